"""How a load turns with its aircraft along a task, at the ξ that its layer will ask for."""

import dataclasses
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.blocks.load_trajectory import PlannedTurn
from drake_nonstop.blocks.turn_rate_optimizer import TurnRateOptimizerConfig
from drake_nonstop.mechanics.signals import PLANNED_SIZE, PlannedParameters
from drake_nonstop.mechanics.wrench import feedforward_wrench
from drake_nonstop.model.system import Model
from drake_nonstop.optimization.flight_limits import FlightLimits
from drake_nonstop.optimization.turn_rate import TurnRateSolver, turn_update

_UPDATES = 300  # of a prediction, at most


class PlannedTurnAlong:
    """The turn of a load about the vertical, at ξ that is linear between some times.

    Args:
        block: what makes the reference of the planned ξ.
        rates: (k,), rad/s, ξ.
        times: (k,), s, from 0 on; after the last one ξ stays.
    """

    def __init__(self, block: PlannedTurn, rates: NDArray, times: NDArray):
        self._block, self._context = block, block.CreateDefaultContext()
        self._rates, self._times = rates, times
        lengths, means = np.diff(times), (rates[1:] + rates[:-1]) / 2
        self._slopes = np.append(np.diff(rates) / lengths, 0.0)
        self._angles = np.concatenate([[0.0], np.cumsum(lengths * means)])

    def planned(self, time: float) -> tuple[float, float, float]:
        """The yaw θ in rad, ξ in rad/s and its rate in rad/s², at a time in s."""
        k = int(np.searchsorted(self._times, time, side="right")) - 1
        since, rate, slope = time - self._times[k], self._rates[k], self._slopes[k]
        angle = self._angles[k] + since * (rate + since / 2 * slope)
        return float(angle), float(rate + since * slope), float(slope)

    def reference(self, time: float) -> NDArray:
        """The load's reference (22,) at a time in s."""
        return self.reference_at(time, *self.planned(time))

    def reference_at(self, time: float, angle: float, rate: float, slope: float = 0.0) -> NDArray:
        """Likewise with a yaw in rad, and its rates in rad/s and rad/s²."""
        planned = np.zeros(PLANNED_SIZE)
        parts = PlannedParameters.view(planned)
        parts.angle[:], parts.frequency[:], parts.frequency_rate[:] = angle, rate, slope
        self._context.SetTime(time)
        self._block.GetInputPort("planned").FixValue(self._context, planned)
        found: NDArray = self._block.GetOutputPort("reference").Eval(self._context).copy()
        return found


def constant_turn(block: PlannedTurn, rate: float) -> PlannedTurnAlong:
    """A turn at a constant ξ in rad/s."""
    return PlannedTurnAlong(block, np.array([rate]), np.zeros(1))


def predicted_turn(
    block: PlannedTurn,
    config: TurnRateOptimizerConfig,
    model: Model,
    wind: Callable[[float], NDArray],
    duration: float,
) -> PlannedTurnAlong:
    """The turn of a load whose layer is a `TurnRateOptimizer`, by the updates of the layer.

    Args:
        block: what makes the reference of the planned ξ.
        config: of the layer.
        model: what the controllers believe.
        wind: (3,), m/s, in W, that the layer takes for it at a time in s.
        duration: s.
    """
    assert model.aircraft is not None
    step = max(config.period, duration / _UPDATES)
    layer = dataclasses.replace(config, period=step)
    solver = TurnRateSolver(model, FlightLimits(config), config.orbit_points)
    turn, rate, angle = constant_turn(block, config.frequency), config.frequency, 0.0
    times, rates = step * np.arange(int(duration / step) + 1), []
    for time in times:
        motion, air = turn.reference_at(time, angle, rate), wind(time)
        wrenches = feedforward_wrench(model.load, motion, air)
        update = turn_update(layer, float(config.speed_bound), rate, motion, *wrenches, air)
        rate = solver.solve(update).rate
        rates.append(rate)
        angle += step * rate
    return PlannedTurnAlong(block, np.array(rates), times)
