"""The dynamics half of box "Carrier Controller + Dynamics", with weight and cable."""

import math
from dataclasses import dataclass

from pydrake.systems.framework import Context, ContinuousState

from drake_nonstop.compiled import CompiledFunction
from drake_nonstop.leaf_block import LeafBlock
from drake_nonstop.mechanics.carrier import loaded_carrier_rate
from drake_nonstop.system import Model
from drake_nonstop.validation import is_number, require


@dataclass(kw_only=True)
class LoadedCarrierDynamicsConfig:
    """What a carrier can do; its mass is the system's."""

    max_force: float = math.inf  # N, of a carrier


class LoadedCarrierDynamics(LeafBlock):
    """Carriers that feel their weight and their cable: m_c p̈ = sat(u) − m_c g e₃ − f.

    A controller that knows of neither lets them sag; see `LoadedCarrierPid`.

    .. pydrake_system::

        name: LoadedCarrierDynamics
        input_ports:
        - carrier_forces
        - cable_forces
        output_ports:
        - carrier_state

    `carrier_forces` (3n), each cut down to `max_force`, and `cable_forces` (3n) on the load
    in N, in W; `carrier_state` (6n) = [positions, velocities], in W, is the state.

    Raises:
        ScenarioError: `max_force` is not positive.
    """

    def __init__(self, model: Model, config: LoadedCarrierDynamicsConfig | None = None):
        super().__init__()
        config = config or LoadedCarrierDynamicsConfig()
        limit = config.max_force
        require(
            (is_number(limit) and limit > 0) or limit == math.inf,
            "carrier_dynamics.max_force",
            limit,
            "give a number greater than zero, or .inf for no limit",
        )
        n = model.n
        self._rate = CompiledFunction(
            lambda state, forces, cables: loaded_carrier_rate(
                state,
                forces,
                cables,
                mass=model.carrier_mass,
                gravity=model.gravity,
                max_force=limit,
            ),
            [6 * n, 3 * n, 3 * n],
            name=self.get_name,
        )
        self._carrier_forces = self.DeclareVectorInputPort("carrier_forces", 3 * n)
        self._cable_forces = self.DeclareVectorInputPort("cable_forces", 3 * n)
        # q and v apart: Drake's semi-explicit integrators need to know.
        index = self.DeclareContinuousState(3 * n, 3 * n, 0)
        self._carrier_state = self.DeclareStateOutputPort("carrier_state", index)

    def DoCalcTimeDerivatives(self, context: Context, derivatives: ContinuousState) -> None:
        (rate,) = self._rate(
            self._carrier_state.Eval(context),
            self._carrier_forces.Eval(context),
            self._cable_forces.Eval(context),
        )
        derivatives.get_mutable_vector().SetFromVector(rate)
