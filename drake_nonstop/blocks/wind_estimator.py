"""Box "wind_estimator": what the controllers and references believe of the wind.

It is known, assumed, or measured by the carriers, or by them and the load. The box is not in the
paper's figure.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.blocks.load_feedback import held_noise
from drake_nonstop.mechanics.signals import WIND_SIZE
from drake_nonstop.model.block import Block, BlockParameters
from drake_nonstop.model.system import Model
from drake_nonstop.validation import (
    StrictFields,
    checked,
    non_negative,
    positive,
    require_ranges,
    require_seed,
)

_BOX = "wind_estimator"
_NOISE_PERIOD = 0.01  # s, where the controllers are continuous


@dataclass(kw_only=True)
class KnownWindConfig(StrictFields):
    """No parameters."""


class KnownWind(Block):
    """The mean wind at the load, as it is."""

    reads = ("mean_wind",)
    makes = ("wind_estimate",)
    passes_on = "mean_wind"

    @staticmethod
    def equations(mean_wind: NDArray) -> NDArray:
        return mean_wind


@dataclass(kw_only=True)
class NoWindConfig(StrictFields):
    """No parameters."""


class NoWind(Block):
    """Still air, whatever the wind is."""

    makes = ("wind_estimate",)
    is_sampled = True

    @staticmethod
    def equations() -> NDArray:
        return np.zeros(WIND_SIZE)


@dataclass(kw_only=True)
class _InstrumentsConfig(StrictFields):
    """The airspeed sensors of the carriers, and what follows each of them."""

    carrier_time_constant: float = positive(2.0)  # s, of the estimate of each carrier's own wind
    airspeed_noise: float = non_negative(0.3)  # m/s, white, of each sample on each axis
    seed: int = checked(0, require_seed)  # of the noise


class _WindInstruments(Block):
    """First-order observers of a wind that is measured, and of each carrier's own.

    The state has the estimates of the wind (3,) and of the carriers' (3n,), m/s, in W.
    """

    is_sampled = True

    @classmethod
    def check(cls, model: Model, config: Any) -> None:
        require_ranges(_BOX, config)

    def block_parameters(self, model: Model, config: Any) -> BlockParameters:
        own = [name for name in vars(config) if name != "seed"]
        return BlockParameters(model, self.system, config=config, own=own)

    def state(self, model: Model) -> NDArray:
        return np.zeros(WIND_SIZE * (1 + model.n))

    def quantities(self, model: Model) -> Mapping[str, int]:
        return {"instruments_noise": WIND_SIZE * (1 + model.n)}

    def precomputed_inputs(self, names: Sequence[str], times: NDArray) -> list[NDArray]:
        """Noise (k, 3 + 3n) of variance 1, held for a sample, at times (k,) in s."""
        period = self.model.control_period or _NOISE_PERIOD
        size = WIND_SIZE * (1 + self.model.n)
        return [held_noise(self.config.seed, times, period, size) for _ in names]


def _followed(
    state: NDArray,
    measured: NDArray,
    own: NDArray,
    time_constant: NDArray,
    carrier_time_constant: NDArray,
) -> tuple[NDArray, NDArray, NDArray]:
    """The state's rate for a wind (3,) and carriers' (n, 3), the estimate, and gusts beyond it."""
    estimate, winds = state[:WIND_SIZE], state[WIND_SIZE:]
    rates = [
        (measured - estimate) / time_constant,
        (own.ravel() - winds) / carrier_time_constant,
    ]
    gusts = (winds.reshape(-1, WIND_SIZE) - estimate).ravel()
    return np.concatenate(rates), estimate, gusts


@dataclass(kw_only=True)
class WindObserverConfig(_InstrumentsConfig):
    """The observer's time constant, and its instruments."""

    time_constant: float = positive(3.0)  # s, of the estimate


class WindObserver(_WindInstruments):
    """A mean wind, the same for all carriers, of what their airspeed sensors tell.

    Carriers know their velocity over ground, and measure that through the air, in the wind w_i,
    with white noise ν_i. The estimate follows the mean difference by a first-order observer,

        dŵ/dt = (z − ŵ)/T,    z = 1/n Σ (w_i + ν_i),

    from the carriers' mean wind at the start on. With the default values and gusts of 0.5 m/s and
    15 s its error has a deviation of 0.24 m/s, where a Kalman filter that knows the gusts comes to
    0.20 m/s, and lets half of a gust through at once.

    `carrier_gust_estimate` is what each carrier's own wind is beyond that estimate, by another
    first-order observer for each: gusts are not the same at all carriers, nor at the load, whose
    wind `wind_estimate` stands for.

    Raises:
        ScenarioError: a field is out of range.
    """

    reads = ("wind",)
    makes = ("wind_estimate", "carrier_gust_estimate")

    @staticmethod
    def equations(
        state: NDArray,
        wind: NDArray,
        instruments_noise: NDArray,
        *,
        airspeed_noise: NDArray,
        **time_constants: NDArray,
    ) -> tuple[NDArray, NDArray, NDArray]:
        """The noise is that of the mean (3,), and what each carrier has beside it (3n,)."""
        own = wind.reshape(-1, WIND_SIZE)
        of_mean = instruments_noise[:WIND_SIZE]
        others = instruments_noise[WIND_SIZE:].reshape(-1, WIND_SIZE)
        n, mean = len(others), own.sum(axis=0) / len(others)
        measured = mean + airspeed_noise / np.sqrt(n) * of_mean
        own = own + measured - mean + airspeed_noise * (others - others.sum(axis=0) / n)
        return _followed(state, measured, own, **time_constants)

    @staticmethod
    def start(state: NDArray, wind: NDArray, *others: NDArray, **numbers: Any) -> NDArray:
        """The mean of the carriers' winds, and each of these."""
        winds = wind.reshape(-1, WIND_SIZE)
        return np.concatenate([winds.sum(axis=0) / len(winds), wind])


@dataclass(kw_only=True)
class LoadAnemometerConfig(_InstrumentsConfig):
    """The time constants of the estimates, and the instruments."""

    time_constant: float = positive(0.4)  # s, of the wind at the load
    noise: float = non_negative(0.3)  # m/s, white, of each sample of it on each axis
    carrier_time_constant: float = positive(0.4)  # s, of that of each carrier's own wind


class LoadAnemometer(_WindInstruments):
    """The wind at the load by an anemometer on it, and at each carrier by its airspeed.

    Airspeeds alone do not tell the wind at the load: of gusts that are not the same at n carriers
    their mean keeps 1/√n, for as long as they last. Each estimate follows its noisy measurement by
    a first-order observer. The anemometer's is `wind_estimate`; `carrier_gust_estimate` is what
    each carrier's own wind is beyond it. Carriers measure as those of `WindObserver` do.

    Raises:
        ScenarioError: a field is out of range.
    """

    reads = ("load_wind", "wind")
    makes = ("wind_estimate", "carrier_gust_estimate")

    @staticmethod
    def equations(
        state: NDArray,
        load_wind: NDArray,
        wind: NDArray,
        instruments_noise: NDArray,
        *,
        noise: NDArray,
        airspeed_noise: NDArray,
        **time_constants: NDArray,
    ) -> tuple[NDArray, NDArray, NDArray]:
        of_load, of_carriers = np.split(instruments_noise, [WIND_SIZE])
        measured, own = load_wind + noise * of_load, wind + airspeed_noise * of_carriers
        return _followed(state, measured, own, **time_constants)

    @staticmethod
    def start(
        state: NDArray, load_wind: NDArray, wind: NDArray, *others: NDArray, **numbers: Any
    ) -> NDArray:
        """The winds."""
        return np.concatenate([load_wind, wind])


VARIANTS = (KnownWind, NoWind, WindObserver, LoadAnemometer)
