"""Box "Internal λ(t) Trajectories" of the figure."""

from dataclasses import dataclass

import numpy as np

from drake_nonstop.mechanics.internal_force import internal_force
from drake_nonstop.mechanics.signals import PARAMETERS_SIZE, PHASE_SIZE, Phase
from drake_nonstop.model.system import Model
from drake_nonstop.systems.traced_block import TracedBlock
from drake_nonstop.validation import StrictFields


@dataclass(kw_only=True)
class InternalForceTrajectoryConfig(StrictFields):
    """No parameters: phases and orders belong to the scenario's pattern."""


class InternalForceTrajectory(TracedBlock):
    """λ_k = A cos(h_k θ + φ_k) and its rate (eq. 23, where the pattern's orders h are 1).

    .. pydrake_system::

        name: InternalForceTrajectory
        input_ports:
        - parameters
        - phase
        output_ports:
        - internal_force

    `parameters` (2) = [ξ (rad/s), A (N)]; `phase` (2) = [θ (rad), ∂θ/∂ξ (s)];
    `internal_force` (2m) = [λ (N); λ̇ (N/s)]. The rate is that of constant ξ and A.
    """

    is_sampled = True

    def __init__(self, model: Model, config: InternalForceTrajectoryConfig | None = None):
        phases, orders = model.pattern.phases, model.pattern.orders
        super().__init__(
            lambda parameters, phase: np.concatenate(
                internal_force(parameters, Phase.view(phase).angle, phases=phases, orders=orders)
            ),
            inputs={"parameters": PARAMETERS_SIZE, "phase": PHASE_SIZE},
            outputs={"internal_force": 2 * model.m},
        )


# The blocks that the box can be, the default first.
VARIANTS = (InternalForceTrajectory,)
