"""`drake-nonstop bench optimizer`: the solvers of the optimization layer."""

import argparse
from functools import partial
from pathlib import Path

from drake_nonstop.cli.arguments import Commands
from drake_nonstop.cli.bench_results import run_benchmark
from drake_nonstop.validation import require, require_seed


def add_to(commands: Commands) -> None:
    """Adds the subcommand."""
    parser = commands.add_parser(
        "optimizer", help="the solvers of the optimization layer, on random and recorded problems"
    )
    parser.set_defaults(action=_bench_optimizer)
    parser.add_argument("--instances", type=int, default=1000, metavar="N", help="(1000)")
    parser.add_argument("--seed", type=int, default=0, help="of the instances (0)")
    parser.add_argument(
        "--solvers", nargs="+", metavar="NAME", default=[], help="these only, of all in the table"
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

    known = [*SOLVERS, *PEERS]
    for name in options.solvers:
        require(name in known, "--solvers", name, f"give some of {', '.join(known)}")
        require(is_installed(name), "--solvers", name, "install SciPy, the extra bench")
    require(options.instances > 0, "--instances", options.instances, "give at least 1")
    require_seed("--seed", options.seed)
    measure = partial(benchmark_optimizer, options.instances, options.seed, options.solvers)
    return run_benchmark(options, "optimizer", measure, table)
