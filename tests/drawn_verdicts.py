"""What `check` says of drawn tasks beside what becomes of their flights in other seeds.

`python tests/drawn_verdicts.py --count 300` prints the table of verdict against outcome and lists
the contradictions. With `--kind errors` each task states an error: noise, a wrong model, a wind or
a delay.
"""

import argparse
import sys
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
from drawn_study import flown
from drawn_tasks import GRAVITY, aircraft_task, attachments_of, loaded

from drake_nonstop.analysis.flights import fly
from drake_nonstop.analysis.stated_errors import is_random, with_seed
from drake_nonstop.analysis.verdict import check_scenario
from drake_nonstop.run.outcome import RunOutcome
from drake_nonstop.scenario.overrides import changed
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.validation import ScenarioError, ScenarioWarning

OK, CANNOT, MIXED, REFUSED = RunOutcome.OK.value, "cannot", "mixed", "refused"
_AIRCRAFT = 5  # one task in so many is flown by aircraft
_OTHER, _OTHERS = 100, 3  # the first of the other seeds, and how many


def task_of_seed(seed: int) -> Scenario:
    """The task of a seed: one in five is one of aircraft, the others are of the kind of `draw`."""
    if seed % _AIRCRAFT == 0:
        return _aircraft_task(seed)
    return changed(loaded("quintic"), draw(seed))


def draw(seed: int) -> list[str]:
    """The overrides that make the scenario "quintic" the task of a seed.

    3 to 8 cables of 0.6 to 3 m hold a load of 0.5 to 3 kg, on a cycle, a carousel, or one that is
    spread, at attachments about a circle. The load moves by up to two cable lengths along each axis
    and turns by up to 0.25 rad. Half of the bounds are 40 to 160 % of the nominal speed at rest,
    the others 40 to 80 %; half of the layers have a limit of speed, tension or separation, too, and
    half of the tasks none of distances.
    """
    rng = np.random.default_rng([34, seed])

    def uniform(low: float, high: float) -> float:
        return round(float(rng.uniform(low, high)), 4)

    n = int(rng.integers(3, 9))
    attachments = attachments_of(n, rng)
    mass, length = uniform(0.5, 3.0), uniform(0.6, 3.0)
    share = mass * GRAVITY / n
    amplitude = round(share * uniform(0.3, 0.8), 4)
    frequency = uniform(1.2, 2.5)
    radius = float(np.linalg.norm(attachments[:, :2], axis=1).mean())
    inertia = round(mass * radius**2 / 4, 4) * np.diag([1.0, 1.0, 2.0])
    speed = frequency * length * amplitude / np.hypot(amplitude, share)
    pattern = ("HamiltonianCycle {}", "Carousel {}", None)[int(rng.integers(3))]
    if pattern is None:
        pattern = f"SpreadCarousel {{spread: {round(amplitude * uniform(1.1, 2.0), 4)}}}"
    move_time = uniform(8.0, 14.0)
    turn = rng.normal(size=3)
    turn *= uniform(0.0, 0.25) / np.linalg.norm(turn)
    bounds = (0.4, 1.6) if rng.random() < 0.5 else (0.4, 0.8)
    layer: dict[str, Any] = {
        "speed_bound": round(float(speed) * uniform(*bounds), 4),
        "frequency": frequency,
        "amplitude": amplitude,
    }
    if rng.random() < 0.5:
        name, value = (
            ("max_speed", float(speed) * uniform(1.3, 3.0)),
            ("max_tension", share * uniform(1.2, 3.0)),
            ("min_separation", radius * uniform(0.2, 1.0)),
        )[int(rng.integers(3))]
        layer[name] = round(value, 4)
    trajectory = {
        "displacement": np.round(rng.uniform(-2.0, 2.0, 3) * length, 4).tolist(),
        "roll_pitch_yaw": np.round(turn, 4).tolist(),
        "start_time": 1.0,
        "move_time": move_time,
    }
    settings = {
        "system.attachments": attachments.tolist(),
        "system.load_mass": mass,
        "system.load_inertia": inertia.tolist(),
        "system.cable_length": length,
        "simulation_duration": round(3.0 + move_time, 2),
        "pattern": f"!{pattern}",
        "load_trajectory": _tagged("RestToRest", trajectory),
        "optimization_layer": _tagged("RecedingHorizonOptimizer", layer),
    }
    if rng.random() < 0.5:  # so that what collides hides nothing else
        settings |= dict.fromkeys(("limits.carrier_distance", "limits.cable_distance"), 0.0)
    return [f"{path}={value}" for path, value in settings.items()]


def _aircraft_task(seed: int) -> Scenario:
    """A drawn transfer of aircraft; half of them with bounds of up to 1.6 of their first ones."""
    rng = np.random.default_rng([35, seed])
    task = aircraft_task(seed)
    factor = float(rng.uniform(0.6, 1.6)) if rng.random() < 0.5 else 1.0
    bound = round(factor * task.speed_bound, 4)
    return changed(task, [f"optimization_layer.speed_bound={bound}"])


def _tagged(name: str, values: dict[str, Any]) -> str:
    return f"!{name} {{{', '.join(f'{key}: {value}' for key, value in values.items())}}}"


def with_errors(seed: int) -> Scenario:
    """The task of a seed with an error that its controllers do not know of, and that it states."""
    rng, task = np.random.default_rng([36, seed]), task_of_seed(seed)
    size = float(np.exp(rng.uniform(np.log(0.01), np.log(1.0))))  # of a large error
    period = task.control_period
    system, scale = task.system, float(np.max(task.system.cable_length))
    if task.system.aircraft is not None:
        velocity = np.append(rng.uniform(-1, 1, 2).round(2), 0.0).tolist()
        gust = f"{{velocity: {velocity}, gust: {size:.4f}}}"
        observer = ("KnownWind {}", "WindObserver {}")[int(rng.integers(2))]
        errors = [
            [f"wind=!GustyWind {gust}", f"wind_estimator=!{observer}"],
            [f"wind=!SteadyWind {{velocity: [{size:.4f}, 0.0, 0.0]}}", "wind_estimator=!NoWind {}"],
            [f"simulated.load_mass={system.load_mass * (1 + 0.5 * size):.4f}"],
            [f"simulated.cable_length={scale * (1 + 0.02 * size):.4f}"],
        ]
    else:
        noise = 0.01 * size * scale
        noises = (
            f"position_noise: {noise:.6f}, velocity_noise: {4 * noise:.6f}, "
            f"orientation_noise: {noise:.6f}, angular_velocity_noise: {4 * noise:.6f}"
        )
        places = np.array(system.attachments) + 0.1 * size * rng.normal(size=3) * [1, 1, 0]
        delay = period * int(rng.integers(1, 5))
        wind = f"!GustyWind {{velocity: [{4 * size:.4f}, 0.0, 0.0], load_gust: {size:.4f}}}"
        errors = [
            [f"load_feedback=!NoisyFeedback {{{noises}, period: {period}}}"],
            [f"load_feedback=!FilteredFeedback {{{noises}, period: {period}}}"],
            [f"simulated.attachments={places.round(4).tolist()}"],
            [f"simulated.load_mass={system.load_mass * (1 + 0.5 * size):.4f}"],
            [f"load_feedback=!NoisyFeedback {{delay: {delay:g}, period: {period}}}"],
            [f"wind={wind}"],
        ]
    return changed(task, errors[int(rng.integers(len(errors)))])


TASKS = {"exact": task_of_seed, "errors": with_errors}


def looked_at(kind: str, seed: int) -> dict[str, Any]:
    """The verdict on a task and the outcomes of its flights in other seeds.

    Nothing is tried that may help.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ScenarioWarning)
        scenario = TASKS[kind](seed)
        try:
            found = check_scenario(scenario, tries_remedies=False)
        except ScenarioError as error:
            return {"verdict": REFUSED, "said": [str(error)], "outcomes": []}
        seeds = range(_OTHER, _OTHER + _OTHERS) if is_random(scenario) else [0]
        others = fly([("", with_seed(scenario, k)) for k in seeds])
    outcomes = [flight.outcome.value for flight in found.flights]
    verdict = CANNOT if OK not in outcomes else OK if set(outcomes) == {OK} else MIXED
    if verdict != MIXED and found.narrow:
        verdict = f"{verdict}, narrow"
    in_others = [flight.outcome.value for flight in others]
    return {"verdict": verdict, "said": [*found.verdicts], "outcomes": in_others}


def contradicts(result: dict[str, Any]) -> bool:
    """Whether a flight in another seed ends well against a verdict, or ill against it.

    Flights of which some end well and some do not promise neither.
    """
    verdict = result["verdict"].partition(",")[0]
    is_ok = [outcome == OK for outcome in result["outcomes"]]
    return any(is_ok) if verdict == CANNOT else verdict == OK and not all(is_ok)


def table(results: Sequence[dict[str, Any]]) -> str:
    """How many flights in other seeds end well, by the verdict, in Markdown."""
    lines = ["| verdict | tasks | other flights | of them ok | contradicted |", "| --- " * 5 + "|"]
    for verdict in sorted({result["verdict"] for result in results}):
        some = [result for result in results if result["verdict"] == verdict]
        flown = [outcome for result in some for outcome in result["outcomes"]]
        wrong = sum(map(contradicts, some))
        lines.append(f"| {verdict} | {len(some)} | {len(flown)} | {flown.count(OK)} | {wrong} |")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Checks, flies and prints; 1 where a verdict is contradicted."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--kind", choices=TASKS, default="exact", help="(exact)")
    parser.add_argument("--first", type=int, default=0, metavar="SEED", help="(0)")
    parser.add_argument("--count", type=int, default=20, metavar="N", help="tasks (20)")
    parser.add_argument("--serial", action="store_true", help="in this process")
    options = parser.parse_args(arguments)
    seeds = range(options.first, options.first + options.count)
    calls = {seed: (options.kind, seed) for seed in seeds}
    results = flown(looked_at, calls, is_serial=options.serial)
    print(table([*results.values()]))
    wrong = {seed: result for seed, result in results.items() if contradicts(result)}
    for seed, result in wrong.items():
        print(f"seed {seed}: {result['verdict']}, but {', '.join(result['outcomes'])}")
        print("".join(f"    {text}\n" for text in result["said"]), end="")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
