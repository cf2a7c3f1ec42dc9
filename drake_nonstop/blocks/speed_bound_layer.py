"""The base of layers of the box "Optimization Layer": ports, states, updates and the bound."""

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.common.value import Value
from pydrake.systems.framework import Context

from drake_nonstop.mechanics.rigid_load import STILL_AIR
from drake_nonstop.mechanics.signal_layouts import Layout
from drake_nonstop.mechanics.signals import SIGNALS
from drake_nonstop.model.block import Block, BlockParameters
from drake_nonstop.model.system import Model
from drake_nonstop.planning.diagnostics import (
    DIAGNOSTICS_SIZE,
    LAYER_LAYOUTS,
    Outcome,
    count_update,
    missed_layout,
    missed_limits_of,
)
from drake_nonstop.planning.problem_config import with_stated_bound
from drake_nonstop.systems.documentation import own_config_class
from drake_nonstop.systems.parameters import NumericParameters, parameters_in
from drake_nonstop.systems.requirements import LoopBlocks
from drake_nonstop.systems.tracing import where
from drake_nonstop.validation import require

BOX = "optimization_layer"
COMMAND = "speed_bound_command"  # an optional input of the box
WIND = "wind_estimate"  # an optional input of the box, of aircraft
_MISSED = "missed_limits"
NO_COMMAND = -1e5  # m/s, the value of the command where none is connected


class PeriodicLayer(Block):
    """A layer whose state is what `answer` returns, every some samples of the controllers.

    The state is one vector of the parts that `parts` names, and the counts of updates. Outputs are
    `equations` of it, of the inputs that are vectors and of the parameters; until the first answer,
    at the initialization, they show the first state. Where there is no control period answers come
    once in the layer's own period.

    Args:
        model: what the controllers believe.
        config: the layer's, None: the default values.

    Attributes:
        every: how many samples are from one answer to the next.
        counted: names of the limits that `missed_limits` counts.
        counts_bow: whether it plans for the ends of bowed cables.
    """

    makes: ClassVar[tuple[str, ...]] = (
        "parameters",
        "diagnostics",
        "solve_time",
        "speed_bound",
        _MISSED,
    )

    where: ClassVar = {WIND: "there are aircraft", _MISSED: "limits are asked for"}
    is_sampled = True
    signal_layouts = LAYER_LAYOUTS
    optional_inputs: tuple[str, ...] = (COMMAND, WIND)
    counts_bow = False

    def __init__(self, model: Model, config: Any = None):
        config = with_stated_bound(BOX, config or own_config_class(type(self))(), model)
        self.check(model, config)
        has_counts = _MISSED in self.makes
        self.counted = missed_limits_of(config, model) if has_counts else ()
        self.makes = tuple(  # type: ignore[misc]
            name for name in self.makes if name != _MISSED or self.counted
        )
        shared = {"diagnostics": np.zeros(DIAGNOSTICS_SIZE), "solve_time": np.zeros(1)}
        missed = {_MISSED: np.zeros(len(self.counted))} if self.counted else {}
        self._state_parts = NumericParameters(self.parts(model, config) | shared | missed)
        super().__init__(model, config)
        for name in self.reads:
            if SIGNALS.get(name, LAYER_LAYOUTS) is None:
                self.DeclareAbstractInputPort(name, Value(object()))

    def requires(self, loop: LoopBlocks) -> Iterator[str]:
        """Tells that carriers on bowed cables fly other orbits than it plans."""
        counts_bow = self.counts_bow and self.model.cable_shape is not None
        if not counts_bow and getattr(loop.get("cables"), "bears_drag", False):
            yield (
                f"optimization_layer = {type(self).__name__}: it plans for straight cables, and "
                "these bow: carriers fly up to some tenths of a m/s slower than it plans, and bank "
                "more; give RecedingHorizonOptimizer, or a speed_bound that is so much higher"
            )

    # Of a class below

    def parts(self, model: Model, config: Any) -> dict[str, ArrayLike]:
        """Parts of the first state, by name, besides the counts of updates."""
        raise NotImplementedError

    def step_period(self, model: Model, config: Any) -> float:
        """Time from one answer to the next, s."""
        return float(config.period)

    def block_parameters(self, model: Model, config: Any) -> BlockParameters:
        """Fields of system and config that the context holds."""
        raise NotImplementedError

    def answer(self, context: Context) -> NDArray:
        """The next state, of the block's own context."""
        raise NotImplementedError

    @staticmethod
    def equations(state: NDArray, *inputs: Any, **numbers: Any) -> tuple[NDArray, ...]:
        """Outputs of the state, of inputs and of constants and parameters by name."""
        return outputs_of(state, speed_bound=numbers["speed_bound"], **numbers["shown"])

    # Of a block

    def constants(self, model: Model, config: Any) -> dict[str, Any]:
        """Names of the outputs, and places of the state's parts by name, for `outputs_of`."""
        places = {name: self._state_parts.place(name) for name in self._state_parts.defaults}
        return {"shown": {"names": self.makes, "places": places}}

    def inputs(self, model: Model) -> tuple[str, ...]:
        """The signals that are vectors, a wind of aircraft alone."""
        is_of_aircraft = model.aircraft is not None
        names = super().inputs(model)
        read = [name for name in names if SIGNALS.get(name, LAYER_LAYOUTS) is not None]
        return tuple(name for name in read if name != WIND or is_of_aircraft)

    def layouts(self, model: Model, config: Any) -> dict[str, Layout]:
        """Layouts of `diagnostics`, and of `missed_limits` where some are counted."""
        missed = {_MISSED: missed_layout(self.counted)} if self.counted else {}
        return {"diagnostics": LAYER_LAYOUTS["diagnostics"]} | missed

    def state(self, model: Model) -> NDArray:
        """The first state."""
        return self._state_parts.vector

    # For answers

    def states(self, context: Context) -> dict[str, NDArray]:
        """Parts of the state by name, views of a copy."""
        return self._state_parts.view(context.get_discrete_state(0).CopyToVector())

    def flat(self, states: Mapping[str, Any]) -> NDArray:
        """The state of all of its parts."""
        return np.concatenate([np.ravel(states[name]) for name in self._state_parts.defaults])

    def input(self, context: Context, name: str) -> NDArray:
        """Value of an input; still air where no wind is told."""
        if name == WIND and not (self.HasInputPort(WIND) and self._has_value(context, WIND)):
            return STILL_AIR
        return self.GetInputPort(name).Eval(context)

    def _has_value(self, context: Context, name: str) -> bool:
        return bool(self.GetInputPort(name).HasValue(context))

    def counted_update(
        self,
        states: Mapping[str, NDArray],
        outcome: Outcome,
        margin: float,
        missed: Collection[str] = (),
    ) -> dict[str, NDArray]:
        """The parts of the state that count updates, after one.

        Its speed margin is in m/s; it misses the limits of these names.
        """
        after = {name: states[name].copy() for name in ("diagnostics", _MISSED) if name in states}
        count_update(after["diagnostics"], outcome, margin)
        if self.counted:
            after[_MISSED] += [name in missed for name in self.counted]
        return after

    def bound_in(self, context: Context) -> NDArray:
        """ε (1,), m/s."""
        return parameters_in(self, context)["speed_bound"]

    def asked(self, context: Context) -> NDArray:
        """The answer to an event, of floats."""
        amplitude = "amplitude 0" if self.model.pattern.is_constant else "amplitude"
        self.require_floats(
            f"give ConstantParameters, with its frequency and {amplitude}, in place of "
            f"{type(self).__name__}"
        )
        return super().asked(context)


def outputs_of(
    state: NDArray, *, names: Sequence[str], places: Mapping[str, slice], **others: NDArray
) -> tuple[NDArray, ...]:
    """Outputs of these names: parts of the state by their places, or others that are given."""
    return tuple(others[name] if name in others else state[places[name]] for name in names)


class CommandedBound(Block):
    """A block of which ε is the parameter `speed_bound`, unless there is a command."""

    unconnected: ClassVar = {COMMAND: NO_COMMAND}

    def check_bound(self, speed_bound: float, name: str = "speed_bound") -> None:
        """Raises ScenarioError for what is no bound (m/s), by the name that it has in the box."""
        raise NotImplementedError

    def set_speed_bound(self, context: Context, speed_bound: float) -> None:
        """Sets another ε (m/s) from the next update on; the context is the block's own.

        Raises:
            ScenarioError: the bound is none of the block, or `speed_bound_command` is connected.
        """
        require(
            not self.GetInputPort(COMMAND).HasValue(context),
            f"{BOX}.speed_bound",
            speed_bound,
            f"the signal {COMMAND} sets the bound: change it in the block that makes that "
            "signal, or take the signal away",
        )
        self.check_bound(speed_bound)
        values = context.get_mutable_numeric_parameter(0)
        values.SetAtIndex(self.parameters.place("speed_bound").start, speed_bound)

    def bound_in(self, context: Context) -> NDArray:
        """ε (1,), m/s: what is commanded, or else as it was set."""
        command = self.GetInputPort(COMMAND)
        if not command.HasValue(context):
            return parameters_in(self, context)["speed_bound"]
        bound = command.Eval(context)
        if self.scalar is float:
            self.check_bound(float(bound[0]), COMMAND)
        return bound


def shown_bound(
    command: NDArray, speed_bound: NDArray, least: float = 0.0, highest: float = math.inf
) -> NDArray:
    """ε (1,), m/s: the command, or without one the parameter.

    NaN where the command is neither 0 nor from the least to below the highest bound.
    """
    nothing = np.array([np.nan])
    below = where(command[0] < highest, command, nothing)
    commanded = where(command[0] >= least, below, where(command[0] == 0, command, nothing))
    return where(command[0] == NO_COMMAND, speed_bound, commanded)
