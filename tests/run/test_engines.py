"""What `engine: compiled` flies is what the diagram flies, and so is how a run ends."""

import os
import signal
import warnings
from dataclasses import dataclass

import numpy as np
import pytest
from helpers import nightly_beyond

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
from drake_nonstop.run import recording
from drake_nonstop.systems import equation_loop
from drake_nonstop.systems.native import compiler
from drake_nonstop.systems.tracing import where

PROGRAM = "optimization_layer=NlpLayer"
CONSTANT = "optimization_layer=ConstantParameters"
SHORT = [CONSTANT, "simulation_duration=0.05"]
BOUNDED = "optimization_layer.speed_bound=0.45"


def flown(name, overrides, engine, **arguments):
    """The run, whole or not, and what was said of it."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        try:
            scenario, given = load_scenario(name, overrides), arguments
            run = simulate(scenario, engine=engine, **given)
        except RunStopped as stopped:
            run = stopped.run
    return run, [str(w.message) for w in told if issubclass(w.category, ScenarioWarning)]


def assert_same(run, expected, tolerance=1e-9):
    np.testing.assert_array_equal(run.time, expected.time)
    np.testing.assert_allclose(run.steps["time"], expected.steps["time"], atol=1e-12)
    assert {*run.signals} == {*expected.signals}
    assert {*run.steps} == {*expected.steps}
    measured = {"time", "solve_time"}
    pairs = [(run.signals[name], values) for name, values in expected.signals.items()]
    pairs += [(run.steps[k], values) for k, values in expected.steps.items() if k not in measured]
    assert len(pairs) > 20
    for values, others in pairs:
        largest = np.abs(others).max(initial=0.0)
        np.testing.assert_allclose(values, others, rtol=0, atol=tolerance * (1 + largest))
    assert run.stopped == expected.stopped
    assert run.step == expected.step
    assert run.unresolved == expected.unresolved


@pytest.mark.parametrize(
    ("name", "overrides"),
    nightly_beyond(
        3,
        "engines",
        [
            # The rest of a sample is the Simulator's.
            ("quintic", [PROGRAM, "simulation_duration=0.104"]),
            ("quintic", [CONSTANT, "simulation_duration=0.004"]),
            (
                "quintic",
                [CONSTANT, "simulation_duration=0.06", "simulator_config.max_step_size=0.003"],
            ),
            ("quintic", [CONSTANT, "simulation_duration=0.06", "control_period=0.0025"]),
            (
                "quintic",
                [
                    *(PROGRAM, "optimization_layer.period=0.03"),
                    *("simulation_duration=0.15", "control_period=0.03"),
                ],
            ),
            ("quintic", [PROGRAM, "simulation_duration=2.5"]),
            ("quintic", ["simulation_duration=0.9", "control_period=0.03"]),
            ("three_carriers", ["simulation_duration=1"]),
            ("aircraft_transfer_gusty", ["simulation_duration=1.2"]),
        ],
    ),
)
def test_a_run_is_the_diagrams(name, overrides):
    expected, _ = flown(name, overrides, "diagram")
    run, told = flown(name, overrides, "compiled")
    assert not any("engine" in message for message in told)
    assert_same(run, expected)


def test_an_interrupted_run_is_the_first_part_of_a_whole_one():
    asked = []

    def interrupt(time):
        if time > 0 and not asked:
            asked.append(time)
            os.kill(os.getpid(), signal.SIGINT)

    overrides = [CONSTANT, "simulation_duration=120", "engine=compiled"]  # the scenario's own
    with pytest.raises(RunInterrupted, match="was interrupted at t = ") as raised:
        simulate(load_scenario("quintic", overrides), progress=interrupt)
    run = raised.value.run
    end = run.time[-1]
    assert 0 < end < 120
    assert f"t = {end:.4f} s" in run.stopped
    whole, _ = flown("quintic", [CONSTANT, f"simulation_duration={end}"], "compiled")
    for name, values in whole.signals.items():
        np.testing.assert_array_equal(run.signals[name], values)


def test_a_long_run_goes_to_files(monkeypatch):
    overrides = [CONSTANT, "simulation_duration=0.203"]
    expected, _ = flown("quintic", overrides, "compiled")
    monkeypatch.setattr(recording, "MEMORY_LIMIT", 3e4)
    run, _ = flown("quintic", overrides, "compiled")
    assert not run.signal("load_state").flags.writeable
    assert_same(run, expected, tolerance=0)


@pytest.mark.parametrize(
    ("overrides", "arguments", "said"),
    [
        (["control_period=0"], {}, "control_period = 0: it goes from sample to sample"),
        (["control_period=0.004"], {}, "control_period = 0.004 and the 0.01 s between signals"),
        (["load_plant=MultibodyLoadPlant"], {}, "load_plant = MultibodyLoadPlant: it has no"),
        ([], {"after_step": lambda *_: StepAction.CONTINUE}, "for after_step the steps of"),
    ],
)
def test_what_cannot_be_compiled_is_said_and_the_diagram_flies(overrides, arguments, said):
    overrides = [CONSTANT, "simulation_duration=0.03", *overrides]
    run, told = flown("quintic", overrides, "compiled", **arguments)
    (message,) = [message for message in told if message.startswith("engine = compiled: ")]
    assert said in message
    assert message.endswith("; the diagram is simulated instead")
    expected, _ = flown("quintic", overrides, "diagram", **arguments)
    assert_same(run, expected, tolerance=0)


@pytest.mark.parametrize(
    ("overrides", "arguments", "said"),
    [
        (["control_period=0"], {}, "control_period = 0: it goes from sample to sample"),
        ([], {"after_step": lambda *_: StepAction.CONTINUE}, "for after_step the steps of"),
        (["simulation_duration=0.004"], {}, "shorter than a sample"),
        (["engine=diagram"], {}, ""),
    ],
)
def test_by_default_what_needs_the_diagram_is_told_by_the_run_alone(overrides, arguments, said):
    run, told = flown("quintic", [*SHORT, *overrides], None, **arguments)
    assert not any("engine" in message for message in told)
    assert run.engine.startswith("diagram: " if said else "diagram")
    assert said in run.engine
    assert "\n" not in run.engine
    assert compute_metrics(run)["engine"] == run.engine


@pytest.mark.skipif(compiler() is None, reason="there is no C compiler")
@pytest.mark.slow
def test_c_and_the_virtual_machine_fly_the_same_to_the_bit(tmp_path, monkeypatch):
    overrides = [CONSTANT, "simulation_duration=1.1", "system.load_drag=0.05"]
    equation_loop._kept.clear()
    with monkeypatch.context() as patched:
        patched.setenv("DRAKE_PROGRAM_CACHE", str(tmp_path))
        slow, _ = flown("quintic", overrides, None)
    assert slow.engine == "compiled: virtual machine"
    for functions in equation_loop._kept.values():
        for key in functions._samples:
            functions.native(key, 1, builds=True)
    fast, _ = flown("quintic", overrides, None)
    assert fast.engine == "compiled: C"
    assert_same(fast, slow, tolerance=0)


class Fails(DisturbanceForce):
    """A disturbance that fails in the middle of a sample."""

    last = 0.051  # s

    def precomputed_inputs(self, names, times):
        if np.max(times) > self.last:
            raise ValueError("it broke")
        return super().precomputed_inputs(names, times)


def test_a_block_that_fails_ends_the_run_at_the_diagrams_step():
    overrides = [CONSTANT, "simulation_duration=0.1"]
    expected, _ = flown("quintic", overrides, "diagram", load_disturbance=Fails)
    run, _ = flown("quintic", overrides, "compiled", load_disturbance=Fails)
    assert "0.0525 s: load_disturbance (test_engines.py" in run.stopped
    assert_same(run, expected)


@dataclass
class CommandedBoundConfig:
    """What the bound is later."""

    later: float = 0.4  # m/s


class CommandedBound(Block):
    """A bound that changes from 0.4 m/s at 0.1 s; a layer may refuse what it is then."""

    makes, reads_time = ("speed_bound_command",), True

    @staticmethod
    def equations(time, *, later):
        return where(time[0] < 0.1, [0.4], [later])


@pytest.mark.parametrize(
    ("layer", "later"),
    nightly_beyond(
        2,
        "engines",
        [
            *((PROGRAM, 0.47), (PROGRAM, -1.0), (BOUNDED, 0.0)),
            *((CONSTANT, 1e-4), (PROGRAM, 0.0), (PROGRAM, 1e-4), (BOUNDED, 0.47), (BOUNDED, -1.0)),
            *((BOUNDED, 1e-4), (CONSTANT, 0.47), (CONSTANT, 0.0), (CONSTANT, -1.0)),
        ],
    ),
)
def test_a_commanded_bound_counts_and_is_checked_as_in_the_diagram(layer, later):
    runs = []
    for engine in ("diagram", "compiled"):
        extra = {"bound": lambda model: CommandedBound(model, CommandedBoundConfig(later))}
        run, told = flown("quintic", [layer, "simulation_duration=0.2"], engine, extra=extra)
        assert later < 1e-3 or not any("engine" in message for message in told)
        runs.append(run)
    assert_same(runs[1], runs[0])
    assert runs[0].signal("speed_bound")[-1] in (later, 0.4)
