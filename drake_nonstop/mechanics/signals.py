"""The flat vectors between the blocks, by the names of their parts.

Each class names the parts of one vector, in their order. `view` slices an array over its last
axis, so that it serves single vectors, object arrays and whole logs (k, size) alike. The parts are
views: nothing is copied, and writing to a part writes to the array. `np.concatenate` of an
instance is the vector again (of logs: with axis=-1).

    velocity = LoadState.view(load_state).velocity
    load_state = np.concatenate(LoadState(quaternion, position, angular_velocity, velocity))

All quantities are SI. Frames are W, unless said otherwise.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

SIGNAL_PERIOD = 0.01  # s, of the signals that are written
POSE_SIZE = 7
LOAD_STATE_SIZE = 13
LOAD_REFERENCE_SIZE = 22
REFERENCE_HIGHER_RATES_SIZE = 6
WRENCH_SIZE = 6
TRACKING_ERROR_SIZE = 12
PARAMETERS_SIZE = 2
PHASE_SIZE = 2
PLANNED_SIZE = 8
WIND_SIZE = 3


class Pose(NamedTuple):
    """The load's pose: what load states and references begin with."""

    quaternion: NDArray  # (..., 4), w x y z, of R_WL
    position: NDArray  # (..., 3), m

    @classmethod
    def view(cls, values: NDArray) -> "Pose":
        """The parts of an array (..., 7), or of a longer one that begins in the same way."""
        return cls(values[..., :4], values[..., 4:7])


class LoadState(NamedTuple):
    """Pose and twist of the load, in the order of a free body in Drake's MultibodyPlant."""

    quaternion: NDArray  # (..., 4), w x y z, of R_WL
    position: NDArray  # (..., 3), m
    angular_velocity: NDArray  # (..., 3), rad/s
    velocity: NDArray  # (..., 3), m/s

    @classmethod
    def view(cls, values: NDArray) -> "LoadState":
        """The parts of an array (..., 13), or of a longer one such as a reference.

        Of a state's rate they are the rates of the parts.
        """
        return cls(values[..., :4], values[..., 4:7], values[..., 7:10], values[..., 10:13])


class LoadReference(NamedTuple):
    """The desired motion of the load."""

    quaternion: NDArray  # (..., 4), w x y z, of R_WD
    position: NDArray  # (..., 3), m
    angular_velocity: NDArray  # (..., 3), rad/s
    velocity: NDArray  # (..., 3), m/s
    angular_acceleration: NDArray  # (..., 3), rad/s²
    acceleration: NDArray  # (..., 3), m/s²
    jerk: NDArray  # (..., 3), m/s³

    @classmethod
    def view(cls, values: NDArray) -> "LoadReference":
        """The parts of an array (..., 22)."""
        return cls(values[..., :4], *(values[..., i : i + 3] for i in range(4, 22, 3)))


def resting_reference() -> NDArray:
    """A new `LoadReference` (22,) that rests at W's origin, with its axes."""
    values = np.zeros(LOAD_REFERENCE_SIZE)
    LoadReference.view(values).quaternion[0] = 1.0
    return values


class ReferenceHigherRates(NamedTuple):
    """The rates of a load reference's angular acceleration and of its jerk."""

    angular_jerk: NDArray  # (..., 3), rad/s³
    snap: NDArray  # (..., 3), m/s⁴

    @classmethod
    def view(cls, values: NDArray) -> "ReferenceHigherRates":
        """The parts of an array (..., 6)."""
        return cls(values[..., :3], values[..., 3:6])


class Wrench(NamedTuple):
    """A wrench at the load's centre of mass, or its rate."""

    torque: NDArray  # (..., 3), N m
    force: NDArray  # (..., 3), N

    @classmethod
    def view(cls, values: NDArray) -> "Wrench":
        """The parts of an array (..., 6)."""
        return cls(values[..., :3], values[..., 3:6])


class TrackingError(NamedTuple):
    """The load's state minus its reference: angular parts in L, the others in W."""

    orientation: NDArray  # (..., 3), e_R, rad for small angles, in L
    position: NDArray  # (..., 3), e_p, m
    angular_velocity: NDArray  # (..., 3), e_ω, rad/s, in L
    velocity: NDArray  # (..., 3), e_v, m/s

    @classmethod
    def view(cls, values: NDArray) -> "TrackingError":
        """The parts of an array (..., 12)."""
        return cls(values[..., :3], values[..., 3:6], values[..., 6:9], values[..., 9:12])


class CarrierStates(NamedTuple):
    """Positions and velocities of n carriers, or their references."""

    positions: NDArray  # (..., n, 3), m
    velocities: NDArray  # (..., n, 3), m/s

    @classmethod
    def view(cls, values: NDArray) -> "CarrierStates":
        """The parts of an array (..., 6n) = [p_1 … p_n, v_1 … v_n]."""
        parts = values.reshape(*values.shape[:-1], 2, -1, 3)
        return cls(parts[..., 0, :, :], parts[..., 1, :, :])

    def flat(self) -> NDArray:
        """The array (..., 6n) of these parts."""
        lead = self.positions.shape[:-2]
        return np.concatenate([part.reshape(*lead, -1) for part in self], axis=-1)


class Parameters(NamedTuple):
    """Parameters of the internal force, each with a last axis of length 1."""

    frequency: NDArray  # (..., 1), ξ, rad/s
    amplitude: NDArray  # (..., 1), A, N

    @classmethod
    def view(cls, values: NDArray) -> "Parameters":
        """The parts of an array (..., 2)."""
        return cls(values[..., :1], values[..., 1:2])


class Phase(NamedTuple):
    """The internal force's phase, each part with a last axis of length 1."""

    angle: NDArray  # (..., 1), θ, rad
    slope: NDArray  # (..., 1), ∂θ/∂ξ, s

    @classmethod
    def view(cls, values: NDArray) -> "Phase":
        """The parts of an array (..., 2)."""
        return cls(values[..., :1], values[..., 1:2])


class PlannedParameters(NamedTuple):
    """Phase θ, frequency ξ = θ̇ and amplitude A of the internal force with all rates that matter.

    Each part has a last axis of length 1; second and third rates are those of time.
    """

    angle: NDArray  # (..., 1), θ, rad
    frequency: NDArray  # (..., 1), ξ, rad/s
    amplitude: NDArray  # (..., 1), A, N
    frequency_rate: NDArray  # (..., 1), rad/s²
    amplitude_rate: NDArray  # (..., 1), N/s
    frequency_second_rate: NDArray  # (..., 1), rad/s³
    amplitude_second_rate: NDArray  # (..., 1), N/s²
    amplitude_third_rate: NDArray  # (..., 1), N/s³

    @classmethod
    def view(cls, values: NDArray) -> "PlannedParameters":
        """The parts of an array (..., 8)."""
        return cls(*(values[..., i : i + 1] for i in range(PLANNED_SIZE)))


class InternalForce(NamedTuple):
    """The m internal-force coordinates and their rates."""

    values: NDArray  # (..., m), λ, N
    rates: NDArray  # (..., m), λ̇, N/s

    @classmethod
    def view(cls, values: NDArray) -> "InternalForce":
        """The parts of an array (..., 2m)."""
        half = values.shape[-1] // 2
        return cls(values[..., :half], values[..., half:])


class InternalForceHigherRates(NamedTuple):
    """The second and third rates of the m internal-force coordinates."""

    second: NDArray  # (..., m), N/s²
    third: NDArray  # (..., m), N/s³

    @classmethod
    def view(cls, values: NDArray) -> "InternalForceHigherRates":
        """The parts of an array (..., 2m)."""
        half = values.shape[-1] // 2
        return cls(values[..., :half], values[..., half:])


class AircraftCommand(NamedTuple):
    """Commands of n aircraft."""

    lift: NDArray  # (..., n), C_L
    bank: NDArray  # (..., n), rad, positive to the right
    thrust: NDArray  # (..., n), N

    @classmethod
    def view(cls, values: NDArray) -> "AircraftCommand":
        """The parts of an array (..., 3n)."""
        n = values.shape[-1] // 3
        return cls(values[..., :n], values[..., n : 2 * n], values[..., 2 * n :])


class AircraftState(NamedTuple):
    """States of n aircraft besides their positions and velocities."""

    lift: NDArray  # (..., n), C_L with the gusts' part, at most its maximum
    bank: NDArray  # (..., n), rad, positive to the right
    thrust: NDArray  # (..., n), N
    airspeed: NDArray  # (..., n), m/s

    @classmethod
    def view(cls, values: NDArray) -> "AircraftState":
        """The parts of an array (..., 4n)."""
        n = values.shape[-1] // 4
        return cls(*(values[..., i * n : (i + 1) * n] for i in range(4)))
