"""Drawn tasks: formations, loads and motions of all kinds that the speed bound has to hold on.

`python -m tests.drawn_tasks --count 20` flies them and prints what each did;
`--set` gives overrides that all of them get, such as another controller of the carriers.
"""

import argparse
import json
import warnings
from functools import cache

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.grasp import grasp_matrix
from drake_nonstop.mechanics.resting_orbit import resting_orbits
from drake_nonstop.mechanics.signals import CarrierStates, TrackingError
from drake_nonstop.model.pattern import HamiltonianCycleConfig
from drake_nonstop.model.system import Model, SystemParameters
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.scenario.overrides import changed
from drake_nonstop.simulation.run import RunStopped, StepCheck
from drake_nonstop.simulation.run_quantities import RunQuantities
from drake_nonstop.simulation.simulate import simulate
from drake_nonstop.validation import ScenarioWarning

GRAVITY = 9.81
REST = 3.0  # s, that the load rests after its move
LEAST_SHARE = 0.05  # of an equal share of the weight, on every cable

loaded = cache(load_scenario)


def draw(seed: int) -> list[str]:
    """The overrides that make the scenario "quintic" the task of a seed.

    3 to 8 cables of 0.6 to 3 m hold a load of 0.5 to 3 kg, at attachments about a circle of 0.5 to
    1.5 m, level or not, from whose middle its centre of mass is off by up to 0.3 of the radius: one
    formation in fifty has a cable that A swings below 15° above the horizontal. The amplitude is 0.3 to 0.6 of a cable's equal share of the
    weight, ξ 1.2 to 2.5 rad/s. The load moves by up to two cable lengths along each axis in 8 to 16
    s and turns by up to 0.25 rad. The bound is 40 to 80 % of the least speed of the orbits at rest.
    """
    rng = np.random.default_rng([19, seed])

    def uniform(low: float, high: float) -> float:
        return round(float(rng.uniform(low, high)), 4)

    n = int(rng.integers(3, 9))
    attachments = _attachments(n, rng)
    mass, length = uniform(0.5, 3.0), uniform(0.6, 3.0)
    amplitude = round(mass * GRAVITY / n * uniform(0.3, 0.6), 4)
    frequency = uniform(1.2, 2.5)
    displacement = rng.uniform(-2.0, 2.0, 3) * length
    turn = _direction(rng) * uniform(0.0, 0.25)
    move_time = uniform(8.0, 16.0)
    system = {"attachments": attachments.tolist(), "load_mass": mass, "cable_length": length}
    resting_speed = _least_resting_speed(SystemParameters(**system), amplitude, frequency)
    bound = uniform(0.4, 0.8) * resting_speed
    trajectory = {
        "displacement": np.round(displacement, 4).tolist(),
        "roll_pitch_yaw": np.round(turn, 4).tolist(),
        "start_time": 1.0,
        "move_time": move_time,
    }
    layer = {"speed_bound": round(bound, 4), "frequency": frequency, "amplitude": amplitude}
    settings = {f"system.{name}": value for name, value in system.items()} | {
        "simulation_duration": round(1.0 + move_time + REST, 2),
        "pattern": "!HamiltonianCycle {}",
        "load_trajectory": _tagged("RestToRest", trajectory),
        "optimization_layer": _tagged("NonstopOptimizer", layer),
    }
    return [f"{path}={value}" for path, value in settings.items()]


def _attachments(n: int, rng: np.random.Generator) -> NDArray:
    """About a circle, such that each cable carries a part of the weight."""
    while True:
        angles = 2 * np.pi * (np.arange(n) + rng.uniform(-0.2, 0.2, n)) / n
        radius = rng.uniform(0.5, 1.5)
        radii = radius * rng.uniform(0.75, 1.0, n)
        heights = rng.uniform(-0.2, 0.2, n) * radii * (rng.random() < 0.5)
        places = np.column_stack([radii * np.cos(angles), radii * np.sin(angles), heights])
        off_centre = 0.3 * radius * np.sqrt(rng.random())
        angle = rng.uniform(0, 2 * np.pi)
        places[:, :2] -= off_centre * np.array([np.cos(angle), np.sin(angle)])
        places = np.round(places, 4)
        forces = np.linalg.pinv(grasp_matrix(places)) @ np.array([0, 0, 0, 0, 0, n])
        if np.min(forces[2::3]) > LEAST_SHARE:
            return places


def _direction(rng: np.random.Generator) -> NDArray:
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector)


def _least_resting_speed(system: SystemParameters, amplitude: float, frequency: float) -> float:
    """The least speed, m/s, of any carrier on its orbit above the load at rest."""
    model = Model(system, HamiltonianCycleConfig())
    orbits = resting_orbits(
        model.load,
        np.eye(7)[0],
        np.linspace(0, 2 * np.pi / frequency, 721),
        np.array([frequency, amplitude]),
        yaw_rate=0.0,
        load_wind=np.zeros(3),
        attachments=model.attachments,
        pseudo_inverse=model.pseudo_inverse,
        basis=model.pattern.basis,
        phases=model.pattern.phases,
        orders=model.pattern.orders,
        offset=model.pattern.offset,
        rest_length=model.cable_length,
        compliance=model.cable_compliance,
    )
    return float(np.min(np.linalg.norm(orbits.velocities, axis=-1)))


def _tagged(name: str, values: dict) -> str:
    return f"!{name} {{{', '.join(f'{key}: {value}' for key, value in values.items())}}}"


def fly(seed: int, overrides: list[str]) -> dict:
    """What the task of a seed did: figures by their names.

    Errors are in mm and mrad/s, averages over the run; `least` and `peak` are speeds in units of
    the bound and in m/s, `speed_squared` is Σ∫v² in m²/s.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ScenarioWarning)
        scenario = changed(loaded("quintic"), [*draw(seed), *overrides])
        try:
            run = simulate(scenario, check_step=StepCheck.NOTHING)
        except RunStopped as stop:
            return {"seed": seed, "stopped": str(stop)}
    bound = scenario.optimization_layer.speed_bound
    states = CarrierStates.view(run.signal("carrier_state"))
    speeds = np.linalg.norm(states.velocities, axis=-1)
    quantities = RunQuantities(run)
    error = TrackingError.view(run.signal("tracking_error"))
    parameters = run.signal("parameters")
    step = run.time[1] - run.time[0]
    return {
        "seed": seed,
        "n": speeds.shape[1],
        "least": quantities.slowest_speed / bound,
        "below": quantities.time_below_bound,
        "peak": quantities.peak_speed,
        "speed_squared": float((speeds**2).sum() * step),
        "position_error": float(1e3 * np.linalg.norm(error.position, axis=1).mean()),
        "rate_error": float(1e3 * np.linalg.norm(error.angular_velocity, axis=1).mean()),
        "amplitude_step": float(np.max(np.abs(np.diff(parameters[:, 1])))),
        "least_tension": float(np.min(run.signal("tensions"))),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--set", nargs="*", default=[])
    options = parser.parse_args()
    for seed in range(options.first, options.first + options.count):
        print(json.dumps(fly(seed, options.set)), flush=True)


if __name__ == "__main__":
    main()
