"""The fleet has every block, pattern and outcome; each of its flights is flown once."""

import contextlib

import fleet as fleet_module
import numpy as np
import pytest
from fleet import BY_BOTH_ENGINES, DRAWN, FLEET, Fleet, flown, scenario_of

from drake_nonstop import compute_metrics, load_scenario
from drake_nonstop.diagrams.nonstop import BOXES
from drake_nonstop.run.outcome import RunOutcome
from drake_nonstop.scenario.choices import PATTERNS

SHORT = load_scenario(
    "quintic", ["simulation_duration=0.1", "optimization_layer=ConstantParameters"]
)


def test_every_block_of_every_box_and_every_pattern_flies():
    scenarios = [scenario_of(name) for name in FLEET]
    for box, variants in BOXES.items():
        flying = {type(getattr(scenario, box)) for scenario in scenarios}
        assert flying >= {*variants.configs}, box
    assert {type(scenario.pattern) for scenario in scenarios} == {*PATTERNS}
    assert {len(scenario.system.attachments) for scenario in scenarios} >= {*range(3, 9)}
    assert any(scenario.reference_governor is not None for scenario in scenarios)
    assert len(BY_BOTH_ENGINES) >= 6


def test_every_outcome_is_flown(fleet):
    # Carriers that collide, and commands that are at their limits for long; whether a step resolves
    # the metrics is told where it is asked for alone.
    names = [*DRAWN, "real_scale_cycle", "aircraft_transfer_gusty"]
    outcomes = {fleet.evaluated(name)[1]["outcome"] for name in names}
    assert outcomes == {outcome.value for outcome in RunOutcome} - {RunOutcome.UNCONVERGED.value}


def assert_same(run, expected):
    assert run.signals.keys() == expected.signals.keys()
    for name, values in expected.signals.items():
        np.testing.assert_array_equal(run.signals[name], values)
    for name, values in expected.steps.items():
        if name != "solve_time":  # measured with a clock
            np.testing.assert_array_equal(run.steps[name], values)


@pytest.fixture
def store(tmp_path):
    with contextlib.closing(Fleet(tmp_path)) as made:
        yield made


def test_a_flight_is_flown_once_and_is_that_of_the_scenario(store, tmp_path, monkeypatch):
    fresh = flown(SHORT)
    stores = [store, Fleet(tmp_path)]  # as of two processes
    runs = [stores[0].run(SHORT)]
    monkeypatch.setattr(fleet_module, "flown", lambda *_, **__: pytest.fail("flown again"))
    runs += [stores[0].run(SHORT), stores[1].run(SHORT)]
    for run in runs:
        assert_same(run, fresh)
    metrics, expected = stores[1].evaluated(SHORT)[1], compute_metrics(fresh)
    assert metrics["carriers"] == expected["carriers"]
    assert metrics["load"] == expected["load"]
