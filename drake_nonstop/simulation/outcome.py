"""What became of a run: its outcome with the reasons, and what it is warned about.

`LIMITS` has a row for each limit of a scenario that a run is held against; those that a layer is
asked for are the rows of `optimization.limits`.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from functools import partial
from operator import attrgetter
from typing import Any

from drake_nonstop.mechanics.aircraft import stall_speed
from drake_nonstop.optimization.limits import LIMITS as ASKED
from drake_nonstop.optimization.limits import Of, limits_of
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.simulation.run_quantities import RunQuantities
from drake_nonstop.simulation.separations import Spacing
from drake_nonstop.validation import is_number

_ROUNDING = 1e-3  # of a limit that a block aims at, by which it may be missed
_DECIMALS = 9  # of a quantity that is shown


class RunOutcome(str, Enum):
    """What became of a run, the worst first."""

    STOPPED = "stopped"  # it diverged, a block failed, or it was ended before its time
    STALLED = "stalled"  # an aircraft's wing stalled
    LOAD_LOST = "load_lost"  # the load did not follow its reference
    COLLISION = "collision"  # carriers or cables came too close to each other
    CABLES_SLACK = "cables_slack"
    BOUND_MISSED = "bound_missed"  # a carrier was below ε
    LIMIT_MISSED = "limit_missed"  # another limit that a block was asked for was not kept
    UNCONVERGED = "unconverged"  # the integrator's step does not resolve the results
    OK = "ok"


@dataclass(frozen=True, kw_only=True)
class Judgement:
    """The outcome of a run, and a sentence for each reason, of the worst outcome first."""

    outcome: RunOutcome
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Limit:
    """A limit of a scenario: what it bounds, and what is said of a run beyond it."""

    path: str  # in the scenario; one without such a field, or without a number there, has no limit
    sentence: str  # with {} for the quantity
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
        sentence = self.sentence.format(f"{shown}{unit}")
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


LIMITS = (
    Limit(
        path="limits.position_error",
        outcome=RunOutcome.LOAD_LOST,
        sentence="the load was {} from its reference",
        unit="m",
        measure=lambda run: run.largest_position_error,
        share_of=lambda run: run.reach,
        whole="the reach",
        default=0.2,
        aircraft_default=1.0,
    ),
    Limit(
        path="limits.orientation_error",
        outcome=RunOutcome.LOAD_LOST,
        sentence="the load was turned by {} from its reference",
        unit="rad",
        measure=lambda run: run.largest_orientation_error,
        default=0.8,
        aircraft_default=math.radians(15.0),
    ),
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
        path="limits.slack_time",
        outcome=RunOutcome.CABLES_SLACK,
        sentence="a cable was slack for {}",
        unit="s",
        measure=lambda run: run.slack_time,
    ),
    Limit(
        path="limits.time_below_bound",
        outcome=RunOutcome.BOUND_MISSED,
        sentence="a carrier was below the bound for {}",
        unit="s",
        measure=lambda run: run.time_below_bound,
    ),
    Limit(
        path="limits.saturated_share",
        outcome=RunOutcome.LIMIT_MISSED,
        sentence="commands of aircraft were at their limits for {} of the time",
        unit="%",
        measure=lambda run: run.saturated_share and 100 * run.saturated_share,
        share_of=lambda run: 100.0,
        whole="it",
    ),
    Limit(
        path="limits.speed",
        sentence="not plausible: a carrier flew at {}",
        unit="m/s",
        measure=lambda run: run.peak_speed,
    ),
    Limit(
        path="limits.acceleration",
        sentence="not plausible: a carrier was accelerated by {}",
        unit="m/s²",
        measure=lambda run: run.largest_acceleration,
    ),
    Limit(
        path="limits.tension",
        sentence="not plausible: a cable's tension rose to {}",
        unit="N",
        measure=lambda run: run.largest_tension,
        share_of=lambda run: run.load_weight,
        whole="the weight",
    ),
    # What blocks are asked for. They command it; what is simulated follows with an error.
    *(
        Limit(
            path=f"{box}.{asked.field}",
            outcome=RunOutcome.LIMIT_MISSED,
            sentence=asked.sentence,
            unit=asked.unit,
            measure=partial(RunQuantities.extreme_of, limit=asked),
            is_least=asked.is_least,
            tolerance=_ROUNDING,
        )
        for box, rows in (
            ("optimization_layer", ASKED),
            ("force_distribution", limits_of(Of.TENSION)),
        )
        for asked in rows
    ),
    Limit(
        path="carrier_dynamics.max_force",
        sentence="a carrier was asked for a force of {}",
        unit="N",
        measure=lambda run: run.largest_carrier_force,
        tolerance=_ROUNDING,
    ),
)


def judge(run: RunQuantities) -> Judgement:
    """The outcome of a run, the worst of all that is wrong with it, and all reasons."""
    wrong = [
        (limit.outcome, sentence)
        for limit in LIMITS
        if limit.outcome is not None and (sentence := limit.complaint(run)) is not None
    ]
    if run.run.stopped:
        wrong.append((RunOutcome.STOPPED, run.run.stopped))
    if run.first_stall is not None:
        wrong.append((RunOutcome.STALLED, _told(run)))
    wrong += [(RunOutcome.UNCONVERGED, sentence) for sentence in run.run.unresolved]
    severity = list(RunOutcome)
    wrong.sort(key=lambda item: severity.index(item[0]))
    worst = wrong[0][0] if wrong else RunOutcome.OK
    return Judgement(outcome=worst, reasons=tuple(sentence for _, sentence in wrong))


def _told(run: RunQuantities) -> str:
    """The sentence about the first stall."""
    stall, aircraft = run.first_stall, run.aircraft
    assert stall is not None
    assert aircraft is not None
    ends = run.run.steps["time"][-1] < run.run.scenario.simulation_duration
    end = ", where the run ended" if ends and not run.run.stopped else ""
    return (
        f"carrier {stall.carrier} stalled at t = {stall.time:.3f} s{end}: C_L was "
        f"{stall.lift:.3g} of at most {aircraft.max_lift:.3g}, and the airspeed "
        f"{stall.airspeed:.3g} m/s, with a stall speed of {stall_speed(aircraft):.3g} m/s"
    )


def find_collisions(motion: Spacing) -> list[str]:
    """A sentence about carriers, and one about cables, that come too close to each other."""
    found = (limit.complaint(motion) for limit in LIMITS if limit.outcome is RunOutcome.COLLISION)
    return [sentence for sentence in found if sentence is not None]


def find_warnings(run: RunQuantities) -> list[str]:
    """What is not as it should be in a run and decides no outcome, a sentence each."""
    found = [
        sentence
        for limit in LIMITS
        if limit.outcome is None and (sentence := limit.complaint(run)) is not None
    ]
    unsolved = run.update_counts["relaxed"] + run.update_counts["held"]
    if unsolved > 0:  # and not NaN
        missed = [f"{name} at {count}" for name, count in run.missed_limits.items() if count > 0]
        of_limits = f"; missed were {', '.join(missed)}" if missed else ""
        found.append(
            f"no xi and A kept the constraints at {unsolved} updates (relaxed, held){of_limits}"
        )
    return found


def _told_apart(value: float, limit: float) -> tuple[str, str]:
    """Both numbers, in three digits or as many as tell them apart."""
    value = round(value, _DECIMALS)
    for digits in range(3, 17):
        texts = f"{value:.{digits}g}", f"{limit:.{digits}g}"
        if texts[0] != texts[1]:
            break
    return texts
