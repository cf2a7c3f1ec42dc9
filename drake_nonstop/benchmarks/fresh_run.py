"""Runs of a scenario in an interpreter of their own, as a script: see `comparing.FreshRuns`.

The one argument is JSON with `scenario` (a name or file), `settings` and `trust`. For every
line on the standard input the scenario is run and a line of JSON is written; the first run
measures the start-up. The script gets along with any revision of the package that can be
imported, and uses the standard library alone before that.
"""

import inspect
import json
import os
import re
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

MEBIBYTE = 1 << 20


def main() -> None:
    """Answers until the standard input ends."""
    sys.path.pop(0)  # this file's folder
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # whatever else is printed is no answer
    asked = json.loads(sys.argv[1])
    start = time.perf_counter()
    import drake_nonstop

    imported = time.perf_counter()
    memory_of_imports = memory("VmRSS")
    scenario = drake_nonstop.load_scenario(
        asked["scenario"], asked["settings"], **({"trust": True} if asked["trust"] else {})
    )
    loaded = time.perf_counter()
    module = sys.modules["drake_nonstop.simulation.simulate"]
    phases = {"import_s": imported - start, "scenario_s": loaded - imported}
    for name, phase in (("make_nonstop", "building_s"), ("set_equilibrium", "equilibrium_s")):
        _time_function(module, name, phases, phase)

    def note_first_step(simulator: Any, nonstop: Any) -> Any:
        if simulator.get_context().get_time() > 0:
            phases.setdefault("total_s", time.perf_counter() - start)
        return module.StepAction.CONTINUE

    for _line in sys.stdin:
        options = {}
        is_first = "total_s" not in phases
        if is_first and "after_step" in inspect.signature(module.simulate).parameters:
            options["after_step"] = note_first_step
        run = module.simulate(scenario, **options)
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

    None where the system has no /proc: the peak that getrusage knows is that of the parent
    process too.
    """
    try:
        status = Path("/proc/self/status").read_text()
    except OSError:
        return None
    found = re.search(rf"^{kind}:\s+(\d+) kB$", status, re.MULTILINE)
    return None if found is None else int(found[1]) * 1024 / MEBIBYTE


def _time_function(module: Any, name: str, phases: dict[str, float], phase: str) -> None:
    """Notes how long the first call of a module's function takes."""
    function: Callable | None = getattr(module, name, None)
    if function is None:
        return

    def timed(*arguments: Any, **named: Any) -> Any:
        start = time.perf_counter()
        result = function(*arguments, **named)
        phases.setdefault(phase, time.perf_counter() - start)
        return result

    setattr(module, name, timed)


if __name__ == "__main__":
    main()
