"""Box "load_feedback": the plain wire of the paper's figure."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import BasicVector, Context, DiscreteValues
from pydrake.systems.primitives import Selector

from drake_nonstop.mechanics.rotation import rotate_quaternion
from drake_nonstop.model.system import Model
from drake_nonstop.systems.block import BlockType, LeafBlock
from drake_nonstop.systems.traced_block import stacking
from drake_nonstop.validation import (
    require,
    require_non_negative,
    require_positive,
    require_seed,
)


@dataclass(kw_only=True)
class IdealFeedbackConfig:
    """No parameters."""


class IdealFeedback(Selector, metaclass=BlockType):
    """Passes the load's state on, unchanged and at once.

    .. pydrake_system::

        name: IdealFeedback
        input_ports:
        - load_state
        output_ports:
        - measured_load_state

    Both (13): [quaternion, position, angular velocity, velocity], in W.
    """

    def __init__(self, model: Model, config: IdealFeedbackConfig | None = None):
        super().__init__(stacking({"load_state": 13}, "measured_load_state"))


@dataclass(kw_only=True)
class DesiredStateFeedbackConfig:
    """No parameters."""


class DesiredStateFeedback(LeafBlock):
    """Opens the loop: what the controllers take for the load's state is its reference.

    With it the wrench controller asks for the wrench of the desired motion alone, which
    is the open-loop method that the paper starts from.

    .. pydrake_system::

        name: DesiredStateFeedback
        input_ports:
        - reference
        output_ports:
        - measured_load_state

    `measured_load_state` (13) is the first part of `reference` (22).
    """

    def __init__(self, model: Model, config: DesiredStateFeedbackConfig | None = None):
        super().__init__()
        self._reference = self.DeclareVectorInputPort("reference", 22)
        self.DeclareVectorOutputPort(
            "measured_load_state", 13, self._calc, {self.all_input_ports_ticket()}
        )

    def _calc(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._reference.Eval(context)[:13])


@dataclass(kw_only=True)
class NoisyFeedbackConfig:
    """Standard deviations on each axis, and the delay."""

    position_noise: float = 0.0  # m
    orientation_noise: float = 0.0  # rad
    velocity_noise: float = 0.0  # m/s
    angular_velocity_noise: float = 0.0  # rad/s
    delay: float = 0.0  # s, a multiple of the period
    period: float = 0.01  # s, between samples of the noise and of what is delayed
    seed: int = 0  # of the noise


class NoisyFeedback(LeafBlock):
    """Passes the load's state on with noise, after a delay.

    The noise is white and normal: a sample per `period`, held to the next, drawn from the
    seed and the sample's number alone, so that runs repeat to the bit. The orientation is
    turned by a random rotation vector in W. With a delay of N periods, what a controller
    sees that samples every period is the state N periods ago; before that the state at the
    start.

    .. pydrake_system::

        name: NoisyFeedback
        input_ports:
        - load_state
        output_ports:
        - measured_load_state

    Both (13): [quaternion, position, angular velocity, velocity], in W.

    Raises:
        ScenarioError: a field is out of range, or the delay no multiple of the period.
    """

    def __init__(self, model: Model, config: NoisyFeedbackConfig | None = None):
        super().__init__()
        config = config or NoisyFeedbackConfig()
        owner = "load_feedback"
        deviations = {
            "orientation_noise": config.orientation_noise,
            "position_noise": config.position_noise,
            "angular_velocity_noise": config.angular_velocity_noise,
            "velocity_noise": config.velocity_noise,
        }
        require_non_negative(owner, delay=config.delay, **deviations)
        require_positive(owner, period=config.period)
        require_seed(f"{owner}.seed", config.seed)
        self._periods = round(config.delay / config.period)
        require(
            abs(self._periods * config.period - config.delay) < 1e-9 and self._periods <= 1000,
            f"{owner}.delay",
            config.delay,
            f"give a multiple of the period {config.period:g} s, at most 1000 of them",
        )
        self._period, self._seed = config.period, config.seed
        self._deviations = np.repeat(list(deviations.values()), 3)
        self._load_state = self.DeclareVectorInputPort("load_state", 13)
        prerequisites = {self.all_input_ports_ticket(), self.time_ticket()}
        if self._periods > 0:
            # The last samples, the newest first, how many of them there are, and when it was.
            self._samples = self.DeclareDiscreteState(13 * self._periods)
            self._count = self.DeclareDiscreteState(1)
            self._newest = self.DeclareDiscreteState([-np.inf])
            self.DeclareInitializationDiscreteUpdateEvent(self._sample)
            # The same offset as the sample-and-hold's: with another one rounding would have the
            # two events now together and now one after the other.
            self.DeclarePeriodicDiscreteUpdateEvent(config.period, config.period, self._sample)
            prerequisites.add(self.xd_ticket())
        self.DeclareVectorOutputPort("measured_load_state", 13, self._calc, prerequisites)

    def _sample(self, context: Context, discrete_state: DiscreteValues) -> None:
        newest = context.get_discrete_state(self._newest).value()[0]
        if context.get_time() < newest + self._period / 2:
            return  # a run that starts at the instant of a sample fires both events
        samples = context.get_discrete_state(self._samples).value()
        count = context.get_discrete_state(self._count).value()[0]
        samples = np.concatenate([self._load_state.Eval(context), samples[:-13]])
        discrete_state.set_value(self._samples, samples)
        discrete_state.set_value(self._newest, [context.get_time()])
        discrete_state.set_value(self._count, [min(count + 1, self._periods)])

    def _calc(self, context: Context, output: BasicVector) -> None:
        state = self._load_state.Eval(context)
        if self._periods > 0:
            count = int(context.get_discrete_state(self._count).value()[0])
            if count > 0:  # else this is the start
                samples = context.get_discrete_state(self._samples).value()
                state = samples[13 * (count - 1) : 13 * count]
        output.SetFromVector(self._noisy(state, context.get_time()))

    def _noisy(self, state: NDArray, time: float) -> NDArray:
        if not self._deviations.any():
            return state
        number = int(np.floor(time / self._period + 1e-6))
        noise = self._deviations * np.random.default_rng([self._seed, number]).standard_normal(12)
        return np.concatenate([rotate_quaternion(state[:4], noise[:3]), state[4:] + noise[3:]])


VARIANTS = (
    IdealFeedback,
    DesiredStateFeedback,
    NoisyFeedback,
)  # of the box, the default first
