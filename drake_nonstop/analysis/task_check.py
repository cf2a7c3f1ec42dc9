"""Whether a task can be flown: its speed bound, its formation, and what would help."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from pydrake.systems.framework import Diagram

from drake_nonstop.analysis.carriers_along import carriers_along
from drake_nonstop.analysis.flight_envelope import (
    BowedCables,
    FlightEnvelope,
    FlightMargin,
    FlightRanges,
    flight_envelope_of,
    limits_along,
)
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

# Times as long as the way asks for what is beyond the limits commands may be at them: afterwards
# feedback makes up for it.
_AFTERWARDS = 3.0
_SHARES = (0.2, 0.75, 0.95)  # of the time, when the plan is there, the growth along it, the motion


class FlightOfPlan(NamedTuple):
    """The aircraft's margins along a plan, each where it is least."""

    margins: tuple[FlightMargin, ...]  # phases are the plan's θ, from 0 to 2π
    times: tuple[float, ...]  # s, of each
    ranges: FlightRanges  # of what they need
    cables: BowedCables  # how drag bows them
    missed_share: float  # of the time, in which an aircraft needs more than its limits allow
    largest_share: float  # up to which that can be flown: `limits.saturated_share` of the run
    gust: float = 0.0  # m/s, standard deviation of the wind at a carrier, which is left out

    @property
    def is_flyable(self) -> bool:
        """Whether limits are missed no longer than commands may be at them, and without stall."""
        return self.missed_share <= self.largest_share and self.ranges.lift_share[1] < 1

    @property
    def is_in_doubt(self) -> bool:
        """Whether a flight alone tells if feedback makes up for what is missed, or for gusts."""
        is_short = _AFTERWARDS * self.missed_share <= self.largest_share
        return self.is_flyable and (not is_short or self.gust > 0)

    @property
    def verdict(self) -> str:
        """Whether the aircraft can fly the plan; what is missed, and what to change."""
        if self.missed_share == 0 and self.is_flyable:
            said = "the aircraft can fly the way within all limits"
            if self.gust == 0:
                return said
            return f"{said} in the mean wind; in gusts of {self.gust:g} m/s a flight alone tells"
        missed = ", ".join(
            f"{margin.sentence} at t = {time:.1f} s, carrier {margin.carriers[0]}"
            for margin, time in zip(self.margins, self.times, strict=True)
            if not margin.is_kept
        )
        if self.is_flyable:
            ends = (
                "whether feedback makes up for it, a flight alone tells"
                if self.is_in_doubt
                else "feedback makes up for so little"
            )
            return (
                f"the aircraft need more than their limits for {100 * self.missed_share:.2g} % of "
                f"the time: {missed}; {ends}"
            )
        return (
            f"system.aircraft: they cannot fly the way within their limits: {missed}; give a "
            "slower motion, a reference_governor, or, where they are not given yet, the layer's "
            "max_lift_share, max_bank, max_climb and max_thrust_share"
        )

    @property
    def dictionary(self) -> dict[str, Any]:
        """The same for a JSON file; angles are in rad."""
        return {
            "verdict": self.verdict,
            "is_flyable": self.is_flyable,
            "missed_share": self.missed_share,
            "margins": [
                margin.dictionary | {"time_s": time}
                for margin, time in zip(self.margins, self.times, strict=True)
            ],
            "ranges": self.ranges.dictionary | {"cables": self.cables.dictionary},
        }


def flight_of_plan(task: Task, speeds: SpeedCheck, limits: FlightEnvelope) -> FlightOfPlan | None:
    """The margins of a task's aircraft along its best plan, in the mean wind at their mean height.

    The aircraft follow the plan exactly, see `CarriersAlong`. None where there are no aircraft, or
    a layer without a speed bound changes ξ and A: there is no plan. Without one in `speeds` ξ and A
    are the nominal ones.
    """
    is_free = task.changes_parameters and speeds.plan is None
    aircraft = task.flown.aircraft
    if aircraft is None or is_free:
        return None
    times = speeds.plan_times
    planned = task.planned(speeds.plan, times)
    carriers = carriers_along(task, times)
    motion = carriers.motion(planned)
    bowed = carriers.bowed(planned, motion)
    needs = carriers.needs(motion, bowed)
    quantities = [*limits_along(aircraft, needs, limits, times)]
    angles = planned[:, 0] % (2 * math.pi)
    missed = [np.any(quantity.left.round(9) < 0, axis=1) for quantity in quantities]
    return FlightOfPlan(
        tuple(quantity.worst_margin(angles) for quantity in quantities),
        tuple(quantity.time for quantity in quantities),
        FlightRanges.of(aircraft, needs),
        BowedCables.of(task.flown, needs.airspeed, motion.forces, bowed),
        float(np.mean(np.any(missed, axis=0))),
        limits.saturated_share,
        task.air.gust,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class TaskCheck:
    """Results known of a task before it is flown, along its best plan; each remedy was tried."""

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
        """Parameters that the motion is judged with."""
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
                f"{said}; the layer aims at {found.target_ratio:.3f}, and whether carriers follow "
                "with less to spare, a flight alone tells"
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
        nearest = motion.approaches[:1]
        return (
            f"carriers stay {motion.carrier_separation:.3g} m apart, and cables "
            f"{motion.closest_cables_for_attachments[0]:.3g} m"
            + "".join(f", {a.body} from {a.obstacle} {a.distance:.3g} m" for a in nearest)
        )


def _of_remedies(remedies: Sequence[str]) -> str:
    return f"give {'; or '.join(remedies)}" if remedies else "nothing that was tried helps"


def _without(instant: FormationInstant) -> str:
    return "" if instant.controlled is None else f", and by {instant.free.rate:.2g} without control"


def check_task(
    scenario: Scenario,
    loop: Diagram | None = None,
    *,
    tries_remedies: bool = True,
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> TaskCheck:
    """Whether a scenario's task can be flown, and what would help where it cannot.

    Args:
        scenario: of the task.
        loop: that was built from it; None: one is, which starts at its equilibrium.
        tries_remedies: whether what would help is looked for, which takes most of the time.
        progress: called with a description and the share that is done, in which what would help
            does not count.

    Raises:
        ScenarioError: as of `task_of` and `make_nonstop`.
    """
    task = task_of(scenario, loop or make_nonstop(scenario))
    progress("looking for a plan", 0.0)
    speeds = check_speeds(task)
    plan = speeds.plan

    progress("linearizing on the way", _SHARES[0])
    formation = find_formation(task, plan)
    scenario = scenario.sampled()
    progress("following the plan", _SHARES[1])
    motion = PlannedMotion(scenario, task, plan)
    least = motion.least_load
    remedies: dict[str, Sequence[Any]] = {}
    progress("looking for what would help", _SHARES[2])
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
    """The results, a line each, for a terminal."""
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
        of_flight = [
            *found.flight.ranges.lines,
            (found.flight.cables.name, found.flight.cables.text),
        ]
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
