"""`drake-nonstop pictures`: the README's pictures."""

import argparse
from pathlib import Path

from drake_nonstop.cli.arguments import Commands
from drake_nonstop.studies.files import require_writable
from drake_nonstop.validation import require_installed
from drake_nonstop.visualization.figure_style import require_drawing
from drake_nonstop.visualization.progress import TaskProgress


def add_to(commands: Commands) -> None:
    """Adds the subcommand."""
    parser = commands.add_parser("pictures", help="take the README's pictures")
    parser.set_defaults(action=_pictures)
    parser.add_argument(
        "--out", type=Path, metavar="DIR", default=Path("out/pictures"), help="(out/pictures)"
    )


def _pictures(options: argparse.Namespace) -> int:
    require_installed("pictures", PIL="pillow")
    require_drawing()
    from drake_nonstop.benchmarks.browser import find_browser
    from drake_nonstop.benchmarks.pictures import FILES, make_pictures

    find_browser()
    require_writable(options.out, FILES)
    with TaskProgress() as progress:
        paths = make_pictures(options.out, progress=progress)
    for path in paths:
        print(path)
    return 0
