"""Box "phase" of the internal forces, in the paper a part of their trajectories."""

from dataclasses import dataclass

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, State
from pydrake.systems.primitives import Integrator, MatrixGain

from drake_nonstop.mechanics.signals import PARAMETERS_SIZE, PHASE_SIZE
from drake_nonstop.model.system import Model
from drake_nonstop.systems.block import DiagramBlock, InnerBlock, LeafBlock
from drake_nonstop.validation import StrictFields


@dataclass(kw_only=True)
class AccumulatedPhaseConfig(StrictFields):
    """No parameters."""


class AccumulatedPhase(DiagramBlock):
    """θ̇ = ξ: the phase is continuous, also where ξ jumps.

    The paper's cos(ξ(t) t + φ), that of `PaperPhase`, jumps by t Δξ when ξ changes.

    .. pydrake_system::

        name: AccumulatedPhase
        input_ports:
        - parameters
        output_ports:
        - phase

    `parameters` (2) = [ξ (rad/s), A (N)]; `phase` (2) = [θ (rad), ∂θ/∂ξ = 0 (s)] is
    the state: continuous, or stepped at each sample where the model has a control period.
    """

    is_sampled = True

    def __init__(self, model: Model, config: AccumulatedPhaseConfig | None = None):
        super().__init__()
        builder = DiagramBuilder()
        if model.control_period > 0:
            state = builder.AddNamedSystem("state", _SteppedPhase(model.control_period))
            parameters = state.get_input_port()
        else:
            rate = builder.AddNamedSystem("rate", MatrixGain(np.diag([1.0, 0.0])))
            state = builder.AddNamedSystem("state", Integrator(PHASE_SIZE))
            builder.Connect(rate.get_output_port(), state.get_input_port())
            parameters = rate.get_input_port()
        builder.ExportInput(parameters, "parameters")
        builder.ExportOutput(state.get_output_port(), "phase")
        builder.BuildInto(self)


class _SteppedPhase(InnerBlock):
    """The phase at samples, of the parameters."""

    def __init__(self, period: float):
        super().__init__()
        self._period = period
        self._parameters = self.DeclareVectorInputPort("parameters", PARAMETERS_SIZE)
        self.DeclareStateOutputPort("phase", self.DeclareDiscreteState(PHASE_SIZE))
        # Unrestricted, because Drake runs these before the discrete updates: θ steps
        # with the ξ of the interval that ends, and the optimization layer, which
        # updates at the same instant, reads the stepped phase.
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, period, self._step)

    def _step(self, context: Context, state: State) -> None:
        angle, slope = context.get_discrete_state_vector().CopyToVector()
        frequency, _ = self._parameters.Eval(context)
        state.get_mutable_discrete_state().set_value([angle + self._period * frequency, slope])


@dataclass(kw_only=True)
class PaperPhaseConfig(StrictFields):
    """No parameters."""


class PaperPhase(LeafBlock):
    """θ = ξ(t) t with the current frequency ξ, as printed in the paper (eq. 23).

    .. pydrake_system::

        name: PaperPhase
        input_ports:
        - parameters
        - sample_time (where the model has a control period)
        output_ports:
        - phase

    `parameters` (2) = [ξ (rad/s), A (N)]; `phase` (2) = [θ = ξ t (rad), ∂θ/∂ξ = t (s)].
    Behind a sampled controller t is the `sample_time` (1), in s.
    """

    is_sampled = True

    def __init__(self, model: Model, config: PaperPhaseConfig | None = None):
        super().__init__()
        self._parameters = self.DeclareVectorInputPort("parameters", PARAMETERS_SIZE)
        self._sample_time = None
        prerequisites = {self.all_input_ports_ticket()}
        if model.control_period > 0:
            self._sample_time = self.DeclareVectorInputPort("sample_time", 1)
        else:
            prerequisites.add(self.time_ticket())
        self.DeclareVectorOutputPort("phase", PHASE_SIZE, self._calc_phase, prerequisites)

    def _calc_phase(self, context: Context, output: BasicVector) -> None:
        time = context.get_time()
        if self._sample_time is not None:
            time = self._sample_time.Eval(context)[0]
        frequency, _ = self._parameters.Eval(context)
        output.SetFromVector([frequency * time, time])


# The blocks that the box can be, the default first.
VARIANTS = (AccumulatedPhase, PaperPhase)
