"""Whether the aircraft of a scenario can fly the orbit above its resting load, and how well."""

import dataclasses
import math
import typing
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context, Diagram

from drake_nonstop.analysis.flight_envelope import (
    ROWS,
    BowedCables,
    FlightEnvelope,
    flight_envelope_of,
    limits_along,
)
from drake_nonstop.analysis.resting_carriers import resting_carriers
from drake_nonstop.analysis.task import task_at
from drake_nonstop.diagrams.nonstop import make_nonstop, replaced
from drake_nonstop.mechanics.aircraft import (
    Aircraft,
    FlightNeeds,
    drawn_power,
    stall_speed,
    thrust_limits,
    thrust_power,
)
from drake_nonstop.mechanics.bowed_orbit import BowedMotion, CableShape
from drake_nonstop.mechanics.distances import segment_distances
from drake_nonstop.mechanics.rigid_load import STILL_AIR
from drake_nonstop.mechanics.signals import LoadReference, Parameters, constant_plan
from drake_nonstop.model.system import Model
from drake_nonstop.planning.margins import FlightRanges, LimitAlong, Margin
from drake_nonstop.scenario.schema import Scenario, check
from drake_nonstop.validation import require

_INSTANTS = 720  # of a turn
_MOST_TURNS = 10  # until an internal force and a load that turns are back where they were
_REFINEMENTS, _PARTS = 3, 4  # of the interval about each extreme
_WIND_TRIALS = 10  # halvings of the range of the largest wind

_CARRIERS_APART = ROWS["separation"]
_CABLES_APART = dataclasses.replace(_CARRIERS_APART, words="cables apart")
_ENVELOPE = FlightEnvelope()


@dataclass(frozen=True, kw_only=True, eq=False)
class AircraftMargins:
    """Margins of a scenario's n aircraft on its resting orbit.

    Attributes:
        scenario: its name.
        margins: of each quantity that has a limit.
        turn: s, after which the orbit repeats.
        phases: (k,) rad, ξ t over that time; the angle of a load that turns, where no internal
            force swings.
        needs: (k, n) each, at these phases.
        thrust_limits: the least and the largest thrust at their airspeeds (k, n), N.
        ranges: of these.
        cables: how drag bows them.
        limits: what they are held against.
        carrier_distance: (k,) m, of the closest two there.
        cable_distance: (k,) m, of the closest two there.
        max_lift: C_Lmax.
        stall_speed: m/s, without a cable's force.
        propulsive_power: W, the mean of T V of one aircraft, none where it windmills.
        drawn_power: W, the mean of what one aircraft draws from its battery.
        wind: in which they fly.
        possible_wind: the share of it up to which all limits are kept, where it is the wind that is
            too much; None elsewhere.
    """

    scenario: str
    margins: tuple[Margin, ...]
    turn: float
    phases: NDArray
    needs: FlightNeeds
    thrust_limits: tuple[NDArray, NDArray]
    ranges: FlightRanges
    cables: BowedCables
    limits: FlightEnvelope
    carrier_distance: NDArray
    cable_distance: NDArray
    max_lift: float
    stall_speed: float
    propulsive_power: float
    drawn_power: float
    wind: NDArray
    possible_wind: float | None = None

    @property
    def missed(self) -> tuple[Margin, ...]:
        """The margins of the limits that are not kept."""
        return tuple(margin for margin in self.margins if not margin.is_kept)

    @property
    def is_flyable(self) -> bool:
        """Whether all limits are kept."""
        return not self.missed

    @property
    def verdict(self) -> str:
        """Whether the aircraft can fly the orbit; if not, what is missed, and what to change."""
        if self.is_flyable:
            return "the aircraft can fly the resting orbit within all limits"
        missed = ", ".join(margin.sentence for margin in self.missed)
        if self.possible_wind is None:
            return (
                "system.aircraft: they cannot fly the resting orbit within their limits: "
                f"{missed}; give another pattern, frequency, amplitude or cable_length, or other "
                "aircraft"
            )
        possible = np.trunc(100 * self.possible_wind * self.wind) / 100 + 0.0
        return (
            f"wind.velocity = {self.wind.tolist()}: the aircraft cannot fly the resting "
            f"orbit in it within their limits: {missed}; give at most {possible.tolist()}"
        )


def aircraft_margins(scenario: Scenario, **replacements: Any) -> AircraftMargins:
    """The needs of a scenario's aircraft on the exact orbit above its resting load.

    The orbit has the initial ξ and A. The load has its first pose, and turns about the vertical at
    its first rate, if at all. There are steady wind, no gusts and no disturbances. The orbit is
    that of the controllers' model; aircraft and load are those of the simulated plant.

    Args:
        scenario: its `system` has aircraft.
        replacements: blocks in place of the scenario's, as of `make_nonstop`.

    Raises:
        ScenarioError: the scenario cannot be built, has no aircraft, or its load turns about a
            horizontal axis at the start.
    """
    check(scenario)
    scenario, replacements = replaced(scenario, replacements)
    scenario = scenario.sampled()
    nonstop = make_nonstop(scenario, at_equilibrium=False, **replacements)
    return aircraft_margins_for(scenario, nonstop, nonstop.CreateDefaultContext())


def margins_table(found: AircraftMargins) -> str:
    """A line for each quantity that has a limit, and others, for a terminal."""
    rows = [("quantity", "value", "limit", "margin", "where")]
    for margin in found.margins:
        sign = ">=" if margin.is_least else "<="
        value, limit, left = map(margin.shown, (margin.value, margin.limit, margin.margin))
        is_missed = "" if margin.is_kept else " !"
        rows.append((margin.name, value, f"{sign} {limit}", f"{left}{is_missed}", margin.place))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
    told = [*found.ranges.lines, (found.cables.name, found.cables.text)]
    lines += [f"{name:{widths[0]}}  {text}" for name, text in told]
    power = f"{found.propulsive_power:.0f} W of thrust, {found.drawn_power:.0f} W drawn"
    lines.append(f"{'mean power of each':{widths[0]}}  {power}")
    lines.append(f"{'a turn':{widths[0]}}  {found.turn:.2f} s")
    said = f"{found.wind.tolist()} m/s, without gusts"
    lines.append(f"{'wind':{widths[0]}}  {said}")
    return "\n".join(lines)


def margins_dictionary(found: AircraftMargins) -> dict[str, Any]:
    """The same for a JSON file; keys end in their units, angles are in rad."""
    return {
        "scenario": found.scenario,
        "is_flyable": found.is_flyable,
        "verdict": found.verdict,
        "turn_s": found.turn,
        "wind_m_s": found.wind.tolist(),
        "possible_share_of_wind": found.possible_wind,
        "margins": [margin.dictionary for margin in found.margins],
        "ranges": found.ranges.dictionary | {"cables": found.cables.dictionary},
        "stall_speed_m_s": found.stall_speed,
        "power_of_thrust_mean_W": found.propulsive_power,
        "power_drawn_mean_W": found.drawn_power,
    }


def aircraft_margins_for(
    scenario: Scenario,
    nonstop: Diagram,
    context: Context,
) -> AircraftMargins:
    """Returns the `aircraft_margins` of a loop that has been built.

    Args:
        scenario: what the loop was made from, with its numbers drawn.
        nonstop: the loop, which exports `reference` and `parameters`.
        context: of the loop, at its start.
    """
    task = task_at(scenario, nonstop, context)
    return margins_at_rest(
        task.flown,
        task.reference(0.0),
        np.array([task.limits.frequency, task.limits.amplitude]),
        believed=task.carried,
        wind=task.air.mean,
        limits=flight_envelope_of(scenario),
        shape=task.references.shape,
        name=scenario.name,
    )


def margins_at_rest(
    model: Model,
    reference: NDArray,
    parameters: NDArray,
    *,
    believed: Model | None = None,
    wind: NDArray = STILL_AIR,
    limits: FlightEnvelope = _ENVELOPE,
    shape: CableShape | None = None,
    name: str = "unnamed",
) -> AircraftMargins:
    """The margins on the orbit above a load that rests, or turns about the vertical.

    What each aircraft needs is evaluated at even phases of a turn, and at finer ones about each
    extreme.

    Args:
        model: of the simulated plant, with aircraft.
        reference: (22,) of the load, of which pose and angular velocity count.
        parameters: [ξ (rad/s), A (N)] (2,).
        believed: what the controllers believe in place of it, whose orbit is flown; None: the same.
        wind: the steady wind (3,), m/s, in W.
        limits: what they are held against.
        shape: of the cables of references that know of their bow; None: straight ones.
        name: of the scenario.

    Raises:
        ScenarioError: there are no aircraft, or the load turns about a horizontal axis.
    """
    orbit = _Orbit(model, believed or model, reference, parameters, limits, shape)
    found = _margins(orbit, wind, name)
    if found.is_flyable or not np.any(wind):
        return found
    if not _margins(orbit, 0 * wind, name).is_flyable:
        return found
    low, high = 0.0, 1.0
    for _ in range(_WIND_TRIALS):
        middle = (low + high) / 2
        flies = _margins(orbit, middle * wind, name).is_flyable
        low, high = (middle, high) if flies else (low, middle)
    return dataclasses.replace(found, possible_wind=low)


class _Orbit:
    """The orbit above a resting load; arguments as of `margins_at_rest`."""

    def __init__(
        self,
        model: Model,
        believed: Model,
        reference: NDArray,
        parameters: NDArray,
        limits: FlightEnvelope,
        shape: CableShape | None,
    ):
        turning = LoadReference.view(reference).angular_velocity
        require(
            np.max(np.abs(turning[:2])) < 1e-9,
            "load_trajectory, angular velocity at t = 0 in rad/s",
            turning.tolist(),
            "give one that lets the load rest at first, or turns it about the vertical: there is "
            "no resting orbit",
        )
        remedy = "give one, such as --set system.aircraft.model=rascal_110"
        require(model.aircraft is not None, "system.aircraft", None, remedy)
        self.model, self.believed = model, believed
        self.aircraft = typing.cast(Aircraft, model.aircraft)
        self._reference, self._parameters, self._shape = reference, parameters, shape
        self._yaw_rate = float(turning[2])
        (frequency,), (amplitude,) = Parameters.view(parameters)
        rates = [abs(self._yaw_rate)] if self._yaw_rate else []
        if np.any(amplitude * model.pattern.basis) or not rates:
            rates.insert(0, abs(float(frequency)))
        self.rate = rates[0] or 1.0  # rad/s, of the phase; nothing moves where it is zero
        self.turns = Fraction(rates[-1] / self.rate).limit_denominator(_MOST_TURNS).denominator
        self.limits = limits

    def at(
        self, times: NDArray, wind: NDArray
    ) -> tuple[FlightNeeds, list[LimitAlong], NDArray, BowedMotion | None]:
        """Needs at times (k,), s, all that has limits, forces on the load, N, and the bow."""
        model = self.model
        frequency, amplitude = self._parameters
        carriers = resting_carriers(
            self.believed,
            model,
            self._reference,
            times,
            yaw_rate=self._yaw_rate,
            load_wind=wind,
            shape=self._shape,
        )
        planned = constant_plan(frequency * times, frequency, amplitude)
        motion = carriers.motion(planned)
        bowed = carriers.bowed(planned, motion)
        needs = carriers.needs(motion, bowed)
        places = (motion if bowed is None else bowed.motion).positions
        ends = carriers.terms.motion.attached(self.believed.attachments).rates[0]
        of_each = limits_along(self.aircraft, needs, self.limits, times)
        return needs, [*of_each, *self._of_pairs(places, ends, times)], motion.forces, bowed

    def _of_pairs(self, places: NDArray, ends: NDArray, times: NDArray) -> Iterator[LimitAlong]:
        """The distances of carriers at `places` (k, n, 3), m, and of their cables from `ends`."""
        model, own = self.model, self.model.attachments
        reach = np.linalg.norm(own, axis=1).max() + np.max(model.cable_length)
        first, second = np.triu_indices(model.n, 1)
        apart = np.linalg.norm(own[first] - own[second], axis=1)
        one, other = places[:, first], places[:, second]
        carriers = np.linalg.norm(one - other, axis=-1)
        cables = segment_distances(ends[:, first], one, ends[:, second], other)
        for row, distances, limits in (
            (_CARRIERS_APART, carriers, self.limits.carrier_distance * reach),
            (_CABLES_APART, cables, self.limits.cable_distance * apart),
        ):
            yield LimitAlong(row, limits, times, distances)


def _margins(orbit: _Orbit, wind: NDArray, name: str) -> AircraftMargins:
    """The margins in a wind, whatever they are."""
    turn = 2 * math.pi * orbit.turns / orbit.rate
    times = np.linspace(0, turn, _INSTANTS * orbit.turns, endpoint=False)
    needs, quantities, forces, bowed = orbit.at(times, wind)
    margins = [quantity.margin for quantity in quantities]
    *_, carriers, cables = (quantity.values.min(axis=1) for quantity in quantities)
    step = times[1]
    for _ in range(_REFINEMENTS):
        step /= _PARTS
        around = step * np.arange(1 - _PARTS, _PARTS)
        near = np.unique([margin.when + around for margin in margins])
        _, quantities, *_ = orbit.at(near, wind)
        found = [quantity.margin for quantity in quantities]
        margins = [min(pair, key=lambda m: m.margin) for pair in zip(margins, found, strict=True)]
    aircraft = orbit.aircraft
    return AircraftMargins(
        scenario=name,
        margins=tuple(margin._replace(when=margin.when % turn) for margin in margins),
        turn=turn,
        phases=orbit.rate * times,
        needs=needs,
        thrust_limits=thrust_limits(aircraft, needs.airspeed),
        ranges=FlightRanges.of(aircraft, needs),
        cables=BowedCables.of(orbit.model, needs.airspeed, forces, bowed),
        limits=orbit.limits,
        carrier_distance=carriers,
        cable_distance=cables,
        max_lift=float(aircraft.max_lift),
        stall_speed=float(stall_speed(aircraft)),
        propulsive_power=float(np.mean(thrust_power(needs.thrust, needs.airspeed))),
        drawn_power=float(np.mean(drawn_power(aircraft, needs.thrust, needs.airspeed))),
        wind=wind,
    )
