"""Box "load_disturbance": the wrench on the load besides cables and gravity."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import BasicVector, Context

from drake_nonstop.mechanics.signals import WRENCH_SIZE
from drake_nonstop.mechanics.wind import (
    coloured_noise,
    random_waves,
    wave_frequencies,
)
from drake_nonstop.model.block import Block
from drake_nonstop.model.descriptions import Gusts, LoadWrench
from drake_nonstop.model.system import Model
from drake_nonstop.systems.block import LeafBlock, number
from drake_nonstop.validation import (
    StrictFields,
    checked,
    non_negative,
    require_period,
    require_ranges,
    require_seed,
    vector,
)

_BOX = "load_disturbance"


@dataclass(kw_only=True)
class NoDisturbanceConfig(StrictFields):
    """No parameters."""


class NoDisturbance(Block):
    """Only cables and gravity act on the load."""

    makes = ("disturbance_wrench",)
    is_sampled = True

    @staticmethod
    def equations() -> NDArray:
        return np.zeros(WRENCH_SIZE)

    def describe_response(self) -> LoadWrench:
        return LoadWrench()


@dataclass(kw_only=True)
class DisturbanceForceConfig(StrictFields):
    """A constant force, and a gust on top of it."""

    force: list[float] = vector([0.0, 0.0, 0.0], "in W")  # N, in W
    torque: list[float] = vector([0.0, 0.0, 0.0], "in W")  # N m, in W
    start_time: float = non_negative(0.0)  # s, nothing before it
    gust_force: float = non_negative(0.0)  # N, standard deviation on each axis
    gust_time: float = checked(1.0, require_period)  # s, correlation time of the gust
    seed: int = checked(0, require_seed)  # of the gust


class DisturbanceForce(LeafBlock):
    """A constant wrench on the load, with a seeded, coloured gust.

    The gust is that of `mechanics.wind` with 32 waves on each axis, up to ωτ = 30: a
    function of time alone, so that runs repeat to the bit whatever the integrator's steps are.

    Raises:
        ScenarioError: a field is out of range.
    """

    makes = ("disturbance_wrench",)
    is_sampled = True

    def __init__(self, model: Model, config: DisturbanceForceConfig | None = None):
        super().__init__()
        config = require_ranges(_BOX, config or DisturbanceForceConfig())
        self._wrench = np.array([*config.torque, *config.force], float)
        self._start_time = config.start_time
        random = np.random.default_rng(config.seed)
        bands: dict[str, Any] = {"count": 32, "highest": 30.0}
        self._waves = random_waves(random, 3, config.gust_time, **bands)
        self._gust = config.gust_force
        frequencies = wave_frequencies(config.gust_time, **bands)
        self._gusts = Gusts(np.repeat([0.0, self._gust], 3), frequencies)
        ticket = self.time_ticket()
        self.DeclareVectorOutputPort("disturbance_wrench", WRENCH_SIZE, self._calc, {ticket})

    def describe_response(self) -> LoadWrench:
        return LoadWrench(self._wrench, self._gusts)

    def _calc(self, context: Context, output: BasicVector) -> None:
        (rows,) = self.precomputed_outputs(["disturbance_wrench"], np.array([context.get_time()]))
        output.SetFromVector(rows[0])

    def precomputed_outputs(self, ports: Sequence[str], times: NDArray) -> list[NDArray]:
        """Values of the port `disturbance_wrench` at times (k,) in s, (k, 6)."""
        forces = coloured_noise(times[:, None, None], self._waves, self._gust)
        wrenches = self._wrench + np.column_stack([np.zeros((len(times), 3)), forces])
        has_begun = np.array([number(time) >= self._start_time for time in times])
        wrenches = np.where(has_begun[:, None], wrenches, 0.0)
        return [wrenches for _ in ports]


VARIANTS = (NoDisturbance, DisturbanceForce)

__all__ = ["NoDisturbance", "NoDisturbanceConfig", "DisturbanceForce", "DisturbanceForceConfig"]
