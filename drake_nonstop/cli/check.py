"""`drake-nonstop check`: whether a scenario's task can be flown, before it is."""

import argparse
from pathlib import Path

from drake_nonstop.analysis.aircraft_margins import (
    aircraft_margins_for,
    margins_dictionary,
    margins_table,
)
from drake_nonstop.analysis.task_check import check_task, task_dictionary, task_table
from drake_nonstop.cli.arguments import Commands, add_scenario, read_scenario
from drake_nonstop.cli.ending import BAD_INPUT, FAILED
from drake_nonstop.run.make_simulator import make_simulator
from drake_nonstop.scenario.fields import warn_of_angles
from drake_nonstop.scenario.loading import dump_scenario
from drake_nonstop.studies.files import replacing_files, require_writable, write_json
from drake_nonstop.studies.results_folder import default_folder, require_no_other_run
from drake_nonstop.systems.block import LOOP
from drake_nonstop.view.figure_style import require_drawing
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
        help="whether a task can be flown: its speed bound, its formation, its aircraft",
        description="Looks for a plan of xi and A that keeps the speed bound and the limits of the "
        "layer over the whole task, tells whether the formation is stable, at rest and on its way, "
        "and whether aircraft can fly the orbit of the resting load; of what fails it tries what "
        "helps. Takes seconds, or a minute where something fails.",
        epilog=f"Exit codes: 0 where the task is sound, {FAILED} where it is not, "
        f"{BAD_INPUT} for bad input.",
    )
    parser.set_defaults(action=_check)
    add_scenario(parser, "out/check/NAME")


def _check(options: argparse.Namespace) -> int:
    scenario = read_scenario(options)
    warn_of_angles(scenario)
    require_drawing()
    folder = options.out or default_folder(Path("out") / "check" / scenario.name, scenario)
    require_no_other_run(folder, scenario)
    loop = make_simulator(scenario).get_system().GetSubsystemByName(LOOP)
    aircraft = None
    if scenario.system.aircraft is not None:
        start = loop.CreateDefaultContext()
        aircraft = aircraft_margins_for(scenario.sampled(), loop, start)
    with TaskProgress() as progress:
        found = check_task(scenario, loop, progress=progress)
    report = {
        "scenario": scenario.name,
        "is_sound": found.is_sound,
        "is_in_doubt": found.is_in_doubt,
    }
    figures = {_TASK: make_check_figure(found)}
    if aircraft is not None:
        report |= margins_dictionary(aircraft)
        report["is_sound"] = found.is_sound and aircraft.is_flyable
        figures[_AIRCRAFT] = make_aircraft_margins_figure(aircraft)
    if found.speeds.limits:
        title = f"{scenario.name}: limits of the layer, dashed, along the plan"
        figures[_LIMITS] = make_limits_figure(found.speeds.limits, title)
    report |= task_dictionary(found)
    files = (_SCENARIO, _DATA, *figures)
    require_writable(folder, files)
    with replacing_files(folder, files) as new:
        (new / _SCENARIO).write_text(dump_scenario(scenario), encoding="utf-8")
        write_json(new / _DATA, report)
        for name, figure in figures.items():
            figure.savefig(new / name, dpi=150)
    print(task_table(found))
    for verdict in found.verdicts:
        print(verdict)
    flown = found.flight or aircraft
    if flown is not None and flown.cables.warning:
        print(flown.cables.warning)
    if aircraft is not None:
        print(margins_table(aircraft))
        print(aircraft.verdict)
    print(f"results: {folder}")
    return 0 if report["is_sound"] else FAILED
