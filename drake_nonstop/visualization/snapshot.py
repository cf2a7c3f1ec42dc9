"""An instant of a run, as a scene shows it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.signals import CarrierStates, Pose


@dataclass(kw_only=True)
class Snapshot:
    """An instant of a run, all in the world frame; quaternions are w x y z, of any norm."""

    time: float  # s
    load_quaternion: NDArray  # (4,)
    load_position: NDArray  # (3,), m
    reference_quaternion: NDArray  # (4,)
    reference_position: NDArray  # (3,), m
    carriers: NDArray  # (n, 3), m
    velocities: NDArray  # (n, 3), m/s
    tensions: NDArray  # (n,), N
    speed_bound: float  # m/s

    @classmethod
    def from_signals(
        cls,
        time: float,
        *,
        load_state: NDArray,
        reference: NDArray,
        carrier_state: NDArray,
        tensions: NDArray,
        speed_bound: float,
    ) -> "Snapshot":
        """The instant at which the loop's signals have these values.

        Args:
            time: in s.
            load_state: (13,).
            reference: (22,).
            carrier_state: (6n,).
            tensions: (n,), N.
            speed_bound: ε in m/s.
        """
        load, desired = Pose.view(load_state), Pose.view(reference)
        carriers = CarrierStates.view(carrier_state)
        return cls(
            time=time,
            load_quaternion=load.quaternion,
            load_position=load.position,
            reference_quaternion=desired.quaternion,
            reference_position=desired.position,
            carriers=carriers.positions,
            velocities=carriers.velocities,
            tensions=tensions,
            speed_bound=speed_bound,
        )

    @property
    def is_finite(self) -> bool:
        """Whether it can be shown: all values are finite, and no quaternion is zero."""
        arrays = (
            self.load_quaternion,
            self.load_position,
            self.reference_quaternion,
            self.reference_position,
            self.carriers,
            self.velocities,
            self.tensions,
        )
        return all(np.isfinite(array).all() for array in arrays) and bool(
            self.load_quaternion.any() and self.reference_quaternion.any()
        )
