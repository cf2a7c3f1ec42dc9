"""What varies from update to update of the nonstop problem, in one flat vector with named parts."""

from itertools import accumulate
from typing import NamedTuple

from numpy.typing import NDArray

from drake_nonstop.mechanics.signals import (
    LOAD_REFERENCE_SIZE,
    LOAD_STATE_SIZE,
    PARAMETERS_SIZE,
    PHASE_SIZE,
    WRENCH_SIZE,
)


class UpdateData(NamedTuple):
    """The parts of the data of one update, all in W.

    `np.concatenate` of an instance is the flat vector that the traced functions take, and `view` of
    that gives the parts. The parts are for reading: some are shared between updates.
    """

    previous: NDArray  # (2,), [ξ⁻, A⁻], rad/s and N
    phase: NDArray  # (2,), [θ, ∂θ/∂ξ], rad and s
    load_state: NDArray  # (13,)
    reference: NDArray  # (22,)
    wrench: NDArray  # (6,), N m and N
    wrench_rate: NDArray  # (6,)
    wrench_second_rate: NDArray  # (6,)
    speed_bound: NDArray  # (1,), m/s, tightened
    speed_unit: NDArray  # (1,), m/s, scales the margins of the speed bound
    orbit_turn: NDArray  # (1,), rad, added to the phases of the orbit ahead
    anchor_weight: NDArray  # (1,)

    @classmethod
    def view(cls, vector: NDArray) -> "UpdateData":
        """The parts of a flat vector (61,), of numbers or symbols: views, not copies."""
        return cls(*[vector[part] for part in _PARTS])


_SIZES = (  # of the parts, in their order
    PARAMETERS_SIZE,
    PHASE_SIZE,
    LOAD_STATE_SIZE,
    LOAD_REFERENCE_SIZE,
    WRENCH_SIZE,
    WRENCH_SIZE,
    WRENCH_SIZE,
    *(1 for _ in ("speed_bound", "speed_unit", "orbit_turn", "anchor_weight")),
)
_ENDS = list(accumulate(_SIZES))
_PARTS = [slice(end - size, end) for size, end in zip(_SIZES, _ENDS, strict=True)]
UPDATE_DATA_SIZE = _ENDS[-1]
