"""What aircraft need, beside what they can: the limits of their flight, and the ranges of needs."""

import dataclasses
import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.analysis.bowed_cables import BowedCables
from drake_nonstop.analysis.limit_along import LimitAlong
from drake_nonstop.blocks.fixed_wing_controller import FixedWingControllerConfig
from drake_nonstop.mechanics.aircraft import (
    Aircraft,
    airspeed_over_loaded_stall,
    stall_speed,
    thrust_limits,
    thrust_share,
)
from drake_nonstop.mechanics.planned_orbit import FlightNeeds
from drake_nonstop.optimization.limits import LIMITS
from drake_nonstop.scenario.run_limits import RunLimits
from drake_nonstop.scenario.schema import Scenario

ROWS = {limit.name: limit for limit in LIMITS}
_AIRSPEED = dataclasses.replace(ROWS["lift"], words="airspeed / stall speed", is_least=True)
_MOST_THRUST = dataclasses.replace(ROWS["thrust"], words="thrust", unit="N")
_LEAST_THRUST = dataclasses.replace(_MOST_THRUST, is_least=True)


class FlightEnvelope(NamedTuple):
    """Beyond which an orbit counts as one that cannot be flown.

    The first three are where `FixedWingController` saturates, the last two those of a run.
    """

    lift_share: float = FixedWingControllerConfig.lift_share  # of C_Lmax
    speed_share: float = FixedWingControllerConfig.speed_share  # of the stall speed
    bank: float = FixedWingControllerConfig.max_bank  # rad
    climb: float = math.radians(30.0)  # rad, up or down; PX4's FW_P_LIM_MAX and FW_P_LIM_MIN
    carrier_distance: float = RunLimits.carrier_distance  # of the reach, see `RunLimits`
    cable_distance: float = RunLimits.cable_distance  # of the distance of two attachments
    saturated_share: float = RunLimits.saturated_share  # of the time on the way, see `RunLimits`


def flight_envelope_of(scenario: Scenario) -> FlightEnvelope:
    """That of the scenario's controller, as far as it has any limits, and of its runs."""
    controller, default = scenario.carrier_controller, FlightEnvelope()
    return default._replace(
        lift_share=getattr(controller, "lift_share", default.lift_share),
        speed_share=getattr(controller, "speed_share", default.speed_share),
        bank=getattr(controller, "max_bank", default.bank),
        carrier_distance=scenario.limits.carrier_distance,
        cable_distance=scenario.limits.cable_distance,
        saturated_share=scenario.limits.saturated_share,
    )


def limits_along(
    aircraft: Aircraft, needs: FlightNeeds, limits: FlightEnvelope, times: NDArray
) -> Iterator[LimitAlong]:
    """What each aircraft needs, (k, n) each, beside its limits; at `times` (k,) of `LimitAlong`."""
    least, most = thrust_limits(aircraft, needs.airspeed)
    lift, bank, climb = (ROWS[name].values(aircraft, needs) for name in ("lift", "bank", "climb"))
    for row, limit, values in (
        (ROWS["lift"], limits.lift_share, lift),
        (_AIRSPEED, limits.speed_share, needs.airspeed / stall_speed(aircraft)),
        (ROWS["bank"], limits.bank, bank),
        (ROWS["climb"], limits.climb, climb),
        (_MOST_THRUST, most, needs.thrust),
        (_LEAST_THRUST, least, needs.thrust),
    ):
        yield LimitAlong(row, limit, times, values)


def _range(values: NDArray) -> tuple[float, float]:
    return float(np.min(values)), float(np.max(values))


class FlightRanges(NamedTuple):
    """The least and the largest of what aircraft need, over all of them and all instants."""

    lift_share: tuple[float, float]  # of C_Lmax
    airspeed: tuple[float, float]  # m/s
    over_stall: tuple[float, float]  # of the airspeed, over the stall speed without a cable
    over_loaded_stall: tuple[float, float]  # over the one with cable and bank
    bank: tuple[float, float]  # rad
    climb: tuple[float, float]  # rad
    thrust: tuple[float, float]  # N
    thrust_share: tuple[float, float]  # of the largest one at that airspeed
    cables: BowedCables

    @classmethod
    def of(
        cls, aircraft: Aircraft, needs: FlightNeeds, cable_forces: NDArray, attachments: NDArray
    ) -> "FlightRanges":
        """Those of needs (k, n), with the cables' forces (k, n, 3), N, and attachments (n, 3)."""
        lift, airspeed, thrust = needs.lift, needs.airspeed, needs.thrust
        tensions = np.linalg.norm(cable_forces, axis=-1)
        return cls(
            lift_share=_range(lift / aircraft.max_lift),
            airspeed=_range(airspeed),
            over_stall=_range(airspeed / stall_speed(aircraft)),
            over_loaded_stall=_range(airspeed_over_loaded_stall(aircraft, airspeed, lift, thrust)),
            bank=_range(needs.bank),
            climb=_range(needs.climb),
            thrust=_range(thrust),
            thrust_share=_range(thrust_share(aircraft, thrust, airspeed)),
            cables=BowedCables.of(aircraft, airspeed, tensions, attachments),
        )

    @property
    def lines(self) -> list[tuple[str, str]]:
        """A name and a text for each line of a table."""
        degrees = [math.degrees(angle) for angle in self.bank]
        (least, most), (share, most_share) = self.thrust, self.thrust_share
        return [
            (
                "airspeed",
                f"{self.airspeed[0]:.1f} to {self.airspeed[1]:.1f} m/s, at least "
                f"{self.over_stall[0]:.2f} of the stall speed, and "
                f"{self.over_loaded_stall[0]:.2f} of that with cable and bank",
            ),
            (
                "thrust",
                f"{least:.1f} to {most:.1f} N, {100 * share:.0f} to {100 * most_share:.0f} % of "
                "the largest",
            ),
            ("bank", f"{degrees[0]:.1f} to {degrees[1]:.1f} deg"),
            ("real cables", self.cables.text),
        ]

    @property
    def dictionary(self) -> dict[str, Any]:
        """The same for a JSON file."""
        return {
            "lift_share": list(self.lift_share),
            "airspeed_m_s": list(self.airspeed),
            "airspeed_over_stall": list(self.over_stall),
            "airspeed_over_loaded_stall": list(self.over_loaded_stall),
            "bank_rad": list(self.bank),
            "climb_rad": list(self.climb),
            "thrust_N": list(self.thrust),
            "thrust_share": list(self.thrust_share),
            "cables": self.cables.dictionary,
        }
