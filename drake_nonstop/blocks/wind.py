"""Box "wind": how the air moves at carriers and load.

The wind acts on the load by its drag, and on carriers that are aircraft. The other carriers of the
box "carrier_dynamics" have no aerodynamics, and do not feel it.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.signals import WIND_SIZE, CarrierStates, LoadState
from drake_nonstop.mechanics.wind import (
    FOOT,
    GUST_STEP,
    LOWEST_HEIGHT,
    SEVERITIES,
    MeanWind,
    gust_samples,
    power_law,
    risen_share,
    turbulence_at,
    wave_frequencies,
)
from drake_nonstop.model.block import Block, BlockParameters
from drake_nonstop.model.descriptions import Gusts, Wind
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
    one_of,
    positive,
    require,
    require_array,
    require_ranges,
    require_seed,
)

_BOX = "wind"
_FASTEST = 100.0  # m/s, more than in any storm
_HIGHEST_GROUND = 1e5  # m, above or below z = 0
_STEEPEST = 1.0  # exponent of the height
_WAVES = 256  # that describe the gusts on an axis, up to 50 Hz
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


def _mean_wind(
    time: NDArray,
    positions: NDArray,
    *,
    velocity: NDArray,
    start_time: Any = None,
    rise_time: Any = None,
    **law: NDArray,
) -> NDArray:
    """The mean wind (3k,) at positions (k, 3), m/s, in W; `law` is that of the height, or empty."""
    if rise_time is not None:
        velocity = velocity * risen_share(time, start=start_time, rise_time=rise_time)
    elif start_time is not None:
        velocity = where(time[0] >= start_time[0], velocity, np.zeros(WIND_SIZE))
    count = positions.shape[0]
    if not law:
        return np.tile(velocity, count)
    height = positions[:, 2] - law["ground_height"]
    shares = power_law(height, reference_height=law["reference_height"], exponent=law["exponent"])
    return np.outer(shares, velocity).ravel()


class SteadyWind(Block):
    """The same wind everywhere, from the beginning on or rising linearly from still air.

    Raises:
        ScenarioError: a field is out of range.
    """

    makes = StillAir.makes
    reads_time = True
    of_model: ClassVar[tuple[str, ...]] = ("n",)

    def __init__(self, model: Model, config: Any = None):
        super().__init__(model, config)
        self.is_sampled = not self.reads and self.describe_wind().is_constant

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
    def equations(time: NDArray, *, n: int, **mean: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        wind = _mean_wind(time, np.zeros((1, 3)), **mean)
        return np.tile(wind, n), wind, wind

    @classmethod
    def check(cls, model: Model, config: _MeanWindFields) -> None:
        require_ranges(_BOX, config)

    def block_parameters(self, model: Model, config: Any) -> BlockParameters:
        return BlockParameters(model, self.system, config=config, own=_moving(model, config))

    def describe_wind(self) -> Wind:
        config = self.config
        mean = MeanWind.of(config, config.velocity)
        return Wind(mean, None, config.start_time, config.rise_time)


def _moving(model: Model, config: Any) -> tuple[str, ...]:
    """The fields that the mean wind follows from."""
    rise = ("start_time", "rise_time") if config.rise_time > 0 else ("start_time",)
    is_law = getattr(config, "exponent", 0.0) > 0
    return (
        "velocity",
        *(rise if config.start_time > 0 or config.rise_time > 0 else ()),
        *(("exponent", "reference_height", "ground_height") if is_law else ()),
    )


def _exponent(default: float) -> Any:
    remedy = f"give at most {_STEEPEST:g}"
    return non_negative(default, number_with(lambda exponent: exponent <= _STEEPEST, remedy))


@dataclass(kw_only=True)
class _ProfileFields(_MeanWindFields):
    """A velocity, when it rises, and how it grows with the height."""

    exponent: float = _exponent(0.14)  # of the height; 0.14: open land, 0: the same wind everywhere
    reference_height: float = positive(  # m, above the ground, where the wind has the velocity
        10.0,
        number_with(
            lambda height: height >= LOWEST_HEIGHT,
            f"give at least {LOWEST_HEIGHT:g} m; below that the wind does not change",
        ),
    )
    ground_height: float = fulfilling(  # m, z of the ground in W
        0.0,
        lambda height: abs(height) <= _HIGHEST_GROUND,
        f"give a number of {_HIGHEST_GROUND:g} m at most",
    )


@dataclass(kw_only=True)
class WindProfileConfig(_ProfileFields):
    """A velocity, when it rises, and how it grows with the height."""


class WindProfile(SteadyWind):
    """A wind that grows with the height above the ground by a power law, and may rise in time.

    w = w_r (h/h_r)^α at the height h, which counts as 1 m below 1 m, see `mechanics.wind`.

    Carrier and load states tell the heights.

    Raises:
        ScenarioError: a field is out of range.
    """

    reads = ("carrier_state", "load_state")
    of_model = ()

    @staticmethod
    def equations(  # type: ignore[override]
        carrier_state: NDArray, load_state: NDArray, time: NDArray, **mean: NDArray
    ) -> tuple[NDArray, NDArray, NDArray]:
        at_carriers = _mean_wind(time, CarrierStates.view(carrier_state).positions, **mean)
        at_load = _mean_wind(time, LoadState.view(load_state).position[None], **mean)
        return at_carriers, at_load, at_load


def _deviation(default: float) -> Any:
    return non_negative(default, _AT_MOST_FASTEST)


def _altitude(default: float) -> Any:
    remedy = f"give {_LOWEST:.3g} to {_HIGHEST_ALTITUDE:.4g} m above the ground"
    return fulfilling(default, lambda height: _LOWEST <= height <= _HIGHEST_ALTITUDE, remedy)


@dataclass(kw_only=True)
class _TurbulenceFields(_ProfileFields):
    """The mean wind, and where gusts are met."""

    velocity: list[float] = checked([0.0, 0.0, 0.0], check_velocity)  # m/s, in W, the mean
    exponent: float = _exponent(0.0)  # of the height; 0.14: open land, 0: the same wind everywhere
    altitude: float = _altitude(100.0)  # m above the ground, of the carriers
    airspeed: float = positive(15.0, _AT_MOST_FASTEST)  # m/s, at which carriers fly through gusts
    coherence: float = non_negative(  # share of the gusts' power that all carriers have in common
        0.0, number_with(lambda share: share <= 1, "give at most 1")
    )
    load_altitude: float = _altitude(20.0)  # m above the ground
    load_airspeed: float = positive(5.0, _AT_MOST_FASTEST)  # m/s, at which gusts pass the load
    seed: int = checked(0, require_seed)  # of the gusts


@dataclass(kw_only=True)
class GustyWindConfig(_TurbulenceFields):
    """The mean wind, and the gusts on top of it."""

    gust: float = _deviation(0.5)  # m/s, standard deviation at a carrier, on each horizontal axis
    load_gust: float = _deviation(0.0)  # m/s, as gust, of the load's own gusts


class GustyWind(WindProfile):
    """A `WindProfile` with Dryden's gusts, seeded, of a given strength.

    White noise through the filters of MIL-F-8785C, see `mechanics.wind.gust_samples`: u along the
    mean wind (without one, along x), of first order, v across it and w upwards, of second order.
    Lengths, and the vertical deviation beside the horizontal one, follow from the altitude, see
    `turbulence_at`; the time constants are the lengths over the airspeed. The samples, each 0.01 s
    with a line between two, are a function of time alone: runs repeat to the bit whatever the
    integrator's steps are. A carrier's own gusts follow from the seed and its number; the share
    `coherence` of their power is the same at all carriers. The load has gusts of its own. They are
    there from the start on; a mean wind may rise later.

    A carrier that circles turns through u and v, whose lengths and deviations are the same.

    Raises:
        ScenarioError: a field is out of range.
    """

    def __init__(self, model: Model, config: Any = None):
        super().__init__(model, config)
        config = self.config
        along = np.append(config.velocity[:2], 0.0) / (np.hypot(*config.velocity[:2]) or 1.0)
        along = along if along.any() else np.eye(3)[0]
        across = np.array([-along[1], along[0], 0.0])
        axes = np.array([along, across, [0.0, 0.0, 1.0]])
        gust, load_gust = self._horizontal_deviations(config)
        carriers = [[config.seed, 2 + i] for i in range(model.n)]
        self._bodies = {
            "wind": _Air.of(config, "", [[config.seed, 1], *carriers], axes * gust),
            "load_wind": _Air.of(config, "load_", [[config.seed, 0]], axes * load_gust),
        }
        self._samples: dict[str, NDArray] = {}  # as far as they were asked for

    @staticmethod
    def equations(  # type: ignore[override]
        carrier_state: NDArray,
        load_state: NDArray,
        gusts: NDArray,
        load_gusts: NDArray,
        time: NDArray,
        **mean: NDArray,
    ) -> tuple[NDArray, NDArray, NDArray]:
        at_carriers, at_load, _ = WindProfile.equations(carrier_state, load_state, time, **mean)
        return at_carriers + gusts, at_load + load_gusts, at_load

    @staticmethod
    def _horizontal_deviations(config: Any) -> tuple[float, float]:
        """Those of carriers and load, m/s."""
        return config.gust, config.load_gust

    def block_parameters(self, model: Model, config: Any) -> BlockParameters:
        return BlockParameters(model, self.system, config=config, own=_moving(model, config))

    def describe_wind(self) -> Wind:
        gust, _ = self._horizontal_deviations(self.config)
        return (
            super()
            .describe_wind()
            ._replace(gust=gust, load_gusts=self._bodies["load_wind"].waves())
        )

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
            made = self._bodies[port].samples(1 << int(count - 1).bit_length())
            if port == "wind":
                common, own = np.split(made, [1], axis=1)
                share = self.config.coherence
                made = np.sqrt(share) * common + np.sqrt(1 - share) * own
            samples = self._samples[port] = made.reshape(len(made), -1)
        return samples


class _Air(NamedTuple):
    """Turbulence as it is met at some places."""

    seeds: list[list[int]]  # of the noises
    times: NDArray  # (3,), s, of u, v and w
    axes: NDArray  # (3, 3), m/s, in W: the axis of each times its standard deviation

    @classmethod
    def of(cls, config: Any, body: str, seeds: list[list[int]], axes: NDArray) -> "_Air":
        """That of carriers or load, of axes times the horizontal deviation."""
        altitude, airspeed = (getattr(config, f"{body}{name}") for name in ("altitude", "airspeed"))
        lengths, horizontal = turbulence_at(altitude)
        fastest = lengths.min() / (_STEPS * GUST_STEP)
        remedy = f"gusts are too short at its altitude; give at most {fastest:g} m/s"
        require(airspeed <= fastest, f"{_BOX}.{body}airspeed", airspeed, remedy)
        return cls(seeds, lengths / airspeed, axes / np.array([[1.0], [1.0], [horizontal]]))

    def samples(self, count: int) -> NDArray:
        """(count, seeds, 3), m/s, in W."""
        return gust_samples(self.seeds, self.times, count) @ self.axes

    def waves(self) -> tuple[Gusts, ...]:
        """Waves that have its spectra, for analyses; gusts along and across are independent."""
        highest = np.pi / GUST_STEP * self.times
        return tuple(
            Gusts(np.abs(axis), wave_frequencies(time, count=_WAVES, highest=x, is_along=k == 0))
            for k, (axis, time, x) in enumerate(zip(self.axes, self.times, highest, strict=True))
        )


@dataclass(kw_only=True)
class DrydenConfig(_TurbulenceFields):
    """The mean wind, and how strong its turbulence is."""

    # light, moderate or severe: a wind of 15, 30 or 45 kn at 20 ft above the ground
    severity: str = checked("light", one_of(SEVERITIES, f"give one of {', '.join(SEVERITIES)}"))


class Dryden(GustyWind):
    """A `WindProfile` with the turbulence of MIL-F-8785C of a stated severity, load and carriers.

    The gusts are those of `GustyWind`; their deviations, too, follow from the altitudes: σ_w =
    0.1 W_20, and 1.4 times that on a horizontal axis at 100 m. The mean wind is as its fields say.

    Raises:
        ScenarioError: a field is out of range.
    """

    @staticmethod
    def _horizontal_deviations(config: DrydenConfig) -> tuple[float, float]:
        vertical = 0.1 * SEVERITIES[config.severity]
        of_carriers, of_load = map(turbulence_at, (config.altitude, config.load_altitude))
        return vertical * of_carriers[1], vertical * of_load[1]


VARIANTS = (StillAir, SteadyWind, WindProfile, GustyWind, Dryden)

__all__ = ["StillAir", "StillAirConfig", "SteadyWind", "SteadyWindConfig"]
__all__ += ["WindProfile", "WindProfileConfig", "GustyWind", "GustyWindConfig"]
__all__ += ["Dryden", "DrydenConfig"]
