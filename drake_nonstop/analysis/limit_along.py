"""A limit beside what it holds for, along a plan, a flight or an orbit."""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.optimization.limits import Limit, Of

_NEARLY = 0.04  # of a limit


@dataclass(frozen=True, kw_only=True)
class FlightMargin:
    """One quantity where it is closest to its limit, or farthest beyond.

    Attributes:
        name: of the quantity.
        unit: of `value` and `limit`; "" for a share.
        value: of the quantity.
        limit: of the quantity there.
        is_upper: whether the limit is the largest value; if not, it is the least.
        phase: rad, where on the orbit.
        carriers: which one, or which two, from 1 on.
    """

    name: str
    unit: str
    value: float
    limit: float
    is_upper: bool
    phase: float
    carriers: tuple[int, ...]

    @property
    def margin(self) -> float:
        """From the value to the limit; negative where it is beyond."""
        return self.limit - self.value if self.is_upper else self.value - self.limit

    @property
    def is_kept(self) -> bool:
        """Whether the value is within the limit."""
        return self.margin >= 0

    def shown(self, value: float) -> str:
        """A value of the quantity with its unit, for a sentence or a table."""
        if self.unit == "rad":
            return f"{math.degrees(value):.1f} deg"
        return f"{value:.{1 if self.unit else 2}f} {self.unit}".rstrip()

    @property
    def dictionary(self) -> dict[str, Any]:
        """All of it for a JSON file."""
        return {
            "name": self.name,
            "unit": self.unit,
            "value": self.value,
            "limit": self.limit,
            "limit_is": "upper" if self.is_upper else "lower",
            "margin": self.margin,
            "phase_rad": self.phase,
            "carriers": list(self.carriers),
        }

    @property
    def sentence(self) -> str:
        """The value beside its limit."""
        bound = "at most" if self.is_upper else "at least"
        return f"{self.name} {self.shown(self.value)} ({bound} {self.shown(self.limit)})"


class LimitAlong(NamedTuple):
    """A limit, and what it holds for at k instants."""

    limit: Limit
    stated: Any  # a number, or an array that broadcasts to the values
    times: NDArray  # (k,), s; phases in rad where the instants are those of an orbit
    values: NDArray  # (k, c), in the limit's unit, of carriers, cables or pairs of carriers

    @property
    def left(self) -> NDArray:
        """From the values to the limit (k, c); negative beyond it."""
        return self.limit.side * (self.values - self.stated)

    @property
    def place(self) -> tuple[int, int]:
        """The instant and the column of the least that is left; of equal ones the first."""
        instant, column = np.unravel_index(np.argmin(self.left.round(9)), self.values.shape)
        return int(instant), int(column)

    @property
    def worst(self) -> float:
        """The value that is the closest to the limit, or the farthest beyond it."""
        return float(self.values[self.place])

    @property
    def time(self) -> float:
        """When that is, s."""
        return float(self.times[self.place[0]])

    @property
    def carriers(self) -> tuple[int, ...]:
        """Of which carrier or cable, or which two, from 1 on."""
        column, count = self.place[1], self.values.shape[1]
        if self.limit.of is not Of.SEPARATION:
            return (column + 1,)
        n = round((1 + np.sqrt(1 + 8 * count)) / 2)
        return tuple(int(numbers[column]) + 1 for numbers in np.triu_indices(n, 1))

    def worst_margin(self, phases: NDArray | None = None) -> FlightMargin:
        """The margin there, at phases (k,) in rad of the instants; None: they are `times`."""
        instant, _ = place = self.place
        return FlightMargin(
            name=self.limit.words,
            unit=self.limit.unit,
            value=float(self.values[place]),
            limit=float(np.broadcast_to(self.stated, self.values.shape)[place]),
            is_upper=not self.limit.is_least,
            phase=float((self.times if phases is None else phases)[instant]),
            carriers=self.carriers,
        )

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
