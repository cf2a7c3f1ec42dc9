"""What the layers that keep a speed bound share: parameters in the context, and ε as an input."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple, TypeVar

import casadi
import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import AbstractValue, Value
from pydrake.systems.framework import (
    BasicVector,
    BasicVector_,
    Context,
    InputPort,
    ValueProducer,
)

from drake_nonstop.mechanics.cable import compliance_of
from drake_nonstop.model.block_parameters import AIRCRAFT_NUMBERS, LOAD, BlockParameters, Rules
from drake_nonstop.model.system import OFFSET, Model
from drake_nonstop.optimization.problem_config import (
    LEAST_BOUND,
    LimitsConfig,
    check_speed_bound,
    highest_speed_bound,
    range_for,
)
from drake_nonstop.optimization.update_data import Beliefs
from drake_nonstop.systems.block import LeafBlock, weakly
from drake_nonstop.systems.diagram_trace import At
from drake_nonstop.systems.parameters import declare_parameters
from drake_nonstop.systems.tracing import chosen
from drake_nonstop.validation import require

BOX = "optimization_layer"
COMMAND = "speed_bound_command"  # an optional input of the box
_OWN = ("speed_bound", "frequency", "amplitude", "frequency_bounds", "amplitude_bounds")

_Config = TypeVar("_Config", bound=LimitsConfig)


def _layer_parameters(
    model: Model,
    config: _Config,
    check: Callable[[str, _Config, Model], None],
    structure: Callable[[Model, _Config], Any],
) -> BlockParameters:
    """Those of a layer; amplitude bounds of zero stand for those from the weight.

    Args:
        model: what the controllers believe.
        config: the layer's.
        check: raises ScenarioError for a config of the named box that cannot be used.
        structure: what of model and config decides how the layer is built, see `Rules`.
    """

    def check_all(model: Model, config: _Config) -> None:
        if not any(config.amplitude_bounds):
            config = replace(config, amplitude_bounds=[])
        check(BOX, config, model)
        check_bound(highest_speed_bound(config), config.speed_bound)

    return BlockParameters(
        model,
        (*LOAD, "cable_length", "cable_stiffness", *model.offset_parameter),
        config=replace(config, amplitude_bounds=config.amplitude_bounds or [0.0, 0.0]),
        own=_OWN,
        rules=Rules(
            check=check_all,
            structure=structure,
            fixed=AIRCRAFT_NUMBERS if model.aircraft is not None else (),
        ),
    )


class LayerNumbers(NamedTuple):
    """What a layer takes of its parameters."""

    speed_bound: float  # m/s
    nominal: NDArray  # (2,), [ξ, A] at the start, rad/s and N
    beliefs: NDArray  # a flat `Beliefs`


def _layer_numbers(values: dict[str, NDArray], n: int) -> LayerNumbers:
    """Of the parameters by name, for n carriers."""
    amplitudes = values["amplitude_bounds"]
    if not amplitudes.any():
        share = float(values["load_mass"][0] * values["gravity"][0]) / n
        amplitudes = np.array(range_for(share, float(values["amplitude"][0])))
    frequencies = values["frequency_bounds"]
    beliefs = Beliefs(
        load_mass=values["load_mass"],
        load_inertia=values["load_inertia"].ravel(),
        load_drag=values["load_drag"],
        load_angular_drag=values["load_angular_drag"],
        gravity=values["gravity"],
        rest_length=values["cable_length"],
        compliance=compliance_of(values["cable_stiffness"]),
        nominal=np.concatenate([values["frequency"], values["amplitude"]]),
        lower=np.array([frequencies[0], amplitudes[0]]),
        upper=np.array([frequencies[1], amplitudes[1]]),
        offset=values.get(OFFSET, np.zeros(0)),
    )
    return LayerNumbers(float(values["speed_bound"][0]), beliefs.nominal, np.concatenate(beliefs))


class SpeedBoundLayer(LeafBlock):
    """A layer that keeps a speed bound, which may change during a run.

    Args:
        model: what the controllers believe.
        config: the layer's.
        check: raises ScenarioError for a config of the named box that cannot be used.
        structure: what of model and config decides how the layer is built, see `Rules`.

    Attributes:
        highest_speed_bound: m/s, below which a bound has to be.
    """

    is_sampled = True
    optional_inputs: tuple[str, ...] = (COMMAND,)

    def __init__(
        self,
        model: Model,
        config: _Config,
        check: Callable[[str, _Config, Model], None],
        structure: Callable[[Model, _Config], Any] = lambda *_: None,
    ):
        super().__init__()
        check(BOX, config, model)
        self.parameters = _layer_parameters(model, config, check, structure)
        declare_parameters(self, self.parameters)
        entry = self.DeclareCacheEntry(
            "numbers",
            ValueProducer(Value(()).Clone, weakly(self._calc_numbers)),
            {self.all_parameters_ticket()},
        )
        self._numbers = entry.cache_index()  # the entry would keep this block alive
        self._enabled = self.DeclareNumericParameter(BasicVector_[self.scalar]([1.0]))
        self.highest_speed_bound = highest_speed_bound(config)
        self._n = model.n

    def declare_command(self) -> None:
        """Declares the input `speed_bound_command`."""
        self._command = self.DeclareVectorInputPort(COMMAND, 1)

    def declare_bound(self) -> None:
        """Declares the output `speed_bound`, after the input."""
        self.DeclareVectorOutputPort(
            "speed_bound",
            1,
            self._calc_speed_bound,
            {self.all_parameters_ticket(), self.input_port_ticket(self._command.get_index())},
        )

    def set_speed_bound(self, context: Context, speed_bound: float) -> None:
        """Sets another ε (m/s) from the next update on; the context is the block's own.

        Raises:
            ScenarioError: the bound is neither 0 nor at least 1e-3 m/s, or not below
                `highest_speed_bound`; or `speed_bound_command` is connected.
        """
        self.require_effect(context, "speed_bound", speed_bound)
        check_bound(self.highest_speed_bound, speed_bound)
        values = context.get_mutable_numeric_parameter(0)
        values.SetAtIndex(self.parameters.place("speed_bound").start, speed_bound)
        self.begin_anew(context)

    def require_effect(self, context: Context, name: str, value: Any) -> None:
        """Raises ScenarioError where a parameter that is set would have none in this context."""
        if name == "speed_bound":
            require_no_command(self._command, context, value)

    def begin_anew(self, context: Context) -> None:
        """Lets what has not been updated begin with the parameters of the context, its own."""

    def set_enabled(self, context: Context, enabled: bool) -> None:
        """Switches the layer on or off from the next update on; the context is the block's own."""
        context.get_mutable_numeric_parameter(self._enabled).SetFromVector([float(enabled)])

    def is_enabled(self, context: Context) -> bool:
        """Whether the layer is switched on."""
        return bool(context.get_numeric_parameter(self._enabled).CopyToVector()[0])

    def traced_bound(self, at: At, bound: NDArray, highest: NDArray) -> NDArray:
        """ε (1,), m/s: `bound`, or what is commanded; no number where that is out of range.

        Args:
            at: the instant.
            bound: (1,), m/s, that was set.
            highest: (1,), m/s, `highest_speed_bound`, which is no part of a trace.
        """
        if not at.has_input(COMMAND):
            return bound
        command = at.input(COMMAND)
        is_bound = casadi.logic_and(command[0] >= LEAST_BOUND, command[0] < highest[0])
        is_bound = casadi.logic_or(command[0] == 0, is_bound)
        return chosen(is_bound, command, np.array([np.nan]))

    def _calc_speed_bound(self, context: Context, output: BasicVector) -> None:
        if self._command.HasValue(context):
            output.SetFromVector(self._commanded_bound(context))
            return
        values = self.parameters.view(context.get_numeric_parameter(0).CopyToVector())
        output.SetFromVector(values["speed_bound"])

    def _commanded_bound(self, context: Context) -> NDArray:
        bound = self._command.Eval(context)
        if self.scalar is float:
            check_bound(self.highest_speed_bound, float(bound[0]), COMMAND)
        return bound

    def _wanted_bound(self, context: Context, numbers: LayerNumbers) -> float:
        """The ε (m/s) that is commanded, or else the one that was set."""
        if self._command.HasValue(context):
            return float(self._commanded_bound(context)[0])
        return numbers.speed_bound

    def _numbers_in(self, context: Context) -> LayerNumbers:
        return self.get_cache_entry(self._numbers).Eval(context)

    def _calc_numbers(self, context: Context, value: AbstractValue) -> None:
        vector = context.get_numeric_parameter(0).CopyToVector()
        value.set_value(_layer_numbers(self.parameters.view(vector), self._n))


def check_bound(highest: float, speed_bound: float, name: str = "speed_bound") -> None:
    """Raises ScenarioError for what is no speed bound, or is not below the highest, both in m/s."""
    check_speed_bound(BOX, speed_bound, name)
    require(
        speed_bound < highest,
        f"{BOX}.{name}",
        speed_bound,
        f"give less than {highest:g} m/s, for the sake of max_speed",
    )


def require_no_command(command: InputPort, context: Context, speed_bound: Any) -> None:
    """Raises ScenarioError where a bound that is set would be overruled."""
    require(
        not command.HasValue(context),
        f"{BOX}.speed_bound",
        speed_bound,
        f"the signal {COMMAND} sets the bound: change it in the block that makes that signal, or "
        "take the signal away",
    )
