"""Forces at points of bodies, as a MultibodyPlant takes them."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.common.value import AbstractValue
from pydrake.symbolic import Expression
from pydrake.systems.framework import Context

from drake_nonstop.systems.block import LeafBlock
from drake_nonstop.systems.tracing import LARGEST, NotFiniteError

if TYPE_CHECKING:  # few runs need them
    from pydrake.multibody.tree import BodyIndex, RigidBody


def no_forces(scalar: type) -> AbstractValue:
    """Class of applied spatial forces that a MultibodyPlant of that scalar type takes."""
    from pydrake.multibody.plant import ExternallyAppliedSpatialForce_

    return AbstractValue.Make([ExternallyAppliedSpatialForce_[scalar]()])


def applied_force(
    scalar: type, body: "BodyIndex", point: NDArray, torque: NDArray, force: NDArray
) -> Any:
    """A torque (N m) and a force (N), in W, at a point (m) in the frame of a body."""
    from pydrake.multibody.math import SpatialForce_
    from pydrake.multibody.plant import ExternallyAppliedSpatialForce_

    entry = ExternallyAppliedSpatialForce_[scalar]()
    entry.body_index, entry.p_BoBq_B = body, point
    entry.F_Bq_W = SpatialForce_[scalar](torque, force)
    return entry


class PointForces(LeafBlock):
    """Forces at points of the bodies of a MultibodyPlant, for blocks with physics of one's own.

    .. pydrake_system::

        name: PointForces
        input_ports:
        - forces
        output_ports:
        - spatial_forces

    `forces` (3k) in N, in W;
    `spatial_forces` is abstract, for the plant's `get_applied_spatial_force_input_port()`.

    Args:
        bodies: k bodies of the plant; one may be among them more than once.
        points: (k, 3), m, in the bodies' frames.

    Raises:
        NotFiniteError: a force is not finite, or is far too large.
    """

    def __init__(self, bodies: Sequence["RigidBody"], points: ArrayLike):
        super().__init__()
        self._places = [
            (body.index(), point) for body, point in zip(bodies, np.asarray(points), strict=True)
        ]
        self._forces = self.DeclareVectorInputPort("forces", 3 * len(bodies))
        scalar = self.scalar
        self.DeclareAbstractOutputPort(
            "spatial_forces",
            lambda: no_forces(scalar),
            self._calc,
            {self.all_input_ports_ticket()},
        )

    def _calc(self, context: Context, output: AbstractValue) -> None:
        forces = self._forces.Eval(context)
        if self.scalar is not Expression and not forces @ forces < LARGEST**2:
            raise NotFiniteError(self.box(), was_given=True)
        pairs = zip(self._places, forces.reshape(-1, 3), strict=True)
        output.set_value(
            [
                applied_force(self.scalar, body, point, np.zeros(3), force)
                for (body, point), force in pairs
            ]
        )
