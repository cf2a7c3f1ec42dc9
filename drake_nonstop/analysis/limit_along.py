"""A limit of a layer beside what it holds for, along a plan or a flight."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.optimization.limits import Limit, Of

_NEARLY = 0.04  # of a limit


class LimitAlong(NamedTuple):
    """A limit that a layer is asked for, and what it holds for at k instants."""

    limit: Limit
    stated: float
    times: NDArray  # (k,), s
    values: NDArray  # (k, c), in the limit's unit, of carriers, cables or pairs of carriers

    @property
    def worst(self) -> float:
        """The value that is the closest to the limit, or the farthest beyond it."""
        return float(self.values[self.limit.worst(self.values)])

    @property
    def time(self) -> float:
        """When that is, s."""
        return float(self.times[self.limit.worst(self.values)[0]])

    @property
    def carriers(self) -> tuple[int, ...]:
        """Of which carrier or cable, or which two, from 1 on."""
        column, count = self.limit.worst(self.values)[1], self.values.shape[1]
        if self.limit.of is not Of.SEPARATION:
            return (column + 1,)
        n = round((1 + np.sqrt(1 + 8 * count)) / 2)
        return tuple(int(numbers[column]) + 1 for numbers in np.triu_indices(n, 1))

    @property
    def margin(self) -> float:
        """From the worst value to the limit, of the limit; negative where it is beyond."""
        return self.limit.side * (self.worst - self.stated) / self.stated

    @property
    def is_kept(self) -> bool:
        """Whether all values are within the limit."""
        return self.margin >= 0

    @property
    def is_in_doubt(self) -> bool:
        """Whether it is missed by so little that the layer may keep it."""
        return -_NEARLY < self.margin < 0

    @property
    def where(self) -> str:
        """Such as "t = 5.30 s, carrier 2"."""
        what = "cable" if self.limit.of is Of.TENSION else "carrier"
        if len(self.carriers) > 1:
            what = "carriers"
        return f"t = {self.time:.2f} s, {what} {' and '.join(map(str, self.carriers))}"

    def shown(self, value: float) -> str:
        """A value with its unit."""
        return f"{value:.4g} {self.limit.unit}".rstrip()

    @property
    def dictionary(self) -> dict[str, Any]:
        """All but the values over time, for a JSON file."""
        return {
            "field": self.limit.field,
            "unit": self.limit.unit,
            "limit": self.stated,
            "limit_is": "lower" if self.limit.is_least else "upper",
            "value": self.worst,
            "is_kept": self.is_kept,
            "time_s": self.time,
            "carriers": list(self.carriers),
        }
