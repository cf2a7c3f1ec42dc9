"""The dynamics half of box "Carrier Controller + Dynamics"."""

import math
from dataclasses import dataclass

from numpy.typing import NDArray
from pydrake.systems.framework import Context, DiagramBuilder, System
from pydrake.systems.primitives import Integrator, Selector, SelectorParams

from drake_nonstop.mechanics.carrier import (
    carriers_kinetic_energy,
    carriers_potential_energy,
    double_integrator_rate,
    loaded_carrier_rate,
)
from drake_nonstop.model.block_parameters import BlockParameters, Rules
from drake_nonstop.model.system import Model
from drake_nonstop.systems.block import BlockType, DiagramBlock
from drake_nonstop.systems.linear_block import AdjustableLinear
from drake_nonstop.systems.parameters import parameters_in
from drake_nonstop.systems.traced_block import Equations, TracedBlock, stacking
from drake_nonstop.validation import StrictFields, is_number, require


@dataclass(kw_only=True)
class CarrierDynamicsConfig(StrictFields):
    """No parameters: the carrier mass is the system's."""


class CarrierDynamics(DiagramBlock):
    """Double integrators: m_c p̈ = u, without weight or cable reaction, as in the paper.

    .. pydrake_system::

        name: CarrierDynamics
        input_ports:
        - carrier_forces
        output_ports:
        - carrier_state

    `carrier_forces` (3n) in N, in W; `carrier_state` (6n) = [positions (m), velocities (m/s)], in
    W, is the state.
    """

    def __init__(self, model: Model, config: CarrierDynamicsConfig | None = None):
        super().__init__()
        size, mass = 3 * model.n, model.system.carrier_mass
        builder = DiagramBuilder()
        accelerations = AdjustableLinear(
            builder,
            lambda forces, carrier_mass: forces / carrier_mass,
            inputs={"carrier_forces": size},
            size=size,
            parameters=BlockParameters(model, ("carrier_mass",)),
            key=("carrier accelerations", size),
        )
        state = builder.AddNamedSystem("state", Integrator(model.initial_carrier_state))
        rate = builder.AddNamedSystem("rate", Selector(_rate(size)))
        builder.Connect(state.get_output_port(), rate.GetInputPort("carrier_state"))
        builder.Connect(accelerations.output, rate.GetInputPort("accelerations"))
        builder.Connect(rate.get_output_port(), state.get_input_port())
        first, second = accelerations.inputs["carrier_forces"]
        builder.ExportInput(first, "carrier_forces")
        builder.ConnectInput("carrier_forces", second)
        builder.ExportOutput(state.get_output_port(), "carrier_state")
        builder.BuildInto(self)
        self.equations = Equations(
            lambda state, forces: double_integrator_rate(state, forces, mass=mass),
            {"carrier_forces": size},
            {},
            model.initial_carrier_state,
            "carrier_state",
        )

    def CalcKineticEnergy(self, context: Context) -> float:
        """½ m_c Σ ‖v_i‖², J; the context is the block's own. Without weight none is potential."""
        return _kinetic_energy(self, context)

    def SetCarrierState(self, context: Context, value: NDArray) -> None:
        context.SetContinuousState(value)


def _rate(size: int) -> SelectorParams:
    """Of a Selector that makes [velocities, accelerations] of the state and the accelerations."""
    params = stacking({"carrier_state": 2 * size, "accelerations": size}, "rate")
    (rate,) = params.outputs
    rate.selections = rate.selections[size:]
    params.outputs = [rate]
    return params


@dataclass(kw_only=True)
class LoadedCarrierDynamicsConfig(StrictFields):
    """The limit of a carrier; its mass is the system's."""

    max_force: float = math.inf  # N, of a carrier


class LoadedCarrierDynamics(TracedBlock):
    """Carriers with weight and cable reaction: m_c p̈ = sat(u) − m_c g e₃ − f.

    They sag under a controller that compensates for neither; see `LoadedCarrierPid`.

    .. pydrake_system::

        name: LoadedCarrierDynamics
        input_ports:
        - carrier_forces
        - cable_forces
        output_ports:
        - carrier_state

    `carrier_forces` (3n), each limited to `max_force`, and `cable_forces` (3n) on the load
    in N, in W; `carrier_state` (6n) = [positions (m), velocities (m/s)], in W, is the state.

    Parameters, the fields of `LoadedCarrierDynamicsConfig`:
        max_force: N, of a carrier

    Raises:
        ScenarioError: `max_force` is not positive.
    """

    def __init__(self, model: Model, config: LoadedCarrierDynamicsConfig | None = None):
        config = config or LoadedCarrierDynamicsConfig()
        _check(model, config)
        n = model.n
        super().__init__(
            lambda *values, carrier_mass, gravity, max_force=None: loaded_carrier_rate(
                *values, mass=carrier_mass, gravity=gravity, max_force=max_force
            ),
            inputs={"carrier_forces": 3 * n, "cable_forces": 3 * n},
            state=Integrator(model.initial_carrier_state),
            state_port="carrier_state",
            parameters=BlockParameters(
                model,
                ("carrier_mass", "gravity"),
                config=config,
                own=("max_force",) if _is_limited(model, config) else (),
                rules=Rules(check=_check, structure=_is_limited),
            ),
            key=("loaded carriers", n, _is_limited(model, config)),
        )

    SetCarrierState = CarrierDynamics.SetCarrierState

    def CalcKineticEnergy(self, context: Context) -> float:
        """½ m_c Σ ‖v_i‖², J; the context is the block's own."""
        return _kinetic_energy(self, context)

    def CalcPotentialEnergy(self, context: Context) -> float:
        """Those of the weights, m_c g Σ z_i, J; the context is the block's own."""
        state = self.GetOutputPort("carrier_state").Eval(context)
        values = parameters_in(self, context)
        energy = carriers_potential_energy(
            state, mass=values["carrier_mass"], gravity=values["gravity"]
        )
        return float(energy[0])


def _kinetic_energy(block: System, context: Context) -> float:
    state = block.GetOutputPort("carrier_state").Eval(context)
    mass = parameters_in(block, context)["carrier_mass"]
    return float(carriers_kinetic_energy(state, mass=mass)[0])


def _check(model: Model, config: LoadedCarrierDynamicsConfig) -> None:
    limit = config.max_force
    require(
        (is_number(limit) and limit > 0) or limit == math.inf,
        "carrier_dynamics.max_force",
        limit,
        "give a number greater than zero, or .inf for no limit",
    )


def _is_limited(model: Model, config: LoadedCarrierDynamicsConfig) -> bool:
    return config.max_force < math.inf


@dataclass(kw_only=True)
class IdealCarriersConfig(StrictFields):
    """No parameters."""


class IdealCarriers(Selector, metaclass=BlockType):
    """Ideal tracking: the carriers' state is their reference, whatever the controller does.

    The load's error that remains with them is not due to the carriers. Behind sampled
    controllers the references, and so the carriers, jump a little at every sample.

    .. pydrake_system::

        name: IdealCarriers
        input_ports:
        - carrier_reference
        output_ports:
        - carrier_state

    Both (6n) = [positions (m), velocities (m/s)], in W.
    """

    def __init__(self, model: Model, config: IdealCarriersConfig | None = None):
        """Makes the block; it takes a `model` and a `config` (None: the default values)."""
        super().__init__(stacking({"carrier_reference": 6 * model.n}, "carrier_state"))
        self.parameters = BlockParameters(model, rules=Rules(fixed=("carrier_mass",)))
        self._mass = model.carrier_mass

    def CalcKineticEnergy(self, context: Context) -> float:
        """½ m_c Σ ‖v_i‖², J; the context is the block's own. Without weight none is potential."""
        state = self.GetOutputPort("carrier_state").Eval(context)
        return float(carriers_kinetic_energy(state, mass=self._mass)[0])


# The blocks that the box can be, the default first.
VARIANTS = (CarrierDynamics, LoadedCarrierDynamics, IdealCarriers)
