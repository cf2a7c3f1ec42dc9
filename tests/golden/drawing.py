"""Draws the loops of golden flights: of points, of aircraft, and tasks of the default layer."""

import time
import warnings

import drawn_tasks
import plausible_scenarios
import yaml
from fleet import flown

from drake_nonstop import ScenarioError, ScenarioWarning, load_scenario
from golden.numbers import DRAWN_LOOPS

DURATION = 1.0  # s
LONGEST = 0.6  # s of processor time
COUNTS = {"loop": 22, "aircraft": 8, "task": 10}


def _drawn(kind: str, seed: int) -> tuple[str, list[str]]:
    if kind == "loop":
        return plausible_scenarios.draw(seed)
    if kind == "aircraft":
        return plausible_scenarios.draw_aircraft(seed)
    return "quintic", [*drawn_tasks.draw(seed)]


def write_drawn_loops() -> None:
    """Writes as many loops of each kind as `COUNTS` has, of the seeds from 0 on that can be flown.

    Their motion begins early, and they last `DURATION`; what takes longer than `LONGEST` to fly is
    left out.
    """
    loops = {}
    for kind, count in COUNTS.items():
        seeds = iter(range(1000))
        found = 0
        while found < count:
            seed = next(seeds)
            name, overrides = _drawn(kind, seed)
            overrides = [o.replace("start_time: 1.0", "start_time: 0.2") for o in overrides]
            overrides = [o for o in overrides if not o.startswith("engine=")]
            overrides.append(f"simulation_duration={DURATION}")
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", ScenarioWarning)
                    start = time.process_time()
                    run = flown(load_scenario(name, overrides))
                    seconds = time.process_time() - start
            except ScenarioError:
                continue  # it is refused
            if not run.stopped and seconds < LONGEST:
                loops[f"{kind}_{seed}"] = [name, overrides]
                found += 1
    DRAWN_LOOPS.write_text(
        yaml.safe_dump(loops, sort_keys=False, width=100, default_flow_style=False),
        encoding="utf-8",
    )
