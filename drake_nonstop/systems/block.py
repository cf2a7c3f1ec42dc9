"""The base classes of all blocks: systems of any scalar type, that Python can free.

A block is written once, as a class below `LeafBlock`. Drake's `ToAutoDiffXd`, `ToSymbolic` and
`Clone` make it again, of the same arguments, by `of_scalar`: from the same class below
`LeafSystem_[AutoDiffXd]` or `LeafSystem_[Expression]`. A `DiagramBlock` is converted by Drake, as
a Diagram of blocks that are.

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

import copy
import functools
import pickle
import re
import types
import weakref
from collections.abc import Mapping
from dataclasses import is_dataclass
from typing import Any, ClassVar

import numpy as np
from pydrake.autodiffutils import AutoDiffXd
from pydrake.symbolic import Expression, uninterpreted_function
from pydrake.systems.framework import (
    BasicVector_,
    Context,
    ContinuousState,
    Diagram,
    LeafSystem,
    LeafSystem_,
    OutputPort,
    PortDataType,
    System,
    SystemScalarConverter,
)

from drake_nonstop.systems.documentation import documented
from drake_nonstop.validation import ScenarioError

_IS_NANOBIND = type(LeafSystem).__module__.startswith("nanobind")


def _type_of_blocks() -> Any:
    """The type of systems, or one whose classes have empty `__slots__` where that is needed."""
    kind: Any = type(LeafSystem)
    if _IS_NANOBIND:
        return kind

    class Slotted(kind):
        __doc__ = vars(type)["__doc__"]  # that of a class, for `help`, which asks the metaclass

        def __new__(cls, name: str, bases: tuple[type, ...], members: dict[str, Any]) -> type:
            return super().__new__(cls, name, bases, {"__slots__": (), **members})

    return Slotted


LOOP = "nonstop"  # the name of the diagram that the blocks are in
BlockType = _type_of_blocks()


class DiagramBlock(Diagram, metaclass=BlockType):  # type: ignore[metaclass]
    """A Diagram that is freed.

    Attributes:
        reads, makes, where: what its docstring tells of its ports, see `documented`.
        is_sampled: whether its outputs, with a control period, change at the controllers' samples
            only, or, as `carrier_reference`, move along their rates in between.
        has_state_outside: whether part of its state is not in the context: a run cannot go back.
    """

    reads: ClassVar[tuple[str, ...]] = ()
    makes: ClassVar[tuple[str, ...]] = ()
    where: ClassVar[Mapping[str, str]] = {}
    is_sampled = False
    has_state_outside = False

    def __init_subclass__(cls) -> None:
        documented(cls)

    def __init__(self) -> None:
        """Makes the block; a box's takes a `model` and a `config` (None: the default values)."""
        super().__init__()


class LeafBlock(LeafSystem, metaclass=BlockType):  # type: ignore[metaclass]
    """A LeafSystem whose methods may be given to its Declare functions, and that is freed.

    It converts to the other scalar types: its methods run with contexts of each of them, where
    ports give, and take, object arrays.

    Attributes:
        reads, makes, where, is_sampled: as of `DiagramBlock`.
        has_state_outside: as of `DiagramBlock`.
        is_for_users: whether it may be in a Diagram of the user's own, and not in a `DiagramBlock`.
        scalar: the type of its numbers: float, AutoDiffXd or Expression.
        is_traced: whether its methods for a trace, where it has some, tell all that it does.
        trace_key: what the methods for a trace (`systems/diagram_trace.py`) depend on besides the
            class, its ports, states and parameters: two blocks with equal ones have one trace. It
            can be hashed; None: it is not known.
    """

    reads: ClassVar[tuple[str, ...]] = ()
    makes: ClassVar[tuple[str, ...]] = ()
    where: ClassVar[Mapping[str, str]] = {}
    is_sampled = False
    has_state_outside = False
    is_for_users = True
    is_traced = True
    scalar: ClassVar[type] = float
    _arguments: tuple[tuple[Any, ...], dict[str, Any]]

    def __init_subclass__(cls) -> None:
        documented(cls)

    def __new__(cls, *arguments: Any, **named: Any) -> "LeafBlock":
        """Remembers the arguments, for a conversion; a config may change after that."""
        block: LeafBlock = super().__new__(cls)
        kept = [copy.deepcopy(a) if is_dataclass(a) else a for a in arguments]
        block._arguments = tuple(kept), named
        return block

    def __init__(self) -> None:
        """Makes the block; a box's takes a `model` and a `config` (None: the default values)."""
        super().__init__(_CONVERTER)

    @property
    def trace_key(self) -> Any:
        """The arguments that the block was made with."""
        try:
            return pickle.dumps(self._arguments)
        except Exception:  # whatever an argument that cannot be pickled may raise
            return None

    # Drake's own give a block by itself a shell, whose ports have other names.
    def ToAutoDiffXd(self) -> Any:  # noqa: N802
        """Overrides LeafSystem's."""
        return _converted(AutoDiffXd, self)

    def ToSymbolic(self) -> Any:  # noqa: N802
        """Overrides LeafSystem's."""
        return _converted(Expression, self)

    def Clone(self) -> Any:  # noqa: N802
        """Overrides LeafSystem's."""
        return _converted(self.scalar, self)

    def require_floats(self, remedy: str) -> None:
        """Raises ScenarioError, with the remedy, where the scalar type is not float."""
        if self.scalar is not float:
            raise ScenarioError(
                f"scalar type of {self.box()} = {self.scalar.__name__}: it computes with "
                f"floating-point numbers only; {remedy}"
            )

    def box(self) -> str:
        """Name in error messages: that of the loop's block that it is in.

        In a diagram without a loop of that name it is those of all systems in between.
        """
        return box_of(self)

    def DeclareVectorOutputPort(self, *arguments: Any, **named: Any) -> OutputPort:  # noqa: N802
        """Overrides LeafSystem's.

        Where a function cannot compute with an Expression, its output in that scalar type is an
        unknown function of all inputs and states: Drake then takes all of them to feed through.
        """
        if self.scalar is Expression:
            owner = weakref.ref(self)
            arguments = tuple(_symbolic_fallback(a, owner) if callable(a) else a for a in arguments)
            named = {
                k: _symbolic_fallback(a, owner) if callable(a) else a for k, a in named.items()
            }
        return super().DeclareVectorOutputPort(*map(weakly, arguments), **named)

    def DeclareAbstractOutputPort(self, *arguments: Any, **named: Any) -> OutputPort:  # noqa: N802
        """Overrides LeafSystem's."""
        return super().DeclareAbstractOutputPort(*map(weakly, arguments), **named)

    if _IS_NANOBIND:
        # Where a class has none, pydrake looks for one at each evaluation of the whole diagram's
        # rates, which takes 6.5 µs; to call one takes 0.7.
        def DoCalcTimeDerivatives(  # noqa: N802
            self, context: Context, derivatives: ContinuousState
        ) -> None:
            """Overrides LeafSystem's, which knows no rates."""
            if derivatives.size() > 0:
                raise NotImplementedError("the rates of its continuous state are unknown")


class InnerBlock(LeafBlock):
    """A LeafBlock inside a block that is a Diagram."""

    is_for_users = False


def is_of_package(block: Any) -> bool:
    """Whether a block is one of this package's, and not a user's own."""
    return type(block).__module__.split(".")[0] == __name__.split(".")[0]


def has_own(block: Any, member: str) -> bool:
    """Whether a block has a member that is the package's, or that its class itself defines.

    What a class of the user's own inherits may not hold for it.
    """
    return hasattr(block, member) and (is_of_package(block) or member in vars(type(block)))


def title(system: System) -> str:
    """Name of a system in messages: that in its diagram, or its class where it has none."""
    name = system.get_name()
    return name if name and "@" not in name else type(system).__name__


def box_of(system: System) -> str:
    """Path of any system, as of `LeafBlock.box`; diagrams without a name are left out."""
    names = system.GetSystemPathname().split("::")[1:]
    if LOOP in names[:-1]:
        return _shown(names[names.index(LOOP) + 1])
    is_for_users = getattr(system, "is_for_users", True)
    below = [_shown(name) for name in (names[1:] if is_for_users else names[1:-1])]
    is_alone = is_for_users or names[0] == "_"
    return ".".join(filter(None, below)) or (title(system) if is_alone else names[0])


def _shown(name: str) -> str:
    """A name in a path; of one that is Drake's, "module.Class@address", the class.

    Empty: it is a Diagram, whose class says nothing.
    """
    if "@" not in name:
        return name
    shown = re.split(r"[./]", name.partition("@")[0])[-1]
    return "" if shown == Diagram.__name__ else shown


def is_converted(system: System) -> bool:
    """Whether Drake has made a system of a `DiagramBlock`: a Diagram without the block's methods.

    Such are the blocks in a loop that was converted or cloned.
    """
    if not isinstance(system, Diagram):
        return hasattr(system, "GetSystems")  # of another scalar type
    return type(system) is Diagram and any(
        isinstance(part, InnerBlock) and not part.is_for_users for part in system.GetSystems()
    )


def of_scalar(block: type, scalar: type) -> type:
    """The class below `LeafBlock`, or that of another scalar type, with numbers of that type."""
    return _of_scalar(getattr(block, "_of_float", block), scalar)


@functools.cache
def _of_scalar(block: type, scalar: type) -> type:
    if scalar is float or not issubclass(block, LeafSystem):
        return block
    if block is LeafSystem:
        return LeafSystem_[scalar]
    bases = tuple(_of_scalar(base, scalar) for base in block.__bases__)
    members = {k: v for k, v in vars(block).items() if k not in ("__dict__", "__weakref__")}
    members |= {"scalar": scalar, "_of_float": block}
    made = type(block)(block.__name__, bases, members)
    for name, member in members.items():
        setattr(made, name, _with_super_of(made, member))
    return made


def _with_super_of(owner: type, method: Any) -> Any:
    """A method with `super()` that of another class, decorated or not; anything else as it is."""
    if isinstance(method, (staticmethod, classmethod)):
        return type(method)(_with_super_of(owner, method.__func__))
    if not isinstance(method, types.FunctionType) or not method.__closure__:
        return method
    closure = tuple(
        types.CellType(owner) if name == "__class__" else _cell_with_super_of(owner, cell)
        for name, cell in zip(method.__code__.co_freevars, method.__closure__, strict=True)
    )
    made = types.FunctionType(
        method.__code__, method.__globals__, method.__name__, method.__defaults__, closure
    )
    made.__kwdefaults__ = method.__kwdefaults__
    return functools.update_wrapper(made, method)


def _cell_with_super_of(owner: type, cell: Any) -> Any:
    """The cell of a method that is decorated; any other one as it is."""
    try:
        inner = cell.cell_contents
    except ValueError:  # it is empty yet
        return cell
    if not isinstance(inner, types.FunctionType) or "__class__" not in inner.__code__.co_freevars:
        return cell
    return types.CellType(_with_super_of(owner, inner))


def _converted(scalar: type, block: LeafBlock) -> Any:
    arguments, named = block._arguments
    made = of_scalar(type(block), scalar)(*arguments, **named)
    made.set_name(block.get_name())
    declare_default_state(made, block.CreateDefaultContext())
    return made


def declare_default_state(block: Any, context: Any) -> None:
    """Makes the continuous state in a context the default one of a LeafSystem in Python.

    A second declaration replaces the first.
    """
    if context.num_continuous_states() > 0:
        state, scalar = context.get_continuous_state(), getattr(block, "scalar", float)
        vector = BasicVector_[scalar]([number(value) for value in state.CopyToVector()])
        declare = LeafSystem_[scalar].DeclareContinuousState  # a block notes what it declares
        declare(block, vector, state.num_q(), state.num_v(), state.num_z())


def _converter() -> SystemScalarConverter:
    converter = SystemScalarConverter()
    for target, source in SystemScalarConverter.SupportedConversionPairs:
        converter._AddConstructor[target, source](functools.partial(_converted, target))
    return converter


_CONVERTER = _converter()


def number(value: Any) -> float:
    """The value of a number of any scalar type.

    Raises:
        ScenarioError: it is an Expression with variables.
    """
    if isinstance(value, AutoDiffXd):
        return float(value.value())
    if isinstance(value, Expression):
        if value.GetVariables():
            raise ScenarioError(
                f"time or state = {value}: a block needs its value; give the context a number"
            )
        return float(value.Evaluate())
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


def _symbolic_fallback(calc: Any, owner: Any) -> Any:
    """Function for an output of Expressions, also where `calc` cannot compute it."""
    calc = weakly(calc)

    def call(context: Any, output: Any) -> None:
        try:
            calc(context, output)
        except ScenarioError:
            raise
        except Exception:  # such as the TypeError of math.sqrt; with numbers it is told
            known = _known_to(owner(), context)
            unknown = uninterpreted_function("unknown", known)
            output.SetFromVector(np.full(output.size(), unknown))

    return call


def _known_to(block: Any, context: Any) -> list[Expression]:
    """The time, the states and the inputs of a block of Expressions."""
    vectors = [np.array([context.get_time()])]
    vectors.append(context.get_continuous_state_vector().CopyToVector())
    for k in range(context.num_discrete_state_groups()):
        vectors.append(context.get_discrete_state(k).CopyToVector())
    for k in range(block.num_input_ports()):
        port = block.get_input_port(k)
        if port.get_data_type() == PortDataType.kVectorValued and port.HasValue(context):
            vectors.append(port.Eval(context))
    return [*np.concatenate([vector.ravel() for vector in vectors])]


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
