"""The loop as an environment of Gymnasium: random ξ and A, constant ones, and the package's layer.

Nothing is trained here. The same reward tells how good each one is: minus the load's error by the
cable's length, and minus the share that the slowest carrier lacks of ε.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from drake_nonstop import load_scenario, make_gym_env, simulate

STEP = 0.1  # s


def episode(policy: Callable[[int], NDArray], duration: float) -> float:
    """The sum of the rewards of an episode under a policy of the step's number."""
    env = make_gym_env(load_scenario("line", [f"simulation_duration={duration}"]), time_step=STEP)
    env.reset(seed=0)
    total, step, is_over = 0.0, 0, False
    while not is_over:
        _, reward, terminated, truncated, _ = env.step(policy(step))
        total, step, is_over = total + reward, step + 1, terminated or truncated
    return total


def main(duration: float = 15.0) -> None:
    """Compares the three on `line`."""
    space = make_gym_env(load_scenario("line")).action_space
    space.seed(0)
    layer = load_scenario("line").optimization_layer
    constant = np.array([layer.frequency, layer.amplitude])
    flown = simulate(load_scenario("line", [f"simulation_duration={duration}"]))
    planned = flown.signal("parameters")
    every = round(STEP / 0.01)
    policies = {
        "random": lambda step: space.sample(),
        "constant": lambda step: constant,
        "the layer's plan": lambda step: planned[min(every * step, len(planned) - 1)],
    }
    for name, policy in policies.items():
        total = episode(policy, duration)
        print(f"{name:18} sum of rewards (load error and speeds) {total:8.3f}")


if __name__ == "__main__":
    main()
