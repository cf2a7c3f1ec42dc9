"""Whether a task can be flown: its speed bound, its formation, and what would help."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.systems.framework import Diagram

from drake_nonstop.analysis.flight_envelope import flight_envelope_of
from drake_nonstop.analysis.flight_of_plan import FlightOfPlan, flight_of_plan
from drake_nonstop.analysis.formation import (
    Formation,
    FormationInstant,
    find_formation,
    find_formation_remedies,
)
from drake_nonstop.analysis.planned_motion import PlannedMotion, find_motion_remedies
from drake_nonstop.analysis.speed_check import (
    SpeedCheck,
    SpeedRemedy,
    check_speeds,
    find_limit_remedies,
    find_speed_remedies,
)
from drake_nonstop.analysis.task import Task, task_of
from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.validation import finite


@dataclass(frozen=True, kw_only=True, eq=False)
class TaskCheck:
    """What is known of a task before it is flown, along its best plan; each remedy was tried."""

    task: Task
    speeds: SpeedCheck
    formation: Formation
    motion: PlannedMotion
    speed_remedies: tuple[SpeedRemedy, ...] = ()  # of a task that is infeasible
    limit_remedies: tuple[SpeedRemedy, ...] = ()  # of limits that are missed, not the bound
    formation_remedies: tuple[str, ...] = ()  # of an unstable one, or of cables that do not pull
    motion_remedies: tuple[str, ...] = ()  # of carriers or cables that meet
    flight: FlightOfPlan | None = None  # of aircraft; None: there are none, or it is not known

    @property
    def is_sound(self) -> bool:
        """Whether bound and limits are kept, the formation stable, none meet, and aircraft fly."""
        return self._may_be_flown and not self.speeds.missed and self.is_stable

    @property
    def is_in_doubt(self) -> bool:
        """Whether a flight alone tells: nothing is missed or unstable by more than a little."""
        formation, missed, least = self.formation, self.speeds.missed, self.motion.least_load
        is_near = (
            self._may_be_flown
            and (formation.is_stable or formation.is_in_doubt)
            and (least.pulls_up or least.is_in_doubt)
            and all(limit.is_in_doubt for limit in missed)
        )
        of_flight = self.flight is not None and self.flight.is_in_doubt
        is_amiss = bool(missed) or not self.is_stable
        return is_near and (is_amiss or self.speeds.is_in_doubt or of_flight)

    @property
    def _may_be_flown(self) -> bool:
        """But for limits, growth and cables that do not pull."""
        is_flyable = self.flight is None or self.flight.is_flyable
        return self.speeds.is_feasible and not self.motion.collisions and is_flyable

    @property
    def is_stable(self) -> bool:
        """Whether the formation is stable, and all of its cables pull all the way."""
        return self.formation.is_stable and self.motion.least_load.pulls_up

    @property
    def verdicts(self) -> tuple[str, ...]:
        """A sentence on the speed bound, formation, distances, and, if any, aircraft and limits."""
        of_flight = [] if self.flight is None else [self.flight.verdict]
        of_limits = [self._of_limits()] if self.speeds.limits else []
        first = self._of_speeds(), self._of_formation(), self._of_motion()
        return *first, *of_flight, *of_limits

    def _of_limits(self) -> str:
        missed = self.speeds.missed
        if not missed:
            return "all limits that the layer is asked for can be kept"
        said = "; ".join(
            f"optimization_layer.{each.limit.field} = {each.stated:g}: it cannot be kept: with "
            f"{self._parameters} {each.limit.sentence.format(each.shown(each.worst))}, at "
            f"{each.where}"
            for each in missed
        )
        if all(each.is_in_doubt for each in missed):
            said += "; the layer may find a better one, which a flight alone tells"
        return f"{said}; {_of_remedies([remedy.text for remedy in self.limit_remedies])}"

    @property
    def _parameters(self) -> str:
        """What the way is judged with."""
        if self.task.turn is not None:
            return "the values of xi that the layer is predicted to ask for"
        if self.speeds.plan is not None:
            return f"the best plan of xi and A from {len(self.speeds.starts)} starts"
        return "the constant xi and A"

    def _of_speeds(self) -> str:
        found = self.speeds
        if found.speed_bound == 0:
            return "there is no speed bound"
        time, carrier = found.least_at
        where = f"at t = {time:.2f} s, carrier {carrier}"
        if found.is_feasible:
            said = f"the speed bound can be kept: at least {found.least:.3f} of it, {where}"
            if not found.is_in_doubt:
                return said
            return (
                f"{said}; the layer aims at {found.aim:.3f}, and whether carriers follow with less "
                "to spare, a flight alone tells"
            )
        tried = (
            f"no plan of xi and A from {len(found.starts)} starts keeps the bound"
            if self.task.changes_parameters
            else f"{self._parameters} do not keep the bound"
        )
        remedy = "; ".join(
            f"{remedy.text} (then {remedy.least:.3f})" for remedy in self.speed_remedies
        )
        return (
            f"optimization_layer.speed_bound = {found.speed_bound:g}: {tried}: at most "
            f"{found.least:.3f} of it is reached, {where}; "
            f"{'give ' + remedy if remedy else 'nothing that was tried helps'}"
        )

    def _of_formation(self) -> str:
        worst, least = self.formation.worst, self.motion.least_load
        helps = _of_remedies(self.formation_remedies)
        if not least.pulls_up:
            end = ", by so little that a flight alone tells" if least.is_in_doubt else ""
            return f"formation = slack: {least.text}: it would have to push{end}; {helps}"
        if self.formation.is_stable:
            growth = math.exp(self.formation.growth)
            change = "does not grow" if growth <= 1 else f"grows {growth:.3g} times at most"
            if math.isnan(self.formation.sampled.growth):
                return (
                    f"a small deviation of the load {change} on the way, with carriers that are "
                    "where they should be and controllers that are continuous; a block that is "
                    "not the package's may make the loop unstable, see `drake-nonstop stability`"
                )
            return f"the formation is stable: a small deviation {change} on the way"
        grows = f"at t = {worst.time:.1f} s a small deviation grows by {worst.rate:.2g} 1/s"
        grows += _without(worst)
        if self.formation.is_lost_in_samples:
            how = self.formation.sampled.sentence
            grows = f"in the samples of the controllers a small deviation grows {how}"
        end = ""
        if self.formation.is_in_doubt:
            end = ", not enough by the end for a load that is surely lost: a flight alone tells"
        return f"formation = unstable: {grows}{end}; {helps}"

    def _of_motion(self) -> str:
        motion = self.motion
        if motion.collisions:
            met = "; ".join(motion.collisions)
            return f"planned motion = too close: {met}; {_of_remedies(self.motion_remedies)}"
        return (
            f"carriers stay {motion.carrier_separation:.3g} m apart, and cables "
            f"{motion.closest_cables_for_attachments[0]:.3g} m"
        )


def _of_remedies(remedies: Sequence[str]) -> str:
    return f"give {'; or '.join(remedies)}" if remedies else "nothing that was tried helps"


def _without(instant: FormationInstant) -> str:
    return "" if instant.controlled is None else f", and by {instant.free.rate:.2g} without control"


def check_task(
    scenario: Scenario, loop: Diagram | None = None, *, tries_remedies: bool = True
) -> TaskCheck:
    """Whether a scenario's task can be flown, and what would help where it cannot.

    Args:
        scenario: of the task.
        loop: that was built from it; None: one is, which starts at its equilibrium.
        tries_remedies: whether what would help is looked for, which takes most of the time.

    Raises:
        ScenarioError: as of `task_of` and `make_nonstop`.
    """
    task = task_of(scenario, loop or make_nonstop(scenario))
    speeds = check_speeds(task)
    plan = speeds.plan

    formation = find_formation(task, plan)
    scenario = scenario.sampled()
    motion = PlannedMotion(scenario, task, plan)
    least = motion.least_load
    remedies: dict[str, Sequence[Any]] = {}
    if tries_remedies and not speeds.is_feasible:
        remedies["speed_remedies"] = find_speed_remedies(task, speeds)
    elif tries_remedies and speeds.missed:
        remedies["limit_remedies"] = find_limit_remedies(task, speeds)
    if tries_remedies and not (formation.is_stable and least.pulls_up):
        worst = math.nan if least.pulls_up else least.time
        remedies["formation_remedies"] = find_formation_remedies(task, formation, plan, worst=worst)
    if tries_remedies and motion.collisions:
        remedies["motion_remedies"] = find_motion_remedies(scenario, task)
    return TaskCheck(
        task=task,
        speeds=speeds,
        formation=formation,
        motion=motion,
        flight=flight_of_plan(task, speeds, flight_envelope_of(scenario)),
        **{name: tuple(found) for name, found in remedies.items()},
    )


def task_table(found: TaskCheck) -> str:
    """What was found, a line each, for a terminal."""
    speeds, formation = found.speeds, found.formation
    rows = [("quantity", "value", "where")]
    if speeds.speed_bound > 0:
        time, carrier = speeds.least_at
        what = "best plan" if speeds.plan is not None else "constant xi and A"
        if found.task.turn is not None:
            what = "xi of the layer"
        rows.append(
            (
                f"least v / bound, {what}",
                f"{speeds.least:.3f}",
                f"t = {time:.2f} s, carrier {carrier}",
            )
        )
        rows.append(("instants at which no constant xi and A do", _share_of(speeds), ""))
        low, high = speeds.parameters.min(axis=0), speeds.parameters.max(axis=0)
        rows.append(("xi", f"{low[0]:.3g} to {high[0]:.3g} rad/s", ""))
        rows.append(("A", f"{low[1]:.3g} to {high[1]:.3g} N", ""))
    rows += found.motion.rows
    for each in speeds.limits:
        bound = f"{each.limit.field} {each.stated:g}"
        rows.append((f"{each.limit.words} ({bound})", each.shown(each.worst), each.where))
    loads = [(instant, instant.loads) for instant in formation.instants]
    instant, least = min(loads, key=lambda pair: pair[1].shares.min())
    cable = int(np.argmin(least.shares)) + 1
    rows.append(
        (
            "least share of the weight / equal share",
            f"{least.shares.min():.2f}",
            _at(instant, cable),
        )
    )
    instant, least = min(loads, key=lambda pair: pair[1].elevations.min())
    cable = int(np.argmin(least.elevations)) + 1
    elevation = math.degrees(least.elevations.min())
    rows.append(("least elevation of a cable", f"{elevation:.1f} deg", _at(instant, cable)))
    for name, instant in (("at rest", formation.at_rest), ("largest", formation.worst)):
        rates = [f"{instant.free.rate:+.3g} 1/s without control"]
        if instant.controlled is not None:
            rates.insert(0, f"{instant.controlled.rate:+.3g} 1/s")
        if name == "at rest" and math.isfinite(formation.sampled_rate):
            rates.append(f"{formation.sampled_rate:+.3g} 1/s in samples")
        rows.append((f"growth of a deviation, {name}", ", ".join(rates), _at(instant)))
    if math.isfinite(formation.sampled.growth):
        rows.append(("growth of a deviation, in samples", formation.sampled.sentence, ""))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
    if found.flight is not None:
        of_flight = found.flight.ranges.lines
        lines += [f"{name + ', on the way':{widths[0]}}  {text}" for name, text in of_flight]
    return "\n".join(lines)


def _share_of(speeds: SpeedCheck) -> str:
    tight = speeds.tight_times
    if len(tight) == 0:
        return "none"
    return f"{len(tight)} of {len(speeds.times)}, {tight[0]:.1f} to {tight[-1]:.1f} s"


def _at(instant: FormationInstant, cable: int | None = None) -> str:
    said = f"t = {instant.time:.2f} s"
    return said if cable is None else f"{said}, cable {cable}"


def task_dictionary(found: TaskCheck) -> dict[str, Any]:
    """The same for a JSON file; keys end in their units."""
    speeds, formation = found.speeds, found.formation
    of_speeds, of_formation, of_motion, *others = found.verdicts
    has_bound = speeds.speed_bound > 0
    of_flight = {} if found.flight is None else {"flight": found.flight.dictionary}
    of_limits: dict[str, Any] = {}
    if speeds.limits:
        of_limits["limits"] = {
            "verdict": others[-1],
            "are_kept": not speeds.missed,
            "remedies": [remedy._asdict() for remedy in found.limit_remedies],
            "along_the_plan": [each.dictionary for each in speeds.limits],
        }
    return (
        of_flight
        | of_limits
        | {
            "distances": found.motion.dictionary
            | {"verdict": of_motion, "remedies": [*found.motion_remedies]},
            "speed_bound": {
                "verdict": of_speeds,
                "is_feasible": speeds.is_feasible,
                "speed_bound_m_s": speeds.speed_bound,
                "least_ratio": speeds.least if has_bound else None,
                "least_at_s": speeds.least_at[0] if has_bound else None,
                "least_carrier": speeds.least_at[1] if has_bound else None,
                "ratios_of_starts": [*speeds.starts] if has_bound else [],
                "tight_times_s": speeds.tight_times.tolist(),
                "remedies": [remedy._asdict() for remedy in found.speed_remedies],
            },
            "formation": {
                "verdict": of_formation,
                "is_stable": found.is_stable,
                "growth": formation.growth,
                "growth_in_samples": finite(formation.sampled.growth),
                "growth_in_samples_from_s": finite(formation.sampled.start),
                "growth_in_samples_until_s": finite(formation.sampled.end),
                "rate_in_samples_at_rest_1_s": finite(formation.sampled_rate),
                "remedies": [*found.formation_remedies],
                "instants": [
                    {
                        "time_s": instant.time,
                        "frequency_rad_s": float(instant.parameters[0]),
                        "amplitude_N": float(instant.parameters[1]),
                        "rate_1_s": instant.controlled and instant.controlled.rate,
                        "rate_without_control_1_s": instant.free.rate,
                        "largest_multiplier": float(
                            abs((instant.controlled or instant.free).multipliers[0])
                        ),
                        "least_shares": instant.loads.shares.tolist(),
                        "mean_shares": instant.loads.mean_shares.tolist(),
                        "least_elevations_rad": instant.loads.elevations.tolist(),
                    }
                    for instant in formation.instants
                ],
            },
        }
    )
