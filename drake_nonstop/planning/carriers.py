"""Carriers above a moving load, for costs and constraints of a program, such as `NlpLayer`'s.

All functions take what `carrier_motion` takes: a `Model`, the load's motion (22,) such as its
reference, the wrench on it and the wrench's rate (6,), in W, then ξ in rad/s, A in N, and the phase
θ in rad. They compute with numbers, AutoDiffXd, Expressions and symbols of CasADi alike. For a
phase that is a number, results have the shape (n, ...) of n carriers; for phases (k,) it is
(k, n, ...).
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from drake_nonstop.mechanics.load_motion import LoadMotion
from drake_nonstop.mechanics.planned_orbit import (
    FlightTerms,
    OrbitMotion,
    flight_terms,
    needs_of_motion,
    orbit_motion,
    squared_gaps,
)
from drake_nonstop.mechanics.rigid_load import STILL_AIR, RigidLoad
from drake_nonstop.mechanics.rotation import norm
from drake_nonstop.mechanics.signals import PlannedParameters, constant_plan
from drake_nonstop.model.block import required_aircraft
from drake_nonstop.model.system import Model
from drake_nonstop.planning.limits import Of, asked


def orbit_terms(
    model: Model,
    references: ArrayLike,
    winds: ArrayLike = STILL_AIR,
    load: RigidLoad | None = None,
) -> FlightTerms:
    """Data of orbits besides the plan, at references (..., 22) with their winds (..., 3).

    The `load` moves so; None: that of the model.
    """
    return FlightTerms.along(
        load or model.load,
        LoadMotion.along(np.array(references)),
        np.array(winds),
        pseudo_inverse=model.pseudo_inverse,
        offset=model.pattern.offset,
    )


def motion_above(model: Model, terms: FlightTerms, planned: NDArray) -> OrbitMotion:
    """The motion of a model's carriers at k instants of a plan (k, 8), of terms there or at one."""
    return orbit_motion(
        terms,
        model.pattern.forces(*PlannedParameters.view(planned).series),
        attachments=model.attachments,
        rest_length=model.cable_length,
        compliance=model.cable_compliance,
    )


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
    """The cables' forces and the carriers' motion through the air, in W, at constant ξ and A.

    The wind (3,), m/s, in W, and the wrench's rate are taken as constant.
    """
    angle = as_vector(theta) + 0 * as_vector(xi)  # of the scalar type of ξ
    distribution = {"pseudo_inverse": model.pseudo_inverse, "offset": model.pattern.offset}
    planned = constant_plan(angle, as_vector(xi), as_vector(amplitude))
    motion = motion_above(
        model, flight_terms(reference, wrench, wrench_rate, **distribution), planned
    )
    motion = motion._replace(velocities=motion.velocities - wind)
    return motion if isinstance(theta, np.ndarray) else OrbitMotion(*(part[0] for part in motion))


def carrier_speeds(*arguments: Any, **named: Any) -> NDArray:
    """The carriers' speeds ‖v_i‖ (eq. 22), m/s, through the air."""
    return norm(carrier_motion(*arguments, **named).velocities)[..., 0]


def cable_tensions(*arguments: Any, **named: Any) -> NDArray:
    """The tensions of the cables, N."""
    return norm(carrier_motion(*arguments, **named).forces)[..., 0]


def carrier_distances(model: Model, *arguments: Any, **named: Any) -> NDArray:
    """The distances of carriers, m, in the order of pairs (1, 2), (1, 3) … (n − 1, n)."""
    places = carrier_motion(model, *arguments, **named).positions
    return np.sqrt(squared_gaps(places, np.array(np.triu_indices(model.n, 1))))


def flight_margins(
    model: Model, limits: Any, reference: NDArray, *arguments: Any, **named: Any
) -> NDArray:
    """Margins to the stated limits of aircraft; a limit is kept where they are not negative.

    `limits` has the fields of `AircraftLimits`. The last axis has a margin for each of the limits
    of C_L, bank and climb, and two for `max_thrust_share`.
    """
    aircraft = required_aircraft(model, "optimization_layer", "flight_margins")
    motion = carrier_motion(model, reference, *arguments, **named)
    needs = needs_of_motion(aircraft, motion)
    rows = asked(limits, Of.FLIGHT)
    margins = [each for limit, most in rows for each in limit.margins(aircraft, needs, most)]
    return np.stack(margins, axis=-1) if margins else needs.airspeed[..., None][..., :0]


def as_vector(value: Any) -> NDArray:
    """A number or symbol as an array (1,), an array as one of a single dimension."""
    if isinstance(value, np.ndarray):
        return value.ravel()
    return np.fromiter([value], float if isinstance(value, (int, float)) else object)
