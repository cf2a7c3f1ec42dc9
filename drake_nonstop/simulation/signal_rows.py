"""Rows of signals: in memory, and in a temporary file once they are many."""

import tempfile
from array import array
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.signal_layouts import by_name

DOUBLE = 8  # bytes
_nameless_file = partial(tempfile.TemporaryFile, buffering=0)


class SignalRows:
    """Values of some ports and their times; the first may be in a file.

    The file has no name: it is gone with the last array that is mapped to it, and with the process,
    however that ends.

    Args:
        sizes: of the ports, by their names.

    Attributes:
        times: of the rows in memory, s.
    """

    TIMES = ""  # no port has this name

    def __init__(self, sizes: Mapping[str, int]):
        self._sizes = {self.TIMES: 1, **sizes}
        self._width = sum(sizes.values())
        self.times, self._values = array("d"), array("d")  # of the rows in memory
        self._file: Any = None
        self._stored = 0  # rows in the file

    def add(self, times: NDArray, values: NDArray) -> None:
        """Adds times (k,), s, and their values (k, size)."""
        self.times.frombytes(times.tobytes())
        self._values.frombytes(values.tobytes())

    def drop_last(self) -> None:
        """Drops the last row."""
        if not self.times:
            self._stored -= 1  # it is in the file, where the next is written over it
            return
        del self.times[-1:], self._values[-self._width :]

    def __len__(self) -> int:
        return self._stored + len(self.times)

    @property
    def memory(self) -> int:
        """Bytes of the rows in memory."""
        return DOUBLE * (len(self.times) + len(self._values))

    def _in_memory(self) -> NDArray:
        """The rows in memory (k, 1 + size), each with its time in front."""
        values = np.array(self._values).reshape(-1, self._width)
        return np.column_stack([np.array(self.times), values])

    def columns(self) -> dict[str, NDArray]:
        """The rows, (rows, size) of each port and (rows,) of the times.

        Of rows in the file they are mapped to memory, and cannot be written to.
        """
        rows = self._in_memory()
        if self._stored == 0:
            parts = {name: part.copy() for name, part in by_name(self._sizes, rows).items()}
        else:
            mapped = np.memmap(self._file, float, "r", shape=(self._stored, 1 + self._width))
            whole = np.concatenate([mapped, rows]) if len(rows) else np.asarray(mapped)
            parts = by_name(self._sizes, whole)
        return parts | {self.TIMES: parts[self.TIMES][:, 0]}

    def store(self) -> None:
        """Moves the rows in memory to the file.

        Raises:
            OSError: it has no room for the next ones, or, the first time, for these, which stay in
                memory then.
        """
        rows = self._in_memory()
        if self._file is None:
            self._file = _nameless_file()
        self._file.seek(self._stored * DOUBLE * (1 + self._width))
        self._write(rows.tobytes())
        self._stored += len(rows)
        del self.times[:], self._values[:]
        # Room for as many and more, so that no full disk comes between the next ones and the file.
        self._write(bytes(2 * rows.nbytes))

    def _write(self, content: bytes) -> None:
        while content:
            content = content[self._file.write(content) :]
