"""The controller half of box "Carrier Controller + Dynamics" for carriers that are aircraft."""

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.flight_control import (
    ObserverStates,
    flight_command,
    limited_command,
    observer_shares,
    observer_targets,
)
from drake_nonstop.mechanics.signals import WIND_SIZE, AircraftState
from drake_nonstop.mechanics.tuning import pid_gains
from drake_nonstop.model.block_parameters import (
    AIRCRAFT_NUMBERS,
    BlockParameters,
    Rules,
    aircraft_of,
    required_aircraft,
)
from drake_nonstop.model.system import Model
from drake_nonstop.systems.traced_block import TracedDynamics
from drake_nonstop.validation import (
    StrictFields,
    require,
    require_non_negative,
    require_positive,
)

_BOX = "carrier_controller"
_LIMITS = ("lift_share", "max_bank", "speed_share")


@dataclass(kw_only=True)
class FixedWingControllerConfig(StrictFields):
    """Poles of the carriers about their references, observer and limits."""

    frequency: float = 1.5  # rad/s, natural frequency of a carrier about its reference
    damping: float = 0.9  # damping ratio
    lead: float = 1.0  # weight of the lead along the reference; 0: none
    observer: float = 1.0  # weight of the observed disturbance; 0: none
    observer_time: float = 0.1  # s, time constant of the disturbance observer
    lift_share: float = 0.9  # of C_Lmax, the largest lift coefficient that is commanded
    max_bank: float = 0.8726646259971648  # rad, the largest bank that is commanded, 50 degrees
    speed_share: float = 1.2  # of the stall speed, below which thrust is added


class FixedWingController(TracedDynamics):
    """Aircraft along their references: lift coefficient, bank and thrust by the exact inverse.

    With the errors e = p_d − p and ė, K_p = ω² and K_v = 2 ζ ω, the force

        F = m (a_d + K_v ė + K_p e) + m g e₃ + f_d − d̂

    is inverted to C_L, bank and thrust; each gets τ times its rate along the reference more, since
    it follows with a lag τ. The disturbance d̂ is the low-pass, in the axes of flight through the
    air, of what the model of the aircraft does not explain of the measured acceleration; of the
    aircraft's state it takes bank and airspeed, and C_L and thrust from the commands and their
    lags. Limits come last: C_L, whose vertical part is kept by cutting the bank, the bank, more
    thrust at low speed, and the thrust, see `mechanics.flight_control`.

    .. pydrake_system::

        name: FixedWingController
        input_ports:
        - carrier_reference
        - carrier_reference_acceleration
        - carrier_reference_jerk
        - carrier_state
        - aircraft_state
        - desired_cable_forces
        - desired_cable_force_rates
        - wind_estimate
        - carrier_acceleration
        output_ports:
        - aircraft_command
        - command_saturation

    `carrier_reference` and `carrier_state` (6n) = [positions (m), velocities (m/s)],
    `carrier_reference_acceleration` and `carrier_acceleration` (3n, m/s²), the first desired and
    the second measured, `carrier_reference_jerk` (3n, m/s³), `desired_cable_forces` (3n, N) and
    their rates (3n, N/s), `wind_estimate` (3, m/s), all in W; `aircraft_state` (4n) = [effective
    C_L; bank (rad); thrust (N); airspeed (m/s)]; `aircraft_command` (3n) = [C_L; bank (rad,
    positive to the right); thrust (N)]; `command_saturation` (3n): 1 where a limit changes an entry
    of the command, else 0. The state is [disturbance (3n, N), in each aircraft's axes of flight
    through the air; C_L (n); thrust (n, N)]: continuous,
    or discrete where the model has a control period; the command is then computed at the samples
    and held.

    Parameters, the fields of `FixedWingControllerConfig`:
        frequency: rad/s, natural frequency of a carrier about its reference
        damping: damping ratio
        lead: weight of the lead along the reference; 0: none
        observer: weight of the observed disturbance; 0: none
        observer_time: s, time constant of the disturbance observer
        lift_share: of C_Lmax, the largest lift coefficient that is commanded
        max_bank: rad, the largest bank that is commanded, 50 degrees
        speed_share: of the stall speed, below which thrust is added

    Raises:
        ScenarioError: the system has no aircraft, or a parameter is out of its range.
    """

    is_sampled = True

    def __init__(self, model: Model, config: FixedWingControllerConfig | None = None):
        config = config or FixedWingControllerConfig()
        _check(model, config)
        n, size, period = model.n, 3 * model.n, model.control_period
        super().__init__(
            _law(model),
            inputs={
                "carrier_reference": 2 * size,
                "carrier_reference_acceleration": size,
                "carrier_reference_jerk": size,
                "carrier_state": 2 * size,
                "aircraft_state": 4 * n,
                "desired_cable_forces": size,
                "desired_cable_force_rates": size,
                "wind_estimate": WIND_SIZE,
                "carrier_acceleration": size,
            },
            outputs=dict.fromkeys(("aircraft_command", "command_saturation"), size),
            state=np.zeros(5 * n),
            start=(_started, ("aircraft_state",)),
            period=period,
            is_held=True,
            parameters=BlockParameters(
                model,
                AIRCRAFT_NUMBERS,
                config=config,
                own=asdict(config),
                rules=Rules(check=_check),
            ),
            key=("fixed-wing controller", n, period),
        )


def _started(aircraft_state: NDArray) -> NDArray:
    """`ObserverStates` (5n,) without a disturbance, with lift and thrust of the aircraft."""
    measured = AircraftState.view(aircraft_state)
    nothing = 0 * aircraft_state[: 3 * len(measured.lift)]
    return np.concatenate(ObserverStates(nothing, measured.lift, measured.thrust))


def _law(model: Model) -> Callable[..., tuple[NDArray, NDArray, NDArray]]:
    """The rates of the observer, the commands, and which of them a limit changes."""
    n, period = model.n, model.control_period
    of_model = required_aircraft(model, _BOX, "FixedWingController")

    def law(
        observer_states: NDArray,
        carrier_reference: NDArray,
        reference_acceleration: NDArray,
        reference_jerk: NDArray,
        carrier_state: NDArray,
        aircraft_state: NDArray,
        cable_forces: NDArray,
        cable_force_rates: NDArray,
        wind: NDArray,
        acceleration: NDArray,
        *,
        frequency: NDArray,
        damping: NDArray,
        lead: NDArray,
        observer: NDArray,
        observer_time: NDArray,
        **numbers: NDArray,
    ) -> tuple[NDArray, NDArray, NDArray]:
        limits = {name: numbers.pop(name) for name in _LIMITS}
        aircraft = aircraft_of(of_model, numbers)
        position_gain, velocity_gain, _ = pid_gains(frequency, damping, 0.0)
        measured = AircraftState.view(aircraft_state)
        command = flight_command(
            aircraft,
            carrier_reference,
            reference_acceleration,
            reference_jerk,
            carrier_state,
            cable_forces,
            cable_force_rates,
            observer * ObserverStates.view(observer_states).disturbance,
            wind,
            position_gain=position_gain,
            velocity_gain=velocity_gain,
            lead=lead,
        )
        told, saturation = limited_command(
            aircraft, command, measured.airspeed, speed_gain=velocity_gain, **limits
        )
        targets = observer_targets(
            aircraft,
            observer_states,
            told,
            carrier_state,
            acceleration,
            measured.bank,
            cable_forces,
            wind,
        )
        shares = observer_shares(aircraft, n, observer_time, period)
        return shares * (targets - observer_states), told, saturation

    return law


def _check(model: Model, config: Any) -> None:
    required_aircraft(model, _BOX, "FixedWingController")
    values = asdict(config)
    weights = {name: values[name] for name in ("damping", "lead", "observer", "speed_share")}
    require_non_negative(_BOX, **weights)
    require_positive(_BOX, **{k: v for k, v in values.items() if k not in weights})
    require(config.lift_share <= 1, f"{_BOX}.lift_share", config.lift_share, "give at most 1")
    require(
        config.max_bank < math.pi / 2,
        f"{_BOX}.max_bank",
        config.max_bank,
        "give less than pi/2 rad",
    )
