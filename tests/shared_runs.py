"""Runs that several tests judge, flown once per test run whatever the number of workers.

The compiled engine flies them where it can: `simulation/test_engines.py` holds it to the diagram.
"""

import contextlib
import copy
import dataclasses
import fcntl
import hashlib
import os
import pickle
from collections.abc import Iterator
from pathlib import Path

from drake_nonstop import Run, Scenario, compute_metrics
from drake_nonstop.scenario.loading import dump_scenario
from drake_nonstop.studies.run_all import fly

# Who asks for a run has its scenario; its diagram, which cannot be pickled, is built where it is
# needed.
_STORED = [field.name for field in dataclasses.fields(Run)]
_STORED = [name for name in _STORED if name not in ("scenario", "diagram")]


class SharedRuns:
    """A folder of runs, filled by the first process that asks for each.

    What is returned is shared: its arrays cannot be written to, and its `diagram` is None.
    """

    def __init__(self, folder: Path):
        self._folder = folder
        self._here: dict[str, tuple[Run, dict]] = {}  # of this process

    def run(self, scenario: Scenario) -> Run:
        """The run of a scenario."""
        return self.evaluated(scenario)[0]

    def evaluated(self, scenario: Scenario) -> tuple[Run, dict]:
        """The run of a scenario and its metrics."""
        key = hashlib.sha256(dump_scenario(scenario).encode()).hexdigest()
        if key not in self._here:
            stored = self._stored(key, scenario)
            run = Run(scenario=copy.deepcopy(scenario), diagram=None, **stored)
            for values in (run.time, run.solve_times, *run.signals.values(), *run.steps.values()):
                values.flags.writeable = False
            self._here[key] = run, compute_metrics(run)
        return self._here[key]

    def _stored(self, key: str, scenario: Scenario) -> dict:
        """The stored fields of a run, flown now where no process has done so before."""
        path = self._folder / f"{key}.pickle"
        self._folder.mkdir(exist_ok=True)
        with _locked(path.with_suffix(".lock")):
            if path.exists():
                return pickle.loads(path.read_bytes())
            run = fly(scenario)
            stored = {name: getattr(run, name) for name in _STORED}
            written = path.with_suffix(".new")
            written.write_bytes(pickle.dumps(stored, protocol=pickle.HIGHEST_PROTOCOL))
            os.replace(written, path)
            return stored


@contextlib.contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Waits until no other process holds the file."""
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
