"""`drake-nonstop bench accuracy`: speed and accuracy by integrator and step."""

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
        "accuracy", help="how fast and how exact a scenario's run is, by integrator and step"
    )
    parser.set_defaults(action=_bench_accuracy)
    add_scenario(parser, "out/bench", default="quintic")
    add_repeats(parser, 3)


def _bench_accuracy(options: argparse.Namespace) -> int:
    from drake_nonstop.benchmarks.accuracy import benchmark_accuracy, table

    require_repeats(options)
    scenario = read_scenario(options)
    measure = partial(benchmark_accuracy, scenario, repeats=options.repeats)
    return run_benchmark(options, "accuracy", measure, table)
