"""How the command ends: its exit codes, and by a signal one sentence and the shell's code."""

import contextlib
import os
import select
import signal
import sys
import threading
import time
from collections.abc import Iterator
from typing import NoReturn

from drake_nonstop.run.interruption import Interruption, before_end, handled_by

FAILED = 1
BAD_INPUT = 2
NOT_OK = 3  # a run came to its end with an outcome other than ok
INTERRUPTED = 130  # the shell's for Ctrl-C

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_GRACE = 1.0  # s, from the second signal, or from a first one that nothing waits for
_LAST_GRACE = 0.5  # s, once the sentence is printed


def exit_code(number: int) -> int:
    """The shell's code for the end by that signal; 0, for a KeyboardInterrupt: of Ctrl-C."""
    return 128 + (number or signal.SIGINT)


def complain(message: str) -> None:
    """Prints a sentence of the command's on the standard error."""
    with contextlib.suppress(OSError, ValueError):  # it is full, or closed
        print(f"drake-nonstop: {message}", file=sys.stderr, flush=True)


def say_end(interruption: Interruption, rest: str = "") -> int:
    """Prints what has ended the command and the rest of the sentence; returns the exit code."""
    interruption.is_said = True
    complain(_cause(interruption.number, rest))
    return exit_code(interruption.number)


def _cause(number: int, rest: str) -> str:
    is_ctrl_c = number in (0, signal.SIGINT)
    cause = "interrupted" if is_ctrl_c else f"ended by {signal.Signals(number).name}"
    return f"{cause}{rest and ': '}{rest}"


class CommandInterruption(Interruption):
    """The signals that the command gets.

    A block that never returns may swallow a KeyboardInterrupt. So a thread of its own ends the
    process some time after the second signal, or after a first one that raised in vain; it keeps
    what was flown. Only what holds Python's lock for ever, such as a loop in C, is out of reach.

    Attributes:
        is_starting: whether nothing has begun yet: the first signal ends the process at once.
        waits: whether the first signal leaves time to end in order.
    """

    def __init__(self) -> None:
        super().__init__()
        self.is_starting = True
        self.waits = False
        self._has_raised = False

    def handle(self, number: int, frame: object) -> None:
        """The handler of the signals."""
        if self.is_starting:
            self.number = number
            self._end()
        super().handle(number, frame)

    def interrupt(self) -> None:
        """Raises KeyboardInterrupt once: a second one would break off what the first one began."""
        if not self._has_raised:
            self._has_raised = True
            raise KeyboardInterrupt

    def _end(self, rest: str = "") -> NoReturn:
        if not self.is_said:
            with contextlib.suppress(OSError):
                os.write(2, f"drake-nonstop: {_cause(self.number, rest)}\n".encode())
        for clean_up in before_end:
            with contextlib.suppress(Exception):
                clean_up()
        os._exit(exit_code(self.number))

    def watch(self) -> None:
        """Starts the thread; to be called once, in the main thread of the command's process."""
        reader, writer = os.pipe()
        os.set_blocking(writer, False)
        signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
        threading.Thread(target=self._watch, args=(reader,), daemon=True).start()

    def _watch(self, reader: int) -> None:
        count, end = 0, None
        while True:
            left = None if end is None else max(0.0, end - time.monotonic())
            if select.select([reader], [], [], left)[0]:
                before = count
                count += sum(number in SIGNALS for number in os.read(reader, 64))
                if before < 2 <= count or (before == 0 and count == 1 and not self.waits):
                    end = time.monotonic() + _GRACE
            elif count > 1 or self._has_raised:
                break
            else:
                end = None
        while self.is_writing:
            time.sleep(0.01)
        rest = ""
        if self.is_said:
            time.sleep(_LAST_GRACE)
        elif (collect := self.collect) is not None and (keep := self.keep) is not None:
            with contextlib.suppress(Exception):
                rest = keep(collect())
        self._end(rest)


@contextlib.contextmanager
def handling_signals() -> Iterator[CommandInterruption]:
    """Within it the command's signals are handled."""
    with handled_by(CommandInterruption(), SIGNALS) as interruption:
        assert isinstance(interruption, CommandInterruption)
        yield interruption
