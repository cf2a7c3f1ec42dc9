"""Values beside their limits, and the ranges of what aircraft need."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.aircraft import (
    Aircraft,
    FlightNeeds,
    airspeed_over_loaded_stall,
    stall_speed,
    thrust_share,
)
from drake_nonstop.planning.limits import Limit, Of
from drake_nonstop.validation import finite


class Margin(NamedTuple):
    """A quantity where it is closest to its limit, or farthest beyond."""

    name: str
    value: float
    limit: float
    unit: str = ""  # of both; "": a share
    is_least: bool = False  # whether the limit is the least value; if not, it is the largest
    where: str = ""  # such as "carrier 2"
    when: float = math.nan  # s; NaN: it is not at one time

    @classmethod
    def along(
        cls,
        name: str,
        values: NDArray,
        limit: Any,
        times: NDArray,
        *,
        unit: str = "",
        is_least: bool = False,
        of: str = "carrier",
    ) -> "Margin":
        """Returns the margin where the least is left, of equal ones the first.

        Args:
            name: of the quantity.
            values: (k, c), of each carrier, cable or pair of carriers; or (k,), of none.
            limit: a number, or an array that broadcasts to the values.
            times: (k,), s.
            unit: of values and limit.
            is_least: whether the limit is the least value.
            of: what the columns are; "carriers": pairs, in the order of `itertools.combinations`.
        """
        left = (1 if is_least else -1) * (values - limit)
        place = np.unravel_index(np.argmin(left.round(9)), values.shape)
        where = ""
        if values.ndim > 1:
            column, numbers = int(place[1]), [int(place[1]) + 1]
            if of == "carriers":
                n = round((1 + math.sqrt(1 + 8 * values.shape[1])) / 2)
                numbers = [int(each[column]) + 1 for each in np.triu_indices(n, 1)]
            where = f"{of} {' and '.join(map(str, numbers))}"
        at_limit = float(np.broadcast_to(limit, values.shape)[place])
        time = float(times[place[0]])
        return cls(name, float(values[place]), at_limit, unit, is_least, where, time)

    @property
    def margin(self) -> float:
        """From the value to the limit; negative where it is beyond."""
        return self.value - self.limit if self.is_least else self.limit - self.value

    @property
    def is_kept(self) -> bool:
        """Whether the value is within the limit."""
        return self.margin >= 0

    def shown(self, value: float) -> str:
        """A value of the quantity with its unit, for a sentence or a table."""
        if self.unit == "rad":
            return f"{math.degrees(value):.1f} deg"
        return f"{value:.4g} {self.unit}".rstrip()

    @property
    def sentence(self) -> str:
        """The value beside its limit."""
        bound = "at least" if self.is_least else "at most"
        return f"{self.name} {self.shown(self.value)} ({bound} {self.shown(self.limit)})"

    @property
    def place(self) -> str:
        """Such as "t = 5.30 s, carrier 2"; "" where neither is known."""
        time = f"t = {self.when:.2f} s" if math.isfinite(self.when) else ""
        return ", ".join(filter(None, [time, self.where]))

    @property
    def dictionary(self) -> dict[str, Any]:
        """All of it for a JSON file."""
        return {
            "name": self.name,
            "unit": self.unit,
            "value": finite(self.value),
            "limit": finite(self.limit),
            "limit_is": "lower" if self.is_least else "upper",
            "margin": finite(self.margin),
            "where": self.where,
            "when_s": finite(self.when),
        }


class LimitAlong(NamedTuple):
    """A limit, and the values that it holds for at k instants."""

    limit: Limit
    stated: Any  # a number, or an array that broadcasts to the values
    times: NDArray  # (k,), s
    values: NDArray  # (k, c), in the limit's unit, of carriers, cables or pairs of carriers

    @property
    def margin(self) -> Margin:
        """The margin where the least is left."""
        of = {Of.TENSION: "cable", Of.SEPARATION: "carriers"}.get(self.limit.of, "carrier")
        return Margin.along(
            self.limit.words,
            self.values,
            self.stated,
            self.times,
            unit=self.limit.unit,
            is_least=self.limit.is_least,
            of=of,
        )


def _range(values: NDArray) -> tuple[float, float]:
    return float(np.min(values)), float(np.max(values))


class FlightRanges(NamedTuple):
    """The least and the largest of what aircraft need, over all of them and all instants."""

    lift_share: tuple[float, float]  # of C_Lmax
    airspeed: tuple[float, float]  # m/s
    over_stall: tuple[float, float]  # of the airspeed, over the stall speed without a cable
    over_loaded_stall: tuple[float, float]  # over the one with cable and bank
    bank: tuple[float, float]  # rad
    climb: tuple[float, float]  # rad
    thrust: tuple[float, float]  # N
    thrust_share: tuple[float, float]  # of the largest one at that airspeed

    @classmethod
    def of(cls, aircraft: Aircraft, needs: FlightNeeds) -> "FlightRanges":
        """Returns the ranges of needs (k, n), in a plan or in a run."""
        lift, airspeed, thrust = needs.lift, needs.airspeed, needs.thrust
        return cls(
            lift_share=_range(lift / aircraft.max_lift),
            airspeed=_range(airspeed),
            over_stall=_range(airspeed / stall_speed(aircraft)),
            over_loaded_stall=_range(airspeed_over_loaded_stall(aircraft, airspeed, lift, thrust)),
            bank=_range(needs.bank),
            climb=_range(needs.climb),
            thrust=_range(thrust),
            thrust_share=_range(thrust_share(aircraft, thrust, airspeed)),
        )

    @property
    def lines(self) -> list[tuple[str, str]]:
        """A name and a text for each line of a table."""
        degrees = [math.degrees(angle) for angle in self.bank]
        (least, most), (share, most_share) = self.thrust, self.thrust_share
        return [
            (
                "airspeed",
                f"{self.airspeed[0]:.1f} to {self.airspeed[1]:.1f} m/s, at least "
                f"{self.over_stall[0]:.2f} of the stall speed, and "
                f"{self.over_loaded_stall[0]:.2f} of that with cable and bank",
            ),
            (
                "thrust",
                f"{least:.1f} to {most:.1f} N, {100 * share:.0f} to {100 * most_share:.0f} % of "
                "the largest",
            ),
            ("bank", f"{degrees[0]:.1f} to {degrees[1]:.1f} deg"),
        ]

    @property
    def dictionary(self) -> dict[str, Any]:
        """The same for a JSON file."""
        return {
            "lift_share": list(self.lift_share),
            "airspeed_m_s": list(self.airspeed),
            "airspeed_over_stall": list(self.over_stall),
            "airspeed_over_loaded_stall": list(self.over_loaded_stall),
            "bank_rad": list(self.bank),
            "climb_rad": list(self.climb),
            "thrust_N": list(self.thrust),
            "thrust_share": list(self.thrust_share),
        }
