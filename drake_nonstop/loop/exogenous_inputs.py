"""What stands outside of a loop's trace: outputs that are known beforehand, evaluated in rows."""

import functools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context, PortDataType

from drake_nonstop.loop.block_events import sample_times
from drake_nonstop.loop.functions import Reading
from drake_nonstop.systems.block import has_own, is_of_package
from drake_nonstop.systems.diagram_trace import QUANTITIES, ROWS, TAKE_CONFIG

_MOST_SAMPLES = 128  # for which what stands outside is evaluated at once
_MOST_AHEAD = 512  # likewise, of a long flight; no more than it has flown
_MOST_SHARED = 64  # rows of sources that all flights of a loop share
_MOST_KEPT = 100  # times so many samples, for flights that share them


class Source:
    """Outputs known beforehand: of a block without inputs, or a traced one's functions of time.

    The context is the block's own, by itself: to set the time of a whole loop's is slow.
    """

    def __init__(self, block: Any, context: Context):
        self.block, self._context = block, context
        self._time = math.nan
        self._known: dict[int | str, Any] = {}  # at that time
        groups = context.num_numeric_parameter_groups() + context.num_abstract_parameters()
        self.is_fixed = groups == 0 and is_of_package(block)  # its values follow from the time

    def is_like(self, other: "Source") -> bool:
        """Whether it is certain that another one of the block has the same values."""
        own, others = self._context, other._context
        is_told = is_of_package(self.block) and own.num_abstract_parameters() == 0
        return is_told and all(
            np.array_equal(*(c.get_numeric_parameter(k).value() for c in (own, others)))
            for k in range(own.num_numeric_parameter_groups())
        )

    def value(self, output: int | str, at: float) -> Any:
        """Value of a port or a quantity at a time in s."""
        if at != self._time:
            self._context.SetTime(at)
            self._time = at
            self._known.clear()
        if output not in self._known:
            if self._has_rows(output):
                self._known[output] = self._rows([output], np.array([at]))[0][0]
            else:
                self._known[output] = self.block.get_output_port(output).Eval(self._context)
        return self._known[output]

    def values(self, outputs: Sequence[int | str], times: NDArray) -> list[NDArray]:
        """Rows of each of some outputs, at times (k,) in s."""
        given = [output for output in outputs if self._has_rows(output)]
        rows = zip(given, self._rows(given, times), strict=True) if given else ()
        found: dict[int | str, NDArray] = dict(rows)
        others = [output for output in outputs if output not in found]
        evaluated = [[self.value(k, at) for k in others] for at in times.tolist() if others]
        found |= zip(others, map(np.array, zip(*evaluated, strict=True)), strict=True)
        return [found[output] for output in outputs]

    def _has_rows(self, output: int | str) -> bool:
        """Whether the block gives rows of an output, and not its ports alone."""
        if isinstance(output, str):
            return True
        port = self.block.get_output_port(output)
        return has_own(self.block, ROWS) and port.get_data_type() == PortDataType.kVectorValued

    def _rows(self, outputs: Sequence[int | str], times: NDArray) -> list[NDArray]:
        """Values of quantities, or of ports.

        Raises:
            ValueError: the block gives other rows than its ports have.
        """
        if isinstance(outputs[0], str):
            return getattr(self.block, QUANTITIES)(outputs, times)
        ports = [self.block.get_output_port(output) for output in outputs]
        names = [port.get_name() for port in ports]
        given = (self._context,) if hasattr(self.block, TAKE_CONFIG) else ()
        rows = getattr(self.block, ROWS)(names, times, *given)
        for port, own in zip(ports, rows, strict=True):
            if own.shape != (len(times), port.size()):
                name = f"{self.block.get_name()}.{ROWS}"
                raise ValueError(f"{name}: rows {own.shape} of {port.get_name()} ({port.size()})")
        return rows


class ExogenousInputs:
    """Inputs from outside of the function of a whole sample, for many samples at once.

    Flights of a loop with the same `shared` rows evaluate once what depends on the time alone.
    """

    def __init__(
        self,
        readings: Sequence[Reading],
        sources: Mapping[int, Source],
        period: float,
        shared: dict[Any, list[NDArray]],
    ):
        self._readings, self._sources, self._period = readings, sources, period
        self._shared = shared
        read = {reading.system for reading in readings}
        self._is_ours = all(is_of_package(sources[number].block) for number in read)
        self._first = self._end = 0  # samples, of the rows
        self._times = np.zeros(0)
        self._rows = np.zeros((0, 0))
        self._kept: Any = None

    def keep(self) -> None:
        """Keeps rows, made for blocks of samples, for several flights."""
        self._kept = self._kept or functools.lru_cache(_MOST_KEPT)(self._made)

    def of_samples(self, first: int, most: int) -> tuple[NDArray, NDArray]:
        """The times (k,), s, and the rows (k, size) of samples from the first on."""
        if not self._first <= first < self._end:
            self._first, count = first, min(most, _MOST_SAMPLES)
            if self._is_ours:  # one of a user's may end with the flight
                count = min(max(most, first), _MOST_AHEAD)
            if self._kept is not None:
                self._first, count = first - first % _MOST_SAMPLES, _MOST_SAMPLES
            self._times, self._rows = (self._kept or self._made)(self._first, count)
            self._end = self._first + count
        chosen = slice(first - self._first, first - self._first + most)
        return self._times[chosen], self._rows[chosen]

    def _made(self, first: int, count: int) -> tuple[NDArray, NDArray]:
        """Each source is evaluated once at each time."""
        ends = sample_times(np.arange(first, first + count + 1), self._period)
        now, after = ends[:-1], ends[1:]
        columns: list[Any] = [None] * len(self._readings)
        for number in dict.fromkeys(reading.system for reading in self._readings):
            own = [k for k, reading in enumerate(self._readings) if reading.system == number]
            at = [
                after if offset == self._period else now + offset
                for offset in (self._readings[k].offset for k in own)
            ]
            times, places = np.unique(np.array(at), return_inverse=True)
            places = places.reshape(len(own), -1)
            outputs = [*dict.fromkeys(self._readings[k].output for k in own)]
            key = number, first, count
            found = self._shared.get(key)
            if found is None:
                found = self._sources[number].values(outputs, times)
            if self._sources[number].is_fixed and len(self._shared) < _MOST_SHARED:
                self._shared[key] = found
            rows = dict(zip(outputs, found, strict=True))
            for k, place in zip(own, places, strict=True):
                columns[k] = rows[self._readings[k].output][place]
        return now, np.hstack([np.zeros((count, 0)), *columns])
