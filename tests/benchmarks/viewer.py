"""The cost of a live view: the processor time of a run with one, and without."""

import statistics
import time
from collections.abc import Callable
from typing import Any

from drake_nonstop.run.run import StepAction
from drake_nonstop.run.simulate import simulate
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.view.meshcat_server import start_meshcat
from drake_nonstop.view.nonstop_visualizer import show_in

REPEATS = 3


def benchmark_viewer(
    scenario: Scenario, progress: Callable[[str, float], None] = lambda what, share: None
) -> dict[str, Any]:
    """Runs a scenario in real time with a view of 30 frames per s and without, alternately.

    The processor time is that of all threads, with Meshcat's; no browser is connected. The cost
    is the median of the differences, as a share of the simulated time.
    """
    seconds: dict[bool, list[float]] = {True: [], False: []}
    for repeat in range(REPEATS):
        for is_watched in (True, False):
            viewers = [show_in(start_meshcat())] if is_watched else []
            start = time.process_time()
            simulate(
                scenario,
                viewers=viewers,
                after_step=_in_real_time,
            )
            seconds[is_watched].append(time.process_time() - start)
            progress("running in real time", (repeat + (1 if is_watched else 2) / 2) / REPEATS)
    differences = [a - b for a, b in zip(seconds[True], seconds[False], strict=True)]
    return {
        "scenario": scenario.name,
        "simulated_s": scenario.simulation_duration,
        "cpu_s_with": seconds[True],
        "cpu_s_without": seconds[False],
        "cost_of_real_time": statistics.median(differences) / scenario.simulation_duration,
    }


def _in_real_time(simulator: Any, nonstop: Any) -> StepAction:
    if simulator.get_target_realtime_rate() == 0:
        simulator.set_target_realtime_rate(1.0)
    return StepAction.CONTINUE


def table(results: dict[str, Any]) -> str:
    """The results in one line."""
    return f"a view of 30 frames per s takes {results['cost_of_real_time']:.1%} of real time"
