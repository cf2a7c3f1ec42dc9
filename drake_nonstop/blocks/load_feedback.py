"""Box "load_feedback": the measurement of the load's state, a wire in the paper's figure."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.load_estimate import (
    corrected_error,
    error_of,
    predicted_error,
    state_with_error,
)
from drake_nonstop.mechanics.rotation import rotate_quaternion
from drake_nonstop.mechanics.signals import (
    LOAD_STATE_SIZE,
    TRACKING_ERROR_SIZE,
    LoadState,
    TrackingError,
)
from drake_nonstop.model.block import Block, BlockParameters
from drake_nonstop.model.descriptions import LoadMeasurement
from drake_nonstop.model.system import Model
from drake_nonstop.systems.block import number
from drake_nonstop.systems.tracing import where
from drake_nonstop.validation import (
    StrictFields,
    checked,
    non_negative,
    positive,
    require,
    require_period,
    require_ranges,
    require_seed,
)

_BOX = "load_feedback"
_NEVER = -1e5  # s, in place of the time of a sample that has not been taken
_EXACT = 1e-9  # a deviation in SI units, in place of none
_DUE = 0.999  # of a period, after which the next measurement is taken


_WITHOUT_ATTITUDE = np.concatenate(  # of a `TrackingError`
    TrackingError(np.zeros(3), np.ones(3), np.zeros(3), np.ones(3))
)


def _with_attitude(load_state: NDArray, *reference: NDArray) -> NDArray:
    """A load's state (13,) with the attitude and the turn rate of a reference, if there is one."""
    if not reference:
        return load_state
    state, desired = LoadState.view(load_state), LoadState.view(reference[0][:LOAD_STATE_SIZE])
    own = desired.quaternion, state.position, desired.angular_velocity, state.velocity
    return np.concatenate(own)


@dataclass(kw_only=True)
class IdealFeedbackConfig(StrictFields):
    """No parameters."""


class IdealFeedback(Block):
    """The load's state, exact and without delay."""

    reads = ("load_state",)
    makes = ("measured_load_state", "measured_attitude")

    @staticmethod
    def equations(load_state: NDArray) -> tuple[NDArray, NDArray]:
        return load_state, load_state[:4]


@dataclass(kw_only=True)
class DesiredStateFeedbackConfig(StrictFields):
    """No parameters."""


class DesiredStateFeedback(Block):
    """Opens the loop: the controllers get the reference in place of the load's state.

    The wrench controller then demands the wrench of the desired motion alone: the open-loop
    method that the paper starts from.
    """

    reads = ("reference",)
    makes = ("measured_load_state", "measured_attitude")

    @staticmethod
    def equations(reference: NDArray) -> tuple[NDArray, NDArray]:
        return reference[:LOAD_STATE_SIZE], reference[:4]

    def describe_response(self) -> LoadMeasurement:
        return LoadMeasurement(is_measured=np.zeros(TRACKING_ERROR_SIZE))


@dataclass(kw_only=True)
class DesiredAttitudeFeedbackConfig(StrictFields):
    """No parameters."""


class DesiredAttitudeFeedback(Block):
    """The load's position and velocity, exact and without delay; its attitude as desired.

    This opens the attitude loop: neither the torque nor the directions of the cable forces follow
    the load's tilt. Cables of 100 m and more need that, since a change of 1 N, or of a hundredth of
    a radian, moves the carriers by metres.

    Quaternion and angular velocity are those of the `reference`.
    """

    reads = ("load_state", "reference")
    makes = ("measured_load_state", "measured_attitude")

    @staticmethod
    def equations(load_state: NDArray, reference: NDArray) -> tuple[NDArray, NDArray]:
        return _with_attitude(load_state, reference), load_state[:4]

    def describe_response(self) -> LoadMeasurement:
        return LoadMeasurement(is_measured=_WITHOUT_ATTITUDE)


@dataclass(kw_only=True)
class MeasurementConfig(StrictFields):
    """Standard deviations on each axis, and the delay."""

    position_noise: float = non_negative(0.0)  # m
    orientation_noise: float = non_negative(0.0)  # rad
    velocity_noise: float = non_negative(0.0)  # m/s
    angular_velocity_noise: float = non_negative(0.0)  # rad/s
    delay: float = non_negative(0.0)  # s, a multiple of the period
    # s, between samples of the noise and of the delayed state
    period: float = checked(0.01, require_period)
    seed: int = checked(0, require_seed)  # of the noise
    measures_attitude: bool = True  # false: attitude and angular velocity are the reference's


@dataclass(kw_only=True)
class NoisyFeedbackConfig(MeasurementConfig):
    """Noise and delay of the measurement."""


class NoisyFeedback(Block):
    """The load's state with noise and delay.

    The noise is white and normal: a sample per `period`, held to the next, drawn from the
    seed and the sample's number alone, so that runs repeat to the bit. The orientation is
    rotated by a random rotation vector in W. With a delay of N periods, a controller that
    samples every period gets the state of N periods before; in the first N periods the state at
    the start. Without `measures_attitude` the attitude loop is open, as in
    `DesiredAttitudeFeedback`: quaternion and angular velocity are those of the reference now.

    The state has the last N samples, the newest first, and a 1 once it has begun, else a 0.

    Raises:
        ScenarioError: a field is out of range, or the delay no multiple of the period.
    """

    reads = ("load_state", "reference")
    makes: ClassVar[tuple[str, ...]] = ("measured_load_state", "measured_attitude")
    where: ClassVar = {"reference": "`measures_attitude` is false"}
    makes_next_state = True

    @staticmethod
    def equations(line: NDArray, load_state: NDArray, *others: NDArray) -> tuple[NDArray, ...]:
        """After the load's state come the reference, if it is read, and the noise."""
        *reference, noise = others
        measured = _measured(line, load_state, noise)
        return _shifted(line, load_state), _with_attitude(measured, *reference), measured[:4]

    @staticmethod
    def start(*values: NDArray, **constants: Any) -> NDArray:
        return NoisyFeedback.equations(*values, **constants)[0]

    @classmethod
    def check(cls, model: Model, config: MeasurementConfig) -> None:
        require_ranges(_BOX, config)
        count = _delay(config)
        is_multiple = abs(count * config.period - config.delay) < 1e-9 and count <= 1000
        remedy = f"give a multiple of the period {config.period:g} s, at most 1000 of them"
        require(is_multiple, f"{_BOX}.delay", config.delay, remedy)

    def block_parameters(self, model: Model, config: MeasurementConfig) -> BlockParameters:
        return BlockParameters(model, self.system)

    def inputs(self, model: Model) -> tuple[str, ...]:
        return self.reads[:1] if self.config.measures_attitude else self.reads

    def quantities(self, model: Model) -> Mapping[str, int]:
        return {"noise": TRACKING_ERROR_SIZE}

    def precomputed_inputs(self, names: Sequence[str], times: NDArray) -> list[NDArray]:
        """The noise (k, 12) at times (k,) in s, all of a `TrackingError` in W."""
        parts = ("orientation", "position", "angular_velocity", "velocity")
        deviations = np.repeat([getattr(self.config, f"{part}_noise") for part in parts], 3)
        noise = held_noise(self.config.seed, times, self.config.period, TRACKING_ERROR_SIZE)
        return [deviations * noise for _ in names]

    def state(self, model: Model) -> NDArray:
        count = _delay(self.config)
        return np.zeros(LOAD_STATE_SIZE * count + 1 if count else 0)

    @classmethod
    def has_state(cls, model: Model, config: MeasurementConfig) -> bool:
        return config.delay > 0

    def step_period(self, model: Model, config: MeasurementConfig) -> float:
        return config.period

    def describe_response(self) -> LoadMeasurement:
        shown = np.ones(TRACKING_ERROR_SIZE) if self.config.measures_attitude else _WITHOUT_ATTITUDE
        return LoadMeasurement(shown)


def _delay(config: MeasurementConfig) -> int:
    """The delay in periods."""
    return round(config.delay / config.period)


def _measured(line: NDArray, load_state: NDArray, noise: NDArray) -> NDArray:
    """The oldest state (13,) of a line, or the load's own, with an error (12,) in W."""
    if len(line):
        load_state = where(line[-1] > 0, line[-1 - LOAD_STATE_SIZE : -1], load_state)
    error = TrackingError.view(noise)
    quaternion, position, angular_velocity, velocity = LoadState.view(load_state)
    return np.concatenate(
        [
            rotate_quaternion(quaternion, error.orientation),
            position + error.position,
            angular_velocity + error.angular_velocity,
            velocity + error.velocity,
        ]
    )


def _shifted(line: NDArray, load_state: NDArray) -> NDArray:
    """The line after a sample; before its first one it is filled with that."""
    if not len(line):
        return line
    shifted = np.concatenate([load_state, line[: -1 - LOAD_STATE_SIZE]])
    filled = np.tile(load_state, len(shifted) // LOAD_STATE_SIZE)
    return np.concatenate([where(line[-1] > 0, shifted, filled), np.ones(1)])


def held_noise(seed: int, times: NDArray, period: float, size: int) -> NDArray:
    """White, normal noise (k, size) of variance 1, held for a period (s), at times (k,) in s.

    Each sample is drawn from the seed and its number alone.
    """
    held = [math.floor(number(time) / period + 1e-6) for time in times]
    numbers, places = np.unique(held, return_inverse=True)
    drawn = [np.random.default_rng([seed, k]).standard_normal(size) for k in numbers.tolist()]
    return np.array(drawn)[places.ravel()]


@dataclass(kw_only=True)
class FilteredFeedbackConfig(MeasurementConfig):
    """The measurement's, and what the filter believes of it and of the load's motion."""

    # true: controllers get the filtered attitude, in place of corrections of the references alone
    measures_attitude: bool = False
    believed_position_noise: float = non_negative(0.0005)  # m
    believed_orientation_noise: float = non_negative(0.0005)  # rad
    believed_velocity_noise: float = non_negative(0.002)  # m/s
    believed_angular_velocity_noise: float = non_negative(0.002)  # rad/s
    process_acceleration: float = positive(0.05)  # m/s², deviation of its mean over a period
    process_angular_acceleration: float = positive(0.05)  # rad/s², likewise


class FilteredFeedback(NoisyFeedback):
    """A Kalman filter of the load's error, behind the measurement that `NoisyFeedback` makes.

    A late measurement is compared with the reference at its own time, and what the filter knows of
    the error then is carried forward by the delay. So neither the reference's motion nor the delay
    leaves an error of its own. Each axis of the error's pose and rate, x = [p; v], moves by white
    accelerations, of spectral density q = σ² T for a deviation σ of their mean over a period T,

        x⁺ = [[1, T], [0, 1]] x + w,  E[w wᵀ] = q [[T³/3, T²/2], [T²/2, T]],  y = x + noise,

    in W, of the rotation as of the position, see `mechanics.load_estimate`. The process's
    deviations trade noise for lag: what the reference does not tell of the load's motion is to be
    within them. A noise of 0 is believed as 1e-9, with which a measurement is passed on.

    The estimate begins with the load's true state, and is made anew every `period`: at the instant
    of a sample, the one that a controller holds has that instant's measurement in it.
    `measured_load_covariance` has the covariance of the error that is shown.

    Raises:
        ScenarioError: a field is out of range, or the delay no multiple of the period.
    """

    makes = (*NoisyFeedback.makes, "measured_load_covariance")
    where: ClassVar = {}
    reads_time = True

    @staticmethod
    def equations(  # type: ignore[override]
        state: NDArray,
        load_state: NDArray,
        reference: NDArray,
        noise: NDArray,
        time: NDArray,
        *,
        period: float,
        delay: float,
        process: NDArray,
        believed: NDArray,
        is_measured: NDArray,
    ) -> tuple[NDArray, ...]:
        """The state has the estimate, its covariance and its time, and the errors that are late."""
        size = TRACKING_ERROR_SIZE
        estimate, covariance, newest, line = np.split(state, [size, size + 6, size + 7])
        has_begun = newest[0] > _NEVER
        desired = reference[:LOAD_STATE_SIZE]
        error = error_of(load_state, desired)
        seen = (where(has_begun, line[-size:], error) if len(line) else error) + noise
        estimate, covariance = predicted_error(estimate, covariance, time - newest, process)
        estimate = where(has_begun, estimate, error)
        covariance = where(has_begun, covariance, 0 * covariance)
        corrected, less = corrected_error(estimate, covariance, seen, believed)
        is_due = time[0] > newest[0] + _DUE * period
        estimate = where(is_due, corrected, estimate)
        covariance = where(is_due, less, covariance)
        late_by = np.array([delay])
        shown, spread = predicted_error(estimate, covariance, late_by, process)
        if len(line):
            filled = np.tile(error, len(line) // size)
            line = where(has_begun, np.concatenate([error, line[:-size]]), filled)
        is_new = time[0] >= newest[0] + period / 2  # a run may begin at the instant of a sample
        stepped = where(is_new, np.concatenate([corrected, less, time, line]), state)
        whole = state_with_error(shown, desired)
        return stepped, state_with_error(is_measured * shown, desired), whole[:4], spread

    @staticmethod
    def start(*values: NDArray, **constants: Any) -> NDArray:
        return FilteredFeedback.equations(*values, **constants)[0]

    def constants(self, model: Model, config: Any) -> dict[str, Any]:
        def squared(*names: str) -> NDArray:
            values = np.array([getattr(config, name) for name in names])
            return np.maximum(values, _EXACT) ** 2

        noises = "orientation", "angular_velocity", "position", "velocity"
        process = squared("process_angular_acceleration", "process_acceleration")
        return {
            "period": config.period,
            "delay": config.period * _delay(config),
            "process": config.period * process,
            "believed": squared(*(f"believed_{name}_noise" for name in noises)).reshape(2, 2),
            "is_measured": self.describe_response().is_measured,
        }

    def inputs(self, model: Model) -> tuple[str, ...]:
        return self.reads

    def state(self, model: Model) -> NDArray:
        late = np.zeros(TRACKING_ERROR_SIZE * _delay(self.config))
        return np.concatenate([np.zeros(TRACKING_ERROR_SIZE + 6), [_NEVER], late])

    @classmethod
    def has_state(cls, model: Model, config: MeasurementConfig) -> bool:
        return True


VARIANTS = (
    IdealFeedback,
    DesiredStateFeedback,
    DesiredAttitudeFeedback,
    NoisyFeedback,
    FilteredFeedback,
)
