"""A run in a file: its signals with their units, and what its metrics are measured from.

`signals.npz` is one of NumPy's archives. It has `time`, each signal by its name "block.port" at
100 Hz, and `entries`, a table of the signals' columns: signal, column, name, unit and frame; the
few signals at every step, "steps/port", with their times, "steps/time"; and `run`, a JSON text with
wall time, step and ending. All but `run` and "steps/solve_time" repeat to the bit.
"""

import io
import json
import lzma
import os
import struct
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.signal_layouts import Entry
from drake_nonstop.run.recording import EVERY_STEP, RUN_SIGNALS, recorded_sizes
from drake_nonstop.run.run import WALL_TIME, Run, built_again, solve_times_of
from drake_nonstop.run.signal_table import SignalTable
from drake_nonstop.scenario.loading import parse_scenario
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.validation import ScenarioError, is_number, one_line, read_text, require

SCENARIO, SIGNALS = "scenario.yaml", "signals.npz"

_TIME, _ENTRIES, _RUN, _STEPS = "time", "entries", "run", "steps/"
VARYING = (f"{_RUN}.npy", f"{_STEPS}{WALL_TIME}.npy")  # what differs from run to run
_COLUMNS = ("signal", "column", *Entry._fields)  # of the entries
# Of a `Run`, as they are, with their types.
_FIELDS = {
    "wall_time": (int, float),
    "engine": str,
    "is_steered": bool,
    "stopped": str,
    "step": (int, float),
    "unresolved": list,
    "half_step": (dict, type(None)),
}
_OWN_BLOCKS = "has_own_blocks"
_FACTS: dict[str, Any] = {**_FIELDS, _OWN_BLOCKS: bool}
_REMEDY = f"put the files of a run there, or fly its {SCENARIO} again with `drake-nonstop run`"

# What reading an archive may raise that is damaged, or has another kind of compression.
_UNREADABLE = (
    OSError,
    ValueError,
    EOFError,
    MemoryError,
    RuntimeError,
    struct.error,
    zipfile.BadZipFile,
    zlib.error,
    lzma.LZMAError,
)


def write_signals(path: Path, run: Run) -> None:
    """Writes what `numpy.load` reads; twice as fast as NumPy, a hundredth larger (quintic)."""
    facts = {name: getattr(run, name) for name in _FIELDS}
    facts[_OWN_BLOCKS] = run.replacements != {}
    arrays = {
        _TIME: run.time,
        _ENTRIES: _entry_table(run),
        **run.signals,
        **{f"{_STEPS}{name}": values for name, values in run.steps.items()},
        _RUN: np.array(json.dumps(facts)),
    }
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, np.asarray(array, order="C"), allow_pickle=False)


def load_signals(folder: Path | str) -> SignalTable:
    """The signals of the run whose results are in a folder, without its scenario and its blocks.

    Raises:
        ScenarioError: there are none, or they cannot be read.
    """
    path = _path(folder) / SIGNALS
    return _table(path, _read(path))


def _table(path: Path, arrays: dict[str, NDArray]) -> SignalTable:
    """The signals among the arrays of a file."""
    signals = {k: v for k, v in arrays.items() if k != _RUN and not k.startswith(_STEPS)}
    time, rows = _taken_time(path, signals), signals.pop(_ENTRIES, np.zeros(0))
    _require(rows.dtype.names == _COLUMNS, path, _ENTRIES, "is missing or damaged")
    entries = _entries(rows)
    for name in [*entries, *signals]:
        _require(name in signals, path, name, "is missing")
        own, columns = len(entries.get(name, ())), signals[name].shape[1]
        _require(own == columns, path, f"{_ENTRIES} of {name}", f"has {own} rows of {columns}")
    return SignalTable(time=time, signals=signals, entries=entries)


def load_run(folder: Path | str, *, trust: bool = False) -> Run:
    """The run whose results are in a folder; see `Run.load`."""
    folder = _path(folder)
    scenario = _scenario(folder / SCENARIO, trust)
    path = folder / SIGNALS
    arrays = _read(path)
    table, facts = _table(path, arrays), _taken_facts(path, arrays)
    steps = {k.removeprefix(_STEPS): v for k, v in arrays.items() if k.startswith(_STEPS)}
    steps = {_TIME: _taken_time(path, steps), **steps}
    has_own_blocks = facts.pop(_OWN_BLOCKS)
    replacements: dict[str, Any] | None = None if has_own_blocks else {}
    n = len(scenario.system.attachments)
    of_carriers = {"carrier_state": 6 * n, "tensions": n}
    sizes = {port: size or of_carriers[port] for port, size in RUN_SIGNALS.items()}
    ports = {name.partition(".")[2]: name for name in table.signals}
    _check_sizes(path, table.signals, {ports.get(port, port): k for port, k in sizes.items()})
    _check_sizes(path, steps, {k: v for k, v in sizes.items() if k in EVERY_STEP})
    diagram = built_again(scenario, replacements, folder)
    if not has_own_blocks:
        for values, known in zip((table.signals, steps), recorded_sizes(diagram), strict=True):
            _check_sizes(path, values, {k: v for k, v in known.items() if k in values})
    facts["unresolved"] = tuple(facts["unresolved"])
    return Run(
        scenario=scenario,
        diagram=diagram,
        steps=steps,
        solve_times=solve_times_of(steps),
        replacements=replacements,
        **vars(table),
        **facts,
    )


def read_arrays(file: Path | BinaryIO) -> dict[str, NDArray]:
    """The arrays of one of NumPy's archives, read-only, each once its checksum is found right.

    Raises:
        ValueError: it cannot be read, for whatever reason.
    """
    found = {}
    try:
        with zipfile.ZipFile(file) as archive:
            for name in archive.namelist():
                content = io.BytesIO(archive.read(name))
                array = np.lib.format.read_array(content, allow_pickle=False)
                array.flags.writeable = False
                found[name.removesuffix(".npy")] = array
    except _UNREADABLE as error:
        raise ValueError(one_line(error)) from None
    return found


def _path(folder: Any) -> Path:
    require(isinstance(folder, (str, os.PathLike)), "run", folder, "give the path of its folder")
    return Path(folder)


def _require(condition: bool, path: Path, part: str, wrong: str) -> None:
    """Raises ScenarioError where something is wrong with a part of a run's file."""
    require(condition, f"{part} in {path.name}, run", path.parent, f"it {wrong}; {_REMEDY}")


def _require_file(path: Path) -> None:
    remedy = f"there is no such file; give the folder of a run, with {SCENARIO} and {SIGNALS}"
    require(path.is_file(), f"{path.name}, run", path.parent, remedy)


def _scenario(path: Path, trust: bool) -> Scenario:
    _require_file(path)
    try:
        text = read_text(path, "text", "give a file that can be read")
        return parse_scenario(text, "text", trust=trust)
    except ScenarioError as error:
        raise ScenarioError(f"{path.name}, run = {path.parent}: {error}") from None


def _read(path: Path) -> dict[str, NDArray]:
    _require_file(path)
    try:
        return read_arrays(path)
    except ValueError as error:
        remedy = f"it cannot be read ({error}); {_REMEDY}"
        require(False, f"{path.name}, run", path.parent, remedy)
        raise


def _is_numeric(values: NDArray, dimensions: int) -> bool:
    return values.ndim == dimensions and values.dtype.kind == "f"


def _taken_time(path: Path, arrays: dict[str, NDArray]) -> NDArray:
    """The instants (k,), s, which are taken out; what is left but texts and tables has k rows."""
    time = arrays.pop(_TIME, np.zeros(0))
    _require(_is_numeric(time, 1) and len(time) > 0, path, _TIME, "is missing or damaged")
    is_increasing = bool(np.all(np.isfinite(time)) and np.all(np.diff(time) > 0))
    _require(is_increasing, path, _TIME, "does not increase from instant to instant")
    for name, values in arrays.items():
        if name != _ENTRIES:
            is_table = _is_numeric(values, 2) and len(values) == len(time)
            _require(is_table, path, name, f"is not of {len(time)} rows of numbers, as {_TIME} is")
    return time


def _taken_facts(path: Path, arrays: dict[str, NDArray]) -> dict[str, Any]:
    """The text of `_RUN`."""
    try:
        facts: Any = {"engine": "unknown", **json.loads(str(arrays[_RUN]))}  # not stored before
    except (KeyError, TypeError, ValueError):
        facts = None
    is_whole = isinstance(facts, dict) and all(
        name in facts and isinstance(facts[name], kind) for name, kind in _FACTS.items()
    )
    is_whole = is_whole and all(isinstance(item, str) for item in facts["unresolved"])
    _require(is_whole, path, _RUN, "is missing or damaged")
    step = facts["step"]
    _require(is_number(step) and step >= 0, path, f"{_RUN}.step", f"is {step} s")
    return {name: facts[name] for name in _FACTS}


def _check_sizes(path: Path, values: Mapping[str, NDArray], sizes: Mapping[str, int]) -> None:
    """Raises ScenarioError where values (k, size) are missing or of other sizes."""
    for name, size in sizes.items():
        _require(name in values, path, name, "is missing")
        columns = values[name].shape[1]
        _require(columns == size, path, name, f"has {columns} columns, not {size} as its loop has")


def _entry_table(run: Run) -> NDArray:
    """The rows of `entries`."""
    rows = [
        (name, column, *entry)
        for name in run.signals
        for column, entry in enumerate(run.entries.get(name, ()))
    ]
    columns = [np.array(column) for column in zip(*rows, strict=True)]
    kinds = [(name, column.dtype) for name, column in zip(_COLUMNS, columns, strict=True)]
    return np.rec.fromarrays(columns, dtype=kinds)


def _entries(table: NDArray) -> Mapping[str, tuple[Entry, ...]]:
    found: dict[str, tuple[Entry, ...]] = {}
    for signal, _, *entry in table.tolist():
        found[signal] = (*found.get(signal, ()), Entry(*entry))
    return found
