"""`drake-nonstop plot`: any signals of any runs over each other."""

import argparse
from pathlib import Path

from drake_nonstop.cli.arguments import Commands, write_figure
from drake_nonstop.simulation.stored_run import load_signals
from drake_nonstop.studies.files import require_writable_file
from drake_nonstop.validation import require
from drake_nonstop.visualization.figure_style import require_drawing
from drake_nonstop.visualization.signal_figure import make_signal_figure

_FORMATS = (".png", ".pdf", ".svg")


def add_to(commands: Commands) -> None:
    """Adds the subcommand."""
    parser = commands.add_parser(
        "plot",
        help="draw any signals of any runs over each other",
        description="Draws signals over time, a panel for each quantity, with their names and "
        "units. A signal is a port, carrier_state or my_block.my_signal, or a part of one, "
        "carrier_state.positions or load_state.velocity.x; `drake-nonstop blocks` lists them.",
    )
    parser.set_defaults(action=_plot)
    parser.add_argument(
        "runs", type=Path, metavar="RUN", nargs="+", help="folders with results of runs"
    )
    parser.add_argument(
        "--signal", action="append", required=True, metavar="NAME", help="once for each signal"
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        default=Path("signals.png"),
        help=f"with a name in {', '.join(_FORMATS)} (signals.png)",
    )


def _plot(options: argparse.Namespace) -> int:
    file: Path = options.out
    require(file.suffix in _FORMATS, "--out", file, f"give a name in {', '.join(_FORMATS)}")
    require_drawing()
    require_writable_file(file)
    runs = {_label(folder, options.runs): load_signals(folder) for folder in options.runs}
    figure = make_signal_figure(runs, options.signal)
    write_figure(file, figure)
    print(f"written: {file}")
    return 0


def _label(folder: Path, folders: list[Path]) -> str:
    """What a run is called: its folder's name, or the whole path where two have the same."""
    names = [other.resolve().name for other in set(folders)]
    name = folder.resolve().name
    return str(folder) if names.count(name) > 1 else name
