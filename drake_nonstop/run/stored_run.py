"""A run in a file: its signals with their units, and what its metrics are measured from.

`signals.npz` is one of NumPy's archives. It has `time`, each signal by its name "block.port" at
100 Hz, and `entries`, a table of the signals' columns: signal, column, name, unit and frame; the
few signals at every step, "steps/port", with their times, "steps/time"; and `run`, a JSON text with
wall time, step and ending. All but `run` and "steps/solve_time" repeat to the bit.
"""

import contextlib
import json
import os
import struct
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.signal_layouts import Entry
from drake_nonstop.run.run import Run, built_again, solve_times_of
from drake_nonstop.run.signal_table import SignalTable
from drake_nonstop.scenario.loading import parse_scenario
from drake_nonstop.validation import ScenarioError, one_line, read_text, require

SCENARIO, SIGNALS = "scenario.yaml", "signals.npz"

_TIME, _ENTRIES, _RUN, _STEPS = "time", "entries", "run", "steps/"
_COLUMNS = ("signal", "column", *Entry._fields)  # of the entries
# Of a `Run`, as they are.
_FACTS = ("wall_time", "engine", "is_steered", "stopped", "step", "unresolved", "half_step")
_OWN_BLOCKS = "has_own_blocks"

# What reading an archive may raise that is damaged, or is one of something else.
_UNREADABLE = (
    *(OSError, EOFError, MemoryError, RuntimeError, LookupError, TypeError, ValueError),
    *(AttributeError, struct.error, zipfile.BadZipFile, zlib.error),
)


def write_signals(path: Path, run: Run) -> None:
    """Writes what `numpy.load` reads; twice as fast as NumPy, a hundredth larger (quintic)."""
    facts = {name: getattr(run, name) for name in _FACTS}
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
    with _reading(folder, SIGNALS) as path:
        return _table(_read(path))


def load_run(folder: Path | str, *, trust: bool = False) -> Run:
    """The run whose results are in a folder; see `Run.load`."""
    with _reading(folder, SCENARIO) as path:
        text = read_text(path, "text", "give a file that can be read")
        scenario = parse_scenario(text, "text", trust=trust)
    with _reading(folder, SIGNALS) as path:
        arrays = _read(path)
        facts = json.loads(str(arrays[_RUN]))
        has_own_blocks = facts[_OWN_BLOCKS]
        known: dict[str, Any] = {name: facts[name] for name in _FACTS}
        known["unresolved"] = tuple(known["unresolved"])
        steps = {k.removeprefix(_STEPS): v for k, v in arrays.items() if k.startswith(_STEPS)}
        _require_times(steps)
        table = _table(arrays)
        flown, stated = steps["carrier_state"].shape[1] // 6, len(scenario.system.attachments)
        if flown != stated:
            raise ValueError(f"{flown} carriers flew, and the scenario has {stated}")
    replacements: dict[str, Any] | None = None if has_own_blocks else {}
    return Run(
        scenario=scenario,
        diagram=built_again(scenario, replacements, folder),
        steps=steps,
        solve_times=solve_times_of(steps),
        replacements=replacements,
        **vars(table),
        **known,
    )


@contextlib.contextmanager
def _reading(folder: Path | str, name: str) -> Iterator[Path]:
    """The path of a run's file; has a ScenarioError name it where it cannot be read within."""
    require(isinstance(folder, (str, os.PathLike)), "run", folder, "give the path of its folder")
    path = Path(folder) / name
    remedy = f"there is no such file; give the folder of a run, with {SCENARIO} and {SIGNALS}"
    require(path.is_file(), f"{name}, run", path.parent, remedy)
    try:
        yield path
    except ScenarioError as error:
        raise ScenarioError(f"{name}, run = {path.parent}: {error}") from None
    except _UNREADABLE as error:
        raise ScenarioError(
            f"{name}, run = {path.parent}: it cannot be read ({one_line(error)}); put the files of "
            f"a run there, or fly its {SCENARIO} again with `drake-nonstop run`"
        ) from None


def _read(path: Path) -> dict[str, NDArray]:
    """The arrays of an archive, read-only; those whose checksums are wrong raise an error."""
    found = {}
    with np.load(path, allow_pickle=False) as archive:
        for name in archive.files:
            found[name] = archive[name]
            found[name].flags.writeable = False
    return found


def _require_times(arrays: Mapping[str, NDArray]) -> None:
    """Raises ValueError unless `time` increases, and each array (k, size) has a row for each."""
    time = arrays[_TIME]
    if not (time.ndim == 1 and len(time) and np.all(np.diff(time) > 0)):
        raise ValueError(f"{_TIME} does not increase")
    for name, values in arrays.items():
        if len(values) != len(time) or values.ndim != 1 + (name != _TIME):
            raise ValueError(f"{name} has not {len(time)} rows, as {_TIME} has")


def _table(arrays: Mapping[str, NDArray]) -> SignalTable:
    """The signals among the arrays of a file."""
    others = (_TIME, _ENTRIES, _RUN)
    signals = {k: v for k, v in arrays.items() if k not in others and not k.startswith(_STEPS)}
    _require_times({_TIME: arrays[_TIME], **signals})
    entries: dict[str, tuple[Entry, ...]] = {}
    for signal, _, *entry in arrays[_ENTRIES].tolist():
        entries[signal] = (*entries.get(signal, ()), Entry(*entry))
    for name in [*entries, *signals]:
        if len(entries.get(name, ())) != signals[name].shape[1]:
            raise ValueError(f"{_ENTRIES} of {name} are not of its columns")
    return SignalTable(time=arrays[_TIME], signals=signals, entries=entries)


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
