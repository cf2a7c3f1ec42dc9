"""Drawn loops: 3 to 16 carriers, and in each box any block that fits and can be traced.

`python tests/drawn_loops.py 60` compares 60 of them with their diagrams, and tells the largest
difference of a signal, relative to 1 + its largest value.
"""

import copy
import itertools
import sys
import warnings

import numpy as np
from drawn_tasks import GRAVITY, attachments_of

from drake_nonstop import (
    CompiledLoop,
    RunStopped,
    ScenarioError,
    make_nonstop,
    simulate,
)
from drake_nonstop.diagrams.nonstop import BOXES
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.scenario.overrides import changed
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.systems.compiled_loop import reason_against

DURATION = 0.24  # s, a multiple of all control periods


def drawn_loop(seed: int) -> Scenario:
    """The loop of a seed."""
    rng = np.random.default_rng([22, seed])

    def uniform(low: float, high: float) -> float:
        return round(float(rng.uniform(low, high)), 4)

    n = int(rng.integers(3, 17))
    mass = round(n * uniform(0.15, 0.5), 4)
    displacement = np.round(rng.uniform(-0.05, 0.05, 3), 4).tolist()
    scenario = changed(
        load_scenario("quintic"),
        [
            "pattern=!HamiltonianCycle {}",
            f"system.attachments={np.round(attachments_of(n, rng), 4).tolist()}",
            f"system.load_mass={mass}",
            f"system.cable_length={uniform(0.6, 3.0)}",
            f"simulated.load_mass={round(mass * uniform(0.95, 1.05), 4)}",
            f"optimization_layer.amplitude={round(mass * GRAVITY / n * uniform(0.3, 0.6), 4)}",
            f"optimization_layer.frequency={uniform(1.2, 2.5)}",
            f"optimization_layer.speed_bound={uniform(0.1, 0.4)}",
            f"load_trajectory.displacement={displacement}",
            "load_trajectory.start_time=0.02",
            f"load_trajectory.move_time={uniform(0.5, 2.0)}",
            f"control_period={rng.choice([0.005, 0.01, 0.02])}",
            f"simulation_duration={DURATION}",
        ],
    )
    for box in rng.permutation([*BOXES]).tolist():
        block = rng.choice(BOXES[box].variants).__name__
        try:
            tried = changed(scenario, [f"{box}={block}"])
            diagram = make_nonstop(tried, at_equilibrium=False)
        except ScenarioError:
            continue  # it does not go with the others
        if not reason_against(diagram, tried.simulator_config, tried.control_period):
            scenario = tried
    return scenario


def loop_of(scenario: Scenario, step: float) -> CompiledLoop:
    """The compiled loop of a scenario, in CasADi's virtual machine, with steps of a time in s."""
    diagram = make_nonstop(scenario)
    config = copy.deepcopy(scenario.simulator_config)
    config.max_step_size = step
    shown = min(0.01, scenario.control_period)
    options = {"signal_period": shown, "compiles": False}
    return CompiledLoop(diagram, config, scenario.control_period, **options)


def largest_difference(scenario: Scenario) -> tuple[float, str]:
    """That of a signal, and the signal's name.

    Raises:
        RunStopped: the diagram's run diverges, or a block fails.
        ScenarioError: the diagram takes steps that are too short to be traced.
    """
    run = simulate(scenario)
    loop = loop_of(scenario, run.step)
    times, signals = loop.run(loop.diagram.CreateDefaultContext(), DURATION)
    every = round(run.time[1] / times[1])
    found = []
    for name, expected in run.signals.items():
        shown = signals[name.partition(".")[2]][::every]
        if name.endswith("solve_time"):
            continue  # measured with a clock
        largest = 1 + np.abs(expected).max()
        found.append((float(np.abs(shown - expected).max() / largest), name))
    return max(found)


def main(count: int) -> None:
    """Compares that many loops."""
    warnings.simplefilter("ignore")
    worst = []
    for seed in itertools.takewhile(lambda _: len(worst) < count, itertools.count()):
        scenario = drawn_loop(seed)
        blocks = [type(getattr(scenario, box)).__name__.removesuffix("Config") for box in BOXES]
        try:
            worst.append((*largest_difference(scenario), seed))
        except (RunStopped, ScenarioError) as reason:  # it diverges, or needs short steps
            print(seed, reason, flush=True)
            continue
        print(seed, len(scenario.system.attachments), f"{worst[-1][0]:.1e}", *blocks, flush=True)
    print(f"{len(worst)} loops, the largest difference {max(worst)[0]:.1e} of {max(worst)[1:]}")


if __name__ == "__main__":
    main(int(sys.argv[1]))
