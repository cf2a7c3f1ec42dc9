"""Steps: shortened where the fastest mode asks for it, and verified with half of them."""

import os
import signal

import numpy as np
import pytest
from helpers import nightly_beyond
from pydrake.systems.framework import LeafSystem

from drake_nonstop import (
    RunInterrupted,
    ScenarioError,
    compute_metrics,
    load_scenario,
    simulate,
    verify_step,
)
from drake_nonstop.run.verify_step import moved_metrics

CONSTANT = "optimization_layer=ConstantParameters"
GENERATOR = np.random.default_rng(16)
DRAWN = nightly_beyond(2, "studies", sorted(np.round(10 ** GENERATOR.uniform(0, 7, 8), 3).tolist()))
FAST_YAW = (  # and ξ and A that move in steps, which the carriers' references follow
    "load_trajectory.roll_pitch_yaw=[0, 0, 12.566]",
    *("load_trajectory.start_time=0", "load_trajectory.move_time=6"),
    *("optimization_layer=PaperLayer", "phase=AccumulatedPhase"),
    *("carrier_trajectory.hold=velocity", "carrier_controller=CarrierPid"),
    "limits.time_below_bound=0.1",
)


def short(*overrides, duration=0.2):
    return load_scenario("quintic", [f"simulation_duration={duration}", *overrides])


@pytest.mark.parametrize("damping", DRAWN)
def test_strongly_damped_cables_are_flown_as_with_a_fifth_of_the_step_or_refused(damping):
    overrides = [f"system.cable_damping={damping}", CONSTANT]
    if damping > 1000:
        with pytest.raises(ScenarioError, match="fastest mode"):
            simulate(short(*overrides))
        return
    run = simulate(short(*overrides))
    step = run.step / 5
    if step < 1e-5:
        return
    finer = simulate(short(*overrides, f"simulator_config.max_step_size={step}"))
    assert moved_metrics(compute_metrics(run), compute_metrics(finer)) == []


class Slow(LeafSystem):
    """Parameters of its own, with a bound of its own."""

    def __init__(self, model):
        super().__init__()
        self.DeclareVectorOutputPort(
            "parameters", 2, lambda context, out: out.SetFromVector([1, 1])
        )


def test_what_is_verified_is_the_loop_that_flew():
    assert verify_step(simulate(short(), optimization_layer=Slow)).unresolved == ()


def test_what_half_the_step_moves_is_named_and_decides_the_outcome():
    run = simulate(short(*FAST_YAW, duration=2.0))
    assert compute_metrics(run)["outcome"] != "unconverged"
    verified = compute_metrics(verify_step(run))
    assert verified["outcome"] == "unconverged"
    assert verified["half_step"]["step_s"] == run.step / 2
    assert verified["half_step"]["moved"]


def test_an_interrupt_of_the_second_flight_keeps_the_first():
    run = simulate(short(duration=2.0))

    def interrupt(time):
        os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(RunInterrupted) as raised:
        verify_step(run, progress=interrupt)
    assert raised.value.run is run
