"""The dynamics half of box "Carrier Controller + Dynamics", with weight and cable."""

import math
from dataclasses import dataclass

from pydrake.systems.primitives import Integrator

from drake_nonstop.mechanics.carrier import loaded_carrier_rate
from drake_nonstop.system import Model
from drake_nonstop.traced_block import TracedBlock
from drake_nonstop.validation import is_number, require


@dataclass(kw_only=True)
class LoadedCarrierDynamicsConfig:
    """What a carrier can do; its mass is the system's."""

    max_force: float = math.inf  # N, of a carrier


class LoadedCarrierDynamics(TracedBlock):
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
        config = config or LoadedCarrierDynamicsConfig()
        limit = config.max_force
        require(
            (is_number(limit) and limit > 0) or limit == math.inf,
            "carrier_dynamics.max_force",
            limit,
            "give a number greater than zero, or .inf for no limit",
        )
        n = model.n
        super().__init__(
            lambda state, forces, cables: loaded_carrier_rate(
                state,
                forces,
                cables,
                mass=model.carrier_mass,
                gravity=model.gravity,
                max_force=limit,
            ),
            inputs={"carrier_forces": 3 * n, "cable_forces": 3 * n},
            state=Integrator(6 * n),
            state_port="carrier_state",
        )
