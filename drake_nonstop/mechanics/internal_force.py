"""Internal cable forces: patterns in the null space of the grasp matrix (eqs. 9, 23).

A pattern is a constant matrix N₀ (3n, m), m phases φ, m orders h and a constant offset f̃⁰ (3n,),
all in L, with G₀ N₀ = 0 and G₀ f̃⁰ = 0. The internal cable forces are f̃⁰ + N₀ λ with
λ_k = A cos(h_k θ + φ_k); the orders are 1 in the paper.
"""

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.grasp import grasp_matrix
from drake_nonstop.mechanics.signals import Parameters, PlannedParameters


def hamiltonian_cycle(attachments: NDArray) -> NDArray:
    """N₀ (3n, n): pairs of opposite unit forces along the cycle 1 → 2 → … → n → 1.

    Column k pushes attachments k and k + 1 apart along the edge between them,
    u_k = (b_k − b_{k+1}) / ‖·‖ in L, so a positive λ spreads the carriers and every
    cable feels two λ's only. The basis of the authors' companion papers.
    """
    n = len(attachments)
    edges = attachments - np.roll(attachments, -1, axis=0)
    units = edges / np.sqrt((edges * edges).sum(axis=1, keepdims=True))
    signs = np.eye(n) - np.roll(np.eye(n), 1, axis=0)  # of column k at cable i
    return (signs[:, None, :] * units.T[None]).reshape(3 * n, n)


def carousel(attachments: NDArray) -> NDArray:
    """Horizontal forces (3n, 2) that rotate together, without a wrench on the load.

    For attachments (n, 3) at the angles β_i about the load's vertical, columns for the phases 0
    and −π/2 of (cos(θ − β_i), sin(θ − β_i), 0). On a regular polygon they have no wrench; for
    other attachments they are projected on the null space of the grasp matrix.
    """
    x, y = _outward(attachments)
    zero = 0 * x
    columns = (np.stack([x, -y, zero], axis=1), np.stack([y, x, zero], axis=1))
    return without_wrench(attachments, np.stack([column.ravel() for column in columns], axis=1))


def elliptic_carousel(
    attachments: NDArray,
    *,
    phase_turns: int,
    radial: float,
    tangential: float,
    vertical: float,
    second_harmonic: float,
    second_harmonic_direction: float,
) -> NDArray:
    """Forces (3n, 4) whose ends move on ellipses, and a second harmonic of the horizontal ones.

    For attachments (n, 3) at the angles β_i about the load's vertical, with the outward r_i, the
    tangential t_i = e₃ × r_i and φ_i = θ + κ β_i, κ = `phase_turns`, columns for the phases 0 and
    −π/2 of the first order, and then of the second, of

        a_r cos φ_i r_i + a_t sin φ_i t_i − b cos φ_i e₃ + h (cos χ_i, sin χ_i, 0),
        χ_i = 2 (φ_i + β_i) + π/2 − direction.

    The second harmonic makes the flight in its direction (rad, from x to y in L) the fastest, and
    the flight against it the slowest. Not projected: see `without_wrench`, which leaves them as
    they are where κ suits the number of attachments of a regular polygon.
    """
    x, y = _outward(attachments)
    angles = np.arctan2(y, x)
    zero = 0 * x
    outward, onward = np.stack([x, y, zero], axis=1), np.stack([-y, x, zero], axis=1)
    upward = np.stack([zero, zero, zero + 1], axis=1)
    cosine, sine = (f(phase_turns * angles)[:, None] for f in (np.cos, np.sin))
    along = radial * outward - vertical * upward
    turns = 2 * (phase_turns + 1) * angles + np.pi / 2 - second_harmonic_direction
    x, y = second_harmonic * np.cos(turns), second_harmonic * np.sin(turns)
    columns = [
        cosine * along + tangential * sine * onward,
        -sine * along + tangential * cosine * onward,
        np.stack([x, y, zero], axis=1),
        np.stack([-y, x, zero], axis=1),
    ]
    return np.stack([column.ravel() for column in columns], axis=1)


def spread(attachments: NDArray) -> NDArray:
    """Outward forces (3n,) of about 1 N each, (cos β_i, sin β_i, 0), projected likewise."""
    x, y = _outward(attachments)
    outward = np.stack([x, y, 0 * x], axis=1)
    return without_wrench(attachments, outward.reshape(-1, 1))[:, 0]


def _outward(attachments: NDArray) -> tuple[NDArray, NDArray]:
    """The cosines and sines (n,) of the angles β_i of attachments (n, 3), about the mean of all."""
    from_centre = attachments - attachments.sum(axis=0) / len(attachments)
    radius = np.sqrt((from_centre[:, :2] * from_centre[:, :2]).sum(axis=1))
    return from_centre[:, 0] / radius, from_centre[:, 1] / radius


def without_wrench(attachments: NDArray, forces: NDArray) -> NDArray:
    """The part of forces (3n, m) in the null space of the grasp matrix."""
    grasp = grasp_matrix(attachments)
    return forces - np.linalg.pinv(grasp) @ (grasp @ forces)


def even_phases(count: int) -> NDArray:
    """φ_k = 2π (k − 1) / count: constant carrier speed over a resting regular polygon."""
    return 2 * np.pi * np.arange(count) / count


def internal_force(
    parameters: NDArray, phase: NDArray, *, phases: NDArray, orders: float | NDArray = 1
) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """λ, λ̇, λ̈ and λ⃛ (..., m) each, of `parameters` [ξ, A] (..., 2) at the phase θ (..., 1), rad.

    λ_k = A cos(h_k θ + φ_k) (eq. 23), with the orders h (m,) of the harmonics, and its rates for
    constant ξ and A.
    """
    frequency, amplitude = Parameters.view(parameters)
    zero = np.zeros(1)
    plan = PlannedParameters(phase, frequency, amplitude, zero, zero, zero, zero, zero)
    return planned_internal_force(plan, phases=phases, orders=orders)


def planned_internal_force(
    plan: PlannedParameters, *, phases: NDArray, orders: float | NDArray = 1
) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """λ, λ̇, λ̈ and λ⃛ (..., m) each, of ξ and A that change.

    With φ = h θ + φ_k, ω = h ξ and the orders h (m,) of the harmonics,

        λ̇ = Ȧ cos φ − A ω sin φ,
        λ̈ = (Ä − A ω²) cos φ − (2 Ȧ ω + A ω̇) sin φ,
        λ⃛ = (A⃛ − 3 Ȧ ω² − 3 A ω ω̇) cos φ − (3 Ä ω + 3 Ȧ ω̇ + A ω̈ − A ω³) sin φ.

    Own derivation.
    """
    angles = orders * plan.angle + phases
    cosine, sine = np.cos(angles), np.sin(angles)
    speed, speed_rate = orders * plan.frequency, orders * plan.frequency_rate
    speed_second_rate = orders * plan.frequency_second_rate
    size, rate, second = plan.amplitude, plan.amplitude_rate, plan.amplitude_second_rate
    squared = speed * speed
    return (
        size * cosine,
        rate * cosine - size * speed * sine,
        (second - size * squared) * cosine - (2 * rate * speed + size * speed_rate) * sine,
        (plan.amplitude_third_rate - 3 * rate * squared - 3 * size * speed * speed_rate) * cosine
        - (
            3 * second * speed
            + 3 * rate * speed_rate
            + size * speed_second_rate
            - size * squared * speed
        )
        * sine,
    )


def orbit_axes(basis: NDArray, phases: NDArray) -> tuple[NDArray, NDArray]:
    """The axes p and q (n, 3), in L, of the forces N₀ λ = A (p cos hθ + q sin hθ).

    They are conjugate axes of the ellipse along which each cable's force moves, for columns of one
    order h; where they are parallel the ellipse is a line, and that carrier stops twice a turn.
    """
    return (
        (basis @ np.cos(phases)).reshape(-1, 3),
        -(basis @ np.sin(phases)).reshape(-1, 3),
    )
