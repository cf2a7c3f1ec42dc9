"""The base classes of all blocks: systems that Python can free.

A run has to give its memory back once it is over, or a sweep of many runs out of it. Three
things keep a system written in Python alive, and with it all of its diagram, some 7 MB a
run (https://github.com/RobotLocomotion/drake/issues/22515):

- Where pydrake is bound by pybind11, a Python class below its classes gets a dictionary that
  Python 3.11's garbage collector counts twice, so that it takes it for held from outside. A class
  with empty `__slots__` has the dictionary of the class above it only, where attributes go, too.
- What C++ calls back is a bound method, which holds the system that holds it, where the
  collector cannot see it. A function that finds the system by a weak reference does not.
- A CacheEntry holds its system, too, unseen: a block keeps its index, and not the entry.

Pydrake bound by nanobind does without the first two.
"""

import functools
import types
import weakref
from typing import Any

from pydrake.systems.framework import (
    Context,
    ContinuousState,
    Diagram,
    LeafSystem,
    OutputPort,
)

_IS_NANOBIND = type(LeafSystem).__module__.startswith("nanobind")


def _type_of_blocks() -> Any:
    """The type of systems, or one whose classes have empty `__slots__` where that is needed."""
    kind: Any = type(LeafSystem)
    if _IS_NANOBIND:
        return kind

    class Slotted(kind):
        def __new__(cls, name: str, bases: tuple[type, ...], members: dict[str, Any]) -> type:
            return super().__new__(cls, name, bases, {"__slots__": (), **members})

    return Slotted


LOOP = "nonstop"  # the name of the diagram that the blocks are in
BlockType = _type_of_blocks()


class DiagramBlock(Diagram, metaclass=BlockType):  # type: ignore[metaclass]
    """A Diagram that is freed.

    Attributes:
        is_sampled: whether its outputs, with a control period, change at the controllers' samples
            only, or, as `carrier_reference`, move along their rates in between.
    """

    is_sampled = False

    def __init__(self) -> None:
        """Makes the block; a box's takes a `model` and a `config` (None: the default values)."""
        super().__init__()


class LeafBlock(LeafSystem, metaclass=BlockType):  # type: ignore[metaclass]
    """A LeafSystem whose methods may be given to its Declare functions, and that is freed.

    Attributes:
        is_sampled: as of `DiagramBlock`.
    """

    is_sampled = False

    def __init__(self) -> None:
        """Makes the block; a box's takes a `model` and a `config` (None: the default values)."""
        super().__init__()

    def box(self) -> str:
        """What error messages call the block: its name in the diagram."""
        return self.get_name()

    def DeclareVectorOutputPort(self, *arguments: Any, **named: Any) -> OutputPort:  # noqa: N802
        """As LeafSystem's."""
        return super().DeclareVectorOutputPort(*map(weakly, arguments), **named)

    def DeclareAbstractOutputPort(self, *arguments: Any, **named: Any) -> OutputPort:  # noqa: N802
        """As LeafSystem's."""
        return super().DeclareAbstractOutputPort(*map(weakly, arguments), **named)

    if _IS_NANOBIND:
        # Where a class has none, pydrake looks for one at each evaluation of the whole diagram's
        # rates, which takes 6.5 µs; to call one takes 0.7.
        def DoCalcTimeDerivatives(  # noqa: N802
            self, context: Context, derivatives: ContinuousState
        ) -> None:
            """As LeafSystem's, which knows no rates."""
            if derivatives.size() > 0:
                raise NotImplementedError("the rates of its continuous state are unknown")


class InnerBlock(LeafBlock):
    """A LeafBlock inside a block that is a Diagram."""

    def box(self) -> str:
        """The name of the block in the loop that this is inside of, however deep."""
        names = self.GetSystemPathname().split("::")
        above = names.index(LOOP) if LOOP in names[:-1] else 0  # first comes an empty name
        return names[above + 1]


def weakly(callback: Any) -> Any:
    """A bound method as a function that does not hold its object; anything else as it is."""
    if not isinstance(callback, types.MethodType):
        return callback
    function, owner = callback.__func__, weakref.ref(callback.__self__)

    @functools.wraps(function)
    def call(*arguments: Any) -> Any:
        return function(owner(), *arguments)

    return call


def release(diagram: Diagram) -> None:
    """Clears the attributes of blocks of the user's own, which are no LeafBlocks.

    The diagram cannot be used after that. All of it can be freed but for these blocks' shells.
    """
    for system in diagram.GetSystems():
        if isinstance(system, Diagram):
            release(system)
        is_drakes = type(system).__module__.split(".")[0] == "pydrake"
        if not is_drakes and not isinstance(system, (LeafBlock, DiagramBlock)):
            vars(system).clear()
