"""The motion of a load as a series in time, and the wrench that moves it so."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.rigid_load import STILL_AIR, RigidLoad
from drake_nonstop.mechanics.rotation import cross, rotate_quaternion, rotation_matrix
from drake_nonstop.mechanics.signals import (
    REFERENCE_HIGHER_RATES_SIZE,
    LoadReference,
    LoadState,
    ReferenceHigherRates,
)
from drake_nonstop.mechanics.taylor import Quantity, Taylor, turned

_UNTURNED = np.array([1.0, 0.0, 0.0, 0.0])
NO_HIGHER_RATES = np.zeros(REFERENCE_HIGHER_RATES_SIZE)


class LoadMotion(NamedTuple):
    """Series of a load's pose, and of its angular velocity."""

    position: Quantity  # (..., 3), m, in W
    axes: Quantity  # (..., 3, 3), R_LW: L's axes in W, one in each row
    spin: Quantity  # (..., 3), ω, rad/s, in W

    @classmethod
    def of_state(cls, load_state: NDArray) -> "LoadMotion":
        """The motion of a state (..., 13): pose and twist."""
        state = LoadState.view(load_state)
        return cls.of(state.quaternion, Taylor(state[1::2]), Taylor([state.angular_velocity]))

    @classmethod
    def along(cls, reference: NDArray, higher_rates: NDArray = NO_HIGHER_RATES) -> "LoadMotion":
        """The motion along a reference (..., 22) with its higher rates (..., 6).

        The rates of its snap and of its angular jerk, in W, are taken as zero.
        """
        desired, higher = LoadReference.view(reference), ReferenceHigherRates.view(higher_rates)
        zero = 0 * desired.jerk
        position = desired.position, desired.velocity, desired.acceleration, desired.jerk
        spin = desired.angular_velocity, desired.angular_acceleration, zero + higher.angular_jerk
        return cls.of(
            desired.quaternion,
            Taylor.of_rates(*position, zero + higher.snap, zero),
            Taylor.of_rates(*spin, zero, zero),
        )

    @classmethod
    def of(cls, quaternion: NDArray, position: Taylor, spin: Taylor) -> "LoadMotion":
        """The motion from a quaternion (..., 4), w x y z, on, of series in W."""
        R_LW = rotation_matrix(quaternion).swapaxes(-1, -2)
        return cls(position, turned(R_LW, spin), spin)

    @property
    def angular_velocity(self) -> Taylor:
        """Angular velocity (..., 3), rad/s, in L: its rate is R_LW ω̇, without a term of ω × ω."""
        start = in_axes(self.spin.coefficients[0], self.axes.coefficients[0])
        series: Taylor = in_axes(self.spin.rate(), self.axes).integral(start)
        return series

    def over(self, times: NDArray) -> "LoadMotion":
        """The motion at times (k,), s, from the present on: arrays (k, ...) in place of series."""
        omega, alpha, jerk = self.spin.rates[:3]
        # Magnus' series, of which the commutator is of third order in time.
        rates = 0 * omega, omega, alpha, jerk + cross(alpha, omega) / 2
        turn = rotation_matrix(rotate_quaternion(_UNTURNED, Taylor.of_rates(*rates).over(times)))
        axes = self.axes.coefficients[0] @ turn.swapaxes(-1, -2)
        return LoadMotion(self.position.over(times), axes, self.spin.over(times))

    def attached(self, points: Quantity) -> Quantity:
        """Where points (..., n, 3), m, in L, are in W."""
        return self.position[..., None, :] + points @ self.axes


def in_axes(vector: Quantity, axes: Quantity) -> Quantity:
    """Components (..., 3) of a vector along axes, which are the rows of (..., 3, 3)."""
    return (axes @ vector[..., None])[..., 0]


def torque_and_force(
    load: RigidLoad, motion: LoadMotion, wind: NDArray = STILL_AIR
) -> tuple[Taylor, Taylor]:
    """The torque, in L, and the force, in W, (..., 3) each, that move a load so in a steady wind.

    J ω̇ + ω × J ω + C_L ω and m (p̈ + g e₃) + B_L (ṗ − w), with the wind w (..., 3), m/s, in W.
    """
    omega: Quantity = motion.angular_velocity
    velocity = motion.position.rate()
    momentum = omega @ load.inertia.T
    torque = momentum.rate() + cross(omega, momentum) + load.angular_drag * omega
    weight = load.mass * load.gravity * np.array([0.0, 0.0, 1.0])
    force = load.mass * velocity.rate() + weight + load.drag * (velocity - wind)
    return torque, force
