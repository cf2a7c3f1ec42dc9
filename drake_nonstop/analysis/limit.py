"""A limit of a scenario, and what is said of a run or of a planned motion beyond it."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from operator import attrgetter
from typing import Any

from drake_nonstop.analysis.separations import Spacing
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.validation import is_number

_DECIMALS = 9  # of a quantity that is shown


class RunOutcome(str, Enum):
    """Outcomes of a run, the worst first."""

    STOPPED = "stopped"  # it diverged, a block failed, or it was ended before its time
    STALLED = "stalled"  # an aircraft's wing stalled
    CABLE_BROKEN = "cable_broken"  # a cable pulled with more than its breaking load
    LOAD_LOST = "load_lost"  # the load did not follow its reference
    COLLISION = "collision"  # carriers or cables came too close to each other, or to an obstacle
    CABLES_SLACK = "cables_slack"
    BOUND_MISSED = "bound_missed"  # a carrier was below ε
    LIMIT_MISSED = "limit_missed"  # another limit that a block was asked for was not kept
    UNCONVERGED = "unconverged"  # the integrator's step does not resolve the results
    OK = "ok"


@dataclass(frozen=True, kw_only=True)
class Limit:
    """A limit of a scenario: what it bounds, and what is said of a run beyond it."""

    path: str  # in the scenario; one without such a field, or without a number there, has no limit
    sentence: str | Callable[[Any], str]  # with {} for the quantity; or what makes it of a run
    unit: str
    measure: Callable[[Any], float | None]  # of a run's quantities; None: unknown
    share_of: Callable[[Any], float] = lambda run: 1.0  # what the limit is a share of
    whole: str = ""  # the name of that
    is_least: bool = False  # a lower limit
    tolerance: float = 0.0  # of the limit
    outcome: RunOutcome | None = None  # of a run beyond it; None: a warning only
    default: float | None = None  # as stated, where the scenario leaves it open
    aircraft_default: float | None = None  # of runs of aircraft, in `unit`

    def complaint(self, run: Spacing) -> str | None:
        """The sentence about a run beyond the limit; None for a run within it.

        A limit of distances is one of a planned motion, too.
        """
        stated, limit = self._limit_of(run)
        value = self.measure(run)
        if limit is None or value is None:
            return None
        beyond = self.tolerance * abs(limit) if math.isfinite(limit) else 0.0
        if value >= limit - beyond if self.is_least else value <= limit + beyond:
            return None
        shown, bound = _told_apart(value, limit)
        unit = f" {self.unit}" if self.unit else ""
        sentence = self.sentence if isinstance(self.sentence, str) else self.sentence(run)
        sentence = sentence.format(f"{shown}{unit}")
        is_share = self.whole and stated is not None and math.isfinite(limit)
        share = f"{stated:g} of {self.whole}, " if is_share else ""
        return f"{sentence} ({self.path}: {share}{bound}{unit})"

    def _limit_of(self, run: Any) -> tuple[float | None, float | None]:
        """The limit as stated, None where it is that of aircraft, and in `unit`; None: no limit."""
        stated = self._stated_in(run.scenario)
        if stated is None and self.aircraft_default is not None and run.has_aircraft:
            return None, self.aircraft_default
        if stated is None:
            stated = self.default
        return stated, None if stated is None else stated * self.share_of(run)

    def _stated_in(self, scenario: Scenario) -> float | None:
        try:
            value = attrgetter(self.path)(scenario)
        except AttributeError:
            return None
        return value if is_number(value) or value == math.inf else None


DISTANCE_LIMITS = (
    Limit(
        path="limits.carrier_distance",
        outcome=RunOutcome.COLLISION,
        sentence="two carriers came within {} of each other",
        unit="m",
        measure=lambda run: run.carrier_separation,
        share_of=lambda run: run.reach,
        whole="the reach",
        is_least=True,
    ),
    Limit(
        path="limits.cable_distance",
        outcome=RunOutcome.COLLISION,
        sentence="two cables came within {} of each other",
        unit="m",
        measure=lambda run: run.closest_cables_for_attachments[0],
        share_of=lambda run: run.closest_cables_for_attachments[1],
        whole="the distance of their attachments",
        is_least=True,
    ),
    Limit(
        path="limits.clearance",
        outcome=RunOutcome.COLLISION,
        sentence=lambda run: run.approaches[0].sentence,
        unit="m",
        measure=lambda run: run.obstacle_distance(),
        is_least=True,
    ),
)


def find_collisions(motion: Spacing) -> list[str]:
    """A sentence about carriers, one about cables, and one about an obstacle, too close."""
    found = (limit.complaint(motion) for limit in DISTANCE_LIMITS)
    return [sentence for sentence in found if sentence is not None]


def _told_apart(value: float, limit: float) -> tuple[str, str]:
    """Both numbers, in three digits or as many as tell them apart."""
    value = round(value, _DECIMALS)
    for digits in range(3, 17):
        texts = f"{value:.{digits}g}", f"{limit:.{digits}g}"
        if texts[0] != texts[1]:
            break
    return texts
