"""A run in files: its signals with their units, and what its metrics are measured from.

Both are NumPy's archives. `signals.npz` has `time`, each signal by its name "block.port" at 100 Hz,
and `entries`, a table of the signals' columns: signal, column, name, unit and frame. It repeats to
the bit from run to run. `steps.npz` has the few signals at every step, and `run`, a JSON text with
wall time, step and ending.
"""

import json
import os
import warnings
import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.mechanics.signal_layouts import Entry
from drake_nonstop.scenario.loading import parse_scenario
from drake_nonstop.simulation.run import Run, solve_times_of
from drake_nonstop.simulation.signal_table import SignalTable
from drake_nonstop.validation import (
    ScenarioError,
    ScenarioWarning,
    one_line,
    read_text,
    require,
)

SCENARIO, SIGNALS, STEPS = "scenario.yaml", "signals.npz", "steps.npz"

_TIME, _ENTRIES, _RUN = "time", "entries", "run"
_COLUMNS = ("signal", "column", *Entry._fields)  # of the entries
# Of a `Run`, as they are.
_FIELDS = ("wall_time", "is_steered", "stopped", "step", "unresolved", "half_step")
_OWN_BLOCKS = "has_own_blocks"


def write_signals(path: Path, run: Run) -> None:
    """Writes `signals.npz`, a signal at a time: not all of a long run are in memory."""
    arrays = ((name, run.signals[name]) for name in run.signals)
    _write(path, [(_TIME, run.time), (_ENTRIES, _entry_table(run))], arrays)


def write_steps(path: Path, run: Run) -> None:
    """Writes `steps.npz`."""
    facts = {name: getattr(run, name) for name in _FIELDS}
    facts[_OWN_BLOCKS] = run.replacements != {}
    text = np.array(json.dumps(facts))
    _write(path, [(_RUN, text)], ((name, run.steps[name]) for name in run.steps))


def load_signals(folder: Path | str) -> SignalTable:
    """The signals of the run whose results are in a folder, without its scenario and its blocks.

    Raises:
        ScenarioError: there are none, or they cannot be read.
    """
    path = _path(folder) / SIGNALS
    remedy = "there is no such file; give the folder of a run"
    require(path.is_file(), "run", path, remedy)
    signals = _read(path)
    time, rows = signals.pop(_TIME, None), signals.pop(_ENTRIES, None)
    if time is None or not _is_numeric(time, 1):
        raise _damaged(path, _TIME)
    for name, values in signals.items():
        if not _is_numeric(values, 2, len(time)):
            raise _damaged(path, name)
    if rows is None or rows.dtype.names != _COLUMNS:
        raise _damaged(path, _ENTRIES)
    entries = _entries(rows)
    for name, own in entries.items():
        if name not in signals or len(own) != signals[name].shape[1]:
            raise _damaged(path, f"{_ENTRIES} of {name}")
    return SignalTable(time=time, signals=signals, entries=entries)


def load_run(folder: Path | str, *, trust: bool = False) -> Run:
    """The run whose results are in a folder; see `Run.load`."""
    folder = _path(folder)
    remedy = "give the folder of a run, with its scenario.yaml, signals.npz and steps.npz"
    for name in (SCENARIO, SIGNALS, STEPS):
        require((folder / name).is_file(), "run", folder / name, f"there is no such file; {remedy}")
    scenario = parse_scenario(read_text(folder / SCENARIO, "run", remedy), "run", trust=trust)
    table = load_signals(folder)
    steps = _read(folder / STEPS)
    facts = _facts(folder / STEPS, steps)
    known = {name: facts[name] for name in _FIELDS}
    has_own_blocks = facts[_OWN_BLOCKS]
    _check_steps(folder, steps, len(scenario.system.attachments))
    if has_own_blocks:
        text = f"run = {folder}: blocks that its scenario does not name were in the loop; its "
        warnings.warn(f"{text}diagram is that of the scenario", ScenarioWarning, stacklevel=3)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ScenarioWarning)  # they were told before it flew
        diagram = make_nonstop(scenario)
    known["unresolved"] = tuple(known["unresolved"])
    return Run(
        scenario=scenario,
        diagram=diagram,
        steps=steps,
        solve_times=solve_times_of(steps),
        replacements=None if has_own_blocks else {},
        **vars(table),
        **known,
    )


def _path(folder: Any) -> Path:
    require(isinstance(folder, (str, os.PathLike)), "run", folder, "give the path of its folder")
    return Path(folder)


def _is_numeric(values: NDArray, dimensions: int, count: int | None = None) -> bool:
    """Whether it is of floats, of so many dimensions, and has as many rows as are asked for."""
    is_shaped = values.ndim == dimensions and count in (None, len(values))
    return is_shaped and values.dtype.kind == "f"


def _damaged(path: Path, part: str) -> ScenarioError:
    remedy = "fly the scenario again, by `drake-nonstop run` with the folder's scenario.yaml"
    return ScenarioError(f"run = {path}: its part {part} is missing or damaged; {remedy}")


def _facts(path: Path, steps: dict[str, NDArray]) -> dict[str, Any]:
    """What `_RUN` tells, which is taken out of the steps."""
    try:
        facts: dict[str, Any] = json.loads(str(steps.pop(_RUN)))
        is_whole = {*_FIELDS, _OWN_BLOCKS} <= facts.keys() and isinstance(facts["unresolved"], list)
    except (KeyError, ValueError, AttributeError):
        is_whole = False
    if not is_whole:
        raise _damaged(path, _RUN)
    return facts


def _check_steps(folder: Path, steps: Mapping[str, NDArray], n: int) -> None:
    """Raises ScenarioError where the steps are not those of a loop of n carriers."""
    path = folder / STEPS
    time = steps.get(_TIME)
    if time is None or not _is_numeric(time, 1):
        raise _damaged(path, _TIME)
    for name in ("carrier_state", "tensions"):
        if name not in steps:
            raise _damaged(path, name)
    for name, values in steps.items():
        if not _is_numeric(values, 1 if name == _TIME else 2, len(time)):
            raise _damaged(path, name)
    carriers = steps["carrier_state"].shape[1] // 6
    remedy = f"its steps are those of {carriers} carriers; put the files of one run into the folder"
    require(carriers == n, f"run = {folder / SCENARIO}: system.attachments", n, remedy)


def _write(
    path: Path, first: Iterable[tuple[str, NDArray]], rest: Iterable[tuple[str, NDArray]]
) -> None:
    """What `np.savez_compressed` would write."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for arrays in (first, rest):
            for name, values in arrays:
                with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                    np.lib.format.write_array(file, values, allow_pickle=False)


def _read(path: Path) -> dict[str, NDArray]:
    try:
        with np.load(path, allow_pickle=False) as archive:
            return dict(archive)
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise ScenarioError(
            f"run = {path}: it cannot be read ({one_line(error)}); fly the scenario again"
        ) from None


def _entry_table(run: Run) -> NDArray:
    """The rows of `entries`."""
    rows = [
        (name, column, *entry)
        for name in run.signals
        for column, entry in enumerate(run.entries.get(name, ()))
    ]
    columns = [np.array(column) for column in zip(*rows, strict=True)]
    table = np.empty(
        len(rows), dtype=[(n, c.dtype) for n, c in zip(_COLUMNS, columns, strict=True)]
    )
    for name, column in zip(_COLUMNS, columns, strict=True):
        table[name] = column
    return table


def _entries(table: NDArray) -> Mapping[str, tuple[Entry, ...]]:
    found: dict[str, tuple[Entry, ...]] = {}
    for signal, _, *entry in table.tolist():
        found[signal] = (*found.get(signal, ()), Entry(*entry))
    return found
