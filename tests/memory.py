"""What a process of the suite frees."""

import contextlib
import ctypes
import gc
import os
from pathlib import Path

from pydrake.systems.framework import LeafSystem

from drake_nonstop import LeafBlock

MOST = 500_000_000  # bytes: a process with less does not look for what it can free
_STATISTICS = Path("/proc/self/statm")

_next = MOST  # the memory in bytes at which the process looks again


def free_memory() -> None:
    """Frees diagrams that nothing uses any more, in a process that has grown.

    Systems that tests derive from Drake's in Python are never freed, nor what they refer to: their
    attributes are cleared.
    """
    global _next
    if not _STATISTICS.exists() or _resident() < _next:
        return
    for thing in gc.get_objects():
        if isinstance(thing, LeafSystem):
            is_drakes = type(thing).__module__.startswith("pydrake")
            if not is_drakes and not isinstance(thing, LeafBlock):
                vars(thing).clear()
    gc.collect()
    with contextlib.suppress(OSError, AttributeError):  # another C library than GNU's
        ctypes.CDLL("libc.so.6").malloc_trim(0)
    _next = max(MOST, _resident() + MOST // 5)


def _resident() -> int:
    """The memory of this process in bytes."""
    return int(_STATISTICS.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
