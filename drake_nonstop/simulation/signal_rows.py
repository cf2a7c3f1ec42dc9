"""Rows of signals: in memory, and in temporary files once they are many."""

import contextlib
import fcntl
import math
import os
import shutil
import tempfile
import time
from array import array
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary, finalize

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.signal_layouts import by_name

DOUBLE = 8  # bytes
_PREFIX = "drake-nonstop-run-"  # of the temporary folders' names
_LEAST_AGE = 60.0  # s, of an abandoned folder: a younger one may be about to be locked


class SignalRows:
    """Values of some ports and their times; the first may be in files, one for each port.

    Args:
        sizes: of the ports, by their names.
    """

    TIMES = ""  # no port has this name

    def __init__(self, sizes: Mapping[str, int]):
        self._sizes = sizes
        self._width = sum(sizes.values())
        self.times, self._values = array("d"), array("d")  # of the rows in memory
        self._stored = 0  # rows in files
        self._files: dict[str, Path] = {}

    def add(self, times: NDArray, values: NDArray) -> None:
        """Adds times (k,), s, and their values (k, size)."""
        self.times.frombytes(times.tobytes())
        self._values.frombytes(values.tobytes())

    def drop_last(self) -> None:
        """Drops the last row."""
        if not self.times:
            self._stored -= 1  # it is in the files, which are cut there
            return
        del self.times[-1:], self._values[-self._width :]

    def __len__(self) -> int:
        return self._stored + len(self.times)

    @property
    def memory(self) -> int:
        """Bytes of the rows in memory."""
        return DOUBLE * (len(self.times) + len(self._values))

    def columns(self) -> dict[str, NDArray]:
        """The rows in memory, (rows, size) of each port and (rows,) of the times."""
        values = np.array(self._values).reshape(-1, self._width)
        columns = {name: part.copy() for name, part in by_name(self._sizes, values).items()}
        return {self.TIMES: np.array(self.times)} | columns

    def store(self, folder: Path) -> None:
        """Appends the rows in memory to the files in a folder, or none of them at an error."""
        folder.mkdir(exist_ok=True)
        for i, (name, values) in enumerate(self.columns().items()):
            self._files[name] = folder / str(i)
            with self._files[name].open("ab") as file:
                # An earlier try may have failed half-way.
                file.truncate(self._stored * DOUBLE * math.prod(values.shape[1:]))
                file.write(values.data)
        self._stored += len(self.times)
        del self.times[:], self._values[:]

    def signals(
        self, names: Mapping[str, str], folder: "TemporaryFolder | None"
    ) -> Mapping[str, NDArray]:
        """All rows, as `columns`.

        Args:
            names: of the ports, by the names of the signals.
            folder: what `store` was given a folder in.
        """
        columns = self.columns()
        in_memory = {name: columns[port] for name, port in names.items()}
        if folder is None or self._stored == 0:
            return in_memory
        files = {
            name: (self._files[port], (self._stored, *columns[port].shape[1:]))
            for name, port in names.items()
        }
        return StoredSignals(folder, files, in_memory if self.times else {})


class StoredSignals(Mapping[str, NDArray]):
    """The signals of a long run, by name, in temporary files.

    Each is mapped to memory when it is asked for, as an array that cannot be written to. The
    files are removed with the last such mapping of a run; an array stays valid without them.

    Args:
        folder: where the files are.
        files: file and shape of each signal.
        rest: what follows of each signal and could not be written.
    """

    def __init__(
        self,
        folder: "TemporaryFolder",
        files: Mapping[str, tuple[Path, tuple[int, ...]]],
        rest: Mapping[str, NDArray],
    ):
        self._folder, self._files, self._rest = folder, files, rest
        # Each takes a file descriptor as long as it is used: one for a signal is enough.
        self._maps: WeakValueDictionary[str, np.memmap] = WeakValueDictionary()

    def __getitem__(self, name: str) -> NDArray:
        path, shape = self._files[name]
        mapped = self._maps.get(name)
        if mapped is None:
            self._maps[name] = mapped = np.memmap(path, float, "r", shape=shape)
        if not self._rest:
            return np.asarray(mapped)
        whole = np.concatenate([mapped, self._rest[name]])
        whole.flags.writeable = False
        return whole

    def __iter__(self) -> Iterator[str]:
        return iter(self._files)

    def __len__(self) -> int:
        return len(self._files)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickles and deep copies are dictionaries of arrays in memory."""
        return dict, ({name: np.array(values) for name, values in self.items()},)


class TemporaryFolder:
    """A folder that is removed with this object.

    The folder of a process that was killed is removed by a later one: a folder whose process
    lives is locked.
    """

    def __init__(self) -> None:
        _remove_abandoned()
        self.path = Path(tempfile.mkdtemp(prefix=_PREFIX))
        lock = os.open(self.path, os.O_RDONLY)
        with contextlib.suppress(OSError):  # not all file systems have locks
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        finalize(self, _remove, self.path, lock, os.getpid())


def _remove(folder: Path, lock: int, process: int) -> None:
    if os.getpid() == process:  # and not a fork of it
        shutil.rmtree(folder, ignore_errors=True)
        os.close(lock)


def _remove_abandoned() -> None:
    """Removes this user's folders of processes that are no more."""
    for folder in Path(tempfile.gettempdir()).glob(f"{_PREFIX}*"):
        with contextlib.suppress(OSError):  # it is another user's, or locked, or gone
            status = folder.lstat()
            if status.st_uid != os.getuid() or time.time() - status.st_mtime < _LEAST_AGE:
                continue
            lock = os.open(folder, os.O_RDONLY | os.O_NOFOLLOW)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(folder)
            finally:
                os.close(lock)
