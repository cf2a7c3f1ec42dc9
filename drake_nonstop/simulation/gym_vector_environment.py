"""Loops side by side as one environment of Gymnasium's vector API, flown by their compiled loops.

The agent's action is a parameter of a block that stands in the place of the layer or controller, so
that the loop has no inputs. `make_gym_vec_env` makes the environment.
"""

import copy
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray
from pydrake.common import RandomGenerator
from pydrake.systems.framework import Context

from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.loop.assembly import models_of
from drake_nonstop.loop.compiled_flight import CompiledFlight
from drake_nonstop.loop.compiled_loop import CompiledLoop
from drake_nonstop.loop.equilibrium import set_equilibrium
from drake_nonstop.loop.lanes import Advance, advance_together
from drake_nonstop.mechanics.signal_layouts import by_name
from drake_nonstop.mechanics.signals import WRENCH_SIZE
from drake_nonstop.model.block import Block
from drake_nonstop.scenario.schema import Scenario, sample
from drake_nonstop.simulation.built_loop import goes_by_numbers, take_scenario
from drake_nonstop.simulation.gym_environment import (
    DIVERGED,
    OBSERVED,
    PARAMETERS,
    WRENCH,
    Reward,
    actions_of,
    are_within,
    as_action,
    as_floats,
    checked_reward,
    default_reward,
    observation_size,
    samples_of,
)
from drake_nonstop.systems.block import is_of_package
from drake_nonstop.systems.tracing import NotFiniteError
from drake_nonstop.validation import StrictFields, require, require_whole

_HOLDER = "action"  # the name of the block that holds it
_WORTH_LANES = 4  # flights
_LARGEST_SEED = 2**32 - 1  # of Drake's RandomGenerator


@dataclass(kw_only=True)
class _HeldAction(StrictFields):
    action: list[float] = field(default_factory=lambda: [0.0])


class _HeldParameters(Block):
    """ξ (rad/s) and A (N) that are parameters of the context."""

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


_HOLDERS = {
    PARAMETERS: (_HeldParameters, "optimization_layer"),
    WRENCH: (_HeldWrench, "wrench_controller"),
}  # of an action, and the box in whose place it stands


class _Start:
    """The compiled loop of a scenario without distributions, and the start of its episodes.

    Attributes:
        scenario: its own.
        space: of the actions.
        samples: of the controllers in a step.
        action: where the action is among the parameters of a flight.
        observation: at the equilibrium under the scenario's own action.
    """

    def __init__(self, scenario: Scenario, action: str, time_step: float):
        period, config = scenario.control_period, scenario.simulator_config
        self.samples = samples_of(time_step, period)
        remedy = f"give a multiple of control_period = {period:g} s"
        is_whole = self.samples > 0 or period == 0  # which cannot be compiled
        require(is_whole, "make_gym_vec_env.time_step", time_step, remedy)
        self._kind, (holder, self._box) = action, _HOLDERS[action]
        resting, self.space = _actions_of(scenario, action)
        held = _HeldAction(action=resting.tolist())
        extra = {_HOLDER: lambda own: holder(own, held)}
        left_out: dict[str, Any] = {self._box: None}
        nonstop = make_nonstop(scenario, at_equilibrium=False, extra=extra, **left_out)
        ending = [block for block in nonstop.GetSystems() if hasattr(block, "ends_run")]
        shown = dict.fromkeys([*OBSERVED, *(block.ending_signal for block in ending)])
        self._loop = CompiledLoop(
            nonstop,
            config,
            period,
            signals=() if ending else OBSERVED,
            step_signals=(*shown,) if ending else (),  # any step may be the last one
        )
        beside = ", ".join(self._loop.blocks_beside)
        require(not beside, "scenario", beside, "it is stepped by itself; give make_gym_env")
        first = self._loop.parameter_names.index(f"{_HOLDER}.action[0]")
        self.action = slice(first, first + len(resting))
        self._has_parameters = goes_by_numbers(nonstop, scenario)
        self._settle(scenario, nonstop.CreateDefaultContext())

    def _settle(self, scenario: Scenario, context: Context) -> None:
        """Finds the start of the scenario, whose numbers are in a context of the loop."""
        nonstop = self._loop.diagram
        self.scenario, self._context = scenario, context
        set_equilibrium(nonstop, context)
        self._ending = [
            (block, nonstop.GetSubsystemContext(block, context))
            for block in nonstop.GetSystems()
            if hasattr(block, "ends_run")
        ]
        self._flight = self._loop.fly(context)
        self.observation = np.concatenate(self._flight.start())[: observation_size(scenario)]
        self._state = self._flight.state

    def of(self, scenario: Scenario) -> "_Start | None":
        """The start of a scenario in the same loop; None where another one has to be built."""
        nonstop, other = self._loop.diagram, copy.copy(self)
        context = nonstop.CreateDefaultContext()
        if not self._has_parameters or not take_scenario(
            nonstop, context, self.scenario, scenario, [self._box]
        ):
            return None
        holder = nonstop.GetMutableSubsystemContext(nonstop.GetSubsystemByName(_HOLDER), context)
        resting, _ = _actions_of(scenario, self._kind)
        holder.get_mutable_numeric_parameter(0).SetFromVector(resting)
        other._settle(scenario, context)
        return other

    def flight(self, other: "_Start") -> CompiledFlight:
        """A new flight, which shares with that of another start what is the same in both."""
        flight = self._loop.fly(self._context)
        if self._loop is other._loop:
            flight.share(other._flight)
        return flight

    def prepare_lanes(self) -> None:
        """Lets flights of the loop fly in lanes, for which it is compiled if it has not been."""
        self._loop.prepare_lanes()

    def begin(self, flight: CompiledFlight) -> None:
        """Sets a flight of the loop to the start of an episode."""
        flight.go_to(0, self._state)

    def ends(self, flown: Sequence[Advance]) -> tuple[NDArray, NDArray]:
        """Observations (k, size) after flights, and whether a block has ended the runs (k,)."""
        has_ended = np.zeros(len(flown), bool)
        if not self._ending:
            return np.array([each.signals[-1] for each in flown]), has_ended
        rows = [each.step_signals for each in flown]
        last = np.array([own[-1] for own in rows])
        for i, own in enumerate(rows if self._is_over(np.concatenate(rows)) else []):
            if self._is_over(own):
                has_ended[i] = True
                last[i] = next(own[k] for k in range(len(own)) if self._is_over(own[k : k + 1]))
        return last[:, : len(self.observation)], has_ended

    def _is_over(self, rows: NDArray) -> bool:
        """Whether a block ends a run in one of some rows (k, size) of signals."""
        shown = by_name(self._loop.step_signals, rows)
        for block, context in self._ending:
            values = shown[block.ending_signal]
            # The package's blocks take rows, of which they look at each.
            for each in [values] if is_of_package(block) else values:
                if block.ends_run(context, each):
                    return True
        return False


class NonstopVecEnv(VectorEnv[NDArray, NDArray, NDArray]):
    """Episodes of a scenario side by side; see `drake_nonstop.make_gym_vec_env`."""

    metadata: ClassVar[dict[str, Any]] = {"autoreset_mode": AutoresetMode.SAME_STEP}

    def __init__(
        self, scenario: Scenario, n: int, action: str, time_step: float, reward: Reward | None
    ):
        self.num_envs, self._given, self._action = n, scenario, action
        self._time_step, self._reward = time_step, reward
        sampled, drawn = sample(scenario)
        self._is_drawn = bool(drawn)
        self._start = start = _Start(sampled, action, time_step)
        if n >= _WORTH_LANES:
            start.prepare_lanes()
        seeds = (scenario.random_seed + np.arange(n)) % (_LARGEST_SEED + 1)
        self._generators = [RandomGenerator(seed) for seed in seeds.tolist()]
        self._starts = n * [start]
        self._flights = [start.flight(start) for _ in range(n)]
        size = observation_size(sampled)
        self.single_action_space = start.space
        self.single_observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float64)
        self.action_space = batch_space(self.single_action_space, n)
        self.observation_space = batch_space(self.single_observation_space, n)
        self._observations = np.zeros((n, size))
        # m, m/s and s, of each scenario
        self._lengths, self._bounds, self._durations = np.ones((3, n))
        self._is_reset = False

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: Any = None
    ) -> tuple[NDArray, dict[str, Any]]:
        """Starts all episodes at their equilibria, as n single environments do.

        Args:
            seed: of the first environment, which that of the next exceeds by 1; or one for each.
            options: there are none.

        Raises:
            ScenarioError: a seed cannot be used, or there are options, or a scenario that was
                drawn cannot be built.
        """
        require(not options, "options", options, "leave them out, there are none")
        seeds = _seeds(seed, self.num_envs)
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
            drawn = self._given.sampled(self._generators[i])
            own = self._start.of(drawn) or _Start(drawn, self._action, self._time_step)
            self._starts[i], self._flights[i] = own, own.flight(self._start)
        start = self._starts[i]
        scenario = start.scenario
        self._lengths[i], self._bounds[i] = scenario.system.cable_length, scenario.speed_bound
        self._durations[i] = scenario.simulation_duration
        start.begin(self._flights[i])
        self._observations[i] = start.observation

    def step(self, actions: NDArray) -> tuple[NDArray, NDArray, NDArray, NDArray, dict[str, Any]]:
        """Flies each episode on for `time_step` s under its action, a row of `actions` (n, k).

        An episode that is over begins anew at once: its row of the observations (n, size) is the
        first one then, and `final_obs` and `final_info` are in the infos. Rewards, terminations
        and truncations (n,) are as of a single environment.

        Raises:
            ScenarioError: an action is not in the action space, the environment has not been
                reset, or a reward is no number.
        """
        require(self._is_reset, "step", "before reset", "call reset() first")
        values = self._as_actions(actions)
        self._is_reset = False  # until all are flown
        for flight, start, action in zip(self._flights, self._starts, values, strict=True):
            flight.set_parameters(start.action, action)
        flown = advance_together(self._flights, [start.samples for start in self._starts])
        has_diverged = np.array([each.error is not None for each in flown])
        has_ended = has_diverged.copy()
        lanes: dict[_Start, list[int]] = {}  # of those that go on, by their starts
        messages = {}
        for i, (start, each) in enumerate(zip(self._starts, flown, strict=True)):
            if each.error is None:
                lanes.setdefault(start, []).append(i)
            elif isinstance(each.error, NotFiniteError):
                messages[i] = {"message": str(each.error)}
            else:
                raise each.error
        for start, own in lanes.items():
            ends = start.ends([flown[i] for i in own])
            self._observations[own], has_ended[own] = ends
        rewards = np.where(has_diverged, DIVERGED, self._rewards(values, has_diverged))
        times = np.array([flight.time for flight in self._flights])
        is_truncated = ~has_ended & (times >= self._durations - 1e-9)
        observations = self._observations
        infos: dict[str, Any] = {}
        for i in np.flatnonzero(has_ended | is_truncated).tolist():
            final = {"final_obs": observations[i].copy(), "final_info": messages.get(i, {})}
            infos = self._add_info(infos, final, i)
            self._begin(i)
        self._is_reset = True
        return observations.copy(), rewards, has_ended, is_truncated, infos

    def _rewards(self, actions: NDArray, has_diverged: NDArray) -> NDArray:
        """Rewards (n,), of a function that was given but for those that have diverged."""
        if self._reward is None:
            return default_reward(self._observations, self._lengths, self._bounds)
        given = zip(self._observations.copy(), actions, has_diverged, strict=True)
        return np.array(
            [
                DIVERGED if is_over else checked_reward(self._reward(observation, action))
                for observation, action, is_over in given
            ]
        )

    def _as_actions(self, actions: Any) -> NDArray:
        """Actions (n, k) as floats; raises ScenarioError, which names the first wrong one."""
        values, space = as_floats(actions), self.single_action_space
        shape = self.action_space.shape
        remedy = f"give an array {shape}, with a row for each environment"
        require(values.shape == shape, "actions", f"an array {values.shape}", remedy)
        for i in np.flatnonzero(~are_within(values, space)).tolist():
            as_action(values[i], space, f"actions[{i}]")
        return np.clip(values, space.low, space.high)


def _actions_of(scenario: Scenario, action: str) -> tuple[NDArray, gymnasium.spaces.Box]:
    """The scenario's own action, and the space of all."""
    return actions_of(scenario, models_of(scenario)[0], action)


def _seeds(seed: Any, n: int) -> list[int | None]:
    """A seed for each environment; raises ScenarioError where one cannot be used."""
    if seed is None:
        return [None] * n
    if np.ndim(seed) == 0:
        require_whole("seed", seed, 0, _LARGEST_SEED + 1 - n)
        return [seed + i for i in range(n)]
    found = np.array(seed, dtype=object).tolist()
    require(len(found) == n, "seed", f"{len(found)} seeds", f"give {n}, one for each environment")
    for i, own in enumerate(found):
        if own is not None:
            require_whole(f"seed[{i}]", own, 0, _LARGEST_SEED)
    return found
