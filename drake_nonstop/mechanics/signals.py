"""The signals between the blocks: flat vectors, with names, units and frames of their parts.

A class has one vector's parts in their order, as views and as a layout:

    velocity = LoadState.view(load_state).velocity
    load_state = np.concatenate(LoadState(quaternion, position, angular_velocity, velocity))
    LoadState.layout.entries("load_state", 13)

`SIGNALS` has the layouts of all signals, by their names. All quantities are SI.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.signal_layouts import Layout, Part, SignalParts, SomeOf, part
from drake_nonstop.mechanics.taylor import Taylor

SIGNAL_PERIOD = 0.01  # s, of the signals that are written
MOST_NODES = 50  # of a cable
SAMPLE_TIME = "sample_time"  # of what is held
HELD = "held_"  # begins the name of a signal that is held from one sample to the next
SAMPLED = "sampled_"  # how names begin of what a block makes at samples and moves in between


class Pose(SignalParts):
    """The load's pose: what load states and references begin with."""

    quaternion: NDArray = part("4", "", "W", "of R_WL")
    position: NDArray = part("3", "m", "W")


class LoadState(Pose):
    """Pose and twist of the load, in the order of a free body in Drake's MultibodyPlant.

    A view of a state's rate has the rates of the parts.
    """

    angular_velocity: NDArray = part("3", "rad/s", "W")
    velocity: NDArray = part("3", "m/s", "W")


class LoadReference(LoadState):
    """The desired motion of the load."""

    quaternion: NDArray = part("4", "", "W", "of R_WD, D the desired frame")
    angular_acceleration: NDArray = part("3", "rad/s²", "W")
    acceleration: NDArray = part("3", "m/s²", "W")
    jerk: NDArray = part("3", "m/s³", "W")


class ReferenceHigherRates(SignalParts):
    """The rates of a load reference's angular acceleration and of its jerk."""

    angular_jerk: NDArray = part("3", "rad/s³", "W")
    snap: NDArray = part("3", "m/s⁴", "W")


class Wrench(SignalParts):
    """A wrench at the load's centre of mass, or its rate."""

    torque: NDArray = part("3", "N m", "W", "about the load's centre of mass")
    force: NDArray = part("3", "N", "W")


class TrackingError(SignalParts):
    """The load's state minus its reference."""

    orientation: NDArray = part("3", "rad", "L", "e_R")
    position: NDArray = part("3", "m", "W", "e_p")
    angular_velocity: NDArray = part("3", "rad/s", "L", "e_ω")
    velocity: NDArray = part("3", "m/s", "W", "e_v")


class CarrierStates(SignalParts):
    """Positions and velocities of n carriers, or their references: [p_1 … p_n, v_1 … v_n]."""

    positions: NDArray = part("3n", "m", "W")
    velocities: NDArray = part("3n", "m/s", "W")


class Parameters(SignalParts):
    """Parameters of the internal force."""

    frequency: NDArray = part("1", "rad/s", "", "ξ")
    amplitude: NDArray = part("1", "N", "", "A")


class Phase(SignalParts):
    """The internal force's phase."""

    angle: NDArray = part("1", "rad", "", "θ")
    slope: NDArray = part("1", "s", "", "∂θ/∂ξ")


class PlannedParameters(SignalParts):
    """Phase θ, frequency ξ = θ̇ and amplitude A of the internal force with all rates that matter."""

    angle: NDArray = part("1", "rad", "", "θ")
    frequency: NDArray = part("1", "rad/s", "", "ξ")
    amplitude: NDArray = part("1", "N", "", "A")
    frequency_rate: NDArray = part("1", "rad/s²", "", "ξ̇")
    amplitude_rate: NDArray = part("1", "N/s", "", "Ȧ")
    frequency_second_rate: NDArray = part("1", "rad/s³", "", "ξ̈")
    amplitude_second_rate: NDArray = part("1", "N/s²", "", "Ä")
    amplitude_third_rate: NDArray = part("1", "N/s³", "", "A⃛")

    @property
    def series(self) -> tuple[Taylor, Taylor]:
        """θ and A with three rates each."""
        angle = self.angle, self.frequency, self.frequency_rate, self.frequency_second_rate
        rates = self.amplitude_rate, self.amplitude_second_rate, self.amplitude_third_rate
        return Taylor.of_rates(*angle), Taylor.of_rates(self.amplitude, *rates)


class InternalForce(SignalParts):
    """The m internal-force coordinates and their rates."""

    values: NDArray = part("m", "N", "", "λ")
    rates: NDArray = part("m", "N/s", "", "λ̇")


class InternalForceHigherRates(SignalParts):
    """The second and third rates of the m internal-force coordinates."""

    second: NDArray = part("m", "N/s²", "", "λ̈")
    third: NDArray = part("m", "N/s³", "", "λ⃛")


class AircraftCommand(SignalParts):
    """Commands of n aircraft."""

    lift: NDArray = part("n", "", "", "C_L")
    bank: NDArray = part("n", "rad", "", "positive to the right")
    thrust: NDArray = part("n", "N")


class AircraftState(AircraftCommand):
    """States of n aircraft besides their positions and velocities."""

    lift: NDArray = part("n", "", "", "C_L with the gusts' part, at most its maximum")
    airspeed: NDArray = part("n", "m/s")


LOAD_STATE_SIZE = LoadState.layout.count()
LOAD_REFERENCE_SIZE = LoadReference.layout.count()
REFERENCE_HIGHER_RATES_SIZE = ReferenceHigherRates.layout.count()
WRENCH_SIZE = Wrench.layout.count()
TRACKING_ERROR_SIZE = TrackingError.layout.count()
PARAMETERS_SIZE = Parameters.layout.count()
PHASE_SIZE = Phase.layout.count()
PLANNED_SIZE = PlannedParameters.layout.count()
WIND_SIZE = 3


def resting_reference() -> NDArray:
    """A new `LoadReference` (22,) that rests at W's origin, with its axes."""
    values = np.zeros(LOAD_REFERENCE_SIZE)
    LoadReference.view(values).quaternion[0] = 1.0
    return values


def constant_plan(angle: NDArray, frequency: Any, amplitude: Any) -> NDArray:
    """A plan (..., 8) at phases (...), rad, of ξ and A that stay, numbers or (...)."""
    zero = 0 * angle
    return np.stack([angle, zero + frequency, zero + amplitude, *[zero] * 5], axis=-1)


def nodes_layout(nodes: int) -> SomeOf:
    """The state of so many nodes of each cable, from the load on."""
    kinds = ("position", "m"), ("velocity", "m/s")
    return SomeOf(
        *(Part(f"{name}_{k + 1}", "3n", unit, "W") for name, unit in kinds for k in range(nodes))
    )


# By the names of signals; None: one is no vector. Besides, a block may have `signal_layouts`.
SIGNALS: dict[str, Layout | None] = {
    "reference": LoadReference.layout,
    "reference_higher_rates": ReferenceHigherRates.layout,
    "reference_preview": None,
    "reference_delay": Layout(Part("", "1", "s", "", "d of the governed time t − d")),
    "load_state": LoadState.layout,
    "measured_load_state": LoadState.layout,
    "measured_attitude": Layout(Part("quaternion", "4", "", "W", "of R_WL")),
    "measured_load_covariance": Layout(  # of the error of each axis
        *(
            Part(f"{p}_{name}", "1", u)
            for p, unit in (("rotation", "rad"), ("translation", "m"))
            for name, u in (
                ("variance", f"{unit}²"),
                ("covariance", f"{unit}²/s"),
                ("rate_variance", f"{unit}²/s²"),
            )
        )
    ),
    "wrench": Wrench.layout,
    "wrench_rate": Layout(Part("torque", "3", "N m/s", "W"), Part("force", "3", "N/s", "W")),
    "tracking_error": TrackingError.layout,
    "parameters": Parameters.layout,
    "plan": PlannedParameters.layout,
    "planned": PlannedParameters.layout,
    "phase": Phase.layout,
    "solve_time": Layout(Part("", "1", "s", "", "wall time of the last update")),
    "speed_bound": Layout(Part("", "1", "m/s", "", "ε, set or commanded")),
    "speed_bound_command": Layout(Part("", "1", "m/s", "", "ε, in place of the one that is set")),
    "measured_margin": Layout(Part("", "1", "m/s", "", "that plans keep above ε")),
    SAMPLE_TIME: Layout(Part("", "1", "s", "", "of the last sample")),
    "internal_force": InternalForce.layout,
    "internal_force_higher_rates": InternalForceHigherRates.layout,
    "desired_cable_forces": Layout(Part("", "3n", "N", "W", "on the load")),
    "desired_cable_force_rates": Layout(Part("", "3n", "N/s", "W")),
    "carrier_reference": CarrierStates.layout,
    "carrier_reference_acceleration": Layout(Part("", "3n", "m/s²", "W")),
    "sampled_carrier_reference": CarrierStates.layout,
    "sampled_carrier_reference_acceleration": Layout(Part("", "3n", "m/s²", "W")),
    "carrier_reference_jerk": Layout(Part("", "3n", "m/s³", "W")),
    "cable_reference": nodes_layout(MOST_NODES),
    "cable_drag_and_weight": Layout(
        Part("", "3n", "N", "W", "that carriers pull with beyond desired_cable_forces")
    ),
    "cable_drag_and_weight_rates": Layout(Part("", "3n", "N/s", "W")),
    "load_mass_estimate": Layout(Part("", "1", "kg", "", "by the cables' tensions")),
    "centre_of_mass_estimate": Layout(
        Part("", "3", "m", "L", "beside the model's; its height is not observed")
    ),
    "cable_length_estimate": Layout(Part("", "n", "m", "", "L₀, by tensions and chords")),
    "cable_drag_estimate": Layout(Part("", "1", "", "", "over the model's, by chords")),
    "carrier_forces": Layout(Part("", "3n", "N", "W")),
    "aircraft_command": AircraftCommand.layout,
    "command_saturation": Layout(
        *(
            Part(p.name, "n", "", "", "1 where a limit holds it")
            for p in AircraftCommand.layout.parts
        )
    ),
    "carrier_state": CarrierStates.layout,
    "aircraft_state": AircraftState.layout,
    "carrier_acceleration": Layout(Part("", "3n", "m/s²", "W")),
    "cable_state": nodes_layout(MOST_NODES),
    "cable_forces": Layout(Part("", "3n", "N", "W", "on the load, at its attachments")),
    "carrier_cable_forces": Layout(Part("", "3n", "N", "W", "of the carriers on their cables")),
    "tensions": Layout(Part("", "n", "N", "", "0 where slack")),
    "disturbance_wrench": Wrench.layout,
    "wind": Layout(Part("", "3n", "m/s", "W", "of the air at the carriers")),
    "load_wind": Layout(Part("", "3", "m/s", "W", "of the air at the load")),
    "mean_wind": Layout(Part("", "3", "m/s", "W", "at the load, without gusts")),
    "wind_estimate": Layout(Part("", "3", "m/s", "W", "what the controllers believe")),
    "carrier_gust_estimate": Layout(Part("", "3n", "m/s", "W", "at carriers, beyond their mean")),
}
