"""Exact wall times of the blocks of a run: every callback from Drake into Python is timed.

A sampling profiler would be biased, since Python switches threads only between its own
instructions. So while a run is timed, the blocks' classes are changed in place: each of
their functions reports its begin and end to the timers. The results of the run are the
same to the bit.
"""

import contextlib
import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from time import perf_counter
from types import FunctionType
from typing import Any

from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, LeafSystem, System

from drake_nonstop.run.run import StepAction
from drake_nonstop.systems.tracing import Evaluator

OUTSIDE = "outside"  # of the blocks' Python: Drake with its own systems, and the logs


@dataclass(slots=True)
class Frame:
    """A box in the tree of calls: one node for each chain of boxes that led to it.

    `seconds` are those in the box itself, without the boxes whose outputs it evaluated, which
    are `children`. `calls` counts the entries into the box by the name of the function, and
    `evaluations` the traced functions that the box evaluated.
    """

    box: str
    seconds: float = 0.0
    calls: dict[str, int] = field(default_factory=dict)
    evaluations: int = 0
    children: dict[str, "Frame"] = field(default_factory=dict)

    @property
    def total(self) -> float:
        """The seconds in the box and in all boxes below it."""
        return self.seconds + sum(child.total for child in self.children.values())

    def walk(self) -> Iterator["Frame"]:
        """This frame and all below it."""
        yield self
        for child in self.children.values():
            yield from child.walk()


class BlockTimers:
    """Times the blocks of one run, which is given `after_step`, within `installed`.

    The time runs from the end of the simulator's initialization to the end of its last step.
    `root` is the time outside of all blocks; the seconds of all frames add up to `seconds`.
    `blocks` maps the boxes of the run's diagram to the names of their classes.

    Args:
        clock: returns the wall time in s.
    """

    def __init__(self, clock: Callable[[], float] = perf_counter) -> None:
        self._clock = clock
        self.root = Frame(OUTSIDE)
        self.blocks: dict[str, str] = {}
        self.seconds = 0.0
        self._stack = [self.root]
        self._boxes: dict[int, str] = {}  # by the id of a system; empty until the first step
        self._systems: list[System] = []  # kept alive, so that no other object takes their ids
        self._simulator: Simulator | None = None
        self._first_steps = 0
        self._start = self._last = 0.0

    @property
    def steps(self) -> int:
        """The simulator's steps since the timing began."""
        steps = self._simulator.get_num_steps_taken() if self._simulator else 0
        return steps - self._first_steps

    def after_step(self, simulator: Simulator, nonstop: Diagram) -> StepAction:
        """A function that `simulate` calls before the first step and after every one."""
        now = self._clock()
        if self._simulator is None:
            for block in nonstop.GetSystems():
                self.blocks[block.get_name()] = type(block).__name__
                self._add(block, block.get_name())
            self._simulator = simulator
            self._first_steps = simulator.get_num_steps_taken()
            self._start = self._last = self._clock()
            return StepAction.CONTINUE
        self.root.seconds += now - self._last
        self._last = now
        self.seconds = now - self._start
        return StepAction.CONTINUE

    def _add(self, system: System, box: str) -> None:
        self._boxes[id(system)] = box
        self._systems.append(system)
        if isinstance(system, Diagram):
            for part in system.GetSystems():
                self._add(part, box)

    @contextlib.contextmanager
    def installed(self) -> Iterator["BlockTimers"]:
        """A context in which all blocks that are built report to these timers."""
        replaced: list[tuple[type, str, Any]] = []

        def replace(owner: type, name: str, value: Any) -> None:
            replaced.append((owner, name, vars(owner)[name]))
            setattr(owner, name, value)

        try:
            for owner in _python_classes(System):
                for name, function in list(vars(owner).items()):
                    # What declares computes nothing, and a copy of a block of another scalar type
                    # takes its `super()` from the function itself.
                    is_own = isinstance(function, FunctionType)
                    if is_own and not name.startswith(("__", "Declare")):
                        replace(owner, name, self._timed(function, name))
            for name in [name for name in vars(LeafSystem) if name.startswith("Declare")]:
                replace(LeafSystem, name, self._timed_declaration(vars(LeafSystem)[name]))
            replace(Evaluator, "__call__", self._counted(vars(Evaluator)["__call__"]))
            yield self
        finally:
            for owner, name, value in reversed(replaced):
                setattr(owner, name, value)

    def _timed(self, function: Callable, name: str) -> Callable:
        """A function whose first argument is a system, timed where that is in the run's diagram."""
        boxes, stack, clock = self._boxes, self._stack, self._clock

        @functools.wraps(function)
        def timed(system: System, /, *arguments: Any, **named: Any) -> Any:
            box, caller = boxes.get(id(system)), stack[-1]
            if box is None or box == caller.box:  # a block's own functions call each other
                return function(system, *arguments, **named)
            frame = caller.children.get(box)
            if frame is None:
                frame = caller.children[box] = Frame(box)
            frame.calls[name] = frame.calls.get(name, 0) + 1
            stack.append(frame)
            start = clock()
            caller.seconds += start - self._last
            self._last = start
            try:
                return function(system, *arguments, **named)
            finally:
                end = clock()
                frame.seconds += end - self._last
                self._last = end
                stack.pop()

        return timed

    def _timed_declaration(self, declare: Callable) -> Callable:
        """A Declare... function that also times callbacks that are no methods, such as lambdas."""

        @functools.wraps(declare)
        def declared(system: System, *arguments: Any, **named: Any) -> Any:
            def timed(value: Any) -> Any:
                if not isinstance(value, FunctionType):
                    return value
                inner = self._timed(
                    lambda _, *given, **named: value(*given, **named), value.__name__
                )
                return functools.partial(inner, system)

            return declare(
                system,
                *(timed(value) for value in arguments),
                **{name: timed(value) for name, value in named.items()},
            )

        return declared

    def _counted(self, evaluate: Callable) -> Callable:
        stack = self._stack

        @functools.wraps(evaluate)
        def counted(evaluator: Evaluator, *inputs: Any) -> Any:
            stack[-1].evaluations += 1
            return evaluate(evaluator, *inputs)

        return counted


def _python_classes(base: type) -> Iterator[type]:
    """The classes below `base`, each once, that are not Drake's."""
    found: dict[type, None] = {}
    waiting = [base]
    while waiting:
        below: type
        for below in waiting.pop().__subclasses__():
            if below not in found:
                found[below] = None
                waiting.append(below)
    return (kind for kind in found if not kind.__module__.startswith("pydrake"))
