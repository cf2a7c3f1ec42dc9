"""`drake-nonstop bench viewer`: the cost of a live view."""

import argparse
from functools import partial

from drake_nonstop.cli.arguments import Commands, add_scenario, read_scenario
from drake_nonstop.cli.bench_results import run_benchmark


def add_to(commands: Commands) -> None:
    """Adds the subcommand."""
    parser = commands.add_parser("viewer", help="what a live view of a scenario costs")
    parser.set_defaults(action=_bench_viewer)
    add_scenario(parser)


def _bench_viewer(options: argparse.Namespace) -> int:
    from drake_nonstop.benchmarks.viewer import benchmark_viewer, table

    scenario = read_scenario(options)
    return run_benchmark(options, "viewer", partial(benchmark_viewer, scenario), table)
