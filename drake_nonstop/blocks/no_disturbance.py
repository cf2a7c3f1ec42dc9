"""Box "load_disturbance": none."""

from dataclasses import dataclass

import numpy as np
from pydrake.systems.framework import BasicVector, Context

from drake_nonstop.block import LeafBlock
from drake_nonstop.system import Model


@dataclass(kw_only=True)
class NoDisturbanceConfig:
    """No parameters."""


class NoDisturbance(LeafBlock):
    """No wrench on the load but that of the cables and gravity.

    .. pydrake_system::

        name: NoDisturbance
        output_ports:
        - disturbance_wrench

    `disturbance_wrench` (6): [torque; force] at the centre of mass, in W: zero.
    """

    def __init__(self, model: Model, config: NoDisturbanceConfig | None = None):
        super().__init__()
        self.DeclareVectorOutputPort("disturbance_wrench", 6, self._calc, {self.nothing_ticket()})

    def _calc(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.zeros(6))
