"""Whether a run's steps resolve its results."""

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import SimulatorConfig
from pydrake.systems.framework import Context

from drake_nonstop.loop.step import with_step
from drake_nonstop.mechanics.signals import SIGNAL_PERIOD, CarrierStates
from drake_nonstop.run.compiled_run import CompiledState
from drake_nonstop.run.metrics import compute_metrics
from drake_nonstop.run.moved_metrics import moved_metrics
from drake_nonstop.run.run import Run
from drake_nonstop.run.short_flights import (
    COMPARED,
    FlightSamples,
    RestorableState,
    ShortFlights,
    difference,
    finer,
    tolerated_speeds,
    tolerated_tensions,
)

_MARGIN = 0.85  # of what a metric may move by, in a run that counts as resolved
_FLIGHT = 0.03  # s, or longer: two samples of the controllers
_FAR = 0.25  # a `difference` of a short flight that is in doubt
_ORDER = 3  # of the schemes whose errors fourth differences tell
_ORDERS = {"runge_kutta3": 3, "bogacki_shampine3": 3, "radau3": 3, "runge_kutta5": 3}
_ROUGH = 0.26  # a `difference` in 10 ms that is in doubt
_JUMP = 2.5  # the same, had the steps 10 ms: of a jump, to which the layer may respond otherwise


def is_in_doubt(run: Run, states: list[RestorableState], context: Context) -> bool:
    """Whether something in a run tells that half its step may change the metrics.

    That is a scheme of first or second order, whose errors add up; a slack cable, since an instant
    at which a force ends is resolved by no step; fourth differences of velocities or tensions,
    the measure of a third-order scheme's error, that are large; or the hardest parts of the run,
    flown again with half the step, that differ from it. Where a block has state outside of the
    context no parts are flown again.

    Args:
        run: what is judged.
        states: of the run, saved on its way.
        context: of the run's diagram, with its parameters.
    """
    if len(run.time) <= _ORDER + 2 or not _has_all_signals(run):
        return False
    if _order(run.scenario.simulator_config) < _ORDER or np.min(run.steps["tensions"]) <= 0:
        return True
    flown = FlightSamples.of(run.time, {name: run.signal(name) for name in COMPARED})
    roughness = _roughness(run, flown)
    accumulated = (run.step / SIGNAL_PERIOD) ** _ORDER * np.max(roughness)
    if np.max(roughness) > _JUMP or accumulated > _ROUGH:
        return True
    if any(getattr(block, "has_state_outside", False) for block in run.diagram.GetSystems()):
        return False  # nothing can be flown again from a state on the way
    config = with_step(run.scenario.simulator_config, run.step)
    period = run.scenario.control_period
    flights = None
    time = max(_FLIGHT, 2 * period)
    hardest = (
        np.argmin(np.min(flown.tensions, axis=1)),
        np.argmax(roughness),
    )
    for i in sorted({_before(float(run.time[instant]), states) for instant in hardest}):
        state = states[i]
        if state.time + time > run.time[-1] - SIGNAL_PERIOD:
            continue
        try:
            if isinstance(state, CompiledState):
                half = state.fly(time, finer(config, 2))
            else:
                flights = flights or ShortFlights(run.diagram, context, config)
                half = flights.fly(state, time, 2)
        except Exception:  # whatever blocks may raise, which they did not in the run
            return True
        if difference(flown.at(np.round(half.time / SIGNAL_PERIOD).astype(int)), half) > _FAR:
            return True
    return False


def _has_all_signals(run: Run) -> bool:
    return {name.partition(".")[2] for name in run.signals} >= {*COMPARED}


def _roughness(run: Run, flown: FlightSamples) -> NDArray:
    """The error (samples - 4,) of steps of 10 ms by fourth differences, as `difference` counts it.

    A step h of a third-order scheme is wrong by about h⁴ v⁗ / 24, and 10 ms of steps by h³ / 10 ms
    of that of one such step.
    """
    velocities = CarrierStates.view(run.signal("carrier_state")).velocities
    speeds = np.linalg.norm(np.diff(velocities, _ORDER + 1, axis=0), axis=2)
    tensions = np.abs(np.diff(flown.tensions, _ORDER + 1, axis=0))
    middle = flown.at(np.arange(2, len(run.time) - 2))
    largest = np.maximum(
        np.max(speeds / tolerated_speeds(middle), axis=1),
        np.max(tensions / tolerated_tensions(middle), axis=1),
    )
    return largest / math.factorial(_ORDER + 1)


def _order(config: SimulatorConfig) -> int:
    """The order of the scheme, at most 3; with error control the accuracy counts instead."""
    return _ORDER if config.use_error_control else _ORDERS.get(config.integration_scheme, 1)


def _before(instant: float, states: list[RestorableState]) -> int:
    """The last of the states up to the instant."""
    times = [state.time for state in states]
    return max(0, int(np.searchsorted(times, instant, side="right")) - 1)


def compared(run: Run, half: Run) -> Run:
    """The run with what its metrics and those of the same with half the step tell.

    Half a step shows 7/8 of a third-order scheme's error, and half of a first-order one's.
    """
    shown = 1 - 0.5 ** _order(run.scenario.simulator_config)
    moves = moved_metrics(compute_metrics(run), compute_metrics(half), share=_MARGIN * shown)
    half_step = {
        "step_s": half.step,
        "moved": {move.metric.path: [move.value, move.finer] for move in moves},
    }
    unresolved = [f"{move} with half the step" for move in moves]
    if unresolved:
        unresolved[0] = f"not resolved by {_steps(run)}: {unresolved[0]}; {_remedy(run)}"
    return dataclasses.replace(run, unresolved=(*run.unresolved, *unresolved), half_step=half_step)


def in_doubt(run: Run) -> str:
    """Text of `Run.unresolved` for a run in doubt that cannot be flown again."""
    return f"parts of the run, flown again with half the step, differ from it; {_remedy(run)}"


def _steps(run: Run) -> str:
    if run.scenario.simulator_config.use_error_control:
        return f"an accuracy of {run.scenario.simulator_config.accuracy:g}"
    return f"steps of {1e3 * run.step:.3g} ms"


def _remedy(run: Run) -> str:
    """Remedies that may resolve a run."""
    if "tensions" in run.steps and np.min(run.steps["tensions"]) <= 0:
        return "cables that go slack and taut again may be resolved by no step: keep them taut"
    if run.scenario.simulator_config.use_error_control:
        accuracy = run.scenario.simulator_config.accuracy / 64
        return f"give a smaller simulator_config.accuracy, such as {accuracy:.2g}"
    return f"give a shorter simulator_config.max_step_size, such as {run.step / 4:.3g}"
