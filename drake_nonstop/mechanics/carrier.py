"""The carriers: their desired motion, their controllers and their dynamics."""

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.cable import beside_vectors, positive_part
from drake_nonstop.mechanics.load_motion import NO_HIGHER_RATES, LoadMotion
from drake_nonstop.mechanics.rotation import norm
from drake_nonstop.mechanics.taylor import Quantity, Taylor


def carrier_positions(
    motion: LoadMotion,
    forces: Quantity,
    *,
    attachments: NDArray,
    rest_length: float | NDArray,
    compliance: float | NDArray,
) -> Taylor:
    """Positions (..., n, 3), in W, of carriers above a load, with their rates (eqs. 1, 22).

    p = p_L + R (b + ℓ q) of cables that pull with f along q = f/T, T = ‖f‖, and are ℓ = L₀ + T/K_c
    long. With 1/K_c = 0 it is that of the paper.

    Args:
        motion: of the load.
        forces: f (..., n, 3), N, in L.
        attachments: b (n, 3), m, in L.
        rest_length: L₀, m, one for all or (n,).
        compliance: 1/K_c, m/N, likewise.
    """
    rest_length, compliance = beside_vectors(rest_length), beside_vectors(compliance)
    cables = (rest_length / norm(forces) + compliance) * forces
    return motion.attached(attachments + cables)


def carrier_motion(
    load_motion: NDArray,
    *forces: NDArray,
    higher_rates: NDArray = NO_HIGHER_RATES,
    attachments: NDArray,
    rest_length: float | NDArray,
    compliance: float | NDArray,
) -> tuple[NDArray, ...]:
    """Positions (n, 3), in W, of carriers that pull with f, and as many rates as forces have.

    Args:
        load_motion: of the load in W, a reference (22,); for positions and velocities a state (13,)
            will do.
        *forces: f (n, 3), N, in W, and up to three of its rates.
        higher_rates: [angular jerk; snap] (6,) of the load.
        attachments: b (n, 3), m, in L.
        rest_length: L₀, m, one for all or (n,).
        compliance: 1/K_c, m/N, likewise.
    """
    if len(forces) > 2:
        motion = LoadMotion.along(load_motion, higher_rates)
    else:
        motion = LoadMotion.of_state(load_motion)
    cables = {"rest_length": rest_length, "compliance": compliance}
    in_load_frame = Taylor.of_rates(*forces) @ motion.axes.T
    return carrier_positions(motion, in_load_frame, attachments=attachments, **cables).rates


def motion_after(motion: NDArray, time: NDArray, *rates: NDArray) -> NDArray:
    """[positions, velocities] (6n,) of carriers a `time` (1,) after `motion` (6n,), SI.

    p + τ v + τ² a/2 + τ³ j/6 and v + τ a + τ² j/2, of the accelerations and jerks (3n,) that are
    given, or of none.
    """
    positions = Taylor.of_rates(*np.split(motion, 2), *rates)
    return np.concatenate([positions.at(time), positions.rate().at(time)])


def pid_forces(
    error: NDArray,
    integral: NDArray,
    *,
    position_gain: float | NDArray,
    velocity_gain: float | NDArray,
    integral_gain: float | NDArray,
) -> NDArray:
    """Forces (3n,) on the carriers, in W, that pull them to their references.

    `error` (6n,) is the reference minus the state, [positions, velocities] in W, `integral`
    (3n,) that of its positions. The forces are linear in both.
    """
    position, velocity = np.split(error, 2)
    return position_gain * position + velocity_gain * velocity + integral_gain * integral


def double_integrator_rate(
    carrier_state: NDArray, forces: NDArray, *, mass: float | NDArray
) -> NDArray:
    """The rate (6n,) of [positions, velocities] of free masses under forces (3n,), in W.

    It is linear in both arguments.
    """
    _, velocities = np.split(carrier_state, 2)
    return np.concatenate([velocities, forces / mass])


def limited_acceleration(acceleration: NDArray, max_acceleration: float | NDArray) -> NDArray:
    """The accelerations (3n,) of n carriers, m/s², each with a norm of `max_acceleration` at most.

    a a_max/√(a_max² + max(‖a‖² − a_max², 0)), which has derivatives at a = 0, too.
    """
    rows, limit = acceleration.reshape(-1, 3), max_acceleration * max_acceleration
    excess = positive_part((rows * rows).sum(axis=-1, keepdims=True) - limit)
    return (rows * max_acceleration / np.sqrt(limit + excess)).ravel()


def limited_carrier_rate(
    states: NDArray,
    acceleration: NDArray,
    pull: NDArray,
    *,
    max_acceleration: float | NDArray,
    lag: float | NDArray,
) -> NDArray:
    """The rate (9n,) of [positions, velocities, own accelerations a] of n carriers, in W.

    v̇ = a + a_e,   ȧ = (sat(a_c) − a)/τ: see `limited_acceleration`. Own derivation.

    Args:
        states: (9n,), m, m/s and m/s².
        acceleration: a_c (3n,), m/s², that is commanded.
        pull: a_e (3n,), m/s², by weight and cable.
        max_acceleration: the limit of ‖a‖, m/s².
        lag: τ, s.
    """
    _, velocities, own = np.split(states, 3)
    limited = limited_acceleration(acceleration, max_acceleration)
    return np.concatenate([velocities, own + pull, (limited - own) / lag])
