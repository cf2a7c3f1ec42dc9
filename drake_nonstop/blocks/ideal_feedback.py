"""Box "load_feedback": the plain wire of the paper's figure."""

from dataclasses import dataclass

from pydrake.systems.primitives import Selector

from drake_nonstop.block import BlockType
from drake_nonstop.system import Model
from drake_nonstop.traced_block import stacking


@dataclass(kw_only=True)
class IdealFeedbackConfig:
    """No parameters."""


class IdealFeedback(Selector, metaclass=BlockType):
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
        super().__init__(stacking({"load_state": 13}, "measured_load_state"))
