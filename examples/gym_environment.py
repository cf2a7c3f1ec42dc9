"""The loop as an environment of Gymnasium: random ξ and A, constant ones, and the package's layer.

Nothing is trained here. The same reward tells how good each one is: minus the load's error by the
cable's length, and minus the share that the slowest carrier lacks of ε.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from drake_nonstop import load_scenario, make_gym_env, make_gym_vec_env, simulate

STEP = 0.1  # s
EPISODES = 64  # side by side


def episode(policy: Callable[[int], NDArray], duration: float) -> float:
    """The sum of the rewards of an episode under a policy of the step's number."""
    env = make_gym_env(load_scenario("line", [f"simulation_duration={duration}"]), time_step=STEP)
    env.reset(seed=0)
    total, step, is_over = 0.0, 0, False
    while not is_over:
        _, reward, terminated, truncated, _ = env.step(policy(step))
        total, step, is_over = total + reward, step + 1, terminated or truncated
    return total


def random_episodes(n: int, duration: float) -> NDArray:
    """The sums (n,) of the rewards of n episodes, flown side by side under random actions."""
    scenario = load_scenario("line", [f"simulation_duration={duration}"])
    envs = make_gym_vec_env(scenario, n, time_step=STEP)
    envs.action_space.seed(0)
    envs.reset(seed=0)
    return sum(envs.step(envs.action_space.sample())[1] for _ in range(round(duration / STEP)))


def main(duration: float = 15.0) -> None:
    """Compares the three on `line`."""
    layer = load_scenario("line").optimization_layer
    constant = np.array([layer.frequency, layer.amplitude])
    flown = simulate(load_scenario("line", [f"simulation_duration={duration}"]))
    planned = flown.signal("parameters")
    every = round(STEP / 0.01)
    policies = {
        "constant": lambda step: constant,
        "the layer's plan": lambda step: planned[min(every * step, len(planned) - 1)],
    }
    drawn = random_episodes(EPISODES, duration)
    totals = {f"random, mean of {EPISODES}": float(drawn.mean())}
    totals |= {name: episode(policy, duration) for name, policy in policies.items()}
    for name, total in totals.items():
        print(f"{name:18} sum of rewards (load error and speeds) {total:8.3f}")
    print(f"standard deviation of the random ones: {drawn.std():.3f}")


if __name__ == "__main__":
    main()
