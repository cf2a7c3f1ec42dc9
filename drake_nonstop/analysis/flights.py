"""Flights of a scenario that is checked: what became of each, and its margins."""

import math
import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.signals import Parameters, PlannedParameters
from drake_nonstop.planning.margins import LimitAlong, Margin
from drake_nonstop.run.many import simulate_many
from drake_nonstop.run.outcome import RunOutcome, find_margins, judge
from drake_nonstop.run.run import Run
from drake_nonstop.run.run_quantities import RunQuantities
from drake_nonstop.run.simulate import simulate
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.systems.block import release
from drake_nonstop.validation import ScenarioWarning

_SHARE = 0.01  # of a limit, a margin that is narrow without a spread
_DEVIATIONS = 3.0  # standard deviations of a margin over seeds, within which it is narrow


class History(NamedTuple):
    """The motion of a flight over time, for figures; k steps, l samples."""

    step_times: NDArray  # (k,), s
    speeds: NDArray  # (k, n), m/s, that the bound holds for
    speed_bounds: NDArray  # (k,), m/s
    times: NDArray  # (l,), s
    parameters: NDArray  # (l, 2), [ξ (rad/s), A (N)]; NaN where no block makes them
    position_error: NDArray  # (l,), m
    limits: tuple[LimitAlong, ...]  # that the layer is asked for


class CheckedFlight(NamedTuple):
    """A flight of a scenario; of one that stopped at once there are no margins and no history."""

    name: str
    scenario: Scenario
    outcome: RunOutcome
    reasons: tuple[str, ...] = ()
    margins: tuple[Margin, ...] = ()
    history: History | None = None

    @property
    def is_ok(self) -> bool:
        """Whether nothing is wrong with it."""
        return self.outcome is RunOutcome.OK


class SpreadMargin(NamedTuple):
    """A margin over flights of several seeds."""

    worst: Margin
    most: float  # the value that is farthest on the safe side of the limit
    deviation: float  # standard deviation of the values; NaN: of one flight

    @property
    def is_narrow(self) -> bool:
        """Whether a flight of another seed, or a slight change, may end on the other side."""
        margin = abs(self.worst.margin)
        if math.isnan(self.deviation):
            return margin < _SHARE * abs(self.worst.limit)
        return margin < _DEVIATIONS * self.deviation


def spread_margins(flights: Sequence[CheckedFlight]) -> list[SpreadMargin]:
    """The margins that all flights have, the worst of each."""
    found = []
    together = zip(*(flight.margins for flight in flights if flight.margins), strict=False)
    for same in together:
        values = [each.value for each in same]
        side = max if same[0].is_least else min
        deviation = float(np.std(values, ddof=1)) if len(same) > 1 else math.nan
        worst = min(same, key=lambda each: each.margin)
        found.append(SpreadMargin(worst, side(values), deviation))
    return found


def fly(
    scenarios: Sequence[tuple[str, Scenario]],
    progress: Callable[[float], None] = lambda share: None,
) -> list[CheckedFlight]:
    """The flights of scenarios with their names, side by side.

    Raises:
        ScenarioError: the first one cannot be built.
        KeyboardInterrupt: Ctrl-C.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ScenarioWarning)
        if len(scenarios) == 1:
            runs: list[Any] = [_flown(scenarios[0][1], progress)]
        else:
            runs = simulate_many([scenario for _, scenario in scenarios], progress=progress)
    found = []
    for (name, scenario), run in zip(scenarios, runs, strict=True):
        run = getattr(run, "run", run)  # of one that stopped
        if not isinstance(run, BaseException):
            found.append(_checked(name, run))
            release(run.diagram)
        elif not found or not isinstance(run, Exception):
            raise run
        else:
            found.append(CheckedFlight(name, scenario, RunOutcome.STOPPED, (str(run),)))
    return found


def _flown(scenario: Scenario, progress: Callable[[float], None]) -> Run | Exception:
    """The flight of one scenario, which tells its progress on the way."""
    duration = scenario.simulation_duration
    try:
        return simulate(scenario, progress=lambda time: progress(min(1.0, time / duration)))
    except Exception as error:  # whatever the user's own blocks may raise
        return error


def _checked(name: str, run: Run) -> CheckedFlight:
    quantities = RunQuantities(run)
    judged = judge(quantities)
    if len(run.time) == 0:
        return CheckedFlight(name, run.scenario, judged.outcome, judged.reasons)
    return CheckedFlight(
        name,
        run.scenario,
        judged.outcome,
        judged.reasons,
        tuple(find_margins(quantities)),
        History(
            run.steps["time"],
            quantities.bounded_speeds,
            quantities.speed_bounds,
            run.time,
            _parameters(run),
            quantities.position_error,
            tuple(quantities.limits),
        ),
    )


def _parameters(run: Run) -> NDArray:
    names = {name.partition(".")[2] for name in run.signals}
    if "planned" in names:
        return np.hstack(PlannedParameters.view(run.signal("planned"))[1:3])
    if "parameters" in names:
        return np.hstack(Parameters.view(run.signal("parameters")))
    return np.full((len(run.time), 2), math.nan)
