"""Box "load_disturbance": the wrench on the load besides cables and gravity."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
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


_BANDS: dict[str, Any] = {"count": 32, "highest": 30.0}  # of the gust's waves


class _Push(NamedTuple):
    """Numbers of a `DisturbanceForce`."""

    wrench: NDArray  # (6,), N m and N, in W
    start_time: float  # s
    gust: float  # N
    waves: Any  # of the gust

    @classmethod
    def of(cls, config: DisturbanceForceConfig) -> "_Push":
        """Those of a config."""
        require_ranges(_BOX, config)
        waves = random_waves(np.random.default_rng(config.seed), 3, config.gust_time, **_BANDS)
        wrench = np.array([*config.torque, *config.force], float)
        return cls(wrench, config.start_time, config.gust_force, waves)


class DisturbanceForce(LeafBlock):
    """A constant wrench on the load, with a seeded, coloured gust.

    The gust is that of `mechanics.wind` with 32 waves on each axis, up to ωτ = 30: a
    function of time alone, so that runs repeat to the bit whatever the integrator's steps are.
    Its numbers are a parameter of the context, which `take_config` sets.

    Raises:
        ScenarioError: a field is out of range.
    """

    makes = ("disturbance_wrench",)
    is_sampled = True

    def __init__(self, model: Model, config: DisturbanceForceConfig | None = None):
        super().__init__()
        config = config or DisturbanceForceConfig()
        self._push = self.DeclareAbstractParameter(Value(_Push.of(config)))
        frequencies = wave_frequencies(config.gust_time, **_BANDS)
        gusts = Gusts(np.repeat([0.0, config.gust_force], 3), frequencies)
        self._described = LoadWrench(np.array([*config.torque, *config.force], float), gusts)
        tickets = {self.time_ticket(), self.all_parameters_ticket()}
        self.DeclareVectorOutputPort("disturbance_wrench", WRENCH_SIZE, self._calc, tickets)

    def describe_response(self) -> LoadWrench:
        return self._described

    def take_config(self, context: Context, config: DisturbanceForceConfig) -> None:
        """Sets its numbers in a context of its own.

        Raises:
            ScenarioError: a field is out of range.
        """
        context.get_mutable_abstract_parameter(self._push).set_value(_Push.of(config))

    def _calc(self, context: Context, output: BasicVector) -> None:
        times = np.array([context.get_time()])
        (rows,) = self.precomputed_outputs(["disturbance_wrench"], times, context)
        output.SetFromVector(rows[0])

    def precomputed_outputs(
        self, ports: Sequence[str], times: NDArray, context: Context
    ) -> list[NDArray]:
        """Values of the port `disturbance_wrench` at times (k,) in s, (k, 6)."""
        push: _Push = context.get_abstract_parameter(self._push).get_value()
        forces = coloured_noise(times[:, None, None], push.waves, push.gust)
        wrenches = push.wrench + np.column_stack([np.zeros((len(times), 3)), forces])
        instants = times if times.dtype == float else np.array([number(time) for time in times])
        has_begun = instants >= push.start_time
        wrenches = np.where(has_begun[:, None], wrenches, 0.0)
        return [wrenches for _ in ports]


VARIANTS = (NoDisturbance, DisturbanceForce)

__all__ = ["NoDisturbance", "NoDisturbanceConfig", "DisturbanceForce", "DisturbanceForceConfig"]
