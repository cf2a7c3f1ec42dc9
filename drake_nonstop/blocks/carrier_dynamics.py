"""The dynamics half of box "Carrier Controller + Dynamics"."""

from dataclasses import dataclass

from pydrake.systems.framework import Context, ContinuousState

from drake_nonstop.compiled import CompiledFunction
from drake_nonstop.leaf_block import LeafBlock
from drake_nonstop.mechanics.carrier import double_integrator_rate
from drake_nonstop.system import Model


@dataclass(kw_only=True)
class CarrierDynamicsConfig:
    """No parameters: the carrier mass is the system's."""


class CarrierDynamics(LeafBlock):
    """Double integrators: m_c p̈ = u, without weight or cable reaction, as in the paper.

    .. pydrake_system::

        name: CarrierDynamics
        input_ports:
        - carrier_forces
        output_ports:
        - carrier_state

    `carrier_forces` (3n) in N, in W; `carrier_state` (6n) = [positions, velocities], in
    W, is the state.
    """

    def __init__(self, model: Model, config: CarrierDynamicsConfig | None = None):
        super().__init__()
        n = model.n
        self._rate = CompiledFunction(
            lambda state, forces: double_integrator_rate(state, forces, mass=model.carrier_mass),
            [6 * n, 3 * n],
            name=self.get_name,
        )
        self._carrier_forces = self.DeclareVectorInputPort("carrier_forces", 3 * n)
        # q and v apart: Drake's semi-explicit integrators need to know.
        index = self.DeclareContinuousState(3 * n, 3 * n, 0)
        self._carrier_state = self.DeclareStateOutputPort("carrier_state", index)

    def DoCalcTimeDerivatives(self, context: Context, derivatives: ContinuousState) -> None:
        (rate,) = self._rate(
            self._carrier_state.Eval(context),
            self._carrier_forces.Eval(context),
        )
        derivatives.get_mutable_vector().SetFromVector(rate)
