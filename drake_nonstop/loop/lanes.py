"""Flights side by side: each goes on by its own samples, as it would alone, to the bit.

Flights of the same traced functions fly in the lanes of one processor core, see `lane_functions`,
where these are compiled; others fly one by one.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.loop.compiled_flight import CompiledFlight
from drake_nonstop.loop.functions import LoopFunction
from drake_nonstop.loop.lane_functions import LaneFunction
from drake_nonstop.validation import require


class Advance(NamedTuple):
    """What a flight has shown on its way through some samples, as of `CompiledFlight.advance`."""

    signals: NDArray  # (instants, size)
    step_signals: NDArray  # (steps, size)
    error: BaseException | None  # that ended it before the sample which raised it


class _Way:
    """A flight on its way to a sample, `end`, and what it has shown."""

    def __init__(self, flight: CompiledFlight, samples: int):
        self.flight, self.end = flight, flight.samples + samples
        self.shown: list[tuple[NDArray, NDArray]] = []
        self.error: BaseException | None = None

    def add(self, go_on: Callable[..., tuple[NDArray, NDArray]], *given: Any) -> None:
        """Goes on by a method of the flight, with what is given to it."""
        try:
            self.shown.append(go_on(*given))
        except (Exception, SystemExit) as error:  # whatever blocks may raise
            self.error = error

    @property
    def left(self) -> int:
        """The number of samples that are to be flown."""
        return 0 if self.error else self.end - self.flight.samples

    def result(self) -> Advance:
        """All that it has shown."""
        if len(self.shown) == 1:
            return Advance(*self.shown[0], self.error)
        shown = [self.flight.no_rows, *self.shown]
        signals, step_signals = map(np.concatenate, zip(*shown, strict=True))
        return Advance(signals, step_signals, self.error)


def advance_together(flights: Sequence[CompiledFlight], samples: Sequence[int]) -> list[Advance]:
    """Goes on with each flight by all of its samples (one or more), in the order given.

    A flight that raises keeps what it had shown before, and stands at its last sample; the others
    go on.

    Raises:
        ScenarioError: a number of samples is below 1.
    """
    for count in samples:
        require(count >= 1, "samples", count, "give 1 or more")
    ways = [_Way(flight, count) for flight, count in zip(flights, samples, strict=True)]
    together: dict[LoopFunction, list[_Way]] = {}
    for way in ways:
        if way.flight.samples == 0:
            way.add(way.flight.advance, 1)  # by another function than that of all others
        if way.left and way.flight.side_by_side is not None:
            together.setdefault(way.flight.side_by_side, []).append(way)
    for function, own in together.items():
        lanes = function.lanes_for(sum(way.left for way in own)) if len(own) > 1 else None
        while lanes is not None and len(own) > 1:
            _advance_in_lanes(lanes, own)
            own = [way for way in own if way.left]
    for way in ways:
        while way.left:
            way.add(way.flight.advance, way.left)
    return [way.result() for way in ways]


def _advance_in_lanes(lanes: LaneFunction, ways: Sequence[_Way]) -> None:
    """Goes on with each flight until its end, or a sample that blocks have to make an update for.

    It then makes that, which ends the samples whose inputs are known beforehand, as well.
    """
    inputs = [way.flight.lane_inputs(way.left) for way in ways]
    flown, states, signals, steps = lanes.fly(inputs)
    row = 0
    for way, own, count, state in zip(ways, inputs, flown, states, strict=True):
        end = row + count
        if count:
            way.add(way.flight.take, state, signals[row:end], steps[row:end])
        if way.left and count < len(own.times):
            way.add(way.flight.advance, 1)
        row += len(own.times)
