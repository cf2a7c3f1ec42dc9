"""The dynamics half of box "Carrier Controller + Dynamics"."""

from dataclasses import dataclass

import numpy as np
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Gain, Integrator, Multiplexer

from drake_nonstop.block import DiagramBlock
from drake_nonstop.mechanics.carrier import double_integrator_rate
from drake_nonstop.system import Model
from drake_nonstop.traced_block import Equations


@dataclass(kw_only=True)
class CarrierDynamicsConfig:
    """No parameters: the carrier mass is the system's."""


class CarrierDynamics(DiagramBlock):
    """Double integrators: m_c p̈ = u, without weight or cable reaction, as in the paper.

    .. pydrake_system::

        name: CarrierDynamics
        input_ports:
        - carrier_forces
        output_ports:
        - carrier_state

    `carrier_forces` (3n) in N, in W; `carrier_state` (6n) = [positions, velocities], in
    W, is the state. It is made of Drake's own systems, which take half as long as a callback;
    `equations` are the same from `mechanics.carrier`, for a fused plant.
    """

    def __init__(self, model: Model, config: CarrierDynamicsConfig | None = None):
        super().__init__()
        size = 3 * model.n
        self.equations = Equations(
            lambda state, forces: double_integrator_rate(state, forces, mass=model.carrier_mass),
            inputs={"carrier_forces": size},
            outputs={},
            initial_state=np.zeros(2 * size),
            state_port="carrier_state",
        )
        builder = DiagramBuilder()
        # In the order of the state.
        positions = builder.AddNamedSystem("positions", Integrator(size))
        velocities = builder.AddNamedSystem("velocities", Integrator(size))
        accelerations = builder.AddNamedSystem("accelerations", Gain(1 / model.carrier_mass, size))
        state = builder.AddNamedSystem("state", Multiplexer([size, size]))
        builder.ExportInput(accelerations.get_input_port(), "carrier_forces")
        builder.Connect(accelerations.get_output_port(), velocities.get_input_port())
        builder.Connect(velocities.get_output_port(), positions.get_input_port())
        for i, part in enumerate((positions, velocities)):
            builder.Connect(part.get_output_port(), state.get_input_port(i))
        builder.ExportOutput(state.get_output_port(), "carrier_state")
        builder.BuildInto(self)
