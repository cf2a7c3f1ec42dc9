"""`drake-nonstop bench`: measurements of speed, a subcommand each."""

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from drake_nonstop.cli.arguments import (
    Commands,
    add_changes,
    add_repeats,
    add_scenario,
    read_scenario,
    require_repeats,
    write_figure,
)
from drake_nonstop.cli.ending import FAILED, complain
from drake_nonstop.run.run import RunStopped
from drake_nonstop.studies.files import require_writable, write_json
from drake_nonstop.view.figure_style import require_drawing
from drake_nonstop.view.progress import TaskProgress


def add_to(commands: Commands) -> None:
    """Adds the subcommand."""
    parser = commands.add_parser("bench", help="measure speed")
    benches = parser.add_subparsers(required=True, metavar="WHAT")
    run = benches.add_parser(
        "run",
        help="how fast a scenario runs and where the time goes, or faster than with what",
        description="Times a scenario and its blocks. With --against or --against-revision it is "
        "run in turns with itself otherwise, for a ratio that other load on the machine spares.",
    )
    run.set_defaults(action=_bench_run)
    add_scenario(run, "out/bench")
    add_repeats(run, 5)
    add_changes(run, "--against", "compare with these overrides besides, as in --set")
    about = "compare with this git revision of the checkout"
    run.add_argument("--against-revision", metavar="REV", help=about)
    about = "how much faster than its diagram a scenario's compiled loop flies"
    engines = benches.add_parser("engines", help=about)
    engines.set_defaults(action=_bench_engines)
    add_scenario(engines, "out/bench", default="quintic")
    add_repeats(engines, 5)


def _bench_run(options: argparse.Namespace) -> int:
    from drake_nonstop.benchmarks import comparing, running
    from drake_nonstop.benchmarks.figures import make_run_time_figure

    require_repeats(options)
    source = comparing.Source(options.scenario, options.set, options.trust)
    source.load()  # what is wrong with it is said before a folder is made
    if options.against or options.against_revision is not None:
        against = options.against, options.against_revision
        measure = partial(comparing.compare, source, *against, repeats=options.repeats)
        return run_benchmark(options, "comparison", measure, comparing.table)
    measure = partial(running.benchmark_run, source, repeats=options.repeats)
    return run_benchmark(options, "run", measure, running.table, make_run_time_figure)


def _bench_engines(options: argparse.Namespace) -> int:
    from drake_nonstop.benchmarks.engines import benchmark_engines, table

    require_repeats(options)
    measure = partial(benchmark_engines, read_scenario(options), repeats=options.repeats)
    return run_benchmark(options, "engines", measure, table)


def run_benchmark(
    options: argparse.Namespace,
    name: str,
    benchmark: Callable[..., dict[str, Any]],
    table: Callable[[dict[str, Any]], str],
    make_figure: Callable[[dict[str, Any]], Any] | None = None,
) -> int:
    """Runs a benchmark, writes its results and prints their table; returns the exit code.

    Args:
        options: `out` is the folder of the results, or None for out/bench.
        name: of the files NAME.json and, with a figure, NAME.png.
        benchmark: called with `progress=`; returns the results.
        table: the results as text.
        make_figure: the results as a Matplotlib figure.
    """
    if make_figure is not None:
        require_drawing()
    folder: Path = options.out or Path("out/bench")
    path = folder / f"{name}.json"
    require_writable(folder, [path.name] + ([f"{name}.png"] if make_figure is not None else []))
    try:
        with TaskProgress() as progress:
            results = benchmark(progress=progress)
    except RunStopped as stopped:
        complain(str(stopped))
        return FAILED
    try:
        write_json(path, results)
    finally:  # also where there is no room for the file
        print(table(results))
    if make_figure is not None:
        write_figure(folder / f"{name}.png", make_figure(results))
    print(f"results: {path}")
    return 0
