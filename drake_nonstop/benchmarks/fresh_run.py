"""Runs of a scenario in an interpreter of their own, as a script: see `comparing.FreshRuns`.

The one argument is JSON with `scenario` (a name or file), `overrides` and `trust`. For every
line on the standard input the scenario is run and a line of JSON is written; the first run
measures the start-up. The script runs with any revision of the package: it looks names up
through the package's public ones, and uses the standard library alone before it imports them.
"""

import importlib
import inspect
import json
import os
import re
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

MEBIBYTE = 1 << 20  # bytes


def main() -> None:
    """Answers until the standard input ends."""
    sys.path.pop(0)  # this file's folder, where the package is not to be imported from
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # all else that is printed goes to the standard error
    asked = json.loads(sys.argv[1])
    start = time.perf_counter()
    drake_nonstop: Any = importlib.import_module("drake_nonstop")  # of whatever revision

    imported = time.perf_counter()
    memory_of_imports = memory("VmRSS")
    scenario = drake_nonstop.load_scenario(
        asked["scenario"], asked["overrides"], **({"trust": True} if asked["trust"] else {})
    )
    loaded = time.perf_counter()
    simulate = drake_nonstop.simulate
    phases = {"import_s": imported - start, "scenario_s": loaded - imported}
    for name, phase in (("make_nonstop", "building_s"), ("set_equilibrium", "equilibrium_s")):
        _time_function(getattr(drake_nonstop, name, None), phases, phase)

    def note_first_step(simulator: Any, nonstop: Any) -> None:  # None: the run goes on
        if simulator.get_context().get_time() > 0:
            phases.setdefault("total_s", time.perf_counter() - start)

    for _line in sys.stdin:
        options: dict[str, Any] = {}
        is_first = "total_s" not in phases
        if is_first and "after_step" in inspect.signature(simulate).parameters:
            options["after_step"] = note_first_step
        run = simulate(scenario, **options)
        answer = {
            "simulated_s": float(run.time[-1]),
            "wall_s": run.wall_time,
            "load_positions_m": run.signal("load_state")[:, 4:7].tolist(),
            "package": str(Path(drake_nonstop.__file__).parent),
            "peak_memory_MiB": memory("VmHWM"),
        }
        if is_first:
            answer["start_up"] = phases | {"memory_of_imports_MiB": memory_of_imports}
            phases.setdefault("total_s", 0.0)
        print(json.dumps(answer), file=answers, flush=True)


def memory(kind: str) -> float | None:
    """The resident memory of this process in MiB: "VmRSS" now, "VmHWM" at its peak.

    None where the system has no /proc: the peak that getrusage reports includes that of the
    parent process.
    """
    try:
        status = Path("/proc/self/status").read_text()
    except OSError:
        return None
    found = re.search(rf"^{kind}:\s+(\d+) kB$", status, re.MULTILINE)
    return None if found is None else int(found[1]) * 1024 / MEBIBYTE


def _time_function(function: Callable | None, phases: dict[str, float], phase: str) -> None:
    """Notes how long the first call of a function of the package takes, whoever calls it."""
    if function is None:  # this revision has none
        return

    def timed(*arguments: Any, **named: Any) -> Any:
        start = time.perf_counter()
        result = function(*arguments, **named)
        phases.setdefault(phase, time.perf_counter() - start)
        return result

    modules = [m for name, m in sys.modules.items() if name.split(".")[0] == "drake_nonstop"]
    for module in modules:
        for name, value in list(vars(module).items()):
            if value is function:
                setattr(module, name, timed)


if __name__ == "__main__":
    main()
