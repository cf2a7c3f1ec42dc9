"""Box "load_feedback": the measurement of the load's state, a wire in the paper's figure."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydrake.math import DiscreteAlgebraicRiccatiEquation

from drake_nonstop.mechanics.load_estimate import corrected_state, predicted_state
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
    makes = ("measured_load_state",)

    @staticmethod
    def equations(load_state: NDArray) -> NDArray:
        return load_state


@dataclass(kw_only=True)
class DesiredStateFeedbackConfig(StrictFields):
    """No parameters."""


class DesiredStateFeedback(Block):
    """Opens the loop: the controllers get the reference in place of the load's state.

    The wrench controller then demands the wrench of the desired motion alone: the open-loop
    method that the paper starts from.
    """

    reads = ("reference",)
    makes = ("measured_load_state",)

    @staticmethod
    def equations(reference: NDArray) -> NDArray:
        return reference[:LOAD_STATE_SIZE]

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
    makes = ("measured_load_state",)

    @staticmethod
    def equations(load_state: NDArray, reference: NDArray) -> NDArray:
        return _with_attitude(load_state, reference)

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
    """Values of the measurement."""


class NoisyFeedback(Block):
    """The load's state with noise and delay.

    The noise is white and normal: a sample per `period`, held to the next, drawn from the
    seed and the sample's number alone, so that runs repeat to the bit. The orientation is
    rotated by a random rotation vector in W. With a delay of N periods, a controller that
    samples every period gets the state of N periods before; in the first N periods the state at
    the start. Without `measures_attitude` the attitude loop is open, as in
    `DesiredAttitudeFeedback`: quaternion and angular velocity are the reference's, of now.

    The state is a line of the last N samples, the newest first, and 1 where it has begun, else 0.

    Raises:
        ScenarioError: a field is out of range, or the delay no multiple of the period.
    """

    reads = ("load_state", "reference")
    makes = ("measured_load_state",)
    where: ClassVar = {"reference": "`measures_attitude` is false"}
    makes_next_state = True

    @staticmethod
    def equations(line: NDArray, load_state: NDArray, *others: NDArray) -> tuple[NDArray, NDArray]:
        """Behind the load's state: the reference, if it is read, and the noise."""
        *reference, noise = others
        shown = _with_attitude(_measured(line, load_state, noise), *reference)
        return _shifted(line, load_state), shown

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
class EstimatedFeedbackConfig(MeasurementConfig):
    """The measurement's, and what the filter believes of it and of the load's motion."""

    believed_position_noise: float = non_negative(0.01)  # m
    believed_orientation_noise: float = non_negative(0.02)  # rad
    believed_velocity_noise: float = non_negative(0.0)  # m/s; 0: measured exactly
    believed_angular_velocity_noise: float = non_negative(0.0)  # rad/s; 0: measured exactly
    process_acceleration: float = positive(0.05)  # m/s², deviation of its mean over a period
    process_angular_acceleration: float = positive(0.05)  # rad/s², likewise


class EstimatedFeedback(NoisyFeedback):
    """A steady-state Kalman filter behind the measurement that `NoisyFeedback` makes.

    The motion that it believes in has white accelerations, of spectral density q = σ² T for a
    deviation σ of their mean over a period T: for each axis of the position, x = [p; v], and of a
    small rotation and the angular velocity likewise,

        x⁺ = [[1, T], [0, 1]] x + w,  E[w wᵀ] = q [[T³/3, T²/2], [T²/2, T]],  y = x + noise.

    The gain K of x̂⁺ = x̂ + K (y − x̂) follows from Drake's solution of the Riccati equation, see
    `steady_state_gain`. A rate without noise is taken as it is measured, and the pose is then
    integrated from it; a pose without noise is, too. The rotation is corrected multiplicatively,
    see `mechanics.load_estimate`.

    The process's deviations trade noise for lag. The defaults are for exact rates, with which there
    is no lag, and what the pose's measurement corrects is small; where rates are noisy, too, give
    about the load's largest accelerations.

    The estimate begins with the load's true state, and is made anew every `period`: at the instant
    of a sample, the one that a controller holds has that instant's measurement in it; between two
    samples it goes on with its velocities. It is one of the delayed state: no delay is made up for.

    Raises:
        ScenarioError: a field is out of range, or the delay no multiple of the period.
    """

    reads_time = True

    @staticmethod
    def equations(  # type: ignore[override]
        state: NDArray,
        load_state: NDArray,
        *others: NDArray,
        period: float,
        gains: tuple[NDArray, NDArray],
    ) -> tuple[NDArray, NDArray]:
        """The state has the estimate, the time of its last measurement, and what is delayed."""
        *reference, noise, time = others
        estimate, newest, line = np.split(state, [LOAD_STATE_SIZE, LOAD_STATE_SIZE + 1])
        measured = _measured(line, load_state, noise)
        predicted = predicted_state(estimate, time - newest)
        has_begun = newest[0] > _NEVER
        corrected = where(has_begun, corrected_state(predicted, measured, *gains), load_state)
        predicted = where(has_begun, predicted, load_state)
        is_due = time[0] > newest[0] + _DUE * period
        shown = _with_attitude(where(is_due, corrected, predicted), *reference)
        after = np.concatenate([corrected, time, _shifted(line, load_state)])
        is_new = time[0] >= newest[0] + period / 2  # a run may begin at the instant of a sample
        return where(is_new, after, state), shown

    @staticmethod
    def start(*values: NDArray, **constants: Any) -> NDArray:
        return EstimatedFeedback.equations(*values, **constants)[0]

    def constants(self, model: Model, config: Any) -> dict[str, Any]:
        return {"period": config.period, "gains": self._gains(config)}

    def state(self, model: Model) -> NDArray:
        return np.concatenate([np.eye(LOAD_STATE_SIZE)[0], [_NEVER], super().state(model)])

    @classmethod
    def has_state(cls, model: Model, config: MeasurementConfig) -> bool:
        return True

    @staticmethod
    def _gains(config: EstimatedFeedbackConfig) -> tuple[NDArray, NDArray]:
        """K (2, 2) of [rotation; angular velocity], and of [position; velocity]; 1, s and 1/s."""
        rotation = config.believed_orientation_noise, config.believed_angular_velocity_noise
        translation = config.believed_position_noise, config.believed_velocity_noise
        return (
            steady_state_gain(*rotation, config.process_angular_acceleration, config.period),
            steady_state_gain(*translation, config.process_acceleration, config.period),
        )


def steady_state_gain(
    pose_noise: float, rate_noise: float, acceleration: float, period: float
) -> NDArray:
    """K (2, 2) of the steady-state Kalman filter of a double integrator that white noise drives.

    Of x = [pose; rate], both measured; the estimate after a measurement y is x̂ + K (y − x̂). The
    covariance P⁺ after a measurement fulfils a Riccati equation in which the next one is one of
    A x + w, so that its noise has the covariance Q + R, and is correlated with w. That is regular
    where R is not; what is measured exactly has no part in P⁺, and drops out of the equation.
    Anderson and Moore, "Optimal Filtering", 1979, section 5.4.

    Args:
        pose_noise: standard deviation of the measured pose; 0: it is exact.
        rate_noise: that of the rate, 1/s.
        acceleration: deviation of the mean acceleration over a period, 1/s².
        period: s.
    """
    # In units of the period, and of a rate's change in it.
    transition = np.array([[1.0, 1.0], [0.0, 1.0]])
    process = np.array([[1 / 3, 1 / 2], [1 / 2, 1.0]])
    units = acceleration * period * np.array([period, 1.0])
    noise = (np.array([pose_noise, rate_noise]) / units) ** 2
    noisy = np.eye(2)[:, noise > 0]
    spread = np.zeros((noisy.shape[1],) * 2)
    if noisy.size > 0:
        moved = transition @ noisy
        spread = DiscreteAlgebraicRiccatiEquation(
            (noisy.T @ moved).T,
            moved.T,
            noisy.T @ process @ noisy,
            process + np.diag(noise),
            noisy.T @ process,
        )
    before = transition @ noisy @ spread @ noisy.T @ transition.T + process
    gain = np.linalg.solve(before + np.diag(noise), before).T
    return gain * np.array([[1.0, period], [1 / period, 1.0]])


VARIANTS = (
    IdealFeedback,
    DesiredStateFeedback,
    DesiredAttitudeFeedback,
    NoisyFeedback,
    EstimatedFeedback,
)
