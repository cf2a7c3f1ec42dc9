"""The benchmark of the optimizer, on few problems."""

import json

import numpy as np
import pytest

from drake_nonstop.benchmarks import instances as drawn
from drake_nonstop.benchmarks.optimizer import PEERS
from drake_nonstop.cli.main import BAD_INPUT, main
from drake_nonstop.optimization.speed_program import FEASIBILITY_TOLERANCE, Outcome


@pytest.fixture(scope="module")
def programs():
    return drawn.make_programs()


@pytest.fixture(scope="module")
def instances(programs):
    return drawn.draw_instances(60, 1, programs)


@pytest.fixture(scope="module")
def truths(instances, programs):
    return [drawn.truth(programs[i.system], i.data) for i in instances]


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "drake_nonstop"


def is_feasible(program, x, data):
    return program.worst_margin(x, data) >= -FEASIBILITY_TOLERANCE


def test_instances_depend_on_the_seed_and_their_number_alone(instances, programs):
    again = drawn.draw_instances(3, 1, programs)
    for one, other in zip(instances, again, strict=False):
        assert one.system == other.system
        np.testing.assert_array_equal(one.data, other.data)
    assert not np.array_equal(drawn.draw_instances(1, 2, programs)[0].data, instances[0].data)


def test_instances_are_of_all_kinds(instances, truths, programs):
    kept = [is_feasible(programs[i.system], i.data[:2], i.data) for i in instances]
    unreachable = [not np.isfinite(truth.cost) for truth in truths]
    assert np.mean(kept) <= 0.5
    assert np.mean(kept) > 0.1
    assert np.mean(unreachable) >= 0.05
    assert {i.system for i in instances} == set(programs)


def test_search_finds_the_true_optima(instances, truths, programs):
    for instance, truth in zip(instances, truths, strict=True):
        program, data = programs[instance.system], instance.data
        x, outcome, _ = program.solve(data)
        if np.isfinite(truth.cost):
            assert outcome in (Outcome.KEPT, Outcome.SOLVED)
            assert is_feasible(program, x, data)
            assert program.cost(x, data) == pytest.approx(truth.cost, rel=1e-3)
        else:
            assert outcome in (Outcome.RELAXED, Outcome.HELD)
            assert program.worst_margin(x, data) == pytest.approx(truth.margin, rel=1e-3)


def test_no_random_point_is_better_than_the_truth(instances, truths, programs):
    rng = np.random.default_rng(4)
    for instance, truth in zip(instances[:20], truths, strict=False):
        program, data = programs[instance.system], instance.data
        lower, upper = program.bounds(data[:2])
        points = np.exp(rng.uniform(np.log(lower), np.log(upper), (300, 2)))
        costs = [program.feasible_cost(x, data) for x in points]
        assert truth.cost <= min(costs)
        assert truth.margin >= max(program.worst_margin(x, data) for x in points) or np.isfinite(
            truth.cost
        )


def test_truths_are_cached(instances, truths, programs, cache):
    few = instances[:3]
    assert drawn.truths(few, programs) == truths[:3]
    (file,) = cache.iterdir()
    with np.load(file) as cached:
        np.savez(file, truths=cached["truths"] + 1)
    changed = drawn.truths(few, programs)
    assert [truth.margin for truth in changed] == [truth.margin + 1 for truth in truths[:3]]
    file.write_bytes(b"no archive")
    assert drawn.truths(few, programs) == truths[:3]


@pytest.mark.parametrize("name", PEERS)
def test_peers_solve_what_is_near_by(name, programs):
    program = programs["cycle of 4"]
    solve = PEERS[name](program)
    ratios = []
    for instance in drawn.draw_instances(40, 3, programs):
        data = instance.data.copy()
        if instance.system != "cycle of 4":
            continue
        # A bound that the previous point just misses.
        unit = np.sqrt(program.worst_margin(data[:2], data) + 1) * data[58] * 1.02
        data[57:59] = unit
        x, outcome, _ = program.solve(data)
        assert outcome == Outcome.SOLVED
        ratios.append(program.feasible_cost(solve(data), data) / program.cost(x, data))
    # Single starts may miss the optimum, but none is beaten.
    assert len(ratios) >= 4
    assert min(ratios) >= 1 - 1e-4
    assert np.median(ratios) <= 1.01


def test_command_prints_a_table_and_writes_json(tmp_path, capsys):
    out = tmp_path / "bench"
    names = ["search", "SciPy SLSQP"]
    arguments = ["bench", "optimizer", "--instances", "4", "--out", str(out)]
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


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--solvers", "gurobi"], "--solvers = gurobi: give some of search"),
        (["--instances", "0"], "--instances = 0: give at least 1"),
        (["--seed", "-1"], "--seed = -1: give 0 or"),
    ],
)
def test_bad_options_are_named(arguments, message, tmp_path, capsys):
    assert main(["bench", "optimizer", "--out", str(tmp_path), *arguments]) == BAD_INPUT
    assert message in capsys.readouterr().err
