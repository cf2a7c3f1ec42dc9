"""Outcome of a run with the reasons, and its warnings.

`LIMITS` has a row for each limit of a scenario that a run is held against; those that a layer is
asked for are the rows of `planning.limits`.
"""

import math
from dataclasses import dataclass
from functools import partial

import numpy as np

from drake_nonstop.analysis.limit import DISTANCE_LIMITS, Limit, RunOutcome
from drake_nonstop.mechanics.aircraft import stall_speed
from drake_nonstop.model.system import breaking_load
from drake_nonstop.planning.limits import LIMITS as ASKED
from drake_nonstop.planning.measured_margin import LARGEST_SHARE
from drake_nonstop.run.run_quantities import RunQuantities

_ROUNDING = 1e-3  # of a limit that a block aims at, by which it may be missed


@dataclass(frozen=True, kw_only=True)
class Judgement:
    """The outcome of a run, and a sentence for each reason, of the worst outcome first."""

    outcome: RunOutcome
    reasons: tuple[str, ...] = ()


LIMITS = (
    Limit(
        path="limits.position_error",
        outcome=RunOutcome.LOAD_LOST,
        sentence="the load was {} from its reference",
        unit="m",
        measure=lambda run: float(np.max(run.position_error)),
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
        measure=lambda run: float(np.max(run.orientation_error)),
        default=0.8,
        aircraft_default=math.radians(15.0),
    ),
    *DISTANCE_LIMITS,
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
        measure=lambda run: float(np.max(run.speeds)),
    ),
    Limit(
        path="limits.acceleration",
        sentence="not plausible: a carrier was accelerated by {}",
        unit="m/s²",
        measure=lambda run: run.turns[0],
    ),
    Limit(
        path="limits.tension",
        sentence="not plausible: a cable's tension rose to {}",
        unit="N",
        measure=lambda run: float(np.max(run.tensions)),
        share_of=lambda run: run.system.load_mass * run.system.gravity,
        whole="the weight",
    ),
    # What blocks are asked for. They command it; what is simulated follows with an error.
    *(
        Limit(
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
    Limit(
        path="carrier_dynamics.max_acceleration",
        sentence="a carrier was asked for an acceleration of {}",
        unit="m/s²",
        measure=lambda run: run.largest_commanded_acceleration,
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
    if run.first_break is not None:
        loads = np.broadcast_to(breaking_load(run.system), len(run.system.attachments))
        bears = loads[run.first_break.cable - 1]
        broken = (
            f"cable {run.first_break.cable} broke at t = {run.first_break.time:.3f} s, with "
            f"{run.first_break.tension:.4g} N: it bears {bears:.4g} N "
            "(system.cable_breaking_load); what follows is that of a cable which holds"
        )
        wrong.append((RunOutcome.CABLE_BROKEN, broken))
    if run.largest_margin_share >= LARGEST_SHARE - _ROUNDING:
        grown = (
            f"the margin above the speed bound grew to its largest, {LARGEST_SHARE:.0%} of it: the "
            "carriers do not fly as planned; filter the feedback (load_feedback="
            "!EstimatedFeedback), correct the model, or give optimization_layer.tightening a number"
        )
        wrong.append((RunOutcome.LIMIT_MISSED, grown))
    wrong += [(RunOutcome.UNCONVERGED, sentence) for sentence in run.run.unresolved]
    severity = list(RunOutcome)
    wrong.sort(key=lambda item: severity.index(item[0]))
    worst = wrong[0][0] if wrong else RunOutcome.OK
    return Judgement(outcome=worst, reasons=tuple(sentence for _, sentence in wrong))


def _told(run: RunQuantities) -> str:
    """The sentence about the first stall."""
    stall, aircraft = run.first_stall, run.aircraft
    assert stall is not None
    ends = run.time[-1] < run.scenario.simulation_duration
    end = ", where the run ended" if ends and not run.run.stopped else ""
    return (
        f"carrier {stall.carrier} stalled at t = {stall.time:.3f} s{end}: C_L was "
        f"{stall.lift:.3g} of at most {aircraft.max_lift:.3g}, and the airspeed "
        f"{stall.airspeed:.3g} m/s, with a stall speed of {stall_speed(aircraft):.3g} m/s"
    )


def find_warnings(run: RunQuantities) -> list[str]:
    """Faults of a run that decide no outcome, a sentence each."""
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
