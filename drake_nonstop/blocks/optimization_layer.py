"""Box "Optimization Layer" of the figure."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.blocks.nlp_layer import NlpLayer, NlpLayerConfig  # noqa: F401
from drake_nonstop.blocks.paper_layer import PaperLayer, PaperLayerConfig  # noqa: F401
from drake_nonstop.blocks.receding_horizon import (
    RecedingHorizonOptimizer,
    RecedingHorizonOptimizerConfig,  # noqa: F401
)
from drake_nonstop.blocks.speed_bound_layer import (
    BOX,
    COMMAND,
    CommandedBound,
    shown_bound,
)
from drake_nonstop.blocks.turn_rate_optimizer import (
    TurnRateOptimizer,
    TurnRateOptimizerConfig,  # noqa: F401
)
from drake_nonstop.model.system import Model
from drake_nonstop.planning.problem_config import SpeedBound, with_stated_bound
from drake_nonstop.validation import (
    StrictFields,
    checked,
    positive,
    require,
    require_non_negative,
    require_positive,
    require_ranges,
)


@dataclass(kw_only=True)
class ConstantParametersConfig(StrictFields):
    """The internal force's parameters, and the bound with which the metrics compare speeds."""

    frequency: float = positive(2.0)  # rad/s, ξ
    amplitude: float = 1.2  # N, A; 0 for a constant pattern, and for no other
    # m/s, ε; reported, not enforced; also "1.4 V_s"
    speed_bound: SpeedBound = checked(0.2, require_non_negative)


class ConstantParameters(CommandedBound):
    """Constant ξ and A: the loop without optimization.

    Nothing enforces the `speed_bound`, which is the `speed_bound_command`, or else a number that
    `set_speed_bound` changes during a run.

    Raises:
        ScenarioError: frequency or amplitude is not positive, an amplitude is given for a pattern
            without orbits, or the bound is negative; during a run, the command is negative.
    """

    reads = ("speed_bound_command",)
    makes = ("parameters", "speed_bound")

    is_sampled = True
    optional_inputs = (COMMAND,)

    def __init__(self, model: Model, config: ConstantParametersConfig | None = None):
        super().__init__(model, with_stated_bound(BOX, config or ConstantParametersConfig(), model))

    @classmethod
    def check(cls, model: Model, config: ConstantParametersConfig) -> None:
        """Raises ScenarioError for a config that cannot be used with the model."""
        require_ranges(BOX, config)
        if model.pattern.is_constant:
            require(
                config.amplitude == 0,
                f"{BOX}.amplitude",
                config.amplitude,
                "the pattern has no orbits that it could size; give 0, or a pattern with orbits",
            )
        else:
            require_positive(f"{BOX}.amplitude", config.amplitude)

    def check_bound(self, speed_bound: float, name: str = "speed_bound") -> None:
        """Raises ScenarioError for a negative bound (m/s)."""
        require_non_negative(f"{BOX}.{name}", speed_bound)

    @staticmethod
    def equations(
        command: NDArray, *, frequency: NDArray, amplitude: NDArray, speed_bound: NDArray
    ) -> tuple[NDArray, NDArray]:
        return np.concatenate([frequency, amplitude]), shown_bound(command, speed_bound)


# The blocks that the box can be, the default first.
VARIANTS = (
    RecedingHorizonOptimizer,
    PaperLayer,
    TurnRateOptimizer,
    NlpLayer,
    ConstantParameters,
)
