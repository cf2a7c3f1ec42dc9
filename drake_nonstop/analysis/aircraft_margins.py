"""Whether the aircraft of a scenario can fly the orbit above its resting load, and how well."""

import dataclasses
import math
import typing
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context, Diagram

from drake_nonstop.analysis.bowed_cables import BowedCables
from drake_nonstop.analysis.separations import segment_distances
from drake_nonstop.blocks.carrier_trajectory import MeasuredCarrierTrajectoryConfig
from drake_nonstop.blocks.fixed_wing_controller import FixedWingControllerConfig
from drake_nonstop.diagrams.nonstop import make_nonstop, replaced
from drake_nonstop.mechanics.aircraft import (
    Aircraft,
    FlightNeeds,
    airspeed_over_loaded_stall,
    drawn_power,
    flight_needs,
    needed_force,
    stall_speed,
    thrust_limits,
    thrust_power,
    thrust_share,
)
from drake_nonstop.mechanics.cable import forces_under_other_wrench, wrenches_of
from drake_nonstop.mechanics.planned_orbit import CarrierOrbits, resting_orbits
from drake_nonstop.mechanics.rigid_load import RigidLoad
from drake_nonstop.mechanics.signals import LoadReference, Parameters, Pose
from drake_nonstop.mechanics.wind import MeanWind
from drake_nonstop.model.system import Model, overridden
from drake_nonstop.scenario.run_limits import RunLimits
from drake_nonstop.scenario.schema import Scenario, check
from drake_nonstop.validation import require

_INSTANTS = 720  # of a turn
_MOST_TURNS = 10  # until an internal force and a load that turns are back where they were
_REFINEMENTS, _PARTS = 3, 4  # of the interval about each extreme
_WIND_TRIALS = 10  # halvings of the range of the largest wind


class FlightLimits(NamedTuple):
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


_STILL_AIR = MeanWind(np.zeros(3))
_LIMITS = FlightLimits()


def aircraft_needs(aircraft: Aircraft, motion: CarrierOrbits, wind: NDArray) -> FlightNeeds:
    """What aircraft need to move so, by the exact inverse of their dynamics.

    Args:
        aircraft: their parameters.
        motion: of carriers and cables, on any paths.
        wind: at the carriers (k, n, 3), m/s, in W.
    """
    force = needed_force(aircraft, motion.accelerations, motion.cable_forces)
    return flight_needs(aircraft, force, motion.velocities - wind)


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


@dataclass(frozen=True, kw_only=True)
class FlightMargin:
    """One quantity where it is closest to its limit, or farthest beyond.

    Attributes:
        name: of the quantity.
        unit: of `value` and `limit`; "" for a share.
        value: of the quantity.
        limit: of the quantity there.
        is_upper: whether the limit is the largest value; if not, it is the least.
        phase: rad, where on the orbit, see `AircraftMargins.phases`.
        carriers: which one, or which two, from 1 on.
    """

    name: str
    unit: str
    value: float
    limit: float
    is_upper: bool
    phase: float
    carriers: tuple[int, ...]

    @property
    def margin(self) -> float:
        """From the value to the limit; negative where it is beyond."""
        return self.limit - self.value if self.is_upper else self.value - self.limit

    @property
    def is_kept(self) -> bool:
        """Whether the value is within the limit."""
        return self.margin >= 0

    def shown(self, value: float) -> str:
        """A value of the quantity with its unit, for a sentence or a table."""
        if self.unit == "rad":
            return f"{math.degrees(value):.1f} deg"
        return f"{value:.{1 if self.unit else 2}f} {self.unit}".rstrip()

    @property
    def dictionary(self) -> dict[str, Any]:
        """All of it for a JSON file."""
        return {
            "name": self.name,
            "unit": self.unit,
            "value": self.value,
            "limit": self.limit,
            "limit_is": "upper" if self.is_upper else "lower",
            "margin": self.margin,
            "phase_rad": self.phase,
            "carriers": list(self.carriers),
        }

    @property
    def sentence(self) -> str:
        """The value beside its limit."""
        bound = "at most" if self.is_upper else "at least"
        return f"{self.name} {self.shown(self.value)} ({bound} {self.shown(self.limit)})"


@dataclass(frozen=True, kw_only=True, eq=False)
class AircraftMargins:
    """What the resting orbit of a scenario asks of its n aircraft, and what they have left.

    Attributes:
        scenario: its name.
        margins: of each quantity that has a limit.
        turn: s, after which the orbit repeats.
        phases: (k,) rad, ξ t over that time; the angle of a load that turns, where no internal
            force swings.
        needs: (k, n) each, at these phases.
        thrust_limits: the least and the largest thrust at their airspeeds (k, n), N.
        ranges: of these, and what straight cables leave out.
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
    margins: tuple[FlightMargin, ...]
    turn: float
    phases: NDArray
    needs: FlightNeeds
    thrust_limits: tuple[NDArray, NDArray]
    ranges: FlightRanges
    limits: FlightLimits
    carrier_distance: NDArray
    cable_distance: NDArray
    max_lift: float
    stall_speed: float
    propulsive_power: float
    drawn_power: float
    wind: MeanWind
    possible_wind: float | None = None

    @property
    def missed(self) -> tuple[FlightMargin, ...]:
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
        possible = np.trunc(100 * self.possible_wind * self.wind.velocity) / 100 + 0.0
        return (
            f"wind.velocity = {self.wind.velocity.tolist()}: the aircraft cannot fly the resting "
            f"orbit in it within their limits: {missed}; give at most {possible.tolist()}"
        )


def aircraft_margins(scenario: Scenario, **replacements: Any) -> AircraftMargins:
    """What the aircraft of a scenario need on the exact orbit above its resting load.

    The orbit is that of the start: of the first ξ and A, above the load in its first pose, which
    turns about the vertical at its first rate and rests otherwise, in the steady wind, without
    gusts and disturbances. The carriers fly the orbit of the load that the controllers believe in;
    the aircraft and the load that they hold are those of the simulated plant.

    Args:
        scenario: with aircraft in its `system`.
        replacements: blocks in place of the scenario's, as of `make_nonstop`.

    Raises:
        ScenarioError: the scenario cannot be built, has no aircraft, or its load turns about a
            horizontal axis at the start.
    """
    check(scenario)
    scenario, replacements = replaced(scenario, replacements)
    scenario = scenario.sampled()
    _simulated(scenario)  # without aircraft there is nothing to build
    nonstop = make_nonstop(scenario, at_equilibrium=False, **replacements)
    return margins_of_loop(scenario, nonstop, nonstop.CreateDefaultContext())


def margins_table(found: AircraftMargins) -> str:
    """A line for each quantity that has a limit, and others, for a terminal."""
    rows = [("quantity", "value", "limit", "margin", "phase", "carrier")]
    for margin in found.margins:
        sign = "<=" if margin.is_upper else ">="
        rows.append(
            (
                margin.name,
                margin.shown(margin.value),
                f"{sign} {margin.shown(margin.limit)}",
                margin.shown(margin.margin) + ("" if margin.is_kept else " !"),
                f"{math.degrees(margin.phase):.1f} deg",
                " and ".join(map(str, margin.carriers)),
            )
        )
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
    lines += [f"{name:{widths[0]}}  {text}" for name, text in found.ranges.lines]
    power = f"{found.propulsive_power:.0f} W of thrust, {found.drawn_power:.0f} W drawn"
    lines.append(f"{'mean power of each':{widths[0]}}  {power}")
    lines.append(f"{'a turn':{widths[0]}}  {found.turn:.2f} s")
    said = f"{found.wind.velocity.tolist()} m/s, without gusts"
    lines.append(f"{'wind':{widths[0]}}  {said}")
    return "\n".join(lines)


def margins_dictionary(found: AircraftMargins) -> dict[str, Any]:
    """The same for a JSON file; keys end in their units, angles are in rad."""
    return {
        "scenario": found.scenario,
        "is_flyable": found.is_flyable,
        "verdict": found.verdict,
        "turn_s": found.turn,
        "wind_m_s": found.wind.velocity.tolist(),
        "possible_share_of_wind": found.possible_wind,
        "margins": [margin.dictionary for margin in found.margins],
        "ranges": found.ranges.dictionary,
        "stall_speed_m_s": found.stall_speed,
        "power_of_thrust_mean_W": found.propulsive_power,
        "power_drawn_mean_W": found.drawn_power,
    }


def margins_of_loop(scenario: Scenario, nonstop: Diagram, context: Context) -> AircraftMargins:
    """As `aircraft_margins`, of a loop that has been built.

    Args:
        scenario: what the loop was made from, with its numbers drawn.
        nonstop: the loop, which exports `reference` and `parameters`.
        context: of the loop, at its start.
    """
    reference, parameters = (
        nonstop.GetOutputPort(name).Eval(context) for name in ("reference", "parameters")
    )
    simulated = _simulated(scenario)
    return margins_at_rest(
        simulated,
        reference,
        parameters,
        believed=_believed(scenario, simulated),
        wind=_mean_wind(scenario, nonstop, context),
        limits=flight_limits_of(scenario),
        name=scenario.name,
    )


def _simulated(scenario: Scenario) -> Model:
    """The model of the simulated plant; raises ScenarioError if it has no aircraft."""
    given = [name for name, value in vars(scenario.simulated).items() if value is not None]
    model = Model(
        overridden(scenario.system, scenario.simulated),
        scenario.pattern,
        scenario.control_period,
        field="simulated" if given else "system",
        overridden=given,
    )
    _aircraft_of(model)
    return model


def _believed(scenario: Scenario, simulated: Model) -> Model:
    """What the carriers' orbits follow from: the controllers' model.

    References above the measured load come to follow the simulated one, whose height is fed back.
    """
    if isinstance(scenario.carrier_trajectory, MeasuredCarrierTrajectoryConfig):
        return simulated
    if not simulated.overridden:
        return simulated
    return Model(scenario.system, scenario.pattern, scenario.control_period)


def asked_load(believed: Model, simulated: Model) -> RigidLoad:
    """The load that the carriers' orbits are for.

    Above its desired position it is the believed one: a lighter load rises by what the cables
    stretch less, which is too little for a controller to notice. To the side the cables hardly hold
    it, and the controller comes to ask for what its drag needs.
    """
    return dataclasses.replace(believed.load, drag=simulated.load.drag)


def _aircraft_of(model: Model) -> Aircraft:
    remedy = "give one, such as --set system.aircraft.model=rascal_110"
    require(model.aircraft is not None, "system.aircraft", None, remedy)
    return typing.cast(Aircraft, model.aircraft)


def flight_limits_of(scenario: Scenario) -> FlightLimits:
    """Those of the scenario's controller, as far as it has any, and of its runs."""
    controller, default = scenario.carrier_controller, FlightLimits()
    return default._replace(
        lift_share=getattr(controller, "lift_share", default.lift_share),
        speed_share=getattr(controller, "speed_share", default.speed_share),
        bank=getattr(controller, "max_bank", default.bank),
        carrier_distance=scenario.limits.carrier_distance,
        cable_distance=scenario.limits.cable_distance,
        saturated_share=scenario.limits.saturated_share,
    )


def _mean_wind(scenario: Scenario, nonstop: Diagram, context: Context) -> MeanWind:
    """That of the scenario's wind; where a block does not state one, the wind of the start."""
    config = scenario.wind
    velocity = getattr(config, "velocity", None)
    if velocity is None:
        velocity = nonstop.GetOutputPort("load_wind").Eval(context)
    return MeanWind.of(config, velocity)


def margins_at_rest(
    model: Model,
    reference: NDArray,
    parameters: NDArray,
    *,
    believed: Model | None = None,
    wind: MeanWind = _STILL_AIR,
    limits: FlightLimits = _LIMITS,
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
        wind: the steady wind.
        limits: what they are held against.
        name: of the scenario.

    Raises:
        ScenarioError: there are no aircraft, or the load turns about a horizontal axis.
    """
    orbit = _Orbit(model, believed or model, reference, parameters, limits)
    found = _margins(orbit, wind, name)
    if found.is_flyable or not np.any(wind.velocity):
        return found
    if not _margins(orbit, wind.times(0.0), name).is_flyable:
        return found
    low, high = 0.0, 1.0
    for _ in range(_WIND_TRIALS):
        middle = (low + high) / 2
        flies = _margins(orbit, wind.times(middle), name).is_flyable
        low, high = (middle, high) if flies else (low, middle)
    return dataclasses.replace(found, possible_wind=low)


class Quantity(NamedTuple):
    """One that has a limit, at k instants, of carriers or of pairs of them."""

    name: str
    unit: str
    values: NDArray  # (k, c)
    limits: NDArray | float  # broadcasts to the values
    is_upper: bool
    carriers: Sequence[tuple[int, ...]]  # c

    @property
    def left(self) -> NDArray:
        """From the values to the limits (k, c); negative beyond them."""
        return self.limits - self.values if self.is_upper else self.values - self.limits

    def worst(self, phases: NDArray) -> FlightMargin:
        """Its least margin at the phases (k,), rad."""
        limits = np.broadcast_to(self.limits, self.values.shape)
        instant, column = self.worst_place
        return FlightMargin(
            name=self.name,
            unit=self.unit,
            value=float(self.values[instant, column]),
            limit=float(limits[instant, column]),
            is_upper=self.is_upper,
            phase=float(phases[instant]),
            carriers=self.carriers[column],
        )

    @property
    def worst_place(self) -> tuple[int, int]:
        """The instant and the column of its least margin; of equal ones the first."""
        instant, column = np.unravel_index(np.argmin(self.left.round(9)), self.values.shape)
        return int(instant), int(column)


def quantities_of_each(
    aircraft: Aircraft, needs: FlightNeeds, limits: FlightLimits
) -> Iterator[Quantity]:
    """What each carrier needs, beside its limit."""
    carriers = [(i + 1,) for i in range(needs.lift.shape[1])]
    lift, airspeed = needs.lift / aircraft.max_lift, needs.airspeed / stall_speed(aircraft)
    least, most = thrust_limits(aircraft, needs.airspeed)
    for name, unit, values, limit, is_upper in (
        ("C_L / C_Lmax", "", lift, limits.lift_share, True),
        ("airspeed / stall speed", "", airspeed, limits.speed_share, False),
        ("bank", "rad", np.abs(needs.bank), limits.bank, True),
        ("climb or descent", "rad", np.abs(needs.climb), limits.climb, True),
        ("thrust", "N", needs.thrust, most, True),
        ("thrust", "N", needs.thrust, least, False),
    ):
        yield Quantity(name, unit, values, limit, is_upper, carriers)


class _Orbit:
    """The orbit above a resting load; arguments as of `margins_at_rest`."""

    def __init__(
        self,
        model: Model,
        believed: Model,
        reference: NDArray,
        parameters: NDArray,
        limits: FlightLimits,
    ):
        turning = LoadReference.view(reference).angular_velocity
        require(
            np.max(np.abs(turning[:2])) < 1e-9,
            "load_trajectory, angular velocity at t = 0 in rad/s",
            turning.tolist(),
            "give one that lets the load rest at first, or turns it about the vertical: there is "
            "no resting orbit",
        )
        self.model, self.believed, self.aircraft = model, believed, _aircraft_of(model)
        self._reference, self._parameters = reference, parameters
        self._yaw_rate = float(turning[2])
        (frequency,), (amplitude,) = Parameters.view(parameters)
        rates = [abs(self._yaw_rate)] if self._yaw_rate else []
        if np.any(amplitude * model.pattern.basis) or not rates:
            rates.insert(0, abs(float(frequency)))
        self.rate = rates[0] or 1.0  # rad/s, of the phase; nothing moves where it is zero
        self.turns = Fraction(rates[-1] / self.rate).limit_denominator(_MOST_TURNS).denominator
        self.limits = limits
        self._pairs = list(combinations(range(model.n), 2))

    def at(
        self, phases: NDArray, wind: MeanWind
    ) -> tuple[FlightNeeds, list[Quantity], FlightRanges]:
        """What the aircraft need at phases (k,), rad, all quantities that have limits, ranges."""
        motion = self._motion(phases, wind)
        needs = aircraft_needs(self.aircraft, motion, wind.at(motion.positions))
        of_each = quantities_of_each(self.aircraft, needs, self.limits)
        ranges = FlightRanges.of(self.aircraft, needs, motion.cable_forces, self.model.attachments)
        return needs, [*of_each, *self._of_pairs(motion)], ranges

    def _motion(self, phases: NDArray, wind: MeanWind) -> CarrierOrbits:
        """Of the carriers as the controllers lead them, and of the cables of the simulated load."""
        model, believed = self.model, self.believed
        if believed is model:
            return self._orbits(model, model.load, phases, wind)
        flown = self._orbits(believed, asked_load(believed, model), phases, wind)
        held = self._orbits(model, model.load, phases, wind)
        levers = held.cable_ends - Pose.view(self._reference).position
        forces = forces_under_other_wrench(
            flown.cable_forces,
            levers,
            wrenches_of(held.cable_forces, levers),
            rest_length=model.cable_length,
            stiffness=model.cable_stiffness,
        )
        return flown._replace(cable_forces=forces, cable_ends=held.cable_ends)

    def _orbits(
        self, model: Model, load: RigidLoad, phases: NDArray, wind: MeanWind
    ) -> CarrierOrbits:
        pattern = model.pattern
        return resting_orbits(
            load,
            self._reference,
            phases / self.rate,
            self._parameters,
            yaw_rate=self._yaw_rate,
            load_wind=wind.at(Pose.view(self._reference).position),
            attachments=model.attachments,
            pseudo_inverse=model.pseudo_inverse,
            basis=pattern.basis,
            phases=pattern.phases,
            orders=pattern.orders,
            offset=pattern.offset,
            rest_length=model.cable_length,
            compliance=model.cable_compliance,
        )

    def _of_pairs(self, motion: CarrierOrbits) -> Iterator[Quantity]:
        model = self.model
        reach = np.linalg.norm(model.attachments, axis=1).max() + model.cable_length
        apart = [
            np.linalg.norm(model.attachments[i] - model.attachments[j]) for i, j in self._pairs
        ]
        carriers, cables = [], []
        for i, j in self._pairs:
            ends, others = ((motion.cable_ends[:, k], motion.positions[:, k]) for k in (i, j))
            carriers.append(np.linalg.norm(ends[1] - others[1], axis=-1))
            cables.append(segment_distances(*ends, *others))
        pairs = [(i + 1, j + 1) for i, j in self._pairs]
        for name, distances, limits in (
            ("carriers apart", carriers, self.limits.carrier_distance * reach),
            ("cables apart", cables, self.limits.cable_distance * np.array(apart)),
        ):
            yield Quantity(name, "m", np.stack(distances, axis=1), limits, False, pairs)


def _margins(orbit: _Orbit, wind: MeanWind, name: str) -> AircraftMargins:
    """The margins in a wind, whatever they are."""
    count = _INSTANTS * orbit.turns
    phases = 2 * np.pi / _INSTANTS * np.arange(count)
    needs, quantities, ranges = orbit.at(phases, wind)
    margins = [quantity.worst(phases) for quantity in quantities]
    distances = {quantity.name: quantity.values.min(axis=1) for quantity in quantities}
    step = phases[1]
    for _ in range(_REFINEMENTS):
        step /= _PARTS
        around = step * np.arange(1 - _PARTS, _PARTS)
        near = np.unique([margin.phase + around for margin in margins])
        _, quantities, _ = orbit.at(near, wind)
        found = [quantity.worst(near) for quantity in quantities]
        margins = [min(pair, key=lambda m: m.margin) for pair in zip(margins, found, strict=True)]
    aircraft = orbit.aircraft
    return AircraftMargins(
        scenario=name,
        margins=tuple(
            dataclasses.replace(m, phase=m.phase % (2 * math.pi * orbit.turns)) for m in margins
        ),
        turn=2 * math.pi * orbit.turns / orbit.rate,
        phases=phases,
        needs=needs,
        thrust_limits=thrust_limits(aircraft, needs.airspeed),
        ranges=ranges,
        limits=orbit.limits,
        carrier_distance=distances["carriers apart"],
        cable_distance=distances["cables apart"],
        max_lift=float(aircraft.max_lift),
        stall_speed=float(stall_speed(aircraft)),
        propulsive_power=float(np.mean(thrust_power(needs.thrust, needs.airspeed))),
        drawn_power=float(np.mean(drawn_power(aircraft, needs.thrust, needs.airspeed))),
        wind=wind,
    )
