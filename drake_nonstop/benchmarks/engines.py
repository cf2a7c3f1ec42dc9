"""How much faster the compiled engine flies a scenario than its diagram is simulated."""

import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from pydrake.systems.framework import DiagramBuilder

from drake_nonstop.benchmarks.running import PACKAGES
from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.run.compiled_run import recorded_loop
from drake_nonstop.run.flight import without_warnings
from drake_nonstop.run.preparation import stable_config
from drake_nonstop.run.recording import LogSignals
from drake_nonstop.run.run import Run
from drake_nonstop.run.simulate import simulate
from drake_nonstop.run.versions import versions
from drake_nonstop.scenario.schema import COMPILED, DIAGRAM, Scenario
from drake_nonstop.systems.native import compiler

_WAYS = {
    DIAGRAM: "simulate, engine=diagram: Drake's Simulator",
    COMPILED: "simulate, engine=compiled: all signals recorded",
    "stepped": "CompiledLoop.run: all signals kept",
    "virtual machine": "the same, by CasADi's virtual machine",
}


def benchmark_engines(
    scenario: Scenario,
    *,
    repeats: int = 5,
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> dict[str, Any]:
    """Flies a scenario by both engines, alternately, and steps its compiled loop directly.

    Args:
        scenario: what is flown.
        repeats: of each; medians are taken.
        progress: called with what is being done and the share of it that is done.

    Returns:
        What `drake-nonstop bench engines` writes as JSON. `difference` is the largest one of a
        signal between the engines, relative to 1 + its largest value; `search_share` that of the
        time of the compiled engine in which the optimization layer searches.

    Raises:
        ScenarioError: the scenario cannot be compiled.
    """
    nonstop = make_nonstop(scenario)
    context = nonstop.CreateDefaultContext()
    config = stable_config(scenario, nonstop, context)
    period = scenario.control_period
    builder = DiagramBuilder()
    builder.AddSystem(nonstop)
    logs = LogSignals(builder, nonstop)  # what a run has is what the loops show
    loops = {
        name: recorded_loop(logs, config, period, compiles=name == "stepped")
        for name in ("stepped", "virtual machine")
    }
    samples = int(scenario.simulation_duration / period + 1e-9)
    seconds: dict[str, list[float]] = {way: [] for way in _WAYS}
    runs: dict[str, Run] = {}
    search = []
    for turn in range(repeats):
        for way in _WAYS:
            if way in (DIAGRAM, COMPILED):
                with without_warnings():
                    runs[way] = simulate(scenario, engine=way)
                seconds[way].append(runs[way].wall_time)
            else:
                start = time.perf_counter()
                loops[way].run(context, samples * period)
                seconds[way].append(time.perf_counter() - start)
        search.append(float(runs[COMPILED].solve_times.sum()) / runs[COMPILED].wall_time)
        progress("flying", (turn + 1) / repeats)
    medians = {way: statistics.median(values) for way, values in seconds.items()}
    return {
        "scenario": scenario.name,
        "simulated_s": scenario.simulation_duration,
        "repeats": repeats,
        "versions": versions(*PACKAGES),
        "compiler": compiler() if loops["stepped"].is_compiled else None,
        "wall_s": medians,
        "ratios": {way: medians[DIAGRAM] / value for way, value in medians.items()},
        "real_time_factors": {
            way: scenario.simulation_duration / value for way, value in medians.items()
        },
        "search_share": statistics.median(search),
        "difference": _difference(runs[DIAGRAM], runs[COMPILED]),
    }


def _difference(expected: Run, run: Run) -> float:
    return max(
        float(np.max(np.abs(run.signals[name] - values)) / (1 + np.max(np.abs(values))))
        for name, values in expected.signals.items()
    )


def table(results: dict[str, Any]) -> str:
    """The results as text."""
    rows = [f"{'times the diagram':>18}{'times real time':>18}"]
    for way, meaning in _WAYS.items():
        ratio, factor = results["ratios"][way], results["real_time_factors"][way]
        rows.append(f"{ratio:18.1f}{factor:18.1f}  {meaning}")
    by = f"as C by {results['compiler']}" if results["compiler"] else "by the virtual machine alone"
    rows.append(
        f"evaluated {by}; the layer's search takes "
        f"{results['search_share']:.0%} of engine=compiled; signals of both engines are within "
        f"{results['difference']:.0e} of each other"
    )
    return "\n".join(rows)
