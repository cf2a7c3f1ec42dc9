"""Progress on the standard error, for what the package's functions take as `progress`.

On a terminal it is a line that is written over, and gone at the end. Elsewhere, such as in a log
file, it is a line every two seconds.
"""

import sys
import time
from typing import Any

_PERIODS = {True: 0.1, False: 2.0}  # s, between two states on a terminal and elsewhere
_WIDTH = 79  # characters, of a line that is written over


class TaskProgress:
    """The share of a task that is done: the `progress` of studies.

    Example:
        with TaskProgress() as progress:
            study(scenario, factors, 5, folder, progress=progress)
    """

    def __init__(self) -> None:
        self._what, self._count, self._share = "", 1, 0.0
        self._start = self._shown = time.monotonic()
        self._is_terminal = sys.stderr.isatty()

    def __enter__(self) -> Any:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def __call__(self, what: str, share: float) -> None:
        """Shows what is being done and the share of it that is done, 0 to 1.

        Another description, or a lower share, begins the next task; one of the same name is
        numbered.
        """
        self._tell(what, "", share)

    def _tell(self, what: str, state: str, share: float) -> None:
        now = time.monotonic()
        if what != self._what or share < self._share:
            self._start = now
            self._count = self._count + 1 if what == self._what else 1
        self._what, self._share = what, share
        if now - self._shown < _PERIODS[self._is_terminal]:
            return
        self._shown, spent = now, now - self._start
        left = f", {spent * (1 - share) / share:.0f} s left" if share > 0 and spent > 0 else ""
        number = f" ({self._count})" if self._count > 1 else ""
        self._write(f"{what}{number}: {state}{share:.0%} [{spent:.0f} s{left}]")

    def _write(self, text: str) -> None:
        line = f"\r{text:<{_WIDTH}.{_WIDTH}}\r" if self._is_terminal else f"{text}\n"
        sys.stderr.write(line)
        sys.stderr.flush()

    def close(self) -> None:
        """Clears the line of a terminal."""
        if self._is_terminal:
            self._write("")


class RunProgress(TaskProgress):
    """The simulated time of a run: the `progress` of `simulate` and `run_live`.

    Example:
        with RunProgress(scenario.name, scenario.simulation_duration) as progress:
            run = simulate(scenario, progress=progress)

    Args:
        name: of the run, shown before the time.
        duration: of the run, in s.
    """

    def __init__(self, name: str, duration: float):
        super().__init__()
        self._name, self._duration = name, duration

    def __call__(self, simulated: float) -> None:  # type: ignore[override]
        """Shows the simulated time in s; an earlier one than before begins another run."""
        state = f"{simulated:.2f} of {self._duration:g} s: "
        self._tell(self._name, state, simulated / self._duration)
