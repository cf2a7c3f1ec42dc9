"""The verdict on a scenario by its flights, and what explains it."""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from drake_nonstop.analysis.aircraft_margins import (
    AircraftMargins,
    aircraft_margins,
    margins_dictionary,
)
from drake_nonstop.analysis.feasible_parameters import (
    FeasibleParameters,
    feasible_parameters,
    has_set,
)
from drake_nonstop.analysis.flights import CheckedFlight, SpreadMargin, fly, spread_margins
from drake_nonstop.analysis.remedies import Remedy, find_remedies
from drake_nonstop.analysis.stability import Stability, explained_stability
from drake_nonstop.analysis.stated_errors import is_random, with_seed, without_errors
from drake_nonstop.analysis.task import Task, task_of
from drake_nonstop.run.outcome import RunOutcome
from drake_nonstop.scenario.schema import Scenario, check
from drake_nonstop.systems.tracing import NotFiniteError
from drake_nonstop.validation import ScenarioError, finite, require

SEEDS = 5  # in which a scenario with random numbers is flown
_MOST_SEEDS = 1000
_EXPLAINED_BY_GROWTH = (RunOutcome.STOPPED, RunOutcome.LOAD_LOST)

Progress = Callable[[str, float], None]


@dataclass(frozen=True, kw_only=True, eq=False)
class ScenarioCheck:
    """What becomes of a scenario's flights, and what explains it.

    Attributes:
        scenario: that is checked.
        flights: as the scenario states it, in each seed.
        nominal: the flight without the errors that it states; None: it states none.
        margins: over the flights, the worst of each.
        remedies: with which all flights are ok, where they are not.
        tried: the number of changes that were tried for that.
        task: what is flown; None: the trajectory does not tell its motion beforehand.
        feasible: constant ξ and A that keep the speed bound; None: there is no bound or no orbit.
        stability: of the load at rest, where it is lost, or rates of references are beyond those
            known to be stable; None: elsewhere, or it is not known.
        aircraft: the margins of aircraft on the resting orbit; None: there are none.
    """

    scenario: Scenario
    flights: tuple[CheckedFlight, ...]
    nominal: CheckedFlight | None
    margins: tuple[SpreadMargin, ...]
    remedies: tuple[Remedy, ...] = ()
    tried: int = 0
    task: Task | None = None
    feasible: FeasibleParameters | None = None
    stability: Stability | None = None
    aircraft: AircraftMargins | None = None

    @property
    def worst(self) -> CheckedFlight:
        """The flight with the worst outcome, the first of several."""
        severity = list(RunOutcome).index
        return min(self.flights, key=lambda flight: severity(flight.outcome))

    @property
    def outcome(self) -> RunOutcome:
        """The worst of all flights."""
        return self.worst.outcome

    @property
    def is_ok(self) -> bool:
        """Whether all flights are ok, and no field makes the loop unstable."""
        return not self._failed and not (self.stability is not None and self.stability.cause)

    @property
    def narrow(self) -> tuple[SpreadMargin, ...]:
        """The margins by which a flight of another seed may end otherwise."""
        if not self._failed:
            return tuple(each for each in self.margins if each.is_narrow)
        missed = [each for each in self.margins if not each.worst.is_kept]
        are_narrow = bool(missed) and all(each.is_narrow for each in missed)
        return tuple(missed) if are_narrow or self._failed < len(self.flights) else ()

    @property
    def _failed(self) -> int:
        return sum(not flight.is_ok for flight in self.flights)

    @property
    def verdicts(self) -> tuple[str, ...]:
        """A sentence on the outcome, and on each thing that explains it."""
        said = [self._of_flights()]
        if self.narrow:
            said.append(self._of_narrow())
        if self.nominal is not None and self._failed:
            said.append(
                "without the errors that the scenario states the flight is ok"
                if self.nominal.is_ok
                else "also without the errors that the scenario states: "
                f"{self.nominal.outcome.value}: {self.nominal.reasons[0]}"
            )
        if self.feasible is not None:
            said.append(self.feasible.text)
        if self.stability is not None:
            found = self.stability
            what = "decays" if found.is_stable else "grows: the loop is unstable"
            sentence = f"about the load at rest a small deviation {what}, {found.rate:+.2g} 1/s"
            said.append(found.cause or sentence)
        if self.aircraft is not None:
            said.append(self.aircraft.verdict)
        if self._failed:
            said.append(self._of_remedies())
        return tuple(said)

    def _of_flights(self) -> str:
        count = len(self.flights)
        if not self._failed:
            who = "the flight keeps" if count == 1 else f"all {count} flights keep"
            return f"ok: {who} all limits"
        share = "" if count == 1 else f" in {self._failed} of {count} flights"
        return f"{self.outcome.value}{share}: {'; '.join(self.worst.reasons)}"

    def _of_narrow(self) -> str:
        told = ", ".join(
            each.worst.sentence
            + ("" if math.isnan(each.deviation) else f", with a deviation of {each.deviation:.2g}")
            for each in self.narrow
        )
        others = "another seed" if len(self.flights) > 1 else "a slight change"
        return f"narrow: {told}: {others} may change the outcome"

    def _of_remedies(self) -> str:
        if not self.remedies:
            return f"none of {self.tried} changes that were flown helps"
        each = (f"{each.text} (then {each.then})" for each in self.remedies)
        return f"give {'; or '.join(each)}"

    @property
    def table(self) -> str:
        """A line for each flight, and for each margin, for a terminal."""
        named = [*self.flights, *([] if self.nominal is None else [self.nominal])]
        rows = [("flight", "outcome", "least margins")]
        for flight in named:
            least = sorted(
                (each for each in flight.margins if each.limit), key=lambda m: m.margin / m.limit
            )
            rows.append(
                (flight.name, flight.outcome.value, ", ".join(m.sentence for m in least[:2]))
            )
        margins = [("margin", "worst", "over the seeds", "limit", "left", "where")]
        for worst, most, _ in self.margins:
            spread = "" if len(self.flights) == 1 else f"to {worst.shown(most)}"
            sign = ">=" if worst.is_least else "<="
            left = worst.shown(worst.margin) + ("" if worst.is_kept else " !")
            limit = f"{sign} {worst.shown(worst.limit)}"
            margins.append((worst.name, worst.shown(worst.value), spread, limit, left, worst.place))
        return f"{_aligned(rows)}\n\n{_aligned(margins)}"

    @property
    def dictionary(self) -> dict[str, Any]:
        """All of it for a JSON file; keys end in their units."""
        found: dict[str, Any] = {} if self.aircraft is None else margins_dictionary(self.aircraft)
        named = [*self.flights, *([] if self.nominal is None else [self.nominal])]
        found |= {
            "scenario": self.scenario.name,
            "outcome": self.outcome.value,
            "is_ok": self.is_ok,
            "is_narrow": bool(self.narrow),
            "verdicts": list(self.verdicts),
            "flights": [
                {
                    "name": flight.name,
                    "outcome": flight.outcome.value,
                    "reasons": list(flight.reasons),
                    "margins": [margin.dictionary for margin in flight.margins],
                }
                for flight in named
            ],
            "margins_over_seeds": [
                each.worst.dictionary
                | {
                    "most": finite(each.most),
                    "deviation": finite(each.deviation),
                    "is_narrow": each.is_narrow,
                }
                for each in self.margins
            ],
            "remedies": [remedy._asdict() for remedy in self.remedies],
            "changes_tried": self.tried,
        }
        if self.feasible is not None:
            found["feasible_parameters"] = {
                "times_s": self.feasible.times.tolist(),
                "speed_over_bound": self.feasible.ratios.tolist(),
                "tight_times_s": self.feasible.tight_times.tolist(),
            }
        if self.stability is not None:
            found["stability"] = {
                "rate_1_s": self.stability.rate,
                "largest_multiplier": self.stability.largest,
                "is_stable": self.stability.is_stable,
            }
        return found


def _aligned(rows: Sequence[tuple[str, ...]]) -> str:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)


def check_scenario(
    scenario: Scenario,
    *,
    seeds: int = SEEDS,
    tries_remedies: bool = True,
    progress: Progress = lambda what, share: None,
) -> ScenarioCheck:
    """Flies a scenario as stated, and explains the outcome: `drake-nonstop check`.

    A scenario with random numbers is flown in several seeds, its own first, and one with errors
    also without them. All flights go side by side.

    Args:
        scenario: to be checked.
        seeds: in which a scenario with random numbers is flown.
        tries_remedies: whether to look for changes with which a flight that is not ok is ok.
        progress: called with a description of the task and the share of it that is done.

    Raises:
        ScenarioError: the scenario cannot be built, or no number of seeds is given.
        KeyboardInterrupt: Ctrl-C.
    """
    check(scenario)
    is_count = isinstance(seeds, int) and 1 <= seeds <= _MOST_SEEDS
    require(is_count, "seeds", seeds, f"give a whole number from 1 to {_MOST_SEEDS}")
    stated = flights_of(scenario, seeds)
    nominal = without_errors(scenario.sampled())
    others = [("without errors", nominal)] if nominal != scenario else []
    start = time.process_time()
    flown = fly([*stated, *others], lambda share: progress("flying", share))
    took = time.process_time() - start
    flights, of_nominal = flown[: len(stated)], flown[len(stated) :]
    scenarios = [each for _, each in stated]
    remedies: list[Remedy] = []
    tried = 0
    is_ok = all(flight.is_ok for flight in flights)
    if tries_remedies and not is_ok:
        remedies, tried = find_remedies(
            flights, scenarios, took, lambda share: progress("flying what may help", share)
        )
    progress("looking at the orbits", 0.0)
    task = _task(scenarios[0])
    is_lost = any(flight.outcome in _EXPLAINED_BY_GROWTH for flight in flights)
    found = ScenarioCheck(
        scenario=scenario,
        flights=tuple(flights),
        nominal=of_nominal[0] if of_nominal else None,
        margins=tuple(spread_margins(flights)),
        remedies=tuple(remedies),
        tried=tried,
        task=task,
        feasible=feasible_parameters(task) if task is not None and has_set(task) else None,
        stability=_stability(scenarios[0].sampled(), is_lost, progress),
        aircraft=None if scenario.system.aircraft is None else _aircraft(scenarios[0]),
    )
    progress("looking at the orbits", 1.0)
    return found


def flights_of(scenario: Scenario, seeds: int) -> list[tuple[str, Scenario]]:
    """The names and scenarios of the flights of a check: one where there are no random numbers."""
    if not is_random(scenario):
        return [("as stated", scenario)]
    return [("as stated" if k == 0 else f"seed +{k}", with_seed(scenario, k)) for k in range(seeds)]


def _task(scenario: Scenario) -> Task | None:
    try:
        return task_of(scenario)
    except ScenarioError:  # its trajectory does not tell its motion
        return None


def _stability(scenario: Scenario, is_lost: bool, progress: Progress) -> Stability | None:
    try:
        return explained_stability(scenario, is_lost, progress)
    except (ScenarioError, NotFiniteError):  # of what turns all the time, or is not compiled
        return None


def _aircraft(scenario: Scenario) -> AircraftMargins | None:
    try:
        return aircraft_margins(scenario)
    except ScenarioError:  # there is no such orbit
        return None
