"""The dynamics half of box "Carrier Controller + Dynamics"."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context

from drake_nonstop.mechanics.aircraft import (
    Aircraft,
    flight_acceleration,
    flight_rate,
    flown_aircraft,
    is_stalled,
    shown_state,
    trimmed_states,
)
from drake_nonstop.mechanics.carrier import (
    double_integrator_rate,
    limited_acceleration,
    limited_carrier_rate,
)
from drake_nonstop.model.block import (
    AIRCRAFT_NUMBERS,
    Block,
    aircraft_of,
    required_aircraft,
)
from drake_nonstop.model.system import Model
from drake_nonstop.systems.parameters import parameters_in
from drake_nonstop.systems.requirements import LoopBlocks
from drake_nonstop.validation import StrictFields, positive, require_ranges

_BOX = "carrier_dynamics"
_PULL = "carrier_cable_forces"
_UP = np.array([0.0, 0.0, 1.0])


class _Points(Block):
    """Carriers without wings."""

    makes: ClassVar[tuple[str, ...]] = ("carrier_state",)

    def requires(self, loop: LoopBlocks) -> Iterator[str]:
        """Tells of aircraft that cannot stall, since they move as points."""
        if loop.simulated.aircraft is not None:
            yield (
                f"{_BOX} = {type(self).__name__}: its carriers are points of the "
                "aircraft's mass, which cannot stall; give carrier_dynamics=FixedWingDynamics and "
                "carrier_controller=FixedWingController"
            )


@dataclass(kw_only=True)
class CarrierDynamicsConfig(StrictFields):
    """No parameters: the carrier mass is the system's."""


class CarrierDynamics(_Points):
    """Double integrators: m_c p̈ = u, without weight or cable reaction, as in the paper.

    `carrier_state` is the state.
    """

    reads = ("carrier_forces",)
    state_ports = ("carrier_state",)
    system = ("carrier_mass",)

    @staticmethod
    def equations(state: NDArray, forces: NDArray, *, carrier_mass: NDArray) -> NDArray:
        return double_integrator_rate(state, forces, mass=carrier_mass)

    def state(self, model: Model) -> NDArray:
        return model.initial_carrier_state


@dataclass(kw_only=True)
class LimitedCarriersConfig(StrictFields):
    """Limit and lag of the carriers' own acceleration, and what else moves them."""

    max_acceleration: float = positive(100.0)  # m/s², of the force that a carrier makes, over m_c
    lag: float = positive(0.005)  # s, time constant of that force
    has_weight: bool = False  # whether its weight pulls at a carrier
    feels_cable: bool = False  # whether its cable pulls at a carrier


class LimitedCarriers(_Points):
    """Double integrators whose force is limited, and follows its command with a first-order lag.

        v̇_i = a_i − g e₃ − f_i/m_c,   τ ȧ_i = sat(u_i/m_c) − a_i,

    with the `lag` τ; sat limits the norm to `max_acceleration`. The term of g is there where
    `has_weight`, and that of the cable's force f_i on the load where `feels_cable`. No controller
    of the package feeds them forward: with a position gain K_p carriers sag by ‖m_c g e₃ + f‖/K_p
    until the integrals of the carriers or of the load correct that. A PID whose force lags by more
    than K_d/K_p is unstable.

    The state is [positions (3n), m; velocities (3n), m/s; a (3n), m/s²], in W. A run starts with
    the a that the references need. Own model of thrust that turns with the vehicle.

    Raises:
        ScenarioError: the limit or the lag is not positive.
    """

    reads = ("carrier_forces", _PULL)
    where: ClassVar = {_PULL: "`feels_cable` is true"}
    system = ("carrier_mass", "gravity")

    @staticmethod
    def equations(
        states: NDArray,
        forces: NDArray,
        *cable_forces: NDArray,
        has_weight: bool,
        carrier_mass: NDArray,
        gravity: NDArray,
        **limits: NDArray,
    ) -> tuple[NDArray, NDArray]:
        pull = -has_weight * gravity * np.tile(_UP, len(forces) // 3)
        for force in cable_forces:
            pull = pull - force / carrier_mass
        rate = limited_carrier_rate(states, forces / carrier_mass, pull, **limits)
        return rate, states[: 2 * len(forces)]

    @classmethod
    def check(cls, model: Model, config: LimitedCarriersConfig) -> None:
        require_ranges(_BOX, config)

    def inputs(self, model: Model) -> tuple[str, ...]:
        return self.reads if self.config.feels_cable else self.reads[:1]

    def constants(self, model: Model, config: LimitedCarriersConfig) -> dict[str, Any]:
        return {"has_weight": config.has_weight}

    def state(self, model: Model) -> NDArray:
        return np.append(model.initial_carrier_state, np.zeros(3 * model.n))

    def trim(self, context: Context, carrier_reference_acceleration: NDArray | float = 0.0) -> None:
        """Sets the carriers' own accelerations for those (3n,) of their references, m/s²."""
        numbers = parameters_in(self, context)
        weight = numbers["gravity"] * self.config.has_weight * np.tile(_UP, self.model.n)
        own = carrier_reference_acceleration + weight
        if self.config.feels_cable:
            own = own + self.GetInputPort(_PULL).Eval(context) / numbers["carrier_mass"]
        limit = numbers["max_acceleration"]
        state = self.GetOutputPort("carrier_state").Eval(context)
        context.SetContinuousState(np.append(state, limited_acceleration(own, limit)))


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
        return np.append(model.initial_carrier_state, np.zeros(6 * model.n))

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


VARIANTS = (CarrierDynamics, LimitedCarriers, FixedWingDynamics)
