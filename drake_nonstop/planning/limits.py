"""The table of limits on what carriers, cables and aircraft do: a row for each field of a layer.

All that keeps, predicts or judges a limit reads `LIMITS`: the layers, the check of a task, the
design of formations, the outcome of a run and the figures. A new limit of aircraft is a row here
and a field of `LimitsConfig`.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.aircraft import Aircraft, FlightNeeds, stall_factor, thrust_limits


class Of(Enum):
    """Bodies that a limit holds for."""

    SPEED = "speed"  # of each carrier, m/s; of aircraft through the air
    TENSION = "tension"  # of each cable, N
    SEPARATION = "separation"  # of any two carriers, m
    FLIGHT = "flight"  # of what each aircraft needs, `FlightNeeds`


Values = Callable[[Aircraft, FlightNeeds], NDArray]
Margins = Callable[[Aircraft, FlightNeeds, float], list[NDArray]]


@dataclass(frozen=True)
class Limit:
    """A limit, which a layer is asked for by a field of its config.

    Attributes:
        name: of what is limited, as `missed_limits` has it.
        field: of the configs; a least value of 0, or a largest of .inf, is no limit.
        unit: of the field; "": a share.
        words: for what is limited, in tables and figures.
        of: the bodies that it holds for.
        sentence: about what missed it, with {} for the value.
        largest: of the field, of a limit of aircraft.
        quantity: what the limit holds for, of needs of aircraft: its size counts.
        own_margins: where the margin is not that of the quantity's square.
        margin_count: how many margins it has.
        is_least: whether it is the least value; if not, it is the largest.
    """

    name: str
    field: str
    unit: str
    words: str
    of: Of
    sentence: str
    largest: float = math.inf
    quantity: Values | None = None
    own_margins: Margins | None = None
    margin_count: int = 1
    is_least: bool = False

    @property
    def is_of_aircraft(self) -> bool:
        """Whether it limits what aircraft need."""
        return self.of is Of.FLIGHT

    @property
    def none(self) -> float:
        """The value that is no limit."""
        return 0.0 if self.is_least else math.inf

    @property
    def side(self) -> int:
        """1 of a least value, -1 of a largest."""
        return 1 if self.is_least else -1

    def stated(self, config: Any) -> float:
        """The value in a config; `none` where it has no such field, or asks for no limit."""
        value = getattr(config, self.field, self.none)
        return value if isinstance(value, (int, float)) else self.none

    def is_asked(self, config: Any) -> bool:
        """Whether a config asks for it."""
        return self.stated(config) != self.none

    def tightened(self, config: Any, tightening: float) -> float:
        """The value that a solver aims at, a share within the one that is asked for."""
        return (1 + self.side * tightening) * self.stated(config)

    def values(self, aircraft: Aircraft, needs: FlightNeeds) -> NDArray:
        """The quantity (...,) of needs (...,), in `unit`."""
        assert self.quantity is not None
        return np.abs(self.quantity(aircraft, needs))

    def margin_of_squares(self, squares: Any, limit: float) -> Any:
        """The margin of squared values: (value/limit)² − 1, or 1 − (value/limit)² of a largest."""
        return squares / limit**2 - 1 if self.is_least else 1 - squares / limit**2

    def margins(self, aircraft: Aircraft, needs: FlightNeeds, limit: float) -> list[NDArray]:
        """The margins (...,) of needs (...,), of numbers or symbols, negative beyond the limit."""
        if self.own_margins is not None:
            return self.own_margins(aircraft, needs, limit)
        assert self.quantity is not None
        value = self.quantity(aircraft, needs)
        return [self.margin_of_squares(value * value, limit)]

    def worst(self, values: NDArray) -> tuple[int, ...]:
        """The place of the value that is the farthest on the limit's side; of equal ones first."""
        place = np.argmin(self.side * values.round(9))
        return tuple(int(i) for i in np.unravel_index(place, values.shape))


def _lift_margins(aircraft: Aircraft, needs: FlightNeeds, limit: float) -> list[NDArray]:
    """1 − ‖F‖/(κ_s V²).

    Up to some percent stricter than C_L, and it has no end of the angle of attack at which it would
    not tell what to do.
    """
    factor = stall_factor(aircraft, limit)
    return [1 - needs.force / (factor * needs.airspeed * needs.airspeed)]


def _thrust_range(aircraft: Aircraft, needs: FlightNeeds) -> tuple[NDArray, NDArray]:
    """The middle of the thrust's range, and half of it, N."""
    least, most = thrust_limits(aircraft, needs.airspeed)
    return (most + least) / 2, (most - least) / 2


def _thrust_share(aircraft: Aircraft, needs: FlightNeeds) -> NDArray:
    middle, half = _thrust_range(aircraft, needs)
    return (needs.thrust - middle) / half


def _thrust_margins(aircraft: Aircraft, needs: FlightNeeds, limit: float) -> list[NDArray]:
    """The distances from the ends of the allowed part of the range, over the weight."""
    middle, half = _thrust_range(aircraft, needs)
    weight = aircraft.mass * aircraft.gravity
    return [
        (middle + limit * half - needs.thrust) / weight,
        (needs.thrust - middle + limit * half) / weight,
    ]


LIMITS = (
    Limit("speed", "max_speed", "m/s", "carrier speed", Of.SPEED, "a carrier flew at {}"),
    Limit(
        *("least_tension", "min_tension", "N", "tension", Of.TENSION),
        "a cable's tension fell to {}",
        is_least=True,
    ),
    Limit(
        *("largest_tension", "max_tension", "N", "tension", Of.TENSION),
        "a cable's tension rose to {}",
    ),
    Limit(
        *("separation", "min_separation", "m", "carriers apart", Of.SEPARATION),
        "two carriers came within {} of each other",
        is_least=True,
    ),
    Limit(
        *("lift", "max_lift_share", "", "C_L / C_Lmax", Of.FLIGHT),
        "an aircraft flew with {} of C_Lmax",
        1.0,
        lambda aircraft, needs: needs.lift / aircraft.max_lift,
        _lift_margins,
    ),
    Limit(
        *("bank", "max_bank", "rad", "bank", Of.FLIGHT),
        "an aircraft banked by {}",
        math.pi / 2,
        lambda aircraft, needs: needs.bank,
    ),
    Limit(
        *("climb", "max_climb", "rad", "climb or descent", Of.FLIGHT),
        "an aircraft climbed or descended at {}",
        math.pi / 2,
        lambda aircraft, needs: needs.climb,
    ),
    Limit(
        *("thrust", "max_thrust_share", "", "thrust, of its range", Of.FLIGHT),
        "an aircraft's thrust was {} of its range from the middle to an end",
        1.0,
        _thrust_share,
        _thrust_margins,
        margin_count=2,
    ),
)


def limits_of(*kinds: Of) -> tuple[Limit, ...]:
    """The rows of these kinds."""
    return tuple(limit for limit in LIMITS if limit.of in kinds)


def asked(config: Any, *kinds: Of) -> Iterator[tuple[Limit, float]]:
    """The rows that a config asks for, of these kinds or of all, with the values stated."""
    for limit in LIMITS if not kinds else limits_of(*kinds):
        if limit.is_asked(config):
            yield limit, limit.stated(config)
