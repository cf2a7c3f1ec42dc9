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
from drake_nonstop.blocks.wind import check_velocity
from drake_nonstop.mechanics.signals import WIND_SIZE, CarrierStates
from drake_nonstop.model.block import Block, BlockParameters
from drake_nonstop.model.system import Model
from drake_nonstop.validation import (
    StrictFields,
    checked,
    fulfilling,
    non_negative,
    number_with,
    positive,
    require_ranges,
    require_seed,
)

_BOX = "wind_estimator"
_NOISE_PERIOD = 0.01  # s, where the controllers are continuous
_START = np.array([1.0, 1.0, 0.0, 1.0])  # of the parts of the variance


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

    def describe_wind_estimate(self) -> NDArray:
        return np.zeros(WIND_SIZE)


@dataclass(kw_only=True)
class AssumedWindConfig(StrictFields):
    """A velocity."""

    velocity: list[float] = checked([2.0, 0.0, 0.0], check_velocity)  # m/s, in W


class AssumedWind(Block):
    """A steady wind, whatever it is.

    Raises:
        ScenarioError: the velocity is out of range.
    """

    makes = ("wind_estimate",)
    is_sampled = True

    @staticmethod
    def equations(*, velocity: NDArray) -> NDArray:
        return velocity

    @classmethod
    def check(cls, model: Model, config: AssumedWindConfig) -> None:
        require_ranges(_BOX, config)

    def describe_wind_estimate(self) -> NDArray:
        return np.array(self.config.velocity, dtype=float)


def _airspeed_error() -> float:
    return fulfilling(0.0, lambda share: abs(share) < 1, "give a number between -1 and 1")


def _heading_error() -> float:
    return fulfilling(0.0, lambda angle: abs(angle) <= np.pi, "give an angle of at most pi")


@dataclass(kw_only=True)
class WindObserverConfig(StrictFields):
    """The observer's time constant, its instruments, and the gusts that it reckons with."""

    time_constant: float = positive(3.0)  # s, of the estimate
    carrier_time_constant: float = positive(2.0)  # s, of that of each carrier's own wind
    airspeed_noise: float = non_negative(0.3)  # m/s, white, of each sample on each axis
    airspeed_error: float = _airspeed_error()  # share of it, the same for all carriers
    heading_error: float = _heading_error()  # rad, the same for all carriers
    gust: float = non_negative(0.5)  # m/s, standard deviation that the variance reckons with
    gust_time: float = positive(15.0)  # s, correlation time of these gusts
    coherence: float = non_negative(  # share of their power that all carriers have in common
        0.0, number_with(lambda share: share <= 1, "give at most 1")
    )
    drift: float = non_negative(0.05)  # m/s in the root of a second, of the mean wind
    seed: int = checked(0, require_seed)  # of the noise


class _WindInstruments(Block):
    """An estimate of winds by noisy instruments on the load, or of the mean, and on carriers."""

    is_sampled = True

    def block_parameters(self, model: Model, config: Any) -> BlockParameters:
        own = [name for name in vars(config) if name != "seed"]
        return BlockParameters(model, self.system, config=config, own=own)

    def quantities(self, model: Model) -> Mapping[str, int]:
        return {"noise": WIND_SIZE * (1 + model.n)}

    def precomputed_inputs(self, names: Sequence[str], times: NDArray) -> list[NDArray]:
        """Noise (k, 3 + 3n) of variance 1, held for a sample, at times (k,) in s."""
        period = self.model.control_period or _NOISE_PERIOD
        size = WIND_SIZE * (1 + self.model.n)
        return [held_noise(self.config.seed, times, period, size) for _ in names]

    def precomputed_input_rates(self, names: Sequence[str], times: NDArray) -> list[NDArray]:
        """Its rates, 0."""
        return [np.zeros((len(times), WIND_SIZE * (1 + self.model.n))) for _ in names]


def _shown_winds(
    carrier_state: NDArray, wind: NDArray, airspeed_error: NDArray, heading_error: NDArray
) -> NDArray:
    """Winds (n, 3), m/s, in W, that carriers' velocities over ground and airspeeds tell."""
    velocities = CarrierStates.view(carrier_state).velocities
    x, y, z = (velocities - wind.reshape(-1, WIND_SIZE)).T
    cosine, sine = np.cos(heading_error), np.sin(heading_error)
    turned = np.stack([cosine * x - sine * y, sine * x + cosine * y, z], axis=-1)
    found: NDArray = velocities - (1 + airspeed_error) * turned
    return found


class WindObserver(_WindInstruments):
    """A mean wind, the same for all carriers, of what their airspeed sensors tell.

    A carrier of the velocity v_i over ground measures the velocity a_i through the air: with white
    noise ν_i, and with constant errors ε of its magnitude and ψ of its heading, which average out
    over a turn. The estimate follows the mean difference by a first-order observer,

        dŵ/dt = (z − ŵ)/T,    z = 1/n Σ (v_i − a_i),    a_i = (1 + ε) R_z(ψ) (v_i − w_i) + ν_i,

    from the carriers' mean wind at the start on. With gusts of variance σ², correlation exp(−|t|/τ)
    and a share c in common, whose mean has the variance S = σ² (c + (1 − c)/n), and with a mean
    wind that drifts by q² a second, `wind_variance` p is that of the error on each axis, without ε
    and ψ (a Lyapunov equation; Åström, "Introduction to Stochastic Control Theory", 1970):

        p → S τ/(τ + T) + q² T/2 + ν² h/(2 n T),    with noise held for samples of h.

    With the default values that is (0.24 m/s)² without noise, where a Kalman filter that knows σ, τ
    and q comes to (0.20 m/s)², and lets half of a gust through at once.

    `carrier_gust_estimate` is what each carrier's own wind is beyond that estimate, by another
    first-order observer for each: gusts are not the same at all carriers, nor at the load, whose
    wind `wind_estimate` stands for.

    Raises:
        ScenarioError: a field is out of range.
    """

    reads = ("wind", "carrier_state")
    makes = ("wind_estimate", "wind_variance", "carrier_gust_estimate")

    @staticmethod
    def equations(
        state: NDArray,
        wind: NDArray,
        carrier_state: NDArray,
        noise: NDArray,
        *,
        n: int,
        sample: float,
        time_constant: NDArray,
        carrier_time_constant: NDArray,
        airspeed_noise: NDArray,
        airspeed_error: NDArray,
        heading_error: NDArray,
        gust: NDArray,
        gust_time: NDArray,
        coherence: NDArray,
        drift: NDArray,
    ) -> tuple[NDArray, NDArray, NDArray, NDArray]:
        """The state has the estimate (3,), parts of the variance for S, q and ν of 1, winds (3n,).

        The noise is that of the mean (3,), and what each carrier has beside it (3n,).
        """
        estimate, parts, winds = np.split(state, np.cumsum([WIND_SIZE, len(_START)]))
        own = _shown_winds(carrier_state, wind, airspeed_error, heading_error)
        mean = own.sum(axis=0) / n
        measured = mean + airspeed_noise / np.sqrt(n) * noise[:WIND_SIZE]
        others = noise[WIND_SIZE:].reshape(n, WIND_SIZE)
        own = own + measured - mean + airspeed_noise * (others - others.sum(axis=0) / n)
        correlated, of_gusts, of_drift, of_noise = np.split(parts, len(_START))
        share = 1 / time_constant
        rates = [
            share * (1 - correlated) - correlated / gust_time,
            2 * share * (correlated - of_gusts),
            1 - 2 * share * of_drift,
            sample * share**2 - 2 * share * of_noise,
        ]
        variance = (
            gust**2 * (coherence + (1 - coherence) / n) * of_gusts
            + drift**2 * of_drift
            + airspeed_noise**2 / n * of_noise
        )
        rates = [
            share * (measured - estimate),
            *rates,
            (own.ravel() - winds) / carrier_time_constant,
        ]
        gusts = (winds.reshape(n, WIND_SIZE) - estimate).ravel()
        return np.concatenate(rates), estimate, variance, gusts

    @classmethod
    def check(cls, model: Model, config: WindObserverConfig) -> None:
        require_ranges(_BOX, config)

    def constants(self, model: Model, config: WindObserverConfig) -> dict[str, Any]:
        return {"n": model.n, "sample": model.control_period or _NOISE_PERIOD}

    def state(self, model: Model) -> NDArray:
        return np.concatenate([np.zeros(WIND_SIZE), _START, np.zeros(WIND_SIZE * model.n)])

    @staticmethod
    def start(state: NDArray, wind: NDArray, *others: NDArray, **numbers: Any) -> NDArray:
        """The mean of the carriers' winds, and each of these."""
        winds = wind.reshape(-1, WIND_SIZE)
        return np.concatenate([winds.sum(axis=0) / len(winds), _START, wind])


@dataclass(kw_only=True)
class LoadAnemometerConfig(StrictFields):
    """The time constants of the estimates, and the instruments."""

    time_constant: float = positive(0.4)  # s, of the wind at the load
    noise: float = non_negative(0.3)  # m/s, white, of each sample of it on each axis
    carrier_time_constant: float = positive(0.4)  # s, of that of each carrier's own wind
    airspeed_noise: float = non_negative(0.3)  # m/s, white, of each sample on each axis
    airspeed_error: float = _airspeed_error()  # share of it, the same for all carriers
    heading_error: float = _heading_error()  # rad, the same for all carriers
    seed: int = checked(0, require_seed)  # of the noise


class LoadAnemometer(_WindInstruments):
    """The wind at the load by an anemometer on it, and at each carrier by its airspeed.

    Airspeeds alone do not tell the wind at the load: of gusts that are not the same at n carriers
    their mean keeps 1/√n, for as long as they last. Each estimate follows its noisy measurement by
    a first-order observer. The anemometer's is `wind_estimate`; `carrier_gust_estimate` is what
    each carrier's own wind is beyond it. Carriers measure as those of `WindObserver` do.

    Raises:
        ScenarioError: a field is out of range.
    """

    reads = ("load_wind", "wind", "carrier_state")
    makes = ("wind_estimate", "carrier_gust_estimate")

    @staticmethod
    def equations(
        state: NDArray,
        load_wind: NDArray,
        wind: NDArray,
        carrier_state: NDArray,
        instruments_noise: NDArray,
        *,
        time_constant: NDArray,
        noise: NDArray,
        carrier_time_constant: NDArray,
        airspeed_noise: NDArray,
        airspeed_error: NDArray,
        heading_error: NDArray,
    ) -> tuple[NDArray, NDArray, NDArray]:
        """The state has the estimates of the wind at the load (3,) and at the carriers (3n,)."""
        estimate, winds = state[:WIND_SIZE], state[WIND_SIZE:]
        of_load, of_carriers = instruments_noise[:WIND_SIZE], instruments_noise[WIND_SIZE:]
        own = _shown_winds(carrier_state, wind, airspeed_error, heading_error).ravel()
        rates = [
            (load_wind + noise * of_load - estimate) / time_constant,
            (own + airspeed_noise * of_carriers - winds) / carrier_time_constant,
        ]
        gusts = (winds.reshape(-1, WIND_SIZE) - estimate).ravel()
        return np.concatenate(rates), estimate, gusts

    @classmethod
    def check(cls, model: Model, config: LoadAnemometerConfig) -> None:
        require_ranges(_BOX, config)

    def state(self, model: Model) -> NDArray:
        return np.zeros(WIND_SIZE * (1 + model.n))

    @staticmethod
    def start(
        state: NDArray, load_wind: NDArray, wind: NDArray, *others: NDArray, **numbers: Any
    ) -> NDArray:
        """The winds."""
        return np.concatenate([load_wind, wind])


VARIANTS = (KnownWind, NoWind, AssumedWind, WindObserver, LoadAnemometer)

__all__ = ["KnownWind", "KnownWindConfig", "NoWind", "NoWindConfig"]
__all__ += ["AssumedWind", "AssumedWindConfig", "WindObserver", "WindObserverConfig"]
__all__ += ["LoadAnemometer", "LoadAnemometerConfig"]
