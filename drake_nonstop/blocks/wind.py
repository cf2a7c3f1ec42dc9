"""Box "wind": how the air moves at carriers and load.

The wind acts on the load by its drag, and on carriers that are aircraft. The other carriers of the
box "carrier_dynamics" have no aerodynamics, and do not feel it.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.signals import WIND_SIZE
from drake_nonstop.mechanics.wind import (
    FOOT,
    GUST_STEP,
    gust_samples,
    risen_share,
    turbulence_at,
)
from drake_nonstop.model.block import Block, BlockParameters
from drake_nonstop.model.descriptions import Wind
from drake_nonstop.model.system import Model
from drake_nonstop.systems.requirements import LoopBlocks
from drake_nonstop.systems.tracing import where
from drake_nonstop.validation import (
    ScenarioError,
    StrictFields,
    checked,
    fulfilling,
    non_negative,
    number_with,
    positive,
    require,
    require_array,
    require_ranges,
    require_seed,
)

_BOX = "wind"
_FASTEST = 100.0  # m/s, more than in any storm
_MOST_SAMPLES = 1 << 20  # of gusts, which take 25 MB a carrier
_STEPS = 5  # samples of gusts in the shortest of their time constants, at least
_LOWEST, _HIGHEST_ALTITUDE = 10 * FOOT, 1000 * FOOT  # m, between which the standard's lengths hold
_AT_MOST_FASTEST = number_with(lambda v: v <= _FASTEST, f"give at most {_FASTEST:g} m/s")


@dataclass(kw_only=True)
class StillAirConfig(StrictFields):
    """No parameters."""


class StillAir(Block):
    """No wind."""

    makes = ("wind", "load_wind", "mean_wind")

    is_sampled = True
    of_model = ("n",)

    @staticmethod
    def equations(*, n: int) -> tuple[NDArray, NDArray, NDArray]:
        return np.zeros(3 * n), np.zeros(3), np.zeros(3)

    def describe_wind(self) -> Wind:
        return Wind()


def check_velocity(field: str, value: Any) -> None:
    """Raises ScenarioError for what is no velocity (3,) of a wind, m/s."""
    velocity = require_array(field, value, [3], "m/s, in W")
    is_wind = np.linalg.norm(velocity) <= _FASTEST
    require(is_wind, field, value, f"give a velocity of at most {_FASTEST:g} m/s")


@dataclass(kw_only=True)
class _MeanWindFields(StrictFields):  # no config may be below another: YAML could not tell them
    """A velocity, and when it rises."""

    velocity: list[float] = checked([2.0, 0.0, 0.0], check_velocity)  # m/s, in W
    start_time: float = non_negative(0.0)  # s, still air before it
    # s, in which it then rises linearly to the velocity; 0: at once
    rise_time: float = non_negative(0.0)


@dataclass(kw_only=True)
class SteadyWindConfig(_MeanWindFields):
    """A velocity, and when it rises."""


class SteadyWind(Block):
    """The same wind everywhere, from the beginning on or rising linearly from still air.

    Raises:
        ScenarioError: a field is out of range.
    """

    makes = StillAir.makes
    reads_time = True
    of_model = ("n",)

    def __init__(self, model: Model, config: Any = None):
        super().__init__(model, config)
        self.is_sampled = self.describe_wind().is_constant

    def requires(self, loop: LoopBlocks) -> Iterator[str]:
        """Tells of a load that the wind does not act on."""
        load = loop.maker_of("load_state")
        if load is not None and not load.HasInputPort("load_wind"):
            yield (
                f"load_plant = {type(load).__name__}: no wind acts on the load, since this block "
                "does not read it; give it an input port load_wind (3), the air's velocity in m/s, "
                "in W, or have still air by wind=StillAir"
            )

    @staticmethod
    def equations(
        *gusts_and_time: NDArray,
        n: int,
        velocity: NDArray,
        start_time: Any = None,
        rise_time: Any = None,
    ) -> tuple[NDArray, NDArray, NDArray]:
        *gusts, time = gusts_and_time
        if rise_time is not None:
            velocity = velocity * risen_share(time, start=start_time, rise_time=rise_time)
        elif start_time is not None:
            velocity = where(time[0] >= start_time[0], velocity, np.zeros(WIND_SIZE))
        at_carriers, at_load = gusts or (0.0, 0.0)
        return np.tile(velocity, n) + at_carriers, velocity + at_load, velocity

    @classmethod
    def check(cls, model: Model, config: _MeanWindFields) -> None:
        require_ranges(_BOX, config)

    def block_parameters(self, model: Model, config: Any) -> BlockParameters:
        rise = ("start_time", "rise_time") if config.rise_time > 0 else ("start_time",)
        is_rising = config.start_time > 0 or config.rise_time > 0
        own = ("velocity", *(rise if is_rising else ()))
        return BlockParameters(model, self.system, config=config, own=own)

    def describe_wind(self) -> Wind:
        mean = np.array(self.config.velocity, dtype=float)
        return Wind(mean, self.config.start_time, self.config.rise_time)


def _altitude(default: float) -> Any:
    remedy = f"give {_LOWEST:.3g} to {_HIGHEST_ALTITUDE:.4g} m above the ground"
    return fulfilling(default, lambda height: _LOWEST <= height <= _HIGHEST_ALTITUDE, remedy)


@dataclass(kw_only=True)
class GustyWindConfig(_MeanWindFields):
    """The mean wind, the gusts on top of it, and where they are met."""

    velocity: list[float] = checked([0.0, 0.0, 0.0], check_velocity)  # m/s, in W, the mean
    # m/s, standard deviation at a carrier, on each horizontal axis
    gust: float = non_negative(0.5, _AT_MOST_FASTEST)
    altitude: float = _altitude(100.0)  # m above the ground, of the carriers
    airspeed: float = positive(15.0, _AT_MOST_FASTEST)  # m/s, at which carriers fly through gusts
    load_gust: float = non_negative(0.0, _AT_MOST_FASTEST)  # m/s, as gust, of the load's own gusts
    load_altitude: float = _altitude(20.0)  # m above the ground
    load_airspeed: float = positive(5.0, _AT_MOST_FASTEST)  # m/s, at which gusts pass the load
    seed: int = checked(0, require_seed)  # of the gusts


class GustyWind(SteadyWind):
    """A wind that may rise in time, with Dryden's gusts, seeded.

    Gusts are white noise through the filters of MIL-F-8785C, see `gust_samples`: u along the
    mean wind (without one, along x), of first order, v across it and w upwards, of second order.
    Lengths, and the vertical deviation beside the horizontal one, follow from the altitude, see
    `turbulence_at`; the time constants are the lengths over the airspeed. The samples, each 0.01 s
    with a line between two, are a function of time alone: runs repeat to the bit whatever the
    integrator's steps are. Those of each carrier follow from the seed and its number, and the load
    has its own. They are there from the start on; a mean wind may rise later.

    A carrier that circles turns through u and v, whose lengths and deviations are the same.

    Raises:
        ScenarioError: a field is out of range.
    """

    def __init__(self, model: Model, config: Any = None):
        super().__init__(model, config)
        config, self.is_sampled = self.config, False
        along = np.append(config.velocity[:2], 0.0) / (np.hypot(*config.velocity[:2]) or 1.0)
        along = along if along.any() else np.eye(3)[0]
        across = np.array([-along[1], along[0], 0.0])
        axes = np.array([along, across, [0.0, 0.0, 1.0]])
        carriers = [[config.seed, 2 + i] for i in range(model.n)]
        self._bodies = {  # the seeds of the noises, time constants and axes
            "wind": (carriers, *_air(config, "", axes)),
            "load_wind": ([[config.seed, 0]], *_air(config, "load_", axes)),
        }
        self._samples: dict[str, NDArray] = {}  # as far as they were asked for

    def quantities(self, model: Model) -> Mapping[str, int]:
        return {"wind": WIND_SIZE * model.n, "load_wind": WIND_SIZE}

    def precomputed_inputs(self, ports: Sequence[str], times: NDArray) -> list[NDArray]:
        """The gusts on top of what ports show, (k, size), at times (k,) in s; m/s, in W."""
        return [self._gusts(port, times)[0] for port in ports]

    def precomputed_input_rates(self, ports: Sequence[str], times: NDArray) -> list[NDArray]:
        """Their rates, m/s²."""
        return [self._gusts(port, times)[1] for port in ports]

    def _gusts(self, port: str, times: NDArray) -> tuple[NDArray, NDArray]:
        """Those of a port with their rates, (k, size) each."""
        instants = times / GUST_STEP
        before = instants.astype(int)
        samples = self._samples_until(port, before.max(initial=0) + 2)
        step = samples[before + 1] - samples[before]
        return samples[before] + (instants - before)[:, None] * step, step / GUST_STEP

    def _samples_until(self, port: str, count: int) -> NDArray:
        """The port's gusts (at least count, size): those that were made, or all of them anew."""
        if count > _MOST_SAMPLES:
            raise ScenarioError(
                f"{_BOX} = {type(self).__name__} at t = {count * GUST_STEP:.6g} s: gusts are made "
                f"for {_MOST_SAMPLES * GUST_STEP:.0f} s at most; give a shorter simulation_duration"
            )
        samples = self._samples.get(port)
        if samples is None or len(samples) < count:
            seeds, times, axes = self._bodies[port]
            made = gust_samples(seeds, times, 1 << int(count - 1).bit_length()) @ axes
            samples = self._samples[port] = made.reshape(len(made), -1)
        return samples


def _air(config: GustyWindConfig, body: str, axes: NDArray) -> tuple[NDArray, NDArray]:
    """The time constants (3,), s, of u, v and w at carriers or load, and their deviations (3, 3).

    These are m/s in W, a row for each of the axes (3, 3).
    """
    names = ("altitude", "airspeed", "gust")
    altitude, airspeed, gust = (getattr(config, f"{body}{name}") for name in names)
    lengths, horizontal = turbulence_at(altitude)
    fastest = lengths.min() / (_STEPS * GUST_STEP)
    remedy = f"gusts are too short at its altitude; give at most {fastest:g} m/s"
    require(airspeed <= fastest, f"{_BOX}.{body}airspeed", airspeed, remedy)
    return lengths / airspeed, axes * gust / np.array([[1.0], [1.0], [horizontal]])


VARIANTS = (StillAir, SteadyWind, GustyWind)
