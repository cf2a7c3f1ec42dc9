"""The motion of a model's carriers above a load that follows its reference."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.planned_orbit import (
    FlightTerms,
    OrbitMotion,
    PlannedOrbit,
    flight_along_reference,
    orbit_motion,
    pattern_directions,
)
from drake_nonstop.mechanics.rigid_load import RigidLoad
from drake_nonstop.model.system import Model


def orbit_terms(
    model: Model,
    references: Sequence[NDArray] | NDArray,
    winds: Sequence[NDArray],
    load: RigidLoad | None = None,
) -> FlightTerms:
    """What orbits depend on besides the plan, at k references (22,) with their winds (3,).

    `load` is what moves so; None: that of the model.
    """
    rows = [
        flight_along_reference(
            load or model.load,
            reference,
            wind,
            pseudo_inverse=model.pseudo_inverse,
            offset=model.pattern.offset,
            attachments=model.attachments,
        )
        for reference, wind in zip(references, winds, strict=True)
    ]
    return FlightTerms.view(np.array(rows))


def motion_above(model: Model, terms: FlightTerms, orbit: PlannedOrbit) -> OrbitMotion:
    """The motion of a model's carriers at k instants, with terms there or at one."""
    pattern = model.pattern
    return orbit_motion(
        terms,
        pattern_directions(pattern.basis, pattern.phases, pattern.orders, orbit.angle),
        orbit,
        rest_length=model.cable_length,
        compliance=model.cable_compliance,
    )
