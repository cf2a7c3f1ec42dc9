"""Box "Load Dynamics" of the figure."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import AbstractValue
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import BodyIndex, SpatialInertia, UnitInertia
from pydrake.systems.framework import Context, DiagramBuilder
from pydrake.systems.primitives import Integrator

from drake_nonstop.mechanics.rigid_load import load_state_rate
from drake_nonstop.model.system import Model
from drake_nonstop.systems.block import DiagramBlock, InnerBlock
from drake_nonstop.systems.traced_block import TracedBlock
from drake_nonstop.systems.tracing import LARGEST, NotFiniteError


@dataclass(kw_only=True)
class LoadPlantConfig:
    """No parameters: mass, inertia, drag and attachments are the system's."""


class LoadPlant(TracedBlock):
    """The rigid load: Newton-Euler with linear drag (eqs. 5-6).

    .. pydrake_system::

        name: LoadPlant
        input_ports:
        - cable_forces
        - disturbance_wrench
        output_ports:
        - load_state

    `cable_forces` (3n) act at the attachments, `disturbance_wrench` (6) = [torque;
    force] at the centre of mass, in W. `load_state` (13) = [quaternion w x y z, position,
    angular velocity, velocity], in W, is the state, in the order of a free body in
    MultibodyPlant.
    """

    def __init__(self, model: Model, config: LoadPlantConfig | None = None):
        def rate(state: NDArray, cable_forces: NDArray, disturbance: NDArray) -> NDArray:
            return load_state_rate(
                state,
                cable_forces,
                disturbance,
                attachments=model.attachments,
                mass=model.load_mass,
                inertia=model.load_inertia,
                inertia_inverse=model.load_inertia_inverse,
                drag=model.load_drag,
                angular_drag=model.load_angular_drag,
                gravity=model.gravity,
            )

        super().__init__(
            rate,
            inputs={"cable_forces": 3 * model.n, "disturbance_wrench": 6},
            state=Integrator(np.array([1.0] + [0.0] * 12)),
            state_port="load_state",
        )


@dataclass(kw_only=True)
class MultibodyLoadPlantConfig:
    """No parameters: mass, inertia, drag and attachments are the system's."""


class MultibodyLoadPlant(DiagramBlock):
    """The rigid load as the free body of a continuous MultibodyPlant.

    It is behind the same ports as `LoadPlant` and shares no equation with it: the cables'
    forces act at the attachment points, and gravity, gyroscopic terms and the quaternion's
    kinematics are Drake's.

    .. pydrake_system::

        name: MultibodyLoadPlant
        input_ports:
        - cable_forces
        - disturbance_wrench
        output_ports:
        - load_state

    `cable_forces` (3n) act at the attachments, `disturbance_wrench` (6) = [torque;
    force] at the centre of mass, in W. `load_state` (13) = [quaternion w x y z, position,
    angular velocity, velocity], in W, is the plant's state.
    """

    def __init__(self, model: Model, config: MultibodyLoadPlantConfig | None = None):
        super().__init__()
        builder = DiagramBuilder()
        plant = builder.AddNamedSystem("plant", MultibodyPlant(time_step=0.0))
        unit = model.load_inertia / model.load_mass
        load = plant.AddRigidBody(
            "load",
            SpatialInertia(
                mass=model.load_mass,
                p_PScm_E=np.zeros(3),
                G_SP_E=UnitInertia(*np.diag(unit), Ixy=unit[0, 1], Ixz=unit[0, 2], Iyz=unit[1, 2]),
            ),
        )
        plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -model.gravity])
        plant.Finalize()
        forces = builder.AddNamedSystem("forces", _LoadForces(model, load.index()))
        builder.Connect(plant.get_state_output_port(), forces.GetInputPort("load_state"))
        builder.Connect(forces.get_output_port(), plant.get_applied_spatial_force_input_port())
        for name in ("cable_forces", "disturbance_wrench"):
            builder.ExportInput(forces.GetInputPort(name), name)
        builder.ExportOutput(plant.get_state_output_port(), "load_state")
        builder.BuildInto(self)


class _LoadForces(InnerBlock):
    """All but gravity that acts on the load, each force where it does."""

    def __init__(self, model: Model, body: BodyIndex):
        super().__init__()
        self._drag, self._angular_drag = model.load_drag, model.load_angular_drag
        self._cable_forces = self.DeclareVectorInputPort("cable_forces", 3 * model.n)
        self._disturbance_wrench = self.DeclareVectorInputPort("disturbance_wrench", 6)
        self._load_state = self.DeclareVectorInputPort("load_state", 13)
        self._body, self._points = body, [*model.attachments, np.zeros(3)]
        self.DeclareAbstractOutputPort(
            "spatial_forces",
            lambda: AbstractValue.Make([ExternallyAppliedSpatialForce()]),
            self._calc,
            {self.all_input_ports_ticket()},
        )

    def _calc(self, context: Context, output: AbstractValue) -> None:
        state = self._load_state.Eval(context)
        wrench = self._disturbance_wrench.Eval(context).copy()
        wrench[:3] -= self._angular_drag * state[7:10]
        wrench[3:] -= self._drag * state[10:13]
        cables = self._cable_forces.Eval(context).reshape(-1, 3)
        values = np.concatenate([state, wrench, cables.ravel()])
        if not values @ values < LARGEST**2:
            raise NotFiniteError(self.box(), was_given=True)
        spatial = [SpatialForce(np.zeros(3), force) for force in cables]
        applied = []
        for point, force in zip(
            self._points, [*spatial, SpatialForce(wrench[:3], wrench[3:])], strict=True
        ):
            entry = ExternallyAppliedSpatialForce()
            entry.body_index, entry.p_BoBq_B, entry.F_Bq_W = self._body, point, force
            applied.append(entry)
        output.set_value(applied)


VARIANTS = (
    LoadPlant,
    MultibodyLoadPlant,
)  # of the box, the default first
