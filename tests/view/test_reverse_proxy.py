"""Who may connect to a live page."""

import base64
import os
import socket

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drake_nonstop.view.meshcat_server import start_meshcat
from drake_nonstop.view.reverse_proxy import is_own


@pytest.fixture(scope="module")
def port():
    meshcat = start_meshcat()
    assert meshcat.GetNumActiveConnections() == 0
    yield int(meshcat.web_url().rsplit(":", 1)[1])
    meshcat.Delete()


def answer(port, host, origin):
    """The status of the answer to a request for a WebSocket."""
    key = base64.b64encode(os.urandom(16)).decode()
    lines = ["GET / HTTP/1.1", f"Host: {host}", "Upgrade: websocket", "Connection: Upgrade"]
    lines += ["Sec-WebSocket-Version: 13", f"Sec-WebSocket-Key: {key}"]
    lines += [] if origin is None else [f"Origin: {origin}"]
    with socket.create_connection(("127.0.0.1", port), timeout=20) as connection:
        connection.sendall("\r\n".join([*lines, "", ""]).encode())
        return int(connection.recv(1000).split()[1])


def test_the_own_page_and_programs_connect_and_others_are_refused(port):
    own = f"localhost:{port}"
    for origin in (f"http://{own}", None):
        assert answer(port, own, origin) == 101
    assert answer(port, f"127.0.0.1:{port}", f"http://127.0.0.1:{port}") == 101
    for origin in ("http://evil.example", "null", f"https://{own}", f"http://localhost:{port + 1}"):
        assert answer(port, own, origin) == 403
    assert answer(port, f"evil.example:{port}", f"http://evil.example:{port}") == 403


_HOSTS = st.one_of(
    st.sampled_from(["localhost", "127.0.0.1", "[::1]", "localhost.evil.example", "evil.example"]),
    st.text("lochst.:[]1", max_size=12),
)
_PORTS = st.sampled_from(["", ":7000", ":80", ":x", ":7000.evil"])


@given(host=_HOSTS, port=_PORTS, other=_HOSTS, other_port=_PORTS, twice=st.booleans())
def test_only_a_page_of_the_same_local_address_is_own(host, port, other, other_port, twice):
    head = f"GET / HTTP/1.1\r\nHost: {host}{port}\r\nOrigin: http://{other}{other_port}\r\n"
    head += f"Host: {host}{port}\r\n" if twice else ""
    is_local = host in ("localhost", "127.0.0.1") and port in ("", ":7000", ":80")
    is_same = (host, port) == (other, other_port) or f"{host}{port}" == f"{other}{other_port}"
    assert is_own(f"{head}\r\n".encode()) == (is_local and is_same and not twice)
