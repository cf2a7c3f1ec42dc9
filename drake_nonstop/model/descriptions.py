"""Descriptions of blocks by themselves, for analyses that do not simulate them.

A block says it by a method, `describe_response()` or `describe_wind()`, which returns one of the
descriptions below. Of a block without the method its response is not known. A block that makes
`wind_estimate` may have `describe_wind_estimate()`, which returns the wind (3,) that it assumes,
m/s, in W; of one without it the estimate is taken for the mean wind at the load.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.bowed_orbit import CableShape
from drake_nonstop.mechanics.signals import TRACKING_ERROR_SIZE
from drake_nonstop.mechanics.wind import risen_share
from drake_nonstop.systems.block import is_of_package

RESPONSE, WIND, WIND_ESTIMATE = "describe_response", "describe_wind", "describe_wind_estimate"


def described(block: Any, method: str = RESPONSE) -> Any:
    """Description of a block by its own method; None: nothing is known.

    What a class of the user's own inherits may not hold for it.
    """
    is_own = is_of_package(block) or method in vars(type(block))
    return getattr(block, method)() if is_own and hasattr(block, method) else None


class CarrierControl(NamedTuple):
    """A `carrier_controller` u = K_p e + K_d ė + K_i ∫e, with the error e of a carrier."""

    position_gain: float  # K_p, N/m
    velocity_gain: float  # K_d, N s/m
    integral_gain: float = 0.0  # K_i, N/(m s)
    has_feedforward: bool = False  # of the references' accelerations
    stiffness: float = math.inf  # N/m, by which carriers give way along their cables


class CarrierMotion(NamedTuple):
    """The `carrier_dynamics` of free points, m_c p̈ = u."""


class CarrierReferences(NamedTuple):
    """The references of a `carrier_trajectory`."""

    # Of their motion within a sample: 1 along the velocity, 3 with accelerations and jerks; 0: they
    # are continuous; None: it is not known.
    hold: int | None
    is_above_load: bool = False  # whether they follow the measured load instead of its reference
    shape: CableShape | None = None  # of cables that bow; None: they are straight


class PseudoInverse(NamedTuple):
    """A `force_distribution` by the pseudo-inverse of the grasp matrix, and the pattern."""


class Estimator(NamedTuple):
    """The errors of a filter of the load's state: d⁺ = (I − K) F d + K (those of its measurement).

    Its predictions are taken as exact, as they are to T²/12 times a change of the acceleration
    where rates are measured exactly. Phases that each stand still would make that change jump.
    """

    gain: NDArray  # K (12, 12)
    transition: NDArray  # F (12, 12)

    @classmethod
    def of(cls, rotation_gain: NDArray, translation_gain: NDArray, period: float) -> "Estimator":
        """That of gains (2, 2) of [pose; rate], which goes on with its rates for a period in s."""
        gain = np.zeros((4, 4))
        gain[::2, ::2], gain[1::2, 1::2] = rotation_gain, translation_gain
        transition = np.eye(4) + period * np.eye(4, k=2)
        return cls(np.kron(gain, np.eye(3)), np.kron(transition, np.eye(3)))


class LoadMeasurement(NamedTuple):
    """Measurement by a `load_feedback` of the errors [e_R, e_p, e_ω, e_v] of the load; SI."""

    is_measured: NDArray = np.ones(TRACKING_ERROR_SIZE)  # 0 for what is taken as desired, else 1
    delay: float = 0.0  # s
    estimator: Estimator | None = None  # behind the measurement


class Wind(NamedTuple):
    """The wind of a block of that box."""

    mean: NDArray = np.zeros(3)  # (3,), m/s, in W, once it has risen
    believed: NDArray | None = None  # (3,), m/s, in W; None: the mean wind at the load
    start: float = 0.0  # s, when it begins to rise
    rise_time: float = 0.0  # s; 0: it comes at once
    gust: float = 0.0  # m/s, standard deviation at a carrier, on a horizontal axis

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


def described_air(blocks: Mapping[str, Any]) -> Wind | None:
    """The wind of a loop's blocks, and what their controllers believe; None: it is not known."""
    air = described(blocks.get("wind"), WIND)
    assumed = described(blocks.get("wind_estimator"), WIND_ESTIMATE)
    return air if air is None else air._replace(believed=assumed)


class TurnRate(NamedTuple):
    """An `optimization_layer` that changes the ξ at which a load turns with its carriers."""

    frequency: float  # rad/s, ξ at the start
    period: float  # s, between updates
    # Returns the next ξ, of a period in s, the last ξ, and the load's reference (22,), wrench (6,),
    # rate of the wrench (6,) and wind (3,).
    updated: Any
