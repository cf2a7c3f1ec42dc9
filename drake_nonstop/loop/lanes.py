"""Flights side by side: each goes on by its own samples, as it would alone, to the bit."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.loop.compiled_flight import CompiledFlight
from drake_nonstop.validation import require


class Advance(NamedTuple):
    """What a flight has shown on its way through some samples, as of `CompiledFlight.advance`."""

    signals: NDArray  # (instants, size)
    step_signals: NDArray  # (steps, size)
    error: Exception | None  # that ended it before the sample which raised it


def advance_together(flights: Sequence[CompiledFlight], samples: Sequence[int]) -> list[Advance]:
    """Goes on with each flight by all of its samples (one or more), in the order given.

    A flight that raises keeps what it had shown before, and stands at its last sample; the others
    go on.

    Raises:
        ScenarioError: a number of samples is below 1.
    """
    for count in samples:
        require(count >= 1, "samples", count, "give 1 or more")
    return [_alone(flight, count) for flight, count in zip(flights, samples, strict=True)]


def _alone(flight: CompiledFlight, samples: int) -> Advance:
    """Goes on with one flight, by itself."""
    shown, error = [], None
    end = flight.samples + samples
    try:
        while flight.samples < end:
            shown.append(flight.advance(end - flight.samples))
    except Exception as raised:  # whatever blocks may raise
        error = raised
    signals, steps = map(np.concatenate, zip(*shown, strict=True)) if shown else flight.no_rows
    return Advance(signals, steps, error)
