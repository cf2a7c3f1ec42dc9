"""`drake-nonstop plot`: draw any signals of any runs over each other, or a figure of a run."""

import argparse
from pathlib import Path

from drake_nonstop.cli.arguments import Commands, add_trust, write_figure
from drake_nonstop.run.run import Run
from drake_nonstop.run.stored_run import load_signals
from drake_nonstop.studies.files import require_writable_file
from drake_nonstop.validation import require
from drake_nonstop.view.figure_style import FORMATS
from drake_nonstop.view.run_figures import FIGURES, make_figure, make_signal_figure

_SUFFIXES = [f".{kind}" for kind in FORMATS]


def add_to(commands: Commands) -> None:
    """Adds the subcommand."""
    parser = commands.add_parser(
        "plot",
        description="Draws signals over time, a panel for each quantity, with their names and "
        "units. A signal is a port, carrier_state or my_block.my_signal, or a part of one, "
        "carrier_state.positions or load_state.velocity.x; `drake-nonstop blocks` lists them. With "
        f"--figure it draws one of those that `run` writes: {', '.join(FIGURES)}.",
    )
    parser.set_defaults(action=_plot)
    parser.add_argument(
        "runs", type=Path, metavar="RUN", nargs="+", help="folders with results of runs"
    )
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--signal", action="append", metavar="NAME", help="once for each signal")
    about = "a figure of one run, such as snapshots"
    what.add_argument("--figure", choices=FIGURES, metavar="NAME", help=about)
    about = f"with a name in {', '.join(_SUFFIXES)} (signals.png, or NAME.png)"
    parser.add_argument("--out", type=Path, metavar="FILE", help=about)
    add_trust(parser)


def _plot(options: argparse.Namespace) -> int:
    file: Path = options.out or Path(f"{options.figure or 'signals'}.png")
    require(file.suffix in _SUFFIXES, "--out", file, f"give a name in {', '.join(_SUFFIXES)}")
    require_writable_file(file)
    if options.figure:
        remedy = "give one run with --figure; several are drawn by --signal"
        require(len(options.runs) == 1, "RUN", f"{len(options.runs)} runs", remedy)
        figure = make_figure(Run.load(options.runs[0], trust=options.trust), options.figure)
    else:
        names = [folder.resolve().name for folder in options.runs]
        if len({*names}) < len(names):  # where two have the same, the whole path
            names = [str(folder) for folder in options.runs]
        runs = dict(zip(names, map(load_signals, options.runs), strict=True))
        figure = make_signal_figure(runs, options.signal)
    write_figure(file, figure)
    print(f"written: {file}")
    return 0
