"""The limits of aircraft on the orbits that a layer predicts, as margins with gradients.

A margin is negative where its limit is not kept. Lift is limited by the norm of the needed force,
‖F‖ ≤ κ_s V², which is up to some percent stricter than C_L, and has no end of the angle of attack
at which it would not tell what to do.
"""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.aircraft import Aircraft, thrust_limits
from drake_nonstop.mechanics.planned_flight import FlightNeeds, stall_factor
from drake_nonstop.optimization.problem_config import limit_tightening


class StatedLimits(Protocol):
    """A config with limits of aircraft, such as a `LimitsConfig`."""

    tightening: Any  # see `limit_tightening`
    max_lift_share: float
    max_bank: float
    max_climb: float
    max_thrust_share: float


class FlightLimits:
    """The enabled limits of lift, bank, climb and thrust.

    Args:
        config: its limits are tightened.

    Attributes:
        kinds: what each array of margins limits, in their order, "thrust" from above and below:
            names of `MissedLimits`.
    """

    def __init__(self, config: StatedLimits):
        smaller = 1 - limit_tightening(config)
        self._lift_share = smaller * config.max_lift_share
        self._bank, self._climb = smaller * config.max_bank, smaller * config.max_climb
        self._thrust_share = smaller * config.max_thrust_share
        limits = {"lift": self._lift_share, "bank": self._bank, "climb": self._climb}
        self.kinds = [name for name, limit in limits.items() if np.isfinite(limit)]
        if np.isfinite(self._thrust_share):
            self.kinds += ["thrust", "thrust"]

    def margins(self, aircraft: Aircraft, needs: FlightNeeds) -> list[NDArray]:
        """The margins (...,) of needs (...,), of numbers or symbols, for each of `kinds`.

        1 − ‖F‖/(κ_s V²), 1 − (μ/μ_max)², 1 − (γ/γ_max)² and, over the aircraft's weight, the
        distances of the thrust from the ends of the allowed part of its range.
        """
        found = []
        if "lift" in self.kinds:
            factor = stall_factor(aircraft, self._lift_share)
            found.append(1 - needs.force / (factor * needs.airspeed * needs.airspeed))
        for name, angle, largest in (
            ("bank", needs.bank, self._bank),
            ("climb", needs.climb, self._climb),
        ):
            if name in self.kinds:
                found.append(1 - angle * angle / largest**2)
        if "thrust" in self.kinds:
            middle, half = self._thrust_range(aircraft, needs.airspeed)
            weight = aircraft.mass * aircraft.gravity
            found += [
                (middle + half - needs.thrust) / weight,
                (needs.thrust - middle + half) / weight,
            ]
        return found

    def gradients(self, aircraft: Aircraft, needs: FlightNeeds, by: FlightNeeds) -> list[NDArray]:
        """Those (g, ...) of `margins`, from those of the needs."""
        found = []
        if "lift" in self.kinds:
            share = needs.force / (stall_factor(aircraft, self._lift_share) * needs.airspeed**2)
            found.append(share * (2 * by.airspeed / needs.airspeed - by.force / needs.force))
        for name, angle, of_angle, largest in (
            ("bank", needs.bank, by.bank, self._bank),
            ("climb", needs.climb, by.climb, self._climb),
        ):
            if name in self.kinds:
                found.append(-2 / largest**2 * angle * of_angle)
        if "thrust" in self.kinds:
            least, most = np.asarray(aircraft.min_thrust), np.asarray(aircraft.max_thrust)
            of_least, of_most = (
                (ends[1] + 2 * ends[2] * needs.airspeed) * by.airspeed for ends in (least, most)
            )
            middle = (of_most + of_least) / 2
            half = self._thrust_share * (of_most - of_least) / 2
            weight = aircraft.mass * aircraft.gravity
            found += [(middle + half - by.thrust) / weight, (by.thrust - middle + half) / weight]
        return found

    def _thrust_range(self, aircraft: Aircraft, airspeed: NDArray) -> tuple[NDArray, NDArray]:
        """The middle of the thrust's range, and the allowed distance from it, N."""
        least, most = thrust_limits(aircraft, airspeed)
        return (most + least) / 2, self._thrust_share * (most - least) / 2
