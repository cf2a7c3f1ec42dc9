"""Box "load_feedback": the measurement of the load's state, a wire in the paper's figure."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import BasicVector, Context, DiscreteValues
from pydrake.systems.primitives import Selector

from drake_nonstop.mechanics.rotation import rotate_quaternion
from drake_nonstop.mechanics.signals import (
    LOAD_REFERENCE_SIZE,
    LOAD_STATE_SIZE,
    TRACKING_ERROR_SIZE,
    LoadState,
    TrackingError,
)
from drake_nonstop.model.system import Model
from drake_nonstop.systems.block import BlockType, LeafBlock, number
from drake_nonstop.systems.traced_block import stacking
from drake_nonstop.validation import (
    StrictFields,
    require,
    require_non_negative,
    require_period,
    require_positive,
    require_seed,
)

_BOX = "load_feedback"


@dataclass(kw_only=True)
class IdealFeedbackConfig(StrictFields):
    """No parameters."""


class IdealFeedback(Selector, metaclass=BlockType):
    """The load's state, exact and without delay.

    .. pydrake_system::

        name: IdealFeedback
        input_ports:
        - load_state
        output_ports:
        - measured_load_state

    Both (13) = [quaternion w x y z, position (m), angular velocity
    (rad/s), velocity (m/s)], in W.
    """

    def __init__(self, model: Model, config: IdealFeedbackConfig | None = None):
        """Makes the block; it takes a `model` and a `config` (None: the default values)."""
        super().__init__(stacking({"load_state": LOAD_STATE_SIZE}, "measured_load_state"))


@dataclass(kw_only=True)
class DesiredStateFeedbackConfig(StrictFields):
    """No parameters."""


class DesiredStateFeedback(LeafBlock):
    """Opens the loop: the controllers get the reference in place of the load's state.

    The wrench controller then demands the wrench of the desired motion alone: the open-loop
    method that the paper starts from.

    .. pydrake_system::

        name: DesiredStateFeedback
        input_ports:
        - reference
        output_ports:
        - measured_load_state

    `measured_load_state` (13) = [quaternion w x y z, position (m), angular velocity
    (rad/s), velocity (m/s)], in W: the first part of `reference` (22).
    """

    def __init__(self, model: Model, config: DesiredStateFeedbackConfig | None = None):
        super().__init__()
        self._reference = self.DeclareVectorInputPort("reference", LOAD_REFERENCE_SIZE)
        self.DeclareVectorOutputPort(
            "measured_load_state", LOAD_STATE_SIZE, self._calc, {self.all_input_ports_ticket()}
        )

    def _calc(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._reference.Eval(context)[:LOAD_STATE_SIZE])


@dataclass(kw_only=True)
class DesiredAttitudeFeedbackConfig(StrictFields):
    """No parameters."""


class DesiredAttitudeFeedback(Selector, metaclass=BlockType):
    """The load's position and velocity, exact and without delay; its attitude as desired.

    This opens the attitude loop: neither the torque nor the directions of the cable forces follow
    the load's tilt. Cables of 100 m and more need that, since a change of 1 N, or of a hundredth of
    a radian, moves the carriers by metres.

    .. pydrake_system::

        name: DesiredAttitudeFeedback
        input_ports:
        - load_state
        - reference
        output_ports:
        - measured_load_state

    `load_state` and `measured_load_state` (13) = [quaternion w x y z, position (m), angular
    velocity (rad/s), velocity (m/s)], in W; quaternion and angular velocity are those of
    `reference` (22).
    """

    def __init__(self, model: Model, config: DesiredAttitudeFeedbackConfig | None = None):
        """Makes the block; it takes a `model` and a `config` (None: the default values)."""
        sizes = {"load_state": LOAD_STATE_SIZE, "reference": LOAD_REFERENCE_SIZE}
        params = stacking(sizes, "measured_load_state")
        entries = np.arange(LOAD_STATE_SIZE)
        state, desired = LoadState.view(entries), LoadState.view(LOAD_STATE_SIZE + entries)
        chosen = LoadState(
            desired.quaternion, state.position, desired.angular_velocity, state.velocity
        )
        (output,) = params.outputs
        output.selections = [output.selections[i] for i in np.concatenate(chosen)]
        params.outputs = [output]
        super().__init__(params)


@dataclass(kw_only=True)
class NoisyFeedbackConfig(StrictFields):
    """Standard deviations on each axis, and the delay."""

    position_noise: float = 0.0  # m
    orientation_noise: float = 0.0  # rad
    velocity_noise: float = 0.0  # m/s
    angular_velocity_noise: float = 0.0  # rad/s
    delay: float = 0.0  # s, a multiple of the period
    period: float = 0.01  # s, between samples of the noise and of the delayed state
    seed: int = 0  # of the noise


class NoisyFeedback(LeafBlock):
    """The load's state with noise and delay.

    The noise is white and normal: a sample per `period`, held to the next, drawn from the
    seed and the sample's number alone, so that runs repeat to the bit. The orientation is
    rotated by a random rotation vector in W. With a delay of N periods, a controller that
    samples every period gets the state of N periods before; in the first N periods the state at
    the start.

    .. pydrake_system::

        name: NoisyFeedback
        input_ports:
        - load_state
        output_ports:
        - measured_load_state

    Both (13) = [quaternion w x y z, position (m), angular velocity
    (rad/s), velocity (m/s)], in W.

    Parameters, the fields of `NoisyFeedbackConfig`:
        position_noise: m
        orientation_noise: rad
        velocity_noise: m/s
        angular_velocity_noise: rad/s
        delay: s, a multiple of the period
        period: s, between samples of the noise and of the delayed state
        seed: of the noise

    Attributes:
        deviations: (12,), standard deviations of the errors, in the order of a `TrackingError`.
        delay_periods: the delay in periods.
        period: s, between samples.

    Raises:
        ScenarioError: a field is out of range, or the delay no multiple of the period.
    """

    def __init__(self, model: Model, config: NoisyFeedbackConfig | None = None):
        super().__init__()
        config = config or NoisyFeedbackConfig()
        deviations = {
            "orientation_noise": config.orientation_noise,
            "position_noise": config.position_noise,
            "angular_velocity_noise": config.angular_velocity_noise,
            "velocity_noise": config.velocity_noise,
        }
        require_non_negative(_BOX, delay=config.delay, **deviations)
        require_positive(_BOX, period=config.period)
        require_period(f"{_BOX}.period", config.period)
        require_seed(f"{_BOX}.seed", config.seed)
        self.delay_periods = round(config.delay / config.period)
        require(
            abs(self.delay_periods * config.period - config.delay) < 1e-9
            and self.delay_periods <= 1000,
            f"{_BOX}.delay",
            config.delay,
            f"give a multiple of the period {config.period:g} s, at most 1000 of them",
        )
        self.period, self._seed = config.period, config.seed
        self.deviations = np.repeat(list(deviations.values()), 3)
        self._load_state = self.DeclareVectorInputPort("load_state", LOAD_STATE_SIZE)
        prerequisites = {self.all_input_ports_ticket(), self.time_ticket()}
        if self.delay_periods > 0:
            # The last samples, the newest first, their number, and the time of the newest.
            self._samples = self.DeclareDiscreteState(LOAD_STATE_SIZE * self.delay_periods)
            self._count = self.DeclareDiscreteState(1)
            self._newest = self.DeclareDiscreteState([-np.inf])
            self.DeclareInitializationDiscreteUpdateEvent(self._sample)
            # The same offset as the sample-and-hold's: with another one, rounding would decide
            # at each sample which of the two events comes first.
            self.DeclarePeriodicDiscreteUpdateEvent(config.period, config.period, self._sample)
            prerequisites.add(self.xd_ticket())
        self.DeclareVectorOutputPort(
            "measured_load_state", LOAD_STATE_SIZE, self._calc, prerequisites
        )

    def _sample(self, context: Context, discrete_state: DiscreteValues) -> None:
        newest = number(context.get_discrete_state(self._newest)[0])
        if number(context.get_time()) < newest + self.period / 2:
            return  # a run that starts at the instant of a sample triggers both events
        samples = context.get_discrete_state(self._samples).CopyToVector()
        count = number(context.get_discrete_state(self._count)[0])
        samples = np.concatenate([self._load_state.Eval(context), samples[:-LOAD_STATE_SIZE]])
        discrete_state.set_value(self._samples, samples)
        discrete_state.set_value(self._newest, [context.get_time()])
        discrete_state.set_value(self._count, [min(count + 1, self.delay_periods)])

    def _calc(self, context: Context, output: BasicVector) -> None:
        state = self._load_state.Eval(context)
        if self.delay_periods > 0:
            count = int(number(context.get_discrete_state(self._count)[0]))
            if count > 0:  # otherwise the state at the start
                samples = context.get_discrete_state(self._samples).CopyToVector()
                state = samples[LOAD_STATE_SIZE * (count - 1) : LOAD_STATE_SIZE * count]
        output.SetFromVector(self._noisy(state, number(context.get_time())))

    def _noisy(self, state: NDArray, time: float) -> NDArray:
        if not self.deviations.any():
            return state
        number = int(np.floor(time / self.period + 1e-6))
        generator = np.random.default_rng([self._seed, number])
        noise = TrackingError.view(  # all of it in W
            self.deviations * generator.standard_normal(TRACKING_ERROR_SIZE)
        )
        quaternion, position, angular_velocity, velocity = LoadState.view(state)
        return np.concatenate(
            [
                rotate_quaternion(quaternion, noise.orientation),
                position + noise.position,
                angular_velocity + noise.angular_velocity,
                velocity + noise.velocity,
            ]
        )


# The blocks that the box can be, the default first.
VARIANTS = (IdealFeedback, DesiredStateFeedback, DesiredAttitudeFeedback, NoisyFeedback)
