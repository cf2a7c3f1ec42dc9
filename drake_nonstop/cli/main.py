"""The command `drake-nonstop`: finds the subcommand, and says what becomes of errors and signals.

A subcommand is a module of this folder, whose docstring has a line with its name and what it does.
`add_to` adds its parser, with the function that runs it as `action`. Only the module of the command
that is given is imported, once signals are handled: pydrake takes a second.
"""

import argparse
import atexit
import gc
import importlib
import os
import re
import sys
import warnings
from pathlib import Path

from drake_nonstop.cli.ending import (
    BAD_INPUT,
    FAILED,
    SIGNALS,
    CommandInterruption,
    complain,
    exit_code,
    say_end,
)
from drake_nonstop.run.interruption import ALL, handled_by
from drake_nonstop.version import __version__

# They end in order by themselves.
_STUDIES = ("design", "robustness", "ablate", "sweep", "study")
_HEADING = re.compile(r'(?m)^(?:""")?`drake-nonstop (?P<name>[a-z]+)`: (?P<about>.*?)\.?(?:"""|$)')


def main(arguments: list[str] | None = None) -> int:
    """Runs the command with the given arguments and returns the exit code.

    Without arguments it takes the process's, and ends the process.
    """
    interruption = CommandInterruption(has_alarm=arguments is None)
    with handled_by(interruption, SIGNALS):
        if arguments is not None:
            return _ended(_main(arguments, interruption), interruption)
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # matrices are small, processes several
        os.environ["MPLBACKEND"] = "agg"  # figures are files, and a backend may not be installed
        for stream in (sys.stdout, sys.stderr):
            if stream is not None:  # characters that a terminal does not have are no errors
                stream.reconfigure(errors="replace")  # type: ignore[union-attr]
        try:
            code = _main(sys.argv[1:], interruption)
        except SystemExit as ended:  # argparse's
            code = int(ended.code or 0)
        code = _ended(code, interruption)
        # Python's own end takes half a second with pydrake, in which Ctrl-C is not heard.
        atexit._run_exitfuncs()
        os._exit(code)


def _ended(code: int, interruption: CommandInterruption) -> int:
    """The exit code, where the output fails or a signal came too late to change anything."""
    try:
        print(end="", flush=True)
    except BrokenPipeError:  # such as of `| head`
        pass
    except (OSError, ValueError) as error:
        complain(f"the output was not written: {error}")
        code = code or FAILED
    if interruption.number and code != exit_code(interruption.number):
        return say_end(interruption)
    return code


def commands() -> dict[str, tuple[str, str]]:
    """The module of each command and what it does, from the modules' docstrings."""
    return {
        heading["name"]: (file.stem, heading["about"])
        for file in sorted(Path(__file__).parent.glob("*.py"))
        for heading in _HEADING.finditer(file.read_text(encoding="utf-8"))
    }


def make_parser(command: str) -> argparse.ArgumentParser:
    """The parser, with all arguments of one command and the names of the others."""
    parser = argparse.ArgumentParser(
        prog="drake-nonstop",
        description="Simulate carriers that fly a load on cables without ever stopping.",
    )
    parser.add_argument("--version", action="version", version=__version__)
    subparsers = parser.add_subparsers(required=True, metavar="COMMAND", dest="command")
    every = commands()
    own = every.get(command, ("", ""))[0]
    for name, (module, about) in every.items():
        if module != own:
            subparsers.add_parser(name, help=about)
    if own:
        importlib.import_module(f"drake_nonstop.cli.{own}").add_to(subparsers)
    for name, chosen in subparsers.choices.items():
        about = every[name][1]
        chosen.description = chosen.description or f"{about[0].upper()}{about[1:]}."
    return parser


def _main(arguments: list[str], interruption: CommandInterruption) -> int:
    options = make_parser(next(iter(arguments), "")).parse_args(arguments)

    from drake_nonstop.run.run import RunStopped
    from drake_nonstop.validation import (
        ScenarioError,
        ScenarioWarning,
        one_line,
        show_warning,
    )

    gc.freeze()  # the collector need not look at what the imports made
    interruption.waits = options.command in _STUDIES
    try:
        interruption.is_starting = False
        with warnings.catch_warnings():
            is_quiet = getattr(options, "quiet", False)
            warnings.simplefilter("ignore" if is_quiet else "once", ScenarioWarning)
            warnings.showwarning = show_warning
            return options.action(options)
    except KeyboardInterrupt as interrupted:
        if interruption.number:
            return say_end(interruption, str(interrupted))
        complain("stopped by a KeyboardInterrupt in its code")
    except BrokenPipeError:
        return 0
    except Exception as error:
        if interruption.number:  # a KeyboardInterrupt that became another error in C++
            return say_end(interruption)
        if isinstance(error, ScenarioError):
            complain(str(error).replace("\n", "\\n"))
            return BAD_INPUT
        if not isinstance(error, (RunStopped, OSError, MemoryError)):
            raise
        complain(one_line(error))
    except SystemExit as error:  # of a block
        complain(one_line(error))
    finally:
        interruption.patience = ALL
    return FAILED
