"""How much faster many flights are side by side than one by one."""

import statistics
import time
from typing import Any

from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.simulation.make_gym_env import make_gym_env, make_gym_vec_env


def environment_ratio(
    scenario: Scenario, *, n: int = 64, time_step: float = 0.1, repeats: int = 5, steps: int = 20
) -> dict[str, Any]:
    """Steps a second of n environments side by side, by those of a single one, alternately.

    All fly the same constant ξ and A, the middle of their bounds. Returns the medians of the
    repeats, each of so many steps.

    Raises:
        ScenarioError: as of `make_gym_vec_env`.
    """
    environments: list[Any] = [
        make_gym_env(scenario, time_step=time_step),
        make_gym_vec_env(scenario, n, time_step=time_step),
    ]
    rates: dict[int, list[float]] = {1: [], n: []}  # steps/s
    for _ in range(repeats):
        for environment, found, count in zip(environments, rates.values(), rates, strict=True):
            space = environment.action_space
            environment.reset()
            start = time.perf_counter()
            for _ in range(steps):
                environment.step((space.low + space.high) / 2)
            found.append(count * steps / (time.perf_counter() - start))
    return {
        "scenario": scenario.name,
        "environments": n,
        "steps_per_s": {count: statistics.median(found) for count, found in rates.items()},
        "ratio": statistics.median(many / one for one, many in zip(*rates.values(), strict=True)),
    }
