"""`drake-nonstop pictures`: the README's pictures."""

import argparse
from pathlib import Path

from drake_nonstop.cli.arguments import Commands
from drake_nonstop.studies.files import require_writable
from drake_nonstop.visualization.progress import TaskProgress


def add_to(commands: Commands) -> None:
    """Adds the subcommand."""
    parser = commands.add_parser("pictures", help="take the README's pictures of the line task")
    parser.set_defaults(action=_pictures)
    parser.add_argument(
        "--out", type=Path, metavar="DIR", default=Path("out/pictures"), help="(out/pictures)"
    )


def _pictures(options: argparse.Namespace) -> int:
    # Imported here: it needs Pillow and, in the end, a browser.
    from drake_nonstop.benchmarks.pictures import make_pictures

    require_writable(options.out)
    with TaskProgress() as progress:
        paths = make_pictures(options.out, progress=progress)
    for path in paths:
        print(path)
    return 0
