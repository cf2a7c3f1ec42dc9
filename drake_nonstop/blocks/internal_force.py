"""Box "Internal λ(t) Trajectories" of the figure."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.internal_force import (
    internal_force,
    internal_force_acceleration,
    internal_force_jerk,
    planned_internal_force,
)
from drake_nonstop.mechanics.signals import PARAMETERS_SIZE, PHASE_SIZE, PLANNED_SIZE, Phase
from drake_nonstop.model.system import Model
from drake_nonstop.systems.traced_block import LateOutputs, TracedBlock
from drake_nonstop.validation import StrictFields


@dataclass(kw_only=True)
class InternalForceTrajectoryConfig(StrictFields):
    """No parameters: phases and orders belong to the scenario's pattern."""


class InternalForceTrajectory(TracedBlock):
    """λ_k = A cos(h_k θ + φ_k) and its rates (eq. 23, where the pattern's orders h are 1).

    .. pydrake_system::

        name: InternalForceTrajectory
        input_ports:
        - parameters
        - phase
        output_ports:
        - internal_force
        - internal_force_higher_rates

    `parameters` (2) = [ξ (rad/s), A (N)]; `phase` (2) = [θ (rad), ∂θ/∂ξ (s)];
    `internal_force` (2m) = [λ (N); λ̇ (N/s)]; `internal_force_higher_rates` (2m) =
    [λ̈ (N/s²); λ⃛ (N/s³)]. The rates are those of constant ξ and A.
    """

    is_sampled = True

    def __init__(self, model: Model, config: InternalForceTrajectoryConfig | None = None):
        phases, orders = model.pattern.phases, model.pattern.orders

        def values_and_rates(parameters: NDArray, phase: NDArray) -> NDArray:
            angle = Phase.view(phase).angle
            return np.concatenate(internal_force(parameters, angle, phases=phases, orders=orders))

        def higher_rates(parameters: NDArray, phase: NDArray) -> NDArray:
            known = values_and_rates(parameters, phase)
            functions = internal_force_acceleration, internal_force_jerk
            return np.concatenate([f(parameters, known, orders=orders) for f in functions])

        inputs = {"parameters": PARAMETERS_SIZE, "phase": PHASE_SIZE}
        super().__init__(
            values_and_rates,
            inputs=inputs,
            outputs={"internal_force": 2 * model.m},
            late=LateOutputs(
                higher_rates,
                tuple(inputs),
                {"internal_force_higher_rates": 2 * model.m},
                key=("internal force's rates", phases, orders),
            ),
            key=("internal force", phases, orders),
        )


@dataclass(kw_only=True)
class PlannedInternalForceConfig(StrictFields):
    """No parameters: phases and orders belong to the scenario's pattern."""


class PlannedInternalForce(TracedBlock):
    """λ_k = A cos(h_k θ + φ_k) of ξ and A that change, with the exact rates of a plan.

    See `mechanics.internal_force.planned_internal_force`.

    .. pydrake_system::

        name: PlannedInternalForce
        input_ports:
        - planned
        output_ports:
        - internal_force
        - internal_force_higher_rates

    `planned` (8) = [θ (rad), ξ (rad/s), A (N), ξ̇ (rad/s²), Ȧ (N/s), ξ̈ (rad/s³), Ä (N/s²),
    A⃛ (N/s³)]; `internal_force` (2m) = [λ (N); λ̇ (N/s)]; `internal_force_higher_rates` (2m) =
    [λ̈ (N/s²); λ⃛ (N/s³)].
    """

    is_sampled = True

    def __init__(self, model: Model, config: PlannedInternalForceConfig | None = None):
        phases, orders = model.pattern.phases, model.pattern.orders

        def rates(planned: NDArray) -> tuple[NDArray, NDArray]:
            all_rates = planned_internal_force(planned, phases=phases, orders=orders)
            return np.concatenate(all_rates[:2]), np.concatenate(all_rates[2:])

        super().__init__(
            rates,
            inputs={"planned": PLANNED_SIZE},
            outputs=dict.fromkeys(("internal_force", "internal_force_higher_rates"), 2 * model.m),
            key=("planned internal force", phases, orders),
        )


# The blocks that the box can be, the default first.
VARIANTS = (PlannedInternalForce, InternalForceTrajectory)
