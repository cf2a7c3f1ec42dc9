"""Tasks drawn at random, a few of them flown; `tests/drawn_study.py` flies all."""

import drawn_study
import numpy as np
import pytest
from drawn_study import VARIANTS, fly, study, table
from drawn_tasks import aircraft_task, carriers_task

from drake_nonstop.analysis.aircraft_margins import aircraft_margins

FAILS_TODAY = 1029  # a task on which the layer of one sample falls below the bound


def flown(seed, variant):
    result = fly("carriers", seed, "none", VARIANTS[variant])
    return result["outcome"], result["figures"]


@pytest.mark.nightly("studies")
@pytest.mark.parametrize("seed", [1001, FAILS_TODAY])
def test_the_horizon_keeps_the_bound_smoothly(seed):
    outcome, figures = flown(seed, "horizon")
    assert outcome == "ok"
    assert figures["least"] >= 1.002
    assert figures["below"] == 0
    assert figures["position_error"] <= 0.05
    assert figures["amplitude_step"] <= 0.02
    assert figures["frequency_step"] <= 0.02


@pytest.mark.nightly("studies")
def test_one_sample_ahead_does_not_keep_it():
    outcome, figures = flown(FAILS_TODAY, "one sample")
    assert outcome == "bound_missed"
    assert figures["least"] < 1 < 100 * figures["amplitude_step"]


def test_tasks_repeat_and_are_as_they_are_said_to_be():
    counts = set()
    for seed in range(2000, 2003):
        task = carriers_task(seed)
        assert task == carriers_task(seed)
        system, layer, motion = task.system, task.optimization_layer, task.load_trajectory
        n = len(system.attachments)
        counts.add(n)
        assert 3 <= n <= 8
        assert 0.5 <= system.load_mass <= 3
        assert 0.6 <= system.cable_length <= 3
        radii = np.linalg.norm(np.array(system.attachments)[:, :2], axis=1)
        assert np.all((radii >= 0.75 * 0.5) & (radii <= 1.5))
        assert 0.3 <= layer.amplitude / (system.load_mass * 9.81 / n) <= 0.6
        assert 1.2 <= layer.frequency <= 2.5
        assert np.max(np.abs(motion.displacement)) <= 2 * system.cable_length
        assert 8 <= motion.move_time <= 16
    assert len(counts) >= 2


@pytest.mark.nightly("studies")
def test_aircraft_can_fly_their_tasks_at_rest():
    for seed in (2000, 2001):
        assert aircraft_margins(aircraft_task(seed)).is_flyable


def test_a_study_goes_on_from_where_it_was_interrupted(tmp_path, monkeypatch):
    flights = []

    def fly_some(tasks, seed, condition, overrides):
        flights.append((seed, *overrides))
        if len(flights) == 4:
            raise KeyboardInterrupt
        figures = {"below": 0.1 * bool(overrides), "least": 1.1, "peak": 2.0 - seed / 2}
        outcome = "bound_missed" if overrides else "ok"
        return {"ending": "completed", "outcome": outcome, "message": "", "figures": figures}

    monkeypatch.setattr(drawn_study, "fly", fly_some)
    variants = {"first": [], "second": ["a=1"]}
    arguments = ("carriers", range(3), variants, tmp_path)
    with pytest.raises(KeyboardInterrupt, match="the same call continues"):
        study(*arguments, is_serial=True)
    results = study(*arguments, is_serial=True)
    assert len(flights) == 7  # the fourth twice
    first, second = table(results).splitlines()[-2:]
    assert first.startswith("| first | 0 of 3 | 0 | 0 | 1.100 | 1.000 (1.00)")
    assert second.startswith("| second | 3 of 3 | 0 | 0 |")
