"""Runs that are tried: each comes to an ending of its own, and none raises."""

import gc
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from pydrake.systems.framework import Diagram

from drake_nonstop.run.many import fly_many
from drake_nonstop.run.run import Run, RunStopped
from drake_nonstop.scenario.schema import Scenario
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
    there are none; `told` are warnings.
    """

    ending: str
    message: str = ""
    run: Run | None = None
    told: list[str]


def attempts(
    runs: Iterable[tuple[Scenario, dict[str, Any]]],
) -> Iterator[tuple[int, Attempt]]:
    """The numbers of runs and how they ended, as they do; several fly at a time.

    A run is a scenario with arguments as of `simulate`. Nothing but Ctrl-C is raised. The systems
    of the loops, whose memory is mostly C++'s, are released after the last run.
    """
    arguments = [{"scenario": scenario} | given for scenario, given in runs]
    diagrams: dict[int, Diagram] = {}
    for number, outcome, told in fly_many(arguments, is_recording=True):
        found = _attempt(outcome, told)
        if found.run is not None:
            diagrams[id(found.run.diagram)] = found.run.diagram
        yield number, found
        del found, outcome
    for diagram in diagrams.values():
        release(diagram)
    gc.collect()  # Python's collector would run too late


def _attempt(outcome: Run | BaseException, told: list[str]) -> Attempt:
    """How a run ended, of the run or of what `simulate` raises."""
    ending, message = COMPLETED, ""
    run = outcome if isinstance(outcome, Run) else getattr(outcome, "run", None)
    if isinstance(outcome, RunStopped):
        ending, message = DIVERGED if outcome.__cause__ is None else FAILED, str(outcome)
    elif isinstance(outcome, BaseException):  # whatever the user's own blocks may raise
        is_bad = isinstance(outcome, ScenarioError)
        ending, message = UNBUILDABLE, str(outcome) if is_bad else one_line(outcome)
    run = run if run is not None and len(run.time) > 0 else None
    return Attempt(ending=ending, message=message, run=run, told=told)
