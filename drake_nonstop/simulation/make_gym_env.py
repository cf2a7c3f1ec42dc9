"""The loop of a scenario as an environment of Gymnasium."""

from typing import TYPE_CHECKING

from drake_nonstop.scenario.schema import Scenario, check
from drake_nonstop.validation import require, require_installed, require_known, require_positive

if TYPE_CHECKING:
    from drake_nonstop.simulation.gym_environment import NonstopEnv, Reward

_NAMES = ("parameters", "wrench")


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
    `simulation_duration`, and are terminated by a divergence or where a block ends the run.

    Args:
        scenario: what is flown; where fields hold distributions, each episode draws numbers anew.
        action: "parameters": ξ (rad/s) and A (N) in place of the optimization layer, within its
            bounds; "wrench": torque (N m) and force (N) on the load in place of the wrench
            controller, held for a step.
        time_step: s, of an action.
        reward: of the observation after a step and the action; None: minus the load's position
            error by the cable's length, and minus the share that the slowest carrier lacks of ε.

    Raises:
        ScenarioError: Gymnasium is not installed, the scenario cannot be built, or an argument
            cannot be used.
    """
    require_installed("make_gym_env", gymnasium="drake-nonstop[gym]")
    check(scenario)
    require_known(action, _NAMES, "action", action)
    require_positive("make_gym_env.time_step", time_step)
    require(reward is None or callable(reward), "reward", reward, "give a function, or None")
    from drake_nonstop.simulation.gym_environment import NonstopEnv

    return NonstopEnv(scenario, action, time_step, reward)
