"""What all of `drake-nonstop bench` do with their results."""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from drake_nonstop.cli.exit_codes import FAILED
from drake_nonstop.simulation.run import RunStopped
from drake_nonstop.studies.files import replacing_file, require_writable, write_json
from drake_nonstop.visualization.figure_style import require_drawing
from drake_nonstop.visualization.progress import TaskProgress


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
        print(f"drake-nonstop: {stopped}", file=sys.stderr)
        return FAILED
    try:
        write_json(path, results)
    finally:  # also where there is no room for the file
        print(table(results))
    if make_figure is not None:
        with replacing_file(folder / f"{name}.png") as file:
            make_figure(results).savefig(file, format="png", dpi=150)
    print(f"results: {path}")
    return 0
