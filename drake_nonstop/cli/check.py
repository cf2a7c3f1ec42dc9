"""`drake-nonstop check`: whether a scenario's aircraft can fly the orbit above its resting load."""

import argparse
import json
from pathlib import Path

from drake_nonstop.cli.arguments import Commands, add_scenario, read_scenario
from drake_nonstop.cli.exit_codes import BAD_INPUT, FAILED
from drake_nonstop.scenario.loading import dump_scenario
from drake_nonstop.simulation.aircraft_margins import (
    aircraft_margins,
    margins_dictionary,
    margins_table,
)
from drake_nonstop.studies.files import replacing_files, require_writable
from drake_nonstop.studies.results_folder import default_folder, require_no_other_run
from drake_nonstop.visualization.figure_style import require_drawing
from drake_nonstop.visualization.margins_figure import make_aircraft_margins_figure

_FILES = _SCENARIO, _DATA, _FIGURE = "scenario.yaml", "check.json", "check.png"


def add_to(commands: Commands) -> None:
    """Adds the subcommand."""
    parser = commands.add_parser(
        "check",
        help="whether the aircraft can fly the orbit of the resting load, and with what margins",
        epilog=f"Exit codes: 0 where all limits are kept, {FAILED} where one is missed, "
        f"{BAD_INPUT} for bad input, such as a scenario without aircraft.",
    )
    parser.set_defaults(action=_check)
    add_scenario(parser, "out/check/NAME")


def _check(options: argparse.Namespace) -> int:
    scenario = read_scenario(options)
    require_drawing()
    folder = options.out or default_folder(Path("out") / "check" / scenario.name, scenario)
    require_no_other_run(folder, scenario)
    found = aircraft_margins(scenario)
    require_writable(folder, _FILES)
    with replacing_files(folder, _FILES) as new:
        (new / _SCENARIO).write_text(dump_scenario(scenario), encoding="utf-8")
        text = json.dumps(margins_dictionary(found), indent=2, allow_nan=False)
        (new / _DATA).write_text(text + "\n", encoding="utf-8")
        make_aircraft_margins_figure(found).savefig(new / _FIGURE, dpi=150)
    print(margins_table(found))
    print(found.verdict)
    print(f"results: {folder}")
    return 0 if found.is_flyable else FAILED
