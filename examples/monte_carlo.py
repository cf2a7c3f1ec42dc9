"""Fly scenarios drawn at random by Drake's MonteCarloSimulation, and look at the worst one."""

import functools

import numpy as np
from pydrake.common import RandomGenerator
from pydrake.common.schema import Gaussian, Uniform
from pydrake.systems.analysis import MonteCarloSimulation
from pydrake.systems.framework import Context, System

from drake_nonstop import DisturbanceForceConfig, load_scenario, make_simulator


def position_error(loop: System, context: Context) -> float:
    """The load's distance from its reference, in m."""
    load = loop.GetOutputPort("load_state").Eval(context)
    reference = loop.GetOutputPort("reference").Eval(context)
    return float(np.linalg.norm(load[4:7] - reference[4:7]))


def main(duration: float = 15.0, runs: int = 20) -> None:
    """Draws the load's mass and a force `runs` times, and flies `duration` seconds each time."""
    scenario = load_scenario("quintic", [f"simulation_duration={duration}"])
    scenario.simulated.load_mass = Uniform(min=0.8, max=1.2)  # kg; the controllers believe 1
    scenario.load_disturbance = DisturbanceForceConfig(
        force=[Gaussian(mean=0.0, stddev=0.1) for _ in "xyz"],  # N
        gust_force=0.1,  # N
        seed=Uniform(min=0, max=1e9),  # another gust in each run
    )
    results = MonteCarloSimulation(
        functools.partial(make_simulator, scenario),
        position_error,
        duration,
        runs,
        RandomGenerator(0),
    )
    errors = 1e3 * np.array([result.output for result in results])
    worst = int(np.argmax(errors))
    drawn = scenario.sampled(results[worst].generator_snapshot)
    push = ", ".join(f"{force:.2f}" for force in drawn.load_disturbance.force)
    print(f"final load error   {errors.mean():.1f} mm, {errors[worst]:.1f} mm at most")
    print(f"that of run {worst}      load of {drawn.simulated.load_mass:.3f} kg, force of {push} N")
    print(f"to fly it again    random_seed {drawn.random_seed}")


if __name__ == "__main__":
    main()
