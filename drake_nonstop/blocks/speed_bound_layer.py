"""The base of layers of the box "Optimization Layer": ports, states, updates and the bound."""

import weakref
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from typing import Any, ClassVar, NamedTuple

import casadi
import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.common.value import AbstractValue, Value
from pydrake.systems.framework import (
    BasicVector_,
    Context,
    DependencyTicket,
    DiscreteValues,
    ValueProducer,
)

from drake_nonstop.mechanics.rigid_load import STILL_AIR
from drake_nonstop.mechanics.signal_layouts import SIGNALS
from drake_nonstop.model.block import AIRCRAFT_NUMBERS, BlockParameters
from drake_nonstop.model.system import Model
from drake_nonstop.optimization.diagnostics import (
    DIAGNOSTICS_SIZE,
    LAYER_LAYOUTS,
    Outcome,
    count_update,
    missed_layout,
    missed_limits_of,
)
from drake_nonstop.optimization.problem_config import (
    LEAST_BOUND,
    check_speed_bound,
    highest_speed_bound,
    with_stated_bound,
)
from drake_nonstop.optimization.update_data import OF_CONFIG, OF_MODEL, beliefs_from
from drake_nonstop.systems.block import LeafBlock, weakly
from drake_nonstop.systems.diagram_trace import InContext, TraceContext
from drake_nonstop.systems.documentation import own_config_class
from drake_nonstop.systems.parameters import declare_parameters
from drake_nonstop.systems.requirements import LoopBlocks
from drake_nonstop.systems.tracing import where
from drake_nonstop.validation import require

BOX = "optimization_layer"
COMMAND = "speed_bound_command"  # an optional input of the box
WIND = "wind_estimate"  # an optional input of the box, of aircraft
_MISSED = "missed_limits"
# Of bowed cables, besides the numbers that layers follow.
_OF_BOW = ("cable_diameter", "cable_density", "cable_drag", "cable_friction")


class PeriodicLayer(LeafBlock):
    """A layer that makes an update every some samples of the controllers, and counts how they end.

    It declares the inputs of `reads`. A class below calls `declare`; its `updated` makes the states
    after an update.

    Args:
        model: what the controllers believe.
        config: the layer's, None: the default values.

    Attributes:
        computed: the outputs of `shown`; the others show the states of their names.
    """

    makes: ClassVar[tuple[str, ...]] = (
        "parameters",
        "diagnostics",
        "solve_time",
        "speed_bound",
        _MISSED,
    )

    where: ClassVar = {WIND: "there are aircraft", _MISSED: "limits are asked for"}
    computed: ClassVar[tuple[str, ...]] = ("speed_bound",)
    is_sampled = True
    signal_layouts = LAYER_LAYOUTS
    optional_inputs: tuple[str, ...] = (COMMAND, WIND)

    def __init__(self, model: Model, config: Any = None):
        super().__init__()
        config = with_stated_bound(BOX, config or own_config_class(type(self))(), model)
        self.check(model, config)
        self._model, self._config = model, config
        self.parameters = self.block_parameters(model, config)
        declare_parameters(self, self.parameters)
        for name in filter(SIGNALS.__contains__, self.reads):  # others a class below declares
            if SIGNALS[name] is None:
                self.DeclareAbstractInputPort(name, Value(object()))
            elif name != WIND or model.aircraft is not None:
                self.DeclareVectorInputPort(name, _size(model, name))

    counts_bow = False  # whether it plans for the ends of bowed cables

    def requires(self, loop: LoopBlocks) -> Iterator[str]:
        """Tells that carriers on bowed cables fly other orbits than it plans."""
        counts_bow = self.counts_bow and self._model.cable_shape is not None
        if not counts_bow and getattr(loop.get("cables"), "bears_drag", False):
            yield (
                f"optimization_layer = {type(self).__name__}: it plans for straight cables, and "
                "these bow: carriers fly up to some tenths of a m/s slower than it plans, and bank "
                "more; give RecedingHorizonOptimizer, or a speed_bound that is so much higher"
            )

    @classmethod
    def check(cls, model: Model, config: Any) -> None:
        """Raises ScenarioError for a config that cannot be used with the model."""

    def block_parameters(self, model: Model, config: Any) -> BlockParameters:
        """Fields of system and config that the context holds."""
        raise NotImplementedError

    def updated(self, context: Context) -> Mapping[str, ArrayLike]:
        """The states that an update changes, by name, after it."""
        raise NotImplementedError

    def declare(self, period: float, **states: ArrayLike) -> None:
        """Declares the states, the outputs and the updates, every `period` s.

        `states` are what the first update finds. Those that all layers have come after the first.
        """
        counts = _MISSED in self.makes
        self._counted = missed_limits_of(self._config, self._model) if counts else ()
        self.signal_layouts = {_MISSED: missed_layout(self._counted)} if self._counted else {}
        first = next(iter(states))
        shared = {"diagnostics": np.zeros(DIAGNOSTICS_SIZE), "solve_time": np.zeros(1)}
        values: dict[str, ArrayLike] = {first: states[first], **shared, **states}
        if self._counted:
            values[_MISSED] = np.zeros(len(self._counted))
        self._groups = {name: self.DeclareDiscreteState(value) for name, value in values.items()}
        for name in self.makes:
            if name in self._groups:
                self.DeclareStateOutputPort(name, self._groups[name])
            elif name in self.computed:
                calc, size = self._shown(name), _size(self._model, name)
                self.DeclareVectorOutputPort(name, size, calc, self.sources_of(name))
        # An event at each sample of the controllers, of which every `_samples_per_update`-th is an
        # update. An event of the update's own period would, by rounding, come at some of their
        # samples and just before others.
        self._sample_period = self._model.control_period or period
        self._samples_per_update = round(period / self._sample_period)
        # Offset = period: with offset 0 the periodic event would repeat the first one.
        self.DeclareInitializationDiscreteUpdateEvent(self._update)
        self.DeclarePeriodicDiscreteUpdateEvent(
            self._sample_period, self._sample_period, self._update_at_sample
        )

    def sources_of(self, output: str) -> set[DependencyTicket]:
        """Prerequisites of an output that is `computed`."""
        return self.tickets(COMMAND)

    def shown(self, output: str, context: Context) -> NDArray:
        """Value of an output that is `computed`."""
        return self.bound_in(context)

    def tickets(self, *inputs: str) -> set[DependencyTicket]:
        """Tickets of the parameters, and of the inputs of these names that there are."""
        ports = (self.GetInputPort(name) for name in inputs if self.HasInputPort(name))
        return {
            self.all_parameters_ticket(),
            *(self.input_port_ticket(port.get_index()) for port in ports),
        }

    def states(self, at: TraceContext | InContext) -> dict[str, NDArray]:
        """The states by name, as they were declared."""
        return {name: at.state(1 + int(group)) for name, group in self._groups.items()}

    def wind(self, at: TraceContext | InContext) -> NDArray:
        """The wind (3,) that aircraft fly in, m/s, in W; still air where it is not told."""
        return at.input_or(WIND, STILL_AIR) if self.HasInputPort(WIND) else STILL_AIR

    def counted(
        self,
        states: dict[str, NDArray],
        outcome: Outcome,
        margin: Any,
        missed: Collection[str] = (),
    ) -> dict[str, NDArray]:
        """The states that count updates, after one.

        Its speed margin (m/s) may be a symbol; it misses the limits of these names.
        """
        after = {name: states[name].copy() for name in ("diagnostics", _MISSED) if name in states}
        count_update(after["diagnostics"], outcome, margin)
        if self._counted:
            after[_MISSED] += [name in missed for name in self._counted]
        return after

    def is_update(self, time: Any) -> Any:
        """Whether a sample at a time (s), a number or symbol, is one of an update."""
        samples = casadi.floor(time / self._sample_period + 0.5)
        return casadi.fmod(samples, self._samples_per_update) == 0

    def _update_at_sample(self, context: Context, discrete_state: DiscreteValues) -> None:
        if self.is_update(context.get_time()):
            self._update(context, discrete_state)

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        amplitude = "amplitude 0" if self._model.pattern.is_constant else "amplitude"
        self.require_floats(
            f"give ConstantParameters, with its frequency and {amplitude}, in place of "
            f"{type(self).__name__}"
        )
        for name, values in self.updated(context).items():
            discrete_state.set_value(self._groups[name], values)

    def bound_in(self, context: Context) -> NDArray:
        """ε (1,), m/s."""
        values = context.get_numeric_parameter(0).CopyToVector()
        return values[self.parameters.place("speed_bound")]

    def _shown(self, output: str) -> Any:
        me: Any = weakref.ref(self)
        return lambda context, vector: vector.SetFromVector(me().shown(output, context))


def _size(model: Model, name: str) -> int:
    """That of a signal which is a vector."""
    layout = SIGNALS[name]
    assert layout is not None
    return layout.count(model.n, model.m)


class CommandedBound(LeafBlock):
    """A block of which ε is the parameter `speed_bound`, unless there is a command."""

    def check_bound(self, speed_bound: float, name: str = "speed_bound") -> None:
        """Raises ScenarioError for what is no bound (m/s), by the name that it has in the box."""
        raise NotImplementedError

    def set_speed_bound(self, context: Context, speed_bound: float) -> None:
        """Sets another ε (m/s) from the next update on; the context is the block's own.

        Raises:
            ScenarioError: the bound is none of the block, or `speed_bound_command` is connected.
        """
        self.require_effect(context, "speed_bound", speed_bound)
        self.check_bound(speed_bound)
        values = context.get_mutable_numeric_parameter(0)
        values.SetAtIndex(self.parameters.place("speed_bound").start, speed_bound)

    def require_effect(self, context: Context, name: str, value: Any) -> None:
        """Raises ScenarioError where a parameter that is set would have none in this context."""
        if name == "speed_bound":
            require(
                not self.GetInputPort(COMMAND).HasValue(context),
                f"{BOX}.speed_bound",
                value,
                f"the signal {COMMAND} sets the bound: change it in the block that makes that "
                "signal, or take the signal away",
            )

    def bound_in(self, context: Context) -> NDArray:
        """ε (1,), m/s: what is commanded, or else as it was set."""
        command = self.GetInputPort(COMMAND)
        if not command.HasValue(context):
            values = context.get_numeric_parameter(0).CopyToVector()
            return values[self.parameters.place("speed_bound")]
        bound = command.Eval(context)
        if self.scalar is float:
            self.check_bound(float(bound[0]), COMMAND)
        return bound


class LayerNumbers(NamedTuple):
    """Values that a layer takes of its parameters."""

    speed_bound: float  # m/s
    nominal: NDArray  # (2,), [ξ, A] at the start, rad/s and N
    beliefs: NDArray  # a flat `ModelParameters`


class SpeedBoundLayer(CommandedBound, PeriodicLayer):
    """A layer that keeps a speed bound, which may change during a run.

    Attributes:
        highest_speed_bound: m/s, below which a bound has to be.
    """

    def __init__(self, model: Model, config: Any = None):
        super().__init__(model, config)
        entry = self.DeclareCacheEntry(
            "numbers",
            ValueProducer(Value(()).Clone, weakly(self._calc_numbers)),
            {self.all_parameters_ticket()},
        )
        self._numbers = entry.cache_index()  # the entry would keep this block alive
        self._enabled = self.DeclareNumericParameter(BasicVector_[self.scalar]([1.0]))
        self.highest_speed_bound = highest_speed_bound(self._config)

    @classmethod
    def structure(cls, model: Model, config: Any) -> Any:
        """Values that decide how the layer is built, see `BlockParameters`."""

    def block_parameters(self, model: Model, config: Any) -> BlockParameters:
        """Checks as `PeriodicLayer` does; amplitude bounds of zero are those from the weight."""
        kind = type(self)

        def check(model: Model, config: Any) -> None:
            if not any(config.amplitude_bounds):
                config = replace(config, amplitude_bounds=[])
            kind.check(model, config)
            check_bound(highest_speed_bound(config), config.speed_bound)

        return BlockParameters(
            model,
            (*OF_MODEL, *model.offset_parameter),
            config=replace(config, amplitude_bounds=config.amplitude_bounds or [0.0, 0.0]),
            own=("speed_bound", *OF_CONFIG),
            check=check,
            structure=kind.structure,
            fixed=(
                *(AIRCRAFT_NUMBERS if model.aircraft is not None else ()),
                *(_OF_BOW if model.cable_shape is not None else ()),
            ),
        )

    def check_bound(self, speed_bound: float, name: str = "speed_bound") -> None:
        """Raises ScenarioError for neither 0 nor from 1e-3 m/s to below the highest bound."""
        check_bound(self.highest_speed_bound, speed_bound, name)

    def set_speed_bound(self, context: Context, speed_bound: float) -> None:
        """Bound of `CommandedBound`."""
        super().set_speed_bound(context, speed_bound)
        self.begin_anew(context)

    def begin_anew(self, context: Context) -> None:
        """Lets what has not been updated begin with the parameters of the context, its own."""

    def set_enabled(self, context: Context, enabled: bool) -> None:
        """Switches the layer on or off from the next update on; the context is the block's own."""
        context.get_mutable_numeric_parameter(self._enabled).SetFromVector([float(enabled)])

    def is_enabled(self, context: Context) -> bool:
        """Whether the layer is switched on."""
        return bool(context.get_numeric_parameter(self._enabled).CopyToVector()[0])

    def trace_parameters(self, context: Context) -> NDArray:
        """The speed bound and the highest one (2,), m/s, which are no part of a trace."""
        return np.array([self._numbers_in(context).speed_bound, self.highest_speed_bound])

    def traced_bound(self, at: TraceContext) -> NDArray:
        """ε (1,), m/s: as set, or what is commanded; no number where that is out of range."""
        if not at.has_input(COMMAND):
            return at.parameters[:1]
        command, highest = at.input(COMMAND), at.parameters[1]
        is_bound = casadi.logic_and(command[0] >= LEAST_BOUND, command[0] < highest)
        is_bound = casadi.logic_or(command[0] == 0, is_bound)
        return where(is_bound, command, np.array([np.nan]))

    def traced_output(self, port: str, at: TraceContext) -> NDArray:
        """Value of a port."""
        return self.traced_bound(at) if port == "speed_bound" else self.states(at)[port]

    def _numbers_in(self, context: Context) -> LayerNumbers:
        return self.get_cache_entry(self._numbers).Eval(context)

    def _calc_numbers(self, context: Context, value: AbstractValue) -> None:
        values = self.parameters.view(context.get_numeric_parameter(0).CopyToVector())
        beliefs = beliefs_from(values, self._model.n)
        bound = float(values["speed_bound"][0])
        value.set_value(LayerNumbers(bound, beliefs.nominal, np.concatenate(beliefs)))


def check_bound(highest: float, speed_bound: float, name: str = "speed_bound") -> None:
    """Raises ScenarioError for what is no speed bound, or is not below the highest, both in m/s."""
    check_speed_bound(f"{BOX}.{name}", speed_bound)
    require(
        speed_bound < highest,
        f"{BOX}.{name}",
        speed_bound,
        f"give less than {highest:g} m/s, for the sake of max_speed",
    )
