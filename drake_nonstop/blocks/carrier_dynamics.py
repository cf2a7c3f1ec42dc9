"""The dynamics half of box "Carrier Controller + Dynamics"."""

import math
from dataclasses import dataclass

import numpy as np
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Gain, Integrator, Multiplexer, Selector

from drake_nonstop.mechanics.carrier import double_integrator_rate, loaded_carrier_rate
from drake_nonstop.model.system import Model
from drake_nonstop.systems.block import BlockType, DiagramBlock
from drake_nonstop.systems.traced_block import Equations, TracedBlock, stacking
from drake_nonstop.validation import is_number, require


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


@dataclass(kw_only=True)
class LoadedCarrierDynamicsConfig:
    """What a carrier can do; its mass is the system's."""

    max_force: float = math.inf  # N, of a carrier


class LoadedCarrierDynamics(TracedBlock):
    """Carriers that feel their weight and their cable: m_c p̈ = sat(u) − m_c g e₃ − f.

    A controller that knows of neither lets them sag; see `LoadedCarrierPid`.

    .. pydrake_system::

        name: LoadedCarrierDynamics
        input_ports:
        - carrier_forces
        - cable_forces
        output_ports:
        - carrier_state

    `carrier_forces` (3n), each cut down to `max_force`, and `cable_forces` (3n) on the load
    in N, in W; `carrier_state` (6n) = [positions, velocities], in W, is the state.

    Raises:
        ScenarioError: `max_force` is not positive.
    """

    def __init__(self, model: Model, config: LoadedCarrierDynamicsConfig | None = None):
        config = config or LoadedCarrierDynamicsConfig()
        limit = config.max_force
        require(
            (is_number(limit) and limit > 0) or limit == math.inf,
            "carrier_dynamics.max_force",
            limit,
            "give a number greater than zero, or .inf for no limit",
        )
        n = model.n
        super().__init__(
            lambda state, forces, cables: loaded_carrier_rate(
                state,
                forces,
                cables,
                mass=model.carrier_mass,
                gravity=model.gravity,
                max_force=limit,
            ),
            inputs={"carrier_forces": 3 * n, "cable_forces": 3 * n},
            state=Integrator(6 * n),
            state_port="carrier_state",
        )


@dataclass(kw_only=True)
class IdealCarriersConfig:
    """No parameters."""


class IdealCarriers(Selector, metaclass=BlockType):
    """Ideal tracking: the carriers are always where they should be, whatever steers them.

    What is left of the load's error with them is none of the carriers' fault. Behind sampled
    controllers their references are no smooth motion: they jump a little at every sample.

    .. pydrake_system::

        name: IdealCarriers
        input_ports:
        - carrier_reference
        output_ports:
        - carrier_state

    Both (6n) = [positions, velocities], in W.
    """

    def __init__(self, model: Model, config: IdealCarriersConfig | None = None):
        super().__init__(stacking({"carrier_reference": 6 * model.n}, "carrier_state"))


VARIANTS = (
    CarrierDynamics,
    LoadedCarrierDynamics,
    IdealCarriers,
)  # of the box, the default first
