"""`drake-nonstop bench optimizer`: the solvers of the optimization layer, and whole tasks."""

import argparse
from functools import partial
from pathlib import Path

from drake_nonstop.cli.arguments import Commands
from drake_nonstop.cli.bench_results import run_benchmark
from drake_nonstop.scenario.loading import scenario_names
from drake_nonstop.validation import require, require_seed


def add_to(commands: Commands) -> None:
    """Adds the subcommand."""
    parser = commands.add_parser(
        "optimizer",
        help="the optimization layer: solvers on random and recorded problems, whole tasks",
        description="Solvers of the optimization layer on random problems and on those of a run, "
        "and layers that fly whole tasks, compared with the best plan that knows all of a task.",
    )
    parser.set_defaults(action=_bench_optimizer)
    parser.add_argument("--instances", type=int, default=1000, metavar="N", help="(1000)")
    parser.add_argument("--seed", type=int, default=0, help="of the instances (0)")
    parser.add_argument(
        "--solvers", nargs="+", metavar="NAME", default=[], help="these only, of all in the table"
    )
    parser.add_argument(
        "--tasks",
        nargs="*",
        metavar="NAME",
        help="scenarios that layers fly (line, quintic, three_carriers, real_scale_spread)",
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", default=Path("out/bench"), help="(out/bench)"
    )


def _bench_optimizer(options: argparse.Namespace) -> int:
    # Imported here: other commands need none of it, and it takes its time.
    from drake_nonstop.benchmarks.optimizer import (
        PEERS,
        SOLVERS,
        benchmark_optimizer,
        is_installed,
        table,
    )
    from drake_nonstop.benchmarks.whole_tasks import TASKS

    known = [*SOLVERS, *PEERS]
    for name in options.solvers:
        require(name in known, "--solvers", name, f"give some of {', '.join(known)}")
        require(is_installed(name), "--solvers", name, "install SciPy, the extra bench")
    require(options.instances > 0, "--instances", options.instances, "give at least 1")
    require_seed("--seed", options.seed)
    tasks = TASKS if options.tasks is None else options.tasks
    for name in tasks:
        require(name in scenario_names(), "--tasks", name, f"give some of {', '.join(TASKS)}")
    measure = partial(benchmark_optimizer, options.instances, options.seed, options.solvers, tasks)
    return run_benchmark(options, "optimizer", measure, table)
