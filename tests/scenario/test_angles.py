"""Angles in degrees in a scenario, as a user is told."""

import warnings

import pytest

from drake_nonstop import ScenarioError, ScenarioWarning, load_scenario, scenario_names, simulate
from drake_nonstop.cli import check as command
from drake_nonstop.cli.ending import BAD_INPUT
from drake_nonstop.cli.main import main
from drake_nonstop.scenario.fields import warn_of_angles


def test_shipped_scenarios_have_none():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for name in scenario_names():
            warn_of_angles(load_scenario(name))


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
