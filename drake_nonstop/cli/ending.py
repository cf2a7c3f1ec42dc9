"""How the command ends: its exit codes, and by a signal one sentence and the shell's code."""

import contextlib
import os
import signal
import sys

from drake_nonstop.run.interruption import Interruption

FAILED = 1
BAD_INPUT = 2
NOT_OK = 3  # a run came to its end with an outcome other than ok
INTERRUPTED = 130  # the shell's for Ctrl-C

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_GRACE = 1.0  # s, in which the command ends in order, from the second signal or an interrupt on


def exit_code(number: int) -> int:
    """The shell's code for the end by that signal; 0, for a KeyboardInterrupt: of Ctrl-C."""
    return 128 + (number or signal.SIGINT)


def complain(message: str) -> None:
    """Prints a sentence of the command's on the standard error."""
    with contextlib.suppress(OSError, ValueError):  # it is full, or closed
        print(f"drake-nonstop: {message}", file=sys.stderr, flush=True)


def say_end(interruption: Interruption, rest: str = "") -> int:
    """Prints what has ended the command and the rest of the sentence; returns the exit code."""
    complain(f"{_cause(interruption.number)}{rest and ': '}{rest}")
    return exit_code(interruption.number)


def _cause(number: int) -> str:
    is_ctrl_c = number in (0, signal.SIGINT)
    return "interrupted" if is_ctrl_c else f"ended by {signal.Signals(number).name}"


class CommandInterruption(Interruption):
    """The signals that the command gets.

    A block that never returns may swallow a KeyboardInterrupt: an alarm ends the process some
    time after the second signal, or after a first one that raised where nothing waits for it. Only
    what does not return to Python, such as a loop in C, is out of its reach.

    Attributes:
        is_starting: whether nothing has begun yet: the first signal ends the process at once.
        waits: whether the first signal leaves all the time to end in order.
        has_alarm: whether the process is the command's own.
    """

    def __init__(self, *, has_alarm: bool) -> None:
        super().__init__()
        self.is_starting = True
        self.waits = False
        self.has_alarm = has_alarm

    def handle(self, number: int, frame: object) -> None:
        """The handler of the signals, which raises once: again, it would break off the end."""
        has_raised = self.count > self.patience
        try:
            super().handle(number, frame)
            raises = False
        except KeyboardInterrupt:
            raises = True
        if self.is_starting:
            self._end()
        if self.has_alarm and (self.count > 1 or (raises and not self.waits)):
            signal.signal(signal.SIGALRM, lambda *_: self._end())
            signal.setitimer(signal.ITIMER_REAL, _GRACE, _GRACE)
        if raises and not has_raised:
            raise KeyboardInterrupt

    def _end(self) -> None:
        """Ends the process, but not while results are written."""
        if not self.is_writing:
            with contextlib.suppress(OSError):
                os.write(2, f"drake-nonstop: {_cause(self.number)}\n".encode())
            os._exit(exit_code(self.number))
