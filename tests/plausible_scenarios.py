"""Drawn plausible scenarios, each flown also at a fifth of its step.

`python -m tests.plausible_scenarios --count 300` flies them in two processes and lists those whose
metrics move with the step though nothing was said; with `--aircraft` those of aircraft in wind.
"""

import argparse
import time
import warnings
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import cache, partial

import numpy as np

from drake_nonstop.run.metrics import compute_metrics
from drake_nonstop.run.moved_metrics import moved_metrics
from drake_nonstop.run.run import RunStopped, StepCheck
from drake_nonstop.run.simulate import simulate
from drake_nonstop.scenario.loading import load_scenario, scenario_names
from drake_nonstop.scenario.overrides import changed
from drake_nonstop.validation import ScenarioError, ScenarioWarning

loaded = cache(load_scenario)


def draw(seed: int) -> tuple[str, list[str]]:
    """A scenario's name and the overrides that make it another one."""
    rng = np.random.default_rng([16, seed])

    def uniform(low, high):
        return round(float(rng.uniform(low, high)), 4)

    def log_uniform(low, high):
        return float(f"{np.exp(rng.uniform(np.log(low), np.log(high))):.4g}")

    def choice(*values):
        return values[int(rng.integers(len(values)))]

    def chance(share):
        return rng.random() < share

    is_large = chance(0.15)
    n = int(rng.integers(3, 9))
    duration = uniform(4.0, 5.0)
    angles = 2 * np.pi * (np.arange(n) + rng.uniform(-0.15, 0.15, n)) / n
    radius = 1.5 if is_large else uniform(0.4, 1.0)
    heights = rng.uniform(-0.1, 0.1, n) * radius * chance(0.3)
    attachments = np.column_stack([radius * np.cos(angles), radius * np.sin(angles), heights])
    load_mass = uniform(5.0, 15.0) if is_large else uniform(0.5, 2.0)
    share = load_mass * 9.81 / n
    pattern = choice("HamiltonianCycle", "HamiltonianCycle", "Carousel", "SpreadCarousel")
    settings = {
        "simulation_duration": duration,
        "system.attachments": np.round(attachments, 4).tolist(),
        "system.load_mass": load_mass,
        "load_trajectory": _trajectory(duration, is_large, uniform, choice, chance),
    }
    amplitude = round(share * uniform(0.3, 0.9), 4)
    if pattern == "SpreadCarousel":
        settings["pattern"] = f"!SpreadCarousel {{spread: {round(amplitude * 1.5, 4)}}}"
    else:
        settings["pattern"] = f"!{pattern} {{}}"
    frequency = uniform(0.25, 0.7) if is_large else uniform(1.0, 4.0)
    length = 60.0 if is_large else uniform(0.5, 1.5)
    speed = frequency * length * amplitude / np.hypot(amplitude, share)
    control_period = choice(0.005, 0.01, 0.01, 0.01, 0.02, 0.05, 0.1)
    layer = {
        "frequency": frequency,
        "amplitude": amplitude,
        "speed_bound": round(float(speed) * uniform(0.3, 0.9), 4),
    }
    if chance(0.35):
        name = "ConstantParameters"
    else:
        name = ("NlpLayer", "PaperLayer")[seed % 2]
        layer["period"] = round(control_period * choice(1, 1, 1, 2, 5), 4)
        if is_large:
            layer["frequency_bounds"] = [0.1, 2.0]
    settings["optimization_layer"] = _tagged(name, layer)
    settings["control_period"] = control_period
    settings["simulator_config.max_step_size"] = choice(0.0025, 0.005, 0.005, 0.005, 0.01)
    if is_large:
        settings["carrier_controller.frequency"] = uniform(8.0, 30.0)
        settings["carrier_controller.damping"] = uniform(0.3, 1.0)
    else:
        # Carriers that are faster than the load swings on its cables, as any that work.
        carrier_mass, rate, damping = log_uniform(0.05, 0.4), uniform(50, 130), uniform(0.3, 1.0)
        swing = rate * uniform(0.15, 0.5)
        settings["system.cable_length"] = length
        settings["system.cable_stiffness"] = float(f"{load_mass / n * swing**2:.4g}")
        settings["system.cable_damping"] = (
            log_uniform(1e4, 1e7) if chance(0.05) else log_uniform(0.01, 5.0)
        )
        settings["system.carrier_mass"] = carrier_mass
        exact = {
            "position_gain": carrier_mass * rate**2,
            "velocity_gain": 2 * damping * carrier_mass * rate,
        }
        gains = {
            "position_gain": float(f"{carrier_mass * rate**2:.4g}"),
            "velocity_gain": float(f"{2 * damping * carrier_mass * rate:.4g}"),
        }
        settings["carrier_controller"] = choice(
            _tagged("CarrierPid", exact),
            _tagged("CarrierPid", gains),
            _tagged("FeedforwardCarrierPid", gains),
        )
    further = {
        "load_feedback": _tagged(
            "NoisyFeedback", {"position_noise": uniform(0, 0.003), "period": control_period}
        ),
        "load_disturbance": _tagged(
            "DisturbanceForce",
            {"force": [uniform(-1, 1), uniform(-1, 1), 0.0], "gust_force": uniform(0, 0.5)},
        ),
        "simulated.load_mass": round(load_mass * uniform(0.9, 1.1), 4),
        "phase": "!PaperPhase {}",
        "load_plant": "!MultibodyLoadPlant {}",
        "engine": "compiled",
        "wrench_controller": "!TunedWrenchController {}",
        "simulator_config.integration_scheme": choice(
            "runge_kutta2", "bogacki_shampine3", "explicit_euler", "implicit_euler", "radau3"
        ),
        "simulator_config.use_error_control": "true",
        "simulated.cable_damping": 0.0,
    }
    for path, value in further.items():
        if chance({"engine": 0.25}.get(path, 0.06)):
            settings[path] = value
    if settings.get("system.cable_damping", 0.0) > 1e3:  # what no explicit scheme can fly
        settings.pop("simulator_config.integration_scheme", None)
        settings.pop("simulator_config.use_error_control", None)
    return (
        "real_scale_spread" if is_large else "quintic",
        [f"{path}={value}" for path, value in settings.items()],
    )


def draw_aircraft(seed: int) -> tuple[str, list[str]]:
    """A shipped scenario of aircraft, in a wind, with disturbances and errors of the model."""
    rng = np.random.default_rng([18, seed])
    shipped = [name for name in scenario_names() if "_cables" not in name]
    name = str(rng.choice([name for name in shipped if name.startswith("aircraft_")]))
    velocity = [*rng.uniform(-3, 3, 2).round(3).tolist(), 0.0]
    wind, law = (
        ("StillAir", {}),
        ("SteadyWind", {"velocity": velocity, "rise_time": round(rng.uniform(0, 5), 3)}),
        ("GustyWind", {"velocity": velocity, "gust": round(rng.uniform(0, 1), 3), "seed": seed}),
    )[rng.integers(3)]
    settings = {"simulation_duration": 10.0, "wind": _tagged(wind, law)}
    settings["simulator_config.max_step_size"] = float(rng.choice([0.01, 0.02, 0.04]))
    settings["control_period"] = float(rng.choice([0.0, 0.01, 0.04, 0.1]))
    force = [*rng.uniform(-5, 5, 2).round(3).tolist(), 0.0]
    further = {
        "load_disturbance": _tagged("DisturbanceForce", {"force": force, "gust_force": 2.0}),
        "simulated.load_mass": round(10 * rng.uniform(0.9, 1.1), 4),
        "simulated.aircraft.lift_gain": round(rng.uniform(0.9, 1.05), 4),
        "simulated.aircraft.thrust_gain": round(rng.uniform(0.8, 1.1), 4),
    }
    settings |= {path: value for path, value in further.items() if rng.random() < 0.3}
    return name, [f"{path}={value}" for path, value in settings.items()]


def _trajectory(duration, is_large, uniform, choice, chance):
    start = uniform(0.3, 1.0)
    move = round(min(uniform(1.5, 6.0), duration - start), 4)
    size = 5.0 if is_large else uniform(0.1, 1.5)
    shift = [round(size * uniform(-1, 1), 4) for _ in range(3)]
    angles = [uniform(-0.2, 0.2), uniform(-0.2, 0.2), 0.0]
    if chance(0.4):
        angles[2] = choice(uniform(-1.5, 1.5), 3.1416, 6.2832)
    kind = choice("RestToRest", "RestToRest", "ConstantVelocityMove", "Waypoints")
    if kind == "ConstantVelocityMove":
        blend = round(min(choice(0.2, 0.5, 1.0), 2 * start, move), 4)
        velocity = [round(s / move, 4) for s in shift]
        values = {"velocity": velocity, "start_time": start, "move_time": move, "blend_time": blend}
    elif kind == "Waypoints":
        half = round(move / 2, 4)
        values = {"positions": [shift, [0, 0, 0]], "move_times": [half, half]}
    else:
        values = {
            "displacement": shift,
            "roll_pitch_yaw": angles,
            "start_time": start,
            "move_time": move,
        }
    return _tagged(kind, values)


def _tagged(name, values):
    return f"!{name} {{{', '.join(f'{key}: {value}' for key, value in values.items())}}}"


@dataclass
class Flight:
    """How a draw went."""

    seed: int
    said: list[str] = field(default_factory=list)  # refused, stopped, shortened, warned about
    moves: list[str] = field(default_factory=list)
    kind: str = ""
    overrides: list[str] = field(default_factory=list)
    seconds: float = 0.0


def fly(seed: int, *, is_judged_if_said: bool = True, draw=draw) -> Flight:
    """Flies a draw as it is and at a fifth of its step.

    Where `is_judged_if_said` is false, what was said of the first flight saves the second.
    """
    name, overrides = draw(seed)
    flight = Flight(seed, overrides=[name, *overrides])
    start = time.perf_counter()
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            scenario = changed(loaded(name), overrides)
            run = simulate(scenario)
        flight.said += [
            str(w.message)
            for w in caught
            if issubclass(w.category, ScenarioWarning) and "engine = " not in str(w.message)
        ]
        flight.said += run.unresolved
        flight.seconds = time.perf_counter() - start
        metrics = compute_metrics(run)
    except (ScenarioError, RunStopped) as error:
        flight.said.append(str(error))
        flight.kind = type(error).__name__
        return flight
    if flight.said and not is_judged_if_said:
        return flight
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            finer = [f"simulator_config.max_step_size={max(run.step / 5, 1e-5)!r}"]
            if scenario.simulator_config.use_error_control:
                finer.append(
                    f"simulator_config.accuracy={scenario.simulator_config.accuracy / 100!r}"
                )
            fine = compute_metrics(simulate(changed(scenario, finer), check_step=StepCheck.NOTHING))
    except (ScenarioError, RunStopped) as error:
        flight.moves = [f"with a fifth of the step: {error}"]
    else:
        flight.moves = [str(move) for move in moved_metrics(metrics, fine)]
    flight.kind = ("moved" if flight.moves else "still") + (", said" if flight.said else "")
    return flight


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--first", type=int, default=0, help="seed of the first draw")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--aircraft", action="store_true", help="in wind, with disturbances")
    parser.add_argument("--verbose", action="store_true")
    options = parser.parse_args()
    kinds = Counter()
    flown = partial(fly, draw=draw_aircraft if options.aircraft else draw)
    with ProcessPoolExecutor(options.workers) as executor:
        for flight in executor.map(flown, range(options.first, options.first + options.count)):
            kinds[flight.kind] += 1
            if flight.kind == "moved" or options.verbose:
                print(f"{flight.seed}: {flight.kind}, {flight.seconds:.1f} s", flush=True)
                for text in [*flight.overrides, "SAID", *flight.said, "MOVES", *flight.moves]:
                    print(f"      {text}", flush=True)
    for kind, count in sorted(kinds.items()):
        print(f"{count:5} {kind}")
    return int(kinds["moved"] > 0)


if __name__ == "__main__":
    raise SystemExit(main())
