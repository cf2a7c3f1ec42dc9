"""`drake-nonstop view`: serves the replay of a run to a browser on this machine."""

import argparse
import contextlib
import functools
import os
import sys
import threading
import webbrowser
from collections.abc import Iterator
from http import HTTPStatus
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from drake_nonstop.cli.arguments import Commands
from drake_nonstop.validation import ScenarioError, require


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


class _OwnHandler(SimpleHTTPRequestHandler):
    """Answers requests of pages at this machine's own names, with files inside of the folder."""

    def send_head(self) -> Any:
        """The file that is asked for, as the base has it; None: the request is refused."""
        from drake_nonstop.view.reverse_proxy import are_own  # with asyncio

        hosts, origins = (self.headers.get_all(name, []) for name in ("Host", "Origin"))
        if not are_own(hosts, origins):
            self.send_error(HTTPStatus.FORBIDDEN, "Open this page at the address that was printed")
            return None
        if not self._is_inside():
            self.send_error(HTTPStatus.NOT_FOUND, "File not found")
            return None
        return super().send_head()

    def _is_inside(self) -> bool:
        """Whether what may be read for this request is in the folder, and no link leads out."""
        path = self.translate_path(self.path)
        if "\0" in path:
            return False
        folder = os.path.realpath(self.directory)
        read = [path, *(os.path.join(path, page) for page in ("index.html", "index.htm"))]
        return all(Path(os.path.realpath(file)).is_relative_to(folder) for file in read)

    def log_message(self, format: str, *args: object) -> None:
        """Says nothing of requests."""


class _Server(ThreadingHTTPServer):
    def handle_error(self, request: Any, client_address: Any) -> None:
        """Says nothing of a browser that goes before it has all of a file."""
        if not isinstance(sys.exc_info()[1], OSError):
            super().handle_error(request, client_address)


@contextlib.contextmanager
def serve_folder(folder: Path, port: int = 0) -> Iterator[str]:
    """Serves the files of a folder, to this machine alone, and yields the address.

    Pages of other addresses are refused, and so are links that lead out of the folder.

    Raises:
        ScenarioError: the port is taken or none.
    """
    handler = functools.partial(_OwnHandler, directory=str(folder))
    try:
        server = _Server(("localhost", port), handler)
    except (OSError, OverflowError):
        raise ScenarioError(f"--port = {port}: give a free port, or 0 for any") from None
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://localhost:{server.server_port}"
    finally:
        server.shutdown()
        server.server_close()
