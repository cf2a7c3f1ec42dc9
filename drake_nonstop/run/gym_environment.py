"""Loops side by side as one environment of Gymnasium's vector API, and one of them alone.

The action is a parameter of a block that stands in the place of the layer or the controller, so
that the loop has no inputs. `make_gym_vec_env` and `make_gym_env` make the environments.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray
from pydrake.common import RandomGenerator
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator
from pydrake.systems.framework import Context, EventStatus

from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.loop.parameters import set_parameter
from drake_nonstop.loop.start import copied_context, set_equilibrium
from drake_nonstop.loop.step import with_largest_step
from drake_nonstop.mechanics.signals import (
    LOAD_REFERENCE_SIZE,
    LOAD_STATE_SIZE,
    WRENCH_SIZE,
    CarrierStates,
    LoadReference,
    LoadState,
)
from drake_nonstop.model.block import Block
from drake_nonstop.model.system import Model
from drake_nonstop.run.monitor import EndingBlocks
from drake_nonstop.scenario.schema import Scenario, sample
from drake_nonstop.systems.compiled_flight import (
    Advance,
    CompiledFlight,
    advance_together,
    sample_times,
)
from drake_nonstop.systems.compiled_loop import CompiledLoop, NotCompiledError
from drake_nonstop.systems.tracing import NotFiniteError
from drake_nonstop.validation import StrictFields, require, warn_user

PARAMETERS, WRENCH = "parameters", "wrench"  # what may be the action
_OBSERVED = ("load_state", "reference", "carrier_state")
_DIVERGED = -1000.0  # the reward
_FARTHEST = 100.0  # cable lengths, of a load or a carrier that is plausible
_IMPLAUSIBLE = (
    f"the load or a carrier is farther than {_FARTHEST:g} cable lengths from the reference"
)
_ROUNDING = 1e-6  # of a bound, or a period
_TINY = np.finfo(float).tiny
_HOLDER = "action"  # the name of the block that holds it
_WORTH_LANES = 4  # flights
_LARGEST_SEED = 2**32 - 1  # of Drake's RandomGenerator

Reward = Callable[[NDArray, NDArray], float]  # of observation and action


@dataclass(kw_only=True)
class _HeldAction(StrictFields):
    action: list[float] = field(default_factory=list)


class _HeldParameters(Block):
    """ξ (rad/s) and A (N) that are a parameter of the context."""

    makes = (PARAMETERS,)

    @staticmethod
    def equations(*, action: NDArray) -> NDArray:
        return action


class _HeldWrench(Block):
    """A wrench (N m, N) that is a parameter of the context, held from step to step."""

    makes = (WRENCH, "wrench_rate")

    @staticmethod
    def equations(*, action: NDArray) -> tuple[NDArray, NDArray]:
        return action, np.zeros(WRENCH_SIZE)


_HOLDERS = {  # of an action, and the boxes in whose places they stand
    PARAMETERS: (_HeldParameters, "optimization_layer"),
    WRENCH: (_HeldWrench, "wrench_controller"),
}


class _Flown(NamedTuple):
    """What an episode has shown at the end of a step."""

    observation: NDArray
    has_ended: bool  # by a block
    error: BaseException | None


class _Start:
    """The loop of a scenario without distributions, at the start of an episode.

    Attributes:
        scenario: of the loop.
        space: of the actions.
        loop: the compiled one; None: the diagram flies.
        reason: why it does.
        observation: at the equilibrium under the scenario's own action.
    """

    def __init__(self, scenario: Scenario, action: str, time_step: float):
        self.scenario, self._time_step = scenario, time_step
        self._period, (holder, box) = scenario.control_period, _HOLDERS[action]
        remedy = f"give at least control_period = {self._period:g} s"
        require(time_step >= self._period, "time_step", time_step, remedy)
        resting, self.space = _actions_of(scenario, action)
        held = _HeldAction(action=resting.tolist())
        blocks: dict[str, Any] = {"extra": {_HOLDER: lambda own: holder(own, held)}}
        self._nonstop = nonstop = make_nonstop(
            scenario, at_equilibrium=False, **blocks | {box: None}
        )
        self._context = context = nonstop.CreateDefaultContext()
        self._ending = EndingBlocks(nonstop, context)
        ends = self._ending.signals
        shown = (*dict.fromkeys([*_OBSERVED, *ends]),)
        signals, steps = ((), shown) if ends else (shown, ())  # any step may be the last one
        set_equilibrium(nonstop, context, start_error=scenario.start_error)
        self._config = with_largest_step(scenario.simulator_config, nonstop, context)
        self.loop: CompiledLoop | None = None
        self.reason = ""
        self._ports = [nonstop.GetOutputPort(name) for name in _OBSERVED]
        try:
            self.loop = CompiledLoop(
                nonstop, self._config, self._period, signals=signals, step_signals=steps
            )
        except NotCompiledError as error:
            self.reason, self._simulator = str(error), self._simulator_of()
            self.observation = self.begin(None)
            return
        first = self.loop.parameter_names.index(f"{_HOLDER}.action[0]")
        self._action = slice(first, first + len(resting))
        flight = self.loop.fly(context)
        size = sum(port.size() for port in self._ports)
        self.observation = np.concatenate(flight.start())[:size]
        self._state = flight.state

    def _simulator_of(self) -> Simulator:
        """Of the diagram; an end by a block ends its flight."""
        simulator = Simulator(self._nonstop)
        ApplySimulatorConfig(self._config, simulator)

        def end_of_run(root: Context) -> EventStatus:
            if EndingBlocks(self._nonstop, root).end_now():
                return EventStatus.ReachedTermination(self._nonstop, "over")
            return EventStatus.DidNothing()

        if self._ending.signals:
            simulator.set_monitor(end_of_run)
        return simulator

    def flight(self) -> CompiledFlight | None:
        """A new flight of the compiled loop; None: there is none."""
        return None if self.loop is None else self.loop.fly(self._context)

    def begin(self, flight: CompiledFlight | None) -> NDArray:
        """Sets a flight, or the diagram, to the start; the observation there."""
        if flight is not None:
            flight.go_to(0, self._state)
            return self.observation
        self._simulator.reset_context(copied_context(self._nonstop, self._context))
        self._simulator.Initialize()
        return self._observed()

    def _observed(self) -> NDArray:
        context = self._simulator.get_context()
        return np.concatenate([port.Eval(context) for port in self._ports])

    def act(self, flight: CompiledFlight | None, action: NDArray) -> None:
        """Sets the action from now on."""
        if flight is not None:
            flight.set_parameters(self._action, action)
            return
        self._simulator.AdvancePendingEvents()  # sampled states step under the last action
        context = self._simulator.get_mutable_context()
        set_parameter(self._nonstop, context, f"{_HOLDER}.action", action)

    def samples(self, steps: int) -> int:
        """The number of samples at the end of so many steps."""
        return math.floor(steps * self._time_step / self._period + _ROUNDING)

    def fly(self, steps: int) -> _Flown:
        """Flies the diagram to the end of so many steps."""
        end = steps * self._time_step
        if self._period > 0:
            end = float(sample_times(self.samples(steps), self._period))
        try:
            status = self._simulator.AdvanceTo(end)
        except NotFiniteError as error:
            return _Flown(self.observation, False, error)
        has_ended = status.reason() == status.ReturnReason.kReachedTerminationCondition
        return _Flown(self._observed(), has_ended, None)

    def flown(self, advance: Advance) -> _Flown:
        """Observation after a flight of the compiled loop."""
        size = len(self.observation)
        if advance.error is not None:
            return _Flown(self.observation, False, advance.error)
        if not self._ending.signals:
            return _Flown(advance.signals[-1, :size], False, None)
        assert self.loop is not None
        end = self._ending.first_end(self.loop.step_signals, advance.step_signals)
        row = advance.step_signals[-1 if end is None else end]
        return _Flown(row[:size], end is not None, None)


class NonstopVecEnv(VectorEnv[NDArray, NDArray, NDArray]):
    """Episodes of a scenario side by side; see `drake_nonstop.make_gym_vec_env`."""

    def __init__(
        self,
        scenario: Scenario,
        n: int,
        action: str,
        time_step: float,
        reward: Reward | None,
        begins_anew: bool = True,
    ):
        self.metadata = {"autoreset_mode": AutoresetMode.SAME_STEP}
        self.num_envs, self._given, self._reward = n, scenario, reward
        self._begins_anew = (
            begins_anew  # where an episode is over; if not, `reset` has to be called
        )
        self._kind = action, time_step
        sampled, drawn = sample(scenario)
        self._is_drawn = bool(drawn)
        start = _Start(sampled, *self._kind)
        if start.loop is not None and n >= _WORTH_LANES:
            start.loop.prepare_lanes()
        elif start.loop is None and n > 1:
            warn_user(f"{start.reason}; the {n} environments fly one by one, by their diagrams")
        # A diagram flies one episode at a time.
        others = n - 1 if start.loop is None and not self._is_drawn else 0
        self._starts = [start, *(_Start(sampled, *self._kind) for _ in range(others))]
        self._starts += (n - len(self._starts)) * [start]
        self._flights = [own.flight() for own in self._starts]
        self.single_action_space, size = start.space, len(start.observation)
        self.single_observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float64)
        self.action_space = batch_space(self.single_action_space, n)
        self.observation_space = batch_space(self.single_observation_space, n)
        seeds = [(scenario.random_seed + i) % (_LARGEST_SEED + 1) for i in range(n)]
        self._generators = [*map(RandomGenerator, seeds)]
        self._observations, self._steps = np.zeros((n, size)), np.zeros(n, int)
        self._numbers = np.ones((3, n))  # cable's length, m, ε, m/s, and duration, s
        self._is_reset = False

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: Any = None
    ) -> tuple[NDArray, dict[str, Any]]:
        """Starts all episodes, as single environments do with a seed for each.

        A number is the first one's seed, and each exceeds the one before by 1. Where the scenario's
        fields hold distributions, their numbers are drawn anew, by the seed, or, without one, after
        those that were drawn last. Nothing else is random.

        Raises:
            ScenarioError: a seed cannot be used, there are options, or a scenario that was drawn
                cannot be built.
        """
        require(not options, "options", options, "leave them out, there are none")
        n, given = self.num_envs, np.asarray(seed).tolist()  # plain numbers
        seeds: Any = [*range(given, given + n)] if type(given) is int else given or n * [None]
        is_right = isinstance(seeds, list) and len(seeds) == n
        is_right = is_right and all(
            own is None or (type(own) is int and 0 <= own <= _LARGEST_SEED) for own in seeds
        )
        remedy = f"give a whole number from 0 to {_LARGEST_SEED}, or {n} of them, or None"
        require(is_right, "seed", seed, remedy)
        super().reset(seed=seeds[0])
        for i, own in enumerate(seeds):
            if own is not None:
                self._generators[i] = RandomGenerator(own)
            self._begin(i)
        self._is_reset = True
        return self._observations.copy(), {}

    def _begin(self, i: int) -> None:
        """Starts an episode of one environment."""
        if self._is_drawn:
            own = _Start(self._given.sampled(self._generators[i]), *self._kind)
            self._starts[i], self._flights[i] = own, own.flight()
        scenario = self._starts[i].scenario
        length, duration = np.max(scenario.system.cable_length), scenario.simulation_duration
        self._numbers[:, i] = length, scenario.speed_bound, duration
        self._steps[i] = 0
        self._observations[i] = self._starts[i].begin(self._flights[i])

    def step(self, actions: NDArray) -> tuple[NDArray, NDArray, NDArray, NDArray, dict[str, Any]]:
        """Flies each episode on under its action, a row of `actions` (n, k), as a single one does.

        One that is over begins anew at once: its row of the observations (n, size) is the first one
        then, and the infos have `final_obs` and `final_info`. After a divergence the last
        observation is that before it.

        Raises:
            ScenarioError: an action is not in the action space, the environment has not been
                reset, or a reward is no number.
        """
        require(self._is_reset, "step", "before reset", "call reset() first")
        values = _as_actions(actions, self.single_action_space, self.num_envs)
        self._is_reset = False  # until all are flown
        observations, infos = self._observations, dict[str, Any]()
        self._steps += 1
        has_ended, messages = np.zeros(self.num_envs, bool), dict[int, dict[str, str]]()
        for i, flown in enumerate(self._flown(values)):
            if flown.error is not None and not isinstance(flown.error, NotFiniteError):
                raise flown.error
            if flown.error is not None:
                messages[i] = {"message": str(flown.error)}
            elif _is_implausible(flown.observation, self._numbers[0, i]):
                messages[i] = {"message": _IMPLAUSIBLE}
            else:
                observations[i] = flown.observation
            has_ended[i] = flown.has_ended or i in messages
        rewards = np.full(self.num_envs, _DIVERGED)
        at = [i for i in range(self.num_envs) if i not in messages]
        if at:
            rewards[at] = self._rewards(at, values)
        is_late = self._steps * self._kind[1] >= self._numbers[2] - 1e-9
        is_truncated = ~has_ended & is_late
        ends = np.flatnonzero(has_ended | is_truncated).tolist()
        for i in ends:
            info = {"final_obs": observations[i].copy(), "final_info": messages.get(i, {})}
            infos = self._add_info(infos, info, i)
            if self._begins_anew:
                self._begin(i)
        self._is_reset = self._begins_anew or not ends
        return observations.copy(), rewards, has_ended, is_truncated, infos

    def _flown(self, actions: NDArray) -> list[_Flown]:
        """Flies the episodes to the ends of their steps, side by side or by diagrams."""
        for start, flight, action in zip(self._starts, self._flights, actions, strict=True):
            start.act(flight, action)
        steps = [*zip(self._starts, self._steps.tolist(), strict=True)]
        flights = [flight for flight in self._flights if flight is not None]
        if len(flights) < self.num_envs:
            return [start.fly(count) for start, count in steps]
        counts = [start.samples(count) - start.samples(count - 1) for start, count in steps]
        advances = advance_together(flights, counts)
        return [start.flown(each) for start, each in zip(self._starts, advances, strict=True)]

    def _rewards(self, at: list[int], actions: NDArray) -> Any:
        """Rewards of some environments, after their actions among all (n, k)."""
        if self._reward is None:
            return _default_reward(self._observations[at], *self._numbers[:2, at])
        pairs = zip(self._observations[at], actions[at], strict=True)
        return [_checked_reward(self._reward(*pair)) for pair in pairs]


class NonstopEnv(gymnasium.Env[NDArray, NDArray]):
    """One lane of `NonstopVecEnv`; see `drake_nonstop.make_gym_env`."""

    def __init__(self, scenario: Scenario, action: str, time_step: float, reward: Reward | None):
        self._lane = NonstopVecEnv(scenario, 1, action, time_step, reward, begins_anew=False)
        self.action_space = self._lane.single_action_space
        self.observation_space = self._lane.single_observation_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray, dict[str, Any]]:
        """Starts at the equilibrium under the scenario's own action; as of `NonstopVecEnv`."""
        super().reset(seed=seed)
        observations, info = self._lane.reset(seed=seed, options=options)
        return observations[0], info

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
        values = _as_actions(action, self.action_space)
        shown, rewards, ends, cuts, infos = self._lane.step(values[None])
        last = infos.get("final_info", {})
        info = {"message": last["message"][0]} if "message" in last else {}
        return shown[0], float(rewards[0]), bool(ends[0]), bool(cuts[0]), info


def _default_reward(observations: NDArray, length: Any, bound: Any) -> NDArray:
    """Minus the load's error by the cable's length, and what the slowest carrier lacks of ε.

    Of observations (..., size), lengths in m and bounds in m/s, numbers or arrays (...); 0 is none.
    """
    load, reference, carriers = _views(observations)
    error = load.position - reference.position
    speeds = np.linalg.norm(carriers.velocities, axis=-1)
    lacking = np.maximum(0.0, bound - speeds.min(axis=-1)) / np.maximum(bound, _TINY)
    rewards: NDArray = -np.linalg.norm(error, axis=-1) / length - lacking
    return rewards


def _is_implausible(observation: NDArray, length: float) -> bool:
    """Whether load or carriers are farther than 100 cable lengths (m) from the load's reference.

    No action that a task needs leads there, and a loop that diverges goes on from there until its
    numbers are too large.
    """
    load, reference, carriers = _views(observation)
    bodies = np.concatenate([load.position[None], carriers.positions])
    away = np.linalg.norm(bodies - reference.position, axis=-1)
    return bool(away.max() > _FARTHEST * length)


def _views(observations: NDArray) -> tuple[LoadState, LoadReference, CarrierStates]:
    """The parts of observations (..., size)."""
    ends = np.cumsum([LOAD_STATE_SIZE, LOAD_REFERENCE_SIZE])
    load, reference, carriers = np.split(observations, ends, axis=-1)
    return LoadState.view(load), LoadReference.view(reference), CarrierStates.view(carriers)


def _checked_reward(reward: Any) -> float:
    """A reward as a number; raises ScenarioError where it is none."""
    remedy = "return a finite number from the function"
    require(np.ndim(reward) == 0 and np.isfinite(reward), "reward", reward, remedy)
    return float(reward)


def _as_actions(actions: Any, space: gymnasium.spaces.Box, *lead: int) -> NDArray:
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


def _actions_of(scenario: Scenario, action: str) -> tuple[NDArray, gymnasium.spaces.Box]:
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
