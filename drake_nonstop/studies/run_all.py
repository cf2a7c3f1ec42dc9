"""Many runs that are independent of each other: in processes, each to an ending of its own."""

import warnings
from collections import deque
from collections.abc import Callable, Container, Hashable, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

from drake_nonstop.scenario.schema import AUTO, COMPILED, Scenario
from drake_nonstop.simulation.compiled_run import NOT_COMPILED
from drake_nonstop.simulation.run import Run, RunInterrupted, RunStopped
from drake_nonstop.simulation.simulate import simulate
from drake_nonstop.studies.processes import Answer, call_in_processes, deferred_signals
from drake_nonstop.validation import ScenarioError, ScenarioWarning, message_of, one_line, require

# How a run may end.
COMPLETED = "completed"
DIVERGED = "diverged"
FAILED = "failed"  # a block raised an error during the run, or its process died
UNBUILDABLE = "unbuildable"

_MAX_PENDING = 200  # runs that an executor has at a time

Key = TypeVar("Key", bound=Hashable)
Result = TypeVar("Result")
Progress = Callable[[str, float], None]  # called with a description and the share that is done


def no_progress(what: str, share: float) -> None:
    """Reports nothing."""


def run_all(
    function: Callable[..., Result],
    keys: Sequence[Key],
    arguments: Callable[[Key], tuple],
    record: Callable[[Key, Result], None],
    failed: Callable[[Key, str], Result],
    *,
    done: Container[Key] = (),
    executor: Executor | None = None,
    what: str = "simulating",
    progress: Progress = no_progress,
) -> None:
    """Calls a function once per key, in a process per core, and records results as they come.

    A call whose process dies is repeated once, by itself. Where this function ends by an error
    or by Ctrl-C, calls that have not ended are dropped and their processes killed; those that
    write results (`keep_what_is_done`) have two seconds to end, unless Ctrl-C comes again.

    Processes can import the function, and what `arguments` makes of a key can be pickled. `failed`
    makes the result of a key from an error message, where the function raised anything but
    ScenarioError, or where its process died; it may raise instead. Keys in `done`, such as a
    `Journal`, are not called again. An executor, of concurrent.futures' kind, is used in place of a
    process per core and not shut down. `progress` is called after each record with `what` and the
    share of keys that are done.

    Raises:
        ScenarioError: the function raised it, processes end as they start, or the executor
            cannot be used.
        KeyboardInterrupt: Ctrl-C; what was recorded stays.
    """
    missing = [key for key in keys if key not in done]
    count = len(keys) - len(missing)

    def record_answer(key: Key, answer: Answer) -> None:
        nonlocal count
        if answer.is_bad_input:
            raise ScenarioError(answer.error)
        record(key, failed(key, answer.error) if answer.error else answer.result)
        count += 1
        progress(what, count / len(keys))

    require(callable(progress), "progress", progress, "give a function, such as a TaskProgress()")
    call = call_in_processes if executor is None else partial(_call_in, executor)
    call(function, missing, arguments, record_answer)


def _call_in(
    executor: Executor,
    function: Callable[..., Any],
    keys: Sequence[Key],
    arguments: Callable[[Key], tuple],
    record: Callable[[Key, Answer], None],
) -> None:
    """Calls in an executor as in processes; raises ScenarioError where it cannot be used."""
    is_one = isinstance(executor, Executor)
    require(is_one, "executor", executor, "give one of concurrent.futures' kind, or None")
    name = type(executor).__name__

    waiting = deque(keys)
    pending: dict[Future, Key] = {}
    try:
        while waiting or pending:
            while waiting and len(pending) < _MAX_PENDING:
                try:
                    future = executor.submit(function, *arguments(waiting[0]))
                except BrokenExecutor:
                    raise
                except RuntimeError as error:  # it is shut down
                    remedy = f"give one that takes calls ({one_line(error)})"
                    raise ScenarioError(f"executor = {name}: {remedy}") from None
                pending[future] = waiting.popleft()
                if future.done():
                    break  # a serial executor: recorded before the next one is run
            for future in wait(pending, return_when=FIRST_COMPLETED).done:
                with deferred_signals():
                    record(pending.pop(future), Answer.of(future.result))
    except BrokenExecutor as error:
        raise ScenarioError(
            f"executor = {name}: its workers end or cannot be used ({one_line(error)}); give "
            "another one, or none for processes that are replaced where they end"
        ) from None
    finally:
        for future in pending:
            future.cancel()


@dataclass(kw_only=True)
class Attempt:
    """How a run ended.

    `message` says why it is not "completed"; `run` holds the signals up to its end, None where
    there are none.
    """

    ending: str
    message: str = ""
    run: Run | None = None
    error: BaseException | None = None  # of a scenario that is "unbuildable"


def fly(scenario: Scenario, **arguments: Any) -> Run:
    """Simulates, by the compiled loop where the scenario leaves the engine open.

    Where that cannot be compiled its diagram is simulated without a word: the results are the same,
    to rounding.
    """
    if getattr(scenario, "engine", None) != AUTO or arguments.get("engine") is not None:
        return simulate(scenario, **arguments)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", NOT_COMPILED, ScenarioWarning)
        return simulate(scenario, **arguments | {"engine": COMPILED})


def attempt(scenario: Callable[[], Scenario], **arguments: Any) -> Attempt:
    """Flies the scenario that a function returns, with arguments as of `simulate`.

    Nothing but Ctrl-C is raised.
    """
    ending, message = COMPLETED, ""
    try:
        run = fly(scenario(), **arguments)
    except RunStopped as stopped:
        run, message = stopped.run, str(stopped)
        ending = DIVERGED if stopped.__cause__ is None else FAILED
    except RunInterrupted:
        raise KeyboardInterrupt from None  # without the run, which cannot be sent to a process
    except ScenarioError as error:
        return Attempt(ending=UNBUILDABLE, message=message_of(error), error=error)
    except (Exception, SystemExit) as error:  # whatever the user's own blocks may raise
        return Attempt(ending=UNBUILDABLE, message=one_line(error), error=error)
    return Attempt(ending=ending, message=message, run=run if len(run.time) > 0 else None)


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
