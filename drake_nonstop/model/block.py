"""The base class of the figure's blocks: what a block is follows from what its class declares."""

import copy
import functools
import math
import numbers
import pickle
import types
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import asdict
from operator import attrgetter
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.primitives import Selector, SelectorParams

from drake_nonstop.mechanics.aircraft import Aircraft
from drake_nonstop.mechanics.rigid_load import RigidLoad
from drake_nonstop.mechanics.signal_layouts import HELD, SIGNALS, Layout
from drake_nonstop.model.aircraft import FLIGHT_FIELDS
from drake_nonstop.model.system import AIRCRAFT, OFFSET, Model
from drake_nonstop.systems.block import BlockType
from drake_nonstop.systems.documentation import documented, own_config_class
from drake_nonstop.systems.parameters import NumericParameters
from drake_nonstop.systems.traced_block import BetweenSamples, Start, TracedBlock, TracedDynamics
from drake_nonstop.systems.tracing import NotFiniteError
from drake_nonstop.validation import ScenarioError, one_line, require, require_array

# An aircraft's, but for what its motion does not go by.
AIRCRAFT_NUMBERS = (
    *(AIRCRAFT + name for name in FLIGHT_FIELDS),
    "cable_diameter",
    "cable_drag",
    "cable_length",
    "gravity",
)
AUTO = "auto"  # in the place of a field of a config that follows from the system
LOAD = ("load_mass", "load_inertia", "load_drag", "load_angular_drag", "gravity")


def _nothing(model: Model, config: Any) -> None:
    pass


def _none(numbers: Mapping[str, Any]) -> dict[str, Any]:
    return {}


class BlockParameters(NumericParameters):
    """The parameters of a block, at first those of its model and its config.

    Args:
        model: the block's.
        of_system: the names of fields of the system, and of `Model.offset_parameter`.
        config: the block's, None where it has no parameters of its own.
        own: the names of fields of the config.
        check: raises ScenarioError for a model and a config that do not make the block.
        structure: what of their numbers decides how it is built, such as whether a gain is zero.
        fixed: fields of the system that it takes over as it is built.
        follow: takes the parameters that are of the system, numbers or arrays (1,) or (3, 3), by
            name, and returns what fields of the config are where they are `AUTO`.
    """

    def __init__(
        self,
        model: Model,
        of_system: Iterable[str] = (),
        *,
        config: Any = None,
        own: Iterable[str] = (),
        check: Callable[[Model, Any], None] = _nothing,
        structure: Callable[[Model, Any], Any] = _nothing,
        fixed: tuple[str, ...] = (),
        follow: Callable[[Mapping[str, Any]], dict[str, Any]] = _none,
    ):
        self.model, self.config, self.fixed = model, config, fixed
        self.check, self.structure, self.follow = check, structure, follow
        self.of_system, self.own = tuple(of_system), tuple(own)
        values = {name: model.number(name) for name in self.of_system}
        following = follow(values)
        of_config = {
            name: following[name] if self.is_auto(name) else getattr(config, name)
            for name in self.own
        }
        super().__init__(values | of_config)

    def with_numbers(self, model: Model, config: Any) -> "BlockParameters":
        """Those of the same block with another model and config."""
        return BlockParameters(
            model,
            self.of_system,
            config=config,
            own=self.own,
            check=self.check,
            structure=self.structure,
            fixed=self.fixed,
            follow=self.follow,
        )

    def is_auto(self, name: str) -> bool:
        """Whether a field of the config is `AUTO`."""
        return bool(getattr(self.config, name) == AUTO)


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


class Block(TracedBlock):
    """A block that is made by `X(model, config)` of what its class X declares.

    The dataclass of its parameters is XConfig, in the same module; those that are numbers are
    parameters of the context. Units, sizes and frames of its signals are those of
    `mechanics.signal_layouts`, or of its own `signal_layouts`:

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

    `equations` takes the state, if there is one, an array (size,) for each signal of `reads`, and
    the time (1,) in s if `reads_time`. By name it takes what is `of_model`, and the parameters of
    `system` and of the config, as arrays, numbers as (1,). It returns the state's rate, if there is
    a state, and an array for each signal of `makes` but `state_port`. It is plain arithmetic that
    runs on arrays of floats, AutoDiffXd, Expressions and symbols of CasADi alike: no branches on
    values, no `np.linalg.norm`, no writing into arrays. From it follow what feeds through to what,
    the derivatives, and the block's part of a compiled loop.

    Attributes:
        reads, makes: names of signals.
        optional_inputs: of those that it reads: they may be left unconnected, and then are zero.
        system: names of fields of the system that `equations` takes, and a context can change.
        of_model: attributes of the `Model` that it takes, and nothing can change, such as
            "attachments" or "pattern.basis", which it takes by the name basis.
        state_port: the signal that shows the state; None: none does.
        is_sampled: with a control period the state changes at the samples alone.
        reads_time, is_joint, is_held, updates_first: as of `TracedBlock`.
        model, config: what it was made of, a copy of the config; all hooks find them there.

    Raises:
        ScenarioError: `check` refuses the config, or a declaration, or what `equations` returns,
            cannot be used.
    """

    optional_inputs: tuple[str, ...] = ()
    system: ClassVar[tuple[str, ...]] = ()
    of_model: ClassVar[tuple[str, ...]] = ()
    state_port: ClassVar[str | None] = None
    reads_time = False
    is_joint: ClassVar[bool] = False
    is_held: ClassVar[bool] = False
    updates_first = False

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        own = vars(cls)
        below = [vars(kind) for kind in cls.__mro__ if kind not in Block.__mro__]
        if any("state" in members for members in below):
            cls.has_rates = True
            if not any("DoCalcTimeDerivatives" in members for members in below):
                cls.DoCalcTimeDerivatives = (  # type: ignore[method-assign]
                    TracedDynamics.DoCalcTimeDerivatives
                )
        for name in ("reads", "makes", "optional_inputs", "system", "of_model"):
            remedy = f'give a tuple of names, such as {name} = ("load_mass",)'
            is_tuple = isinstance(own.get(name, ()), tuple)
            require(is_tuple, f"{cls.__name__}.{name}", own.get(name), remedy)
        is_static = isinstance(own.get("equations", staticmethod(len)), staticmethod)
        remedy = "make it a @staticmethod, which takes all that it needs as arguments"
        require(is_static, f"{cls.__name__}.equations", "a method", remedy)

    def __init__(self, model: Model, config: Any = None):
        """Makes the block; it takes a `model` and a `config` (None: the default values)."""
        config = own_config_class(type(self))() if config is None else config
        config = copy.deepcopy(config)  # the caller may change it
        self.model, self.config = model, config
        self.check(model, config)
        constants, parameters = self.constants(model, config), self.block_parameters(model, config)
        reads, period = self.inputs(model), model.control_period
        state = self.state(model)
        if state is not None:
            state = require_array(self._said("state"), state, [None], "numbers, the first state")
        has_state = state is not None and self.has_state(model, config)
        if layouts := self.layouts(model, config):
            self.signal_layouts = layouts
        outputs = signal_sizes(self, model, self.makes)
        self._require_sound(constants, parameters, reads, has_state)
        made = {name: size for name, size in outputs.items() if name != self.state_port}
        if state is not None:
            made = {"the state's rate": len(state)} | made
        equations: Any = type(self).equations
        function = self._explained("equations", functools.partial(equations, **constants), made)
        kept = [(k, v if callable(v) else pickle.dumps(v)) for k, v in constants.items()]
        if state is not None and not has_state:
            function = _without_state(function, state)
            kept.append(("state", state.tobytes()))
        super().__init__(
            function,
            inputs=signal_sizes(self, model, reads),
            outputs=outputs,
            optional=[name for name in self.optional_inputs if name in reads],
            known=self.quantities(model),
            reads_time=self.reads_time,
            parameters=parameters,
            key=(equations, has_state, *kept),
            is_joint=self.is_joint,
            between=self._moved(outputs) if period > 0 else None,
            state=state if has_state else None,
            state_port=self.state_port,
            period=period if self.is_sampled else 0.0,
            updates_first=self.updates_first,
            start=self.start() if has_state else None,
            is_held=self.is_held,
        )

    def _said(self, member: str) -> str:
        """Name of a member of the class in errors."""
        return f"{type(self).__name__}.{member}"

    def _require_sound(
        self,
        constants: Mapping[str, Any],
        parameters: BlockParameters,
        reads: Collection[str],
        has_state: bool,
    ) -> None:
        """Raises ScenarioError for declarations that contradict each other."""
        remedy = "write a @staticmethod of arrays, see drake_nonstop.Block"
        require(hasattr(type(self), "equations"), self._said("equations"), "none", remedy)
        port, remedy = self.state_port, "name one of the signals that it makes, of a state"
        is_shown = port is None or (port in self.makes and has_state)
        require(is_shown, self._said("state_port"), port, remedy)
        for name in self.optional_inputs:
            remedy = "name signals that it reads"
            is_read = name in reads or name in self.reads
            require(is_read, self._said("optional_inputs"), name, remedy)
        for name, value in constants.items():
            is_bound = isinstance(value, types.MethodType) and value.__self__ is self
            remedy = "it would be kept with the block; make it a @staticmethod"
            require(not is_bound, self._said("constants"), f"{name}, a method of it", remedy)
        last_parts = [name.rpartition(".")[2] for name in self.of_model]
        names = [*{*constants} - {*last_parts}, *last_parts]
        names += [*parameters.of_system, *parameters.own]
        twice = [name for name in dict.fromkeys(names) if names.count(name) > 1]
        remedy = "constants, fields of the system and of the config need different names"
        require(not twice, type(self).__name__, ", ".join(twice), remedy)

    def _moved(self, outputs: Mapping[str, int]) -> BetweenSamples | None:
        """Outputs that move between samples, checked."""
        between = self.between_samples(self.model, self.config)
        if between is None:
            return None
        for name in (*between.reads, *between.makes):
            remedy = f"name signals that it makes: {', '.join(outputs)}"
            require(name in outputs, self._said("between_samples"), name, remedy)
        sizes = {name: outputs[name] for name in between.makes}
        function = self._explained("between_samples", between.function, sizes)
        return between._replace(function=function)

    @classmethod
    def check(cls, model: Model, config: Any) -> None:
        """Raises ScenarioError for a config that cannot be used with the model."""

    def constants(self, model: Model, config: Any) -> dict[str, Any]:
        """Arguments of `equations` by name besides parameters: numbers, arrays or functions."""
        try:
            return {name.rpartition(".")[2]: attrgetter(name)(model) for name in self.of_model}
        except AttributeError as error:
            remedy = 'give attributes of a Model, such as "attachments" or "pattern.basis"'
            field = self._said("of_model")
            raise ScenarioError(f"{field} = {one_line(error)}: {remedy}") from error

    def inputs(self, model: Model) -> tuple[str, ...]:
        """The signals that it reads."""
        return self.reads

    def quantities(self, model: Model) -> Mapping[str, int]:
        """Names and sizes of functions of the time that `equations` takes after the signals.

        The methods `precomputed_inputs` and `precomputed_input_rates` make them, see `TracedBlock`.
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
        """Whether the state moves; if not, `equations` always gets that of a new context."""
        return True

    def start(self) -> Start | None:
        """Function for the state at the start of a run; None: it stays as it is."""
        return None

    def between_samples(self, model: Model, config: Any) -> BetweenSamples | None:
        """How outputs move between the samples of a control period; None: they do not."""
        return None

    def block_parameters(self, model: Model, config: Any) -> BlockParameters:
        """Fields of system and config that `equations` takes: those that are numbers."""
        own = [name for name, value in asdict(config).items() if _is_numeric(value)]
        return self.parameters_of(model, config, own)

    def parameters_of(
        self,
        model: Model,
        config: Any,
        own: Iterable[str],
        *,
        system: Iterable[str] | None = None,
        **rules: Any,
    ) -> BlockParameters:
        """The parameters of these fields of the config, and of the `system`.

        The others are as of `BlockParameters`.
        """
        system = self.system if system is None else system
        for name in system:
            is_known = name == OFFSET or name.startswith(AIRCRAFT) or hasattr(model.system, name)
            remedy = "give fields of the scenario's system, such as load_mass"
            require(is_known, f"{type(self).__name__}.system", name, remedy)
        rules = {"check": self.check, "structure": self.has_state} | rules
        return BlockParameters(model, system, config=config, own=own, **rules)

    def _explained(self, member: str, function: Callable, sizes: Mapping[str, int]) -> Callable:
        """A function that returns arrays of these sizes; what is wrong is said in a sentence.

        It runs when it is traced, and on AutoDiffXd and Expression.
        """
        field = self._said(member)
        remedy = "return an array for each of " + ", ".join(f"{k} ({v})" for k, v in sizes.items())

        def explained(*inputs: NDArray, **values: NDArray) -> tuple[NDArray, ...]:
            try:
                made = function(*inputs, **values)
                made = made if isinstance(made, tuple) else (made,)
                arrays = tuple(np.asarray(each) for each in made)
            except (ScenarioError, NotFiniteError):
                raise
            except Exception as error:  # whatever a user's own code may raise
                plain = (
                    "take what is declared, and compute by arithmetic of arrays, without branches"
                )
                raise ScenarioError(f"{field} = {one_line(error)}: {plain}") from error
            found = [array.size for array in arrays]
            require(found == [*sizes.values()], field, f"arrays of {found} numbers", remedy)
            return arrays

        return explained


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
    layouts = SIGNALS | getattr(block, "signal_layouts", {})
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


class SelectorBlock(Selector, metaclass=BlockType):
    """A block whose signal has entries of those that it reads: without a call into Python."""

    reads: ClassVar[tuple[str, ...]] = ()
    makes: ClassVar[tuple[str, ...]] = ()

    def __init_subclass__(cls) -> None:
        documented(cls)

    def __init__(self, model: Model, config: Any = None):
        """Makes the block; it takes a `model` and a `config` (None: the default values)."""
        sizes = signal_sizes(type(self), model, self.reads)
        inputs = [SelectorParams.InputPortParams(name=k, size=size) for k, size in sizes.items()]
        places = [(i, k) for i, size in enumerate(sizes.values()) for k in range(size)]
        selections = [
            SelectorParams.OutputSelection(input_port_index=i, input_offset=k)
            for i, k in (places[entry] for entry in self.entries(len(places)))
        ]
        (name,) = self.makes
        output = SelectorParams.OutputPortParams(name=name, selections=selections)
        super().__init__(SelectorParams(inputs=inputs, outputs=[output]))

    @staticmethod
    def entries(count: int) -> Iterable[int]:
        """Numbers of the stacked inputs, so many, that the output has: all of them."""
        return range(count)
