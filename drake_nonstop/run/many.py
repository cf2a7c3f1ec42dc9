"""Many scenarios to runs: several fly at a time, side by side in one loop where they share it."""

import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import nullcontext
from typing import Any

import numpy as np

from drake_nonstop.run.compiled_run import fly_together
from drake_nonstop.run.flight import Flight, require_engine
from drake_nonstop.run.interruption import Interruption, current_interruption
from drake_nonstop.run.run import Run, RunsInterrupted
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.systems.native import asking
from drake_nonstop.validation import listed, require

_AT_A_TIME = 16  # flights


def simulate_many(
    scenarios: Iterable[Scenario],
    *,
    engine: str | None = None,
    progress: Callable[[float], None] | None = None,
) -> list[Run | BaseException]:
    """Simulates scenarios; the runs in their order, each as `simulate` returns it, to the bit.

    Several fly at a time, those that differ in numbers alone side by side in one compiled loop.
    An exception of `simulate`, such as a ScenarioError or a RunStopped, stands in the place of its
    run, and does not change the others.

    Args:
        scenarios: what to run.
        engine: as of `simulate`.
        progress: called with the share of the runs that have ended, as each does.

    Raises:
        ScenarioError: `scenarios` is no list, `progress` no function, or there is no such engine.
        RunsInterrupted: Ctrl-C; carries the runs that have ended.
    """
    scenarios = listed("scenarios", scenarios, "give a list of them")
    remedy = "give a function, or None"
    require(progress is None or callable(progress), "progress", progress, remedy)
    require_engine(engine)
    outcomes: list[Any] = [None] * len(scenarios)
    try:
        given = [{"scenario": each, "engine": engine} for each in scenarios]
        for ended, (k, outcome, _) in enumerate(fly_many(given), 1):
            outcomes[k] = outcome
            if progress is not None:
                progress(ended / len(scenarios))
    except KeyboardInterrupt:
        raise RunsInterrupted(outcomes) from None
    return outcomes


def fly_many(
    arguments: Sequence[dict[str, Any]], *, is_recording: bool = False
) -> Iterator[tuple[int, Run | BaseException, list[str]]]:
    """The numbers of runs, what they are, and their warnings, as they end.

    Of those that raise anything but an interrupt the exception.

    Args:
        arguments: of each as of `simulate`, with the `scenario`.
        is_recording: whether warnings are recorded; if not, users are warned.

    Raises:
        KeyboardInterrupt: Ctrl-C; runs that have not ended are left out.
    """
    with current_interruption() as interruption, interruption.patient(1):
        for first in range(0, len(arguments), _AT_A_TIME):
            batch = [
                _Lane(given, len(arguments), is_recording, interruption)
                for given in arguments[first : first + _AT_A_TIME]
            ]
            for lane in batch:
                lane.go_on(lane.begin)
            compiled = [each for lane in batch if lane.flight for each in lane.flight.compiled]
            with np.errstate(under="ignore"):
                fly_together(compiled, interruption.check)
            for number, lane in enumerate(batch, first):
                if lane.outcome is None:
                    lane.go_on(lane.finish)
                assert lane.outcome is not None
                yield number, lane.outcome, lane.told
                lane.flight = lane.outcome = None


class _Lane:
    """One of several runs that fly; no signal ends it before its time.

    Attributes:
        flight: of it; None: it has none, or ended.
        outcome: the run, or what it has raised; None: it flies.
        told: warnings, where they are recorded.
    """

    def __init__(
        self, given: dict[str, Any], count: int, is_recording: bool, interruption: Interruption
    ):
        self._given, self._count = given, count
        self._is_recording, self._interruption = is_recording, interruption
        self.flight: Flight | None = None
        self.outcome: Run | BaseException | None = None
        self.told: list[str] = []

    def begin(self) -> None:
        """Builds and prepares it."""
        flight = Flight(Interruption(), **self._given, flights=self._count)
        with flight.kept():
            flight.prepare()
        self.flight = flight

    def finish(self) -> Run:
        """The run, with what the compiled loop has left."""
        assert self.flight is not None
        with self.flight.kept():
            return self.flight.finish()

    def go_on(self, stage: Callable[[], Run | None]) -> None:
        """Passes through a stage, and has an outcome where it ends it.

        Raises:
            KeyboardInterrupt: Ctrl-C.
        """
        check = self._interruption.check
        check()
        kept: Any = warnings.catch_warnings(record=True)
        tiny = np.errstate(under="ignore")
        with asking(check), tiny, kept if self._is_recording else nullcontext([]) as told:
            if self._is_recording:
                warnings.simplefilter("always")
            try:
                self.outcome = stage()
            except (Exception, SystemExit) as error:  # whatever the user's own blocks may raise
                if self._interruption.count > 1:  # a KeyboardInterrupt that went through C++
                    raise KeyboardInterrupt from None
                self.outcome, self.flight = error, None
        self.told += [str(warning.message) for warning in told or ()]
