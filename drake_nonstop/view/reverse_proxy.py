"""A server in front of another, which lets pages of its own address in, and no others.

Run as a script, in a process of its own, it serves a socket that listens already until its standard
input ends: `reverse_proxy.py HOST PORT DESCRIPTOR` with the address of the server behind it. It
needs nothing but Python's standard library.
"""

import asyncio
import contextlib
import os
import socket
import sys
import threading

_LONGEST_HEAD = 1 << 16  # bytes, of a request
_OWN_NAMES = ("localhost", "127.0.0.1")
_FORBIDDEN = (
    b"HTTP/1.1 403 Forbidden\r\nContent-Type: text/plain\r\nConnection: close\r\n\r\n"
    b"Open this page at the address that was printed: pages of others are refused.\n"
)


def is_own(head: bytes) -> bool:
    """Whether a request comes from a page of the server's own, or from no page.

    A browser says of every WebSocket which page opens it (Origin), so that a foreign page that
    guesses the address is known; and by which name it found the server (Host), so that a foreign
    name for this machine is known. The head is the request line and the header.
    """
    request, *lines = head.decode("latin-1").split("\r\n")
    cut = [line.partition(":") for line in lines]
    pairs = [(name.strip().lower(), value.strip().lower()) for name, _, value in cut]
    hosts = [value for name, value in pairs if name == "host"]
    origins = [value for name, value in pairs if name == "origin"]
    if not request.startswith(("GET ", "HEAD ")) or len(hosts) != 1:
        return False
    name, colon, port = hosts[0].partition(":")
    is_local = name in _OWN_NAMES and (not colon or port.isdigit())
    return is_local and all(origin == f"http://{hosts[0]}" for origin in origins)


async def _serve(host: str, port: int, listening: socket.socket) -> None:
    async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Asks the server behind each request until one opens a WebSocket, and then all."""
        behind, is_open = None, False
        with contextlib.suppress(OSError, asyncio.IncompleteReadError, asyncio.LimitOverrunError):
            while not is_open:
                head = await reader.readuntil(b"\r\n\r\n")
                if not is_own(head):
                    writer.write(_FORBIDDEN)
                    await writer.drain()
                    break
                if behind is None:
                    answers, behind = await asyncio.open_connection(host, port)
                    task = asyncio.ensure_future(_copy(answers, writer))
                    task.add_done_callback(lambda _: writer.close())
                behind.write(head)
                is_open = b"\nupgrade:" in head.lower()
            else:
                assert behind is not None
                await _copy(reader, behind)
        for end in (behind, writer):
            if end is not None:
                end.close()

    await asyncio.start_server(answer, sock=listening, limit=_LONGEST_HEAD)
    await asyncio.Event().wait()


async def _copy(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with contextlib.suppress(OSError):
        while data := await reader.read(_LONGEST_HEAD):
            writer.write(data)
            await writer.drain()


def _end_with_input() -> None:
    sys.stdin.buffer.read()
    os._exit(0)


if __name__ == "__main__":
    threading.Thread(target=_end_with_input, daemon=True).start()
    asyncio.run(_serve(sys.argv[1], int(sys.argv[2]), socket.socket(fileno=int(sys.argv[3]))))
