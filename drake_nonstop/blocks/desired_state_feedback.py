"""Box "load_feedback", opened: the controllers see the desired state."""

from dataclasses import dataclass

from pydrake.systems.framework import BasicVector, Context

from drake_nonstop.block import LeafBlock
from drake_nonstop.system import Model


@dataclass(kw_only=True)
class DesiredStateFeedbackConfig:
    """No parameters."""


class DesiredStateFeedback(LeafBlock):
    """Opens the loop: what the controllers take for the load's state is its reference.

    With it the wrench controller asks for the wrench of the desired motion alone, which
    is the open-loop method that the paper starts from.

    .. pydrake_system::

        name: DesiredStateFeedback
        input_ports:
        - reference
        output_ports:
        - measured_load_state

    `measured_load_state` (13) is the first part of `reference` (22).
    """

    def __init__(self, model: Model, config: DesiredStateFeedbackConfig | None = None):
        super().__init__()
        self._reference = self.DeclareVectorInputPort("reference", 22)
        self.DeclareVectorOutputPort(
            "measured_load_state", 13, self._calc, {self.all_input_ports_ticket()}
        )

    def _calc(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._reference.Eval(context)[:13])
