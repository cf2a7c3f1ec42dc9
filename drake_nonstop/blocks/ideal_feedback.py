"""Box "load_feedback": the plain wire of the paper's figure."""

from dataclasses import dataclass

from pydrake.systems.framework import BasicVector, Context

from drake_nonstop.leaf_block import LeafBlock
from drake_nonstop.system import Model


@dataclass(kw_only=True)
class IdealFeedbackConfig:
    """No parameters."""


class IdealFeedback(LeafBlock):
    """Passes the load's state on, unchanged and at once.

    .. pydrake_system::

        name: IdealFeedback
        input_ports:
        - load_state
        output_ports:
        - measured_load_state

    Both (13): [quaternion, position, angular velocity, velocity], in W.
    """

    def __init__(self, model: Model, config: IdealFeedbackConfig | None = None):
        super().__init__()
        self._load_state = self.DeclareVectorInputPort("load_state", 13)
        self.DeclareVectorOutputPort(
            "measured_load_state", 13, self._calc, {self.all_input_ports_ticket()}
        )

    def _calc(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._load_state.Eval(context))
