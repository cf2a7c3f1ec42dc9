"""Box "wind": how the air moves at carriers and load, and what the controllers believe of it.

The wind acts on the load by its drag, and on carriers that are aircraft. The other carriers of the
box "carrier_dynamics" have no aerodynamics, and do not feel it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.signals import LOAD_STATE_SIZE, WIND_SIZE, CarrierStates, LoadState
from drake_nonstop.mechanics.wind import (
    LOWEST_HEIGHT,
    MeanWind,
    Waves,
    coloured_noise,
    random_waves,
    wave_frequencies,
)
from drake_nonstop.model.block import Block
from drake_nonstop.model.descriptions import Gusts, Wind
from drake_nonstop.model.system import Model
from drake_nonstop.systems.block import LeafBlock
from drake_nonstop.systems.diagram_trace import shown
from drake_nonstop.validation import (
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
_HIGHEST_GROUND = 1e5  # m, above or below z = 0
_STEEPEST = 1.0  # exponent of the height
_WAVES, _HIGHEST = 64, 100.0  # of a gust on each axis, and its highest frequency times its time
_SHORTEST = 0.01  # s, correlation time of a gust


@dataclass(kw_only=True)
class StillAirConfig(StrictFields):
    """No parameters."""


class StillAir(Block):
    """No wind."""

    makes = ("wind", "load_wind", "wind_estimate")

    is_trivial = True  # nothing blows
    is_sampled = True
    of_model = ("n",)

    @staticmethod
    def equations(*, n: int) -> tuple[NDArray, NDArray, NDArray]:
        return np.zeros(3 * n), np.zeros(3), np.zeros(3)

    def describe_wind(self) -> Wind:
        return Wind()


def _check_velocity(field: str, value: Any) -> None:
    velocity = require_array(field, value, [3], "m/s, in W")
    is_wind = np.linalg.norm(velocity) <= _FASTEST
    require(is_wind, field, value, f"give a velocity of at most {_FASTEST:g} m/s")


@dataclass(kw_only=True)
class _MeanWindFields(StrictFields):  # no config may be below another: YAML could not tell them
    """A velocity, and when it rises."""

    velocity: list[float] = checked([2.0, 0.0, 0.0], _check_velocity)  # m/s, in W
    start_time: float = non_negative(0.0)  # s, still air before it
    # s, in which it then rises linearly to the velocity; 0: at once
    rise_time: float = non_negative(0.0)
    # m/s, in W, wind_estimate; null: the mean wind at the load
    believed: list[float] | None = checked(None, _check_velocity)


@dataclass(kw_only=True)
class SteadyWindConfig(_MeanWindFields):
    """A velocity, and when it rises."""


class SteadyWind(LeafBlock):
    """The same wind everywhere, from the beginning on or rising linearly from still air.

    Raises:
        ScenarioError: a field is out of range.
    """

    makes = StillAir.makes
    is_traced = False  # it is known beforehand

    def __init__(self, model: Model, config: _MeanWindFields | None = None):
        super().__init__()
        config = require_ranges(_BOX, config or SteadyWindConfig())
        believed = None if config.believed is None else np.array(config.believed, float)
        mean = MeanWind.of(config, np.array(config.velocity, float))
        self._wind = Wind(mean, believed, config.start_time, config.rise_time)
        inputs = (("carrier_state", 6 * model.n), ("load_state", LOAD_STATE_SIZE))
        read = {k: self.DeclareVectorInputPort(k, size) for k, size in inputs if k in self.reads}
        self.is_sampled = self._wind.is_constant and not read
        for name in self.makes:
            sources = {self.nothing_ticket() if self.is_sampled else self.time_ticket()}
            if read:
                heights = read["carrier_state" if name == "wind" else "load_state"]
                sources.add(self.input_port_ticket(heights.get_index()))
            size = 3 * model.n if name == "wind" else WIND_SIZE
            self.DeclareVectorOutputPort(name, size, shown(self, name), sources)

    def describe_wind(self) -> Wind:
        return self._wind

    def traced_output(self, port: str, at: Any) -> NDArray:
        if port == "wind_estimate" and self._wind.believed is not None:
            return self._wind.believed
        mean = self._wind.at(at.time, self._positions(port, at)).ravel()
        return mean + self._gusts_at(port, at)

    def _positions(self, port: str, at: Any) -> NDArray:
        """Heights (k, 3) of the port's bodies: here none counts."""
        return np.zeros((self.GetOutputPort(port).size() // WIND_SIZE, 3))

    def _gusts_at(self, port: str, at: Any) -> Any:
        """The gusts on top of what a port shows."""
        return 0.0


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
    is_traced = True

    def __init__(self, model: Model, config: _ProfileFields | None = None):
        super().__init__(model, config or WindProfileConfig())

    @property
    def trace_key(self) -> Any:
        """The mean wind, and what is believed of it."""
        (velocity, *law), believed, *rise = self._wind[:4]
        return velocity.tobytes(), *law, None if believed is None else believed.tobytes(), *rise

    def _positions(self, port: str, at: Any) -> NDArray:
        if port == "wind":
            return CarrierStates.view(at.input("carrier_state")).positions
        return LoadState.view(at.input("load_state")).position[None]


def _deviation(default: float) -> Any:
    remedy = f"give at most {_FASTEST:g} m/s"
    return non_negative(default, number_with(lambda deviation: deviation <= _FASTEST, remedy))


@dataclass(kw_only=True)
class GustyWindConfig(_ProfileFields):
    """The mean wind, and the gusts on top of it."""

    velocity: list[float] = checked([0.0, 0.0, 0.0], _check_velocity)  # m/s, in W, the mean
    exponent: float = _exponent(0.0)  # of the height; 0.14: open land, 0: the same wind everywhere
    gust: float = _deviation(0.5)  # m/s, standard deviation at a carrier, on each horizontal axis
    vertical_share: float = non_negative(  # of that, the standard deviation on the vertical axis
        0.6,
        number_with(lambda s: s <= 2, "give at most 2, of the horizontal standard deviation"),
    )
    gust_length: float = positive(50.0)  # m, correlation length
    airspeed: float = positive(15.0)  # m/s, at which carriers fly through the gusts
    load_gust: float = _deviation(0.0)  # m/s, as gust, of the load's own gusts, which last as long
    seed: int = checked(0, require_seed)  # of the gusts


class GustyWind(WindProfile):
    """A `WindProfile` with seeded gusts, each carrier's its own.

    On each axis first-order coloured noise, of `mechanics.wind`, whose time constant is
    the correlation length over the airspeed: a function of time alone, so that runs repeat to the
    bit whatever the integrator's steps are. A carrier's gusts follow from the seed and its number.
    They are there from the start on; a mean wind may rise later.

    Raises:
        ScenarioError: a field is out of range.
    """

    def __init__(self, model: Model, config: GustyWindConfig | None = None):
        config = config or GustyWindConfig()
        super().__init__(model, config)
        correlation_time = config.gust_length / config.airspeed
        require(
            correlation_time >= _SHORTEST,
            f"{_BOX}.gust_length",
            config.gust_length,
            f"give at least {_SHORTEST:g} s times the airspeed, {_SHORTEST * config.airspeed:g} m",
        )

        def waves(number: int) -> Waves:
            random = np.random.default_rng([config.seed, number])
            return random_waves(random, 3, correlation_time, count=_WAVES, highest=_HIGHEST)

        frequencies = wave_frequencies(correlation_time, count=_WAVES, highest=_HIGHEST)
        shares = np.array([1.0, 1.0, config.vertical_share])
        carriers = [waves(i + 1) for i in range(model.n)]
        self._waves = Waves._make(map(np.concatenate, zip(*carriers, strict=True)))
        self._deviations = np.tile(config.gust * shares, model.n)
        self._load_waves = waves(0)
        gusts = Gusts(config.load_gust * shares, frequencies)
        self._wind = self._wind._replace(gust=config.gust, load_gusts=gusts)

    def _gusts_at(self, port: str, at: Any) -> Any:
        return 0.0 if port == "wind_estimate" else at.known(port, self.GetOutputPort(port).size())

    def precomputed_inputs(self, ports: Sequence[str], times: NDArray) -> list[NDArray]:
        """The gusts on top of what ports show, (k, size), at times (k,) in s; m/s, in W."""
        waves = {"wind": self._waves, "load_wind": self._load_waves}
        assert self._wind.load_gusts is not None
        deviations = {"wind": self._deviations, "load_wind": self._wind.load_gusts.deviations}
        times = times[:, None, None]
        return [coloured_noise(times, waves[port], deviations[port]) for port in ports]


VARIANTS = (StillAir, SteadyWind, WindProfile, GustyWind)

__all__ = ["StillAir", "StillAirConfig", "SteadyWind", "SteadyWindConfig"]
__all__ += ["WindProfile", "WindProfileConfig", "GustyWind", "GustyWindConfig"]
