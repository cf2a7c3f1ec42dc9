"""The speed of a scenario, and the share of the time that each block takes."""

import contextlib
import platform
import statistics
from collections.abc import Callable
from typing import Any

from drake_nonstop.benchmarks.block_timers import OUTSIDE, BlockTimers, Frame
from drake_nonstop.benchmarks.comparing import FreshRuns, Source, spread
from drake_nonstop.run.simulate import simulate
from drake_nonstop.run.versions import versions
from drake_nonstop.scenario.schema import COMPILED, DIAGRAM
from drake_nonstop.validation import require

PACKAGES = "drake", "numpy", "casadi", "scipy"  # whose versions results have
STARTS = 3  # fresh interpreters; the start-up is the median's
START_UP = {  # the phases of a start-up, and their names in the table
    "import_s": "import",
    "scenario_s": "scenario",
    "building_s": "diagram",
    "equilibrium_s": "equilibrium",
    "rest_s": "rest, first step",
}


def benchmark_run(
    source: Source,
    *,
    repeats: int = 5,
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> dict[str, Any]:
    """Runs a scenario in fresh interpreters, then here, alternately without and with timers.

    Args:
        source: what to run.
        repeats: of the runs without timers, which give the real-time factor, and of those
            with timers, of which the one with the median wall time gives the blocks' times.
        progress: called with what is being done and the share of it that is done.

    Returns:
        What `drake-nonstop bench run` writes as JSON, times in s, memory in MiB. The blocks'
        seconds are exclusive: the evaluation of blocks upstream is not counted.
        `calls_per_step` counts how often Drake or another block enters a block per step of the
        simulator, `evaluations_per_step` how many traced functions the block then evaluates.

    Raises:
        ScenarioError: the scenario cannot be run, or its engine is not the diagram's.
    """
    scenario = source.load()
    remedy = "give engine=diagram, whose blocks are timed, or `bench engines`, or --against"
    require(scenario.engine != COMPILED, "engine", scenario.engine, remedy)
    fresh = []
    for i in range(STARTS):
        with contextlib.closing(FreshRuns(source)) as runs:
            fresh.append(runs.run())
        progress("starting up", (i + 1) / STARTS)
    plain: list[tuple[float, float]] = []  # s: the run, the solving in it
    timed: list[tuple[float, BlockTimers]] = []
    for i in range(repeats):
        run = simulate(scenario, engine=DIAGRAM)
        plain.append((run.wall_time, float(run.solve_times.sum())))
        timers = BlockTimers()
        with timers.installed():
            run = simulate(scenario, after_step=timers.after_step)
        timed.append((run.wall_time, timers))
        progress("running", (i + 1) / repeats)
    wall = statistics.median(wall for wall, _ in plain)
    timed.sort(key=lambda pair: pair[1].seconds)
    _, timers = timed[(len(timed) - 1) // 2]
    blocks = _blocks(timers)
    shares = {block["name"]: block["share"] for block in blocks}
    peaks = [answer["peak_memory_MiB"] for answer in fresh]
    return {
        "scenario": scenario.name,
        "overrides": list(source.overrides),
        "versions": versions(*PACKAGES) | {"python": platform.python_version()},
        "repeats": repeats,
        "simulated_s": scenario.simulation_duration,
        "steps": timers.steps,
        "real_time_factor": spread([scenario.simulation_duration / wall for wall, _ in plain]),
        "wall_s": wall,
        "wall_per_step_s": wall / timers.steps,
        "timers_overhead": statistics.median(timed_wall for timed_wall, _ in timed) / wall - 1,
        "timed_s": timers.seconds,
        "blocks": blocks,
        "outside_share": timers.root.seconds / timers.seconds,
        "optimization_layer_share": shares.get("optimization_layer"),
        "solving_share": statistics.median(solving / wall for wall, solving in plain),
        "start_up": _start_up([answer["start_up"] for answer in fresh]),
        "peak_memory_MiB": None if None in peaks else statistics.median(peaks),
        "memory_of_imports_MiB": fresh[0]["start_up"]["memory_of_imports_MiB"],
        "frames": _as_dict(timers.root),
    }


def _blocks(timers: BlockTimers) -> list[dict[str, Any]]:
    """The exclusive time and the calls of each box, longest time first."""
    steps = timers.steps
    result = []
    for box, block in timers.blocks.items():
        frames = [frame for frame in timers.root.walk() if frame.box == box]
        calls: dict[str, int] = {}
        for frame in frames:
            for name, count in frame.calls.items():
                calls[name] = calls.get(name, 0) + count
        seconds = sum(frame.seconds for frame in frames)
        result.append(
            {
                "name": box,
                "block": block,
                "seconds": seconds,
                "share": seconds / timers.seconds,
                "per_step_s": seconds / steps,
                "calls_per_step": sum(calls.values()) / steps,
                "evaluations_per_step": sum(frame.evaluations for frame in frames) / steps,
                "callbacks_per_step": {name: count / steps for name, count in calls.items()},
            }
        )
    return sorted(result, key=lambda block: -block["seconds"])


def _as_dict(frame: Frame) -> dict[str, Any]:
    return {
        "box": frame.box,
        "seconds": frame.seconds,
        "children": [_as_dict(child) for child in frame.children.values()],
    }


def _start_up(starts: list[dict[str, float]]) -> dict[str, float]:
    """The phases of the start with the median total; `rest_s` is the remaining time."""
    start = sorted(starts, key=lambda start: start["total_s"])[(len(starts) - 1) // 2]
    phases = {name: start[name] for name in START_UP if name in start}
    return phases | {"rest_s": start["total_s"] - sum(phases.values()), "total_s": start["total_s"]}


def table(results: dict[str, Any]) -> str:
    """The results as text."""
    factor, start_up = results["real_time_factor"], results["start_up"]
    layer = results["optimization_layer_share"]
    peak, imports = results["peak_memory_MiB"], results["memory_of_imports_MiB"]
    phases = ", ".join(f"{what} {start_up[name]:.2f}" for name, what in START_UP.items())
    head = [
        (
            "real-time factor",
            f"{factor['median']:.2f} ({factor['lowest']:.2f} to {factor['highest']:.2f} in "
            f"{results['repeats']} runs of {results['simulated_s']:g} s)",
        ),
        (
            "wall time per step",
            f"{1e6 * results['wall_per_step_s']:.0f} us, {results['steps']} steps",
        ),
        ("outside the blocks", f"{results['outside_share']:.1%} (Drake and its systems, logs)"),
        (
            "optimization layer",
            f"{'none' if layer is None else f'{layer:.1%}'}, solving "
            f"{results['solving_share']:.1%} of a run without timers",
        ),
        ("start-up", f"{start_up['total_s']:.2f} s: {phases}"),
        (
            "peak memory",
            "unknown" if peak is None else f"{peak:.0f} MiB, after the import {imports:.0f} MiB",
        ),
        ("the timers' cost", f"{results['timers_overhead']:+.1%} of the wall time"),
    ]
    rows = [f"{'':22}{'share':>8}{'us/step':>10}{'calls/step':>12}{'evaluations/step':>18}  block"]
    for block in results["blocks"]:
        if not block["calls_per_step"]:  # Drake's own systems: their time is outside
            rows.append(f"{block['name']:22}{'-':>8}{'-':>10}{'-':>12}{'-':>18}  {block['block']}")
            continue
        rows.append(
            f"{block['name']:22}{block['share']:8.1%}{1e6 * block['per_step_s']:10.1f}"
            f"{block['calls_per_step']:12.2f}{block['evaluations_per_step']:18.2f}"
            f"  {block['block']}"
        )
    outside = results["outside_share"] * results["timed_s"] / results["steps"]
    rows.append(f"{OUTSIDE:22}{results['outside_share']:8.1%}{1e6 * outside:10.1f}")
    return "\n".join([f"{name:22}{value}" for name, value in head] + ["", *rows])
