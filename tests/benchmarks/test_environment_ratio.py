"""`environment_ratio`, on few steps."""

import pytest

from benchmarks.many import environment_ratio
from drake_nonstop import load_scenario

pytest.importorskip("gymnasium")
pytestmark = pytest.mark.filterwarnings("ignore:compiled loop")


@pytest.mark.nightly("benchmarks")
def test_many_environments_make_more_steps_than_one(monkeypatch):
    monkeypatch.setenv("CC", "/bin/false")  # to compile would take longer
    found = environment_ratio(load_scenario("quintic"), n=8, repeats=1, steps=3)
    assert found["ratio"] == pytest.approx(found["steps_per_s"][8] / found["steps_per_s"][1])
    assert found["ratio"] > 3
