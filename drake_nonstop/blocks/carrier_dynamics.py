"""The dynamics half of box "Carrier Controller + Dynamics"."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context, System
from pydrake.systems.primitives import Selector

from drake_nonstop.blocks.jsbsim_carriers import JsbsimCarriers
from drake_nonstop.mechanics.aircraft import (
    Aircraft,
    FlightStates,
    flight_acceleration,
    flight_rate,
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
from drake_nonstop.model.block_parameters import (
    AIRCRAFT_NUMBERS,
    BlockParameters,
    Rules,
    aircraft_of,
    required_aircraft,
)
from drake_nonstop.model.system import Model
from drake_nonstop.systems.block import BlockType
from drake_nonstop.systems.parameters import parameters_in
from drake_nonstop.systems.requirements import LoopBlocks
from drake_nonstop.systems.traced_block import TracedDynamics, stacking
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


class CarrierDynamics(TracedDynamics):
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

    requires = _requires_points

    def __init__(self, model: Model, config: CarrierDynamicsConfig | None = None):
        super().__init__(
            lambda state, forces, carrier_mass: double_integrator_rate(
                state, forces, mass=carrier_mass
            ),
            inputs={"carrier_forces": 3 * model.n},
            state=model.initial_carrier_state,
            state_port="carrier_state",
            parameters=BlockParameters(model, ("carrier_mass",)),
            key=("double integrators", model.n),
        )

    def CalcKineticEnergy(self, context: Context) -> float:
        """½ m_c Σ ‖v_i‖², J; the context is the block's own. Without weight none is potential."""
        return _kinetic_energy(self, context)

    def SetCarrierState(self, context: Context, value: NDArray) -> None:
        context.SetContinuousState(value)


@dataclass(kw_only=True)
class LoadedCarrierDynamicsConfig(StrictFields):
    """The limit of a carrier; its mass is the system's."""

    max_force: float = math.inf  # N, of a carrier


class LoadedCarrierDynamics(TracedDynamics):
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

    requires = _requires_points

    def __init__(self, model: Model, config: LoadedCarrierDynamicsConfig | None = None):
        config = config or LoadedCarrierDynamicsConfig()
        _check(model, config)
        n = model.n
        super().__init__(
            lambda *values, carrier_mass, gravity, max_force=None: loaded_carrier_rate(
                *values, mass=carrier_mass, gravity=gravity, max_force=max_force
            ),
            inputs={"carrier_forces": 3 * n, "cable_forces": 3 * n},
            state=model.initial_carrier_state,
            state_port="carrier_state",
            parameters=BlockParameters(
                model,
                ("carrier_mass", "gravity"),
                config=config,
                own=("max_force",) if _is_limited(model, config) else (),
                rules=Rules(check=_check, structure=_is_limited),
            ),
            key=("loaded carriers", n, _is_limited(model, config)),
        )

    SetCarrierState = CarrierDynamics.SetCarrierState

    def CalcKineticEnergy(self, context: Context) -> float:
        """½ m_c Σ ‖v_i‖², J; the context is the block's own."""
        return _kinetic_energy(self, context)

    def CalcPotentialEnergy(self, context: Context) -> float:
        """Those of the weights, m_c g Σ z_i, J; the context is the block's own."""
        state = self.GetOutputPort("carrier_state").Eval(context)
        values = parameters_in(self, context)
        energy = carriers_potential_energy(
            state, mass=values["carrier_mass"], gravity=values["gravity"]
        )
        return float(energy[0])


def _kinetic_energy(block: System, context: Context) -> float:
    state = block.GetOutputPort("carrier_state").Eval(context)
    mass = parameters_in(block, context)["carrier_mass"]
    return float(carriers_kinetic_energy(state, mass=mass)[0])


def _check(model: Model, config: LoadedCarrierDynamicsConfig) -> None:
    limit = config.max_force
    require(
        (is_number(limit) and limit > 0) or limit == math.inf,
        "carrier_dynamics.max_force",
        limit,
        "give a number greater than zero, or .inf for no limit",
    )


def _is_limited(model: Model, config: LoadedCarrierDynamicsConfig) -> bool:
    return config.max_force < math.inf


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

    requires = _requires_points

    def __init__(self, model: Model, config: IdealCarriersConfig | None = None):
        """Makes the block; it takes a `model` and a `config` (None: the default values)."""
        super().__init__(stacking({"carrier_reference": 6 * model.n}, "carrier_state"))
        self.parameters = BlockParameters(model, rules=Rules(fixed=("carrier_mass",)))
        self._mass = model.carrier_mass

    def CalcKineticEnergy(self, context: Context) -> float:
        """½ m_c Σ ‖v_i‖², J; the context is the block's own. Without weight none is potential."""
        state = self.GetOutputPort("carrier_state").Eval(context)
        return float(carriers_kinetic_energy(state, mass=self._mass)[0])


@dataclass(kw_only=True)
class FixedWingDynamicsConfig(StrictFields):
    """What a stall does to a run; the aircraft are the system's."""

    stops_at_stall: bool = (
        True  # the run ends at the first stall; false: with stalled lift it goes on
    )


class FixedWingDynamics(TracedDynamics):
    """Fixed-wing aircraft: 3-DoF point masses with lift, bank and thrust that lag their commands.

    With the airspeed V, forward x, the lift's direction l at the bank μ, and q = ½ ρ V²,

        m v̇ = q S C_L l + T (cos α x + sin α l) − q S C_D x − m g e₃ − f,

    see `drake_nonstop.mechanics.aircraft` for the polar, the lags, the limits of roll rate and
    thrust, and the gusts' angle of attack. A wing whose C_L reaches C_Lmax, or an airspeed below
    the stall speed, is a stall: the lift stays at that of C_Lmax.

    .. pydrake_system::

        name: FixedWingDynamics
        input_ports:
        - aircraft_command
        - cable_forces
        - wind
        output_ports:
        - carrier_state
        - aircraft_state
        - carrier_acceleration

    `aircraft_command` (3n) = [C_L; bank (rad, positive to the right); thrust (N)], `cable_forces`
    (3n) on the load in N, `wind` (3n) in m/s; `carrier_state` (6n) = [positions (m), velocities
    (m/s)], `aircraft_state` (4n) = [C_L with the gusts' part; bank (rad); thrust (N); airspeed
    (m/s)], `carrier_acceleration` (3n) in m/s²; vectors are in W.

    Parameters, the fields of `FixedWingDynamicsConfig`:
        stops_at_stall: the run ends at the first stall; false: with stalled lift it goes on

    Raises:
        ScenarioError: the system has no aircraft.
    """

    ending_signal = "aircraft_state"

    def __init__(self, model: Model, config: FixedWingDynamicsConfig | None = None):
        aircraft = required_aircraft(model, "carrier_dynamics", "FixedWingDynamics")
        n = model.n
        zeros = FlightStates(model.initial_carrier_state, *(np.zeros(k * n) for k in (1, 1, 1, 3)))

        def flight(*values: NDArray, **numbers: Any) -> tuple[NDArray, ...]:
            states, _, pull, wind = values
            flying = aircraft_of(aircraft, numbers)
            return (
                flight_rate(flying, *values),
                states[: 6 * n],
                shown_state(flying, states, wind),
                flight_acceleration(flying, states, pull, wind),
            )

        super().__init__(
            flight,
            inputs={"aircraft_command": 3 * n, "cable_forces": 3 * n, "wind": 3 * n},
            outputs={
                "carrier_state": 6 * n,
                "aircraft_state": 4 * n,
                "carrier_acceleration": 3 * n,
            },
            state=np.concatenate(zeros),
            parameters=BlockParameters(model, AIRCRAFT_NUMBERS),
            key=("fixed-wing aircraft", n),
        )
        self._stops_at_stall = (config or FixedWingDynamicsConfig()).stops_at_stall
        self._aircraft = aircraft

    def SetCarrierState(self, context: Context, value: NDArray) -> None:
        states = context.get_continuous_state_vector().CopyToVector()
        states[: len(value)] = value
        context.SetContinuousState(states)

    def TrimCarriersTo(self, context: Context, acceleration: NDArray) -> None:
        """Sets C_L, bank and thrust, within their limits, for these accelerations (3n,), m/s²."""
        pull, wind = (self.GetInputPort(name).Eval(context) for name in ("cable_forces", "wind"))
        state = self.GetOutputPort("carrier_state").Eval(context)
        states = trimmed_states(self._aircraft_in(context), state, acceleration, pull, wind)
        context.SetContinuousState(states)

    def ends_run(self, context: Context, shown: NDArray) -> bool:
        """Whether an aircraft is stalled, and a run ends there.

        Args:
            context: the block's own, whose parameters it goes by.
            shown: the `aircraft_state`.
        """
        aircraft = self._aircraft_in(context)
        return self._stops_at_stall and bool(np.any(is_stalled(aircraft, shown)))

    def _aircraft_in(self, context: Context) -> Aircraft:
        return aircraft_of(self._aircraft, parameters_in(self, context))

    def CalcKineticEnergy(self, context: Context) -> float:
        """½ m Σ ‖v_i‖², J; the context is the block's own."""
        state = self.GetOutputPort("carrier_state").Eval(context)
        mass = self._aircraft_in(context).mass
        return float(carriers_kinetic_energy(state, mass=mass)[0])

    def CalcPotentialEnergy(self, context: Context) -> float:
        """Those of the weights, m g Σ z_i, J; the context is the block's own."""
        state = self.GetOutputPort("carrier_state").Eval(context)
        flying = self._aircraft_in(context)
        energy = carriers_potential_energy(state, mass=flying.mass, gravity=flying.gravity)
        return float(energy[0])


# The blocks that the box can be, the default first.
VARIANTS = (
    CarrierDynamics,
    LoadedCarrierDynamics,
    FixedWingDynamics,
    JsbsimCarriers,
    IdealCarriers,
)
