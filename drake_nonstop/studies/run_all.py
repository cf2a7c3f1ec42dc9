"""Many runs that are independent of each other: in processes, each to an outcome of its own."""

import contextlib
import gc
import os
import signal
import sys
import threading
import warnings
from collections import deque
from collections.abc import Callable, Hashable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import get_context, parent_process
from multiprocessing.synchronize import Event
from typing import Any, TypeVar

from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.simulation.run import Run, RunInterrupted, RunStopped, StepAction
from drake_nonstop.simulation.simulate import simulate
from drake_nonstop.validation import ScenarioError, one_line, show_warning

# The outcomes of a run.
COMPLETED = "completed"
DIVERGED = "diverged"
FAILED = "failed"  # a block raised an error during the run, or its process died
UNBUILDABLE = "unbuildable"

_MAX_PENDING = 200  # runs that an executor has at a time
_PROCESS_DIED = "its process died: it crashed or ran out of memory"

Key = TypeVar("Key", bound=Hashable)
Result = TypeVar("Result")
Progress = Callable[[str, float], None]  # called with a description and the share that is done

_is_cancelled: Event | None = None  # in a worker process: set where its results are not needed


def no_progress(what: str, share: float) -> None:
    """Reports nothing."""


def run_all(
    function: Callable[..., Result],
    keys: Sequence[Key],
    arguments: Callable[[Key], tuple],
    record: Callable[[Key, Result], None],
    failed: Callable[[Key, str], Result],
    *,
    executor: Executor | None = None,
    what: str = "simulating",
    progress: Progress = no_progress,
    already_done: int = 0,
) -> None:
    """Calls a function once per key, in a process per core, and records results as they come.

    Where a process dies, the calls that it may have been at are repeated one by one, in a
    process of their own each: the one that ends it has failed. Where this function ends by an
    error or by Ctrl-C, calls that have not begun are dropped; those that have are waited for,
    and runs by `attempt` among them end at their next step.

    Args:
        function: called in another process, so it must be one that can be imported there.
        keys: one for each call, all different.
        arguments: the function's arguments for a key, which must be picklable.
        record: called with a key and its result, in the order in which results come.
        failed: makes the result of a key from an error message, where the function raised
            anything but ScenarioError, or where its process died. It may raise instead.
        executor: any of concurrent.futures' kind, in place of a process per core. It is not shut
            down, and its processes are its own concern.
        what: the description of the calls for progress.
        progress: called after each record with `what` and the share of calls that are done.
        already_done: the number of calls of an earlier time that count in this share.

    Raises:
        ScenarioError: the function raised it, or processes end as they start.
        KeyboardInterrupt: Ctrl-C; what was recorded stays.
    """
    done: set[Key] = set()

    def record_result(key: Key, result: Result) -> None:
        done.add(key)
        record(key, result)
        progress(what, (already_done + len(done)) / (already_done + len(keys)))

    def submit(to: Executor, key: Key) -> Future:
        return to.submit(function, *arguments(key))

    def result_of(future: Future, key: Key) -> Result:
        try:
            return future.result()
        except (BrokenProcessPool, ScenarioError):
            raise
        except Exception as error:
            return failed(key, one_line(error))

    def run_in(some: Executor, waiting: deque[Key]) -> None:
        pending: dict[Future, Key] = {}
        try:
            while waiting or pending:
                while waiting and len(pending) < _MAX_PENDING:
                    future = submit(some, waiting[0])
                    pending[future] = waiting.popleft()
                    if future.done():
                        break  # a serial executor: recorded before the next one is run
                for future in wait(pending, return_when=FIRST_COMPLETED).done:
                    result = result_of(future, pending[future])
                    record_result(pending.pop(future), result)
        finally:
            for future in pending:
                future.cancel()

    def missing() -> list[Key]:
        return [key for key in keys if key not in done]

    if executor is not None:
        run_in(executor, deque(keys))
        return
    while missing():
        try:
            with _processes() as processes:
                run_in(processes, deque(missing()))
        except BrokenProcessPool:
            # Each process has one call, and one more is on its way to them.
            for key in missing()[: (os.cpu_count() or 1) + 1]:
                with _processes(1) as process:
                    _require_start(process)
                    try:
                        result = result_of(submit(process, key), key)
                    except BrokenProcessPool:
                        result = failed(key, _PROCESS_DIED)
                record_result(key, result)


@dataclass(kw_only=True)
class Attempt:
    """How a run ended.

    `message` says why it is not "completed"; `run` holds the signals up to its end, None where
    there are none.
    """

    outcome: str
    message: str = ""
    run: Run | None = None
    error: BaseException | None = None  # of a scenario that is "unbuildable"


def attempt(scenario: Callable[[], Scenario]) -> Attempt:
    """Simulates the scenario that a function returns, and never raises an error of the run.

    Raises:
        KeyboardInterrupt: Ctrl-C, or `run_all` was ended while it ran.
    """
    outcome, message = COMPLETED, ""
    try:
        run = simulate(
            scenario(),
            after_step=lambda simulator, diagram: (
                StepAction.END if _is_worker_cancelled() else StepAction.CONTINUE
            ),
        )
    except RunStopped as stopped:
        run, message = stopped.run, str(stopped)
        outcome = DIVERGED if stopped.__cause__ is None else FAILED
    except RunInterrupted:
        raise KeyboardInterrupt from None  # without the run, which cannot be sent to a process
    except ScenarioError as error:
        return Attempt(outcome=UNBUILDABLE, message=str(error), error=error)
    except (Exception, SystemExit) as error:  # whatever the user's own blocks may raise
        return Attempt(outcome=UNBUILDABLE, message=one_line(error), error=error)
    if _is_worker_cancelled():
        raise KeyboardInterrupt
    return Attempt(outcome=outcome, message=message, run=run if len(run.time) > 0 else None)


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


@contextlib.contextmanager
def _processes(count: int | None = None) -> Iterator[ProcessPoolExecutor]:
    """So many processes, or one per core; an error in the block drops what has not begun.

    They are forked from one process that has imported the package and nothing else, so that the
    imports are paid for once.
    """
    context = get_context("forkserver")
    context.set_forkserver_preload([__name__, "drake_nonstop.public"])
    cancelled = context.Event()
    executor = ProcessPoolExecutor(
        count, mp_context=context, initializer=_start_worker, initargs=(cancelled,)
    )
    try:
        yield executor
    except BaseException:
        cancelled.set()
        raise
    finally:
        executor.shutdown(cancel_futures=True)


def _require_start(processes: ProcessPoolExecutor) -> None:
    """Raises ScenarioError where a process ends before it can be given anything to do."""
    try:
        processes.submit(int).result()
    except BrokenProcessPool:
        script = getattr(sys.modules["__main__"], "__file__", "a script without a file")
        raise ScenarioError(
            f"__main__ = {script}: processes import it as they start, and end; put what it does "
            'into a function that is called below `if __name__ == "__main__":`'
        ) from None


def _is_worker_cancelled() -> bool:
    """Whether this is a worker process whose results are not needed any more."""
    return _is_cancelled is not None and _is_cancelled.is_set()


def _start_worker(cancelled: Event) -> None:
    global _is_cancelled
    _is_cancelled = cancelled
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle
    threading.Thread(target=_exit_with_parent, daemon=True).start()
    warnings.showwarning = show_warning
    gc.freeze()  # the collector need not look at what the imports made


def _exit_with_parent() -> None:
    """Ends this worker process with its parent, also where that was killed."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
