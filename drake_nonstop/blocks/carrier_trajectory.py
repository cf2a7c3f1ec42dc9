"""Box "Carrier Desired Trajectories" of the figure."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.cable import compliance_of
from drake_nonstop.mechanics.carrier import carrier_acceleration, carrier_jerk, carrier_motion
from drake_nonstop.mechanics.force_rates import second_and_third_force_rates
from drake_nonstop.mechanics.signals import (
    LOAD_REFERENCE_SIZE,
    LOAD_STATE_SIZE,
    PARAMETERS_SIZE,
    WIND_SIZE,
)
from drake_nonstop.model.block_parameters import LOAD, BlockParameters, rigid_load
from drake_nonstop.model.system import Model
from drake_nonstop.systems.traced_block import LateOutputs, TracedBlock
from drake_nonstop.validation import StrictFields


class _TrajectoryAboveLoad(TracedBlock):
    """The carriers' positions and velocities for the desired cable forces (eqs. 1, 22).

    The attachments are those of a given load pose. Behind a sampled controller the references
    move along their velocities between the samples.

    Args:
        model: attachments and cables.
        pose: the signal with the load's pose, and its size: a load state, or what begins with
            one.
        stretches: whether the cables do, by their stiffness.
        derivatives: makes accelerations and jerks as well, of these inputs and three more.
    """

    is_sampled = True

    def __init__(
        self,
        model: Model,
        *,
        pose: tuple[str, int],
        stretches: bool = True,
        derivatives: LateOutputs | None = None,
    ):
        attachments = model.attachments

        def motion(
            state: NDArray,
            forces: NDArray,
            rates: NDArray,
            *further: NDArray,
            cable_length: NDArray,
            cable_stiffness: NDArray | None = None,
            **_: NDArray,
        ) -> NDArray:
            positions, velocities = carrier_motion(
                state,
                forces.reshape(-1, 3),
                rates.reshape(-1, 3),
                attachments=attachments,
                rest_length=cable_length,
                compliance=_compliance(cable_stiffness),
            )
            if is_sampled:
                sample_time, time = further[-2:]
                positions = positions + (time - sample_time) * velocities
            return np.concatenate([positions, velocities])

        inputs = dict([pose])
        inputs |= dict.fromkeys(("desired_cable_forces", "desired_cable_force_rates"), 3 * model.n)
        parameters = _of_cables(stretches)
        if derivatives is not None:
            inputs |= {"internal_force": 2 * model.m, "parameters": PARAMETERS_SIZE}
            inputs |= {"wind_estimate": WIND_SIZE}
            parameters += LOAD
        is_sampled = model.control_period > 0
        if is_sampled:
            inputs["sample_time"] = 1
        super().__init__(
            motion,
            inputs=inputs,
            outputs={"carrier_reference": 6 * model.n},
            reads_time=is_sampled,
            parameters=BlockParameters(model, parameters),
            key=("carrier trajectory", tuple(inputs), is_sampled, stretches, attachments),
            late=derivatives,
        )


class _TrajectoryAboveReference(_TrajectoryAboveLoad):
    """A `_TrajectoryAboveLoad` on its reference, with accelerations and jerks."""

    optional_inputs = ("internal_force", "parameters", "wind_estimate")

    def __init__(self, model: Model, *, stretches: bool = True):
        pose = ("reference", LOAD_REFERENCE_SIZE)
        super().__init__(model, pose=pose, stretches=stretches, derivatives=_derivatives(model))


def _derivatives(model: Model) -> LateOutputs:
    """The carriers' accelerations and jerks while the load is on its reference."""
    attachments, pseudo_inverse = model.attachments, model.pseudo_inverse
    basis, orders = model.pattern.basis, model.pattern.orders

    def derivatives(
        reference: NDArray,
        forces: NDArray,
        rates: NDArray,
        internal_force: NDArray,
        parameters: NDArray,
        wind: NDArray,
        *,
        cable_length: NDArray,
        cable_stiffness: NDArray | None = None,
        **load: NDArray,
    ) -> tuple[NDArray, NDArray]:
        forces, rates = forces.reshape(-1, 3), rates.reshape(-1, 3)
        higher_rates = second_and_third_force_rates(
            rigid_load(**load),
            reference,
            forces,
            rates,
            internal_force,
            parameters,
            wind,
            pseudo_inverse=pseudo_inverse,
            basis=basis,
            orders=orders,
        )
        cables: dict[str, Any] = {
            "attachments": attachments,
            "rest_length": cable_length,
            "compliance": _compliance(cable_stiffness),
        }
        return (
            carrier_acceleration(reference, forces, rates, higher_rates[0], **cables),
            carrier_jerk(reference, forces, rates, *higher_rates, **cables),
        )

    return LateOutputs(
        derivatives,
        (
            "reference",
            "desired_cable_forces",
            "desired_cable_force_rates",
            "internal_force",
            "parameters",
            "wind_estimate",
        ),
        dict.fromkeys(("carrier_reference_acceleration", "carrier_reference_jerk"), 3 * model.n),
        key=("carrier derivatives", attachments, basis, orders),
    )


def _of_cables(stretches: bool) -> tuple[str, ...]:
    """The fields of the system that cables go by."""
    return ("cable_length", "cable_stiffness") if stretches else ("cable_length",)


def _compliance(stiffness: NDArray | None) -> NDArray:
    """Of cables of a stiffness (1,) in N/m, None if they do not stretch: (1,) in m/N."""
    return np.zeros(1) if stiffness is None else compliance_of(stiffness)


@dataclass(kw_only=True)
class CarrierTrajectoryConfig(StrictFields):
    """No parameters: cable length and stiffness are the system's."""


class CarrierTrajectory(_TrajectoryAboveReference):
    """Carriers above the desired load pose, on cables stretched by the desired forces (eqs. 1, 22).

    The cables stretch by the system's stiffness (.inf: L_i = L₀, as in the paper).

    .. pydrake_system::

        name: CarrierTrajectory
        input_ports:
        - reference
        - desired_cable_forces
        - desired_cable_force_rates
        - internal_force
        - parameters
        - wind_estimate
        - sample_time (where the model has a control period)
        output_ports:
        - carrier_reference
        - carrier_reference_acceleration
        - carrier_reference_jerk

    `reference` (22), SI, `desired_cable_forces` (3n, N) and their rates (3n, N/s) in W;
    `internal_force` (2m) = [λ (N); λ̇ (N/s)], `parameters` (2) = [ξ (rad/s), A (N)] and
    `wind_estimate` (3, m/s) in W, which only accelerations and jerks need; `sample_time` (1) in s;
    `carrier_reference` (6n) = [positions (m), velocities (m/s)] in W. Between samples the reference
    moves along its velocity.

    `carrier_reference_acceleration` (3n, m/s²) and `carrier_reference_jerk` (3n, m/s³) in W are
    those of constant ξ and A while the load is on its reference, whose snap and angular jerk are
    taken as zero, see `mechanics.force_rates`; between samples they stand still.
    """

    def __init__(self, model: Model, config: CarrierTrajectoryConfig | None = None):
        super().__init__(model)


@dataclass(kw_only=True)
class InextensibleCarrierTrajectoryConfig(StrictFields):
    """No parameters: the cable length is the system's."""


class InextensibleCarrierTrajectory(_TrajectoryAboveReference):
    """Carriers above the desired load pose, on inextensible cables L_i = L₀, as in the paper.

    If the simulated cables stretch, the load hangs lower until the wrench controller's integral
    lifts it.

    .. pydrake_system::

        name: InextensibleCarrierTrajectory
        input_ports:
        - reference
        - desired_cable_forces
        - desired_cable_force_rates
        - internal_force
        - parameters
        - wind_estimate
        - sample_time (where the model has a control period)
        output_ports:
        - carrier_reference
        - carrier_reference_acceleration
        - carrier_reference_jerk

    `reference` (22), SI, `desired_cable_forces` (3n, N) and their rates (3n, N/s) in W;
    `internal_force` (2m) = [λ (N); λ̇ (N/s)], `parameters` (2) = [ξ (rad/s), A (N)] and
    `wind_estimate` (3, m/s) in W, which only accelerations and jerks need; `sample_time` (1) in s;
    `carrier_reference` (6n) = [positions (m), velocities (m/s)] in W. Between samples the reference
    moves along its velocity.

    `carrier_reference_acceleration` (3n, m/s²) and `carrier_reference_jerk` (3n, m/s³) in W are
    those of constant ξ and A while the load is on its reference, whose snap and angular jerk are
    taken as zero, see `mechanics.force_rates`; between samples they stand still.
    """

    def __init__(self, model: Model, config: InextensibleCarrierTrajectoryConfig | None = None):
        super().__init__(model, stretches=False)


@dataclass(kw_only=True)
class MeasuredCarrierTrajectoryConfig(StrictFields):
    """No parameters: cable length and stiffness are the system's."""


class MeasuredCarrierTrajectory(_TrajectoryAboveLoad):
    """Carriers above the measured load pose: they follow the load wherever it is.

    Only the wrench controller then corrects the load's pose. It does not make the accelerations and
    jerks that the others make: those of the measured load are not known.

    .. pydrake_system::

        name: MeasuredCarrierTrajectory
        input_ports:
        - measured_load_state
        - desired_cable_forces
        - desired_cable_force_rates
        - sample_time (where the model has a control period)
        output_ports:
        - carrier_reference

    `measured_load_state` (13), SI, `desired_cable_forces` (3n, N) and their rates (3n, N/s) in W;
    `sample_time` (1) in s; `carrier_reference` (6n) = [positions (m), velocities (m/s)] in W.
    Between samples the reference moves along its velocity.
    """

    def __init__(self, model: Model, config: MeasuredCarrierTrajectoryConfig | None = None):
        super().__init__(model, pose=("measured_load_state", LOAD_STATE_SIZE))


# The blocks that the box can be, the default first.
VARIANTS = (CarrierTrajectory, InextensibleCarrierTrajectory, MeasuredCarrierTrajectory)
