"""The dynamics half of box "Carrier Controller + Dynamics", for carriers without any."""

from dataclasses import dataclass

from pydrake.systems.primitives import Selector

from drake_nonstop.block import BlockType
from drake_nonstop.system import Model
from drake_nonstop.traced_block import stacking


@dataclass(kw_only=True)
class IdealCarriersConfig:
    """No parameters."""


class IdealCarriers(Selector, metaclass=BlockType):
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
        super().__init__(stacking({"carrier_reference": 6 * model.n}, "carrier_state"))
