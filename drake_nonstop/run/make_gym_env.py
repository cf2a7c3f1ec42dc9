"""The loop of a scenario as an environment of Gymnasium."""

from typing import TYPE_CHECKING, Any

from drake_nonstop.scenario.schema import Scenario, check
from drake_nonstop.validation import (
    require,
    require_installed,
    require_known,
    require_positive,
    require_whole,
)

if TYPE_CHECKING:
    from drake_nonstop.run.gym_environment import NonstopEnv, NonstopVecEnv, Reward

_NAMES = ("parameters", "wrench")
_MOST = 100_000  # environments


def make_gym_env(
    scenario: Scenario,
    *,
    action: str = "parameters",
    time_step: float = 0.1,
    reward: "Reward | None" = None,
) -> "NonstopEnv":
    """The loop of a scenario as an environment, in which the agent takes a box's place.

    Observations are [load_state (13), reference (22), carrier_state (6n)], in SI units in W, see
    the signal dictionary. Episodes begin at the equilibrium, are truncated at the scenario's
    `simulation_duration`, and are terminated by a divergence or where a block ends the run. Load or
    carriers farther than 100 cable lengths from the load's reference count as a divergence. The
    integrator's step is that of `with_largest_step`. The compiled loop flies, or the diagram where
    it cannot be compiled.

    Args:
        scenario: has the loop; each episode draws the numbers of its distributions anew.
        action: "parameters": ξ (rad/s) and A (N) in place of the optimization layer, within its
            bounds; "wrench": torque (N m) and force (N) on the load in place of the wrench
            controller, held for a step.
        time_step: s, of an action, at least the scenario's `control_period`; each step ends at the
            controllers' last sample at or before its end. One that is no multiple of
            `control_period` has sometimes a sample more.
        reward: of the observation after a step and the action; None: minus the load's position
            error by the cable's length, and minus the share that the slowest carrier lacks of ε.

    Raises:
        ScenarioError: Gymnasium is not installed, the scenario cannot be built, or an argument
            cannot be used.
    """
    _check("make_gym_env", scenario, action, time_step, reward)
    from drake_nonstop.run.gym_environment import NonstopEnv

    return NonstopEnv(scenario, action, time_step, reward)


def make_gym_vec_env(
    scenario: Scenario,
    n: int,
    *,
    action: str = "parameters",
    time_step: float = 0.1,
    reward: "Reward | None" = None,
) -> "NonstopVecEnv":
    """Several environments of `make_gym_env` side by side, by Gymnasium's vector API.

    Their episodes are flights of a compiled loop, equal to those of single environments. A loop
    that cannot be compiled flies by diagrams, one after the other, with a warning. An episode that
    ends begins anew in the same step, with `final_obs` and `final_info` in the infos. `reset` takes
    a list of seeds, or the first seed, to which each further environment adds 1.

    Args:
        scenario: has the loop, whose C is compiled in some seconds unless the cache has it.
        n: the number of environments.
        action: as of `make_gym_env`.
        time_step: as of `make_gym_env`.
        reward: as of `make_gym_env`, of one environment.

    Raises:
        ScenarioError: as of `make_gym_env`.
    """
    _check("make_gym_vec_env", scenario, action, time_step, reward)
    require_whole("n", n, 1, _MOST)
    from drake_nonstop.run.gym_environment import NonstopVecEnv

    return NonstopVecEnv(scenario, n, action, time_step, reward)


def _check(name: str, scenario: Scenario, action: str, time_step: float, reward: Any) -> None:
    """Raises ScenarioError for an argument that cannot be used, or without Gymnasium."""
    require_installed(name, gymnasium="drake-nonstop[gym]")
    check(scenario)
    require_known(action, _NAMES, "action", action)
    require_positive(f"{name}.time_step", time_step)
    require(reward is None or callable(reward), "reward", reward, "give a function, or None")
