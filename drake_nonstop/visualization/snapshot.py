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
    # Where the carriers are aircraft, see `Scene`; None: unknown.
    aircraft_state: NDArray | None = None  # (4n,)
    wind: NDArray | None = None  # (n, 3), m/s, at the carriers
    load_wind: NDArray | None = None  # (3,), m/s

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
        aircraft_state: NDArray | None = None,
        wind: NDArray | None = None,
        load_wind: NDArray | None = None,
    ) -> "Snapshot":
        """The instant at which the loop's signals have these values.

        Args:
            time: in s.
            load_state: (13,).
            reference: (22,).
            carrier_state: (6n,).
            tensions: (n,), N.
            speed_bound: ε in m/s.
            aircraft_state: (4n,), of aircraft.
            wind: (3n,), m/s, at the carriers.
            load_wind: (3,), m/s, at the load.
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
            aircraft_state=aircraft_state,
            wind=None if wind is None else wind.reshape(-1, 3),
            load_wind=load_wind,
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
            self.aircraft_state,
            self.wind,
            self.load_wind,
        )
        given = (array for array in arrays if array is not None)
        return all(np.isfinite(array).all() for array in given) and bool(
            self.load_quaternion.any() and self.reference_quaternion.any()
        )
