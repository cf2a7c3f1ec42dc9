"""Both engines fly the same: the fleet, drawn blocks, ends of samples, refusals and endings."""

import os
import signal
import warnings
from dataclasses import dataclass

import numpy as np
import pytest
from drawn_own_blocks import compare
from fleet import BY_BOTH_ENGINES, FLEET
from helpers import assert_same_run, nightly_beyond

from drake_nonstop import (
    Block,
    RunInterrupted,
    RunStopped,
    ScenarioWarning,
    StepAction,
    compute_metrics,
    load_scenario,
    simulate,
)
from drake_nonstop.blocks.load_disturbance import DisturbanceForce
from drake_nonstop.systems.tracing import where

PROGRAM = "optimization_layer=NlpLayer"
CONSTANT = "optimization_layer=ConstantParameters"
COMPILED, DIAGRAM = "compiled", "diagram"
BOUNDED = "optimization_layer.speed_bound=0.45"
GROWING = {"that_diverges": 1e-5}  # rounding grows tenfold every few steps


def flown(name, overrides, engine, **arguments):
    """The run, whole or not, and what was said of its engine."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        try:
            run = simulate(load_scenario(name, overrides), engine=engine, **arguments)
        except RunStopped as stopped:
            run = stopped.run
    messages = [str(w.message) for w in told if issubclass(w.category, ScenarioWarning)]
    return run, [message for message in messages if "engine" in message]


@pytest.mark.parametrize(
    "name",
    nightly_beyond(3, "engines", dict.fromkeys([*BY_BOTH_ENGINES, *FLEET])),
)
def test_both_engines_fly_the_fleet_alike(name, fleet):
    run, metrics = fleet.evaluated(name)  # compiled
    expected, expected_metrics = fleet.evaluated(name, DIAGRAM)
    assert_same_run(run, expected, GROWING.get(name, 1e-8))
    assert metrics["outcome"] == expected_metrics["outcome"]


# A continuous state that starts by others; a sampled one, of two samples; no multiple; plain.
SHOWN_BY_DAY = [6, 14, 2, 4]


@pytest.mark.parametrize(
    "seed", nightly_beyond(4, "engines", dict.fromkeys([*SHOWN_BY_DAY, *range(112)]))
)
def test_drawn_blocks_fly_the_same_or_are_named(seed):
    difference, told = compare(seed)
    assert difference < 1e-9, told
    assert (told == "") == (seed in (6, 14)) or seed not in SHOWN_BY_DAY


OTHER_LENGTHS = [  # the rest of a sample is the Simulator's
    [PROGRAM, "simulation_duration=0.104"],
    [CONSTANT, "simulation_duration=0.004"],
    [CONSTANT, "simulation_duration=0.06", "simulator_config.max_step_size=0.003"],
    ["simulation_duration=0.9", "control_period=0.03"],
]


@pytest.mark.parametrize("overrides", nightly_beyond(3, "engines", OTHER_LENGTHS))
def test_steps_and_samples_of_other_lengths_are_the_diagrams(overrides):
    run, told = flown("quintic", overrides, COMPILED)
    assert not told
    assert_same_run(run, flown("quintic", overrides, DIAGRAM)[0], 1e-9)


STEERED = {"after_step": lambda *_: StepAction.CONTINUE}
NOT_COMPILED = [
    (["control_period=0"], {}, "control_period = 0: it goes from sample to sample"),
    (["control_period=0.004"], {}, "control_period = 0.004 and the 0.01 s between signals"),
    (["load_plant=MultibodyLoadPlant"], {}, "load_plant = MultibodyLoadPlant: it has no"),
    (["load_feedback=!NoisyFeedback {delay: 0.015, period: 0.015}"], {}, "every 0.015 s, no"),
    (["simulator_config.use_error_control=true"], {}, "without error control"),
    ([], STEERED, "for after_step the steps of"),
]


@pytest.mark.parametrize(
    ("overrides", "arguments", "said"), nightly_beyond(4, "engines", NOT_COMPILED)
)
def test_what_cannot_be_compiled_is_said_where_it_was_asked_for(overrides, arguments, said):
    overrides = [CONSTANT, "simulation_duration=0.03", *overrides]
    expected, _ = flown("quintic", overrides, DIAGRAM, **arguments)
    for engine, is_told in ((COMPILED, True), (None, False)):
        run, told = flown("quintic", overrides, engine, **arguments)
        assert [said in message for message in told] == [True] * is_told
        assert run.engine.startswith("diagram: ")
        assert said in run.engine == compute_metrics(run)["engine"]
        assert_same_run(run, expected)


def test_an_interrupted_run_is_the_first_part_of_a_whole_one():
    def interrupt(time):
        if time > 0 and not asked:
            asked.append(time)
            os.kill(os.getpid(), signal.SIGINT)

    asked, overrides = [], [CONSTANT, "simulation_duration=120", "engine=compiled"]
    with pytest.raises(RunInterrupted, match="was interrupted at t = ") as raised:
        simulate(load_scenario("quintic", overrides), progress=interrupt)
    run = raised.value.run
    end = run.time[-1]
    assert 0 < end < 120
    assert f"t = {end:.4f} s" in run.stopped
    whole, _ = flown("quintic", [CONSTANT, f"simulation_duration={end}"], COMPILED)
    for name, values in whole.signals.items():
        np.testing.assert_array_equal(run.signals[name], values)


class Fails(DisturbanceForce):
    """A disturbance that fails in the middle of a sample."""

    def precomputed_inputs(self, names, times):
        if np.max(times) > 0.051:
            raise ValueError("it broke")
        return super().precomputed_inputs(names, times)


def test_a_block_that_fails_ends_the_run_at_the_diagrams_step():
    overrides = [CONSTANT, "simulation_duration=0.1"]
    expected, _ = flown("quintic", overrides, DIAGRAM, load_disturbance=Fails)
    run, _ = flown("quintic", overrides, COMPILED, load_disturbance=Fails)
    assert "0.0525 s: load_disturbance (test_engines.py" in run.stopped
    assert_same_run(run, expected, 1e-9)


@dataclass
class CommandedBoundConfig:
    """What the bound is later."""

    later: float = 0.47  # m/s


class CommandedBound(Block):
    """A bound that changes from 0.4 m/s at 0.1 s; a layer may refuse what it is then."""

    makes, reads_time = ("speed_bound_command",), True

    @staticmethod
    def equations(time, *, later):
        return where(time[0] < 0.1, [0.4], [later])


@pytest.mark.parametrize(
    ("layer", "later"),
    nightly_beyond(2, "engines", [(PROGRAM, 0.47), (PROGRAM, -1.0), (BOUNDED, 0.47)]),
)
def test_a_commanded_bound_counts_and_is_checked_as_in_the_diagram(layer, later):
    extra = {"bound": lambda model: CommandedBound(model, CommandedBoundConfig(later))}
    overrides = [layer, "simulation_duration=0.2"]
    run, told = flown("quintic", overrides, COMPILED, extra=extra)
    assert later < 0 or not told
    assert_same_run(run, flown("quintic", overrides, DIAGRAM, extra=extra)[0], 1e-9)
    assert run.signal("speed_bound")[-1] in (later, 0.4)
