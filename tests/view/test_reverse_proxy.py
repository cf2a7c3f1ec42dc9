"""Who may connect to a live page."""

import itertools
import socket

import pytest

from drake_nonstop import start_meshcat


@pytest.fixture(scope="module")
def port():
    meshcat = start_meshcat()
    assert meshcat.GetNumActiveConnections() == 0
    yield int(meshcat.web_url().rsplit(":", 1)[1])
    meshcat.Delete()


def is_let_in(port, *fields):
    """Whether a request for a WebSocket is answered by one, and not refused."""
    lines = ["GET / HTTP/1.1", "Upgrade: websocket", "Connection: Upgrade", *fields]
    lines += ["Sec-WebSocket-Version: 13", "Sec-WebSocket-Key: bWVzaGNhdCBvZiBvdXJzIQ=="]
    with socket.create_connection(("127.0.0.1", port), timeout=20) as connection:
        connection.sendall("\r\n".join([*lines, "", ""]).encode())
        status = int(connection.recv(1000).split()[1])
    assert status in (101, 403)
    return status == 101


def test_only_pages_of_the_same_local_address_and_programs_are_let_in(port):
    names = "localhost", "127.0.0.1", "[::1]", "localhost.evil.example", "evil.example", "l"
    hosts = [f"{name}{end}" for name in names for end in (f":{port}", ":80", "", ":x", ":80.evil")]
    own = [f"{name}{end}" for name in names[:2] for end in (f":{port}", ":80", "")]
    for host in hosts:
        assert is_let_in(port, f"Host: {host}") == (host in own), host
    for host, other in itertools.product(own[::2], hosts):
        is_own = is_let_in(port, f"Host: {host}", f"Origin: http://{other}")
        assert is_own == (host == other), (host, other)
    host = f"Host: {own[0]}"
    for more in (host, "Origin: null", f"Origin: https://{own[0]}", "Origin: http://localhost:1"):
        assert not is_let_in(port, host, f"Origin: http://{own[0]}", more)
