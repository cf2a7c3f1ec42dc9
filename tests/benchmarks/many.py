"""How much faster many flights are side by side than one by one."""

import importlib.util
import os
import statistics
import tempfile
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from pydrake.systems.framework import DiagramBuilder

from drake_nonstop import load_scenario
from drake_nonstop.benchmarks.running import PACKAGES
from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.run.compiled_run import recorded_loop
from drake_nonstop.run.flight import without_warnings
from drake_nonstop.run.make_gym_env import make_gym_env, make_gym_vec_env
from drake_nonstop.run.many import simulate_many
from drake_nonstop.run.metrics import compute_metrics, versions
from drake_nonstop.run.preparation import stable_config
from drake_nonstop.run.recording import LogSignals
from drake_nonstop.run.simulate import simulate
from drake_nonstop.scenario.overrides import changed
from drake_nonstop.scenario.schema import COMPILED, DIAGRAM, Scenario
from drake_nonstop.studies.sweep import sweep
from drake_nonstop.studies.sweep_spec import SweepSpec
from drake_nonstop.systems.compiled_flight import advance_together
from drake_nonstop.systems.native import LANES, compiler
from drake_nonstop.validation import require

_SAMPLES, _CALLS = 40, 25  # of each flight that are timed at once
_SUCCESS: dict[str, Any] = {  # as examples/success_study.yaml has it
    "overrides": ["load_disturbance=!DisturbanceForce {}"],
    "draws": {
        "simulated.load_mass": {"uniform": [0.7, 1.3]},
        "load_disturbance.gust_force": {"uniform": [0.0, 0.3]},
        "load_disturbance.seed": {"seed": True},
    },
}
_CONSTANT = "optimization_layer=ConstantParameters"
_OTHERS_IN_LANES = "aircraft_transfer", "aircraft_transfer_cables"
_PREPARED = 16  # runs whose preparation is timed


def benchmark_many(
    scenario: Scenario,
    *,
    runs: int = 100,
    repeats: int = 5,
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> dict[str, Any]:
    """Times runs of the success study's kind, with the scenario's layer and with constant ξ and A.

    Args:
        scenario: what is flown, with other masses and gusts in each run.
        runs: of a sweep, by a process per core.
        repeats: of all else, of which medians are taken.
        progress: called with what is being done and the share of it that is done.

    Returns:
        What `python -m tests.benchmarks many` writes as JSON. `preparation` is the time of a run of
        one sample by `simulate_many` over that by `simulate` of the diagram; `run` that of a run of
        the sweep, with its metrics and the processes' start, over that of one by `simulate` of the
        diagram with its metrics.

    Raises:
        ScenarioError: the scenario cannot be flown so.
    """
    layers: dict[str, Any] = {}
    for k, (name, overrides) in enumerate({"default": [], "constant": [_CONSTANT]}.items()):
        layers[name] = _of_layer(changed(scenario, overrides), runs, repeats)
        progress("flying", (k + 1) / 2)
    found = {
        "scenario": scenario.name,
        "runs": runs,
        "processes": os.cpu_count(),
        "versions": versions(*PACKAGES),
        "layers": layers,
    }
    constant = changed(scenario, [_CONSTANT])
    if compiler() is not None:
        others = [load_scenario(name) for name in _OTHERS_IN_LANES]
        found["lanes"] = [lanes_ratio(each, repeats=repeats) for each in (constant, *others)]
    if importlib.util.find_spec("gymnasium") is not None:
        found["environment"] = environment_ratio(constant, repeats=repeats)
    return found


def _of_layer(scenario: Scenario, runs: int, repeats: int) -> dict[str, Any]:
    spec = SweepSpec(runs=max(runs, _PREPARED), **_SUCCESS)
    short = [f"simulation_duration={scenario.control_period}"]
    planned = [spec.run(k).overrides for k in range(_PREPARED)]
    own = [changed(scenario, [str(text) for text in texts]) for texts in planned]
    brief = [changed(each, short) for each in own]
    with without_warnings(), tempfile.TemporaryDirectory() as folder:
        unchecked: dict[str, Any] = {"engine": COMPILED}
        apart = _median(repeats, lambda k: simulate(brief[k], **unchecked | {"engine": DIAGRAM}))
        together = _median(repeats, lambda k: simulate_many(brief, **unchecked)) / _PREPARED
        one = _median(repeats, lambda k: compute_metrics(simulate(own[k], engine=DIAGRAM)))
        start = time.perf_counter()
        sweep(scenario, SweepSpec(runs=runs, **_SUCCESS), folder)
        each = (time.perf_counter() - start) / runs
    return {
        "preparation_s": [together, apart],
        "run_s": [each, one],
        "ratios": {"preparation": together / apart, "run": each / one},
    }


def _median(repeats: int, call: Callable[[int], Any]) -> float:
    """The median time of calls, s, after a first one that is not timed."""
    seconds = []
    for k in range(-1, repeats):
        start = time.perf_counter()
        call(max(k, 0) % _PREPARED)
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds[1:])


def table(results: dict[str, Any]) -> str:
    """The results as text."""
    rows = []
    for name, found in results["layers"].items():
        for what, ratio in found["ratios"].items():
            many, one = found[f"{what}_s"]
            rows.append(
                f"{name:>9} layer, {what:<11}  {1e3 * many:8.1f} ms of {1e3 * one:8.1f} ms by the "
                f"diagram, 1/{1 / ratio:.0f}"
            )
    for found in results.get("lanes", []):
        one, many = found["us_per_sample"].values()
        rows.append(
            f"lanes, {found['scenario']}: {many:.2f} µs a sample, of {one:.2f} by C one by one, "
            f"{found['ratio']:.1f} times"
        )
    if "environment" in results:
        found = results["environment"]
        rows.append(f"{found['environments']} environments: {found['ratio']:.0f} times one's steps")
    return "\n".join(rows)


def environment_ratio(
    scenario: Scenario, *, n: int = 64, time_step: float = 0.1, repeats: int = 5, steps: int = 20
) -> dict[str, Any]:
    """Steps a second of n environments side by side, by those of a single one, alternately.

    All fly the same constant ξ and A, the middle of their bounds. Returns the medians of the
    repeats, each of so many steps.

    Raises:
        ScenarioError: as of `make_gym_vec_env`.
    """
    environments: list[Any] = [
        make_gym_env(scenario, time_step=time_step),
        make_gym_vec_env(scenario, n, time_step=time_step),
    ]
    rates: dict[int, list[float]] = {1: [], n: []}  # steps/s
    for _ in range(repeats):
        for environment, found, count in zip(environments, rates.values(), rates, strict=True):
            space = environment.action_space
            environment.reset()
            start = time.perf_counter()
            for _ in range(steps):
                environment.step((space.low + space.high) / 2)
            found.append(count * steps / (time.perf_counter() - start))
    return {
        "scenario": scenario.name,
        "environments": n,
        "steps_per_s": {count: statistics.median(found) for count, found in rates.items()},
        "ratio": statistics.median(many / one for one, many in zip(*rates.values(), strict=True)),
    }


def lanes_ratio(scenario: Scenario, *, repeats: int = 5) -> dict[str, Any]:
    """The time of samples flown one flight after the other, by that in lanes, alternately.

    Both by C. Returns the medians of the repeats, per flight and sample.

    Raises:
        ScenarioError: the scenario cannot be compiled, or there is no compiler for its lanes.
    """
    nonstop = make_nonstop(scenario)
    context = nonstop.CreateDefaultContext()
    config = stable_config(scenario, nonstop, context)
    builder = DiagramBuilder()
    builder.AddSystem(nonstop)
    loop = recorded_loop(LogSignals(builder, nonstop), config, scenario.control_period)
    loop.prepare_lanes()
    is_fit = loop.is_compiled and loop.lanes() is not None
    require(is_fit, "lanes", "none", "name a compiler with vector extensions in CC")
    flights = [loop.fly(context) for _ in range(LANES)]
    for flight in flights:
        flight.start()
    start = flights[0].state
    seconds: dict[str, list[float]] = {"one by one": [], "in lanes": []}
    for _ in range(repeats):
        for found, groups in zip(
            seconds.values(), ([[f] for f in flights], [flights]), strict=True
        ):
            for flight in flights:
                flight.go_to(0, start)
            before = time.process_time()
            for group in groups:
                for _ in range(_CALLS):
                    advance_together(group, [_SAMPLES] * len(group))
            found.append(time.process_time() - before)
    one, many = seconds.values()
    samples = LANES * _SAMPLES * _CALLS
    return {
        "scenario": scenario.name,
        "us_per_sample": {w: 1e6 * statistics.median(s) / samples for w, s in seconds.items()},
        "ratio": statistics.median(np.divide(one, many).tolist()),
    }
