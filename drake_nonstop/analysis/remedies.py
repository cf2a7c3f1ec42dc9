"""What helps a scenario whose flights are not ok: changes of it, each of which is flown."""

import itertools
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from drake_nonstop.analysis.flights import CheckedFlight, fly, spread_margins
from drake_nonstop.blocks.wind_estimator import KnownWindConfig
from drake_nonstop.model.system import AIRCRAFT, given_fields
from drake_nonstop.run.outcome import RunOutcome
from drake_nonstop.scenario.overrides import as_override, changed
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.scenario.yaml_text import dump_plain
from drake_nonstop.validation import ScenarioError

_FACTORS = (1.2, 1.5, 2.5)  # of quantities that are changed, one after the other
_EASED = (0.98, 0.9, 0.7)  # of a bound that is missed, what is asked for instead
_MOST = 3  # remedies that are told
_LEAST_TIME = 3.0  # s of the processor, of trials; or as long as the flights took

_LOST = (RunOutcome.LOAD_LOST, RunOutcome.STOPPED)
_TOO_CLOSE = (RunOutcome.COLLISION, RunOutcome.CABLES_SLACK, RunOutcome.CABLE_BROKEN)
_TOO_SLOW = (RunOutcome.BOUND_MISSED,)
_BEYOND = (RunOutcome.LIMIT_MISSED, RunOutcome.STALLED)
_ALL = _LOST + _TOO_CLOSE + _TOO_SLOW + _BEYOND


class Remedy(NamedTuple):
    """Changes of a scenario with which all of its flights are ok."""

    overrides: tuple[str, ...]
    then: str  # the margins that were missed, as they are with it

    @property
    def text(self) -> str:
        """The overrides, as `--set` takes them."""
        return " and ".join(self.overrides)


@dataclass(frozen=True)
class _Failed:
    """A flight that is not ok."""

    flight: CheckedFlight
    stated: Scenario  # with distributions and errors
    scenario: Scenario  # that was flown, with the numbers that were drawn

    def value(self, *names: str) -> float | None:
        """The value of the first of these margins that is missed."""
        missed = (each for each in self.flight.margins if each.name in names and not each.is_kept)
        return next((each.value for each in missed), None)


_Proposals = Iterator[list[str]]  # from the mildest change on


def _modelled(failed: _Failed) -> _Proposals:
    """A model of the plant as it is; not of one that differs with the seed."""
    plant = failed.stated.simulated
    given = {n: attrgetter(n)(plant) for n in given_fields(plant) if n != AIRCRAFT[:-1]}
    if given and failed.scenario.simulated == plant:
        yield [as_override(f"system.{n}", v) for n, v in given.items() if v is not None]


def _known_wind(failed: _Failed) -> _Proposals:
    """A wind that the controllers know of; not in place of one that they measure."""
    scenario = failed.scenario
    is_measured = hasattr(scenario.wind_estimator, "airspeed_noise")
    if scenario.wind_estimator != KnownWindConfig() and not is_measured:
        yield ["wind_estimator=KnownWind"]


def _filtered(failed: _Failed) -> _Proposals:
    """A filter behind noisy measurements, which believes in their noise."""
    feedback = failed.scenario.load_feedback
    values = {name: value for name, value in vars(feedback).items() if value}
    noises = [name for name in values if name.endswith("_noise")]
    if not noises or hasattr(feedback, "process_acceleration"):
        return
    values |= {f"believed_{name}": values[name] for name in noises}
    for process in (0.05, 0.3):
        values |= {"process_acceleration": process, "process_angular_acceleration": process}
        shown = ", ".join(f"{name}: {dump_plain(v, name)}" for name, v in values.items())
        yield [f"load_feedback=!FilteredFeedback {{{shown}}}"]


def _lower_bound(failed: _Failed) -> _Proposals:
    """A bound below the least speed that was flown."""
    least, bound = failed.value("speed / bound"), failed.scenario.speed_bound
    for share in _EASED:
        if least is not None and least > 0.05 and bound > 0:
            yield [f"optimization_layer.speed_bound={_rounded(share * least * bound, -1):g}"]


def _eased_limits(failed: _Failed) -> _Proposals:
    """The limits that the layer was asked for, beyond the values that were flown."""
    history = failed.flight.history
    missed = [] if history is None else [each for each in history.limits if not each.margin.is_kept]
    for share in _EASED:
        if missed:
            yield [
                f"optimization_layer.{each.limit.field}="
                f"{_rounded(each.margin.value * share**each.limit.side, -each.limit.side):g}"
                for each in missed
            ]


def _of_layer(name: str, power: int) -> Callable[[_Failed], _Proposals]:
    """ξ or A of the layer, times the factors to the power; its bounds grow with it."""

    def proposals(failed: _Failed) -> _Proposals:
        layer: Any = failed.scenario.optimization_layer
        if not hasattr(layer, name):
            return
        for factor in _FACTORS:
            value = _rounded(getattr(layer, name) * factor**power, power)
            said = [f"optimization_layer.{name}={value:g}"]
            bounds = getattr(layer, f"{name}_bounds", [])
            if len(bounds) == 2 and not bounds[0] <= value <= bounds[1]:
                wider = [min(bounds[0], value), max(bounds[1], value)]
                said.append(as_override(f"optimization_layer.{name}_bounds", wider))
            yield said

    return proposals


def _longer_cables(failed: _Failed) -> _Proposals:
    length = np.asarray(failed.scenario.system.cable_length)
    for factor in _FACTORS:
        longer = np.vectorize(_rounded)(factor * length, 1).tolist()
        yield [as_override("system.cable_length", longer)]


def _slower_motion(failed: _Failed) -> _Proposals:
    scenario = failed.scenario
    trajectory: Any = scenario.load_trajectory
    for factor in _FACTORS:
        said = []
        for name in ("move_time", "move_times"):
            if hasattr(trajectory, name):
                times = factor * np.asarray(getattr(trajectory, name))
                said.append(as_override(f"load_trajectory.{name}", times.round(3).tolist()))
        if hasattr(trajectory, "velocity"):
            slower = (np.asarray(trajectory.velocity) / factor).round(4).tolist()
            said.append(as_override("load_trajectory.velocity", slower))
        if hasattr(trajectory, "samples"):
            rows = [[round(factor * row[0], 4), *row[1:]] for row in trajectory.resolved().samples]
            yield [
                as_override("load_trajectory.samples", rows),
                as_override("simulation_duration", factor * scenario.simulation_duration),
            ]
        elif said:
            longer = factor * scenario.simulation_duration
            yield [*said, as_override("simulation_duration", round(longer, 3))]


def _planned(failed: _Failed) -> _Proposals:
    """A layer that changes ξ and A."""
    layer: Any = failed.scenario.optimization_layer
    if not hasattr(layer, "frequency_bounds") and hasattr(layer, "frequency"):
        yield ["optimization_layer=RecedingHorizonOptimizer"]


def _lifted(failed: _Failed) -> _Proposals:
    """A path that is higher by more than what is missing of the clearance."""
    missing = failed.value("clearance")
    trajectory: Any = failed.scenario.load_trajectory
    if missing is None or not hasattr(trajectory, "start_position"):
        return
    missing = failed.scenario.limits.clearance - missing
    for factor in (1.05, 2.0, 5.0, 15.0):
        lift = _rounded(factor * missing, 1)
        said = []
        for name in ("start_position", "positions"):
            if places := getattr(trajectory, name, []):
                raised = np.asarray(places) + np.array([0.0, 0.0, lift])
                said.append(as_override(f"load_trajectory.{name}", raised.round(6).tolist()))
        yield said


def _tuned(failed: _Failed) -> _Proposals:
    """Carriers with gains that suit their mass and their samples."""
    if failed.scenario.system.aircraft is None:
        yield ["carrier_controller=TunedFeedforwardCarrierPid"]


# Which outcomes a change may help against, those that take the cause away first.
_FAMILIES: tuple[tuple[tuple[RunOutcome, ...], Callable[[_Failed], _Proposals]], ...] = (
    (_ALL, _modelled),
    (_ALL, _known_wind),
    (_ALL, _filtered),
    ((RunOutcome.COLLISION,), _lifted),
    (_TOO_SLOW, _lower_bound),
    (_BEYOND, _eased_limits),
    (_LOST + _TOO_CLOSE + _BEYOND, _of_layer("amplitude", -1)),
    (_LOST, _tuned),
    (_TOO_SLOW + _BEYOND, _planned),
    (_TOO_SLOW + _BEYOND, _of_layer("frequency", 1)),
    (_ALL, _slower_motion),
    (_TOO_SLOW, _longer_cables),
    (_TOO_SLOW, _of_layer("amplitude", 1)),
)


def find_remedies(
    flights: Sequence[CheckedFlight],
    scenarios: Sequence[Scenario],
    took: float,
    progress: Callable[[float], None] = lambda share: None,
) -> tuple[list[Remedy], int]:
    """The first changes with which all flights are ok, each flown, and how many were tried.

    A change is tried on the worst flight, up to a turn after the first limit that it missed, and
    what helps there on all flights. New ones are tried for as long as the flights took, and for
    three seconds at least; those are not flown that would take twice what is left.

    Args:
        flights: of the scenarios.
        scenarios: that were flown.
        took: s of the processor, all flights together.
        progress: called with the share of the time for trials that is over.
    """
    severity = list(RunOutcome).index
    worst = min(range(len(flights)), key=lambda k: severity(flights[k].outcome))
    failed = _Failed(flights[worst], scenarios[worst], scenarios[worst].sampled())
    families = [make(failed) for outcomes, make in _FAMILIES if failed.flight.outcome in outcomes]
    proposals = itertools.chain.from_iterable(itertools.zip_longest(*families))
    end, whole = _end_of_trials(failed), failed.scenario.simulation_duration
    each, budget = took / len(flights) * end / whole, max(_LEAST_TIME, took)
    start, tried = time.process_time(), 0
    found: list[Remedy] = []
    missed = [each.name for each in failed.flight.margins if not each.is_kept]
    waiting = iter([proposal for proposal in proposals if proposal])
    while len(found) < _MOST and (left := budget - (time.process_time() - start)) > 0:
        progress(1 - left / budget)
        count = min(8, max(1, int(left / max(each, 1e-3) / 2)))
        some = [*itertools.islice(waiting, count)]
        if not some:
            break
        tried += len(some)
        helped = [said for said, flown in _flown(failed.scenario, some, end) if flown.is_ok]
        for said in helped:
            if len(found) == _MOST or any(_same_fields(said, other.overrides) for other in found):
                continue
            if took / 2 > budget - (time.process_time() - start):
                break
            made = [_changed(scenario, said) for scenario in scenarios]
            all_flights = fly([("", each) for each in made if each is not None])
            if all(flight.is_ok for flight in all_flights):
                margins = [each.worst for each in spread_margins(all_flights)]
                then = ", ".join(each.sentence for each in margins if each.name in missed)
                found.append(Remedy(tuple(said), then))
    return found, tried


def _same_fields(one: Sequence[str], other: Sequence[str]) -> bool:
    return [each.partition("=")[0] for each in one] == [each.partition("=")[0] for each in other]


def _changed(scenario: Scenario, overrides: Sequence[str]) -> Scenario | None:
    try:
        return changed(scenario, overrides)
    except ScenarioError:
        return None


def _flown(
    scenario: Scenario, proposals: Sequence[list[str]], end: float
) -> list[tuple[list[str], CheckedFlight]]:
    """The proposals that can be built, each with its flight up to a time in s."""
    tried = []
    for said in proposals:
        made = _changed(scenario, said)
        if made is not None:
            factor = made.simulation_duration / scenario.simulation_duration
            tried.append((said, _shortened(made, factor * end)))
    if not tried:
        return []
    try:
        flights = fly([("", made) for _, made in tried])
    except ScenarioError:  # the first one cannot be built
        return _flown(scenario, [said for said, _ in tried[1:]], end)
    return [(said, flight) for (said, _), flight in zip(tried, flights, strict=True)]


def _shortened(scenario: Scenario, duration: float) -> Scenario:
    if duration >= scenario.simulation_duration:
        return scenario
    return changed(scenario, [f"simulation_duration={duration:.4g}"])


def _end_of_trials(failed: _Failed) -> float:
    """A turn after the first limit that the flight missed, s; its end where that is not known."""
    duration = failed.scenario.simulation_duration
    missed = [
        each.when for each in failed.flight.margins if not each.is_kept and math.isfinite(each.when)
    ]
    frequency = getattr(failed.scenario.optimization_layer, "frequency", 0.0)
    if not missed or not frequency:
        return duration
    return min(duration, min(missed) + 2 * math.pi / frequency)


def _rounded(value: float, side: int) -> float:
    """To three digits, towards a side."""
    digits = 2 - math.floor(math.log10(abs(value)))
    scaled = value * 10.0**digits
    return float(f"{(math.ceil if side > 0 else math.floor)(scaled) / 10.0**digits:.3g}")
