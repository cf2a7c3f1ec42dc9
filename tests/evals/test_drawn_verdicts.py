"""What `check` says of drawn tasks, beside a few flights; `tests/drawn_verdicts.py` flies many."""

import pytest
from drawn_verdicts import (
    CANNOT,
    SOUND,
    UNKNOWN,
    contradicts,
    looked_at,
    table,
    task_of_seed,
    verdict_of,
)
from helpers import nightly_beyond

from drake_nonstop.scenario.loading import load_scenario, scenario_names


def result(verdict, outcome):
    return {"verdict": verdict, "said": [], "outcome": outcome, "reasons": []}


def test_tasks_repeat_and_one_in_five_is_of_aircraft():
    for seed in range(1, 6):
        task = task_of_seed(seed)
        assert task == task_of_seed(seed)
        assert (task.system.aircraft is not None) == (seed == 5)
        assert task.speed_bound > 0


def test_verdicts_are_contradicted_by_what_they_judge_alone():
    for outcome in ("collision", "cables_slack", "bound_missed", "load_lost", "stopped"):
        assert contradicts(result(SOUND, outcome))
        assert not contradicts(result(CANNOT, outcome))
        assert not contradicts(result(UNKNOWN, outcome))
    assert contradicts(result(CANNOT, "ok"))
    for outcome in ("ok", "unconverged"):
        assert not contradicts(result(SOUND, outcome))


def test_the_table_counts_each_pair():
    shown = table([result(SOUND, "ok"), result(SOUND, "ok"), result(CANNOT, "collision")])
    assert "| verdict | collision | ok |" in shown
    assert "| sound | 0 | 2 |" in shown
    assert "| cannot | 1 | 0 |" in shown


SHIPPED = ["aircraft_rest", *scenario_names()]


@pytest.mark.parametrize("name", nightly_beyond(1, "studies", dict.fromkeys(SHIPPED)))
def test_no_shipped_flight_contradicts_what_is_said_of_it(name, fleet):
    scenario = load_scenario(name)
    verdict, said = verdict_of(scenario)
    _, metrics = fleet.evaluated(scenario)
    found = {"verdict": verdict, "outcome": metrics["outcome"]}
    assert not contradicts(found), [*said, *metrics["reasons"]]


@pytest.mark.parametrize("seed", nightly_beyond(1, "studies", [8, 1, 2, 4, 6, 7, 9, 11, 12, 13]))
def test_no_flight_contradicts_what_is_said_of_its_task(seed):
    found = looked_at(seed)
    assert found["verdict"] != UNKNOWN
    assert not contradicts(found), [*found["said"], *found["reasons"]]
