"""`drake-nonstop view`: shows the replay of a run in a browser."""

import argparse
import threading
import webbrowser
from pathlib import Path

from drake_nonstop.cli.arguments import Commands
from drake_nonstop.cli.file_server import serve_folder
from drake_nonstop.validation import require


def add_to(commands: Commands) -> None:
    """Adds the subcommand."""
    parser = commands.add_parser("view", help="watch the replay of a run")
    parser.set_defaults(action=_view)
    parser.add_argument("folder", type=Path, metavar="DIR", help="the results of `run`")
    parser.add_argument("--port", type=int, default=0, help="to serve it on (any that is free)")
    parser.add_argument("--no-open", action="store_true", help="leave opening it to you")


def _view(options: argparse.Namespace) -> int:
    page = options.folder / "replay.html"
    require(page.is_file(), "DIR", options.folder, "give a folder that `run` left a replay.html in")
    with serve_folder(options.folder, options.port) as address:
        address = f"{address}/replay.html"
        print(f"{address} (Ctrl-C ends it)", flush=True)
        if not options.no_open:
            webbrowser.open(address)
        threading.Event().wait()
    return 0
