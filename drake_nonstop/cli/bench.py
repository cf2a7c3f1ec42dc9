"""`drake-nonstop bench`: measurements of speed and quality, a subcommand each."""

from drake_nonstop.cli import (
    bench_accuracy,
    bench_engines,
    bench_optimizer,
    bench_run,
    bench_scale,
    bench_viewer,
)
from drake_nonstop.cli.arguments import Commands


def add_to(commands: Commands) -> None:
    """Adds the subcommand."""
    parser = commands.add_parser("bench", help="measure speed and quality")
    benches = parser.add_subparsers(required=True, metavar="WHAT")
    benches_of = (
        bench_optimizer,
        bench_viewer,
        bench_run,
        bench_engines,
        bench_accuracy,
        bench_scale,
    )
    for bench in benches_of:
        bench.add_to(benches)
