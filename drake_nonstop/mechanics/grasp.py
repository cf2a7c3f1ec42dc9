"""The grasp matrix and the distribution of a load wrench over the cables (eqs. 7-9), with rates.

The paper stacks a wrench as [force; torque]; Drake, and every array here, stacks it as
[torque; force]. Only `grasp_matrix` exchanges the two.
"""

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.load_motion import LoadMotion, in_axes, torque_and_force
from drake_nonstop.mechanics.rigid_load import STILL_AIR, RigidLoad
from drake_nonstop.mechanics.rotation import skew
from drake_nonstop.mechanics.signals import InternalForce, InternalForceHigherRates, Wrench
from drake_nonstop.mechanics.taylor import Quantity, Taylor


def grasp_matrix(attachments: NDArray) -> NDArray:
    """G₀ (6, 3n) in L: stacked cable forces (3n,) to the wrench [torque; force] (6,).

    Eq. 8 with R = I and its two row blocks exchanged; `attachments` (n, 3) are the b_i
    in L. In the load frame the matrix is constant, so that neither its pseudo-inverse
    nor its null space has to be differentiated along the motion.
    """
    return np.concatenate(
        [
            np.concatenate([skew(b) for b in attachments], axis=1),
            np.concatenate([np.eye(3)] * len(attachments), axis=1),
        ]
    )


def cable_forces(
    wrench: Quantity,
    internal_force: Quantity,
    *,
    pseudo_inverse: NDArray,
    basis: NDArray,
    offset: NDArray | float,
) -> Quantity:
    """Cable forces (..., n, 3), in L, of a wrench (..., 6) in L and of λ (..., m) (eq. 9).

    ᴸf = G₀† ᴸw + f̃⁰ + N₀ λ. All constants are those of L: `pseudo_inverse` (3n, 6), `basis` N₀
    (3n, m) and `offset` f̃⁰ (3n,). So ᴸf has the rates of ᴸw and λ, and f_i = R ᴸf_i those of the
    paper, Ġ†w + G†ẇ + Ṅλ + Nλ̇. Own derivation.
    """
    stacked = wrench @ pseudo_inverse.T + internal_force @ basis.T + offset
    return stacked.reshape(*stacked.shape[:-1], -1, 3)


def cable_forces_and_rates(
    load_state: NDArray,
    wrench: NDArray,
    wrench_rate: NDArray,
    internal_force: NDArray,
    *,
    pseudo_inverse: NDArray,
    basis: NDArray,
    offset: NDArray,
) -> tuple[NDArray, NDArray]:
    """Desired cable forces f and their rates ḟ, each (n, 3) in W (eqs. 9, 16, 19-21).

    `load_state` (13,), `wrench` and `wrench_rate` (6,) are in W, `internal_force` (2m,)
    is [λ; λ̇]; others as of `cable_forces`.
    """
    axes = LoadMotion.of_state(load_state).axes
    parts = zip(*map(Wrench.view, (wrench, wrench_rate)), strict=True)  # torques, then forces
    wrench_L = np.concatenate([in_axes(Taylor(part), axes) for part in parts])
    constants = {"pseudo_inverse": pseudo_inverse, "basis": basis, "offset": offset}
    forces = cable_forces(wrench_L, Taylor(InternalForce.view(internal_force)), **constants)
    values, rates = (forces @ axes).rates
    return values, rates


def forces_along(
    load: RigidLoad,
    motion: LoadMotion,
    forces: NDArray,
    rates: NDArray,
    internal_force_higher_rates: NDArray,
    wind: NDArray = STILL_AIR,
    *,
    pseudo_inverse: NDArray,
    basis: NDArray,
) -> Taylor:
    """The desired cable forces (n, 3), in L, with three rates, on a load along its reference.

    Its second and third rates are those of the wrench that moves the load along its reference, and
    of λ. The second and third rates of what the feedback adds to the wrench are taken as zero.

    Args:
        load: the controllers' model.
        motion: of the load along its reference.
        forces: f (n, 3), N, in W, and the next their rates.
        rates: ḟ (n, 3), N/s.
        internal_force_higher_rates: [λ̈; λ⃛] (2m,).
        wind: (3,), m/s, in W, steady.
        pseudo_inverse: (3n, 6), in L.
        basis: N₀ (3n, m), in L.
    """
    now, first = (Taylor([forces, rates]) @ motion.axes.T).rates
    second, third = InternalForceHigherRates.view(internal_force_higher_rates)
    unknown = 0 * second
    torque, force = torque_and_force(load, motion, wind)
    along = cable_forces(
        np.concatenate([torque, in_axes(force, motion.axes)]),
        Taylor.of_rates(unknown, unknown, second, third),
        pseudo_inverse=pseudo_inverse,
        basis=basis,
        offset=0.0,
    )
    return Taylor.of_rates(now, first, *along.rates[2:])
