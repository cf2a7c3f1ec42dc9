"""The benchmark of the optimizer, on few problems."""

import json

import numpy as np
import pytest

from benchmarks import instances as drawn
from benchmarks.__main__ import main
from benchmarks.optimizer import PEERS
from benchmarks.whole_tasks import benchmark_tasks, tasks_table
from drake_nonstop.cli.ending import BAD_INPUT
from drake_nonstop.optimization.constraints import FEASIBILITY_TOLERANCE
from drake_nonstop.optimization.diagnostics import Outcome
from drake_nonstop.optimization.horizon_solver import PLAN_TOLERANCE

pytestmark = pytest.mark.nightly("benchmarks")


@pytest.fixture(scope="module")
def solvers():
    return drawn.make_solvers()


@pytest.fixture(scope="module")
def instances(solvers):
    return drawn.draw_instances(30, 1, solvers)


@pytest.fixture(scope="module")
def truths(instances, solvers):
    return [drawn.truth(solvers[i.system].problem(i.data)) for i in instances]


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "drake_nonstop"


def is_feasible(problem, x):
    return problem.worst_margin(x) >= -FEASIBILITY_TOLERANCE


def test_instances_depend_on_the_seed_and_their_number_alone(instances, solvers):
    again = drawn.draw_instances(3, 1, solvers)
    for one, other in zip(instances, again, strict=False):
        assert one.system == other.system
        np.testing.assert_array_equal(np.concatenate(one.data), np.concatenate(other.data))
    other_seed = drawn.draw_instances(1, 2, solvers)[0]
    assert not np.array_equal(np.concatenate(other_seed.data), np.concatenate(instances[0].data))


def test_instances_are_of_all_kinds(instances, truths, solvers):
    problems = [solvers[i.system].problem(i.data) for i in instances]
    kept = [is_feasible(problem, problem.previous) for problem in problems]
    unreachable = [not np.isfinite(truth.cost) for truth in truths]
    assert np.mean(kept) <= 0.5
    assert np.mean(kept) > 0.1
    assert np.mean(unreachable) >= 0.05
    assert {i.system for i in instances} == set(solvers)


def test_search_finds_the_true_optima(instances, truths, solvers):
    for instance, truth in zip(instances, truths, strict=True):
        solver, data = solvers[instance.system], instance.data
        problem = solver.problem(data)
        x, outcome, _ = solver.solve(data)
        if np.isfinite(truth.cost):
            assert outcome in (Outcome.KEPT, Outcome.SOLVED)
            assert is_feasible(problem, x)
            assert problem.cost(x) == pytest.approx(truth.cost, rel=1e-3)
        else:
            assert outcome in (Outcome.RELAXED, Outcome.HELD)
            assert problem.worst_margin(x) == pytest.approx(truth.margin, rel=1e-3)


def test_no_random_point_is_better_than_the_truth(instances, truths, solvers):
    rng = np.random.default_rng(4)
    for instance, truth in zip(instances[:20], truths, strict=False):
        problem = solvers[instance.system].problem(instance.data)
        lower, upper = problem.bounds
        points = np.exp(rng.uniform(np.log(lower), np.log(upper), (300, 2)))
        costs = [problem.feasible_cost(x) for x in points]
        assert truth.cost <= min(costs)
        assert truth.margin >= max(problem.worst_margin(x) for x in points) or np.isfinite(
            truth.cost
        )


def test_truths_are_cached(instances, truths, solvers, cache):
    few = instances[:3]
    assert drawn.truths(few, solvers) == truths[:3]
    (file,) = cache.iterdir()
    with np.load(file) as cached:
        np.savez(file, truths=cached["truths"] + 1)
    changed = drawn.truths(few, solvers)
    assert [truth.margin for truth in changed] == [truth.margin + 1 for truth in truths[:3]]
    file.write_bytes(b"no archive")
    assert drawn.truths(few, solvers) == truths[:3]


@pytest.mark.parametrize("name", PEERS)
def test_peers_solve_what_is_near_by(name, solvers):
    solver = solvers["cycle of 4"]
    solve = PEERS[name](solver)
    ratios = []
    for instance in drawn.draw_instances(40, 3, solvers):
        data = instance.data
        if instance.system != "cycle of 4":
            continue
        # A bound that the previous point just misses.
        worst = solver.problem(data).worst_margin(data.previous)
        bound = np.sqrt(worst + 1) * data.speed_unit * 1.02
        data = data._replace(speed_bound=bound, speed_unit=bound)
        x, outcome, _ = solver.solve(data)
        assert outcome == Outcome.SOLVED
        problem = solver.problem(data)
        ratios.append(problem.feasible_cost(solve(data)) / problem.cost(x))
    # Single starts may miss the optimum, but none is beaten.
    assert len(ratios) >= 4
    assert min(ratios) >= 1 - 1e-4
    assert np.median(ratios) <= 1.01


def test_command_prints_a_table_and_writes_json(tmp_path, capsys):
    out = tmp_path / "bench"
    names = ["search", "SciPy SLSQP"]
    arguments = ["optimizer", "--instances", "4", "--tasks", "--out", str(out)]
    assert main([*arguments, "--solvers", *names]) == 0
    text = capsys.readouterr().out
    results = json.loads((out / "optimizer.json").read_text())
    for part in ("instances", "quintic"):
        assert list(results[part]["solvers"]) == names
    assert all(name in text for name in names)
    search = results["instances"]["solvers"]["search"]
    assert search["feasible_share"] == search["optimal_share"] == 1
    assert 0 < results["quintic"]["layer_share_of_wall_time"] < 0.5
    assert results["quintic"]["updates"] == 1500
    bounds = results["instances"]["ranges"]["speed_bound_m_s"]
    assert bounds == list(drawn.RANGES["speed_bound_m_s"])
    assert results["quintic"]["solvers"]["search"]["optimal_share"] == 1
    assert {path.name for path in out.iterdir()} == {"optimizer.json"}


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
        (["--solvers", "gurobi"], "--solvers = gurobi: give some of search"),
        (["--instances", "0"], "--instances = 0: give at least 1"),
        (["--seed", "-1"], "--seed = -1: give 0 or"),
        (["--tasks", "circle"], "--tasks = circle: give some of line"),
    ],
)
def test_bad_options_are_named(arguments, message, tmp_path, capsys):
    assert main(["optimizer", "--out", str(tmp_path), *arguments]) == BAD_INPUT
    assert message in capsys.readouterr().err
