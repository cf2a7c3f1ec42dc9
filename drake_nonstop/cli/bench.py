"""`drake-nonstop bench`: measurements of speed, a subcommand each."""

from drake_nonstop.cli import bench_engines, bench_run
from drake_nonstop.cli.arguments import Commands, add_moved


def add_to(commands: Commands) -> None:
    """Adds the subcommand."""
    parser = commands.add_parser("bench", help="measure speed")
    benches = parser.add_subparsers(required=True, metavar="WHAT")
    bench_run.add_to(benches)
    bench_engines.add_to(benches)
    add_moved(benches, "optimizer", "viewer", "accuracy", "scale")
