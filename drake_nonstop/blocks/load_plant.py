"""Box "Load Dynamics" of the figure."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.primitives import Integrator

from drake_nonstop.mechanics.rigid_load import load_state_rate
from drake_nonstop.system import Model
from drake_nonstop.traced_block import TracedBlock


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
