"""`drake-nonstop list`: the scenarios."""

import argparse

from drake_nonstop.cli.arguments import Commands
from drake_nonstop.scenario.loading import load_scenario, scenario_names


def add_to(commands: Commands) -> None:
    """Adds the subcommand."""
    parser = commands.add_parser("list", help="list the scenarios")
    parser.set_defaults(action=_list)


def _list(options: argparse.Namespace) -> int:
    names = scenario_names()
    width = max(len(name) for name in names)
    for name in names:
        print(f"{name:{width}}  {load_scenario(name).description}")
    return 0
