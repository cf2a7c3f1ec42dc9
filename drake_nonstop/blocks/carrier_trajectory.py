"""Box "Carrier Desired Trajectories" of the figure."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from drake_nonstop.compiled import CompiledFunction
from drake_nonstop.mechanics.carrier import carrier_motion
from drake_nonstop.system import Model


@dataclass(kw_only=True)
class CarrierTrajectoryConfig:
    """No parameters: cable length and stiffness are the system's."""


_NO_TIME = np.zeros(1)


class CarrierTrajectory(LeafSystem):
    """Where each carrier has to be for its cable to pull as desired (eqs. 1, 22).

    The desired load pose carries the cables; they are as long as the system's cable
    length and stiffness make them under the desired force (stiffness .inf: L_i = L₀, as
    printed). Behind a sampled controller the references go on along their velocity
    between the samples.

    .. pydrake_system::

        name: CarrierTrajectory
        input_ports:
        - reference
        - desired_cable_forces
        - desired_cable_force_rates
        - sample_time (where the model has a control period)
        output_ports:
        - carrier_reference

    `reference` (22), `desired_cable_forces` and `desired_cable_force_rates` (3n) in W;
    `sample_time` (1) in s; `carrier_reference` (6n) = [positions, velocities] in W.
    """

    def __init__(self, model: Model, config: CarrierTrajectoryConfig | None = None):
        super().__init__()

        def motion(reference: NDArray, forces: NDArray, rates: NDArray, ahead: NDArray) -> NDArray:
            positions, velocities = carrier_motion(
                reference,
                forces.reshape(-1, 3),
                rates.reshape(-1, 3),
                attachments=model.attachments,
                rest_length=model.cable_length,
                compliance=model.cable_compliance,
            )
            return np.concatenate([positions + ahead * velocities, velocities])

        self._motion = CompiledFunction(
            motion, [22, 3 * model.n, 3 * model.n, 1], name=self.get_name
        )
        self._reference = self.DeclareVectorInputPort("reference", 22)
        self._forces = self.DeclareVectorInputPort("desired_cable_forces", 3 * model.n)
        self._rates = self.DeclareVectorInputPort("desired_cable_force_rates", 3 * model.n)
        self._sample_time = None
        prerequisites = {self.all_input_ports_ticket()}
        if model.control_period > 0:
            self._sample_time = self.DeclareVectorInputPort("sample_time", 1)
            prerequisites.add(self.time_ticket())
        self.DeclareVectorOutputPort(
            "carrier_reference", 6 * model.n, self._calc_reference, prerequisites
        )

    def _calc_reference(self, context: Context, output: BasicVector) -> None:
        ahead = _NO_TIME
        if self._sample_time is not None:
            ahead = context.get_time() - self._sample_time.Eval(context)
        (motion,) = self._motion(
            self._reference.Eval(context),
            self._forces.Eval(context),
            self._rates.Eval(context),
            ahead,
        )
        output.SetFromVector(motion)
