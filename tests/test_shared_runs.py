"""The runs that tests share are those that studies fly."""

import numpy as np
import pytest
import shared_runs

from drake_nonstop import compute_metrics, load_scenario
from drake_nonstop.studies.run_all import fly


def test_a_shared_run_is_simulated_once_and_is_that_of_the_scenario(tmp_path, monkeypatch):
    scenario = load_scenario(
        "quintic", ["simulation_duration=0.1", "optimization_layer=ConstantParameters"]
    )
    fresh = fly(scenario)
    stores = [shared_runs.SharedRuns(tmp_path) for _ in range(2)]  # as of two processes
    runs = [stores[0].run(scenario)]
    monkeypatch.setattr(shared_runs, "fly", lambda scenario: pytest.fail("flown again"))
    runs += [stores[0].run(scenario), stores[1].run(scenario)]
    for run in runs:
        assert run.signals.keys() == fresh.signals.keys()
        for name, values in fresh.signals.items():
            np.testing.assert_array_equal(run.signals[name], values)
        for name, values in fresh.steps.items():
            np.testing.assert_array_equal(run.steps[name], values)
    metrics, expected = stores[1].evaluated(scenario)[1], compute_metrics(fresh)
    assert metrics["carriers"] == expected["carriers"]
    assert metrics["load"] == expected["load"]


def test_a_shared_run_cannot_be_changed(tmp_path):
    scenario = load_scenario(
        "quintic", ["simulation_duration=0.1", "optimization_layer=ConstantParameters"]
    )
    run = shared_runs.SharedRuns(tmp_path).run(scenario)
    with pytest.raises(ValueError, match="read-only"):
        run.signal("load_state")[0, 0] = 1.0
