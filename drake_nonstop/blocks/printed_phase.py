"""The phase of the internal forces, as the paper prints it."""

from dataclasses import dataclass

from pydrake.systems.framework import BasicVector, Context

from drake_nonstop.block import LeafBlock
from drake_nonstop.system import Model


@dataclass(kw_only=True)
class PrintedPhaseConfig:
    """No parameters."""


class PrintedPhase(LeafBlock):
    """θ = ξ(t) t (eq. 23), for the current frequency ξ.

    .. pydrake_system::

        name: PrintedPhase
        input_ports:
        - parameters
        - sample_time (where the model has a control period)
        output_ports:
        - phase

    `parameters` (2) = [ξ (rad/s), A (N)]; `phase` (2) = [θ = ξ t (rad), ∂θ/∂ξ = t (s)].
    Behind a sampled controller t is the sample's time.
    """

    def __init__(self, model: Model, config: PrintedPhaseConfig | None = None):
        super().__init__()
        self._parameters = self.DeclareVectorInputPort("parameters", 2)
        self._sample_time = None
        prerequisites = {self.all_input_ports_ticket()}
        if model.control_period > 0:
            self._sample_time = self.DeclareVectorInputPort("sample_time", 1)
        else:
            prerequisites.add(self.time_ticket())
        self.DeclareVectorOutputPort("phase", 2, self._calc_phase, prerequisites)

    def _calc_phase(self, context: Context, output: BasicVector) -> None:
        time = context.get_time()
        if self._sample_time is not None:
            time = self._sample_time.Eval(context)[0]
        output.SetFromVector([self._parameters.Eval(context)[0] * time, time])
