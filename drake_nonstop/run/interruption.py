"""Signals that ask for the end: noted at once, acted on where nothing is lost.

A KeyboardInterrupt raised wherever Python happens to be may surface, on its way through C++, as an
error of a block or a solver, or not at all. So the handler notes the signal, and raises only where
the code has no better place to ask.
"""

import contextlib
import math
import signal
import threading
from collections.abc import Iterator, Sequence

ALL = math.inf  # the patience with which no signal raises


class Interruption:
    """The signals that have come, and how many of them may come before one raises.

    Attributes:
        number: of the first signal, such as signal.SIGINT; 0: none has come.
        count: of signals.
        patience: the number of signals that are only noted; later ones raise KeyboardInterrupt.
        is_writing: whether results are being written, which only SIGKILL breaks off.
    """

    def __init__(self) -> None:
        self.number = 0
        self.count = 0
        self.patience = 0.0
        self.is_writing = False

    def handle(self, number: int, frame: object) -> None:
        """The handler of the signals."""
        self.number = self.number or number
        self.count += 1
        if self.count > self.patience:
            raise KeyboardInterrupt

    def check(self) -> None:
        """Raises KeyboardInterrupt where a signal has been noted: a place to end at."""
        if self.number:
            raise KeyboardInterrupt

    @contextlib.contextmanager
    def patient(self, patience: float) -> Iterator[None]:
        """Within it so many signals are only noted."""
        before, self.patience = self.patience, patience
        try:
            yield
        finally:
            self.patience = before


_current: Interruption | None = None


@contextlib.contextmanager
def handled_by(interruption: Interruption, numbers: Sequence[int]) -> Iterator[Interruption]:
    """Within it these signals are handled so; those that the process ignores stay ignored.

    Only the main thread can handle signals: in any other nothing is changed.
    """
    global _current
    if threading.current_thread() is not threading.main_thread():
        yield interruption
        return
    previous = {number: signal.getsignal(number) for number in numbers}
    previous = {n: handler for n, handler in previous.items() if handler is not signal.SIG_IGN}
    outer, _current = _current, interruption
    try:
        for number in previous:
            signal.signal(number, interruption.handle)
        yield interruption
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
        _current = outer


@contextlib.contextmanager
def current_interruption() -> Iterator[Interruption]:
    """The one of the command, or else a new one, which handles Ctrl-C until the end."""
    if _current is not None:
        yield _current
        return
    with handled_by(Interruption(), [signal.SIGINT]) as interruption:
        yield interruption
