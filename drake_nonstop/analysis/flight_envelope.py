"""Limits of flights beside what they hold for, and the ranges of what aircraft need."""

import dataclasses
import math
from collections.abc import Iterator
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.blocks.fixed_wing_controller import FixedWingControllerConfig
from drake_nonstop.blocks.lumped_cables import material_of
from drake_nonstop.mechanics.aircraft import (
    Aircraft,
    FlightNeeds,
    stall_speed,
    thrust_limits,
)
from drake_nonstop.mechanics.bowed_orbit import BowedMotion
from drake_nonstop.model.system import Model
from drake_nonstop.planning.limits import LIMITS
from drake_nonstop.planning.margins import LimitAlong
from drake_nonstop.scenario.run_limits import RunLimits
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.validation import finite

_LEAST_TENSION = 1e-3  # N, of a cable that is all but slack
_SHARE_OF_WIDTH = 0.01  # by which two cables may differ in length
ROWS = {limit.name: limit for limit in LIMITS}
_AIRSPEED = dataclasses.replace(ROWS["lift"], words="airspeed / stall speed", is_least=True)
_MOST_THRUST = dataclasses.replace(ROWS["thrust"], words="thrust", unit="N")
_LEAST_THRUST = dataclasses.replace(_MOST_THRUST, is_least=True)


class BowedCables(NamedTuple):
    """How drag bows the cables of aircraft, or would if they were not flown as straight.

    Where the references know of it the figures are those of their cables. Elsewhere they are those
    of a still load: the air moves past a cable as fast as its aircraft at its upper end, and not at
    the lower one. So the drag on its length, w_d = ½ ρ C_D d V² at the upper end, grows with the
    square of the place: of a tension T and a length L the cable bows farthest by w_d L²/(16 ∛4 T),
    at 0.63 of L, and its chord is shorter by 9/14 L (w_d L/(12 T))². Own derivation, for small
    bows.
    """

    bow: float  # m, the largest
    shortening: tuple[float, float]  # m, of a chord, the least and the largest
    difference: float  # m, of the shortenings of two cables at one instant, the largest
    mass: float  # kg, of the heaviest cable
    load_width: float  # m, the largest distance of two attachments
    chord: tuple[float, float]  # m, from end to end
    tension: tuple[float, float]  # N, at the load
    carrier_tension: tuple[float, float]  # N
    breaking_load: float  # N, of the cable that breaks first
    safety: float  # that over its largest tension
    are_flown: bool  # whether references count it

    @classmethod
    def of(
        cls,
        model: Model,
        airspeeds: NDArray,
        cable_forces: NDArray,
        bowed: BowedMotion | None = None,
    ) -> "BowedCables":
        """Returns those of n aircraft at airspeeds (k, n), m/s, with cable forces (k, n, 3), N.

        The forces are those on the load. `bowed` is the motion of references that know of the bow.
        """
        taut = np.maximum(np.linalg.norm(cable_forces, axis=-1), _LEAST_TENSION)
        length, pulls = model.cable_length + model.cable_compliance * taut, taut
        if bowed is None:
            cable = material_of(model)
            drag = np.ravel(cable.air_density / 2 * cable.drag * cable.diameter) * airspeeds**2
            sag = drag * model.cable_length / taut
            bow = float(np.max(sag * model.cable_length)) / (16 * 4 ** (1 / 3))
            shorter = 9 / 14 * model.cable_length * (sag / 12) ** 2
        else:
            bow = float(np.max(bowed.bows))
            shorter = length - np.linalg.norm(bowed.chords, axis=-1)
            pulls = np.linalg.norm(bowed.motion.forces, axis=-1)
        breaking = np.broadcast_to(model.cable_breaking_load, len(model.attachments))
        safeties = breaking / np.maximum(taut, pulls).max(axis=0)
        first = int(np.argmin(safeties))
        apart = (float(np.linalg.norm(a - b)) for a, b in combinations(model.attachments, 2))
        return cls(
            bow=bow,
            shortening=_range(shorter),
            difference=float(np.max(np.ptp(shorter, axis=1))),
            mass=float(np.max(model.cable_mass)),
            load_width=max(apart),
            chord=_range(length - shorter),
            tension=_range(taut),
            carrier_tension=_range(pulls),
            breaking_load=float(breaking[first]),
            safety=float(safeties[first]),
            are_flown=bowed is not None,
        )

    @property
    def name(self) -> str:
        """Name of its line in a table."""
        return "cables" if self.are_flown else "real cables"

    @property
    def text(self) -> str:
        """Its numbers in a line."""
        (least, most), (low, high) = self.shortening, self.tension
        said = (
            f"bow by up to {self.bow:.2g} m and are {least:.2g} to {most:.2g} m shorter, "
            f"by up to {self.difference:.2g} m more than others; {self.mass:.2g} kg each"
        )
        if self.are_flown:
            below, above = self.carrier_tension
            said += (
                f"; chords of {self.chord[0]:.2f} to {self.chord[1]:.2f} m, {low:.3g} to "
                f"{high:.3g} N at the load and {below:.3g} to {above:.3g} N at the carriers"
            )
        if math.isfinite(self.safety):
            said += f"; they break at {self.safety:.2g} times the largest tension"
        return said

    @property
    def warning(self) -> str:
        """A sentence on what to expect of a real flight; "" where it is counted, or little."""
        allowed = _SHARE_OF_WIDTH * self.load_width
        if self.are_flown or self.difference <= allowed:
            return ""
        return (
            f"cables are simulated as straight: drag would shorten one by up to "
            f"{self.difference:.2g} m more than another, above a hundredth of the load's width "
            f"({allowed:.2g} m), which turns and moves the load; give thinner cables "
            "(cable_diameter), more tension, or carrier_trajectory=BowedCarrierTrajectory with "
            "cables=LumpedCables; a real flight would differ"
        )

    @property
    def dictionary(self) -> dict[str, Any]:
        """The same for a JSON file."""
        return {
            "bow_m": self.bow,
            "shortening_m": list(self.shortening),
            "shortening_difference_m": self.difference,
            "chord_m": list(self.chord),
            "tension_N": list(self.tension),
            "carrier_tension_N": list(self.carrier_tension),
            "breaking_load_N": finite(self.breaking_load),
            "are_flown": self.are_flown,
            "mass_kg": self.mass,
            "load_width_m": self.load_width,
            "warning": self.warning,
        }


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


def flight_envelope_of(scenario: Scenario) -> FlightEnvelope:
    """That of the scenario's controller, as far as it has any limits, and of its runs."""
    controller, default = scenario.carrier_controller, FlightEnvelope()
    return default._replace(
        lift_share=getattr(controller, "lift_share", default.lift_share),
        speed_share=getattr(controller, "speed_share", default.speed_share),
        bank=getattr(controller, "max_bank", default.bank),
        carrier_distance=scenario.limits.carrier_distance,
        cable_distance=scenario.limits.cable_distance,
    )


def limits_along(
    aircraft: Aircraft, needs: FlightNeeds, limits: FlightEnvelope, times: NDArray
) -> Iterator[LimitAlong]:
    """Needs of each aircraft, (k, n) each, beside its limits; at `times` (k,) of `LimitAlong`."""
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
