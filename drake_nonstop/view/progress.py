"""Progress bars, for what the package's functions take as `progress`.

They are tqdm's, on a terminal or in a notebook. Where the standard error is neither, such as a
log file, a line is written every two seconds instead.
"""

import sys
from typing import TYPE_CHECKING, Any, ClassVar, TextIO

from drake_nonstop.validation import is_number, require

if TYPE_CHECKING:
    from tqdm import tqdm

_LINE_PERIOD = 2.0  # s, between lines
_BAR_PERIOD = 0.1  # s, between two states of a bar


class _Progress:
    """A bar that is closed by `close` or at the end of a `with`."""

    def __init__(self) -> None:
        self._bar: tqdm[Any] | None = None

    def __enter__(self) -> Any:
        return self

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        if kind is None and self._bar is not None:
            self._bar.n = self._bar.total or self._bar.n
        self.close()

    def close(self) -> None:
        """Ends the bar, which stays in view as it is; progress that follows begins another."""
        if self._bar is not None:
            self._bar.close()
            self._bar = None

    def _show(self, value: float, **options: Any) -> "tqdm[Any]":
        """The bar at this value; a new one with these options where there is none at a lower."""
        require(is_number(value), "progress", value, "give a finite number")
        if self._bar is not None and value < self._bar.n:
            self._bar.leave = False
            self.close()
        if self._bar is None:
            self._bar = _new_bar(**options)
        return self._bar


class TaskProgress(_Progress):
    """The share of a task that is done: the `progress` of studies.

    Example:
        with TaskProgress() as progress:
            study(scenario, factors, 5, folder, progress=progress)
    """

    _OPTIONS: ClassVar = {
        "total": 1.0,
        "bar_format": "{desc} |{bar}| {percentage:3.0f}% [{elapsed}, {remaining} left]",
    }

    def __init__(self) -> None:
        super().__init__()
        self._show(0.0, **self._OPTIONS)

    def __call__(self, what: str, share: float) -> None:
        """Shows what is being done and the share of it that is done, 0 to 1.

        A share below the one before begins the next task.
        """
        bar = self._show(share, **self._OPTIONS)
        bar.set_description_str(what, refresh=False)
        bar.update(share - bar.n)


class RunProgress(_Progress):
    """Simulated time and real-time factor of a run: the `progress` of `simulate` and `run_live`.

    Example:
        with RunProgress(scenario.name, scenario.simulation_duration) as progress:
            run = simulate(scenario, progress=progress)

    Args:
        name: of the run, shown before the bar.
        duration: of the run, in s.
    """

    def __init__(self, name: str, duration: float):
        super().__init__()
        _bar_class()  # not while the run is timed
        bar_format = "{desc} |{bar}| {n:6.2f} / {total:g} s{postfix}"
        self._options = {"desc": name, "total": duration, "bar_format": bar_format}

    def __call__(self, simulated: float) -> None:
        """Shows the simulated time in s; an earlier one than before begins another run."""
        bar = self._show(simulated, initial=simulated, **self._options)
        elapsed = bar.format_dict["elapsed"]
        if elapsed > 0 and simulated > bar.initial:
            factor = (simulated - bar.initial) / elapsed
            bar.set_postfix_str(f"{factor:.1f} x real time", refresh=False)
        bar.update(simulated - bar.n)


def _bar_class() -> "tuple[type[tqdm[Any]], bool]":
    """The class of bars, and whether it is a notebook's.

    It is imported late, since many commands show no progress, and tqdm.auto, which takes as long
    again, where there may be a notebook.
    """
    if "IPython" not in sys.modules:
        from tqdm import tqdm as on_terminal

        return on_terminal, False
    from tqdm.asyncio import tqdm as on_terminal
    from tqdm.auto import tqdm as anywhere

    return anywhere, anywhere is not on_terminal


def _new_bar(**options: Any) -> "tqdm[Any]":
    bar_class, is_notebook = _bar_class()
    if is_notebook or sys.stderr.isatty():
        period = _BAR_PERIOD
        options |= {"file": sys.stderr, "dynamic_ncols": True}
    else:
        period = _LINE_PERIOD
        options |= {"file": _Lines(sys.stderr), "leave": False, "ascii": ".#"}
    # Without the thread that looks after bars whose miniters are not 0.
    bar = type("Bar", (bar_class,), {"monitor_interval": 0})
    return bar(mininterval=period, delay=period, miniters=0, smoothing=0, **options)


class _Lines:
    """A stream that writes each state of a bar as a line of its own."""

    def __init__(self, stream: TextIO):
        self._stream = stream

    def write(self, text: str) -> None:
        line = text.strip()
        if line:
            self._stream.write(f"{line}\n")

    def flush(self) -> None:
        self._stream.flush()
