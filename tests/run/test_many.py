"""Many runs together are those that `simulate` makes of each alone, to the bit."""

import os
import signal
import warnings

import pytest
from helpers import assert_same_run, nightly_beyond

from drake_nonstop import (
    Run,
    RunsInterrupted,
    RunStopped,
    ScenarioError,
    ScenarioWarning,
    load_scenario,
    simulate,
    simulate_many,
)

CONSTANT = "optimization_layer=ConstantParameters"
SHORT = [CONSTANT, "simulation_duration=0.3"]
COMPILED = {"engine": "compiled"}


def flown(scenarios):
    """The runs of many together, and of each alone, after it is held that these tell the same."""
    runs, told = [], []
    for call in (
        lambda: simulate_many(scenarios, **COMPILED),
        lambda: [simulate(each, **COMPILED) for each in scenarios],
    ):
        with warnings.catch_warnings(record=True) as found:
            warnings.simplefilter("always", ScenarioWarning)
            runs.append(call())
        told.append(sorted(str(each.message) for each in found))
    assert told[0] == told[1]
    return runs


GUST = "load_disturbance=!DisturbanceForce {{gust_force: {}, seed: 3, start_time: 0.01}}"
CASES = {
    "constant": (
        [*SHORT, GUST.format(0.0)],
        [
            ["simulated.load_mass=0.9", GUST.format(0.1), "limits.slack_time=1"],
            ["simulated.load_mass=1.1", GUST.format(0.2), "simulation_duration=0.104"],
            ["system.cable_stiffness=400", GUST.format(0.3)],
            ["optimization_layer.frequency=1.9", "wrench_controller.position_gain=12"],
            [GUST.format(0.2), "carrier_controller.velocity_gain=3"],
        ],
    ),
    "planned": (
        ["simulation_duration=0.12", GUST.format(0.0)],
        [
            ["optimization_layer.speed_bound=0.5", "system.load_mass=1.1"],
            ["optimization_layer.speed_bound=0.4", GUST.format(0.2)],
        ],
    ),
    "other loops": (
        [CONSTANT, "simulation_duration=0.06"],
        [
            ["system.attachments=[[0.8, 0.8, 0], [-0.8, 0.8, 0], [-0.8, -0.8, 0], [0.8, -0.8, "
             "0]]"],
            ["load_trajectory.move_time=8"],
            ["control_period=0"],  # is not compiled
        ],
    ),
}  # fmt: skip


@pytest.mark.parametrize(("common", "numbers"), nightly_beyond(2, "engines", CASES.values()))
def test_runs_are_those_of_simulate(common, numbers):
    for run, alone in zip(
        *flown([load_scenario("quintic", [*common, *own]) for own in numbers]), strict=True
    ):
        assert run.scenario == alone.scenario
        assert_same_run(run, alone)


def test_what_is_wrong_or_diverges_has_a_row_of_its_own_and_harms_no_other():
    wrong, right = load_scenario("quintic", SHORT), load_scenario("quintic", SHORT)
    wrong.system.load_mass = -1.0
    diverging = load_scenario(
        "quintic", [CONSTANT, "simulation_duration=1", "wrench_controller.velocity_gain=400"]
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ScenarioWarning)
        found = simulate_many([wrong, right, diverging, right], **COMPILED)
        with pytest.raises(RunStopped) as stopped:
            simulate(diverging, **COMPILED)
    assert isinstance(found[0], ScenarioError)
    assert "load_mass" in str(found[0])
    assert isinstance(found[2], RunStopped)
    assert 0 < found[2].run.time[-1] < 1
    assert str(found[2]) == str(stopped.value)
    assert_same_run(found[2].run, stopped.value.run)
    expected = simulate(right, **COMPILED)
    assert_same_run(found[1], expected)
    assert_same_run(found[3], expected)


def test_an_interrupt_keeps_the_runs_that_have_ended():
    scenarios = [load_scenario("quintic", own) for own in (SHORT, SHORT, [CONSTANT])]

    def interrupt(share):
        os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(RunsInterrupted, match="1 of 3 runs have ended") as raised:
        simulate_many(scenarios, progress=interrupt, **COMPILED)
    assert [isinstance(run, Run) for run in raised.value.runs] == [True, False, False]
