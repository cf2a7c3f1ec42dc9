"""The base classes of all blocks: systems of any scalar type, that Python can free.

A block is written once, as a class below `LeafBlock`. Drake's `ToAutoDiffXd`, `ToSymbolic` and
`Clone` make it again, of the same arguments, by `of_scalar`: of a class with the same methods above
`LeafSystem_[AutoDiffXd]` or `LeafSystem_[Expression]`. A `DiagramBlock` is converted by Drake, as
a Diagram of blocks that are.

A run has to give its memory back once it is over, or a sweep of many runs out of it. Three
things keep a system written in Python alive, and with it all of its diagram, some 7 MB a
run (https://github.com/RobotLocomotion/drake/issues/22515):

- A Python class below those of pydrake gets a dictionary that Python 3.11's garbage collector
  counts twice, so that it takes it for held from outside. A class with empty `__slots__` has the
  dictionary of the class above it only, where attributes go, too.
- What C++ calls back is a bound method, which holds the system that holds it, where the
  collector cannot see it. A function that finds the system by a weak reference does not.
- A CacheEntry holds its system, too, unseen: a block keeps its index, and not the entry.
"""

import copy
import functools
import re
import types
import weakref
from collections.abc import Mapping
from dataclasses import is_dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydrake.autodiffutils import AutoDiffXd
from pydrake.symbolic import Expression, uninterpreted_function
from pydrake.systems.framework import (
    BasicVector_,
    Context,
    Diagram,
    Diagram_,
    LeafSystem,
    LeafSystem_,
    OutputPort,
    PortDataType,
    System,
    SystemScalarConverter,
)

from drake_nonstop.systems.documentation import declared_by, documented
from drake_nonstop.validation import ScenarioError

LOOP = "nonstop"  # the name of the diagram that the blocks are in
_DRAKES: Any = type(LeafSystem)


class BlockType(_DRAKES):  # noqa: D101
    __doc__ = vars(type)["__doc__"]  # that of a class, for `help`, which asks the metaclass

    def __new__(cls, name: str, bases: tuple[type, ...], members: dict[str, Any]) -> Any:
        """A class with empty `__slots__`."""
        return super().__new__(cls, name, bases, {"__slots__": (), **members})

    def mro(self) -> Any:
        """Of another scalar type: the classes of the block of floats, in front of Drake's."""
        if (of_floats := vars(self).get("of_floats")) is None:
            return super().mro()
        own = [kind for kind in of_floats.__mro__ if kind not in LeafSystem.__mro__]
        return [self, *own, *self.__bases__[0].__mro__]


def title(system: System) -> str:
    """Name of a system in messages: that in its diagram, or its class where it has none."""
    name = system.get_name()
    return name if name and "@" not in name else type(system).__name__


def box_of(system: System) -> str:
    """Name of a system in error messages: that of the loop's block that it is in.

    In a diagram without a loop of that name it is those of all systems in between, where they have
    one.
    """
    names = system.GetSystemPathname().split("::")[1:]
    if LOOP in names[:-1]:
        return _shown(names[names.index(LOOP) + 1])
    is_inner = isinstance(system, InnerBlock)
    below = filter(None, map(_shown, names[1:-1] if is_inner else names[1:]))
    is_alone = not is_inner or names[0] == "_"
    return ".".join(below) or (title(system) if is_alone else names[0])


def _shown(name: str) -> str:
    """A name in a path; of one that is Drake's, "module.Class@address", the class.

    Empty: it is a Diagram, whose class says nothing.
    """
    if "@" not in name:
        return name
    shown = re.split(r"[./]", name.partition("@")[0])[-1]
    return "" if shown == Diagram.__name__ else shown


class _Declaring:
    __slots__ = ()
    reads: ClassVar[tuple[str, ...]] = ()
    makes: ClassVar[tuple[str, ...]] = ()
    where: ClassVar[Mapping[str, str]] = {}
    optional_inputs: tuple[str, ...] = ()
    signal_layouts: Mapping[str, Any] = {}
    is_sampled = False

    def __init_subclass__(cls) -> None:
        documented(cls)


class DiagramBlock(_Declaring, Diagram, metaclass=BlockType):
    """A Diagram that is freed.

    Attributes:
        reads, makes, where: what its docstring tells of its ports, see `documented`.
        optional_inputs: of those that it reads: they may be left unconnected.
        signal_layouts: of its signals that the figure does not have, by name.
        is_sampled: whether its outputs, with a control period, change at the controllers' samples
            only, or move along their rates in between.
    """

    def __init__(self) -> None:
        """Makes the block; a box's takes a `model` and a `config` (None: the default values)."""
        super().__init__()


class LeafBlock(_Declaring, LeafSystem, metaclass=BlockType):
    """A LeafSystem whose Declare functions take its methods, and that Python frees.

    It converts to AutoDiffXd and Expression: its methods then run with contexts of these types,
    whose ports give and take object arrays.

    Attributes:
        reads, makes and so on: as of `DiagramBlock`.
        scalar: the type of its numbers: float, AutoDiffXd or Expression.

    A loop with such a block is flown by its diagram; a `Block` has equations.
    """

    scalar: ClassVar[type] = float
    of_floats: ClassVar[type | None] = None
    _arguments: tuple[tuple[Any, ...], dict[str, Any]]

    def __new__(cls, *arguments: Any, **named: Any) -> "LeafBlock":
        """Remembers the arguments, for a conversion; a config may change after that."""
        block: LeafBlock = super().__new__(cls)
        kept = [copy.deepcopy(a) if is_dataclass(a) else a for a in arguments]
        block._arguments = tuple(kept), named
        return block

    def __init__(self) -> None:
        """Makes the block; a box's takes a `model` and a `config` (None: the default values)."""
        super().__init__(_CONVERTER)

    def _converted(self, scalar: type) -> Any:
        arguments, named = self._arguments
        made = of_scalar(type(self), scalar)(*arguments, **named)
        made.set_name(self.get_name())
        declare_default_state(made, self.CreateDefaultContext())
        return made

    # Drake's own give a block by itself a shell, whose ports have other names.
    ToAutoDiffXd = functools.partialmethod(_converted, AutoDiffXd)
    ToSymbolic = functools.partialmethod(_converted, Expression)

    def Clone(self) -> Any:  # noqa: N802
        """Overrides LeafSystem's."""
        return self._converted(self.scalar)

    box = box_of

    def require_floats(self, remedy: str) -> None:
        """Raises ScenarioError, with the remedy, where the scalar type is not float."""
        if self.scalar is not float:
            raise ScenarioError(
                f"scalar type of {self.box()} = {self.scalar.__name__}: it computes with "
                f"floating-point numbers only; {remedy}"
            )

    def DeclareVectorOutputPort(self, *arguments: Any, **named: Any) -> OutputPort:  # noqa: N802
        """Overrides LeafSystem's.

        Where a function cannot compute with an Expression, its output in that scalar type is an
        unknown function of all inputs and states: Drake then takes all of them to feed through.
        """
        made: Any = weakly
        if self.scalar is Expression:
            made = functools.partial(_symbolic_fallback, weakref.ref(self))
        given = {name: made(value) for name, value in named.items()}
        return super().DeclareVectorOutputPort(*map(made, arguments), **given)

    def DeclareAbstractOutputPort(self, *arguments: Any, **named: Any) -> OutputPort:  # noqa: N802
        """Overrides LeafSystem's."""
        return super().DeclareAbstractOutputPort(*map(weakly, arguments), **named)


class InnerBlock(LeafBlock):
    """A LeafBlock inside a block that is a Diagram."""


def is_of_package(block: Any) -> bool:
    """Whether a block is one of this package's, and not a user's own."""
    return type(block).__module__.split(".")[0] == __name__.split(".")[0]


def is_converted(system: System) -> bool:
    """Whether Drake has made a system of a `DiagramBlock`: a Diagram without the block's methods.

    Such are the blocks in a loop that was converted or cloned.
    """
    if type(system) is Diagram:
        return any(isinstance(part, InnerBlock) for part in system.GetSystems())
    return isinstance(system, (Diagram_[AutoDiffXd], Diagram_[Expression]))


@functools.cache
def of_scalar(block: type[LeafBlock], scalar: type) -> type:
    """The class below `LeafBlock`, or that of another scalar type, with numbers of that type."""
    if block.of_floats is not None:
        return of_scalar(block.of_floats, scalar)
    if scalar is float:
        return block
    members = {name: vars(block)[name] for name in ("__module__", "__doc__")}
    members |= {"scalar": scalar, "of_floats": block, "__qualname__": block.__qualname__}
    return BlockType(block.__name__, (LeafSystem_[scalar],), members)


_CONVERTER = SystemScalarConverter()
for _target, _source in SystemScalarConverter.SupportedConversionPairs:
    _convert = functools.partial(LeafBlock._converted, scalar=_target)
    _CONVERTER._AddConstructor[_target, _source](_convert)


def declare_default_state(block: Any, context: Any) -> None:
    """Makes the continuous state in a context the default one of a LeafSystem in Python.

    A second declaration replaces the first.
    """
    if context.num_continuous_states() > 0:
        state, scalar = context.get_continuous_state(), declared_by(block, "scalar", float)
        vector = BasicVector_[scalar]([number(value) for value in state.CopyToVector()])
        declare = LeafSystem_[scalar].DeclareContinuousState  # a block notes what it declares
        declare(block, vector, state.num_q(), state.num_v(), state.num_z())


def state_values(context: Context) -> NDArray:
    """All numeric states of a system in one array, the continuous ones first."""
    groups = range(context.num_discrete_state_groups())
    discrete = [context.get_discrete_state(i).CopyToVector() for i in groups]
    return np.concatenate([context.get_continuous_state_vector().CopyToVector(), *discrete])


def set_state_values(context: Context, values: NDArray) -> None:
    """Sets all numeric states of a system, in the order of `state_values`."""
    start = context.num_continuous_states()
    if start:
        context.SetContinuousState(values[:start])
    for i in range(context.num_discrete_state_groups()):
        end = start + context.get_discrete_state(i).size()
        context.SetDiscreteState(i, values[start:end])
        start = end


def number(value: Any) -> float:
    """The value of a number of any scalar type.

    Raises:
        ScenarioError: it is an Expression with variables.
    """
    if isinstance(value, Expression) and value.GetVariables():
        raise ScenarioError(
            f"time or state = {value}: a block needs its value; give the context a number"
        )
    if isinstance(value, (AutoDiffXd, Expression)):
        value = value.value() if isinstance(value, AutoDiffXd) else value.Evaluate()
    return float(value)


def weakly(callback: Any) -> Any:
    """A bound method as a function that does not hold its object; anything else as it is."""
    if not isinstance(callback, types.MethodType):
        return callback
    function, owner = callback.__func__, weakref.ref(callback.__self__)

    @functools.wraps(function)
    def call(*arguments: Any) -> Any:
        return function(owner(), *arguments)

    return call


def _symbolic_fallback(owner: Any, calc: Any) -> Any:
    """Function for an output of Expressions, also where `calc` cannot compute it."""
    if not callable(calc):
        return calc
    calc = weakly(calc)

    def call(context: Any, output: Any) -> None:
        try:
            calc(context, output)
        except ScenarioError:
            raise
        except Exception:  # such as the TypeError of math.sqrt; with numbers it is told
            unknown = uninterpreted_function("unknown", _known_to(owner(), context))
            output.SetFromVector(np.full(output.size(), unknown))

    return call


def _known_to(block: Any, context: Any) -> list[Expression]:
    """The time, the states and the inputs of a block of Expressions."""
    inputs = [
        port.Eval(context)
        for port in map(block.get_input_port, range(block.num_input_ports()))
        if port.get_data_type() == PortDataType.kVectorValued and port.HasValue(context)
    ]
    return [context.get_time(), *np.concatenate([state_values(context), *inputs])]


def release(diagram: Diagram) -> None:
    """Clears the attributes of blocks of the user's own, which are no LeafBlocks.

    The diagram cannot be used after that. All of it can be freed but for these blocks' shells.
    """
    for system in diagram.GetSystems():
        if isinstance(system, Diagram):
            release(system)
        is_drakes = type(system).__module__.split(".")[0] == "pydrake"
        if not is_drakes and not isinstance(system, _Declaring):
            vars(system).clear()
