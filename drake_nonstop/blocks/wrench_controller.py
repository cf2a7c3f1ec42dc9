"""Box "Load Wrench Controller" of the figure."""

from dataclasses import asdict, dataclass

from numpy.typing import NDArray
from pydrake.common.value import AbstractValue, Value
from pydrake.systems.framework import (
    BasicVector,
    Context,
    ContinuousState,
    DiscreteValues,
    LeafSystem,
    ValueProducer,
)

from drake_nonstop.compiled import CompiledFunction
from drake_nonstop.mechanics import wrench
from drake_nonstop.system import Model
from drake_nonstop.validation import require_non_negative


@dataclass(kw_only=True)
class WrenchControllerConfig:
    """The paper's gains (Table I), and the feedforward that its equations leave out."""

    position_gain: float = 5.0  # N/m, K_p
    velocity_gain: float = 2.0  # N s/m, K_v
    position_integral_gain: float = 0.9  # N/(m s), K_i
    orientation_gain: float = 0.5  # N m, K_R
    angular_velocity_gain: float = 0.06  # N m s, K_omega
    orientation_integral_gain: float = 0.1  # N m/s, K_iR
    feedforward: float = 1.0  # weight of the reference's own wrench; 0: as printed


class WrenchController(LeafSystem):
    """PID on the load's pose with feedforward, and the exact rate of its wrench.

    Equations 14-15 and `mechanics.wrench`. The integrals are the block's state:
    continuous, or discrete where the model has a control period.

    .. pydrake_system::

        name: WrenchController
        input_ports:
        - measured_load_state
        - reference
        output_ports:
        - wrench
        - wrench_rate
        - tracking_error

    `measured_load_state` (13) and `reference` (22) as everywhere, in W; `wrench` and
    `wrench_rate` (6) are [torque; force] at the centre of mass, in W; `tracking_error`
    (12) is [e_R, e_p, e_ω, e_v].

    Raises:
        ScenarioError: a gain is negative or not finite.
    """

    def __init__(self, model: Model, config: WrenchControllerConfig | None = None):
        super().__init__()
        config = config or WrenchControllerConfig()
        require_non_negative("wrench_controller", **asdict(config))

        def outputs(state: NDArray, reference: NDArray, integrals: NDArray) -> tuple:
            return (
                *wrench.wrench_and_rate(
                    state,
                    reference,
                    integrals,
                    **asdict(config),
                    mass=model.load_mass,
                    inertia=model.load_inertia,
                    inertia_inverse=model.load_inertia_inverse,
                    drag=model.load_drag,
                    angular_drag=model.load_angular_drag,
                    gravity=model.gravity,
                ),
                wrench.tracking_error(state, reference),
            )

        self._control = CompiledFunction(outputs, [13, 22, 6], name=self.get_name)
        self._measured_load_state = self.DeclareVectorInputPort("measured_load_state", 13)
        self._reference = self.DeclareVectorInputPort("reference", 22)
        self._period = model.control_period
        if self._period > 0:
            index = self.DeclareDiscreteState(6)
            self.DeclarePeriodicDiscreteUpdateEvent(
                self._period, self._period, self._update_integrals
            )
            state = self.discrete_state_ticket(index)
        else:
            self.DeclareContinuousState(6)
            state = self.xc_ticket()
        self._result = self.DeclareCacheEntry(
            "wrench, its rate and the error",
            ValueProducer(Value(()).Clone, self._calc),
            {self.all_input_ports_ticket(), state},
        )
        result = {self._result.ticket()}
        self.DeclareVectorOutputPort("wrench", 6, self._calc_wrench, result)
        self.DeclareVectorOutputPort("wrench_rate", 6, self._calc_wrench_rate, result)
        self.DeclareVectorOutputPort("tracking_error", 12, self._calc_tracking_error, result)

    def _integrals(self, context: Context) -> NDArray:
        if self._period > 0:
            return context.get_discrete_state_vector().value()
        return context.get_continuous_state_vector().CopyToVector()

    def _calc(self, context: Context, value: AbstractValue) -> None:
        results = self._control(
            self._measured_load_state.Eval(context),
            self._reference.Eval(context),
            self._integrals(context),
        )
        value.set_value(tuple(result.copy() for result in results))

    def _calc_wrench(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._result.Eval(context)[0])

    def _calc_wrench_rate(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._result.Eval(context)[1])

    def _calc_tracking_error(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._result.Eval(context)[2])

    def DoCalcTimeDerivatives(self, context: Context, derivatives: ContinuousState) -> None:
        if self._period == 0:
            derivatives.get_mutable_vector().SetFromVector(self._result.Eval(context)[2][:6])

    def _update_integrals(self, context: Context, discrete_state: DiscreteValues) -> None:
        error = self._result.Eval(context)[2][:6]
        discrete_state.set_value(self._integrals(context) + self._period * error)
