"""Box "Cable Force Distribution" of the figure."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.grasp import cable_forces_and_rates
from drake_nonstop.model.block import Block, BlockParameters
from drake_nonstop.model.system import Model
from drake_nonstop.validation import StrictFields


@dataclass(kw_only=True)
class CableForceDistributionConfig(StrictFields):
    """No parameters: the pattern is the scenario's."""


class CableForceDistribution(Block):
    """f_d = G† w_d + f̃⁰ + N λ and its exact rate (eqs. 16, 19-21)."""

    reads = ("measured_load_state", "wrench", "wrench_rate", "internal_force")
    makes = ("desired_cable_forces", "desired_cable_force_rates")
    of_model = ("pseudo_inverse", "pattern.basis")
    is_sampled = True

    @staticmethod
    def equations(
        *inputs: NDArray,
        pseudo_inverse: NDArray,
        basis: NDArray,
        pattern_offset: NDArray | None = None,
    ) -> tuple[NDArray, NDArray]:
        offset = np.zeros(len(basis)) if pattern_offset is None else pattern_offset
        return cable_forces_and_rates(
            *inputs, pseudo_inverse=pseudo_inverse, basis=basis, offset=offset
        )

    def block_parameters(self, model: Model, config: Any) -> BlockParameters:
        return BlockParameters(model, model.offset_parameter)


VARIANTS = (CableForceDistribution,)
