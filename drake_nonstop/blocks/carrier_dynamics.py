"""The dynamics half of box "Carrier Controller + Dynamics"."""

import math
from dataclasses import dataclass

from pydrake.systems.framework import Context
from pydrake.systems.primitives import Integrator, Selector

from drake_nonstop.mechanics.carrier import (
    carriers_kinetic_energy,
    carriers_potential_energy,
    double_integrator_rate,
    loaded_carrier_rate,
)
from drake_nonstop.model.system import Model
from drake_nonstop.systems.block import BlockType
from drake_nonstop.systems.linear_block import LinearBlock
from drake_nonstop.systems.traced_block import TracedBlock, stacking
from drake_nonstop.validation import StrictFields, is_number, require


@dataclass(kw_only=True)
class CarrierDynamicsConfig(StrictFields):
    """No parameters: the carrier mass is the system's."""


class CarrierDynamics(LinearBlock):
    """Double integrators: m_c p̈ = u, without weight or cable reaction, as in the paper.

    .. pydrake_system::

        name: CarrierDynamics
        input_ports:
        - carrier_forces
        output_ports:
        - carrier_state

    `carrier_forces` (3n) in N, in W; `carrier_state` (6n) = [positions (m), velocities (m/s)], in
    W, is the state.
    """

    def __init__(self, model: Model, config: CarrierDynamicsConfig | None = None):
        super().__init__(
            lambda state, forces: double_integrator_rate(state, forces, mass=model.carrier_mass),
            inputs={"carrier_forces": 3 * model.n},
            state_size=6 * model.n,
            state_port="carrier_state",
        )
        self._mass = model.carrier_mass

    def CalcKineticEnergy(self, context: Context) -> float:
        """½ m_c Σ ‖v_i‖², J; the context is the block's own. Without weight none is potential."""
        state = self.GetOutputPort("carrier_state").Eval(context)
        return float(carriers_kinetic_energy(state, mass=self._mass)[0])


@dataclass(kw_only=True)
class LoadedCarrierDynamicsConfig(StrictFields):
    """The limit of a carrier; its mass is the system's."""

    max_force: float = math.inf  # N, of a carrier


class LoadedCarrierDynamics(TracedBlock):
    """Carriers with weight and cable reaction: m_c p̈ = sat(u) − m_c g e₃ − f.

    They sag under a controller that compensates for neither; see `LoadedCarrierPid`.

    .. pydrake_system::

        name: LoadedCarrierDynamics
        input_ports:
        - carrier_forces
        - cable_forces
        output_ports:
        - carrier_state

    `carrier_forces` (3n), each limited to `max_force`, and `cable_forces` (3n) on the load
    in N, in W; `carrier_state` (6n) = [positions (m), velocities (m/s)], in W, is the state.

    Parameters, the fields of `LoadedCarrierDynamicsConfig`:
        max_force: N, of a carrier

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
        self._mass, self._gravity = model.carrier_mass, model.gravity

    def CalcKineticEnergy(self, context: Context) -> float:
        """½ m_c Σ ‖v_i‖², J; the context is the block's own."""
        state = self.GetOutputPort("carrier_state").Eval(context)
        return float(carriers_kinetic_energy(state, mass=self._mass)[0])

    def CalcPotentialEnergy(self, context: Context) -> float:
        """Those of the weights, m_c g Σ z_i, J; the context is the block's own."""
        state = self.GetOutputPort("carrier_state").Eval(context)
        energy = carriers_potential_energy(state, mass=self._mass, gravity=self._gravity)
        return float(energy[0])


@dataclass(kw_only=True)
class IdealCarriersConfig(StrictFields):
    """No parameters."""


class IdealCarriers(Selector, metaclass=BlockType):
    """Ideal tracking: the carriers' state is their reference, whatever the controller does.

    The load's error that remains with them is not due to the carriers. Behind sampled
    controllers the references, and so the carriers, jump a little at every sample.

    .. pydrake_system::

        name: IdealCarriers
        input_ports:
        - carrier_reference
        output_ports:
        - carrier_state

    Both (6n) = [positions (m), velocities (m/s)], in W.
    """

    def __init__(self, model: Model, config: IdealCarriersConfig | None = None):
        """Makes the block; it takes a `model` and a `config` (None: the default values)."""
        super().__init__(stacking({"carrier_reference": 6 * model.n}, "carrier_state"))
        self._mass = model.carrier_mass

    def CalcKineticEnergy(self, context: Context) -> float:
        """½ m_c Σ ‖v_i‖², J; the context is the block's own. Without weight none is potential."""
        state = self.GetOutputPort("carrier_state").Eval(context)
        return float(carriers_kinetic_energy(state, mass=self._mass)[0])


# The blocks that the box can be, the default first.
VARIANTS = (CarrierDynamics, LoadedCarrierDynamics, IdealCarriers)
