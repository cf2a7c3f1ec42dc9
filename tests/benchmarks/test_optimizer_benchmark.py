"""The benchmark of layers, on one task."""

import pytest

from benchmarks.__main__ import main
from benchmarks.whole_tasks import benchmark_tasks, tasks_table
from drake_nonstop.cli.ending import BAD_INPUT
from drake_nonstop.planning.horizon_solver import PLAN_TOLERANCE

pytestmark = pytest.mark.nightly("benchmarks")


def test_layers_are_compared_with_the_offline_optimum():
    short = ["simulation_duration=5", "load_trajectory.move_time=4"]
    slow = ["load_trajectory.displacement=[0.4, 0.4, 0.4]", "optimization_layer.speed_bound=0.55"]
    results = benchmark_tasks(["quintic"], [*short, *slow])
    one_sample, horizon, offline = results["quintic"].values()
    assert 0 <= offline["slack"] <= PLAN_TOLERANCE
    for row in (one_sample, horizon, offline):
        assert row["least_of_bound"] == pytest.approx(1.02, abs=0.01)
    # The planned flight of an ideal loop is that of the simulated one.
    assert horizon["speed_squared_m2_s"] == pytest.approx(offline["speed_squared_m2_s"], rel=0.02)
    assert 0.999 * offline["cost"] <= horizon["cost"] <= 1.1 * offline["cost"]
    assert offline["deviation"] < one_sample["deviation"]
    assert one_sample["cost"] is None
    table = tasks_table(results)
    assert all(layer in table for layer in ("one sample", "horizon", "offline optimum"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--tasks", "circle"], "--tasks = circle: give some of line"),
    ],
)
def test_bad_options_are_named(arguments, message, tmp_path, capsys):
    assert main(["optimizer", "--out", str(tmp_path), *arguments]) == BAD_INPUT
    assert message in capsys.readouterr().err
