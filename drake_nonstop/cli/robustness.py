"""`drake-nonstop robustness`: fly a scenario with errors unknown to its controllers, one by one."""

import argparse

from drake_nonstop.cli.arguments import (
    Commands,
    add_seeds,
    add_study,
    make_study,
    read_scenario,
    result_folder,
)
from drake_nonstop.studies.presets import robustness


def add_to(commands: Commands) -> None:
    """Adds the subcommand."""
    parser = commands.add_parser("robustness")
    parser.set_defaults(action=_robustness)
    add_study(parser, "out/robustness/NAME")
    add_seeds(parser)


def _robustness(options: argparse.Namespace) -> int:
    scenario = read_scenario(options)
    folder = result_folder(options, scenario.name, scenario)
    make_study(options, robustness, scenario, folder, seeds=options.seeds)
    return 0
