"""Carriers above a moving load, for costs and constraints of the user's own.

All functions take what `carrier_motion` takes: a `Model`, the load's motion (22,) such as its
reference, the wrench on it and the wrench's rate (6,), in W, then ξ in rad/s, A in N, and the phase
θ in rad. They compute with numbers, AutoDiffXd, Expressions and symbols of CasADi alike. For a
phase that is a number, results have the shape (n, ...) of n carriers; for phases (k,) it is
(k, n, ...).
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.planned_orbit import (
    FlightTerms,
    OrbitMotion,
    PlannedOrbit,
    flight_terms,
    orbit_motion,
    pattern_directions,
)
from drake_nonstop.mechanics.rigid_load import STILL_AIR
from drake_nonstop.mechanics.rotation import norm
from drake_nonstop.model.system import Model


def carrier_motion(
    model: Model,
    reference: NDArray,
    wrench: NDArray,
    wrench_rate: NDArray,
    xi: Any,
    amplitude: Any,
    theta: Any,
    wind: NDArray = STILL_AIR,
) -> OrbitMotion:
    """The cables' forces and the carriers' motion through the air, in L, at constant ξ and A.

    `wind` (3,) is that of the air, m/s, in W; it and the wrench's rate are taken as constant.
    """
    angle, pattern = as_vector(theta), model.pattern
    terms = flight_terms(
        *(reference, reference, wrench, wrench_rate, 0 * wrench_rate, wind),
        pseudo_inverse=model.pseudo_inverse,
        offset=pattern.offset,
        attachments=model.attachments,
    )
    motion = orbit_motion(
        FlightTerms(*(part[None] for part in terms)),
        pattern_directions(pattern.basis, pattern.phases, pattern.orders, angle),
        PlannedOrbit.constant(angle, as_vector(xi), as_vector(amplitude)),
        rest_length=model.cable_length,
        compliance=model.cable_compliance,
    )
    return motion if isinstance(theta, np.ndarray) else OrbitMotion(*(part[0] for part in motion))


def carrier_speeds(*arguments: Any, **named: Any) -> NDArray:
    """The carriers' speeds ‖v_i‖ (eq. 22), m/s, through the air."""
    return norm(carrier_motion(*arguments, **named).velocities)[..., 0]


def cable_tensions(*arguments: Any, **named: Any) -> NDArray:
    """The tensions of the cables, N."""
    return norm(carrier_motion(*arguments, **named).forces)[..., 0]


def carrier_distances(model: Model, *arguments: Any, **named: Any) -> NDArray:
    """The distances of carriers, m, in the order of pairs (1, 2), (1, 3) … (n − 1, n)."""
    places = model.attachments + carrier_motion(model, *arguments, **named).cables
    first, second = np.triu_indices(model.n, 1)
    return norm(places[..., first, :] - places[..., second, :])[..., 0]


def as_vector(value: Any) -> NDArray:
    """A number or symbol as an array (1,), an array as one of a single dimension."""
    if isinstance(value, np.ndarray):
        return value.ravel()
    return np.fromiter([value], float if isinstance(value, (int, float)) else object)
