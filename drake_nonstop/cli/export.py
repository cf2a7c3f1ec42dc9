"""`drake-nonstop export`: write a run as CSV, Parquet, a bag of ROS 2, or a recording of Rerun."""

import argparse
from pathlib import Path

from drake_nonstop.cli.arguments import Commands, add_trust
from drake_nonstop.run.run import Run
from drake_nonstop.run.stored_run import load_signals
from drake_nonstop.studies.exports import write_csv, write_mcap, write_parquet, write_rerun
from drake_nonstop.studies.files import require_writable_file
from drake_nonstop.validation import require

_TABLES = {"csv": ("signals.csv", write_csv), "parquet": ("signals.parquet", write_parquet)}
_RUNS = {"mcap": ("run.mcap", write_mcap), "rerun": ("run.rrd", write_rerun)}


def add_to(commands: Commands) -> None:
    """Adds the subcommand."""
    parser = commands.add_parser(
        "export",
        description="Writes the signals of a run, from the folder with its results. Columns of CSV "
        "and Parquet have their units in their names; a bag (MCAP) has Odometry and WrenchStamped "
        "messages of ROS 2; a recording of Rerun has the motion in space and plots.",
        epilog="All but CSV need an extra: pip install 'drake-nonstop[export]'.",
    )
    parser.set_defaults(action=_export)
    parser.add_argument("run", type=Path, metavar="RUN", help="the folder with a run's results")
    parser.add_argument("--to", choices=[*_TABLES, *_RUNS], required=True, help="what to write")
    parser.add_argument(
        "--signal",
        action="append",
        default=[],
        metavar="NAME",
        help="a signal of a table, such as carrier_state; may be given again (all)",
    )
    parser.add_argument("--out", type=Path, metavar="FILE", help="(in RUN, such as signals.csv)")
    add_trust(parser)


def _export(options: argparse.Namespace) -> int:
    is_table = options.to in _TABLES
    remedy = "leave it out: it is for csv and parquet; all else has its own signals"
    require(is_table or not options.signal, "--signal", options.signal, remedy)
    name = (_TABLES | _RUNS)[options.to][0]
    file: Path = options.out or options.run / name
    suffix = Path(name).suffix
    require(file.suffix == suffix, "--out", file, f"give a name that ends in {suffix}")
    if is_table:  # they need neither the scenario nor its blocks
        table = load_signals(options.run)
        require_writable_file(file)
        _TABLES[options.to][1](table, file, options.signal)
    else:
        run = Run.load(options.run, trust=options.trust)
        require_writable_file(file)
        _RUNS[options.to][1](run, file)
    print(f"written: {file}")
    return 0
