"""The command `drake-nonstop`: what becomes of errors and signals.

The other modules are imported only once signals are handled: pydrake takes a second.
"""

import atexit
import codecs
import gc
import locale
import os
import resource

from drake_nonstop.cli.ending import (
    BAD_INPUT,
    FAILED,
    CommandInterruption,
    complain,
    exit_code,
    handling_signals,
    say_end,
)
from drake_nonstop.cli.output import GuardedStream, guarded_output, open_closed_streams

_LEAST_OPEN_FILES = 32


def main(arguments: list[str] | None = None) -> int:
    """Runs the command with the given arguments and returns the exit code.

    Without arguments it takes the process's, and ends the process.
    """
    if arguments is not None:
        with handling_signals() as interruption, guarded_output() as (out, _):
            return _finished(_main(arguments, interruption), interruption, out)
    import drake_nonstop.studies.one_blas_thread  # noqa: F401

    open_closed_streams()
    with handling_signals() as interruption, guarded_output() as (out, err):
        interruption.watch()
        try:
            code = _main(None, interruption)
        except SystemExit as ended:  # argparse's
            code = int(ended.code or 0)
        code = _finished(code, interruption, out)
        err.flush()
        # Python's own end takes half a second with pydrake, in which Ctrl-C is not heard.
        atexit._run_exitfuncs()
        os._exit(code)


def _finished(code: int, interruption: CommandInterruption, out: GuardedStream) -> int:
    """The exit code, where the output fails or a signal came too late to change anything."""
    out.flush()
    if out.error is not None and not isinstance(out.error, BrokenPipeError):
        complain(f"the output was not written: {out.error}")
    if interruption.number and code != exit_code(interruption.number):
        return say_end(interruption)
    return code or (FAILED if out.error is not None else 0)


def _main(arguments: list[str] | None, interruption: CommandInterruption) -> int:
    import warnings

    open_files, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if 0 <= open_files < _LEAST_OPEN_FILES:  # pydrake would crash
        remedy = f"allow it more, `ulimit -n {_LEAST_OPEN_FILES}`"
        complain(f"the process may open {open_files} files at a time: {remedy}")
        return FAILED
    if codecs.lookup(locale.getpreferredencoding(False)).name == "ascii":
        remedy = "set PYTHONUTF8=1, or a locale of UTF-8"
        complain(f"pydrake cannot be imported in an ASCII locale: {remedy}")
        return FAILED
    from drake_nonstop.cli.parser import STUDIES, make_parser
    from drake_nonstop.run.interruption import ALL
    from drake_nonstop.run.run import RunStopped
    from drake_nonstop.validation import (
        ScenarioError,
        ScenarioWarning,
        message_of,
        one_line,
        show_warning,
    )

    if arguments is None:
        gc.freeze()  # the collector need not look at what the imports made
    options = make_parser().parse_args(arguments)
    interruption.waits = options.command in STUDIES
    try:
        try:
            interruption.is_starting = False
            with warnings.catch_warnings():
                is_quiet = getattr(options, "quiet", False)
                warnings.simplefilter("ignore" if is_quiet else "once", ScenarioWarning)
                warnings.showwarning = show_warning
                return options.action(options)
        finally:
            interruption.patience = ALL
    except ScenarioError as error:
        message, code = message_of(error).replace("\n", "\\n"), BAD_INPUT
    except RunStopped as stopped:
        message, code = str(stopped), FAILED
    except KeyboardInterrupt as interrupted:
        if interruption.number:
            return say_end(interruption, message_of(interrupted))
        rest = message_of(interrupted)
        message = f"stopped by a KeyboardInterrupt in its code{rest and ': '}{rest}"
        code = FAILED
    except (OSError, MemoryError, SystemExit) as error:
        message, code = one_line(error), FAILED
    except Exception:
        if interruption.number == 0:
            raise
        message = ""  # a KeyboardInterrupt may become another error on its way through C++
    if interruption.number or not message:
        return say_end(interruption)
    complain(message)
    return code
