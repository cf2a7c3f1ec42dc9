"""Tasks drawn at random, a few of them flown; `tests/drawn_study.py` and others fly all."""

import drawn_study
import drawn_verdicts
import numpy as np
import pytest
from drawn_study import VARIANTS, fly, study, table
from drawn_tasks import aircraft_task, carriers_task
from drawn_verdicts import CANNOT, MIXED, OK, TASKS, contradicts, looked_at, task_of_seed
from helpers import nightly_beyond

from drake_nonstop.analysis.aircraft_margins import aircraft_margins
from drake_nonstop.analysis.stated_errors import without_errors

FAILS_TODAY = 1029  # a task on which the layer of one sample falls below the bound


def flown(seed, variant):
    figures = fly("carriers", seed, "none", VARIANTS[variant])
    return figures["outcome"], figures


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


def test_variants_are_compared_on_the_tasks_that_both_complete(monkeypatch):
    def fly_none(tasks, seed, condition, overrides):
        if seed == 2 and overrides:
            return {"ending": "diverged", "outcome": "", "message": "no"}
        figures = dict.fromkeys(("amplitude_step", "frequency_step", "least_tension"), 0.1)
        figures |= {"below": 0.1 * bool(overrides), "least": 1.1, "peak": 2.0 + bool(overrides)}
        outcome = "bound_missed" if overrides else "ok"
        figures |= {"speed_squared": 4.0, "position_error": float(seed)}
        return {"ending": "completed", "outcome": outcome, "message": "", **figures}

    monkeypatch.setattr(drawn_study, "fly", fly_none)
    rows = study("carriers", range(3), {"first": [], "second": ["a=1"]}, is_serial=True)
    first, second = table(rows).splitlines()[-2:]
    assert first.startswith("| first | 0 of 3 | 0 | 0 | 1.100 | 1.000 (1.00) | 1.000 | 1 (2) |")
    assert second.startswith("| second | 2 of 3 | 1 | 0 | 1.100 | 1.500 (1.50) | 1.000 | 0.5 (1)")


def result(verdict, *outcomes):
    return {"verdict": verdict, "said": [], "outcomes": list(outcomes)}


def test_tasks_of_verdicts_repeat_and_one_in_five_is_of_aircraft():
    for seed in range(1, 6):
        task = task_of_seed(seed)
        assert task == task_of_seed(seed)
        assert (task.system.aircraft is not None) == (seed == 5)
        assert without_errors(task) == task
        assert without_errors(TASKS["errors"](seed)) != TASKS["errors"](seed)


def test_verdicts_are_contradicted_by_flights_in_other_seeds():
    assert contradicts(result(OK, "ok", "collision"))
    assert contradicts(result(f"{CANNOT}, narrow", "collision", "ok"))
    for kept in (result(OK, "ok"), result(CANNOT, "stalled"), result(MIXED, "ok", "stopped")):
        assert not contradicts(kept)
    table = [result(OK, "ok", "ok"), result(OK, "ok"), result(CANNOT, "ok")]
    shown = drawn_verdicts.table(table)
    assert "| ok | 2 | 3 | 3 | 0 |" in shown
    assert "| cannot | 1 | 1 | 1 | 1 |" in shown


@pytest.mark.parametrize("kind", TASKS)
@pytest.mark.parametrize("seed", nightly_beyond(1, "studies", [8, 1, 2, 4, 5, 6, 7]))
def test_no_flight_contradicts_what_is_said_of_its_task(kind, seed):
    found = looked_at(kind, seed)
    assert not contradicts(found), found["said"]
