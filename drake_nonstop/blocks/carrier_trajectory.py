"""Box "Carrier Desired Trajectories" of the figure."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.carrier import carrier_motion
from drake_nonstop.model.system import Model
from drake_nonstop.systems.traced_block import TracedBlock


class CarrierMotion(TracedBlock):
    """Where each carrier has to be for its cable to pull as desired (eqs. 1, 22).

    A load pose carries the cables. Behind a sampled controller the references go on along
    their velocity between the samples.

    .. pydrake_system::

        name: CarrierMotion
        input_ports:
        - (the load's pose)
        - desired_cable_forces
        - desired_cable_force_rates
        - sample_time (where the model has a control period)
        output_ports:
        - carrier_reference

    `desired_cable_forces` and `desired_cable_force_rates` (3n) in W; `sample_time` (1) in s;
    `carrier_reference` (6n) = [positions, velocities] in W.

    Args:
        model: attachments and cables.
        pose: the signal of the pose that carries the cables, and its size: a load state, or
            what begins with one.
        compliance: 1/K_c (m/N), by which the cables are taken to stretch.
    """

    def __init__(self, model: Model, *, pose: tuple[str, int], compliance: float):
        def motion(state: NDArray, forces: NDArray, rates: NDArray, *times: NDArray) -> NDArray:
            positions, velocities = carrier_motion(
                state,
                forces.reshape(-1, 3),
                rates.reshape(-1, 3),
                attachments=model.attachments,
                rest_length=model.cable_length,
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
        )


@dataclass(kw_only=True)
class CarrierTrajectoryConfig:
    """No parameters: cable length and stiffness are the system's."""


class CarrierTrajectory(CarrierMotion):
    """Cables on the desired load pose, as long as they are under the desired forces.

    Ports as `CarrierMotion`, with the `reference` (22) as the load's pose. The cables stretch
    by the system's stiffness (.inf: L_i = L₀, as printed).
    """

    def __init__(self, model: Model, config: CarrierTrajectoryConfig | None = None):
        super().__init__(model, pose=("reference", 22), compliance=model.cable_compliance)


@dataclass(kw_only=True)
class InextensibleCarrierTrajectoryConfig:
    """No parameters: the cable length is the system's."""


class InextensibleCarrierTrajectory(CarrierMotion):
    """Cables on the desired load pose that never stretch, L_i = L₀, as printed.

    Ports as `CarrierMotion`, with the `reference` (22) as the load's pose. Cables that do
    stretch then let the load hang lower, until the wrench controller's integral lifts it.
    """

    def __init__(self, model: Model, config: InextensibleCarrierTrajectoryConfig | None = None):
        super().__init__(model, pose=("reference", 22), compliance=0.0)


@dataclass(kw_only=True)
class MeasuredCarrierTrajectoryConfig:
    """No parameters: cable length and stiffness are the system's."""


class MeasuredCarrierTrajectory(CarrierMotion):
    """Cables on the measured load pose: the carriers follow the load wherever it is.

    Ports as `CarrierMotion`, with the `measured_load_state` (13) as the load's pose. Only the
    wrench controller then leads the load back.
    """

    def __init__(self, model: Model, config: MeasuredCarrierTrajectoryConfig | None = None):
        super().__init__(model, pose=("measured_load_state", 13), compliance=model.cable_compliance)


VARIANTS = (
    CarrierTrajectory,
    InextensibleCarrierTrajectory,
    MeasuredCarrierTrajectory,
)  # of the box, the default first
