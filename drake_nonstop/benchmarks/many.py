"""How much faster many flights are side by side than one by one."""

import copy
import statistics
import time
from typing import Any

import numpy as np
from pydrake.systems.framework import DiagramBuilder

from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.loop.functions import Evaluation
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.simulation.compiled_run import recorded_loop
from drake_nonstop.simulation.make_gym_env import make_gym_env, make_gym_vec_env
from drake_nonstop.simulation.preparation import with_chosen_step
from drake_nonstop.simulation.recording import LogSignals
from drake_nonstop.systems.compilation import Compiled, c_text, compiled_for_processor
from drake_nonstop.validation import require

_FLIGHTS, _SAMPLES, _CALLS = 8, 40, 25  # how many of which are timed at once


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

    Both by C of the same function, with the same options for this processor. Returns the medians
    of the repeats, per flight and sample.

    Raises:
        ScenarioError: there are no lanes for the scenario, or its blocks make updates themselves.
    """
    nonstop = make_nonstop(scenario)
    context = nonstop.CreateDefaultContext()
    config = with_chosen_step(scenario, nonstop, context).config
    builder = DiagramBuilder()
    builder.AddSystem(nonstop)
    loop = recorded_loop(LogSignals(builder, nonstop), config, scenario.control_period)
    loop.prepare_lanes()
    flight = loop.fly(context)
    flight.start()
    flight.advance()
    inputs = flight.lane_inputs(_SAMPLES)
    function = copy.copy(flight.side_by_side)
    lanes = function.lanes if function else None
    remedy = "choose a layer that makes no updates itself, and a compiler with vector extensions"
    is_fit = function is not None and function.argument_sizes[-1] == 0 and lanes is not None
    require(is_fit, "optimization_layer", scenario.optimization_layer, remedy)
    assert function is not None
    assert lanes is not None
    text = c_text(function.function) + function.besides
    library = compiled_for_processor(lambda: text, builds=True)
    assert library is not None  # as of the lanes
    function.compiled = Compiled(function.function, library)
    alone = Evaluation(function, compiles=True)
    state = [inputs.state, inputs.parameters, np.zeros(0)]
    seconds: dict[str, list[float]] = {"one by one": [], "in lanes": []}
    for _ in range(repeats):
        start = time.perf_counter()
        for _ in range(_CALLS * _FLIGHTS):
            alone.fly(state, inputs.times, inputs.outside, inputs.largest)
        between = time.perf_counter()
        for _ in range(_CALLS):
            lanes.fly([inputs] * _FLIGHTS)
        seconds["one by one"].append(between - start)
        seconds["in lanes"].append(time.perf_counter() - between)
    one, many = seconds.values()
    samples = _CALLS * _FLIGHTS * len(inputs.times)
    return {
        "scenario": scenario.name,
        "us_per_sample": {w: 1e6 * statistics.median(s) / samples for w, s in seconds.items()},
        "ratio": statistics.median(np.divide(one, many).tolist()),
    }
