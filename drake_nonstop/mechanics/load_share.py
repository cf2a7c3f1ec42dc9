"""What tensions and chords of cables tell of cables and load.

The lengths of the cables and their drag, the load's mass and its centre of mass.

Own derivation.
"""

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.rotation import cross, norm

SHARE_SIZE = 3  # of s: of all cables, and more of it along x and y of L, 1/m


def share_terms(attachments: NDArray) -> NDArray:
    """The matrix (n, 3) of [1, x, y] of attachments (n, 3), m, in L."""
    return np.column_stack([np.ones(len(attachments)), attachments[:, :2]])


def shared_forces(
    forces: NDArray,
    axes: NDArray,
    share: NDArray,
    *,
    attachments: NDArray,
    pseudo_inverse: NDArray,
) -> NDArray:
    """Cable forces (..., n, 3), in W, of a load with another mass and another centre of mass.

    Each force is scaled by 1 + s·[1, x, y], its spread included, so that the cable keeps its
    direction. Internal forces that are scaled unlike are none any more: what the scaled forces'
    wrench has beyond that which moves this load is taken out, by G⁺ as the wrench is shared.

    Args:
        forces: those for the model's load.
        axes: (..., 3, 3), of L in W, as rows.
        share: s (3,).
        attachments: b (n, 3), m, in L.
        pseudo_inverse: G⁺ (3n, 6).
    """
    n = len(attachments)
    factors = 1 + share_terms(attachments) @ share
    heavier, centre = share_of_mass(share, pseudo_inverse, attachments)
    in_load = forces @ axes.swapaxes(-1, -2)
    moved = attachments - centre  # from the centre of mass
    # Of the wrench about the centre of mass; that of the model's load about its own.
    scaled = in_load * factors.reshape(n, 1)
    torque = (cross(moved, scaled) - heavier * cross(attachments, in_load)).sum(axis=-2)
    force = (scaled - heavier * in_load).sum(axis=-2)
    # G⁺ is about the model's centre of mass.
    wrench = np.concatenate([torque + cross(centre + 0 * force, force), force], axis=-1)
    excess = (wrench @ pseudo_inverse.T).reshape(forces.shape)
    found: NDArray = (scaled - excess) @ axes
    return found


def observed_share(
    tensions: NDArray, carried: NDArray, forces: NDArray, attachments: NDArray
) -> NDArray:
    """What is missing in a share s (3,), by least squares over the cables.

    Args:
        tensions: (n,), N, measured at the load.
        carried: (n, 3), N, what cables are believed to pull with.
        forces: (n, 3), N, the same of the model's load.
        attachments: (n, 3), m, in L.
    """
    missing = (tensions - norm(carried)[:, 0]) / norm(forces)[:, 0]
    found: NDArray = np.linalg.pinv(share_terms(attachments)) @ missing
    return found


def observed_lengths(
    tensions: NDArray,
    chords: NDArray,
    carried: NDArray,
    believed_chords: NDArray,
    lengths: NDArray,
    stiffness: NDArray,
) -> tuple[NDArray, NDArray]:
    """What cables are longer than believed by their measured tensions and chords, and their bow.

    Both are (n,), m. A tension T beyond the believed one lengthens a chord c by the stretch 1/K,
    and by taking out bow: a parabola of the length l = L + T/K has a bow l − c in proportion to
    1/T², so that dc/dT = 1/K + 2 (l − c)/T.

    Args:
        tensions: (n,), N, measured at the load.
        chords: (n,), m, measured.
        carried: (n, 3), N, what cables are believed to pull with.
        believed_chords: (n,), m.
        lengths: (n,), L, m, believed.
        stiffness: (n,) or (1,), K, N/m.
    """
    pull = norm(carried)[:, 0]
    bow = lengths + pull / stiffness - believed_chords
    compliance = 1 / stiffness + 2 * bow / pull
    return chords - believed_chords - compliance * (tensions - pull), bow


def observed_drag(longer: NDArray, bow: NDArray, lengths: NDArray) -> NDArray:
    """What is missing in the logarithm of the drag of all cables (1,), by least squares.

    A bow is in proportion to the square of the drag: where the drag is larger than believed by a
    small share d, a cable seems shorter by 2 d times its bow. Lengths and drag are told apart by
    bows that change along an orbit. A bow below a thousandth of the length tells nothing.

    Args:
        longer: (n,), m, what cables are longer than believed.
        bow: (n,), m.
        lengths: (n,), m.
    """
    told = 2 * (bow**2).sum(keepdims=True) + ((1e-3 * lengths) ** 2).sum(keepdims=True)
    found: NDArray = -(longer * bow).sum(keepdims=True) / told
    return found


def share_of_mass(
    share: NDArray, pseudo_inverse: NDArray, attachments: NDArray
) -> tuple[NDArray, NDArray]:
    """A load's mass over the model's (1,), and its centre of mass (3,), m, in L, level, of s (3,).

    Of forces that carry the model's load upright, with vertical parts w_i of its weight, those that
    are scaled carry 1 + s_1 of it, since Σ w_i b_i = 0, with the moment Σ w_i b_i (b_i·s).

    Args:
        share: s.
        pseudo_inverse: G⁺ (3n, 6), of which w follows.
        attachments: b (n, 3), m, in L, from the model's centre of mass.
    """
    level, weights = attachments[:, :2], pseudo_inverse[2::3, 5:]
    heavier = 1 + share[:1]
    centre = level.T @ (weights * level) @ share[1:] / heavier
    return heavier, np.concatenate([centre, 0 * centre[:1]])
