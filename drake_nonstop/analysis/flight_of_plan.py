"""What the aircraft of a task need on their way, along the plan that keeps the bound."""

import math
from typing import Any, NamedTuple

import numpy as np

from drake_nonstop.analysis.carriers_along import carriers_along
from drake_nonstop.analysis.flight_envelope import (
    FlightEnvelope,
    FlightMargin,
    FlightRanges,
    limits_along,
)
from drake_nonstop.analysis.speed_check import SpeedCheck
from drake_nonstop.analysis.task import Task
from drake_nonstop.mechanics.planned_orbit import PlannedOrbit

# Times as long as the way asks for what is beyond the limits commands may be at them: afterwards
# feedback makes up for it.
_AFTERWARDS = 3.0


class FlightOfPlan(NamedTuple):
    """The aircraft's margins along a plan, each where it is least."""

    margins: tuple[FlightMargin, ...]  # phases are the plan's θ, from 0 to 2π
    times: tuple[float, ...]  # s, of each
    ranges: FlightRanges  # of what they need, and what straight cables leave out
    missed_share: float  # of the time, in which an aircraft needs more than its limits allow
    largest_share: float  # up to which that can be flown: `limits.saturated_share` of the run
    gust: float = 0.0  # m/s, standard deviation of the wind at a carrier, which is left out

    @property
    def is_flyable(self) -> bool:
        """Whether limits are missed no longer than commands may be at them, and without stall."""
        return self.missed_share <= self.largest_share and self.ranges.lift_share[1] < 1

    @property
    def is_in_doubt(self) -> bool:
        """Whether a flight alone tells if feedback makes up for what is missed, or for gusts."""
        is_short = _AFTERWARDS * self.missed_share <= self.largest_share
        return self.is_flyable and (not is_short or self.gust > 0)

    @property
    def verdict(self) -> str:
        """Whether the aircraft can fly the plan; what is missed, and what to change."""
        if self.missed_share == 0 and self.is_flyable:
            said = "the aircraft can fly the way within all limits"
            if self.gust == 0:
                return said
            return f"{said} in the mean wind; in gusts of {self.gust:g} m/s a flight alone tells"
        missed = ", ".join(
            f"{margin.sentence} at t = {time:.1f} s, carrier {margin.carriers[0]}"
            for margin, time in zip(self.margins, self.times, strict=True)
            if not margin.is_kept
        )
        if self.is_flyable:
            ends = (
                "whether feedback makes up for it, a flight alone tells"
                if self.is_in_doubt
                else "feedback makes up for so little"
            )
            return (
                f"the aircraft need more than their limits for {100 * self.missed_share:.2g} % of "
                f"the time: {missed}; {ends}"
            )
        return (
            f"system.aircraft: they cannot fly the way within their limits: {missed}; give a "
            "slower motion, a reference_governor, or, where they are not given yet, the layer's "
            "max_lift_share, max_bank, max_climb and max_thrust_share"
        )

    @property
    def dictionary(self) -> dict[str, Any]:
        """The same for a JSON file; angles are in rad."""
        return {
            "verdict": self.verdict,
            "is_flyable": self.is_flyable,
            "missed_share": self.missed_share,
            "margins": [
                margin.dictionary | {"time_s": time}
                for margin, time in zip(self.margins, self.times, strict=True)
            ],
            "ranges": self.ranges.dictionary,
        }


def flight_of_plan(task: Task, speeds: SpeedCheck, limits: FlightEnvelope) -> FlightOfPlan | None:
    """The margins of a task's aircraft along its best plan, in the mean wind at their mean height.

    The aircraft follow the plan exactly, see `CarriersAlong`. None where there are no aircraft, the
    internal force has other harmonics than the first, or a layer without a speed bound changes ξ
    and A: there is no plan. Without one in `speeds` ξ and A are the nominal ones.
    """
    is_free = task.changes_parameters and speeds.plan is None
    aircraft = task.flown.aircraft
    if aircraft is None or is_free or any(o != 1 for o in task.flown.pattern.harmonics):
        return None
    times = speeds.plan_times
    planned = task.planned(speeds.plan, times)
    carriers = carriers_along(task, times)
    motion = carriers.motion(PlannedOrbit.of_planned(planned))
    needs = carriers.needs(motion)
    quantities = [*limits_along(aircraft, needs, limits, times)]
    angles = planned[:, 0] % (2 * math.pi)
    missed = [np.any(quantity.left.round(9) < 0, axis=1) for quantity in quantities]
    return FlightOfPlan(
        tuple(quantity.worst_margin(angles) for quantity in quantities),
        tuple(quantity.time for quantity in quantities),
        FlightRanges.of(aircraft, needs, motion.forces, task.flown.attachments),
        float(np.mean(np.any(missed, axis=0))),
        limits.saturated_share,
        task.air.gust,
    )
