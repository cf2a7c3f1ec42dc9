"""What varies from update to update of the nonstop problem, in one flat vector with named parts."""

from itertools import accumulate
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.rigid_load import RigidLoad
from drake_nonstop.mechanics.signals import (
    LOAD_REFERENCE_SIZE,
    LOAD_STATE_SIZE,
    PARAMETERS_SIZE,
    PHASE_SIZE,
    WIND_SIZE,
    WRENCH_SIZE,
)
from drake_nonstop.model.system import Model
from drake_nonstop.optimization.problem_config import LimitsConfig, amplitude_range


class UpdateData(NamedTuple):
    """The parts of the data of one update, all in W.

    `np.concatenate` of an instance is the flat vector that the traced functions take, and `view` of
    that gives the parts. The parts are for reading: some are shared between updates. The numbers of
    `beliefs` are those of its view as `Beliefs`.
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
    wind: NDArray  # (3,), m/s, of aircraft; it does not count for other carriers
    beliefs: NDArray  # what the controllers believe, a flat `Beliefs`; (0,): what the solver does

    @classmethod
    def view(cls, vector: NDArray) -> "UpdateData":
        """The parts of a flat vector, of numbers or symbols: views, not copies."""
        return cls._make([*(vector[part] for part in _PARTS), vector[_ENDS[-1] :]])


class Beliefs(NamedTuple):
    """Numbers of the controllers' model and of the problem that may change between updates."""

    load_mass: NDArray  # (1,), kg
    load_inertia: NDArray  # (9,), kg m², in L, row by row
    load_drag: NDArray  # (1,), N s/m
    load_angular_drag: NDArray  # (1,), N m s/rad
    gravity: NDArray  # (1,), m/s²
    rest_length: NDArray  # (1,), m
    compliance: NDArray  # (1,), m/N
    nominal: NDArray  # (2,), [ξ, A] at the start, rad/s and N
    lower: NDArray  # (2,), bounds of [ξ, A]
    upper: NDArray  # (2,)
    offset: NDArray  # (3n,), N, in L, of the pattern; (0,) where it has none

    @property
    def load(self) -> RigidLoad:
        """The load, of numbers or symbols."""
        return RigidLoad(
            mass=self.load_mass,
            inertia=self.load_inertia.reshape(3, 3),
            drag=self.load_drag,
            angular_drag=self.load_angular_drag,
            gravity=self.gravity,
        )

    @property
    def cables(self) -> dict[str, NDArray]:
        """The numbers of the cables, as equations take them."""
        return {"rest_length": self.rest_length, "compliance": self.compliance}

    @classmethod
    def view(cls, vector: NDArray) -> "Beliefs":
        """The parts of a flat vector, of numbers or symbols: views, not copies."""
        end = _BELIEFS[-1].stop
        return cls._make([*(vector[part] for part in _BELIEFS), vector[end:]])


_SIZES = (  # of the parts, in their order
    PARAMETERS_SIZE,
    PHASE_SIZE,
    LOAD_STATE_SIZE,
    LOAD_REFERENCE_SIZE,
    WRENCH_SIZE,
    WRENCH_SIZE,
    WRENCH_SIZE,
    *(1 for _ in ("speed_bound", "speed_unit", "orbit_turn", "anchor_weight")),
    WIND_SIZE,
)
_ENDS = list(accumulate(_SIZES))
_PARTS = [slice(end - size, end) for size, end in zip(_SIZES, _ENDS, strict=True)]
_BELIEF_ENDS = [1, 10, 11, 12, 13, 14, 15, 17, 19, 21]
_BELIEFS = [slice(a, b) for a, b in zip([0, *_BELIEF_ENDS], _BELIEF_ENDS, strict=False)]


def update_data_size(offset_size: int) -> int:
    """The size of an `UpdateData` with an offset of that size."""
    return _ENDS[-1] + _BELIEF_ENDS[-1] + offset_size


def beliefs_of(model: Model, config: LimitsConfig) -> Beliefs:
    """Those of a model and a config."""
    system = model.system
    lower, upper = np.transpose([config.frequency_bounds, amplitude_range(config, model)])
    return Beliefs(
        load_mass=np.array([system.load_mass]),
        load_inertia=np.array(system.load_inertia, float).ravel(),
        load_drag=np.array([system.load_drag]),
        load_angular_drag=np.array([system.load_angular_drag]),
        gravity=np.array([system.gravity]),
        rest_length=np.array([system.cable_length]),
        compliance=np.array([model.cable_compliance]),
        nominal=np.array([config.frequency, config.amplitude]),
        lower=lower,
        upper=upper,
        offset=model.pattern.offset if model.offset_parameter else np.zeros(0),
    )
