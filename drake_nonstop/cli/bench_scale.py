"""`drake-nonstop bench scale`: speed by the number of carriers."""

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
from drake_nonstop.validation import require


def add_to(commands: Commands) -> None:
    """Adds the subcommand."""
    parser = commands.add_parser(
        "scale", help="how a scenario's speed falls with the number of carriers"
    )
    parser.set_defaults(action=_bench_scale)
    add_scenario(parser, "out/bench", default="quintic")
    add_repeats(parser, 3)
    parser.add_argument("--max-n", type=int, default=64, metavar="N", help="carriers, at most (64)")
    parser.add_argument("--duration", type=float, default=3.0, metavar="S", help="of a run (3)")


def _bench_scale(options: argparse.Namespace) -> int:
    from drake_nonstop.benchmarks.figures import make_scale_figure
    from drake_nonstop.benchmarks.scaling import benchmark_scale, table

    require_repeats(options)
    require(options.duration > 0, "--duration", options.duration, "give more than 0 s")
    scenario = read_scenario(options)
    measure = partial(
        benchmark_scale,
        scenario,
        max_n=options.max_n,
        duration=options.duration,
        repeats=options.repeats,
    )
    return run_benchmark(options, "scale", measure, table, make_scale_figure)
