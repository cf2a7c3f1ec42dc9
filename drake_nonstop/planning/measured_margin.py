"""The margin above the speed bound that follows from how carriers flew beside their plan."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.bowed_orbit import CableShape, bowed_motion
from drake_nonstop.mechanics.cable import positive_part
from drake_nonstop.mechanics.load_motion import LoadMotion
from drake_nonstop.mechanics.planned_orbit import FlightTerms, OrbitMotion, orbit_motion
from drake_nonstop.mechanics.rigid_load import RigidLoad
from drake_nonstop.mechanics.rotation import norm
from drake_nonstop.mechanics.signals import PlannedParameters
from drake_nonstop.model.pattern import InternalForcePattern
from drake_nonstop.systems.tracing import where

MEASURED = "measured"  # in the place of a number
FIRST_SHARE = 0.02  # of ε, the least margin and that of the first plan
LARGEST_SHARE = 2.0  # of ε
_STEP = 0.02  # of ε
_DOWN = 1.5  # steps, by which less has to be needed before a margin falls by one
_DECAY = 20.0  # s, of what was measured
_RESERVE = 1.25  # times what was measured: the next deviation may be larger
PLANS_OF_RISE = 3  # one from each knot on, in which a share that has risen is reached
_LEAST = 1e-12  # m²/s⁴, beside a square that may vanish

# The deviation that was measured, m/s; the share of ε that follows; and the one that plans reach.
NOTHING_MEASURED = np.array([0.0, FIRST_SHARE, FIRST_SHARE])


def margin_after(
    margin: NDArray, deviations: NDArray, speed_bound: NDArray, period: Any
) -> NDArray:
    """The margin (3,) after a sample, of any scalar type, without branches.

    With the period T and τ = 20 s, the measured deviation is m⁺ = max(d, m exp(−T/τ)). The share of
    ε that plans keep follows 5/4 m in steps of 2 %, up at once, and down where it is one and a half
    of them too large.

    Args:
        margin: of `NOTHING_MEASURED`.
        deviations: d (n,), m/s, of the carriers.
        speed_bound: ε (1,), m/s.
        period: s, from sample to sample.
    """
    measured, share = margin[:1] * np.exp(-period / _DECAY), margin[1:2]
    for i in range(len(deviations)):
        measured = measured + positive_part(deviations[i : i + 1] - measured)
    needed, step = (_RESERVE * measured - share * speed_bound)[0], _STEP * speed_bound[0]
    fallen = where(share[0] > FIRST_SHARE + _STEP / 2, share - _STEP, share)
    risen = where(share[0] < LARGEST_SHARE - _STEP / 2, share + _STEP, share)
    after = where(needed > 0, risen, where(needed < -_DOWN * step, fallen, share))
    return np.concatenate([measured, after, margin[2:]])


def margin_at_next_plan(margin: NDArray) -> NDArray:
    """The margin (3,), whose last entry has come nearer to the share that plans rise to."""
    measured, share, reached = margin
    return np.array([measured, share, min(share, reached + (share - reached) / PLANS_OF_RISE)])


def deviations_of(motion: OrbitMotion, velocities: NDArray) -> NDArray:
    """How far velocities (n, 3) are from planned ones, across the accelerations, (n,), m/s.

    A carrier is at most so much slower than planned, now or where it flies in another direction.
    What is along its acceleration is what it lags behind its path, at the same speed.

    Args:
        motion: planned, at one instant.
        velocities: of the carriers, in W.
    """
    off, along = motion.velocities[0] - velocities, motion.accelerations[0]
    square = (along * along).sum(axis=-1, keepdims=True)
    lag = (off * along).sum(axis=-1, keepdims=True) / (square + _LEAST)
    found: NDArray = norm(off - lag * along)[..., 0]
    return found


def planned_motion(
    load: RigidLoad,
    reference: NDArray,
    planned: NDArray,
    wind: NDArray,
    *,
    pattern: InternalForcePattern,
    shape: CableShape | None,
    pseudo_inverse: NDArray,
    offset: NDArray,
    **ends: NDArray,
) -> OrbitMotion:
    """The motion of carriers above a load on its reference, at one instant.

    Args:
        load: what the controllers believe.
        reference: (22,), of the load.
        planned: (8,), `PlannedParameters`.
        wind: (3,), m/s, in W.
        pattern: of the cables' forces.
        shape: of cables that bow; None: they are straight.
        pseudo_inverse: (3n, 6), in L.
        offset: (3n,), N, in L, of the pattern.
        **ends: the `attachments` (n, 3), m, in L, and the cables' `rest_length`, m, and
            `compliance`, m/N.
    """
    motion = LoadMotion.along(reference[None])
    terms = FlightTerms.along(load, motion, wind, pseudo_inverse=pseudo_inverse, offset=offset)
    if shape is None:
        forces = pattern.forces(*PlannedParameters.view(planned[None]).series)
        return orbit_motion(terms, forces, **ends)
    shape = shape.of_length(ends["rest_length"], ends["compliance"])
    bowed = bowed_motion(
        terms, pattern.forces, planned[None], shape, wind, attachments=ends["attachments"]
    )
    return bowed.motion
