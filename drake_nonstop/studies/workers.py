"""Calls of a function in worker processes: what is done is recorded, whoever dies.

Workers are those of `concurrent.futures`: a process per core here, or any executor of this kind,
such as Dask's on a cluster. Where a process dies, the calls that were out are repeated, each by
itself and at most twice, so that only a call that ends its process whenever it is made is lost.
"""

import contextlib
import gc
import multiprocessing.forkserver as forkserver
import os
import signal
import sys
import threading
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from multiprocessing import current_process, get_context, parent_process, resource_tracker
from pathlib import Path
from typing import Any

from drake_nonstop.run.interruption import ALL, current_interruption
from drake_nonstop.validation import ScenarioError, one_line, require, show_warning

PROCESS_DIED = "its process died: it crashed or ran out of memory"
BLAS_THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")

Progress = Callable[[str, float], None]  # called with a description and the share that is done
Batches = deque[list[Any]]


def no_progress(what: str, share: float) -> None:
    """Reports nothing."""


class SerialExecutor(Executor):
    """Calls each function at once, in the process and thread that submits it."""

    def submit(self, fn: Callable, /, *args: Any, **kwargs: Any) -> Future:
        """A future that is done; KeyboardInterrupt is raised here, not kept in it."""
        future: Future = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


def require_main() -> None:
    """Checks that workers can import the script that starts them.

    In a process that is importing that script, and so runs what should be below the script's
    guard, it ends the process without a word: the parent tells why.

    Raises:
        ScenarioError: the script is in no file, or the process may start none.
    """
    if getattr(current_process(), "_inheriting", False):
        os._exit(1)
    remedy = "it may start no processes; call the study from a process that is none"
    require(not current_process().daemon, "process", "daemonic, as a pool's", remedy)
    main = sys.modules["__main__"]
    file = getattr(main, "__file__", None)
    if getattr(main, "__spec__", None) is None and file and not Path(file).exists():
        raise _unguarded(file)


def _unguarded(script: str) -> ScenarioError:
    return ScenarioError(
        f"__main__ = {script}: processes import it as they start, and cannot; save it as a .py "
        'file, with what it does in a function that is called below `if __name__ == "__main__":`'
    )


def in_batches(calls: Sequence[Any], most: int) -> list[list[Any]]:
    """The calls in batches of the same size, `most` or less, several for each core."""
    size = min(most, max(1, len(calls) // (4 * (os.cpu_count() or 1))))
    return [[*calls[start : start + size]] for start in range(0, len(calls), size)]


def results_of(
    function: Callable[[list[Any]], list[Any]],
    batches: Sequence[list[Any]],
    executor: Executor | None = None,
) -> Iterator[tuple[list[Any], list[Any] | str]]:
    """Batches of calls with their results, as they come; an error's text in place of the results.

    Args:
        function: returns the results of a list of calls; processes can import it.
        batches: lists of calls, which can be pickled.
        executor: takes the place of a process per core, and is not shut down.

    Raises:
        ScenarioError: the function raised it, processes end as they start, or the executor cannot
            be used.
    """
    waiting: Batches = deque(batches)
    if executor is not None:
        remedy = "give one of concurrent.futures' kind, or None"
        require(isinstance(executor, Executor), "executor", executor, remedy)
        try:
            yield from _results(executor, function, waiting, 200, [])
        except (BrokenExecutor, RuntimeError) as error:  # RuntimeError: it is shut down
            raise ScenarioError(
                f"executor = {type(executor).__name__}: its workers have ended, or it takes no "
                f"calls ({one_line(error)}); give another one, or none"
            ) from None
        return
    require_main()
    once, twice, has_any = Batches(), Batches(), False  # calls whose process died so often
    for now, again in ((waiting, once), (once, twice), (twice, None)):
        most = os.cpu_count() or 1 if now is waiting else 1
        while now:
            out: list[list[Any]] = []  # the batches that processes have
            try:
                with _pool(min(most, len(now))) as pool:
                    for answer in _results(pool, function, now, most, out):
                        has_any = True
                        yield answer
            except BrokenExecutor:
                if again is None:
                    yield out[0], PROCESS_DIED
                    continue
                again.extend([call] for batch in out for call in batch)
                if not has_any:
                    _require_startable()


def _results(
    pool: Executor,
    function: Callable[[list[Any]], list[Any]],
    waiting: Batches,
    most: int,
    out: list[list[Any]],
) -> Iterator[tuple[list[Any], list[Any] | str]]:
    """The results of waiting batches, of which a pool has so many at a time, those in `out`."""
    pending: dict[Future, list[Any]] = {}
    try:
        while waiting or pending:
            while waiting and len(pending) < most:
                out.append(waiting.popleft())
                future = pool.submit(function, out[-1])
                pending[future] = out[-1]
                if future.done():
                    break  # a serial executor: recorded before the next one is called
            for future in wait(pending, return_when=FIRST_COMPLETED).done:
                error = future.exception()
                if isinstance(error, (BrokenExecutor, ScenarioError)):
                    raise error
                batch = pending.pop(future)
                out.remove(batch)
                yield batch, one_line(error) if error else future.result()
    finally:
        for future in pending:
            future.cancel()


class _Pool(ProcessPoolExecutor):
    """Processes that are all known, and so end with the pool, whenever a signal comes."""

    def submit(self, fn: Callable, /, *args: Any, **kwargs: Any) -> Future:
        """Starts a process, too, which a signal does not break off."""
        with current_interruption() as interruption:
            with interruption.patient(ALL):
                try:
                    future = super().submit(fn, *args, **kwargs)
                except (ConnectionError, EOFError) as error:  # of the process that forks them
                    raise BrokenExecutor("the process that starts others died") from error
            interruption.check()
        return future


@contextlib.contextmanager
def _pool(count: int) -> Iterator[ProcessPoolExecutor]:
    """Processes, each with one thread for linear algebra; killed where the block ends early."""
    context = get_context("forkserver")
    context.set_forkserver_preload(["drake_nonstop.studies.study", "drake_nonstop.public"])
    _ensure_forkserver()
    pool = _Pool(count, mp_context=context, initializer=_begin)
    try:
        yield pool
        pool.shutdown()
    finally:
        with current_interruption() as interruption, interruption.patient(ALL):
            for process in [*(getattr(pool, "_processes", None) or {}).values()]:
                process.kill()
            pool.shutdown(wait=False, cancel_futures=True)


def _ensure_forkserver() -> None:
    """Starts the process from which workers are forked, which Ctrl-C does not reach."""
    resource_tracker.ensure_running()  # at its end it lets SIGINT through again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    added = [] if any(name in os.environ for name in BLAS_THREADS) else BLAS_THREADS
    try:
        os.environ.update(dict.fromkeys(added, "1"))
        forkserver.ensure_running()
    finally:
        for name in added:
            os.environ.pop(name, None)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin() -> None:
    """Prepares a worker, which ends with its parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle
    warnings.showwarning = show_warning
    threading.Thread(target=_end_with_parent, daemon=True).start()
    gc.freeze()  # the collector need not look at what the imports made


def _end_with_parent() -> None:
    """Waits for the end of this process's parent, and then ends this one."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _require_startable() -> None:
    """Raises ScenarioError where a process ends before it could call anything."""
    try:
        with _pool(1) as pool:
            pool.submit(os.getpid).result()
    except BrokenExecutor:
        script = getattr(sys.modules["__main__"], "__file__", "a script without a file")
        raise _unguarded(script) from None
