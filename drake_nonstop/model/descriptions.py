"""Descriptions of blocks by themselves, for analyses that do not simulate them.

A block says it by a method, `describe_response()` or `describe_wind()`, which returns one of the
descriptions below. Of a block without the method its response is not known.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.bowed_orbit import CableShape
from drake_nonstop.mechanics.signals import TRACKING_ERROR_SIZE
from drake_nonstop.mechanics.wind import risen_share
from drake_nonstop.systems.block import is_of_package

RESPONSE, WIND = "describe_response", "describe_wind"


def described(block: Any, method: str = RESPONSE) -> Any:
    """Description of a block by its own method; None: nothing is known.

    What a class of the user's own inherits may not hold for it.
    """
    is_own = is_of_package(block) or method in vars(type(block))
    return getattr(block, method)() if is_own and hasattr(block, method) else None


class CarrierReferences(NamedTuple):
    """The references of a `carrier_trajectory`."""

    # Of their motion within a sample: 1 along the velocity, 3 with accelerations and jerks; 0: they
    # are continuous; None: it is not known.
    hold: int | None
    is_above_load: bool = False  # whether they follow the measured load instead of its reference
    shape: CableShape | None = None  # of cables that bow; None: they are straight


class LoadMeasurement(NamedTuple):
    """Measurement by a `load_feedback` of the errors [e_R, e_p, e_ω, e_v] of the load; SI."""

    is_measured: NDArray = np.ones(TRACKING_ERROR_SIZE)  # 0 for what is taken as desired, else 1


class Wind(NamedTuple):
    """The wind of a block of that box."""

    mean: NDArray = np.zeros(3)  # (3,), m/s, in W, once it has risen
    start: float = 0.0  # s, when it begins to rise
    rise_time: float = 0.0  # s; 0: it comes at once

    @property
    def is_constant(self) -> bool:
        """Whether the mean wind is there from the beginning on."""
        return self.start == 0 == self.rise_time

    def at(self, time: float) -> NDArray:
        """The mean wind (3,) at a time in s; m/s, in W."""
        now, share = np.array([time]), np.array([float(time >= self.start)])
        if self.rise_time > 0:
            share = risen_share(now, start=self.start, rise_time=self.rise_time)
        return share * self.mean
