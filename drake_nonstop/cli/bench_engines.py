"""`drake-nonstop bench engines`: the compiled loop against its diagram."""

import argparse
from functools import partial

from drake_nonstop.cli.arguments import (
    Commands,
    add_repeats,
    add_scenario,
    read_scenario,
    require_repeats,
)
from drake_nonstop.cli.bench_results import run_benchmark


def add_to(commands: Commands) -> None:
    """Adds the subcommand."""
    parser = commands.add_parser(
        "engines", help="how much faster than its diagram a scenario's compiled loop flies"
    )
    parser.set_defaults(action=_bench_engines)
    add_scenario(parser, "out/bench", default="quintic")
    add_repeats(parser, 5)


def _bench_engines(options: argparse.Namespace) -> int:
    from drake_nonstop.benchmarks.engines import benchmark_engines, table

    require_repeats(options)
    scenario = read_scenario(options)
    measure = partial(benchmark_engines, scenario, repeats=options.repeats)
    return run_benchmark(options, "engines", measure, table)
