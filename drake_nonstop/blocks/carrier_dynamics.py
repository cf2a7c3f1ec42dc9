"""The dynamics half of box "Carrier Controller + Dynamics"."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context, System

from drake_nonstop.blocks.jsbsim_carriers import JsbsimCarriers, JsbsimCarriersConfig
from drake_nonstop.mechanics.aircraft import (
    Aircraft,
    FlightStates,
    flight_acceleration,
    flight_rate,
    flown_aircraft,
    is_stalled,
    shown_state,
    trimmed_states,
)
from drake_nonstop.mechanics.carrier import (
    carriers_kinetic_energy,
    carriers_potential_energy,
    double_integrator_rate,
    loaded_carrier_rate,
)
from drake_nonstop.model.block import (
    AIRCRAFT_NUMBERS,
    Block,
    BlockParameters,
    aircraft_of,
    required_aircraft,
)
from drake_nonstop.model.descriptions import CarrierMotion
from drake_nonstop.model.system import Model
from drake_nonstop.systems.parameters import parameters_in
from drake_nonstop.systems.requirements import LoopBlocks
from drake_nonstop.validation import StrictFields, is_number, require


def _requires_points(self: System, loop: LoopBlocks) -> Iterator[str]:
    """Tells of aircraft that cannot stall, since they move as points."""
    if loop.simulated.aircraft is not None:
        yield (
            f"carrier_dynamics = {type(self).__name__}: its carriers are points of the "
            "aircraft's mass, which cannot stall; give carrier_dynamics=FixedWingDynamics and "
            "carrier_controller=FixedWingController"
        )


@dataclass(kw_only=True)
class CarrierDynamicsConfig(StrictFields):
    """No parameters: the carrier mass is the system's."""


class CarrierDynamics(Block):
    """Double integrators: m_c p̈ = u, without weight or cable reaction, as in the paper.

    `carrier_state` is the state.
    """

    reads = ("carrier_forces",)
    makes = ("carrier_state",)
    state_ports = ("carrier_state",)
    system = ("carrier_mass",)
    requires = _requires_points

    @staticmethod
    def equations(state: NDArray, forces: NDArray, *, carrier_mass: NDArray) -> NDArray:
        return double_integrator_rate(state, forces, mass=carrier_mass)

    def state(self, model: Model) -> NDArray:
        return model.initial_carrier_state

    def describe_response(self) -> CarrierMotion:
        return CarrierMotion()

    def CalcKineticEnergy(self, context: Context) -> float:
        """½ m_c Σ ‖v_i‖², J; the context is the block's own."""
        state = self.GetOutputPort("carrier_state").Eval(context)
        mass = parameters_in(self, context)["carrier_mass"]
        return float(carriers_kinetic_energy(state, mass=mass)[0])


@dataclass(kw_only=True)
class LoadedCarrierDynamicsConfig(StrictFields):
    """The limit of a carrier; its mass is the system's."""

    max_force: float = math.inf  # N, of a carrier


class LoadedCarrierDynamics(Block):
    """Carriers with weight and cable reaction: m_c p̈ = sat(u) − m_c g e₃ − f.

    They sag under a controller that compensates for neither; see `LoadedCarrierPid`.

    Each of the `carrier_forces` is limited to `max_force`; `carrier_state` is the state.

    Raises:
        ScenarioError: `max_force` is not positive.
    """

    reads = ("carrier_forces", "carrier_cable_forces")
    makes = ("carrier_state",)
    state_ports = ("carrier_state",)
    system = ("carrier_mass", "gravity")
    requires = _requires_points

    @staticmethod
    def equations(
        *values: NDArray, carrier_mass: NDArray, gravity: NDArray, max_force: Any = None
    ) -> NDArray:
        return loaded_carrier_rate(*values, mass=carrier_mass, gravity=gravity, max_force=max_force)

    @classmethod
    def check(cls, model: Model, config: LoadedCarrierDynamicsConfig) -> None:
        limit = config.max_force
        require(
            (is_number(limit) and limit > 0) or limit == math.inf,
            "carrier_dynamics.max_force",
            limit,
            "give a number greater than zero, or .inf for no limit",
        )

    def block_parameters(
        self, model: Model, config: LoadedCarrierDynamicsConfig
    ) -> BlockParameters:
        own = ("max_force",) if config.max_force < math.inf else ()
        return BlockParameters(model, self.system, config=config, own=own)

    state = CarrierDynamics.state
    CalcKineticEnergy = CarrierDynamics.CalcKineticEnergy

    def describe_response(self) -> CarrierMotion:
        return CarrierMotion(bears_cables=True)

    def CalcPotentialEnergy(self, context: Context) -> float:
        """Potential energy of the weights, m_c g Σ z_i, J; the context is the block's own."""
        state = self.GetOutputPort("carrier_state").Eval(context)
        own = parameters_in(self, context)
        mass, gravity = own["carrier_mass"], own["gravity"]
        return float(carriers_potential_energy(state, mass=mass, gravity=gravity)[0])


@dataclass(kw_only=True)
class IdealCarriersConfig(StrictFields):
    """No parameters."""


class IdealCarriers(Block):
    """Ideal tracking: the carriers' state is their reference, whatever the controller does.

    The load's error that remains with them is not due to the carriers. Behind sampled
    controllers the references, and so the carriers, jump a little at every sample.
    """

    reads = ("carrier_reference",)
    makes = ("carrier_state",)

    requires = _requires_points

    @staticmethod
    def equations(reference: NDArray) -> NDArray:
        return reference

    def CalcKineticEnergy(self, context: Context) -> float:
        """½ m_c Σ ‖v_i‖², J; the context is the block's own. Without weight none is potential."""
        state = self.GetOutputPort("carrier_state").Eval(context)
        return float(carriers_kinetic_energy(state, mass=self.model.carrier_mass)[0])


@dataclass(kw_only=True)
class FixedWingDynamicsConfig(StrictFields):
    """Effect of a stall on a run; the aircraft are the system's."""

    stops_at_stall: bool = (
        True  # the run ends at the first stall; false: with stalled lift it goes on
    )


class FixedWingDynamics(Block):
    """Fixed-wing aircraft: 3-DoF point masses with lift, bank and thrust that lag their commands.

    With the airspeed V, forward x, the lift's direction l at the bank μ, and q = ½ ρ V²,

        m v̇ = q S C_L l + T (cos α x + sin α l) − q S C_D x − m g e₃ − f,

    see `drake_nonstop.mechanics.aircraft` for the polar, the lags, the limits of roll rate and
    thrust, and the gusts' angle of attack. A wing whose C_L reaches C_Lmax, or an airspeed below
    the stall speed, is a stall: the lift stays at that of C_Lmax.

    Raises:
        ScenarioError: the system has no aircraft.
    """

    reads = ("aircraft_command", "carrier_cable_forces", "wind")
    makes = ("carrier_state", "aircraft_state", "carrier_acceleration")
    system = AIRCRAFT_NUMBERS
    of_model = ("bears_cable_drag",)
    ending_signal = "aircraft_state"

    @staticmethod
    def equations(
        states: NDArray,
        command: NDArray,
        pull: NDArray,
        wind: NDArray,
        *,
        bears_cable_drag: bool,
        **numbers: Any,
    ) -> tuple[NDArray, ...]:
        flying = flown_aircraft(aircraft_of(numbers), bears_cable_drag)
        return (
            flight_rate(flying, states, command, pull, wind),
            states[: 2 * len(pull)],
            shown_state(flying, states, wind),
            flight_acceleration(flying, states, pull, wind),
        )

    @classmethod
    def check(cls, model: Model, config: Any) -> None:
        required_aircraft(model, "carrier_dynamics", "FixedWingDynamics")

    def state(self, model: Model) -> NDArray:
        others = (np.zeros(k * model.n) for k in (1, 1, 1, 3))
        return np.concatenate(FlightStates(model.initial_carrier_state, *others))

    def trim(self, context: Context, carrier_reference_acceleration: NDArray) -> None:
        """Sets C_L, bank and thrust, within their limits, for these accelerations (3n,), m/s²."""
        pull, wind = (self.GetInputPort(name).Eval(context) for name in self.reads[1:])
        state = self.GetOutputPort("carrier_state").Eval(context)
        aircraft = self._aircraft_in(context)
        states = trimmed_states(aircraft, state, carrier_reference_acceleration, pull, wind)
        context.SetContinuousState(states)

    def ends_run(self, context: Context, shown: NDArray) -> bool:
        """Whether an aircraft is stalled by the `aircraft_state`, and a run ends there."""
        aircraft = self._aircraft_in(context)
        return self.config.stops_at_stall and bool(np.any(is_stalled(aircraft, shown)))

    def _aircraft_in(self, context: Context) -> Aircraft:
        own = aircraft_of(parameters_in(self, context))
        return flown_aircraft(own, self.model.bears_cable_drag)

    def CalcKineticEnergy(self, context: Context) -> float:
        """½ m Σ ‖v_i‖², J; the context is the block's own."""
        state = self.GetOutputPort("carrier_state").Eval(context)
        mass = self._aircraft_in(context).mass
        return float(carriers_kinetic_energy(state, mass=mass)[0])

    def CalcPotentialEnergy(self, context: Context) -> float:
        """Potential energy of the weights, m g Σ z_i, J; the context is the block's own."""
        state = self.GetOutputPort("carrier_state").Eval(context)
        flying = self._aircraft_in(context)
        energy = carriers_potential_energy(state, mass=flying.mass, gravity=flying.gravity)
        return float(energy[0])


VARIANTS = (
    CarrierDynamics,
    LoadedCarrierDynamics,
    FixedWingDynamics,
    JsbsimCarriers,
    IdealCarriers,
)

__all__ = ["CarrierDynamics", "CarrierDynamicsConfig"]
__all__ += ["LoadedCarrierDynamics", "LoadedCarrierDynamicsConfig"]
__all__ += ["FixedWingDynamics", "FixedWingDynamicsConfig"]
__all__ += ["JsbsimCarriers", "JsbsimCarriersConfig", "IdealCarriers", "IdealCarriersConfig"]
