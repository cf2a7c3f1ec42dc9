"""Processes: those below this one, the slowness of the machine, and ends that are certain."""

import contextlib
import ctypes
import os
import signal
import time
from pathlib import Path

_PR_SET_CHILD_SUBREAPER = 36


def become_subreaper() -> None:
    """Makes this process the parent of processes below it that lose theirs."""
    ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def descendants(root: int) -> list[int]:
    """The processes below one that are alive, parents first."""
    children: dict[int, list[int]] = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with contextlib.suppress(OSError, IndexError):
                state, parent = (entry / "stat").read_text().rpartition(")")[2].split()[:2]
                if state not in "ZX":
                    children.setdefault(int(parent), []).append(int(entry.name))
    found, waiting = [], [root]
    while waiting:
        below = children.get(waiting.pop(), [])
        found += below
        waiting += below
    return found


def command_line(process: int) -> str:
    with contextlib.suppress(OSError):
        return Path(f"/proc/{process}/cmdline").read_bytes().replace(b"\0", b" ").decode()[:150]
    return "?"


def end_all_below(root: int) -> None:
    """Kills the processes below one, and those that these start in the meantime."""
    for _ in range(20):
        found = descendants(root)
        if not found:
            return
        for process in found:
            with contextlib.suppress(OSError):
                os.kill(process, signal.SIGKILL)
        reap()
        time.sleep(0.02)


def reap() -> None:
    """Forgets children that have ended. For a process that waits for none by itself."""
    with contextlib.suppress(OSError):
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass


def slowness() -> float:
    """How much longer than on an idle machine things may take now.

    The load is that of the last minute, or of this instant where that is more.
    """
    running = int(Path("/proc/loadavg").read_text().split()[3].partition("/")[0])
    return min(max(1.0, max(os.getloadavg()[0], running) / (os.cpu_count() or 1)), 4.0)
