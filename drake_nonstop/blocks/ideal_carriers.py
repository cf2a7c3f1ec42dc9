"""The dynamics half of box "Carrier Controller + Dynamics", for carriers without any."""

from dataclasses import dataclass

from pydrake.systems.framework import BasicVector, Context

from drake_nonstop.leaf_block import LeafBlock
from drake_nonstop.system import Model


@dataclass(kw_only=True)
class IdealCarriersConfig:
    """No parameters."""


class IdealCarriers(LeafBlock):
    """Ideal tracking: the carriers are always where they should be, whatever steers them.

    What is left of the load's error with them is none of the carriers' fault. Behind sampled
    controllers their references are no smooth motion: they jump a little at every sample.

    .. pydrake_system::

        name: IdealCarriers
        input_ports:
        - carrier_reference
        output_ports:
        - carrier_state

    Both (6n) = [positions, velocities], in W.
    """

    def __init__(self, model: Model, config: IdealCarriersConfig | None = None):
        super().__init__()
        self._carrier_reference = self.DeclareVectorInputPort("carrier_reference", 6 * model.n)
        self.DeclareVectorOutputPort(
            "carrier_state", 6 * model.n, self._calc, {self.all_input_ports_ticket()}
        )

    def _calc(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._carrier_reference.Eval(context))
