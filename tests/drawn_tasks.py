"""Drawn tasks: formations, loads and motions of all kinds that the speed bound has to hold on.

`drawn_study.py` flies them. Those of the published figures, which nothing is tuned on, are 500 of
the carriers' tasks, seeds from 5000 on, and 200 of the aircraft's, from 4200 on. With disturbances
those of the carriers' from 4000 on are flown. All others are there to try.
"""

import dataclasses
from functools import cache

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.analysis.aircraft_margins import margins_at_rest
from drake_nonstop.blocks.load_trajectory import RestToRest, RestToRestConfig
from drake_nonstop.mechanics.aircraft import stall_speed
from drake_nonstop.mechanics.grasp import grasp_matrix
from drake_nonstop.mechanics.rigid_load import STILL_AIR
from drake_nonstop.model.pattern import HamiltonianCycleConfig
from drake_nonstop.model.system import Model, SystemParameters
from drake_nonstop.planning.horizon_config import HorizonConfig, timed
from drake_nonstop.planning.horizon_problem import HorizonProblem
from drake_nonstop.planning.problem_config import LimitsConfig
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.scenario.overrides import changed
from drake_nonstop.scenario.schema import Scenario

GRAVITY = 9.81
STEP = 0.02  # s, at which planned motions are looked at
REST = 3.0  # s, that the load rests after its move
LEAST_SHARE = 0.05  # of an equal share of the weight, on every cable

DISC_RADIUS = 1.5  # m, of the aircraft's load
PEAK = 1.875  # the largest speed of a quintic move, of its mean

loaded = cache(load_scenario)


def carriers_task(seed: int) -> Scenario:
    """The task of a seed with carriers such as multirotors, of the kind of `draw`."""
    return changed(loaded("quintic"), draw(seed))


def aircraft_task(seed: int) -> Scenario:
    """The task of a seed with aircraft, of the kind of `draw_aircraft`."""
    return changed(loaded("aircraft_transfer"), draw_aircraft(seed))


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
    rng = np.random.default_rng([19, seed])

    def uniform(low: float, high: float) -> float:
        return round(float(rng.uniform(low, high)), 4)

    n = int(rng.integers(3, 9))
    attachments = attachments_of(n, rng)
    mass, length = uniform(0.5, 3.0), uniform(0.6, 3.0)
    amplitude = round(mass * GRAVITY / n * uniform(0.3, 0.6), 4)
    frequency = uniform(1.2, 2.5)
    system = {"attachments": attachments.tolist(), "load_mass": mass, "cable_length": length}
    orbit = _Orbit(SystemParameters(**system), amplitude, frequency)
    while True:
        displacement = rng.uniform(-2.0, 2.0, 3) * length
        turn = _direction(rng) * uniform(0.0, 0.25)
        trajectory = {
            "displacement": np.round(displacement, 4).tolist(),
            "roll_pitch_yaw": np.round(turn, 4).tolist(),
            "start_time": 1.0,
            "move_time": uniform(8.0, 16.0),
        }
        bound = uniform(0.4, 0.8) * orbit.least_resting_speed
        if orbit.least_speed(RestToRestConfig(**trajectory)) < 0.9 * bound:
            break
    layer = {"speed_bound": round(bound, 4), "frequency": frequency, "amplitude": amplitude}
    layer |= {"max_frequency_rate": 2.0, "max_amplitude_rate": 2.0}
    settings = {f"system.{name}": value for name, value in system.items()} | {
        "simulation_duration": round(1.0 + trajectory["move_time"] + REST, 2),
        "pattern": "!HamiltonianCycle {}",
        "load_trajectory": _tagged("RestToRest", trajectory),
        "optimization_layer": _tagged("RecedingHorizonOptimizer", layer),
    }
    return [f"{path}={value}" for path, value in settings.items()]


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
    rng = np.random.default_rng([1919, seed])

    def uniform(low: float, high: float) -> float:
        return round(float(rng.uniform(low, high)), 4)

    base = loaded("aircraft_transfer")
    while True:
        mass, frequency, amplitude = uniform(9.0, 11.5), uniform(0.58, 0.66), uniform(0.9, 1.1)
        inertia = round(mass * DISC_RADIUS**2 / 4, 4) * np.diag([1.0, 1.0, 2.0])
        load = {"load_mass": mass, "load_inertia": inertia.tolist()}
        ranges = {
            "frequency_bounds": [round(0.9 * frequency, 4), round(1.15 * frequency, 4)],
            "amplitude_bounds": [round(0.9 * amplitude, 4), round(1.1 * amplitude, 4)],
        }
        model = Model(dataclasses.replace(base.system, **load), base.pattern)
        flown = [(frequency, amplitude)] + [
            (xi, A) for xi in ranges["frequency_bounds"] for A in ranges["amplitude_bounds"]
        ]
        share, peak, move_time = uniform(0.6, 0.9), uniform(0.5, 3.5), uniform(30.0, 60.0)
        azimuth, rise = uniform(0.0, 2 * np.pi), uniform(-0.2, 0.2)
        margins = margins_at_rest(model, _AT_ORIGIN, np.array(flown[0]))
        slowest = float(np.min(margins.needs.airspeed))  # in still air
        least = 1.2 * stall_speed(model.aircraft)
        if max(share * slowest, slowest - peak) < least or not margins.is_flyable:
            continue
        if all(margins_at_rest(model, _AT_ORIGIN, np.array(x)).is_flyable for x in flown[1:]):
            break
    distance = peak * move_time / PEAK
    displacement = distance * np.array([np.cos(azimuth), np.sin(azimuth), rise])
    trajectory = {
        "displacement": np.round(displacement, 2).tolist(),
        "start_time": 5.0,
        "move_time": move_time,
    }
    layer = {
        "speed_bound": round(share * slowest, 4),
        "frequency": frequency,
        "amplitude": amplitude,
        **ranges,
        # Where their controller saturates.
        "max_lift_share": 0.9,
        "max_bank": 0.8727,
    }
    settings = {f"system.{name}": value for name, value in load.items()} | {
        "simulation_duration": round(15.0 + move_time, 2),
        "load_trajectory": _tagged("RestToRest", trajectory),
        "optimization_layer": _tagged("RecedingHorizonOptimizer", layer),
    }
    return [f"{path}={value}" for path, value in settings.items()]


_AT_ORIGIN = np.eye(22)[0]  # a load's reference, at rest


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


def _direction(rng: np.random.Generator) -> NDArray:
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector)


class _Orbit:
    """The carriers' orbits above a load, with constant ξ and A."""

    def __init__(self, system: SystemParameters, amplitude: float, frequency: float):
        self._model = Model(system, HamiltonianCycleConfig())
        limits = LimitsConfig(amplitude=amplitude, frequency=frequency)
        horizon = timed(HorizonConfig(), frequency, 0.0)
        self._problem = HorizonProblem(self._model, limits, horizon)
        self._amplitude, self._frequency = amplitude, frequency
        at_rest = RestToRestConfig(move_time=2 * np.pi / frequency)
        self.least_resting_speed = self.least_speed(at_rest)  # m/s, of any carrier

    def least_speed(self, motion: RestToRestConfig) -> float:
        """That in m/s of any carrier while the load moves as planned."""
        trajectory = RestToRest(self._model, motion)
        context = trajectory.CreateDefaultContext()
        preview = trajectory.GetOutputPort("reference_preview").Eval(context)
        times = motion.start_time + np.arange(0.0, motion.move_time, STEP)
        squares = []
        for time, reference in zip(times, preview.references(times), strict=True):
            orbit = self._frequency * time, self._frequency, self._amplitude
            planned = np.append(orbit, np.zeros(5))[:, None]
            squares.append(self._problem.squared_speeds(planned, reference, STILL_AIR))
        return float(np.sqrt(np.min(squares)))


def _tagged(name: str, values: dict) -> str:
    return f"!{name} {{{', '.join(f'{key}: {value}' for key, value in values.items())}}}"
