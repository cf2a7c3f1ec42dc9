"""Internal cable forces: patterns in the null space of the grasp matrix (eqs. 9, 23).

A pattern is a constant matrix N₀ (3n, m), m phases φ and a constant offset f̃⁰ (3n,), all in L,
with G₀ N₀ = 0 and G₀ f̃⁰ = 0. The internal cable forces are f̃⁰ + N₀ λ, λ_k = A cos(θ + φ_k).
"""

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.grasp import grasp_matrix
from drake_nonstop.mechanics.signals import Parameters
from drake_nonstop.mechanics.taylor import Quantity, Taylor


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


def elliptic_carousel(
    attachments: NDArray,
    *,
    phase_turns: int,
    radial: float,
    tangential: float,
    vertical: float,
) -> NDArray:
    """Forces (3n, 2) whose ends move on ellipses.

    For attachments (n, 3) at the angles β_i about the load's vertical, with the outward r_i, the
    tangential t_i = e₃ × r_i and φ_i = θ + κ β_i, κ = `phase_turns`, columns for the phases 0 and
    −π/2 of

        a_r cos φ_i r_i + a_t sin φ_i t_i − b cos φ_i e₃.

    Not projected: see `without_wrench`, which leaves them as they are where κ suits the number of
    attachments of a regular polygon.
    """
    x, y = _outward(attachments)
    angles = np.arctan2(y, x)
    zero = 0 * x
    outward, onward = np.stack([x, y, zero], axis=1), np.stack([-y, x, zero], axis=1)
    upward = np.stack([zero, zero, zero + 1], axis=1)
    cosine, sine = (f(phase_turns * angles)[:, None] for f in (np.cos, np.sin))
    along = radial * outward - vertical * upward
    columns = [
        cosine * along + tangential * sine * onward,
        -sine * along + tangential * cosine * onward,
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


def harmonics(angle: Quantity, amplitude: Quantity, *, phases: NDArray) -> Quantity:
    """λ_k = A cos(θ + φ_k) (..., m), N, of θ in rad and A in N, (..., 1) each (eq. 23)."""
    return amplitude * np.cos(angle + phases)


def internal_force(parameters: NDArray, phase: NDArray, *, phases: NDArray) -> tuple[NDArray, ...]:
    """λ, λ̇, λ̈ and λ⃛ (..., m) each, of constant `parameters` [ξ, A] (..., 2) at θ (..., 1), rad."""
    frequency, amplitude = Parameters.view(parameters)
    angle = Taylor([phase, frequency, 0 * frequency, 0 * frequency])
    rates: tuple[NDArray, ...] = harmonics(angle, amplitude, phases=phases).rates
    return rates


def orbit_forces(axes: tuple[NDArray, NDArray], angle: Quantity, amplitude: Quantity) -> Quantity:
    """The forces N₀ λ = A (p cos θ + q sin θ) (..., n, 3), N, in L, by the axes of `orbit_axes`.

    Of θ in rad and A in N, (..., 1) each.
    """
    (p, q), angle = axes, angle[..., None]
    return amplitude[..., None] * (np.cos(angle) * p + np.sin(angle) * q)


def orbit_axes(basis: NDArray, phases: NDArray) -> tuple[NDArray, NDArray]:
    """The axes p and q (n, 3), in L, of the forces N₀ λ = A (p cos θ + q sin θ).

    They are conjugate axes of the ellipse along which each cable's force moves; where they are
    parallel the ellipse is a line, and that carrier stops twice a turn.
    """
    return (
        (basis @ np.cos(phases)).reshape(-1, 3),
        -(basis @ np.sin(phases)).reshape(-1, 3),
    )
