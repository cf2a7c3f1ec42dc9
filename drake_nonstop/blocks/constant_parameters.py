"""Box "Optimization Layer", switched off."""

from dataclasses import dataclass

import numpy as np
from pydrake.systems.framework import BasicVector, Context, NumericParameterIndex

from drake_nonstop.block import LeafBlock
from drake_nonstop.system import Model
from drake_nonstop.validation import require_non_negative, require_positive


@dataclass(kw_only=True)
class ConstantParametersConfig:
    """The internal force's parameters, and the bound that the metrics compare with."""

    frequency: float = 2.0  # rad/s, ξ
    amplitude: float = 1.2  # N, A
    speed_bound: float = 0.2  # m/s, ε; reported, not enforced


class ConstantParameters(LeafBlock):
    """Constant ξ and A: the loop without optimization.

    .. pydrake_system::

        name: ConstantParameters
        output_ports:
        - parameters
        - speed_bound

    `parameters` (2) = [ξ (rad/s), A (N)]; `speed_bound` (1) is ε in m/s, which nothing enforces
    and `set_speed_bound` changes during a run.

    Raises:
        ScenarioError: frequency or amplitude is not positive, or the bound negative.
    """

    def __init__(self, model: Model, config: ConstantParametersConfig | None = None):
        super().__init__()
        config = config or ConstantParametersConfig()
        require_positive(
            "optimization_layer", frequency=config.frequency, amplitude=config.amplitude
        )
        require_non_negative("optimization_layer", speed_bound=config.speed_bound)
        self._parameters = np.array([config.frequency, config.amplitude])
        self.DeclareVectorOutputPort(
            "parameters", 2, self._calc_parameters, {self.nothing_ticket()}
        )
        self._speed_bound = self.DeclareNumericParameter(BasicVector([config.speed_bound]))
        self.DeclareVectorOutputPort(
            "speed_bound",
            1,
            self._calc_speed_bound,
            {self.numeric_parameter_ticket(NumericParameterIndex(self._speed_bound))},
        )

    def set_speed_bound(self, context: Context, speed_bound: float) -> None:
        """Compares with another ε (m/s) from now on; the context is the block's own."""
        require_non_negative("optimization_layer", speed_bound=speed_bound)
        context.get_mutable_numeric_parameter(self._speed_bound).SetFromVector([speed_bound])

    def _calc_parameters(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._parameters)

    def _calc_speed_bound(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(context.get_numeric_parameter(self._speed_bound).value())
