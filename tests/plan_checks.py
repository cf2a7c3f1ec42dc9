"""Problems over a horizon, and what their margins have to be, from the carriers' positions alone.

Velocities and accelerations are differences of p_L + R (b + (L₀/‖f‖ + 1/K_c) f), in which the
cables' forces f are those of the wrench that moves the load in the wind that is believed in.
"""

import functools
from typing import NamedTuple

import numpy as np
from helpers import difference, irregular, regular, rotation, spatial
from numpy.typing import NDArray
from pydrake.math import RollPitchYaw, RotationMatrix

from drake_nonstop.blocks.lumped_cables import material_of
from drake_nonstop.mechanics.aircraft import (
    flight_needs,
    needed_force,
    stall_factor,
    thrust_limits,
)
from drake_nonstop.mechanics.bowed_line import TimeWindow, bowed_lines
from drake_nonstop.mechanics.bowed_orbit import CableShape
from drake_nonstop.mechanics.rigid_load import STILL_AIR
from drake_nonstop.model.aircraft import AircraftParameters
from drake_nonstop.model.pattern import (
    EllipticCarouselConfig,
    HamiltonianCycleConfig,
    SpreadCarouselConfig,
)
from drake_nonstop.model.system import Model, SystemParameters
from drake_nonstop.planning.horizon_config import HorizonConfig
from drake_nonstop.planning.horizon_problem import HorizonProblem
from drake_nonstop.planning.problem_config import LimitsConfig

TIGHTENING = 0.02
WINDOW = TimeWindow.of(0.75, 9)
WIND = np.array([1.6, -0.7, 0.2])  # m/s
AT_REST = np.concatenate([[1.0], np.zeros(21)])
SMALL = HorizonConfig(intervals=10, knot_spacing=0.4, instants=10)
ELLIPSE = EllipticCarouselConfig(spread=1.0, radial=1.2, tangential=0.7, vertical=0.3)
PATTERNS = {
    "cycle-3": (regular(3), HamiltonianCycleConfig()),
    "cycle-4": (irregular(4), HamiltonianCycleConfig()),
    "cycle-5": (spatial(5), HamiltonianCycleConfig()),
    "ellipse-6": (regular(6), ELLIPSE),
    "spread-7": (regular(7), SpreadCarouselConfig(spread=1.5)),
    "cycle-8": (irregular(8), HamiltonianCycleConfig()),
}
LIMITS = {"max_speed": 2.0, "min_tension": 1.5, "max_tension": 6.0, "min_separation": 0.5}
NO_LIMITS = {"max_speed": 100.0, "min_tension": 1e-3, "max_tension": 1e3, "min_separation": 1e-3}
SHARES = {"max_lift_share": 0.9, "max_bank": 0.75, "max_climb": 0.5, "max_thrust_share": 0.95}
NO_SHARES = {"max_lift_share": 1.0, "max_bank": 1.5, "max_climb": 1.5, "max_thrust_share": 1.0}
BOUND_OF_AIRCRAFT = 12.0  # m/s


def points_problem(name: str, *, horizon=SMALL, system=None, **fields) -> HorizonProblem:
    """The problem of carriers that are no aircraft, with other fields of the system."""
    attachments, pattern = PATTERNS[name]
    parameters = SystemParameters(attachments=attachments.tolist(), **system or {})
    fields = {"speed_bound": 0.4, "amplitude": 0.8, "tightening": TIGHTENING} | fields
    return HorizonProblem(Model(parameters, pattern), LimitsConfig(**fields), horizon)


def aircraft_problem(fixed=4, is_bowed=False, lengths=150.0, **fields) -> HorizonProblem:
    """The problem of four aircraft, on straight or on bowed cables."""
    system = SystemParameters(
        load_mass=10.0,
        load_inertia=[[5.6, 0.2, 0.1], [0.2, 5.1, 0.0], [0.1, 0.0, 9.2]],
        load_drag=0.6,
        attachments=regular(4, 1.5).tolist(),
        cable_length=lengths,
        cable_stiffness=120.0,
        aircraft=AircraftParameters(model="rascal_110"),
    )
    sizes = {"spread": 6.75, "radial": 3.3, "tangential": 4.5, "vertical": 4.9}
    model = Model(system, EllipticCarouselConfig(phase_turns=2, **sizes))
    own = {"frequency": 0.595, "amplitude": 1.0, "amplitude_bounds": [0.6, 1.6]}
    own |= {"speed_bound": BOUND_OF_AIRCRAFT, "tightening": TIGHTENING}
    horizon = HorizonConfig(instants=10, fixed_coefficients=fixed)
    shape = CableShape(4, WINDOW, material_of(model)) if is_bowed else None
    return HorizonProblem(model, LimitsConfig(**own | fields), horizon, shape=shape)


@functools.cache
def example(name: str) -> HorizonProblem:
    """The problem of a pattern, or of aircraft, with all limits; the cables of two differ."""
    if name in PATTERNS:
        system = {"cable_length": [0.8, 1.0, 0.9, 0.7, 0.85]} if name == "cycle-5" else {}
        return points_problem(name, system=system, **LIMITS)
    lengths = [150.0, 155.0, 150.0, 145.0] if name == "aircraft" else 150.0
    limits = {"min_separation": 12.0, "max_speed": 26.0, "max_tension": 60.0, **SHARES}
    return aircraft_problem(is_bowed=name == "bowed", lengths=lengths, **limits)


EXAMPLES = (*PATTERNS, "aircraft", "bowed")


def turning(pace: float):
    """A load that swings, and turns about a skew axis with a constant angular acceleration.

    The rates of its reference therefore are all that there are. `pace` scales its time.
    """
    size, frequency = np.array([0.4, 0.3, -0.2]), np.array([1.1, 0.8, 1.4])
    axis = np.array([0.3, -0.2, 0.5])
    tilt = RollPitchYaw(0.2, -0.1, 0.4).ToRotationMatrix().matrix()

    def reference(time):
        s = pace * time
        half = (0.6 * s + 0.08 * s**2) * np.linalg.norm(axis) / 2
        turn = np.append(np.cos(half), np.sin(half) * axis / np.linalg.norm(axis))
        quaternion = RotationMatrix(rotation(turn) @ tilt).ToQuaternion().wxyz()
        p, v, a, jerk = (
            (pace * frequency) ** k * size * np.sin(frequency * s + 0.3 + k * np.pi / 2)
            for k in range(4)
        )
        omega = pace * (0.6 + 0.16 * s) * axis
        return np.concatenate([quaternion, p, omega, v, pace**2 * 0.16 * axis, a, jerk])

    return reference


def reference_of(name: str):
    """The load's motion of an example: aircraft's is slow, since the rates of its jerk are left."""
    return turning(1.0 if name in PATTERNS else 0.05)


@functools.cache
def data_of(name: str):
    """The data of a plan of an example, on its way."""
    problem = example(name)
    return problem.data(1.0, 0.3, reference_of(name), problem.limits.speed_bound, wind=WIND)


def drawn_coefficients(problem: HorizonProblem, seed: int, size: float = 0.1) -> NDArray:
    """Coefficients (2, N) about those of the nominal ξ and A."""
    return 1 + size * np.random.default_rng(seed).normal(size=(2, problem.count))


def carriers(model: Model, reference, angle: float, amplitude: float, wind=STILL_AIR):
    """Positions of the carriers, and forces of the cables on the load, (n, 3) each, m and N."""
    R, load = rotation(reference[:4]), model.load
    omega, v, alpha, a = reference[7:19].reshape(4, 3)
    inertia = R @ load.inertia @ R.T
    torque = inertia @ alpha + np.cross(omega, inertia @ omega) + load.angular_drag * omega
    force = load.mass * (a + np.array([0, 0, load.gravity])) + load.drag * (v - wind)
    internal = model.pattern.basis @ (amplitude * np.cos(angle + model.pattern.phases))
    forces = model.pseudo_inverse @ np.append(R.T @ torque, R.T @ force)
    forces = (forces + model.pattern.offset + internal).reshape(-1, 3) @ R.T
    lengths, compliances = (
        np.broadcast_to(number, model.n)[:, None]
        for number in (model.cable_length, model.cable_compliance)
    )
    reach = lengths / np.linalg.norm(forces, axis=1, keepdims=True) + compliances
    return reference[4:7] + model.attachments @ R.T + reach * forces, forces


class Motion(NamedTuple):
    """The carriers' motion (n, 3) each, in W."""

    positions: NDArray
    velocities: NDArray  # less the wind that aircraft fly in
    accelerations: NDArray
    at_load: NDArray  # N, the cables' forces on the load
    pulls: NDArray  # N, that the carriers pull with


def along(plan):
    """[θ, A] of a plan at times in s."""
    return lambda time: plan.planned(time)[[0, 2]]


def straight_velocities(model: Model, reference, orbit, time: float, wind) -> NDArray:
    """Velocities (n, 3), m/s, of carriers on straight cables, less the wind."""
    return (
        difference(lambda now: carriers(model, reference(now), *orbit(now), wind)[0], time) - wind
    )


def motion_at(problem: HorizonProblem, reference, orbit, time: float, wind=WIND) -> Motion:
    """The motion at a time in s, where `orbit` tells [θ, A] at times."""
    model = problem.model
    wind = wind if model.aircraft is not None else STILL_AIR

    def at(now):
        return carriers(model, reference(now), *orbit(now), wind)

    positions, forces = at(time)
    if problem.shape is None:
        step = 2e-3
        velocities = straight_velocities(model, reference, orbit, time, wind)
        accelerations = (at(time + step)[0] - 2 * positions + at(time - step)[0]) / step**2
        return Motion(positions, velocities, accelerations, forces, forces)
    now = [reference(each) for each in time + WINDOW.times]
    pulls = np.array([at(each)[1] for each in time + WINDOW.times])
    ends = [row[4:7] + model.attachments @ rotation(row[:4]).T for row in now]
    shape = {"cable": problem.shape.cable, "nodes": problem.shape.nodes}
    lines = bowed_lines(pulls, np.array(ends), wind, WINDOW, **shape)
    positions, velocities, accelerations, _ = WINDOW.at_present(lines.ends)
    pull = lines.forces[len(WINDOW.times) // 2]
    return Motion(positions, velocities - wind, accelerations, forces, pull)


def slowest_velocities(motion: Motion, half: float) -> NDArray:
    """The slowest velocities (n, 3), m/s, within so many s, at constant accelerations."""
    times = np.linspace(-half, half, 4001)[:, None, None]
    tried = motion.velocities + times * motion.accelerations
    place = np.linalg.norm(tried, axis=2).argmin(axis=0)
    return tried[place, np.arange(len(place))]


def expected_margins(
    problem: HorizonProblem, motion: Motion, bounds: NDArray, half: float
) -> NDArray:
    """The margins (r,) of a motion, for tightened bounds (n,), m/s, kept within so many s."""
    limits, n = problem.limits, problem.model.n
    more, less = 1 + limits.tightening, 1 - limits.tightening
    aircraft = problem.model.aircraft
    speeds = np.linalg.norm(motion.velocities, axis=1)
    tensions = np.linalg.norm(motion.at_load, axis=1)
    first, second = np.triu_indices(n, 1)
    apart = np.linalg.norm(motion.positions[first] - motion.positions[second], axis=1)
    slowest = np.linalg.norm(slowest_velocities(motion, half), axis=1)
    rows = {
        problem.names[0]: (slowest / bounds) ** 2 - 1,
        "speed": 1 - (speeds / (less * limits.max_speed)) ** 2,
        "largest_tension": 1 - (tensions / (less * limits.max_tension)) ** 2,
    }
    if limits.min_tension:
        rows["least_tension"] = (tensions / (more * limits.min_tension)) ** 2 - 1
    if limits.min_separation:
        rows["separation"] = (apart / (more * limits.min_separation)) ** 2 - 1
    if aircraft is not None:
        if problem.shape is not None:  # the cable's own drag bows it
            aircraft = aircraft._replace(cable_drag=0.0)
        rows |= _flight_margins(aircraft, limits, less, motion)
    return np.concatenate([rows[name] for name in dict.fromkeys(problem.names)])


def expected_orbit_margins(
    problem: HorizonProblem, reference, bounds: NDArray, planned: NDArray, time: float
) -> NDArray:
    """The margins (r,) at a phase of a whole orbit, of constant [θ, ξ, A] at a time in s.

    The part of a velocity that grows with ξ counts with its sign.
    """
    angle, xi, A = planned
    model, n = problem.model, problem.model.n
    phases = (problem.points - len(problem.instants)) // 8  # of each of eight orbits

    def kept(frequency):
        return lambda now: (angle + frequency * (now - time), A)

    motion = motion_at(problem, reference, kept(xi), time)
    half = np.pi / phases / xi
    margins = expected_margins(problem, motion, bounds, half)
    wind = WIND if model.aircraft is not None else STILL_AIR
    slow, fast = (
        straight_velocities(model, reference, kept(frequency), time, wind)
        for frequency in (xi, xi + 1)
    )
    faster = (fast - slow) / np.linalg.norm(fast - slow, axis=1, keepdims=True)
    slowest = slowest_velocities(motion, half)
    backward = np.minimum((slowest * faster).sum(axis=1), 0.0)
    margins[:n] -= 2 * backward**2 / bounds**2
    return margins


def _flight_margins(aircraft, limits, less: float, motion: Motion):
    air = motion.velocities
    force = needed_force(aircraft, motion.accelerations, motion.pulls)
    needs = flight_needs(aircraft, force, air)
    speeds = np.linalg.norm(air, axis=1)
    low, high = thrust_limits(aircraft, speeds)
    middle, half = (high + low) / 2, less * limits.max_thrust_share * (high - low) / 2
    thrust = np.concatenate([middle + half - needs.thrust, needs.thrust - middle + half])
    factor = stall_factor(aircraft, less * limits.max_lift_share)
    return {
        "lift": 1 - np.linalg.norm(force, axis=1) / (factor * speeds**2),
        "bank": 1 - (needs.bank / (less * limits.max_bank)) ** 2,
        "climb": 1 - (np.arcsin(air[:, 2] / speeds) / (less * limits.max_climb)) ** 2,
        "thrust": thrust / (aircraft.mass * aircraft.gravity),
    }
