"""The base class of the figure's blocks: what a block is follows from what its class declares."""

import copy
import functools
import math
import numbers
import pickle
import types
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from operator import attrgetter
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import ValueProducer

from drake_nonstop.mechanics.aircraft import Aircraft
from drake_nonstop.mechanics.rigid_load import RigidLoad
from drake_nonstop.mechanics.signal_layouts import Layout
from drake_nonstop.mechanics.signals import HELD, SAMPLE_TIME, SIGNALS
from drake_nonstop.model.aircraft import FLIGHT_FIELDS
from drake_nonstop.model.system import AIRCRAFT, OFFSET, Model
from drake_nonstop.systems.block import is_of_package
from drake_nonstop.systems.documentation import own_config_class
from drake_nonstop.systems.equation_block import EquationBlock, rates_in
from drake_nonstop.systems.equations import STATE, TIME, BetweenSamples, Equations
from drake_nonstop.systems.parameters import NumericParameters
from drake_nonstop.systems.tracing import where
from drake_nonstop.validation import (
    ScenarioError,
    StrictFields,
    one_line,
    require,
    require_array,
)

# An aircraft's, but for what its motion does not go by.
AIRCRAFT_NUMBERS = (
    *(AIRCRAFT + name for name in FLIGHT_FIELDS),
    "cable_diameter",
    "cable_drag",
    "cable_length",
    "gravity",
)
AUTO = "auto"  # in the place of a field of a config that follows from the system
_ROUNDED = 1e-6  # of a period, that of a number of samples which was written in decimals
LOAD = ("load_mass", "load_inertia", "load_drag", "load_angular_drag", "gravity")


class BlockParameters(NumericParameters):
    """The parameters of a block, at first those of its model and its config.

    Args:
        model: the block's.
        of_system: the names of fields of the system, and of `Model.offset_parameter`.
        config: the block's, None where it has no parameters of its own.
        own: the names of fields of the config.
    """

    def __init__(
        self,
        model: Model,
        of_system: Iterable[str] = (),
        *,
        config: Any = None,
        own: Iterable[str] = (),
    ):
        self.model, self.of_system, self.own = model, tuple(of_system), tuple(own)
        values = {name: model.number(name) for name in self.of_system}
        super().__init__(values | {name: getattr(config, name) for name in self.own})


def rigid_load(
    load_mass: Any, load_inertia: Any, load_drag: Any, load_angular_drag: Any, gravity: Any
) -> RigidLoad:
    """The load of these parameters, `LOAD`, numbers or symbols."""
    return RigidLoad(
        mass=load_mass,
        inertia=load_inertia,
        drag=load_drag,
        angular_drag=load_angular_drag,
        gravity=gravity,
    )


def required_aircraft(model: Model, box: str, block: str) -> Aircraft:
    """The model's aircraft.

    Raises:
        ScenarioError: there is none.
    """
    if model.aircraft is None:
        raise ScenarioError(
            f"system.aircraft = none: {box} = {block} flies aircraft; give "
            f"{{model: rascal_110}}, or choose another block for {box}"
        )
    return model.aircraft


def aircraft_of(numbers: Mapping[str, Any]) -> Aircraft:
    """The aircraft of `AIRCRAFT_NUMBERS`, numbers or symbols; what flight does not go by is NaN."""
    given = {name.removeprefix(AIRCRAFT): numbers[name] for name in AIRCRAFT_NUMBERS}
    return Aircraft._make(given.get(name, math.nan) for name in Aircraft._fields)


def with_this_sample(
    state: NDArray, rate: NDArray, sample_time: Sequence[NDArray], period: float
) -> tuple[NDArray, NDArray]:
    """The rate of a sampled state, and the state after its step, which outputs may go by.

    The first step is made from the second sample on. Without a `sample_time` the state is
    continuous.
    """
    if not sample_time:
        return rate, state
    rate = where(sample_time[0][0] > 0, rate, 0 * rate)
    return rate, state + period * rate


@dataclass(kw_only=True)
class _NoConfig(StrictFields):
    """No parameters."""


class Block(EquationBlock):
    """A block of the loop: `X(model, config)` makes it from the declarations of its class X.

    XConfig, in the same module, is the dataclass of its parameters. Numbers are parameters of the
    context. `mechanics.signals`, or the class's own `signal_layouts`, has the units, sizes and
    frames of its signals:

        @dataclass(kw_only=True)
        class SpringConfig(StrictFields):
            stiffness: float = 10.0  # N/m

        class Spring(Block):
            reads = ("load_state", "reference")
            makes = ("disturbance_wrench",)

            @staticmethod
            def equations(load_state, reference, *, stiffness):
                force = stiffness * (reference[4:7] - load_state[4:7])
                return np.concatenate([np.zeros(3), force])

    `equations` takes the state, if there is one, an array (size,) for each signal of `reads`, then
    for each of its `quantities`, and the time (1,) in s if `reads_time`. By name it takes the
    attributes `of_model`, and the parameters of `system` and of the config, as arrays, numbers as
    (1,). It returns the state's rate, if there is a state, and an array for each signal of `makes`
    that does not show the state. It is plain arithmetic that runs on arrays of floats, AutoDiffXd,
    Expressions and symbols of CasADi alike: no branches on values, no `np.linalg.norm`, no writing
    into arrays. Direct feedthrough, derivatives and the block's part of a compiled loop follow from
    it.

    At each sample the states of all sampled blocks step at once, from the values held since the
    last sample. A class may have a static method `start`, which takes what `equations` takes, and
    returns the state at the start of a run.

    Attributes:
        reads, makes: names of signals.
        optional_inputs: signals of `reads` that may be left unconnected, and then are zero.
        unconnected: their values by name, if not zero.
        system: names of fields of the system that `equations` takes, and a context can change.
        of_model: attributes of the `Model` that it takes as constants, such as "attachments", or
            "pattern.basis" by the name basis.
        state_ports: signals that show the state, one part after the other.
        is_sampled: with a control period the state changes at the samples alone.
        reads_time: `equations` takes the time.
        makes_next_state: `equations` returns the next value of a sampled state, not its rate.
        is_joint: all outputs are computed together.
        model, config: the model, and a copy of the config, for all methods.

    Raises:
        ScenarioError: `check` refuses the config; a declaration, or a result of `equations`, cannot
            be used.
    """

    system: ClassVar[tuple[str, ...]] = ()
    of_model: ClassVar[tuple[str, ...]] = ()
    unconnected: ClassVar[Mapping[str, float]] = {}
    state_ports: ClassVar[tuple[str, ...]] = ()
    start: ClassVar[Callable | None] = None
    equations: Any = None
    reads_time = makes_next_state = is_joint = False
    _first_state: NDArray | None = None

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        own = vars(cls)
        below = {name for kind in cls.__mro__ if kind not in Block.__mro__ for name in vars(kind)}
        if "state" in below and "DoCalcTimeDerivatives" not in below:
            cls.DoCalcTimeDerivatives = rates_in
        for name in ("reads", "makes", "optional_inputs", "system", "of_model"):
            remedy = f'give a tuple of names, such as {name} = ("load_mass",)'
            is_tuple = isinstance(own.get(name, ()), tuple)
            require(is_tuple, f"{cls.__name__}.{name}", own.get(name), remedy)
        is_static = isinstance(own.get("equations", staticmethod(len)), staticmethod)
        remedy = "make it a @staticmethod, which takes all that it needs as arguments"
        require(is_static, f"{cls.__name__}.equations", "a method", remedy)

    def __init__(self, model: Model | None, config: Any = None):
        """Makes the block; it takes a `model` and a `config` (None: the default values).

        One that is made of other things, and goes by no system, gives None for the model.
        """
        if model is None:
            no_model: Any = types.SimpleNamespace(n=0, m=0, control_period=0.0)
            model, config = no_model, _NoConfig()
        assert model is not None
        config = own_config_class(type(self))() if config is None else config
        config = copy.deepcopy(config)  # the caller may change it
        self.model, self.config = model, config
        self.check(model, config)
        for name in self.system:
            is_known = name == OFFSET or name.startswith(AIRCRAFT) or hasattr(model.system, name)
            remedy = "give fields of the scenario's system, such as load_mass"
            require(is_known, self._said("system"), name, remedy)
        constants, parameters = self.constants(model, config), self.block_parameters(model, config)
        reads, makes, period = self.inputs(model), self.outputs(model), model.control_period
        state = self.state(model) if self._first_state is None else self._first_state
        if state is not None:
            state = require_array(self._said("state"), state, [None], "numbers, the first state")
        has_state = state is not None and self.has_state(model, config)
        if layouts := self.layouts(model, config):
            self.signal_layouts = layouts
        fixed = self.fixed_outputs()
        outputs = signal_sizes(self, model, [name for name in makes if name not in fixed])
        remedy = "write a @staticmethod of arrays, see drake_nonstop.Block"
        require(self.equations is not None, self._said("equations"), "none", remedy)
        ports = self.state_ports if has_state else ()
        between = self.between_samples(model, config) if period > 0 else None
        if between is not None:
            sizes = {name: outputs[name] for name in between.makes}
            reads_between = (*between.reads,)
            between = between._replace(reads=reads_between, makes=sizes, title=type(self).__name__)
        moved = () if between is None else between.makes
        kept = {k: _frozen(v) for k, v in constants.items()}
        own: Any = type(self)
        equations: Callable = functools.partial(own.equations, **constants)
        has_start = has_state and own.start is not None
        start = functools.partial(own.start, **constants) if has_start else None
        if state is not None and not has_state:
            equations = _without_state(equations, state)
            kept[STATE] = state.tobytes()
        own_period = self.step_period(model, config)
        remedy = "return a first state by `state`, and a time above 0 by `step_period`"
        is_sampled = self.answer is None or (has_state and own_period > 0)
        require(is_sampled, self._said("answer"), "that of no sampled state", remedy)
        samples = own_period / period if period > 0 else 0.0
        is_multiple = round(samples) > 0 and math.isclose(samples, round(samples), rel_tol=_ROUNDED)
        own_period = round(samples) * period if is_multiple else own_period
        block = Equations(
            equations,
            inputs=signal_sizes(self, model, reads),
            outputs={k: size for k, size in outputs.items() if k not in (*ports, *moved)},
            quantities=self.quantities(model),
            optional={
                name: self.unconnected.get(name, 0.0)
                for name in self.optional_inputs
                if name in reads
            },
            state=state if has_state else (),
            shown={name: outputs[name] for name in ports},
            reads_time=self.reads_time,
            parameters=parameters,
            period=own_period,
            makes_next_state=self.makes_next_state,
            start=start,
            answers=self.answer is not None,
            key=None
            if None in kept.values()
            else (own.equations, own.start, has_state, *kept.items()),
            joint=self.is_joint,
            title=own.__name__,
            motion=between,
        )
        if not is_of_package(self):
            self._require_pure(block)
        order = dict.fromkeys([*(name for name in self.makes if name in outputs), *outputs])
        super().__init__(block, sample_period=period if is_multiple else 0.0, order=[*order])
        for name, value in fixed.items():
            allocate = functools.partial(AbstractValue.Clone, AbstractValue.Make(value))
            known = {self.nothing_ticket()}
            self.DeclareAbstractOutputPort(name, allocate, ValueProducer.NoopCalc, known)

    def starting_at(self, state: NDArray) -> "Block":
        """A new block with another first state."""
        arguments, named = self._arguments
        made: Block = type(self).__new__(type(self), *arguments, **named)
        made._first_state = state
        made.__init__(*arguments, **named)  # type: ignore[misc]
        return made

    def _said(self, member: str) -> str:
        """Name of a member of the class in errors."""
        return f"{type(self).__name__}.{member}"

    def _require_pure(self, equations: Equations) -> None:
        """Raises ScenarioError where the equations are others when they are traced again."""
        # Outputs that move between samples are functions of other outputs, and of two times.
        sizes = {TIME: 1, SAMPLE_TIME: 1} | equations.outputs | equations.arguments
        values = {name: np.linspace(0.3, 0.9, size) for name, size in sizes.items()}
        for group in equations.groups:
            again = Equations._traced(equations)
            read = [values[name] for name in group.reads]
            others = [o for o in again if (o.reads, o.makes) == (group.reads, group.makes)]
            pairs = [
                zip(group.function.call(read), o.function.call(read), strict=True) for o in others
            ]
            are_same = len(pairs) == 1 and all(
                np.array_equal(a.full(), b.full(), equal_nan=True) for a, b in pairs[0]
            )
            remedy = (
                "evaluated twice, it differs: give it no random numbers, counters or clocks; noise "
                "is one of the block's `quantities`"
            )
            require(are_same, self._said("equations"), "not a pure function", remedy)

    @classmethod
    def check(cls, model: Model, config: Any) -> None:
        """Raises ScenarioError for a config that cannot be used with the model."""

    def constants(self, model: Model, config: Any) -> dict[str, Any]:
        """Further arguments of `equations` by name: numbers, arrays or functions."""
        try:
            return {name.rpartition(".")[2]: attrgetter(name)(model) for name in self.of_model}
        except AttributeError as error:
            remedy = 'give attributes of a Model, such as "attachments" or "pattern.basis"'
            field = self._said("of_model")
            raise ScenarioError(f"{field} = {one_line(error)}: {remedy}") from error

    def inputs(self, model: Model) -> tuple[str, ...]:
        """The signals that it reads; `sample_time` only if there are samples."""
        left_out = SAMPLE_TIME if SAMPLE_TIME in self.where and model.control_period == 0 else None
        return tuple(name for name in self.reads if name != left_out)

    def outputs(self, model: Model) -> tuple[str, ...]:
        """The signals that it makes."""
        return self.makes

    def fixed_outputs(self) -> Mapping[str, Any]:
        """Outputs that are objects and never change; `equations` makes the others.

        An object must not refer to the block, which would never be freed.
        """
        return {}

    def quantities(self, model: Model) -> Mapping[str, int]:
        """Names and sizes of functions of the time that `equations` takes after the signals.

        The method `precomputed_inputs(names, times)` makes rows (k, size) of each at times (k,), s,
        and, where these do not stand still, `precomputed_input_rates` their rates.
        """
        return {}

    def layouts(self, model: Model, config: Any) -> dict[str, Layout]:
        """Layouts of its outputs that differ with the config, in place of `signal_layouts`."""
        return {}

    def state(self, model: Model) -> NDArray | None:
        """The state (s,) in a new context, None if there is none."""
        return None

    @classmethod
    def has_state(cls, model: Model, config: Any) -> bool:
        """Whether the state moves; if not, `equations` always gets the first state."""
        return True

    def between_samples(self, model: Model, config: Any) -> BetweenSamples | None:
        """How outputs move between the samples of a control period; None: they do not."""
        return None

    def step_period(self, model: Model, config: Any) -> float:
        """Time between steps of a sampled state, s; 0: it is continuous."""
        return model.control_period if self.is_sampled else 0.0

    def block_parameters(self, model: Model, config: Any) -> BlockParameters:
        """Fields of system and config that are numbers, for `equations`."""
        own = [name for name, value in asdict(config).items() if _is_numeric(value)]
        return BlockParameters(model, self.system, config=config, own=own)


def _frozen(value: Any) -> Any:
    """A constant as part of a key; None: it can neither be hashed nor pickled."""
    if callable(value) and isinstance(value, Hashable):
        return value
    try:
        return pickle.dumps(value)
    except Exception:  # whatever an object of a user's own may raise
        return None


def _without_state(function: Callable, state: NDArray) -> Callable:
    """The function with a state that stays as it is, and without its rate."""

    def outputs(*inputs: NDArray, **values: NDArray) -> Any:
        return function(state, *inputs, **values)[1:]

    return outputs


def _is_numeric(value: Any) -> bool:
    """Whether a field can be a parameter of the context: a number, or an array of some."""
    if isinstance(value, bool) or not isinstance(value, numbers.Real | list | np.ndarray):
        return False
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):  # no numbers, or rows of several lengths
        return False
    return array.size > 0


def signal_sizes(block: Any, model: Model, names: Iterable[str]) -> dict[str, int]:
    """The sizes of the signals of these names, by the figure's layouts or those of the block.

    Raises:
        ScenarioError: there is no vector of a name.
    """
    layouts = SIGNALS | block.signal_layouts
    sizes = {}
    for name in names:
        layout: Any = layouts.get(name.removeprefix(HELD))
        remedy = (
            "it is no vector among the figure's signals; correct the name, or give its layout, "
            f'such as signal_layouts = {{"{name}": Layout(Part("", "3", "m"))}}'
        )
        kind = block if isinstance(block, type) else type(block)
        require(layout is not None, f"{kind.__name__} reads or makes", name, remedy)
        sizes[name] = layout.count(model.n, model.m)
    return sizes
