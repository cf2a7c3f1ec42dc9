"""Processes for runs that have nothing to do with each other."""

import contextlib
import gc
import os
import signal
import threading
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from multiprocessing import get_context, parent_process
from multiprocessing.synchronize import Event
from typing import Any

from drake_nonstop.validation import show_warning

_end: Event | None = None  # in a worker: set where nobody waits for it any more


@contextlib.contextmanager
def worker_processes(count: int | None = None) -> Iterator[ProcessPoolExecutor]:
    """So many, or one per core.

    Where the block ends by an error or Ctrl-C, what has not begun is dropped, and what has is
    waited for; where that may take long, it asks `is_ending`.
    """
    context = get_context("spawn")
    end = context.Event()
    executor = ProcessPoolExecutor(count, mp_context=context, initializer=_begin, initargs=(end,))
    try:
        yield executor
    except BaseException:
        end.set()
        raise
    finally:
        executor.shutdown(cancel_futures=True)


class SerialExecutor(Executor):
    """Runs what it is given at once, in the process and thread that give it."""

    def submit(self, fn: Callable, /, *args: Any, **kwargs: Any) -> Future:
        """A future that is done; Ctrl-C is not kept in it, but raised."""
        future: Future = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


def is_ending() -> bool:
    """Whether this is a worker whose results nobody waits for any more."""
    return _end is not None and _end.is_set()


def _begin(end: Event) -> None:
    global _end
    _end = end
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle
    threading.Thread(target=_end_with_parent, daemon=True).start()
    warnings.showwarning = show_warning
    gc.freeze()  # what the imports made stays: the collector need not look at it every time


def _end_with_parent() -> None:
    """Ends this worker with its parent, also where that was killed and could not say so."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
