"""The fleet: flights that many tests read, each flown once in a run of the suite.

Its flights are the shipped scenarios and the `DRAWN` ones. Together they have every block of every
box, every pattern, every outcome, and 3 to 8 carriers; `tests/test_fleet.py` holds that. The
compiled engine flies them where it can. Those of `BY_BOTH_ENGINES` are flown by the diagram, too.
"""

import copy
import dataclasses
import fcntl
import hashlib
import os
import pickle
import warnings
from collections.abc import Collection, Iterable
from pathlib import Path

import numpy as np
import pytest
from helpers import irregular, regular, spatial

from drake_nonstop import (
    Run,
    RunStopped,
    Scenario,
    ScenarioWarning,
    compute_metrics,
    dump_scenario,
    load_scenario,
    scenario_names,
    simulate,
)


def _carriers(n: int, shape=irregular, **settings: object) -> list[str]:
    """Overrides of "quintic" for n carriers at the corners of a shape."""
    points = np.round(shape(n), 4).tolist()
    return [f"system.attachments={points}", "pattern=!HamiltonianCycle {}", *_settings(settings)]


def _settings(settings: dict[str, object]) -> list[str]:
    return [f"{path}={value}" for path, value in settings.items()]


def _circle(radius: float, duration: float) -> list[list[float]]:
    """Poses [t, x, y, z] on a circle in m, once around from rest to rest in a time in s."""
    shares = np.linspace(0, 1, 31)
    angles = 2 * np.pi * shares**3 * (10 - 15 * shares + 6 * shares**2)
    x, y = radius * (np.cos(angles) - 1), radius * np.sin(angles)
    return np.column_stack([duration * shares, x, y, 0 * x]).round(4).tolist()


_ONE_SAMPLE_AHEAD = [
    *("optimization_layer=NlpLayer", "phase=AccumulatedPhase"),
    "carrier_trajectory.hold=velocity",
]
_SHORT_MOTION = "!RestToRest {displacement: [0.2, 0.1, 0.1], start_time: 0.2, move_time: 2.0}"

# The scenario that each starts from, and its overrides.
DRAWN: dict[str, tuple[str, list[str]]] = {
    "three_on_a_circle": (
        "three_carriers",
        [
            "simulation_duration=4",
            f"load_trajectory=!SampledTrajectory {{samples: {_circle(0.5, 6.0)}}}",
            "load_feedback=!FilteredFeedback {position_noise: 0.002, orientation_noise: 0.002}",
            "wind=!SteadyWind {velocity: [0.5, 0.2, 0], start_time: 0.5, rise_time: 1}",
            *("system.load_drag=0.1", "wrench_controller=!TunedWrenchController {}"),
            "carrier_controller=!TunedFeedforwardCarrierPid {}",
        ],
    ),
    "five_tilted_loaded": (
        "quintic",
        [
            *_carriers(5, spatial, simulation_duration=4),
            "load_trajectory=!Waypoints {positions: [[0.5, 0, 0.2], [0, 0.4, 0]], "
            "roll_pitch_yaw: [[0.1, 0.1, 0.3], [0, 0, 0]], move_times: [2, 2], "
            "start_roll_pitch_yaw: [0.15, -0.1, 0.4]}",
            "carrier_dynamics=!LimitedCarriers {has_weight: true, feels_cable: true}",
            "simulated.cable_length=[0.8, 0.79, 0.8, 0.81, 0.8]",
            *("simulated.load_mass=1.05", "optimization_layer.amplitude=0.6"),
            *("optimization_layer.speed_bound=0.2", "optimization_layer.tightening=0.02"),
        ],
    ),
    "six_noisy": (
        "quintic",
        [
            *_carriers(6, regular, simulation_duration=3),
            *_ONE_SAMPLE_AHEAD,
            *("optimization_layer.amplitude=0.7", "optimization_layer.speed_bound=0.4"),
            "limits.time_below_bound=0.5",  # its step is too long for what else it shows
            "pattern=!SpreadCarousel {spread: 1.5}",
            "load_feedback=!NoisyFeedback {position_noise: 0.002, delay: 0.02, seed: 3}",
            "load_disturbance=!DisturbanceForce {force: [0.5, 0.2, 0], gust_force: 0.2}",
            *("carrier_controller=CarrierPid", "wrench_controller=PaperWrenchController"),
        ],
    ),
    "seven_gusty": (
        "quintic",
        [
            *_carriers(7, simulation_duration=3, control_period=0.02),
            "load_trajectory=!SampledTrajectory {samples: [[0, 0, 0, 0], [2, 0.3, 0.1, 0], "
            "[5, 0.6, 0, 0.1]]}",
            "wind=!GustyWind {velocity: [0.5, 0, 0], gust: 0.2, rise_time: 1, seed: 5}",
            "wind_estimator=WindObserver",
            *("system.load_drag=0.1", "optimization_layer.amplitude=0.5"),
            *("optimization_layer.speed_bound=0.2", "simulator_config.max_step_size=0.004"),
            "optimization_layer.tightening=0.02",
        ],
    ),
    "eight_by_drakes_body": (
        "quintic",
        [
            *_carriers(8, regular, simulation_duration=1.5),
            "load_plant=MultibodyLoadPlant",
            "wind=!SteadyWind {velocity: [0.5, 0, 0]}",
            f"load_trajectory={_SHORT_MOTION}",
            *("optimization_layer.amplitude=0.5", "optimization_layer.speed_bound=0.2"),
        ],
    ),
    "four_above_the_measured_load": (
        "quintic",
        [
            *("simulation_duration=2", "pattern=!HamiltonianCycle {}"),
            *("carrier_trajectory=MeasuredCarrierTrajectory", "carrier_controller=CarrierPid"),
            "wrench_controller=!WrenchController {feedforward: 0, position_integral_gain: 0, "
            "orientation_integral_gain: 0}",
            *("optimization_layer=ConstantParameters", "load_feedback=DesiredAttitudeFeedback"),
            "wind_estimator=NoWind",
        ],
    ),
    "four_governed": (
        "quintic",
        [
            *("simulation_duration=4", "reference_governor={}"),
            f"load_trajectory={_SHORT_MOTION}",
        ],
    ),
    "with_bowed_cables": (
        "aircraft_rest",
        [
            *("simulation_duration=2", "cables=!LumpedCables {nodes: 2}"),
            "simulated.cable_breaking_load=30",
            "carrier_trajectory=!BowedCarrierTrajectory {nodes: 2}",
        ],
    ),
    "that_falls": (
        "quintic",
        [
            *("simulation_duration=0.8", "wind_estimator=NoWind"),
            "optimization_layer.tightening=0.02",
            "carrier_dynamics=!LimitedCarriers {max_acceleration: 10, has_weight: true, "
            "feels_cable: true}",
        ],
    ),
    "that_stalls": (
        "aircraft_three",
        [
            "simulation_duration=4",
            "wind=!GustyWind {velocity: [9, 0, 0], rise_time: 3, gust: 1.064881436101872, "
            "load_gust: 1.3867002685825582}",
        ],
    ),
    "that_diverges": (
        "quintic",
        ["optimization_layer=ConstantParameters", "wrench_controller.velocity_gain=400"],
    ),
    "with_slack_cables": (
        "quintic",
        [
            *("simulation_duration=2", "optimization_layer=ConstantParameters"),
            *("system.cable_stiffness=.inf", "simulated.cable_stiffness=500"),
            "load_disturbance=!DisturbanceForce {force: [0, 0, 9], start_time: 1}",
        ],
    ),
}
BY_BOTH_ENGINES = (
    *("three_on_a_circle", "that_stalls", "that_diverges"),
    *("static_hold_open_loop", "six_noisy", "seven_gusty"),
)
FLEET = (*scenario_names(), *DRAWN)
# Flights that take a second or more, of which there is a shorter one of the same kind.
LONG = (
    *(name for name in scenario_names() if "_cables" in name),
    *("aircraft_co_rotating_rising_wind", "aircraft_six", "paper_line", "quintic_nlp"),
    *("real_scale_carousel", "real_scale_spread"),
)


def long_ones_nightly(names: Iterable[str], others: Collection[str] = ()) -> list:
    """Flights, as cases of a test, of which the long ones and others are for `make nightly`."""
    marks = {True: pytest.mark.nightly("flights"), False: ()}
    return [pytest.param(name, marks=marks[name in LONG or name in others]) for name in names]


def scenario_of(name: str) -> Scenario:
    """The scenario of a flight of the fleet."""
    base, overrides = DRAWN.get(name, (name, []))
    return load_scenario(base, overrides)


# Who asks for a run has its scenario; its diagram, which cannot be pickled, is built where it is
# needed.
_STORED = [field.name for field in dataclasses.fields(Run)]
_STORED = [name for name in _STORED if name not in ("scenario", "diagram")]


class Fleet:
    """A folder of runs, filled by the first process that asks for each.

    What is returned is shared: its arrays cannot be written to, and its `diagram` is None.
    """

    def __init__(self, folder: Path):
        self._folder = folder
        self._latest: tuple[str, Run, dict] = "", None, {}  # up to 50 MB

    def run(self, flight: str | Scenario, engine: str | None = None) -> Run:
        """The run of a flight of the fleet, or of a scenario, by an engine or the fastest."""
        return self.evaluated(flight, engine)[0]

    def evaluated(self, flight: str | Scenario, engine: str | None = None) -> tuple[Run, dict]:
        """The run of a flight of the fleet, or of a scenario, and its metrics."""
        scenario = scenario_of(flight) if isinstance(flight, str) else flight
        text = f"{engine}\n{dump_scenario(scenario)}"
        key = hashlib.sha256(text.encode()).hexdigest()
        if self._latest[0] != key:
            stored, metrics = self._stored(key, scenario, engine)
            run = Run(scenario=copy.deepcopy(scenario), diagram=None, **stored)
            for values in (run.time, run.solve_times, *run.signals.values(), *run.steps.values()):
                values.flags.writeable = False
            self._latest = key, run, metrics
        return self._latest[1:]

    def _stored(self, key: str, scenario: Scenario, engine: str | None) -> tuple[dict, dict]:
        """The stored fields of a run, and its metrics, flown now if no process has done so."""
        path = self._folder / f"{key}.pickle"
        self._folder.mkdir(exist_ok=True)
        with path.with_suffix(".lock").open("w") as lock:  # held by one process at a time
            fcntl.flock(lock, fcntl.LOCK_EX)
            try:
                if not path.exists():
                    run = flown(scenario, engine=engine)
                    stored = {name: getattr(run, name) for name in _STORED}
                    stored |= {name: dict(stored[name]) for name in ("signals", "steps")}
                    content = pickle.dumps((stored, compute_metrics(run)), pickle.HIGHEST_PROTOCOL)
                    path.with_suffix(".new").write_bytes(content)
                    os.replace(path.with_suffix(".new"), path)
            finally:  # for processes, too, that were forked meanwhile
                fcntl.flock(lock, fcntl.LOCK_UN)
        return pickle.loads(path.read_bytes())


def flown(scenario: Scenario, **arguments: object) -> Run:
    """The run of a scenario, whole or as far as it came; arguments are those of `simulate`."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ScenarioWarning)
        try:
            return simulate(scenario, **arguments)
        except RunStopped as stopped:
            return stopped.run
