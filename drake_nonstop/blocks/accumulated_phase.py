"""The phase of the internal forces, accumulated."""

from dataclasses import dataclass

from numpy.typing import NDArray
from pydrake.systems.framework import (
    BasicVector,
    Context,
    ContinuousState,
    State,
)

from drake_nonstop.block import LeafBlock
from drake_nonstop.system import Model


@dataclass(kw_only=True)
class AccumulatedPhaseConfig:
    """No parameters."""


class AccumulatedPhase(LeafBlock):
    """θ̇ = ξ: the phase goes on smoothly whatever ξ does.

    The paper prints cos(ξ(t) t + φ), which jumps by t Δξ when ξ changes; `PrintedPhase`
    is that.

    .. pydrake_system::

        name: AccumulatedPhase
        input_ports:
        - parameters
        output_ports:
        - phase

    `parameters` (2) = [ξ (rad/s), A (N)]; `phase` (2) = [θ (rad), ∂θ/∂ξ = 0 (s)]. θ is
    the state: continuous, or stepped at each sample where the model has a control period.
    """

    def __init__(self, model: Model, config: AccumulatedPhaseConfig | None = None):
        super().__init__()
        self._parameters = self.DeclareVectorInputPort("parameters", 2)
        self._period = model.control_period
        if self._period > 0:
            state = self.discrete_state_ticket(self.DeclareDiscreteState(1))
            # Unrestricted, because Drake runs these before the discrete updates: θ steps
            # with the ξ of the interval that ends, and the optimization layer, which
            # updates at the same instant, reads the stepped phase.
            self.DeclarePeriodicUnrestrictedUpdateEvent(self._period, self._period, self._step)
        else:
            self.DeclareContinuousState(1)
            state = self.xc_ticket()
        self.DeclareVectorOutputPort("phase", 2, self._calc_phase, {state})

    def _calc_phase(self, context: Context, output: BasicVector) -> None:
        if self._period > 0:
            angle = context.get_discrete_state_vector().GetAtIndex(0)
        else:
            angle = context.get_continuous_state_vector().GetAtIndex(0)
        output.SetFromVector([angle, 0.0])

    def _frequency(self, context: Context) -> NDArray:
        return self._parameters.Eval(context)[:1]

    def DoCalcTimeDerivatives(self, context: Context, derivatives: ContinuousState) -> None:
        if self._period == 0:
            derivatives.get_mutable_vector().SetFromVector(self._frequency(context))

    def _step(self, context: Context, state: State) -> None:
        angle = context.get_discrete_state_vector().value()
        state.get_mutable_discrete_state().set_value(
            angle + self._period * self._frequency(context)
        )
