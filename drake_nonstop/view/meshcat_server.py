"""The Meshcat server that a scene is shown by."""

import logging
import secrets
import socket
import subprocess
import sys
import weakref
from pathlib import Path

from pydrake.geometry import Meshcat, MeshcatParams

from drake_nonstop.systems.drake_log import drake_log_level

_PROXY = Path(__file__).with_name("reverse_proxy.py")  # not imported: asyncio takes a while


def start_meshcat() -> Meshcat:
    """Starts a Meshcat that only this machine can reach, and only through its own page.

    Any web page that is open in a browser could connect to Meshcat itself, and press its buttons.
    Therefore a `reverse_proxy` serves it.
    """
    with socket.create_server(("127.0.0.1", 0)) as listening:
        meshcat, host = start_hidden_meshcat(f"http://localhost:{listening.getsockname()[1]}")
        command = [sys.executable, "-S", "-E", str(_PROXY), host, str(meshcat.port())]
        proxy = subprocess.Popen(
            [*command, str(listening.fileno())],
            stdin=subprocess.PIPE,
            pass_fds=[listening.fileno()],
            start_new_session=True,  # Ctrl-C is not meant for it
        )
    weakref.finalize(meshcat, _end, proxy)
    return meshcat


def start_hidden_meshcat(url: str = "http://localhost:{port}") -> tuple[Meshcat, str]:
    """A Meshcat at an address of this machine that cannot be guessed, and that address.

    The Meshcat gives `url` as its own.
    """
    # One of 2^24 addresses, times 2^15 ports.
    host = ".".join(["127", *(str(secrets.choice(range(1, 255))) for _ in range(3))])
    with drake_log_level(logging.WARNING):
        return Meshcat(MeshcatParams(host=host, port=0, web_url_pattern=url)), host


def _end(proxy: subprocess.Popen) -> None:
    assert proxy.stdin is not None
    proxy.stdin.close()
    proxy.wait()
