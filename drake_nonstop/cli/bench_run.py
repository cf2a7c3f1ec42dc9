"""`drake-nonstop bench run`: the speed of a scenario, or of two, compared."""

import argparse
from functools import partial

from drake_nonstop.cli.arguments import Commands, add_repeats, add_scenario, require_repeats
from drake_nonstop.cli.bench_results import run_benchmark


def add_to(commands: Commands) -> None:
    """Adds the subcommand."""
    parser = commands.add_parser(
        "run",
        help="how fast a scenario runs and where the time goes, or faster than with what",
        description="Times a scenario and its blocks. With --against or --against-revision it is "
        "run in turns with itself otherwise, for a ratio that other load on the machine spares.",
    )
    parser.set_defaults(action=_bench_run)
    add_scenario(parser, "out/bench")
    add_repeats(parser, 5)
    parser.add_argument(
        "--against",
        nargs="+",
        action="extend",
        default=[],
        metavar="PATH=VALUE",
        help="compare with these overrides besides, as in --set",
    )
    parser.add_argument(
        "--against-revision",
        metavar="REV",
        help="compare with this git revision of the checkout",
    )


def _bench_run(options: argparse.Namespace) -> int:
    from drake_nonstop.benchmarks import comparing, running
    from drake_nonstop.benchmarks.figures import make_run_time_figure

    require_repeats(options)
    source = comparing.Source(options.scenario, options.set, options.trust)
    source.load()  # what is wrong with it is said before a folder is made
    if options.against or options.against_revision is not None:
        measure = partial(
            comparing.compare,
            source,
            options.against,
            options.against_revision,
            repeats=options.repeats,
        )
        return run_benchmark(options, "comparison", measure, comparing.table)
    measure = partial(running.benchmark_run, source, repeats=options.repeats)
    return run_benchmark(options, "run", measure, running.table, make_run_time_figure)
