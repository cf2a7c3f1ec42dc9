"""The parser of the command, with all its subcommands."""

import argparse

from drake_nonstop.cli import check, design, run, scenarios, signals, studies, video
from drake_nonstop.version import __version__

# Each has `add_to`, which adds its parsers; the help lists them in this order.
_COMMANDS = (scenarios, design, check, run, video, signals, studies)
STUDIES = ("design", "stability", "robustness", "ablate", "sweep")


def make_parser() -> argparse.ArgumentParser:
    """The parser; `command` is the subcommand's name, `action` its function."""
    parser = argparse.ArgumentParser(
        prog="drake-nonstop",
        description="Simulate carriers that fly a load on cables without ever stopping.",
    )
    parser.add_argument("--version", action="version", version=__version__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND", dest="command")
    for command in _COMMANDS:
        command.add_to(commands)
    return parser
