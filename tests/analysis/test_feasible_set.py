"""The feasible ξ and A over the time of a task, as figures show them."""

import numpy as np

from drake_nonstop import load_scenario
from drake_nonstop.analysis import feasible_parameters
from drake_nonstop.analysis.task import task_of


def shares(bound: float) -> np.ndarray:
    """The least v/ε over orbits of rising ξ beside the nominal A, at rest."""
    layer = f"optimization_layer.speed_bound={bound}"
    task = task_of(load_scenario("quintic", [layer, "simulation_duration=2"]))
    flown = np.array([0.0, 2.0]), np.tile([1.9, 1.3], (2, 1))
    _, _, ratios = feasible_parameters.set_over_time(task, flown, 0, 3)
    return ratios[0]


def test_least_speeds_over_time_are_shares_of_the_bound():
    ratios = shares(0.4)
    np.testing.assert_allclose(ratios, 2 * shares(0.8), rtol=1e-9)
    assert np.all(np.diff(ratios, prepend=0) > 0)
