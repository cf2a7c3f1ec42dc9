"""Box "Load Dynamics" of the figure."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import AbstractValue
from pydrake.symbolic import Expression
from pydrake.systems.framework import Context, DiagramBuilder

from drake_nonstop.mechanics.rigid_load import load_state_rate
from drake_nonstop.mechanics.signals import (
    LOAD_STATE_SIZE,
    WIND_SIZE,
    WRENCH_SIZE,
    LoadState,
    Wrench,
)
from drake_nonstop.model.block import LOAD, Block, BlockParameters, rigid_load
from drake_nonstop.model.system import Model
from drake_nonstop.systems.block import DiagramBlock, InnerBlock
from drake_nonstop.systems.parameters import declare_parameters
from drake_nonstop.systems.tracing import LARGEST, NotFiniteError
from drake_nonstop.validation import StrictFields


@dataclass(kw_only=True)
class LoadPlantConfig(StrictFields):
    """No parameters: mass, inertia, drag and attachments are the system's."""


class LoadPlant(Block):
    """The rigid load: Newton-Euler with drag linear in the velocity through the air (eqs. 5-6).

    `load_state` is the state, in the order of a free body in MultibodyPlant.
    """

    reads = ("cable_forces", "disturbance_wrench", "load_wind")
    makes = ("load_state",)
    state_ports = ("load_state",)
    system = ("attachments", *LOAD)

    @staticmethod
    def equations(
        state: NDArray,
        cable_forces: NDArray,
        disturbance: NDArray,
        wind: NDArray,
        *,
        attachments: NDArray,
        **load: NDArray,
    ) -> NDArray:
        return load_state_rate(
            rigid_load(**load), state, cable_forces, disturbance, wind, attachments=attachments
        )

    def state(self, model: Model) -> NDArray:
        return model.initial_load_state


@dataclass(kw_only=True)
class MultibodyLoadPlantConfig(StrictFields):
    """No parameters: mass, inertia, drag and attachments are the system's."""


class MultibodyLoadPlant(DiagramBlock):
    """The rigid load as the free body of a continuous MultibodyPlant.

    It has the ports of `LoadPlant` and shares no equation with it: the cables' forces act at the
    attachment points, and gravity, gyroscopic terms and the quaternion's kinematics are Drake's.
    """

    reads, makes = LoadPlant.reads, LoadPlant.makes

    def __init__(self, model: Model, config: MultibodyLoadPlantConfig | None = None):
        from pydrake.multibody.plant import MultibodyPlant  # here: few runs need them
        from pydrake.multibody.tree import SpatialInertia, UnitInertia

        super().__init__()
        builder = DiagramBuilder()
        plant = builder.AddNamedSystem("plant", MultibodyPlant(time_step=0.0))
        unit = model.load.inertia / model.load.mass
        load = plant.AddRigidBody(
            "load",
            SpatialInertia(
                mass=model.load.mass,
                p_PScm_E=np.zeros(3),
                G_SP_E=UnitInertia(*np.diag(unit), Ixy=unit[0, 1], Ixz=unit[0, 2], Iyz=unit[1, 2]),
            ),
        )
        plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -model.load.gravity])
        plant.Finalize()
        forces = builder.AddNamedSystem("forces", _LoadForces(model, load.index()))
        builder.Connect(plant.get_state_output_port(), forces.GetInputPort("load_state"))
        builder.Connect(forces.get_output_port(), plant.get_applied_spatial_force_input_port())
        for name in ("cable_forces", "disturbance_wrench", "load_wind"):
            builder.ExportInput(forces.GetInputPort(name), name)
        builder.ExportOutput(plant.get_state_output_port(), "load_state")
        builder.BuildInto(self)


class _LoadForces(InnerBlock):
    """All forces on the load except gravity, with their points of application."""

    def __init__(self, model: Model, body: Any):
        from drake_nonstop.systems.point_forces import applied_force, no_forces

        super().__init__()
        self._applied_force = applied_force
        self.parameters = BlockParameters(model, ("load_drag", "load_angular_drag"))
        declare_parameters(self, self.parameters)
        self._cable_forces = self.DeclareVectorInputPort("cable_forces", 3 * model.n)
        self._disturbance_wrench = self.DeclareVectorInputPort("disturbance_wrench", WRENCH_SIZE)
        self._load_wind = self.DeclareVectorInputPort("load_wind", WIND_SIZE)
        self._load_state = self.DeclareVectorInputPort("load_state", LOAD_STATE_SIZE)
        scalar = self.scalar
        self._body, self._points = body, [*model.attachments, np.zeros(3)]
        self.DeclareAbstractOutputPort(
            "spatial_forces",
            lambda: no_forces(scalar),
            self._calc,
            {self.all_input_ports_ticket(), self.all_parameters_ticket()},
        )

    def _calc(self, context: Context, output: AbstractValue) -> None:
        drag, angular_drag = context.get_numeric_parameter(0).CopyToVector()
        state = self._load_state.Eval(context)
        wrench = self._disturbance_wrench.Eval(context)
        wind = self._load_wind.Eval(context)
        load, (torque, force) = LoadState.view(state), Wrench.view(wrench)
        torque = torque - angular_drag * load.angular_velocity
        force = force - drag * (load.velocity - wind)
        cables = self._cable_forces.Eval(context).reshape(-1, 3)
        values = np.concatenate([state, torque, force, cables.ravel()])
        if self.scalar is not Expression and not values @ values < LARGEST**2:
            raise NotFiniteError(self.box(), was_given=True)
        parts = [*((np.zeros(3), cable) for cable in cables), (torque, force)]
        applied = [
            self._applied_force(self.scalar, self._body, point, *part)
            for point, part in zip(self._points, parts, strict=True)
        ]
        output.set_value(applied)


VARIANTS = (LoadPlant, MultibodyLoadPlant)
