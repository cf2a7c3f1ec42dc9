"""Drawn tasks: formations, loads and motions of all kinds that the speed bound has to hold on.

`drawn_study.py` flies them. Those of the published figures, which nothing is tuned on, are 500 of
the carriers' tasks, seeds from 5000 on, and 200 of the aircraft's, from 4200 on. All others are
there to try.
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from drake_nonstop import (
    Model,
    RestToRest,
    Scenario,
    aircraft_margins,
    changed,
    load_scenario,
)
from drake_nonstop.blocks.load_trajectory import RestToRestConfig
from drake_nonstop.mechanics.aircraft import stall_speed
from drake_nonstop.mechanics.grasp import grasp_matrix
from drake_nonstop.mechanics.load_motion import LoadMotion
from drake_nonstop.mechanics.planned_orbit import FlightTerms, orbit_motion
from drake_nonstop.mechanics.rigid_load import STILL_AIR
from drake_nonstop.mechanics.signals import PlannedParameters, constant_plan

GRAVITY = 9.81
STEP = 0.02  # s, at which planned motions are looked at
REST = 3.0  # s, that the load rests after its move
LEAST_SHARE = 0.05  # of an equal share of the weight, on every cable
DISC_RADIUS = 1.5  # m, of the aircraft's load
PEAK = 1.875  # the largest speed of a quintic move, of its mean

loaded = cache(load_scenario)


class Draw:
    """Random numbers of a key, to four digits."""

    def __init__(self, *key: int):
        self.rng = np.random.default_rng(key)

    def __call__(self, low: float, high: float) -> float:
        return round(float(self.rng.uniform(low, high)), 4)

    def is_so(self) -> bool:
        """Half of the times."""
        return self.rng.random() < 0.5


def carriers_task(seed: int) -> Scenario:
    """The task of a seed with carriers such as multirotors, of the kind of `draw`."""
    return changed(loaded("quintic"), draw(seed))


def aircraft_task(seed: int) -> Scenario:
    """The task of a seed with aircraft, of the kind of `draw_aircraft`."""
    return changed(loaded("aircraft_transfer"), draw_aircraft(seed))


@cache
def draw(seed: int) -> list[str]:
    """The overrides that make the scenario "quintic" the task of a seed.

    3 to 8 cables of 0.6 to 3 m hold a load of 0.5 to 3 kg, at attachments about a circle of 0.5 to
    1.5 m, level or not. One formation in a hundred, of three, has a cable with less than a fifth
    of an equal share of the weight, which A swings below 15° above the horizontal. The amplitude
    is 0.3 to 0.6 of an equal share, ξ 1.2 to 2.5 rad/s. The load moves by up to two cable lengths
    along each axis in 8 to 16 s and turns by up to 0.25 rad. The bound is 40 to 80 % of the least
    speed of the orbits at rest; ξ and A may change by 2 rad/s² and 2 N/s. A motion and a bound that
    the first ξ and A keep all the way, or miss by less than a tenth, as four in five do, ask little
    of a layer and are drawn again.
    """
    uniform = Draw(19, seed)
    n = int(uniform.rng.integers(3, 9))
    attachments = attachments_of(n, uniform.rng)
    mass, length = uniform(0.5, 3.0), uniform(0.6, 3.0)
    amplitude = round(mass * GRAVITY / n * uniform(0.3, 0.6), 4)
    frequency = uniform(1.2, 2.5)
    layer = {"frequency": frequency, "amplitude": amplitude}
    layer |= {"max_frequency_rate": 2.0, "max_amplitude_rate": 2.0}
    settings = {
        "system.attachments": attachments.tolist(),
        "system.load_mass": mass,
        "system.cable_length": length,
        "pattern": "!HamiltonianCycle {}",
    }
    formation = changed(loaded("quintic"), written(settings))
    model = Model(formation.system, formation.pattern)
    turn_of_rest = RestToRestConfig(move_time=2 * np.pi / frequency)
    resting = least_speed(model, turn_of_rest, frequency, amplitude)
    while True:
        displacement = uniform.rng.uniform(-2.0, 2.0, 3) * length
        axis = uniform.rng.normal(size=3)
        turn = axis / np.linalg.norm(axis) * uniform(0.0, 0.25)
        trajectory = {
            "displacement": np.round(displacement, 4).tolist(),
            "roll_pitch_yaw": np.round(turn, 4).tolist(),
            "start_time": 1.0,
            "move_time": uniform(8.0, 16.0),
        }
        bound = uniform(0.4, 0.8) * resting
        motion = RestToRestConfig(**trajectory)
        if least_speed(model, motion, frequency, amplitude) < 0.9 * bound:
            break
    settings["simulation_duration"] = round(1.0 + motion.move_time + REST, 2)
    settings["load_trajectory"] = tagged("RestToRest", trajectory)
    layer = {"speed_bound": round(bound, 4), **layer}
    settings["optimization_layer"] = tagged("RecedingHorizonOptimizer", layer)
    return written(settings)


@cache
def draw_aircraft(seed: int) -> list[str]:
    """The overrides that make the scenario "aircraft_transfer" the task of a seed.

    Four aircraft carry a load of 9 to 11.5 kg with ξ of 0.58 to 0.66 rad/s and A of 0.9 to 1.1,
    which may rise by 15 and 10 %: at rest the aircraft can fly all that is within these bounds. The
    bound is 60 to 90 % of their least speed at rest. The load moves in 30 to 60 s, in any
    direction, up or down by as much as a fifth of that, at up to 3.5 m/s. Either the bound or the
    motion alone keeps the aircraft above 1.2 of the stall speed. The layers know the limits of lift
    and bank.
    """
    uniform = Draw(1919, seed)
    base = loaded("aircraft_transfer")
    while True:
        mass, frequency, amplitude = uniform(9.0, 11.5), uniform(0.58, 0.66), uniform(0.9, 1.1)
        inertia = round(mass * DISC_RADIUS**2 / 4, 4) * np.diag([1.0, 1.0, 2.0])
        load = {"system.load_mass": mass, "system.load_inertia": inertia.tolist()}
        layer = {
            "frequency": frequency,
            "amplitude": amplitude,
            "frequency_bounds": [round(0.9 * frequency, 4), round(1.15 * frequency, 4)],
            "amplitude_bounds": [round(0.9 * amplitude, 4), round(1.1 * amplitude, 4)],
            "max_lift_share": 0.9,  # with the bank, where their controller saturates
            "max_bank": 0.8727,
        }
        share, peak, move_time = uniform(0.6, 0.9), uniform(0.5, 3.5), uniform(30.0, 60.0)
        azimuth, rise = uniform(0.0, 2 * np.pi), uniform(-0.2, 0.2)

        def margins(xi, A, load=load):
            constant = tagged("ConstantParameters", {"frequency": xi, "amplitude": A})
            own = load | {"optimization_layer": constant}
            return aircraft_margins(changed(base, written(own)))

        found = margins(frequency, amplitude)
        slowest = float(np.min(found.needs.airspeed))  # in still air
        least = 1.2 * stall_speed(Model(base.system, base.pattern).aircraft)
        if max(share * slowest, slowest - peak) < least or not found.is_flyable:
            continue
        bounds = layer["frequency_bounds"], layer["amplitude_bounds"]
        if all(margins(xi, A).is_flyable for xi in bounds[0] for A in bounds[1]):
            break
    distance = peak * move_time / PEAK
    displacement = distance * np.array([np.cos(azimuth), np.sin(azimuth), rise])
    trajectory = {
        "displacement": np.round(displacement, 2).tolist(),
        "start_time": 5.0,
        "move_time": move_time,
    }
    layer = {"speed_bound": round(share * slowest, 4), **layer}
    return written(
        load
        | {
            "simulation_duration": round(15.0 + move_time, 2),
            "load_trajectory": tagged("RestToRest", trajectory),
            "optimization_layer": tagged("RecedingHorizonOptimizer", layer),
        }
    )


def attachments_of(n: int, rng: np.random.Generator) -> NDArray:
    """About a circle, such that each cable carries a part of the weight."""
    while True:
        angles = 2 * np.pi * (np.arange(n) + rng.uniform(-0.3, 0.3, n)) / n
        radii = rng.uniform(0.5, 1.5) * rng.uniform(0.75, 1.0, n)
        heights = rng.uniform(-0.2, 0.2, n) * radii * (rng.random() < 0.5)
        places = np.column_stack([radii * np.cos(angles), radii * np.sin(angles), heights])
        places = np.round(places, 4) + 0.0
        forces = np.linalg.pinv(grasp_matrix(places)) @ np.array([0, 0, 0, 0, 0, n])
        if np.min(forces[2::3]) > LEAST_SHARE:
            return places


def least_speed(model: Model, motion: RestToRestConfig, xi: float, amplitude: float) -> float:
    """The least speed of any carrier, m/s, of constant ξ and A while the load moves as planned."""
    trajectory = RestToRest(model, motion)
    context = trajectory.CreateDefaultContext()
    preview = trajectory.GetOutputPort("reference_preview").Eval(context)
    times = motion.start_time + np.arange(0.0, motion.move_time, STEP)
    terms = FlightTerms.along(
        model.load,
        LoadMotion.along(preview.references(times)),
        STILL_AIR,
        pseudo_inverse=model.pseudo_inverse,
        offset=model.pattern.offset,
    )
    plan = PlannedParameters.view(constant_plan(xi * times, xi, amplitude))
    orbit = orbit_motion(
        terms,
        model.pattern.forces(*plan.series),
        attachments=model.attachments,
        rest_length=model.cable_length,
        compliance=model.cable_compliance,
    )
    return float(np.linalg.norm(orbit.velocities, axis=-1).min())


def tagged(name: str, values: dict) -> str:
    """A block with its fields in YAML."""
    return f"!{name} {{{', '.join(f'{key}: {value}' for key, value in values.items())}}}"


def written(settings: dict[str, object]) -> list[str]:
    """Overrides of fields by their paths."""
    return [f"{path}={value}" for path, value in settings.items()]
