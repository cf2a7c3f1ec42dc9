"""The controller half of box "Carrier Controller + Dynamics"."""

from dataclasses import asdict, dataclass

import numpy as np
from pydrake.systems.framework import BasicVector, Context, ContinuousState, LeafSystem

from drake_nonstop.compiled import CompiledFunction
from drake_nonstop.mechanics.carrier import pid_forces
from drake_nonstop.system import Model
from drake_nonstop.validation import require_non_negative


@dataclass(kw_only=True)
class CarrierPidConfig:
    """Gains on each axis; the paper prints 1000 and 1.5 and names no integral gain."""

    position_gain: float = 1000.0  # N/m
    velocity_gain: float = 10.0  # N s/m; 1.5 as printed is a damping ratio of 0.075
    integral_gain: float = 0.0  # N/(m s)


class CarrierPid(LeafSystem):
    """u = K_p (p_d − p) + K_d (v_d − v) + K_i ∫(p_d − p), for every carrier.

    .. pydrake_system::

        name: CarrierPid
        input_ports:
        - carrier_reference
        - carrier_state
        output_ports:
        - carrier_forces

    `carrier_reference` and `carrier_state` (6n) = [positions, velocities], in W;
    `carrier_forces` (3n) in N, in W. The integrals are the state, where their gain is
    not zero.

    Raises:
        ScenarioError: a gain is negative or not finite.
    """

    def __init__(self, model: Model, config: CarrierPidConfig | None = None):
        super().__init__()
        config = config or CarrierPidConfig()
        require_non_negative("carrier_controller", **asdict(config))
        n = model.n
        self._n = n
        self._no_integral = np.zeros(3 * n)
        self._forces = CompiledFunction(
            lambda reference, state, integral: pid_forces(
                reference, state, integral, **asdict(config)
            ),
            [6 * n, 6 * n, 3 * n],
            name=self.get_name,
        )
        self._carrier_reference = self.DeclareVectorInputPort("carrier_reference", 6 * n)
        self._carrier_state = self.DeclareVectorInputPort("carrier_state", 6 * n)
        prerequisites = {self.all_input_ports_ticket()}
        self._integrates = config.integral_gain > 0
        if self._integrates:
            self.DeclareContinuousState(3 * n)
            prerequisites.add(self.xc_ticket())
        self.DeclareVectorOutputPort("carrier_forces", 3 * n, self._calc_forces, prerequisites)

    def _calc_forces(self, context: Context, output: BasicVector) -> None:
        integral = self._no_integral
        if self._integrates:
            integral = context.get_continuous_state_vector().CopyToVector()
        (forces,) = self._forces(
            self._carrier_reference.Eval(context), self._carrier_state.Eval(context), integral
        )
        output.SetFromVector(forces)

    def DoCalcTimeDerivatives(self, context: Context, derivatives: ContinuousState) -> None:
        if not self._integrates:
            return
        half = 3 * self._n
        error = (
            self._carrier_reference.Eval(context)[:half] - self._carrier_state.Eval(context)[:half]
        )
        derivatives.get_mutable_vector().SetFromVector(error)
