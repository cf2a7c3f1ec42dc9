"""The controller half of box "Carrier Controller + Dynamics" for carriers that are aircraft."""

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.aircraft import flown_aircraft
from drake_nonstop.mechanics.flight_control import (
    FlightSignals,
    ObserverStates,
    flight_command,
    limited_command,
    observer_rate,
)
from drake_nonstop.mechanics.signals import HELD, SAMPLE_TIME, AircraftState
from drake_nonstop.mechanics.tuning import pid_gains
from drake_nonstop.model.block import (
    AIRCRAFT_NUMBERS,
    Block,
    aircraft_of,
    required_aircraft,
    with_this_sample,
)
from drake_nonstop.model.system import Model
from drake_nonstop.validation import (
    StrictFields,
    non_negative,
    number_with,
    positive,
    require_ranges,
)

_BOX = "carrier_controller"
_OF_CABLES = ("cable_drag_and_weight", "cable_drag_and_weight_rates")
# What it reads at the samples: references as they are computed there, measurements as held.
_AT_SAMPLES = {
    name: f"sampled_{name}" for name in ("carrier_reference", "carrier_reference_acceleration")
} | {name: HELD + name for name in ("carrier_state", "aircraft_state", "carrier_acceleration")}


@dataclass(kw_only=True)
class FixedWingControllerConfig(StrictFields):
    """Poles of the carriers about their references, weights of lead and observer, and limits."""

    frequency: float = positive(1.5)  # rad/s, natural frequency of a carrier about its reference
    damping: float = non_negative(0.9)  # damping ratio
    lead: float = non_negative(1.0)  # weight of the lead along the reference; 0: none
    observer: float = non_negative(1.0)  # weight of the observed disturbance; 0: none
    observer_time: float = positive(0.1)  # s, time constant of the disturbance observer
    lift_share: float = positive(  # share of C_Lmax, up to which a C_L is commanded
        0.9, number_with(lambda share: share <= 1, "give at most 1")
    )
    max_bank: float = positive(  # rad, the largest bank that is commanded, 50 degrees
        0.8726646259971648, number_with(lambda b: b < math.pi / 2, "give less than pi/2 rad")
    )
    speed_share: float = non_negative(1.2)  # share of the stall speed; below it thrust is added


class FixedWingController(Block):
    """Aircraft along their references: lift coefficient, bank and thrust by the exact inverse.

    With the errors e = p_d − p of position and ė of velocity, the reference's acceleration a_d, the
    desired force f_d of the cable on the load, K_p = ω² and K_v = 2 ζ ω of the config's `frequency`
    ω and `damping` ζ, the force on an aircraft

        F = m (a_d + K_v ė + K_p e) + m g e₃ + f_d − d̂

    is inverted to C_L, bank and thrust; each gets τ times its rate along the reference more, since
    it follows with a lag τ. The disturbance d̂ is the low-pass, in the axes of flight through the
    air, of the force that the measured acceleration shows and the model of the aircraft does not.
    The model takes the measured bank and airspeed, and C_L and thrust that follow the commands with
    their lags. Limits come last: C_L, whose vertical part is kept by cutting the bank, the bank,
    more thrust at low speed, and the thrust, see `mechanics.flight_control`.

    The command is [C_L (n); bank (n), rad; thrust (n), N], the saturation (3n,) has 1 where a limit
    changed it, else 0. The state is [disturbance (3n), N, in each aircraft's axes of flight through
    the air; C_L (n); thrust (n), N]: continuous, or discrete where the model has a control period;
    the command is then computed at the samples and held.

    Where references know their cables' drag and weight f_d has these, too, by
    `cable_drag_and_weight`, and the model of the aircraft no share of that drag.

    Raises:
        ScenarioError: the system has no aircraft, or a parameter is out of its range.
    """

    reads = (
        "carrier_reference",
        "carrier_reference_acceleration",
        "carrier_reference_jerk",
        "carrier_state",
        "aircraft_state",
        "desired_cable_forces",
        "desired_cable_force_rates",
        "wind_estimate",
        "carrier_acceleration",
        *_OF_CABLES,
        SAMPLE_TIME,
    )
    optional_inputs = _OF_CABLES
    where: ClassVar = {SAMPLE_TIME: "the model has a control period"}
    makes = ("aircraft_command", "command_saturation")

    system = AIRCRAFT_NUMBERS
    of_model = ("control_period", "bears_cable_drag")
    is_sampled = True

    def inputs(self, model: Model) -> tuple[str, ...]:
        shown = _AT_SAMPLES if model.control_period > 0 else {}
        return tuple(shown.get(name, name) for name in super().inputs(model))

    @staticmethod
    def equations(
        observer_states: NDArray,
        *values: NDArray,
        frequency: NDArray,
        damping: NDArray,
        lead: NDArray,
        observer: NDArray,
        observer_time: NDArray,
        control_period: float,
        bears_cable_drag: bool,
        **numbers: NDArray,
    ) -> tuple[NDArray, NDArray, NDArray]:
        (*given, cable_load, cable_load_rates), sample_time = values[:11], values[11:]
        signals = FlightSignals(*given)
        signals = signals._replace(
            cable_forces=signals.cable_forces + cable_load,
            cable_force_rates=signals.cable_force_rates + cable_load_rates,
        )
        aircraft = flown_aircraft(aircraft_of(numbers), bears_cable_drag)
        position_gain, velocity_gain, _ = pid_gains(frequency, damping, 0.0)
        command = flight_command(
            aircraft,
            signals,
            observer * ObserverStates.view(observer_states).disturbance,
            position_gain=position_gain,
            velocity_gain=velocity_gain,
            lead=lead,
        )
        limited, saturation = limited_command(
            aircraft,
            command,
            AircraftState.view(signals.aircraft_state).airspeed,
            speed_gain=velocity_gain,
            **{name: numbers[name] for name in ("lift_share", "max_bank", "speed_share")},
        )
        rate = observer_rate(
            aircraft,
            observer_states,
            limited,
            signals,
            observer_time=observer_time,
            period=control_period,
        )
        rate, _ = with_this_sample(observer_states, rate, sample_time, control_period)
        return rate, limited, saturation

    @classmethod
    def check(cls, model: Model, config: Any) -> None:
        required_aircraft(model, _BOX, "FixedWingController")
        require_ranges(_BOX, config)

    def state(self, model: Model) -> NDArray:
        return np.zeros(5 * model.n)

    @staticmethod
    def start(observer_states: NDArray, *inputs: NDArray, **numbers: Any) -> NDArray:
        """`ObserverStates` (5n,) without a disturbance, with C_L and thrust of `AircraftState`."""
        aircraft_state = inputs[4]
        measured = AircraftState.view(aircraft_state)
        undisturbed = 0 * aircraft_state[: 3 * len(measured.lift)]
        return np.concatenate([undisturbed, measured.lift, measured.thrust])
