"""Box "load_disturbance": the wrench on the load besides cables and gravity."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.signals import WRENCH_SIZE
from drake_nonstop.mechanics.wind import random_waves
from drake_nonstop.model.block import Block, BlockParameters
from drake_nonstop.model.system import Model
from drake_nonstop.systems.tracing import where
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


@dataclass(kw_only=True)
class DisturbanceForceConfig(StrictFields):
    """A constant force, and a gust on top of it."""

    force: list[float] = vector([0.0, 0.0, 0.0], "in W")  # N, in W
    torque: list[float] = vector([0.0, 0.0, 0.0], "in W")  # N m, in W
    start_time: float = non_negative(0.0)  # s, nothing before it
    gust_force: float = non_negative(0.0)  # N, standard deviation on each axis
    gust_time: float = checked(1.0, require_period)  # s, correlation time of the gust
    seed: int = checked(0, require_seed)  # of the gust


class DisturbanceForce(Block):
    """A constant wrench on the load, with a seeded, coloured gust.

    The gust is that of `mechanics.wind` with 32 waves on each axis, up to ωτ = 30: a
    function of time alone, so that runs repeat to the bit whatever the integrator's steps are.

    Raises:
        ScenarioError: a field is out of range.
    """

    makes = ("disturbance_wrench",)
    is_sampled = True
    reads_time = True

    def __init__(self, model: Model, config: DisturbanceForceConfig | None = None):
        super().__init__(model, config)
        random = np.random.default_rng(self.config.seed)
        self._waves = random_waves(random, 3, self.config.gust_time, count=32, highest=30.0)

    @staticmethod
    def equations(
        noise: NDArray,
        time: NDArray,
        *,
        force: NDArray,
        torque: NDArray,
        start_time: NDArray,
        gust_force: NDArray,
    ) -> NDArray:
        """The noise (3,) is of variance 1."""
        wrench = np.concatenate([torque, force + gust_force * noise])
        return where(time[0] >= start_time[0], wrench, np.zeros(WRENCH_SIZE))

    @classmethod
    def check(cls, model: Model, config: DisturbanceForceConfig) -> None:
        require_ranges(_BOX, config)

    def block_parameters(self, model: Model, config: DisturbanceForceConfig) -> BlockParameters:
        own = ("force", "torque", "start_time", "gust_force")
        return BlockParameters(model, self.system, config=config, own=own)

    def quantities(self, model: Model) -> Mapping[str, int]:
        return {"noise": 3}

    def precomputed_inputs(self, names: Sequence[str], times: NDArray) -> list[NDArray]:
        """The gust's noise (k, 3) of variance 1 at times (k,) in s."""
        return [self._waves.at(times) for _ in names]

    def precomputed_input_rates(self, names: Sequence[str], times: NDArray) -> list[NDArray]:
        """Its rates, 1/s."""
        return [self._waves.at(times, order=1) for _ in names]


VARIANTS = (NoDisturbance, DisturbanceForce)
