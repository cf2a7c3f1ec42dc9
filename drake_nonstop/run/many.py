"""Many scenarios to runs: several fly at a time, side by side in one loop where they share it."""

import contextlib
import math
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from drake_nonstop.run.compiled_run import Flying
from drake_nonstop.run.flight import Request, require_engine
from drake_nonstop.run.interruption import Interruption, current_interruption
from drake_nonstop.run.recording import MEMORY_LIMIT, least_size
from drake_nonstop.run.run import Run, RunsInterrupted
from drake_nonstop.run.simulate import simulating
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.systems.compiled_flight import Advance, CompiledFlight, advance_together
from drake_nonstop.systems.native import asking
from drake_nonstop.validation import listed, require, warn_user

_MOST = 16  # flights at a time
_SHARE = 0.5  # of the free memory, that their signals may take
_LOOP = 5e6  # bytes that a flight takes besides
_COPIES = 2  # of the signals of a run: as they are recorded, and in its arrays


def simulate_many(
    scenarios: Iterable[Scenario],
    *,
    engine: str | None = None,
    progress: Callable[[float], None] | None = None,
) -> list[Run | BaseException]:
    """Simulates scenarios, and returns what `simulate` makes of each, in their order, to the bit.

    Several fly at a time, those that differ in numbers alone side by side in one compiled loop.
    Where `simulate` raises an exception, such as a ScenarioError or a RunStopped, that is in the
    place of the run; the others are what they are without it.

    Args:
        scenarios: what to run.
        engine: as of `simulate`.
        progress: called with the share of the runs that have ended, as each does.

    Raises:
        ScenarioError: `scenarios` is no list, `progress` no function, or there is no such
            engine.
        RunsInterrupted: Ctrl-C; carries the runs that have ended.
    """
    scenarios = listed("scenarios", scenarios, "give a list of them")
    remedy = "give a function, or None"
    require(progress is None or callable(progress), "progress", progress, remedy)
    require_engine(engine)
    outcomes: list[Any] = [None] * len(scenarios)
    arguments: dict[str, Any] = {"engine": engine}
    ended = 0
    try:
        for k, outcome, _ in fly_many([{"scenario": each} | arguments for each in scenarios]):
            outcomes[k], ended = outcome, ended + 1
            if progress is not None:
                progress(ended / len(scenarios))
    except KeyboardInterrupt:
        raise RunsInterrupted(outcomes) from None
    return outcomes


@dataclass(eq=False)
class _Flyer:
    """One of several runs that fly.

    Attributes:
        number: of the run.
        flying: the run, which asks for samples of its flight.
        check: raises where the user has interrupted, also while a compiler runs.
        is_recording: whether warnings are kept.
        told: warnings, where it `is_recording`.
        asked: what it waits for, while it has no outcome.
        outcome: the run, or what it has raised; a KeyboardInterrupt: it is left out.
    """

    number: int
    flying: Flying[Run]
    check: Callable[[], None]
    is_recording: bool
    told: list[str] = field(default_factory=list)
    asked: tuple[CompiledFlight, int] = field(init=False)
    outcome: Run | BaseException | None = None

    def go_on(self, advance: Advance | None) -> None:
        """Gives it what it waits for; it then has an outcome, or waits for more."""
        kept: Any = warnings.catch_warnings(record=True) if self.is_recording else nullcontext([])
        with asking(self.check), kept as told:
            if self.is_recording:
                warnings.simplefilter("always")
            try:
                self.asked = next(self.flying) if advance is None else self.flying.send(advance)
            except StopIteration as end:
                self.outcome = end.value
            except (
                Exception,
                SystemExit,
                KeyboardInterrupt,
            ) as error:  # whatever the user's own blocks may raise
                self.outcome = error
        self.told += [str(warning.message) for warning in told or ()]


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
    waiting = iter(range(len(arguments)))
    most = min(_MOST, len(arguments))
    flyers: list[_Flyer] = []
    with current_interruption() as interruption, interruption.patient(1):
        is_cut = False
        while not (is_cut or interruption.number):
            while len(flyers) < most and not interruption.number:
                number = next(waiting, None)
                if number is None:
                    break
                given = arguments[number]
                flyer = _Flyer(
                    number, _flying(given, len(arguments)), interruption.check, is_recording
                )
                flyer.go_on(None)
                flyers.append(flyer)
                if flyer.outcome is None:
                    most = _flights_at_a_time(most, given["scenario"])
            if not flyers:
                return
            going = [flyer for flyer in flyers if flyer.outcome is None]
            flights, samples = [each.asked[0] for each in going], [each.asked[1] for each in going]
            for flyer, advance in zip(going, advance_together(flights, samples), strict=True):
                flyer.go_on(advance)
            ended, flyers = flyers, [flyer for flyer in going if flyer.outcome is None]
            for flyer in ended:
                is_error = isinstance(flyer.outcome, Exception)
                if isinstance(flyer.outcome, KeyboardInterrupt) or (
                    is_error and interruption.count > 1  # one that went through C++
                ):
                    is_cut = True
                elif flyer.outcome is not None:
                    yield flyer.number, flyer.outcome, flyer.told
    raise KeyboardInterrupt


def _flying(given: dict[str, Any], flights: int) -> Flying[Run]:
    """A run by the arguments of `simulate` that are given; no signal ends it before its time."""
    own = {k: v for k, v in given.items() if k in Request.__dataclass_fields__}
    others = {k: v for k, v in given.items() if k not in own}
    return (
        yield from simulating(Request(replacements=others, flights=flights, **own), Interruption())
    )


def _flights_at_a_time(most: int, scenario: Scenario) -> int:
    """The number of flights, `most` or less, for which there is memory; tells where it is less."""
    free = free_memory()
    size = _LOOP + _COPIES * min(MEMORY_LIMIT, 2 * least_size(scenario))
    number = min(most, max(1, int(_SHARE * free / size)))
    if number < most:
        warn_user(
            f"memory = {free / 1e6:.0f} MB are free: {number} of the runs fly at a time, in place "
            f"of {most}; the results are the same"
        )
    return number


def free_memory() -> float:
    """Bytes that the system has left, without what it can drop; inf where it does not tell."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return 1024 * float(line.split()[1])
    return math.inf
