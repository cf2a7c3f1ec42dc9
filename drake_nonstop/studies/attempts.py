"""Runs that are tried: each comes to an ending of its own, and none raises."""

import gc
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from pydrake.systems.framework import Diagram

from drake_nonstop.run.many import fly_many
from drake_nonstop.run.run import Run, RunStopped
from drake_nonstop.systems.block import release
from drake_nonstop.validation import ScenarioError, one_line

# How a run may end.
COMPLETED = "completed"
DIVERGED = "diverged"
FAILED = "failed"  # a block raised an error during the run, or its process died
UNBUILDABLE = "unbuildable"


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
            message = str(outcome) if is_bad else one_line(outcome)
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
            arguments[number] = {"scenario": make() if callable(make) else make} | given
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
