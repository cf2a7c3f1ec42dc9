"""`drake-nonstop check`: fly a scenario as it states, and explain the outcome."""

import argparse

from drake_nonstop.analysis.aircraft_margins import margins_table
from drake_nonstop.analysis.verdict import SEEDS, check_scenario, flights_of
from drake_nonstop.cli.arguments import Commands, add_scenario, read_scenario, result_folder
from drake_nonstop.cli.ending import BAD_INPUT, FAILED
from drake_nonstop.scenario.fields import warn_of_angles
from drake_nonstop.scenario.loading import dump_scenario
from drake_nonstop.studies.files import replacing_files, require_writable, write_json
from drake_nonstop.view.progress import TaskProgress
from drake_nonstop.view.task_figures import (
    make_aircraft_margins_figure,
    make_check_figure,
    make_limits_figure,
)

_SCENARIO, _DATA, _TASK, _AIRCRAFT = "scenario.yaml", "check.json", "task.png", "check.png"
_LIMITS = "limits.png"


def add_to(commands: Commands) -> None:
    """Adds the subcommand."""
    parser = commands.add_parser(
        "check",
        help="fly what a scenario states, in several seeds: margins, and what would help",
        description="Flies the scenario as it states, in several seeds where it has noise, gusts "
        "or distributions, and once without the errors that it states. Prints the outcome, the "
        "margins to each limit with their spread over the seeds, and, where a flight is not ok, "
        "changes with which all flights are, each of which was flown.",
        epilog=f"Exit codes: 0 where all flights are ok, {FAILED} where one is not, "
        f"{BAD_INPUT} for bad input.",
    )
    parser.set_defaults(action=_check)
    add_scenario(parser, "out/check/NAME")
    about = f"flights of a scenario with random numbers ({SEEDS})"
    parser.add_argument("--seeds", type=int, default=SEEDS, metavar="N", help=about)


def _check(options: argparse.Namespace) -> int:
    scenario = read_scenario(options, sampled=False)
    count = len(flights_of(scenario, options.seeds))
    flights = "a flight" if count == 1 else f"{count} flights"
    print(f"check {scenario.name}: {flights} of {scenario.simulation_duration:g} s", flush=True)
    warn_of_angles(scenario)
    folder = result_folder(options, scenario.name, scenario)
    with TaskProgress() as progress:
        found = check_scenario(scenario, seeds=options.seeds, progress=progress)
    figures = {_TASK: make_check_figure(found)}
    if found.aircraft is not None:
        figures[_AIRCRAFT] = make_aircraft_margins_figure(found.aircraft)
    history = found.worst.history
    if history is not None and history.limits:
        figures[_LIMITS] = make_limits_figure(history.limits)
    files = (_SCENARIO, _DATA, *figures)
    require_writable(folder, files)
    with replacing_files(folder, files) as new:
        (new / _SCENARIO).write_text(dump_scenario(scenario), encoding="utf-8")
        write_json(new / _DATA, found.dictionary)
        for name, figure in figures.items():
            figure.savefig(new / name, dpi=150)
    print(found.table)
    if found.aircraft is not None:
        print(f"\n{margins_table(found.aircraft)}")
        if found.aircraft.cables.warning:
            print(found.aircraft.cables.warning)
    print("", *found.verdicts, f"results: {folder}", sep="\n")
    return 0 if found.is_ok else FAILED
