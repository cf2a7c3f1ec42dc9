"""The shipped flight over a tower, against distances that follow from its path alone."""

import pytest
from fleet import scenario_of

from drake_nonstop.analysis.planned_motion import PlannedMotion
from drake_nonstop.analysis.task import task_of

NAME = "quintic_over_tower"
HEIGHT = 1.3 - 0.7  # m, of the load's path above the tower's top
LIFT = 2.3  # m, of the load at rest above the ground


def test_the_load_passes_over_the_tower(fleet):
    _, metrics = fleet.evaluated(NAME)
    assert metrics["outcome"] == "ok"
    assert metrics["obstacles"]["load_distance_min_m"] == pytest.approx(HEIGHT, abs=1e-4)
    said = " ".join(metrics["obstacles"]["approaches"])
    assert f"the load came within {HEIGHT:g} m of tower" in said
    assert f"the load came within {LIFT:g} m of ground" in said


def test_the_planned_motion_tells_the_same():
    scenario = scenario_of(NAME)
    motion = PlannedMotion(scenario, task_of(scenario))
    assert motion.is_flyable
    assert motion.obstacle_distance("load") == pytest.approx(HEIGHT, abs=1e-4)
