"""Steps: shortened where they have to be, checked with half of them, and said if unresolved."""

import dataclasses
import os
import signal

import numpy as np
import pytest
from helpers import nightly_beyond
from pydrake.systems.framework import LeafSystem

from drake_nonstop import (
    RunInterrupted,
    ScenarioError,
    StepAction,
    StepCheck,
    compute_metrics,
    load_scenario,
    simulate,
    verify_step,
)
from drake_nonstop.run.moved_metrics import moved_metrics

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
    overrides = [f"system.cable_damping={damping}", "simulation_duration=0.2", CONSTANT]
    if damping > 1000:
        with pytest.raises(ScenarioError, match="fastest mode"):
            simulate(load_scenario("quintic", overrides))
        return
    run = simulate(load_scenario("quintic", overrides), check_step=StepCheck.NOTHING)
    step = run.step / 5
    if step < 1e-5:
        return
    finer = simulate(
        load_scenario("quintic", [*overrides, f"simulator_config.max_step_size={step}"]),
        check_step=StepCheck.NOTHING,
    )
    assert moved_metrics(compute_metrics(run), compute_metrics(finer)) == []


class Slow(LeafSystem):
    """Parameters of its own, with a bound of its own."""

    def __init__(self, model):
        super().__init__()
        self.DeclareVectorOutputPort(
            "parameters", 2, lambda context, out: out.SetFromVector([1, 1])
        )


def test_what_is_verified_is_the_loop_that_flew():
    run = simulate(short(), optimization_layer=Slow, check_step=StepCheck.NOTHING)
    again = simulate(
        dataclasses.replace(run.scenario, simulation_duration=0.2),
        optimization_layer=Slow,
        check_step=StepCheck.NOTHING,
    )
    assert verify_step(run).unresolved == verify_step(again).unresolved == ()


def test_an_interrupt_of_the_second_flight_keeps_the_first_and_its_doubt():
    calls = []

    def progress(time):
        calls.append(time)
        if len(calls) > 1 and time <= calls[-2]:  # the second flight
            os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(RunInterrupted) as raised:
        simulate(short(*FAST_YAW, duration=2.0), progress=progress)
    run = raised.value.run
    assert run.time[-1] == pytest.approx(2.0)
    assert compute_metrics(run)["outcome"] == "unconverged"


def test_what_is_called_after_each_step_sees_one_flight():
    times = []

    def after_step(simulator, nonstop):
        times.append(simulator.get_context().get_time())
        return StepAction.CONTINUE

    run = simulate(short(*FAST_YAW, duration=2.0), after_step=after_step)
    assert times == sorted(times)
    assert compute_metrics(run)["outcome"] == "unconverged"
