"""The shipped flight over a tower, against distances that follow from its path alone."""

import pytest

HEIGHT = 1.3 - 0.7  # m, of the load's path above the tower's top
LIFT = 2.3  # m, of the load at rest above the ground


def test_the_load_passes_over_the_tower(fleet):
    _, metrics = fleet.evaluated("quintic_over_tower")
    assert metrics["outcome"] == "ok"
    assert metrics["obstacles"]["load_distance_min_m"] == pytest.approx(HEIGHT, abs=1e-4)
    said = " ".join(metrics["obstacles"]["approaches"])
    assert f"the load came within {HEIGHT:g} m of tower" in said
    assert f"the load came within {LIFT:g} m of ground" in said
