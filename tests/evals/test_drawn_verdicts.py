"""What `check` says of drawn tasks, beside a few flights; `tests/drawn_verdicts.py` flies many."""

import pytest
from drawn_verdicts import CANNOT, MIXED, OK, TASKS, contradicts, looked_at, table, task_of_seed
from helpers import nightly_beyond

from drake_nonstop.analysis.stated_errors import without_errors


def result(verdict, *outcomes):
    return {"verdict": verdict, "said": [], "outcomes": list(outcomes)}


def test_tasks_repeat_and_one_in_five_is_of_aircraft():
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
    shown = table([result(OK, "ok", "ok"), result(OK, "ok"), result(CANNOT, "ok")])
    assert "| ok | 2 | 3 | 3 | 0 |" in shown
    assert "| cannot | 1 | 1 | 1 | 1 |" in shown


@pytest.mark.parametrize("kind", TASKS)
@pytest.mark.parametrize("seed", nightly_beyond(1, "studies", [8, 1, 2, 4, 5, 6, 7]))
def test_no_flight_contradicts_what_is_said_of_its_task(kind, seed):
    found = looked_at(kind, seed)
    assert not contradicts(found), found["said"]
