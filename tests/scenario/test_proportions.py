"""What is out of proportion in a scenario, as a user is told."""

import warnings

import pytest

from drake_nonstop import ScenarioError, ScenarioWarning, load_scenario, scenario_names, simulate
from drake_nonstop.cli import check as command
from drake_nonstop.cli.ending import BAD_INPUT
from drake_nonstop.cli.main import main
from drake_nonstop.run.run import RunStopped, StepCheck
from drake_nonstop.scenario.proportions import PROPORTIONS, out_of_proportion, warn_of_angles

CONSTANT = "optimization_layer=ConstantParameters"
NOISY = "load_feedback=!NoisyFeedback"
MILLIMETRES = "[[750, 0, 0], [0, 750, 0], [-750, 0, 0], [0, -750, 0]]"
MISTAKEN = {
    "control_period": ["control_period=10", CONSTANT],
    "load_feedback.period": [NOISY + " {period: 10}"],
    "load_feedback.delay": [NOISY + " {delay: 5}"],
    "load_feedback.position_noise": [NOISY + " {position_noise: 1.0}"],
    "load_feedback.orientation_noise": [NOISY + " {orientation_noise: 1.0}"],
    "load_feedback.velocity_noise": [NOISY + " {velocity_noise: 5.0}"],
    "load_feedback.angular_velocity_noise": [NOISY + " {angular_velocity_noise: 5.0}"],
    "system.attachments": [f"system.attachments={MILLIMETRES}"],
    "system.cable_length": ["system.cable_length=800"],
    "system.cable_stiffness": ["system.cable_stiffness=0.5"],
    "optimization_layer.amplitude": ["optimization_layer.amplitude=122"],
}


@pytest.mark.parametrize("field", [row.field for row in PROPORTIONS])
def test_each_quantity_is_named_where_it_is_out_of_proportion(field):
    (sentence,) = out_of_proportion(load_scenario("quintic", MISTAKEN[field]))
    assert sentence.startswith(f"{field} = ")


def test_shipped_scenarios_are_in_proportion():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for name in scenario_names():
            scenario = load_scenario(name)
            assert not out_of_proportion(scenario)
            warn_of_angles(scenario)


@pytest.mark.slow
@pytest.mark.parametrize(
    "field",
    ["system.cable_length", "optimization_layer.amplitude", "load_feedback.orientation_noise"],
)
@pytest.mark.filterwarnings("ignore::drake_nonstop.ScenarioWarning")
def test_a_divergence_says_what_is_out_of_proportion_and_the_gains(field):
    scenario = load_scenario("quintic", [CONSTANT, *MISTAKEN[field], "simulation_duration=3"])
    with pytest.raises(RunStopped) as stopped:
        simulate(scenario, check_step=StepCheck.NOTHING)
    message = str(stopped.value)
    assert f"; {field} = " in message
    assert "the loop may be unstable" not in message
    assert "; gains in use: wrench_controller.position_gain = " in message
    assert ", carrier_controller.velocity_gain = 10" in message


def test_a_divergence_without_such_a_cause_has_its_gains():
    scenario = load_scenario("quintic", [CONSTANT, "wrench_controller.position_gain=1e5"])
    with pytest.raises(RunStopped) as stopped:
        simulate(scenario, check_step=StepCheck.NOTHING)
    assert "gains in use: wrench_controller.position_gain = 1e+05" in str(stopped.value)


def test_a_step_that_would_be_too_short_says_what_is_out_of_proportion():
    with pytest.raises(
        ScenarioError, match=r"fastest mode = .*; system\.attachments = 750 is 938 times"
    ):
        simulate(load_scenario("quintic", MISTAKEN["system.attachments"]))


def test_angles_in_degrees_get_a_hint(monkeypatch, capsys):
    change = "load_trajectory.start_roll_pitch_yaw=[0, 0, 45]"
    words = r"load_trajectory\.start_roll_pitch_yaw = .*45.*: an angle beyond 2π.*degrees given\?"
    with pytest.warns(ScenarioWarning, match=words):
        simulate(load_scenario("quintic", [change, "simulation_duration=0.01"]))

    def refuse(scenario):
        warn_of_angles(scenario)
        raise ScenarioError("no more")

    monkeypatch.setattr(command, "warn_of_angles", refuse)  # before what takes longer
    assert main(["check", "quintic", "--set", change]) == BAD_INPUT
    assert "degrees given?" in capsys.readouterr().err
