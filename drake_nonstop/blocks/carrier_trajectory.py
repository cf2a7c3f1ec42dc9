"""Box "Carrier Desired Trajectories" of the figure."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.cable import compliance_of
from drake_nonstop.mechanics.carrier import carrier_motion
from drake_nonstop.mechanics.signals import LOAD_REFERENCE_SIZE, LOAD_STATE_SIZE
from drake_nonstop.model.block_parameters import BlockParameters
from drake_nonstop.model.system import Model
from drake_nonstop.systems.traced_block import TracedBlock
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
    """

    is_sampled = True

    def __init__(self, model: Model, *, pose: tuple[str, int], stretches: bool = True):
        attachments = model.attachments

        def motion(
            state: NDArray,
            forces: NDArray,
            rates: NDArray,
            *times: NDArray,
            cable_length: NDArray,
            cable_stiffness: NDArray | None = None,
        ) -> NDArray:
            compliance = np.zeros(1)
            if cable_stiffness is not None:
                compliance = compliance_of(cable_stiffness)
            positions, velocities = carrier_motion(
                state,
                forces.reshape(-1, 3),
                rates.reshape(-1, 3),
                attachments=attachments,
                rest_length=cable_length,
                compliance=compliance,
            )
            if times:
                sample_time, time = times
                positions = positions + (time - sample_time) * velocities
            return np.concatenate([positions, velocities])

        inputs = dict([pose])
        inputs |= dict.fromkeys(("desired_cable_forces", "desired_cable_force_rates"), 3 * model.n)
        is_sampled = model.control_period > 0
        if is_sampled:
            inputs["sample_time"] = 1
        super().__init__(
            motion,
            inputs=inputs,
            outputs={"carrier_reference": 6 * model.n},
            reads_time=is_sampled,
            parameters=BlockParameters(
                model, ("cable_length", "cable_stiffness") if stretches else ("cable_length",)
            ),
            key=("carrier trajectory", pose, is_sampled, stretches, attachments),
        )


@dataclass(kw_only=True)
class CarrierTrajectoryConfig(StrictFields):
    """No parameters: cable length and stiffness are the system's."""


class CarrierTrajectory(_TrajectoryAboveLoad):
    """Carriers above the desired load pose, on cables stretched by the desired forces (eqs. 1, 22).

    The cables stretch by the system's stiffness (.inf: L_i = L₀, as in the paper).

    .. pydrake_system::

        name: CarrierTrajectory
        input_ports:
        - reference
        - desired_cable_forces
        - desired_cable_force_rates
        - sample_time (where the model has a control period)
        output_ports:
        - carrier_reference

    `reference` (22), SI, `desired_cable_forces` (3n, N) and their rates (3n, N/s) in W;
    `sample_time` (1) in s; `carrier_reference` (6n) = [positions (m), velocities (m/s)] in W.
    Between samples the reference moves along its velocity.
    """

    def __init__(self, model: Model, config: CarrierTrajectoryConfig | None = None):
        super().__init__(model, pose=("reference", LOAD_REFERENCE_SIZE))


@dataclass(kw_only=True)
class InextensibleCarrierTrajectoryConfig(StrictFields):
    """No parameters: the cable length is the system's."""


class InextensibleCarrierTrajectory(_TrajectoryAboveLoad):
    """Carriers above the desired load pose, on inextensible cables L_i = L₀, as in the paper.

    If the simulated cables stretch, the load hangs lower until the wrench controller's integral
    lifts it.

    .. pydrake_system::

        name: InextensibleCarrierTrajectory
        input_ports:
        - reference
        - desired_cable_forces
        - desired_cable_force_rates
        - sample_time (where the model has a control period)
        output_ports:
        - carrier_reference

    `reference` (22), SI, `desired_cable_forces` (3n, N) and their rates (3n, N/s) in W;
    `sample_time` (1) in s; `carrier_reference` (6n) = [positions (m), velocities (m/s)] in W.
    Between samples the reference moves along its velocity.
    """

    def __init__(self, model: Model, config: InextensibleCarrierTrajectoryConfig | None = None):
        super().__init__(model, pose=("reference", LOAD_REFERENCE_SIZE), stretches=False)


@dataclass(kw_only=True)
class MeasuredCarrierTrajectoryConfig(StrictFields):
    """No parameters: cable length and stiffness are the system's."""


class MeasuredCarrierTrajectory(_TrajectoryAboveLoad):
    """Carriers above the measured load pose: they follow the load wherever it is.

    Only the wrench controller then corrects the load's pose.

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
