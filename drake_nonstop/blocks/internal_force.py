"""Box "Internal λ(t) Trajectories" of the figure."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.internal_force import harmonics
from drake_nonstop.mechanics.signals import PlannedParameters
from drake_nonstop.model.block import Block
from drake_nonstop.validation import StrictFields


@dataclass(kw_only=True)
class PlannedInternalForceConfig(StrictFields):
    """No parameters: the phases belong to the scenario's pattern."""


class PlannedInternalForce(Block):
    """λ_k = A cos(θ + φ_k) with its exact rates (eq. 23), for ξ and A that may change.

    With rates of zero in `planned`, ξ and A are constant. See `mechanics.internal_force.harmonics`.
    """

    reads = ("planned",)
    makes = ("internal_force", "internal_force_higher_rates")
    of_model = ("pattern.phases",)
    is_sampled = True

    @staticmethod
    def equations(planned: NDArray, *, phases: NDArray) -> tuple[NDArray, NDArray]:
        plan = PlannedParameters.view(planned)
        rates = harmonics(*plan.series, phases=phases).rates
        return np.concatenate(rates[:2]), np.concatenate(rates[2:])


VARIANTS = (PlannedInternalForce,)
