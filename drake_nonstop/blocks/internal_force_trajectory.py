"""Box "Internal λ(t) Trajectories" of the figure."""

from dataclasses import dataclass

from pydrake.systems.framework import BasicVector, Context

from drake_nonstop.compiled import CompiledFunction
from drake_nonstop.leaf_block import LeafBlock
from drake_nonstop.mechanics.internal_force import internal_force
from drake_nonstop.system import Model


@dataclass(kw_only=True)
class InternalForceTrajectoryConfig:
    """No parameters: the phases belong to the scenario's pattern."""


class InternalForceTrajectory(LeafBlock):
    """λ_k = A cos(θ + φ_k) and its rate (eq. 23).

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

    def __init__(self, model: Model, config: InternalForceTrajectoryConfig | None = None):
        super().__init__()
        phases = model.pattern.phases
        self._internal_force = CompiledFunction(
            lambda parameters, phase: internal_force(parameters, phase[:1], phases=phases),
            [2, 2],
            name=self.get_name,
        )
        self._parameters = self.DeclareVectorInputPort("parameters", 2)
        self._phase = self.DeclareVectorInputPort("phase", 2)
        self._m = model.m
        self.DeclareVectorOutputPort(
            "internal_force", 2 * model.m, self._calc, {self.all_input_ports_ticket()}
        )

    def _calc(self, context: Context, output: BasicVector) -> None:
        force, rate = self._internal_force(
            self._parameters.Eval(context), self._phase.Eval(context)
        )
        value = output.get_mutable_value()
        value[: self._m], value[self._m :] = force, rate
