"""`drake-nonstop plot` and `export`: the signals of runs as figures, and in other tools' files."""

import argparse
from pathlib import Path

from drake_nonstop.cli.arguments import Commands, add_look, add_trust, write_figure
from drake_nonstop.run.run import Run
from drake_nonstop.run.stored_run import load_signals
from drake_nonstop.studies.files import require_writable_file
from drake_nonstop.validation import require
from drake_nonstop.view.figure_style import FORMATS, FigureLook
from drake_nonstop.view.run_figures import FIGURE_NAMES, make_signal_figure, plotted

_FORMATS = [f".{kind}" for kind in FORMATS]
_FILES = {
    "csv": "signals.csv",
    "parquet": "signals.parquet",
    "mcap": "run.mcap",
    "rerun": "run.rrd",
}
_TABLES = ("csv", "parquet")


def add_to(commands: Commands) -> None:
    """Adds the subcommands."""
    parser = commands.add_parser(
        "plot",
        help="draw any signals of any runs over each other, or a figure of a run",
        description="Draws signals over time, a panel for each quantity, with their names and "
        "units. A signal is a port, carrier_state or my_block.my_signal, or a part of one, "
        "carrier_state.positions or load_state.velocity.x; `drake-nonstop blocks` lists them. With "
        f"--figure it draws one of those that `run` writes: {', '.join(FIGURE_NAMES)}.",
    )
    parser.set_defaults(action=_plot)
    parser.add_argument(
        "runs", type=Path, metavar="RUN", nargs="+", help="folders with results of runs"
    )
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--signal", action="append", metavar="NAME", help="once for each signal")
    about = "a figure of one run, such as snapshots"
    what.add_argument("--figure", choices=FIGURE_NAMES, metavar="NAME", help=about)
    about = f"with a name in {', '.join(_FORMATS)} (signals.png, or NAME.png)"
    parser.add_argument("--out", type=Path, metavar="FILE", help=about)
    add_look(parser)
    add_trust(parser)
    parser = commands.add_parser(
        "export",
        help="write a run as CSV, Parquet, a bag of ROS 2 messages, or a recording of Rerun",
        description="Writes the signals of a run, from the folder with its results. Columns of CSV "
        "and Parquet have their units in their names; a bag (MCAP) has Odometry, WrenchStamped and "
        "PoseArray messages of ROS 2; a recording of Rerun has the motion in space and plots.",
        epilog="All but CSV need an extra: pip install 'drake-nonstop[export]'.",
    )
    parser.set_defaults(action=_export)
    parser.add_argument("run", type=Path, metavar="RUN", help="the folder with a run's results")
    parser.add_argument("--to", choices=_FILES, required=True, help="what to write")
    parser.add_argument(
        "--signal",
        action="append",
        default=[],
        metavar="NAME",
        help="a signal of a table, such as carrier_state; may be given again (all)",
    )
    parser.add_argument("--out", type=Path, metavar="FILE", help="(in RUN, such as signals.csv)")
    add_trust(parser)


def _plot(options: argparse.Namespace) -> int:
    file: Path = options.out or Path(f"{options.figure or 'signals'}.png")
    require(file.suffix in _FORMATS, "--out", file, f"give a name in {', '.join(_FORMATS)}")
    look = FigureLook(options.style, options.width)
    with look.applied():
        pass  # they can be drawn
    require_writable_file(file)
    if options.figure:
        remedy = "give one run with --figure; several are drawn by --signal"
        require(len(options.runs) == 1, "RUN", f"{len(options.runs)} runs", remedy)
        figure = plotted(Run.load(options.runs[0], trust=options.trust), [options.figure], look)
    else:
        runs = {_label(folder, options.runs): load_signals(folder) for folder in options.runs}
        figure = make_signal_figure(runs, options.signal, look)
    write_figure(file, figure)
    print(f"written: {file}")
    return 0


def _label(folder: Path, folders: list[Path]) -> str:
    """Name of a run: its folder's, or the whole path where two have the same."""
    names = [other.resolve().name for other in set(folders)]
    name = folder.resolve().name
    return str(folder) if names.count(name) > 1 else name


def _export(options: argparse.Namespace) -> int:
    # Imported here: other commands need none of it.
    from drake_nonstop.studies.exports import write_csv, write_mcap, write_parquet, write_rerun

    remedy = "leave it out: it is for csv and parquet; all else has its own signals"
    require(options.to in _TABLES or not options.signal, "--signal", options.signal, remedy)
    file: Path = options.out or options.run / _FILES[options.to]
    suffix = Path(_FILES[options.to]).suffix
    require(file.suffix == suffix, "--out", file, f"give a name that ends in {suffix}")
    if options.to in _TABLES:  # they need neither the scenario nor its blocks
        table = load_signals(options.run)
        require_writable_file(file)
        write_table = write_csv if options.to == "csv" else write_parquet
        write_table(table, file, options.signal)
    else:
        run = Run.load(options.run, trust=options.trust)
        require_writable_file(file)
        write = write_mcap if options.to == "mcap" else write_rerun
        write(run, file)
    print(f"written: {file}")
    return 0
