"""Outcome of a run with the reasons, and its margins.

`LIMITS` has a row for each limit of a scenario that a run is held against; those that a layer is
asked for are the rows of `planning.limits`.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from functools import partial
from operator import attrgetter
from typing import Any

import numpy as np

from drake_nonstop.mechanics.aircraft import stall_speed
from drake_nonstop.model.system import breaking_load
from drake_nonstop.planning.limits import LIMITS as ASKED
from drake_nonstop.planning.margins import Margin
from drake_nonstop.planning.measured_margin import LARGEST_SHARE
from drake_nonstop.run.run_quantities import RunQuantities
from drake_nonstop.validation import is_number

_ROUNDING = 1e-3  # of a limit that a block aims at, by which it may be missed
_TAUT = 1e-6  # N, the least tension of a cable that is not slack


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
class Judgement:
    """The outcome of a run, and a sentence for each reason, of the worst outcome first."""

    outcome: RunOutcome
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class RunLimit:
    """A limit of a scenario: what it bounds, and what is said of a run beyond it."""

    path: str  # in the scenario; one without such a field, or without a number there, has no limit
    outcome: RunOutcome  # of a run beyond it
    sentence: str  # with {} for the quantity, and `run` for the run's quantities
    measure: Callable[[RunQuantities], float | None]  # None: unknown
    unit: str = ""  # "": a share
    share_of: Callable[[RunQuantities], float] = lambda run: 1.0  # what the limit is a share of
    is_least: bool = False  # a lower limit
    tolerance: float = 0.0  # of the limit
    default: float | None = None  # as stated, where the scenario leaves it open
    aircraft_default: float | None = None  # of runs of aircraft, in `unit`

    def margin(self, run: RunQuantities) -> Margin | None:
        """The run's value beside the limit; None: there is no limit, or the value is unknown."""
        limit = self._limit_of(run)
        value = None if limit is None else self.measure(run)
        if limit is None or value is None:
            return None
        name = self.path.rpartition(".")[2].replace("_", " ")
        return Margin(name, value, limit, self.unit, self.is_least)

    def complaint(self, run: RunQuantities) -> str | None:
        """The sentence about a run beyond the limit; None for a run within it."""
        margin = self.margin(run)
        if margin is None or not math.isfinite(margin.limit):
            return None
        if margin.margin >= -self.tolerance * abs(margin.limit):
            return None
        shown = margin.shown(round(margin.value, 9))  # zero but for rounding is zero
        return f"{self.sentence.format(shown, run=run)} ({self.path}: {margin.shown(margin.limit)})"

    def _limit_of(self, run: RunQuantities) -> float | None:
        """The limit in `unit`; None: there is none."""
        stated: Any = run.scenario
        for name in self.path.split("."):
            stated = getattr(stated, name, None)
        if stated is None and self.aircraft_default is not None and run.has_aircraft:
            return self.aircraft_default
        if stated is None:
            stated = self.default
        return stated * self.share_of(run) if is_number(stated) or stated == math.inf else None


def _turn_limit(name: str, turned: str) -> RunLimit:
    """The limit of the load's tilt or yaw beside its reference."""
    of = attrgetter(f"{name}_error")
    return RunLimit(
        path=f"limits.{name}_error",
        outcome=RunOutcome.LOAD_LOST,
        sentence=f"the load was {turned} by {{}} from its reference",
        unit="rad",
        measure=lambda run: float(np.max(of(run))),
        default=0.8,
        aircraft_default=math.radians(15.0),
    )


LIMITS = (
    RunLimit(
        path="limits.position_error",
        outcome=RunOutcome.LOAD_LOST,
        sentence="the load was {} from its reference{run.untold_wind}",
        unit="m",
        measure=lambda run: float(np.max(run.position_error)),
        share_of=lambda run: run.reach,
        default=0.2,
        aircraft_default=1.0,
    ),
    _turn_limit("tilt", "tilted"),
    _turn_limit("yaw", "turned"),
    RunLimit(
        path="limits.carrier_distance",
        outcome=RunOutcome.COLLISION,
        sentence="two carriers came within {} of each other",
        unit="m",
        measure=lambda run: run.carrier_separation,
        share_of=lambda run: run.reach,
        is_least=True,
    ),
    RunLimit(
        path="limits.cable_distance",
        outcome=RunOutcome.COLLISION,
        sentence="two cables came within {} of the distance of their attachments",
        measure=lambda run: run.cable_separation_share,
        is_least=True,
    ),
    RunLimit(
        path="limits.clearance",
        outcome=RunOutcome.COLLISION,
        sentence="{run.approaches[0].sentence}",
        unit="m",
        measure=lambda run: run.obstacle_distance(),
        is_least=True,
    ),
    RunLimit(
        path="limits.slack_time",
        outcome=RunOutcome.CABLES_SLACK,
        sentence="a cable was slack for {}{run.misfit}",
        unit="s",
        measure=lambda run: run.slack_time,
    ),
    RunLimit(
        path="limits.time_below_bound",
        outcome=RunOutcome.BOUND_MISSED,
        sentence="a carrier was below the bound for {}",
        unit="s",
        measure=lambda run: run.time_below_bound,
    ),
    RunLimit(
        path="limits.saturated_share",
        outcome=RunOutcome.LIMIT_MISSED,
        sentence="commands of aircraft were at their limits for {} of the time{run.most_saturated}",
        measure=lambda run: run.saturated_share,
    ),
    # What blocks are asked for. They command it; what is simulated follows with an error.
    *(
        RunLimit(
            path=f"optimization_layer.{asked.field}",
            outcome=RunOutcome.LIMIT_MISSED,
            sentence=asked.sentence,
            unit=asked.unit,
            measure=partial(RunQuantities.extreme_of, limit=asked),
            is_least=asked.is_least,
            tolerance=_ROUNDING,
        )
        for asked in ASKED
    ),
)


def judge(run: RunQuantities) -> Judgement:
    """The outcome of a run, the worst of all that is wrong with it, and all reasons."""
    if not len(run.time):
        return Judgement(outcome=RunOutcome.STOPPED, reasons=(run.run.stopped,))
    wrong = [
        (limit.outcome, sentence)
        for limit in LIMITS
        if (sentence := limit.complaint(run)) is not None
    ]
    if run.run.stopped:
        wrong.append((RunOutcome.STOPPED, run.run.stopped))
    if (stall := run.first_stall) is not None:
        sentence = (
            f"carrier {stall.number} stalled at t = {stall.time:.3f} s: C_L was {stall.value:.3g} "
            f"of at most {run.aircraft.max_lift:.3g}, with a stall speed of "
            f"{stall_speed(run.aircraft):.3g} m/s"
        )
        wrong.append((RunOutcome.STALLED, sentence))
    if (broken := run.first_break) is not None:
        loads = np.broadcast_to(breaking_load(run.system), len(run.system.attachments))
        sentence = (
            f"cable {broken.number} broke at t = {broken.time:.3f} s, with {broken.value:.4g} N: "
            f"it bears {loads[broken.number - 1]:.4g} N (system.cable_breaking_load); what follows "
            "is that of a cable which holds"
        )
        wrong.append((RunOutcome.CABLE_BROKEN, sentence))
    if run.largest_margin_share >= LARGEST_SHARE - _ROUNDING:
        sentence = (
            f"the margin above the speed bound grew to its largest, {LARGEST_SHARE:.0%} of it: the "
            "carriers do not fly as planned; filter the feedback (load_feedback="
            "!FilteredFeedback), correct the model, or give optimization_layer.tightening a number"
        )
        wrong.append((RunOutcome.LIMIT_MISSED, sentence))
    wrong += [(RunOutcome.UNCONVERGED, sentence) for sentence in run.run.unresolved]
    severity = list(RunOutcome)
    wrong.sort(key=lambda item: severity.index(item[0]))
    worst = wrong[0][0] if wrong else RunOutcome.OK
    return Judgement(outcome=worst, reasons=tuple(sentence for _, sentence in wrong))


def find_margins(run: RunQuantities) -> list[Margin]:
    """The run's margins to all that decides its outcome."""
    margins = [
        margin
        for limit in LIMITS
        if (margin := limit.margin(run)) is not None
        and math.isfinite(margin.limit)
        and (margin.limit > 0 or limit.path == "limits.clearance")
    ]
    for k, margin in enumerate(margins):
        if margin.name in ("position error", "tilt error", "yaw error"):
            errors = getattr(run, margin.name.replace(" ", "_"))
            margins[k] = margin._replace(when=float(run.run.time[np.argmax(errors)]))
    time = run.time
    if np.any(run.speed_bounds > 0) and run.scenario.limits.time_below_bound == 0:
        speeds, bounds = run.bounded_speeds, run.speed_bounds[:, None]
        shares = np.divide(speeds, bounds, out=np.full(speeds.shape, np.inf), where=bounds > 0)
        margins.append(Margin.along("speed / bound", shares, 1.0, time, is_least=True))
    of_cables: dict[str, Any] = {"of": "cable", "unit": "N"}
    if run.scenario.limits.slack_time == 0:
        margins.append(
            Margin.along("tension", run.tensions, _TAUT, time, is_least=True, **of_cables)
        )
    breaks = np.broadcast_to(breaking_load(run.system), run.tensions.shape[1])
    if np.any(np.isfinite(breaks)):
        margins.append(Margin.along("breaking load", run.tensions, breaks, time, **of_cables))
    if run.has_aircraft:
        lift = run.aircraft_state.lift / run.aircraft.max_lift
        margins.append(Margin.along("C_L / C_Lmax", lift, 1.0, time))
    return margins
