"""The load's reference to come, and one whose motion has a time of its own."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from drake_nonstop.mechanics.load_motion import NO_HIGHER_RATES
from drake_nonstop.mechanics.rotation import rotate_quaternion, rotation_matrix
from drake_nonstop.mechanics.signals import LOAD_REFERENCE_SIZE, LoadReference, ReferenceHigherRates
from drake_nonstop.mechanics.taylor import Taylor

FADE_TIME = 0.5  # s, in which the accelerations of `continued_reference` fade


@dataclass(frozen=True, eq=False)
class ReferencePreview:
    """The reference at later times, the value of the signal `reference_preview`.

    It holds no state and is not copied with a context: any thread may call it at any time.

    Attributes:
        reference: returns the reference (22,) at an absolute time in s, as the signal
            `reference` has it then.
        end_time: s, until which the reference is known; inf: for ever.
        references: returns the references (k, 22) at times (k,), if this is faster than k calls.
        higher_rates: returns the signal `reference_higher_rates` (6,) at a time, where it is known.
    """

    reference: Callable[[float], NDArray]
    end_time: float = math.inf
    references: Callable[[NDArray], NDArray] | None = None
    higher_rates: Callable[[float], NDArray] | None = None

    def __call__(self, time: float) -> NDArray:
        """The reference (22,) at an absolute time in s, at most `end_time`."""
        return self.reference(time)

    def at(self, times: ArrayLike) -> NDArray:
        """The references (k, 22) at absolute times (k,) in s."""
        times = np.asarray(times, dtype=float)
        if self.references is not None:
            return self.references(times)
        rows = [self.reference(time) for time in times.tolist()]
        return np.array(rows).reshape(-1, LOAD_REFERENCE_SIZE)

    def __deepcopy__(self, memo: dict) -> "ReferencePreview":
        """Itself: nothing in it changes. Drake copies what contexts and ports hold."""
        return self


def continued_reference(reference: NDArray, time: ArrayLike) -> NDArray:
    """How a reference goes on where nothing is known of it: velocity and turn rate stay.

    At 0 it is the reference itself, with its accelerations and its jerk. These fade with the time
    constant T = `FADE_TIME`, and so does what they add to the velocities:

        v = v₀ + (a₀ t + (j₀/2 + a₀/T) t²) e^(−t/T),
        R = exp(S(ω̇₀ g)) exp(S(ω₀ t)) R₀,   ġ = t e^(−t/T),   g(0) = 0,

    so that v → v₀ and |ω| → |ω₀|. Position, acceleration, jerk, ω and ω̇ are exactly those of this
    motion. Own derivation.

    Args:
        reference: (22,), the present one.
        time: s from it on, (...,).

    Returns:
        The references (..., 22).
    """
    t = np.asarray(time, dtype=float)[..., None]
    now = LoadReference.view(reference)
    T = FADE_TIME
    x = t / T
    fade = np.exp(-x)
    a, b = now.acceleration, now.jerk / 2 + now.acceleration / T
    # ∫ t e^(−t/T) and ∫ t² e^(−t/T)
    first = T**2 * (1 - (1 + x) * fade)
    second = T**3 * (2 - (2 + 2 * x + x * x) * fade)
    turn = now.angular_acceleration * first
    turn_rate = now.angular_acceleration * (t * fade)
    upright = np.broadcast_to(np.eye(4)[0], (*turn.shape[:-1], 4))
    matrix = rotation_matrix(rotate_quaternion(upright, turn))
    angular_velocity = np.einsum("...ij,j->...i", matrix, now.angular_velocity)
    start = np.broadcast_to(now.quaternion, (*turn.shape[:-1], 4))
    parts = LoadReference(
        quaternion=rotate_quaternion(rotate_quaternion(start, now.angular_velocity * t), turn),
        position=now.position + now.velocity * t + a * first + b * second,
        angular_velocity=turn_rate + angular_velocity,
        velocity=now.velocity + (a * t + b * t * t) * fade,
        angular_acceleration=(
            now.angular_acceleration * ((1 - x) * fade) + np.cross(turn_rate, angular_velocity)
        ),
        acceleration=(a * (1 - x) + b * (2 * t - t * x)) * fade,
        jerk=(a * (x - 2) / T + b * (2 - 4 * x + x * x)) * fade,
    )
    return np.concatenate(parts, axis=-1)


def stretched(reference: NDArray, rates: NDArray) -> NDArray:
    """The reference (..., 22) in a time s that passes at other rates: p(s(t)) and R(s(t)).

    Args:
        reference: (..., 22), at s.
        rates: ṡ, s̈ (1/s) and s⃛ (1/s²), and more, (..., 3 or more).
    """
    now = LoadReference.view(reference)
    position, spin = _stretched(reference, NO_HIGHER_RATES, rates[..., :3])
    place, velocity, acceleration, jerk = position.rates
    moved = LoadReference(now.quaternion, place, spin[0], velocity, spin[1], acceleration, jerk)
    return np.concatenate(moved, axis=-1)


def stretched_higher_rates(reference: NDArray, higher_rates: NDArray, rates: NDArray) -> NDArray:
    """The higher rates (..., 6) of a `stretched` reference.

    Args:
        reference: (..., 22), at s.
        higher_rates: (..., 6), a `ReferenceHigherRates` at s.
        rates: ṡ, s̈ (1/s), s⃛ (1/s²), s⁗ (1/s³), (..., 4).
    """
    position, spin = _stretched(reference, higher_rates, rates)
    return np.concatenate([spin[2], position.rates[4]], axis=-1)


def _stretched(
    reference: NDArray, higher_rates: NDArray, rates: NDArray
) -> tuple[Taylor, tuple[NDArray, ...]]:
    """Series of the position, and the angular velocity with its rates, ω = ω(s) ṡ, (..., 3)."""
    now, higher = LoadReference.view(reference), ReferenceHigherRates.view(higher_rates)
    position = Taylor.of_rates(now.position, now.velocity, now.acceleration, now.jerk, higher.snap)
    spin = Taylor.of_rates(now.angular_velocity, now.angular_acceleration, higher.angular_jerk)
    passed = Taylor.of_rates(0 * rates[..., :1], *np.split(rates, rates.shape[-1], axis=-1))
    return position.at(passed), (spin.at(passed) * passed.rate()).rates
