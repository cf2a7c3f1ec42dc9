"""The command `drake-nonstop`: its parser, and what becomes of errors."""

import argparse
import os
import sys
import warnings

from drake_nonstop.cli import (
    ablate,
    bench,
    blocks,
    list_scenarios,
    new,
    pictures,
    report,
    robustness,
    run,
    stability,
    sweep,
    view,
)
from drake_nonstop.cli.exit_codes import BAD_INPUT, FAILED, INTERRUPTED
from drake_nonstop.validation import ScenarioError, ScenarioWarning, show_warning
from drake_nonstop.version import __version__

# Each has `add_to`, which adds its parser; the help lists them in this order.
_COMMANDS = (
    list_scenarios,
    blocks,
    new,
    run,
    view,
    stability,
    robustness,
    ablate,
    sweep,
    pictures,
    report,
    bench,
)


def main(arguments: list[str] | None = None) -> int:
    """Runs the command with the given or the process's arguments; returns the exit code."""
    options = _parser().parse_args(arguments)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("once", ScenarioWarning)
            warnings.showwarning = show_warning
            return options.action(options)
    except ScenarioError as error:
        print(f"drake-nonstop: {error}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print("drake-nonstop: interrupted", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # the reader of the output has closed it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="drake-nonstop",
        description="Simulate carriers that fly a load on cables without ever stopping.",
    )
    parser.add_argument("--version", action="version", version=__version__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for command in _COMMANDS:
        command.add_to(commands)
    return parser


if __name__ == "__main__":
    sys.exit(main())
