"""The rate at which a load turns with its aircraft: the formation that has no amplitude.

The carriers keep their places above the load. At each phase of a turn the squared airspeed is
quadratic in the rate, and what the aircraft need is smooth in it: the search is one over intervals
of one number.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.internal_force import orbit_axes
from drake_nonstop.mechanics.planned_orbit import PlannedOrbit, planned_needs, turning_terms
from drake_nonstop.model.system import Model
from drake_nonstop.optimization.amplitude_intervals import allowed_intervals
from drake_nonstop.optimization.constraints import FEASIBILITY_TOLERANCE, Constraints
from drake_nonstop.optimization.diagnostics import BOUND, Outcome
from drake_nonstop.optimization.limits import Of

_RATES = 64  # at which the least infeasible one is looked for
_TOLERANCE = 1e-6  # relative, of a rate


class TurnUpdate(NamedTuple):
    """Data that vary from update to update, in W."""

    previous: float  # rad/s, the last rate
    nominal: float  # rad/s, what the anchor pulls to
    anchor_weight: float
    low: float  # rad/s, the bounds of the rate
    high: float  # rad/s
    motion: NDArray  # (22,), of the load
    wrench: NDArray  # (6,)
    wrench_rate: NDArray  # (6,)
    wind: NDArray  # (3,), m/s
    speed_bound: float  # m/s, tightened; 0: none


def turn_update(
    config: Any,
    speed_bound: float,
    previous: float,
    motion: NDArray,
    wrench: NDArray,
    wrench_rate: NDArray,
    wind: NDArray,
) -> TurnUpdate:
    """The update of a layer with a `TurnRateOptimizerConfig`, for ε in m/s; see `TurnUpdate`."""
    low, high = config.frequency_bounds
    step = config.max_frequency_rate * config.period
    return TurnUpdate(
        previous=previous,
        nominal=config.frequency,
        anchor_weight=config.anchor_weight,
        low=max(low, previous - step),
        high=min(high, previous + step),
        motion=motion,
        wrench=wrench,
        wrench_rate=wrench_rate,
        wind=wind,
        speed_bound=(1 + config.tightening) * speed_bound,
    )


class TurnAnswer(NamedTuple):
    """The answer of one update."""

    rate: float  # rad/s
    outcome: Outcome
    slowest_speed: float  # m/s, predicted, through the air
    missed: list[str]  # names of limits, as of `missed_limits`


class TurnRateSolver:
    """Changes the rate as little as keeps the airspeed and the limits of aircraft over a turn.

    The limits are those of `constraints`, at a number of `phases` of the turn.
    """

    def __init__(self, model: Model, constraints: Constraints, phases: int):
        assert model.aircraft is not None
        self._model, self._aircraft, self._constraints = model, model.aircraft, constraints
        self._angles = 2 * np.pi * np.arange(phases) / phases
        self._axes = orbit_axes(model.pattern.basis, model.pattern.phases)

    def margins(self, update: TurnUpdate, rates: NDArray) -> tuple[NDArray, NDArray]:
        """The worst margin (1 + limits, k) of the airspeed and of each limit, at rates (k,).

        And the least airspeed (k,), m/s.
        """
        model, count = self._model, len(self._angles)
        terms = turning_terms(
            update.motion,
            update.wrench,
            update.wrench_rate,
            update.wind,
            np.repeat(rates, count),
            np.tile(self._angles, len(rates)),
            pseudo_inverse=model.pseudo_inverse,
            offset=model.pattern.offset,
            attachments=model.attachments,
        )
        needs = planned_needs(
            self._aircraft,
            terms,
            self._axes,
            PlannedOrbit.constant(np.zeros(1), 0.0, 0.0),
            rest_length=model.cable_length,
            compliance=model.cable_compliance,
        )
        squares = needs.airspeed * needs.airspeed
        unit = update.speed_bound or 1.0
        found = [
            (squares - update.speed_bound**2) / unit**2,
            *self._constraints.of_flight(self._aircraft, needs),
        ]
        worst = [margin.reshape(len(rates), -1).min(axis=1) for margin in found]
        return np.stack(worst), np.sqrt(squares.reshape(len(rates), -1).min(axis=1))

    def solve(self, update: TurnUpdate) -> TurnAnswer:
        """The answer of one update."""
        previous = min(max(update.previous, update.low), update.high)
        weight = update.anchor_weight
        wanted = (update.previous + weight * update.nominal) / (1 + weight)
        wanted = min(max(wanted, update.low), update.high)

        def at(rate: float) -> tuple[NDArray, NDArray]:
            return self.margins(update, np.array([rate]))

        def worst(rates: NDArray) -> NDArray:
            return self.margins(update, rates)[0].min(axis=0)

        margins, slowest = at(wanted)
        if margins.min() >= -FEASIBILITY_TOLERANCE:
            is_kept = abs(wanted - update.previous) <= _TOLERANCE * update.previous
            outcome = Outcome.KEPT if is_kept else Outcome.SOLVED
            return self._answer(wanted, outcome, margins, slowest)
        intervals = allowed_intervals(worst, update.low, update.high, previous)
        if intervals:
            nearest = [min(max(wanted, low), high) for low, high in intervals]
            rate = min(nearest, key=lambda rate: abs(rate - wanted))
            return self._answer(rate, Outcome.SOLVED, *at(rate))
        rates = np.append(np.geomspace(update.low, update.high, _RATES), previous)
        margins, _ = self.margins(update, rates)
        # As of other searches: the speeds first, and where they are kept what lacks the least.
        order = np.lexsort([margins.min(axis=0), np.minimum(margins[0], 0.0)])
        rate = float(rates[order[-1]])
        is_held = abs(rate - update.previous) <= _TOLERANCE * update.previous
        return self._answer(rate, Outcome.HELD if is_held else Outcome.RELAXED, *at(rate))

    def _answer(
        self, rate: float, outcome: Outcome, margins: NDArray, slowest: NDArray
    ) -> TurnAnswer:
        kinds = np.array([BOUND, *self._constraints.names(Of.FLIGHT)])
        missed = kinds[margins[:, 0] < -FEASIBILITY_TOLERANCE].tolist()
        return TurnAnswer(rate, outcome, float(slowest[0]), missed)
