"""How fast and how good the solvers of the optimization layer are, and the layers themselves."""

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks import instances as drawn
from benchmarks.instances import Instance, Truth
from benchmarks.peers import Solve, casadi_ipopt, scipy_slsqp
from benchmarks.whole_tasks import ONE_SAMPLE, benchmark_tasks, tasks_table
from drake_nonstop.benchmarks.running import PACKAGES
from drake_nonstop.blocks.optimization_layer import NonstopOptimizer, NonstopOptimizerConfig
from drake_nonstop.model.system import Model
from drake_nonstop.optimization.constraints import FEASIBILITY_TOLERANCE
from drake_nonstop.optimization.update_data import UpdateData
from drake_nonstop.optimization.update_solver import Answer, UpdateSolver
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.scenario.schema import DIAGRAM
from drake_nonstop.simulation.metrics import versions
from drake_nonstop.simulation.run import StepCheck
from drake_nonstop.simulation.simulate import simulate
from drake_nonstop.systems.drake_log import drake_log_level

_SAME_COST = 1e-3  # relative, to the true optimum
_REPEATS = 3  # of each solve; its time is the median's
_SLOW = 0.02  # s; what takes longer is not repeated

# Config fields of the optimization layer by the names in the table. The bare solvers are
# alone, "+ search" is certified by the search.
SOLVERS: dict[str, dict[str, Any]] = {
    "search": {"solver": "search"},
    "snopt + search": {"solver": "snopt"},
    "snopt": {"solver": "snopt", "global_search": False},
    "ipopt": {"solver": "ipopt", "global_search": False},
    "nlopt": {"solver": "nlopt", "global_search": False},
    "grid": {"solver": "grid"},
}
PEERS: dict[str, Callable[[UpdateSolver], Solve]] = {
    "CasADi + IPOPT": casadi_ipopt,
    "SciPy SLSQP": scipy_slsqp,
}


@dataclass(frozen=True)
class Answers:
    """A solver's answers to a list of problems: times (s), costs (inf: infeasible), margins."""

    times: NDArray
    costs: NDArray
    margins: NDArray


def benchmark_optimizer(
    count: int = 1000,
    seed: int = 0,
    names: list[str] | None = None,
    tasks: Sequence[str] = (),
    progress: Callable[[str, float], None] | None = None,
) -> dict[str, Any]:
    """Runs the solvers on random instances and on the updates of `quintic`, and layers on tasks.

    Args:
        count: how many instances.
        seed: of the instances.
        names: of the solvers, out of `SOLVERS` and `PEERS`; none: all that are installed.
        tasks: scenarios that layers fly, compared with the offline optimum, see `whole_tasks`.
        progress: called with the name of a part and the share of it that is done.

    Returns:
        What `python -m tests.benchmarks optimizer` writes as JSON.
    """

    def report(what: str) -> Callable[[int], None] | None:
        if progress is None:
            return None
        return lambda done: progress(what, done / count)

    names = names or [*SOLVERS, *PEERS]
    reference = drawn.make_solvers()
    instances = drawn.draw_instances(count, seed, reference)
    truths = drawn.truths(instances, reference, report("true optima"))
    updates, share, model, config = _closed_loop()
    in_loop = [Instance("quintic", data) for data in updates]
    reference["quintic"] = UpdateSolver(model, config, str)
    loop_truths = [drawn.truth(reference["quintic"].problem(data)) for data in updates]
    random: dict[str, Any] = {}
    sequence: dict[str, Any] = {}
    with drake_log_level(logging.ERROR):  # failed solves are counted here
        for name in names:
            fields = SOLVERS.get(name, {})
            solvers = drawn.make_solvers(**fields)
            in_loop_config = NonstopOptimizerConfig(**{**vars(config), **fields})
            solvers["quintic"] = UpdateSolver(model, in_loop_config, str)
            solves = _solves(name, solvers)
            answers = _solve_all(instances, solves, reference, report(name))
            random[name] = _judge(answers, truths)
            answers = _solve_all(in_loop, solves, reference, None)
            sequence[name] = _judge(answers, loop_truths)
    costs = np.array([truth.cost for truth in truths])
    return {
        "instances": {
            "count": count,
            "seed": seed,
            "ranges": drawn.RANGES,
            "infeasible_at_previous_share": float(np.mean(costs > 0)),
            "no_feasible_point_share": float(np.mean(~np.isfinite(costs))),
            "solvers": random,
        },
        "quintic": {
            "updates": len(updates),
            "layer_share_of_wall_time": share,
            "solvers": sequence,
        },
        "whole_tasks": benchmark_tasks(tasks, progress=progress),
        "times": f"each the median of {_REPEATS} solves, of one where that took over {_SLOW} s",
        "versions": versions(*PACKAGES),
    }


def table(results: dict[str, Any]) -> str:
    """The results as text, one line per solver."""
    random, sequence = results["instances"], results["quintic"]
    return "\n".join(
        [
            f"{random['count']} instances, seed {random['seed']}: "
            f"{random['infeasible_at_previous_share']:.1%} infeasible at the previous point, "
            f"{random['no_feasible_point_share']:.1%} without any feasible point",
            *_rows(random["solvers"]),
            "",
            f"{sequence['updates']} updates of quintic; the layer took "
            f"{sequence['layer_share_of_wall_time']:.1%} of the run's wall time",
            *_rows(sequence["solvers"]),
            "",
            f"times in ms: p50 / p99 / max; {results['times']}",
            "feasible, optimal: of the solved ones; best: of those without a feasible point",
            *(["", tasks_table(results["whole_tasks"])] if results["whole_tasks"] else []),
        ]
    )


def _rows(solvers: dict[str, Any]) -> list[str]:
    times, shares = ("kept", "solved", "relaxed", "all"), ("feasible", "optimal", "best")
    rows = [" " * 15 + "".join(f"{t:>26}" for t in times) + "".join(f"{s:>10}" for s in shares)]
    for name, result in solvers.items():
        cells = [result[f"{time}_ms"] for time in times]
        rows.append(
            f"{name:15}"
            + "".join(f"{'-' if c is None else ' / '.join(_short(c)):>26}" for c in cells)
            + "".join(_percent(result[f"{share}_share"]) for share in shares)
        )
    return rows


def _short(quantiles: dict[str, float]) -> list[str]:
    return [f"{value:.3g}" if value >= 1 else f"{value:.3f}" for value in quantiles.values()]


def _percent(share: float | None) -> str:
    return f"{'-' if share is None else f'{share:.2%}':>10}"


def _closed_loop() -> tuple[list[UpdateData], float, Model, Any]:
    """The data of all updates of `quintic`, and the layer's share of the run's wall time."""
    scenario = load_scenario("quintic", ONE_SAMPLE)
    config = scenario.optimization_layer
    assert isinstance(config, NonstopOptimizerConfig)
    updates: list[UpdateData] = []
    models: list[Model] = []

    def recording(model: Model) -> NonstopOptimizer:
        block = NonstopOptimizer(model, config)
        solve = block.solver.solve

        def record(data: UpdateData) -> Answer:
            updates.append(data)
            return solve(data)

        block.solver.solve = record  # type: ignore[method-assign]
        models.append(model)
        return block

    # The diagram calls the layer for each update; the compiled loop keeps parameters by itself.
    recorded = {"optimization_layer": recording, "engine": DIAGRAM}
    simulate(scenario, check_step=StepCheck.NOTHING, **recorded)
    shares = []
    for _ in range(3):
        run = simulate(scenario, engine=DIAGRAM)
        shares.append(float(np.sum(run.solve_times)) / run.wall_time)
    # Looking for the equilibrium takes updates, too, before the run's.
    count = round(scenario.simulation_duration / config.period)
    return updates[-count:], float(np.median(shares)), models[0], config


def _solves(name: str, solvers: dict[str, UpdateSolver]) -> dict[str, Solve]:
    """The function that a solver offers for each system; feasible points are kept by all."""
    if name in SOLVERS:
        return {system: _answer_of(solver) for system, solver in solvers.items()}
    return {
        system: _unless_feasible(solver, PEERS[name](solver)) for system, solver in solvers.items()
    }


def _answer_of(solver: UpdateSolver) -> Solve:
    return lambda data: solver.solve(data).parameters


def _unless_feasible(solver: UpdateSolver, solve: Solve) -> Solve:
    def kept_or_solved(data: UpdateData) -> NDArray:
        update = solver.problem(data)
        if update.worst_margin(update.previous) >= -FEASIBILITY_TOLERANCE:
            return update.previous
        return solve(data)

    return kept_or_solved


def _solve_all(
    instances: list[Instance],
    solves: dict[str, Solve],
    reference: dict[str, UpdateSolver],
    progress: Callable[[int], None] | None,
) -> Answers:
    times, costs, margins = [], [], []
    for i, instance in enumerate(instances):
        solve, data = solves[instance.system], instance.data
        taken = []
        for _ in range(_REPEATS):
            start = time.perf_counter()
            x = solve(data)
            taken.append(time.perf_counter() - start)
            if taken[-1] > _SLOW:
                break
        times.append(float(np.median(taken)))
        update = reference[instance.system].problem(data)
        costs.append(update.feasible_cost(x))
        margins.append(update.worst_margin(x))
        if progress is not None:
            progress(i + 1)
    return Answers(np.array(times), np.array(costs), np.array(margins))


def _judge(answers: Answers, truths: list[Truth]) -> dict[str, Any]:
    """Times and shares, each for problems that are kept, solved, and without a feasible point."""
    costs = np.array([truth.cost for truth in truths])
    margins = np.array([truth.margin for truth in truths])
    kept, relaxed = costs == 0, ~np.isfinite(costs)
    solved = ~kept & ~relaxed
    optimal = answers.costs[solved] <= costs[solved] * (1 + _SAME_COST)
    largest = margins[relaxed]
    best = answers.margins[relaxed] >= largest - _SAME_COST * np.abs(largest)
    return {
        "kept_ms": _quantiles(answers.times[kept]),
        "solved_ms": _quantiles(answers.times[solved]),
        "relaxed_ms": _quantiles(answers.times[relaxed]),
        "all_ms": _quantiles(answers.times),
        "feasible_share": _mean(np.isfinite(answers.costs[solved])),
        "optimal_share": _mean(optimal),
        "best_share": _mean(best),
    }


def _quantiles(times: NDArray) -> dict[str, float] | None:
    if len(times) == 0:
        return None
    values = 1e3 * np.quantile(times, [0.5, 0.99, 1.0])
    return dict(zip(("p50", "p99", "max"), values.tolist(), strict=True))


def _mean(flags: NDArray) -> float | None:
    return float(np.mean(flags)) if len(flags) > 0 else None
