"""Many runs that are independent of each other: in processes, each to an ending of its own."""

import gc
from collections import deque
from collections.abc import Callable, Container, Hashable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

from pydrake.systems.framework import Diagram

from drake_nonstop.run.many import fly_many
from drake_nonstop.run.run import Run, RunStopped
from drake_nonstop.studies.processes import (
    Answer,
    call_in_processes,
    deferred_signals,
    in_parts,
    one_by_one,
)
from drake_nonstop.systems.block import release
from drake_nonstop.validation import ScenarioError, message_of, one_line, require

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
    function: Callable[..., Any],
    keys: Sequence[Key],
    arguments: Callable[[Key], tuple],
    record: Callable[[Key, Result], None],
    failed: Callable[[Key, str], Result],
    *,
    done: Container[Key] = (),
    executor: Executor | None = None,
    what: str | Callable[[], str] = "simulating",
    progress: Progress = no_progress,
    is_of_many: bool = False,
) -> None:
    """Calls a function once per key, in a process per core, and records results as they come.

    One `is_of_many` takes the arguments of several keys, in a list, and yields numbers of this list
    with the results for these. A call whose process dies is repeated once, by itself. Where this
    function ends by an error or by Ctrl-C, calls that have not ended are dropped and their
    processes killed; those that write results (`keep_what_is_done`) have two seconds to end, unless
    Ctrl-C comes again.

    Processes can import the function, and what `arguments` makes of a key can be pickled. `failed`
    makes the result of a key from an error message, where the function raised anything but
    ScenarioError, or where its process died; it may raise instead. Keys in `done`, such as a
    `Journal`, are not called again. An executor, of concurrent.futures' kind, is used in place of a
    process per core and not shut down. `progress` is called after each record with `what`,
    or what it returns, such as what was found so far, and the share of keys that are done.

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
        progress(what() if callable(what) else what, count / len(keys))

    require(callable(progress), "progress", progress, "give a function, such as a TaskProgress()")
    call = call_in_processes if executor is None else partial(_call_in, executor)
    each = function if is_of_many else partial(one_by_one, function)
    call(each, in_parts(missing, is_of_many=is_of_many), arguments, record_answer)


def _call_in(
    executor: Executor,
    function: Callable[..., Any],
    parts: Iterable[Sequence[Key]],
    arguments: Callable[[Key], tuple],
    record: Callable[[Key, Answer], None],
) -> None:
    """Calls in an executor as in processes; raises ScenarioError where it cannot be used."""
    is_one = isinstance(executor, Executor)
    require(is_one, "executor", executor, "give one of concurrent.futures' kind, or None")
    name = type(executor).__name__

    waiting = deque(parts)
    pending: dict[Future, Sequence[Key]] = {}
    try:
        while waiting or pending:
            while waiting and len(pending) < _MAX_PENDING:
                try:
                    future = executor.submit(_made, function, [*map(arguments, waiting[0])])
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
                    answer, part = Answer.of(future.result), pending.pop(future)
                    results = {} if answer.error else answer.result
                    for k, key in enumerate(part):
                        record(key, Answer(result=results[k]) if k in results else answer)
    except BrokenExecutor as error:
        raise ScenarioError(
            f"executor = {name}: its workers end or cannot be used ({one_line(error)}); give "
            "another one, or none for processes that are replaced where they end"
        ) from None
    finally:
        for future in pending:
            future.cancel()


def _made(function: Callable[..., Any], calls: Sequence[tuple]) -> dict[int, Any]:
    """The results of calls by their numbers."""
    return dict(function(calls))


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
    told: tuple[str, ...] = ()  # warnings

    @classmethod
    def of(cls, outcome: Run | BaseException, told: Iterable[str] = ()) -> "Attempt":
        """Ending of a run, or of what `simulate` raises, with its warnings."""
        said = tuple(told)
        if isinstance(outcome, RunStopped):
            ending = DIVERGED if outcome.__cause__ is None else FAILED
            run = outcome.run if len(outcome.run.time) > 0 else None
            return cls(ending=ending, message=str(outcome), run=run, told=said)
        if isinstance(outcome, BaseException):  # whatever the user's own blocks may raise
            is_bad = isinstance(outcome, ScenarioError)
            message = message_of(outcome) if is_bad else one_line(outcome)
            return cls(ending=UNBUILDABLE, message=message, error=outcome, told=said)
        run = outcome if len(outcome.time) > 0 else None
        return cls(ending=COMPLETED, run=run, told=said)


def attempts(
    runs: Iterable[tuple[Any, dict[str, Any]]], *, is_recording: bool = False
) -> Iterator[tuple[int, Attempt]]:
    """The numbers of runs and how they ended, as they do; several fly at a time.

    A run is a scenario, or a function that returns it, and arguments as of `simulate`. Nothing but
    Ctrl-C is raised. The systems of the loops, whose memory is mostly C++'s, are released after the
    last run. What is warned of is in the attempts where it `is_recording`.
    """
    arguments: dict[int, dict[str, Any]] = {}
    diagrams: dict[int, Diagram] = {}
    for number, (make, given) in enumerate(runs):
        try:
            scenario = make() if callable(make) else make
            arguments[number] = {"scenario": scenario} | given
        except (Exception, SystemExit) as error:  # whatever the user's own blocks may raise
            yield number, Attempt.of(error)
    numbers = [*arguments]
    for k, outcome, told in fly_many([*arguments.values()], is_recording=is_recording):
        found = Attempt.of(outcome, told)
        if found.run is not None:
            diagrams[id(found.run.diagram)] = found.run.diagram
        yield numbers[k], found
        del found, outcome
    for diagram in diagrams.values():
        release(diagram)
    gc.collect()  # Python's collector would run too late


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
