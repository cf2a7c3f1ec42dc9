"""The fleet has every block, pattern and outcome; each of its flights is flown once."""

import fleet as fleet_module
import numpy as np
import pytest
from fleet import BY_BOTH_ENGINES, DRAWN, FLEET, Fleet, flown, scenario_of
from registries import CHOICES

from drake_nonstop import RunOutcome, compute_metrics, load_scenario


def test_every_block_of_every_box_and_every_pattern_flies():
    scenarios = [scenario_of(name) for name in FLEET]
    for box, configs in CHOICES.items():
        assert {type(getattr(scenario, box)) for scenario in scenarios} >= {*configs}, box
    assert {len(scenario.system.attachments) for scenario in scenarios} >= {*range(3, 9)}
    assert any(scenario.reference_governor is not None for scenario in scenarios)
    assert len(BY_BOTH_ENGINES) >= 6


def test_every_outcome_is_flown(fleet):
    # Carriers that collide, and commands that are at their limits for long; whether a step resolves
    # the metrics is told where it is asked for alone.
    names = [*DRAWN, "real_scale_cycle", "aircraft_transfer_gusty"]
    outcomes = {fleet.evaluated(name)[1]["outcome"] for name in names}
    assert outcomes == {outcome.value for outcome in RunOutcome} - {RunOutcome.UNCONVERGED.value}
    stalled = fleet.evaluated("that_stalls")[1]["reasons"][0]
    assert "carrier 2 stalled at t = 1.480 s: C_L was 1.16" in stalled


def test_a_flight_is_flown_once_and_is_that_of_the_scenario(tmp_path, monkeypatch):
    short = ["simulation_duration=0.1", "optimization_layer=ConstantParameters"]
    scenario = load_scenario("quintic", short)
    expected = flown(scenario)
    store, other = Fleet(tmp_path), Fleet(tmp_path)  # as of two processes
    runs = [store.run(scenario)]
    monkeypatch.setattr(fleet_module, "flown", lambda *_, **__: pytest.fail("flown again"))
    runs += [store.run(scenario), other.run(scenario)]
    for run in runs:
        assert run.signals.keys() == expected.signals.keys()
        for name, values in expected.signals.items():
            np.testing.assert_array_equal(run.signals[name], values)
    assert other.evaluated(scenario)[1]["carriers"] == compute_metrics(expected)["carriers"]
