"""Processes for runs that have nothing to do with each other."""

import contextlib
import signal
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context


@contextlib.contextmanager
def worker_processes() -> Iterator[ProcessPoolExecutor]:
    """One per core; what has not begun is dropped where the block ends by an error or Ctrl-C."""
    executor = ProcessPoolExecutor(
        mp_context=get_context("spawn"),
        initializer=signal.signal,
        initargs=(signal.SIGINT, signal.SIG_IGN),  # Ctrl-C is the parent's to handle
    )
    try:
        yield executor
    finally:
        executor.shutdown(cancel_futures=True)
