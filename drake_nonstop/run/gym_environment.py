"""The loop as an environment of Gymnasium, by Drake's DrakeGymEnv; `make_gym_env` makes it."""

import math
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray
from pydrake.common import RandomGenerator
from pydrake.gym import DrakeGymEnv
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, EventStatus
from pydrake.systems.primitives import ConstantVectorSource, Multiplexer

from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.loop.start import set_equilibrium
from drake_nonstop.loop.step import with_largest_step
from drake_nonstop.mechanics.signals import (
    LOAD_REFERENCE_SIZE,
    LOAD_STATE_SIZE,
    WRENCH_SIZE,
    CarrierStates,
    LoadReference,
    LoadState,
)
from drake_nonstop.model.system import Model
from drake_nonstop.run.monitor import EndingBlocks
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.systems.compiled_flight import sample_times
from drake_nonstop.systems.tracing import NotFiniteError
from drake_nonstop.validation import require

PARAMETERS, WRENCH = "parameters", "wrench"  # what may be the action
_ACTIONS, _OBSERVATIONS = "actions", "observations"
OBSERVED = ("load_state", "reference", "carrier_state")
DIVERGED = -1000.0  # the reward
_FARTHEST = 100.0  # cable lengths, of a load or a carrier that is plausible
IMPLAUSIBLE = (
    f"the load or a carrier is farther than {_FARTHEST:g} cable lengths from the reference"
)
_ROUNDING = 1e-6  # of a bound, or a period
_TINY = np.finfo(float).tiny

Reward = Callable[[NDArray, NDArray], float]  # of observation and action


class NonstopEnv(DrakeGymEnv):
    """The loop of a scenario, whose optimization layer or wrench controller is the agent.

    See `drake_nonstop.make_gym_env`.
    """

    _config: SimulatorConfig | None  # of the integrator; None: not before the first start

    def __init__(self, scenario: Scenario, action: str, time_step: float, reward: Reward | None):
        self._given, self._action = scenario, action
        simulator, actions = self._simulator_of(scenario.sampled())
        self._judge = reward or self._default_reward
        self._is_reset = False
        size = observation_size(self._scenario)
        super().__init__(
            simulator=simulator,
            time_step=time_step,
            action_space=actions,
            observation_space=gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float64),
            reward=lambda system, context: 0.0,
            action_port_id=_ACTIONS,
            observation_port_id=_OBSERVATIONS,
        )
        self._given_step = time_step

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray, dict[str, Any]]:
        """Starts at the equilibrium under the scenario's own action.

        Where the scenario's fields hold distributions, their numbers are drawn anew, by the seed,
        or, without one, after those that were drawn last. Nothing else is random.
        """
        gymnasium.Env.reset(self, seed=seed)
        require(not options, "options", options, "leave them out, there are none")
        if seed is not None:
            self.generator = RandomGenerator(seed)
        if self._given.sampled() is not self._given:  # it holds distributions
            self.simulator, _ = self._simulator_of(self._given.sampled(self.generator))
            self._setup()
        simulator = self.simulator
        simulator.reset_context(simulator.get_system().CreateDefaultContext())
        context = simulator.get_mutable_context()
        self.action_port.FixValue(context, self._resting)
        set_equilibrium(self._loop, self._loop.GetMyMutableContextFromRoot(context))
        if self._config is None:
            self._config = with_largest_step(
                self._scenario.simulator_config, simulator.get_system(), context
            )
            ApplySimulatorConfig(self._config, simulator)
        simulator.Initialize()
        self._is_reset, self._steps = True, 0
        return self._observation(), {}

    def step(self, action: NDArray) -> tuple[NDArray, float, bool, bool, dict[str, Any]]:
        """Flies on under an action, to the last sample at or before the end of the `time_step`.

        The episode is truncated at the scenario's `simulation_duration`. It is terminated by a
        divergence, with the observation before it, a reward of -1000 and the `message` in the
        info, and where a block ends the run, such as a stall. A divergence is a value that is not
        finite, or a load or a carrier farther than 100 cable lengths from the load's reference.

        Raises:
            ScenarioError: the action is not in the action space, the environment has not been
                reset, or the reward is no number.
        """
        require(self._is_reset, "step", "before reset", "call reset() first")
        values = as_actions(action, self.action_space)
        before = self._observation()
        # To the bit at a sample of the controllers: else some of their updates would come before
        # the observation, and others after it.
        period, self._steps = self._scenario.control_period, self._steps + 1
        end = self._steps * self._given_step
        at_sample = sample_times(samples_until(end, period), period) if period > 0 else end
        end_of_step = at_sample if self._given_step >= period else end
        self.time_step = end_of_step - self.simulator.get_context().get_time()
        try:
            self.simulator.AdvancePendingEvents()  # sampled states step under the last action
            observation, _, terminated, truncated, info = super().step(values)
        except NotFiniteError as error:
            return before, DIVERGED, True, False, {"message": str(error)}
        if is_implausible(observation, np.max(self._scenario.system.cable_length)):
            return before, DIVERGED, True, False, {"message": IMPLAUSIBLE}
        is_over = end >= self._scenario.simulation_duration - 1e-9
        reward = checked_reward(self._judge(observation, values))
        return observation.copy(), reward, bool(terminated), bool(truncated or is_over), info

    def _simulator_of(self, scenario: Scenario) -> tuple[Simulator, gymnasium.spaces.Box]:
        """A simulator of the loop of a scenario without distributions, which is flown from now.

        And the space of its actions.
        """
        self._scenario = scenario
        self._resting, actions = actions_of(scenario, self._action)
        diagram, self._loop = _diagram(scenario, self._action)
        simulator = Simulator(diagram)
        self._config = None

        def end_of_run(root: Context) -> EventStatus:
            if EndingBlocks(self._loop, root).end_now():
                return EventStatus.ReachedTermination(self._loop, "over")
            return EventStatus.DidNothing()

        if EndingBlocks(self._loop, simulator.get_context()).signals:
            simulator.set_monitor(end_of_run)
        return simulator, actions

    def _observation(self) -> NDArray:
        values: NDArray = self.observation_port.Eval(self.simulator.get_context())
        return values.copy()

    def _default_reward(self, observation: NDArray, action: NDArray) -> float:
        scenario = self._scenario
        return float(
            default_reward(observation, np.max(scenario.system.cable_length), scenario.speed_bound)
        )


def observation_size(scenario: Scenario) -> int:
    """The number of entries of an observation."""
    return LOAD_STATE_SIZE + LOAD_REFERENCE_SIZE + 6 * len(scenario.system.attachments)


def default_reward(observations: NDArray, length: Any, bound: Any) -> NDArray:
    """Minus the load's error by the cable's length, and what the slowest carrier lacks of ε.

    Of observations (..., size), lengths in m and bounds in m/s, numbers or arrays (...); 0 is none.
    """
    load, reference, carriers = _views(observations)
    error = load.position - reference.position
    speeds = np.linalg.norm(carriers.velocities, axis=-1)
    lacking = np.maximum(0.0, bound - speeds.min(axis=-1)) / np.maximum(bound, _TINY)
    rewards: NDArray = -np.linalg.norm(error, axis=-1) / length - lacking
    return rewards


def is_implausible(observations: NDArray, length: Any) -> NDArray:
    """Whether load or carriers are farther than 100 cable lengths from the load's reference, (...).

    Of observations (..., size) and lengths in m, a number or an array (...). No action that a task
    needs leads there, and a loop that diverges goes on from there until its numbers are too large.
    """
    load, reference, carriers = _views(observations)
    bodies = np.concatenate([load.position[..., None, :], carriers.positions], axis=-2)
    away = np.linalg.norm(bodies - reference.position[..., None, :], axis=-1).max(axis=-1)
    found: NDArray = away > _FARTHEST * length
    return found


def _views(observations: NDArray) -> tuple[LoadState, LoadReference, CarrierStates]:
    """The parts of observations (..., size)."""
    ends = np.cumsum([LOAD_STATE_SIZE, LOAD_REFERENCE_SIZE])
    load, reference, carriers = np.split(observations, ends, axis=-1)
    return LoadState.view(load), LoadReference.view(reference), CarrierStates.view(carriers)


def checked_reward(reward: Any) -> float:
    """A reward as a number; raises ScenarioError where it is none."""
    remedy = "return a finite number from the function"
    require(np.ndim(reward) == 0 and np.isfinite(reward), "reward", reward, remedy)
    return float(reward)


def samples_until(time: float, period: float) -> int:
    """The number of the controllers' last sample at or before a time, of a period, both in s."""
    return math.floor(time / period + _ROUNDING)


def as_actions(actions: Any, space: gymnasium.spaces.Box, *lead: int) -> NDArray:
    """Actions (*lead, k) as floats; raises ScenarioError where they are not in the space (k,)."""
    try:
        values = np.asarray(actions, dtype=float)
    except (TypeError, ValueError):
        values = np.array(np.nan)
    # A policy of single precision may be beyond a bound by rounding.
    is_within = values.shape == (*lead, *space.shape) and np.all(
        (values >= space.low - _ROUNDING * np.abs(space.low))
        & (values <= space.high + _ROUNDING * np.abs(space.high))
    )
    rows = f", in {lead[0]} rows" if lead else ""
    low, high = space.low.tolist(), space.high.tolist()
    require(is_within, "action", actions, f"give numbers from {low} to {high}{rows}")
    return np.clip(values, space.low, space.high)


def _diagram(scenario: Scenario, action: str) -> tuple[Diagram, Diagram]:
    """A diagram with the ports of the environment, and the loop inside of it."""
    if action == PARAMETERS:
        loop = make_nonstop(scenario, optimization_layer=None, inputs=[PARAMETERS])
    else:
        inputs = [WRENCH, "wrench_rate"]
        loop = make_nonstop(scenario, wrench_controller=None, inputs=inputs)
    builder = DiagramBuilder()
    builder.AddSystem(loop)
    builder.ExportInput(loop.GetInputPort(action), _ACTIONS)
    if action == WRENCH:  # which is held from step to step
        rate = builder.AddSystem(ConstantVectorSource(np.zeros(WRENCH_SIZE)))
        builder.Connect(rate.get_output_port(), loop.GetInputPort("wrench_rate"))
    sizes = [loop.GetOutputPort(name).size() for name in OBSERVED]
    observed = builder.AddSystem(Multiplexer(sizes))
    for i, name in enumerate(OBSERVED):
        builder.Connect(loop.GetOutputPort(name), observed.get_input_port(i))
    builder.ExportOutput(observed.get_output_port(), _OBSERVATIONS)
    return builder.Build(), loop


def actions_of(scenario: Scenario, action: str) -> tuple[NDArray, gymnasium.spaces.Box]:
    """The scenario's own action, and the space of all.

    That is the layer's initial ξ and A within its bounds, or the wrench that carries the weight
    within bounds by the weight.
    """
    if action == PARAMETERS:
        layer = scenario.optimization_layer
        kind = type(layer).__name__.removesuffix("Config")
        remedy = 'it has no ξ and A to begin with; give ConstantParameters, or action="wrench"'
        has_both = hasattr(layer, "frequency") and hasattr(layer, "amplitude")
        require(has_both, "optimization_layer", kind, remedy)
        resting = np.array([layer.frequency, layer.amplitude])
        bounds = [
            getattr(layer, f"{name}_bounds", None) or [0.5 * value, 2 * value]
            for name, value in zip(("frequency", "amplitude"), resting.tolist(), strict=True)
        ]
        least, most = np.array(bounds).T
    else:
        model = Model(scenario.system, scenario.pattern, scenario.control_period)
        force = float(np.squeeze(model.load.mass * model.load.gravity))
        resting = np.array([0.0, 0.0, 0.0, 0.0, 0.0, force])
        reach = float(np.max(np.linalg.norm(model.attachments, axis=1)))
        most = np.array([*3 * [force * reach], *3 * [force]])
        least = -most
        least[-1], most[-1] = 0.0, 2 * force
    return resting, gymnasium.spaces.Box(least, most, dtype=np.float64)
