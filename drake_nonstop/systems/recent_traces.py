"""Traces that a process keeps to use them again, bounded by their memory."""

import pickle
import threading
from collections.abc import Callable, Iterable
from typing import Any, ClassVar

import casadi

MOST_BYTES = 200e6  # of what all caches of a process hold
_BYTES_OF_INSTRUCTION = 80  # of a function, with its expressions: measured, 60 to 75


def bytes_of(value: Any) -> int:
    """Estimated memory of the functions in a value: in its attributes, or in those of its parts."""
    if isinstance(value, casadi.Function):
        is_traced = value.is_a("SXFunction")
        return _BYTES_OF_INSTRUCTION * value.n_instructions() if is_traced else 0
    if isinstance(value, casadi.SX | str):
        return 0
    if isinstance(value, dict):
        parts: Iterable[Any] = value.values()
    elif isinstance(value, list | tuple):
        parts = value
    elif type(value).__module__.partition(".")[0] == __package__.partition(".")[0]:
        parts = getattr(value, "__dict__", {}).values()
    else:  # such as a library, which refers to itself
        return 0
    return sum(map(bytes_of, parts))


class LruCache:
    """Values made for the keys that were used last.

    All caches of a process together hold no more than `MOST_BYTES`, or a value each: the largest of
    them loses what was not used for longest. Values may grow: all are measured again once a
    twentieth of that is new.
    """

    _all: ClassVar[list["LruCache"]] = []
    _new: ClassVar[float] = 0.0  # bytes, since all were measured
    _lock = threading.RLock()

    def __init__(self) -> None:
        self.entries: dict[Any, Any] = {}  # the most recently used is the last
        self._all.append(self)

    def get(self, key: Any, make: Callable[[], Any]) -> Any:
        """Returns the entry of a key, made if there is none; a key that is None has no entry."""
        if key is None:
            return make()
        with self._lock:
            found = self.entries.pop(key, None)
            is_new = found is None
            found = self.entries[key] = make() if is_new else found
            if is_new:
                LruCache._new += bytes_of(found)
                if LruCache._new > MOST_BYTES / 20:
                    self._make_room()
            return found

    def _make_room(self) -> None:
        """Removes entries until a twentieth of the room is free again."""
        LruCache._new = 0.0
        kept = [(cache.entries, [*map(bytes_of, cache.entries.values())]) for cache in self._all]
        while sum(sum(sizes) for _, sizes in kept) > 0.95 * MOST_BYTES:
            entries, sizes = max(kept, key=lambda pair: (len(pair[1]) > 1, sum(pair[1])))
            if len(sizes) == 1:
                break
            del entries[next(iter(entries))], sizes[0]


_traces = LruCache()


def recent_trace(make: Callable[[], Any], *key: Any) -> Any:
    """The value for an equal key, made if there is none; a last part None means no key."""
    return _traces.get(None if key[-1] is None else tuple(map(_hashed, key)), make)


def _hashed(key: Any) -> Any:
    """A key as it is, or pickled where it cannot be hashed."""
    try:
        hash(key)
    except TypeError:
        return pickle.dumps(key)
    return key
