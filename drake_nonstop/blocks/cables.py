"""Box "Cable Forces" of the figure."""

from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from drake_nonstop.blocks.lumped_cables import (
    LumpedCables,
    LumpedCablesConfig,  # noqa: F401
    require_stretch,
    tell_of_equilibrium,
)
from drake_nonstop.mechanics.cable import cable_forces_and_tensions
from drake_nonstop.model.block import Block
from drake_nonstop.model.system import Model
from drake_nonstop.validation import StrictFields


@dataclass(kw_only=True)
class CablesConfig(StrictFields):
    """No parameters: length, stiffness and damping are the system's."""


class Cables(Block):
    """Cables of the system's length, stiffness and damping, alike or each with its own.

    Massless, tension-only spring-dampers (eq. 4), see `mechanics.cable`.

    Raises:
        ScenarioError: the simulated stiffness is not finite.
    """

    reads = ("load_state", "carrier_state")
    makes = ("cable_forces", "carrier_cable_forces", "tensions")
    system = ("attachments", "cable_length", "cable_stiffness", "cable_damping")
    tell_start = tell_of_equilibrium

    @staticmethod
    def equations(
        load_state: NDArray,
        carrier_state: NDArray,
        *,
        attachments: NDArray,
        cable_length: NDArray,
        cable_stiffness: NDArray,
        cable_damping: NDArray,
    ) -> tuple[NDArray, ...]:
        forces, tensions = cable_forces_and_tensions(
            load_state,
            carrier_state,
            attachments=attachments,
            rest_length=cable_length,
            stiffness=cable_stiffness,
            damping=cable_damping,
        )
        return forces, forces, tensions

    @classmethod
    def check(cls, model: Model, config: Any) -> None:
        require_stretch(model)


VARIANTS = (Cables, LumpedCables)
