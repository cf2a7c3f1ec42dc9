"""The Meshcat server that a scene is shown by."""

import errno
import logging
import secrets
import socket
import subprocess
import sys
import weakref
from pathlib import Path

from pydrake.geometry import Meshcat, MeshcatParams

from drake_nonstop.systems.drake_log import drake_log_level
from drake_nonstop.validation import ScenarioError, require

_PORTS = range(7000, 8000)  # of which the first free one is taken
_PROXY = Path(__file__).with_name("reverse_proxy.py")  # not imported: asyncio takes a while


def start_meshcat(port: int | None = None) -> Meshcat:
    """Starts a Meshcat that only this machine can reach, and only by a page of its own.

    Meshcat itself lets any web page that the user has open connect and press buttons. So it is
    served by a `reverse_proxy`, and listens where no page can find it.

    Args:
        port: where it is served; 0 for any free port, None for the first free one from 7000 on.

    Raises:
        ScenarioError: the port is taken, or is not a port number.
    """
    remedy = "give a free port from 1024 to 65535, or 0 for any"
    is_number = type(port) is int and (port == 0 or 1024 <= port <= 65535)
    require(port is None or is_number, "--port", port, remedy)
    for candidate in _PORTS if port is None else [port]:
        try:
            sockets = _listening(candidate)
            break
        except OSError:
            continue
    else:
        raise ScenarioError(f"--port = {port}: {remedy}")
    try:
        meshcat, host = start_hidden_meshcat(f"http://localhost:{sockets[0].getsockname()[1]}")
        descriptors = [each.fileno() for each in sockets]
        proxy = subprocess.Popen(
            [
                *(sys.executable, "-S", "-E", str(_PROXY)),
                *(host, str(meshcat.port()), *map(str, descriptors)),
            ],
            stdin=subprocess.PIPE,
            pass_fds=descriptors,
            start_new_session=True,  # Ctrl-C is not meant for it
        )
    finally:
        for each in sockets:
            each.close()
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


def _listening(port: int) -> list[socket.socket]:
    """Sockets that listen at the port of localhost, by IPv4 and where there is it, by IPv6.

    Raises:
        OSError: the port is taken.
    """
    first = socket.create_server(("127.0.0.1", port))
    try:
        port = first.getsockname()[1]
        return [first, socket.create_server(("::1", port), family=socket.AF_INET6)]
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            first.close()
            raise
        return [first]  # there is no IPv6


def _end(proxy: subprocess.Popen) -> None:
    assert proxy.stdin is not None
    proxy.stdin.close()
    proxy.wait()
