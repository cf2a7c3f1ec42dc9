"""Loops side by side as one environment of Gymnasium's vector API, flown by their compiled loop.

The action is a parameter of a block that stands in the place of the layer or the controller, so
that the loop has no inputs. `make_gym_vec_env` makes the environment.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, cast

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray
from pydrake.common import RandomGenerator

from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.loop.start import set_equilibrium
from drake_nonstop.loop.step import with_largest_step
from drake_nonstop.mechanics.signals import WRENCH_SIZE
from drake_nonstop.model.block import Block
from drake_nonstop.run import gym_environment as single
from drake_nonstop.run.monitor import EndingBlocks
from drake_nonstop.scenario.schema import Scenario, sample
from drake_nonstop.systems.compiled_flight import Advance, CompiledFlight, advance_together
from drake_nonstop.systems.compiled_loop import CompiledLoop
from drake_nonstop.systems.tracing import NotFiniteError
from drake_nonstop.validation import StrictFields, require

_HOLDER = "action"  # the name of the block that holds it
_WORTH_LANES = 4  # flights
_LARGEST_SEED = 2**32 - 1  # of Drake's RandomGenerator


@dataclass(kw_only=True)
class _HeldAction(StrictFields):
    action: list[float] = field(default_factory=list)


class _HeldParameters(Block):
    """ξ (rad/s) and A (N) that are a parameter of the context."""

    makes = (single.PARAMETERS,)

    @staticmethod
    def equations(*, action: NDArray) -> NDArray:
        return action


class _HeldWrench(Block):
    """A wrench (N m, N) that is a parameter of the context, held from step to step."""

    makes = (single.WRENCH, "wrench_rate")

    @staticmethod
    def equations(*, action: NDArray) -> tuple[NDArray, NDArray]:
        return action, np.zeros(WRENCH_SIZE)


_HOLDERS = {  # of an action, and the boxes in whose places they stand
    single.PARAMETERS: (_HeldParameters, "optimization_layer"),
    single.WRENCH: (_HeldWrench, "wrench_controller"),
}


class _Start:
    """The compiled loop of a scenario without distributions, at the start of an episode.

    Attributes:
        scenario: of the loop.
        space: of the actions.
        action: where the action is among the parameters of a flight.
        observation: at the equilibrium under the scenario's own action.
        state: of a flight there.
    """

    def __init__(self, scenario: Scenario, action: str, time_step: float):
        self.scenario, self._time_step = scenario, time_step
        period, (holder, box) = scenario.control_period, _HOLDERS[action]
        remedy = f"give at least control_period = {period:g} s"
        require(time_step >= period, "make_gym_vec_env.time_step", time_step, remedy)
        resting, self.space = single.actions_of(scenario, action)
        held = _HeldAction(action=resting.tolist())
        blocks: dict[str, Any] = {"extra": {_HOLDER: lambda own: holder(own, held)}}
        nonstop = make_nonstop(scenario, at_equilibrium=False, **blocks | {box: None})
        context = nonstop.CreateDefaultContext()
        self._ending = EndingBlocks(nonstop, context)
        ends = self._ending.signals
        shown = (*dict.fromkeys([*single.OBSERVED, *ends]),)
        signals, steps = ((), shown) if ends else (shown, ())  # any step may be the last one
        set_equilibrium(nonstop, context)
        config = with_largest_step(scenario.simulator_config, nonstop, context)
        self.loop = CompiledLoop(nonstop, config, period, signals=signals, step_signals=steps)
        first = self.loop.parameter_names.index(f"{_HOLDER}.action[0]")
        self.action = slice(first, first + len(resting))
        self._context = context
        flight = self.flight()
        self.observation = np.concatenate(flight.start())[: single.observation_size(scenario)]
        self.state = flight.state

    def flight(self) -> CompiledFlight:
        """A new flight."""
        return self.loop.fly(self._context)

    def samples(self, steps: int) -> int:
        """The number of samples at the end of so many steps."""
        return single.samples_until(steps * self._time_step, self.scenario.control_period)

    def ends(self, flown: Sequence[Advance]) -> tuple[NDArray, NDArray]:
        """Observations (k, size) after flights, and whether a block has ended each there (k,)."""
        has_ended = np.zeros(len(flown), bool)
        if not self._ending.signals:
            return np.array([each.signals[-1] for each in flown]), has_ended
        rows = [each.step_signals for each in flown]
        last = np.array([own[-1] for own in rows])
        sizes = self.loop.step_signals
        if self._ending.first_end(sizes, np.concatenate(rows)) is not None:
            for i, own in enumerate(rows):
                end = self._ending.first_end(sizes, own)
                if end is not None:
                    has_ended[i], last[i] = True, own[end]
        return last[:, : len(self.observation)], has_ended


class NonstopVecEnv(VectorEnv[NDArray, NDArray, NDArray]):
    """Episodes of a scenario side by side; see `drake_nonstop.make_gym_vec_env`."""

    def __init__(
        self,
        scenario: Scenario,
        n: int,
        action: str,
        time_step: float,
        reward: single.Reward | None,
        mode: AutoresetMode,
    ):
        self.metadata = {"autoreset_mode": mode}
        self._waits = mode is AutoresetMode.NEXT_STEP
        self._is_over = np.zeros(n, bool)  # and begins anew in the next step
        self.num_envs, self._given, self._reward = n, scenario, reward
        self._kind = action, time_step
        sampled, drawn = sample(scenario)
        self._is_drawn = bool(drawn)
        self._start = start = _Start(sampled, *self._kind)
        if n >= _WORTH_LANES:
            start.loop.prepare_lanes()
        self.single_action_space, size = start.space, len(start.observation)
        self.single_observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float64)
        self.action_space = batch_space(self.single_action_space, n)
        self.observation_space = batch_space(self.single_observation_space, n)
        seeds = [(scenario.random_seed + i) % (_LARGEST_SEED + 1) for i in range(n)]
        self._generators = [*map(RandomGenerator, seeds)]
        self._starts, self._flights = n * [start], [start.flight() for _ in range(n)]
        self._observations, self._steps = np.zeros((n, size)), np.zeros(n, int)
        self._numbers = np.ones((3, n))  # cable's length, m, ε, m/s, and duration, s
        self._is_reset = False

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: Any = None
    ) -> tuple[NDArray, dict[str, Any]]:
        """Starts all episodes, as single environments do with a seed for each.

        A number is the first one's seed, and each exceeds the one before by 1.

        Raises:
            ScenarioError: a seed cannot be used, there are options, or a scenario that was drawn
                cannot be built.
        """
        require(not options, "options", options, "leave them out, there are none")
        n, given = self.num_envs, cast(Any, seed)
        if isinstance(given, np.ndarray | np.integer):
            given = given.tolist()  # plain numbers
        seeds: Any = [*range(given, given + n)] if type(given) is int else given or n * [None]
        is_right = isinstance(seeds, Sequence) and len(seeds) == n
        remedy = f"give a whole number from 0 to {_LARGEST_SEED}, or {n} of them, or None"
        for own in seeds if is_right else []:
            is_right &= own is None or (type(own) is int and 0 <= own <= _LARGEST_SEED)
        require(is_right, "seed", seed, remedy)
        super().reset(seed=seeds[0])
        for i, own in enumerate(seeds):
            if own is not None:
                self._generators[i] = RandomGenerator(own)
            self._begin(i)
        self._is_reset, self._is_over = True, np.zeros(n, bool)
        return self._observations.copy(), {}

    def _begin(self, i: int) -> None:
        """Starts an episode of one environment."""
        if self._is_drawn:
            own = _Start(self._given.sampled(self._generators[i]), *self._kind)
            self._starts[i], self._flights[i] = own, own.flight()
        start, scenario = self._starts[i], self._starts[i].scenario
        length, duration = np.max(scenario.system.cable_length), scenario.simulation_duration
        self._numbers[:, i] = length, scenario.speed_bound, duration
        self._steps[i] = 0
        self._flights[i].go_to(0, start.state)
        self._observations[i] = start.observation

    def step(self, actions: NDArray) -> tuple[NDArray, NDArray, NDArray, NDArray, dict[str, Any]]:
        """Flies each episode on under its action, a row of `actions` (n, k), as a single one does.

        One that is over begins anew at once: its row of the observations (n, size) is the first one
        then, and the infos have `final_obs` and `final_info`. With `NEXT_STEP` it does so in the
        next step, whose action and reward do not count for it.

        Raises:
            ScenarioError: an action is not in the action space, the environment has not been
                reset, or a reward is no number.
        """
        require(self._is_reset, "step", "before reset", "call reset() first")
        values = single.as_actions(actions, self.single_action_space, self.num_envs)
        self._is_reset = False  # until all are flown
        observations, infos = self._observations, dict[str, Any]()
        going = np.flatnonzero(~self._is_over).tolist()
        starts = [self._starts[i] for i in going]
        for i, start in zip(going, starts, strict=True):
            self._flights[i].set_parameters(start.action, values[i])
        self._steps[going] += 1
        flights = [self._flights[i] for i in going]
        counts = [
            start.samples(self._steps[i]) - start.samples(self._steps[i] - 1)
            for i, start in zip(going, starts, strict=True)
        ]
        flown = dict(zip(going, advance_together(flights, counts), strict=True))
        has_ended, messages = np.zeros(self.num_envs, bool), dict[int, dict[str, str]]()
        lanes: dict[_Start, list[int]] = {}  # of those that have not diverged, by their starts
        for i, each in flown.items():
            if each.error is None:
                lanes.setdefault(self._starts[i], []).append(i)
            elif isinstance(each.error, NotFiniteError):
                has_ended[i], messages[i] = True, {"message": str(each.error)}
            else:
                raise each.error
        for start, own in lanes.items():
            shown, ended = start.ends([flown[i] for i in own])
            is_lost = single.is_implausible(shown, self._numbers[0, own])
            for i, row, end, is_diverged in zip(own, shown, ended, is_lost, strict=True):
                has_ended[i] = end or is_diverged
                if is_diverged:
                    messages[i] = {"message": single.IMPLAUSIBLE}
                else:
                    observations[i] = row
        rewards = np.where(self._is_over, 0.0, single.DIVERGED)
        at = sorted(set(going) - set(messages))
        if at:
            rewards[at] = self._rewards(at, values)
        is_late = self._steps * self._kind[1] >= self._numbers[2] - 1e-9
        is_truncated = ~has_ended & ~self._is_over & is_late
        for i in np.flatnonzero(self._is_over).tolist():
            self._begin(i)
        ends = has_ended | is_truncated
        self._is_over = ends & self._waits
        for i in np.flatnonzero(ends).tolist():
            info: dict[str, Any] = messages.get(i, {})
            if not self._waits:
                info = {"final_obs": observations[i].copy(), "final_info": info}
                self._begin(i)
            infos = self._add_info(infos, info, i)
        self._is_reset = True
        return observations.copy(), rewards, has_ended, is_truncated, infos

    def _rewards(self, at: list[int], actions: NDArray) -> Any:
        """Rewards of some environments, after their actions among all (n, k)."""
        if self._reward is None:
            return single.default_reward(self._observations[at], *self._numbers[:2, at])
        pairs = zip(self._observations[at], actions[at], strict=True)
        return [single.checked_reward(self._reward(*pair)) for pair in pairs]
