"""How fast and how good the solvers of the optimization layer are, on the same problems."""

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.benchmarks import instances as drawn
from drake_nonstop.benchmarks.instances import Instance, Truth
from drake_nonstop.benchmarks.peers import casadi_ipopt, scipy_slsqp
from drake_nonstop.blocks.nonstop_optimizer import NonstopOptimizer, NonstopOptimizerConfig
from drake_nonstop.scenario import load_scenario
from drake_nonstop.simulate import simulate
from drake_nonstop.speed_program import FEASIBILITY_TOLERANCE, Outcome, SpeedProgram
from drake_nonstop.system import Model
from drake_nonstop.version import __version__

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
PEERS: dict[str, Callable[[SpeedProgram], Callable[[NDArray], NDArray]]] = {
    "CasADi + IPOPT": casadi_ipopt,
    "SciPy SLSQP": scipy_slsqp,
}

Solve = Callable[[NDArray], NDArray]


@dataclass(frozen=True)
class Answers:
    """What a solver made of a list of problems: times (s), costs (inf: infeasible), margins."""

    times: NDArray
    costs: NDArray
    margins: NDArray


def benchmark_optimizer(
    count: int = 1000,
    seed: int = 0,
    names: list[str] | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> dict[str, Any]:
    """Runs the solvers on random instances and on the updates of `quintic`.

    Args:
        count: how many instances.
        seed: of the instances.
        names: of the solvers, out of `SOLVERS` and `PEERS`; none: all that are installed.
        progress: called with what is going on and the share of it that is done.

    Returns:
        What `drake-nonstop bench optimizer` writes as JSON.
    """
    names = names or [*SOLVERS, *PEERS]

    # Drake's logger tells of every failed solve; they are counted here.
    logging.getLogger("drake").setLevel(logging.ERROR)

    def report(what: str) -> Callable[[int], None] | None:
        if progress is None:
            return None
        return lambda done: progress(what, done / count)

    instances = drawn.draw_instances(count, seed)
    truths = drawn.truths(instances, report("true optima"))
    updates, share, model, config = _closed_loop()
    reference = drawn.make_programs()
    random: dict[str, Any] = {}
    sequence: dict[str, Any] = {}
    for name in names:
        try:
            solves = _solves(name, drawn.make_programs(**SOLVERS.get(name, {})))
        except ModuleNotFoundError:
            continue
        answers = _solve_all(instances, solves, reference, report(name))
        random[name] = _judge(answers, instances, truths, reference)
        fields = {**vars(config), **SOLVERS.get(name, {})}
        programs = {"quintic": SpeedProgram(model, NonstopOptimizerConfig(**fields), str)}
        in_loop = [Instance("quintic", data) for data in updates]
        answers = _solve_all(in_loop, _solves(name, programs), programs, None)
        kept = _kept(in_loop, programs)
        sequence[name] = _times(answers.times, kept)
    kept = _kept(instances, reference)
    unreachable = np.array([not np.isfinite(truth.cost) for truth in truths])
    return {
        "instances": {
            "count": count,
            "seed": seed,
            "ranges": {
                name.lower(): value
                for name, value in vars(drawn).items()
                if name.isupper() and not name.startswith("_")
            },
            "infeasible_at_previous_share": float(np.mean(~kept)),
            "no_feasible_point_share": float(np.mean(unreachable)),
            "solvers": random,
        },
        "quintic": {
            "updates": len(updates),
            "layer_share_of_wall_time": share,
            "solvers": sequence,
        },
        "versions": _versions(),
    }


def table(results: dict[str, Any]) -> str:
    """The results as text, one line per solver."""
    random, sequence = results["instances"], results["quintic"]
    head = (
        f"{random['count']} instances, seed {random['seed']}: "
        f"{random['infeasible_at_previous_share']:.1%} infeasible at the previous point, "
        f"{random['no_feasible_point_share']:.1%} without any feasible point"
    )
    columns = "kept ms", "solved ms", "feasible", "optimal", "relaxed best"
    lines = [
        head,
        f"{'':16}{columns[0]:>22}{columns[1]:>24}" + "".join(f"{c:>14}" for c in columns[2:]),
    ]
    for name, row in random["solvers"].items():
        shares = (row["feasible_share"], row["optimal_share"], row["relaxed_best_share"])
        lines.append(
            f"{name:16}{_triple(row['kept_ms']):>22}{_triple(row['solved_ms']):>24}"
            + "".join(f"{'-' if s is None else f'{s:.2%}':>14}" for s in shares)
        )
    lines += [
        "",
        f"{sequence['updates']} updates of quintic; the layer took "
        f"{sequence['layer_share_of_wall_time']:.1%} of the run's wall time",
        f"{'':16}{'kept ms':>22}{'solved ms':>24}{'all ms':>24}",
    ]
    for name, row in sequence["solvers"].items():
        triples = [row[key] for key in ("kept_ms", "solved_ms", "all_ms")]
        lines.append(
            f"{name:16}{_triple(triples[0]):>22}"
            + "".join(f"{_triple(triple):>24}" for triple in triples[1:])
        )
    return "\n".join([*lines, "times: p50 / p99 / max"])


def _triple(times: dict[str, float] | None) -> str:
    return "-" if times is None else " / ".join(f"{t:.3f}" for t in times.values())


def _closed_loop() -> tuple[list[NDArray], float, Model, Any]:
    """The data of all updates of `quintic`, and the layer's share of the run's wall time."""
    scenario = load_scenario("quintic")
    config = scenario.optimization_layer
    assert isinstance(config, NonstopOptimizerConfig)
    updates: list[NDArray] = []
    models: list[Model] = []

    def recording(model: Model) -> NonstopOptimizer:
        block = NonstopOptimizer(model, config)
        solve = block.program.solve

        def record(data: NDArray) -> tuple[NDArray, Outcome, float]:
            updates.append(data.copy())
            return solve(data)

        block.program.solve = record  # type: ignore[method-assign]
        models.append(model)
        return block

    simulate(scenario, optimization_layer=recording)
    shares = []
    for _ in range(3):
        run = simulate(scenario)
        shares.append(float(np.sum(run.solve_times)) / run.wall_time)
    count = round(scenario.duration / config.period)
    return updates[-count:], float(np.median(shares)), models[0], config


def _solves(name: str, programs: dict[str, SpeedProgram]) -> dict[str, Solve]:
    """The function that a solver offers for each system; feasible points are kept by all."""
    if name in SOLVERS:
        return {system: _answer_of(program) for system, program in programs.items()}
    return {
        system: _unless_feasible(program, PEERS[name](program))
        for system, program in programs.items()
    }


def _answer_of(program: SpeedProgram) -> Solve:
    return lambda data: program.solve(data)[0]


def _unless_feasible(program: SpeedProgram, solve: Solve) -> Solve:
    def kept_or_solved(data: NDArray) -> NDArray:
        if program.worst_margin(data[:2], data) >= -FEASIBILITY_TOLERANCE:
            return data[:2]
        return solve(data)

    return kept_or_solved


def _solve_all(
    instances: list[Instance],
    solves: dict[str, Solve],
    reference: dict[str, SpeedProgram],
    progress: Callable[[int], None] | None,
) -> Answers:
    times, costs, margins = [], [], []
    for i, instance in enumerate(instances):
        solve, program, data = solves[instance.system], reference[instance.system], instance.data
        taken = []
        for _ in range(_REPEATS):
            start = time.perf_counter()
            x = solve(data)
            taken.append(time.perf_counter() - start)
            if taken[-1] > _SLOW:
                break
        times.append(float(np.median(taken)))
        costs.append(program.feasible_cost(x, data))
        margins.append(program.worst_margin(x, data))
        if progress is not None:
            progress(i + 1)
    return Answers(np.array(times), np.array(costs), np.array(margins))


def _kept(instances: list[Instance], programs: dict[str, SpeedProgram]) -> NDArray:
    """Which problems are fulfilled by their previous parameters."""
    return np.array(
        [
            programs[instance.system].worst_margin(instance.data[:2], instance.data)
            >= -FEASIBILITY_TOLERANCE
            for instance in instances
        ]
    )


def _judge(
    answers: Answers,
    instances: list[Instance],
    truths: list[Truth],
    reference: dict[str, SpeedProgram],
) -> dict[str, Any]:
    kept = _kept(instances, reference)
    true_costs = np.array([truth.cost for truth in truths])
    true_margins = np.array([truth.margin for truth in truths])
    has_feasible = np.isfinite(true_costs)
    asked, relaxed = has_feasible & ~kept, ~has_feasible
    optimal = answers.costs[asked] <= true_costs[asked] * (1 + _SAME_COST)
    best = answers.margins[relaxed] >= true_margins[relaxed] - _SAME_COST * np.abs(
        true_margins[relaxed]
    )
    return {
        **_times(answers.times, kept),
        "feasible_share": _mean(np.isfinite(answers.costs[has_feasible])),
        "optimal_share": _mean(optimal),
        "relaxed_best_share": _mean(best),
    }


def _times(times: NDArray, kept: NDArray) -> dict[str, Any]:
    def quantiles(of: NDArray) -> dict[str, float] | None:
        if len(of) == 0:
            return None
        values = 1e3 * np.quantile(of, [0.5, 0.99, 1.0])
        return dict(zip(("p50", "p99", "max"), values.tolist(), strict=True))

    return {
        "kept_ms": quantiles(times[kept]),
        "solved_ms": quantiles(times[~kept]),
        "all_ms": quantiles(times),
    }


def _mean(flags: NDArray) -> float | None:
    return float(np.mean(flags)) if len(flags) > 0 else None


def _versions() -> dict[str, str | None]:
    found: dict[str, str | None] = {"drake_nonstop": __version__}
    for package in ("drake", "numpy", "casadi", "scipy"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = None
    return found
