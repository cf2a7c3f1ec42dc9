"""Processes for runs that have nothing to do with each other."""

import contextlib
import signal
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from multiprocessing.synchronize import Event

_end: Event | None = None  # in a worker: set where nobody waits for it any more


@contextlib.contextmanager
def worker_processes() -> Iterator[ProcessPoolExecutor]:
    """One per core; what has not begun is dropped where the block ends by an error or Ctrl-C.

    What has begun is waited for; where that may take long, it asks `is_ending`.
    """
    context = get_context("spawn")
    end = context.Event()
    executor = ProcessPoolExecutor(mp_context=context, initializer=_begin, initargs=(end,))
    try:
        yield executor
    except BaseException:
        end.set()
        raise
    finally:
        executor.shutdown(cancel_futures=True)


def is_ending() -> bool:
    """Whether this is a worker whose results nobody waits for any more."""
    return _end is not None and _end.is_set()


def _begin(end: Event) -> None:
    global _end
    _end = end
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle
