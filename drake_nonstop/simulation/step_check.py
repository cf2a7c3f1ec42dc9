"""Whether a run's steps resolve its results, judged from short flights and, in doubt, a long one."""

import dataclasses

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context

from drake_nonstop.mechanics.signals import CarrierStates
from drake_nonstop.simulation.metrics import compute_metrics
from drake_nonstop.simulation.moved_metrics import moved_metrics
from drake_nonstop.simulation.run import SIGNAL_PERIOD, Run
from drake_nonstop.simulation.short_flights import Flight, SavedState, ShortFlights, difference
from drake_nonstop.simulation.step_size import with_step
from drake_nonstop.systems.tracing import NotFiniteError

_SAVING_PERIOD = 0.25  # s; longer where there would be more states than the largest number
_MOST_STATES = 256
_FLIGHT = 0.04  # s, or longer: two samples of the controllers
_IN_DOUBT = 0.25  # the largest `difference` of a short flight that is not in doubt


class SavedStates:
    """States of the loop during a run, some time apart."""

    def __init__(self) -> None:
        self.states: list[SavedState] = []
        self._period = _SAVING_PERIOD
        self._next = 0.0

    def save(self, context: Context) -> None:
        """Saves the loop's state, if it is time."""
        if context.get_time() < self._next:
            return
        self.states.append(SavedState.of(context))
        if len(self.states) > _MOST_STATES:
            self.states = self.states[::2]
            self._period *= 2
        self._next = self.states[-1].time + (1 - 1e-6) * self._period


def is_in_doubt(run: Run, states: list[SavedState], context: Context) -> bool:
    """Whether a run's hardest parts, flown again with half the step, differ from it.

    A run whose cables go slack is in doubt anyway: an instant at which a force ends is resolved by
    no step.

    Args:
        run: what is judged.
        states: of the run, saved on its way.
        context: of the run's diagram, with its parameters.
    """
    tensions, carriers = run.signal("tensions"), CarrierStates.view(run.signal("carrier_state"))
    speeds = np.linalg.norm(carriers.velocities, axis=2)
    if np.min(run.steps["tensions"]) <= 0:
        return True
    config = with_step(run.scenario.simulator, run.step)
    period = run.scenario.control_period
    flights = ShortFlights(run.diagram, context, config, period)
    time = max(_FLIGHT, 2 * period)
    last = run.time[-1] - time - SIGNAL_PERIOD
    starts = {_before(instant, states) for instant in _hardest_instants(run.time, tensions, speeds)}
    for state in (states[i] for i in sorted(starts)):
        if state.time > last:
            continue
        try:
            finer = flights.fly(state, time, 2)
        except NotFiniteError:
            return True
        samples = np.round(finer.time / SIGNAL_PERIOD).astype(int)
        flown = Flight(
            time=finer.time,
            tensions=tensions[samples],
            speeds=speeds[samples],
            load_velocity=run.signal("load_state")[samples, -3:],
        )
        if difference(flown, finer) > _IN_DOUBT:
            return True
    return False


def _hardest_instants(time: NDArray, tensions: NDArray, speeds: NDArray) -> list[float]:
    """Where a tension and a speed are least, and where the tensions change most in a sample."""
    if len(time) < 2:
        return []
    changes = np.max(np.abs(np.diff(tensions, axis=0)), axis=1)
    hardest = [np.argmin(np.min(tensions, axis=1)), np.argmin(np.min(speeds, axis=1))]
    return [float(time[i]) for i in (*hardest, np.argmax(changes))]


def _before(instant: float, states: list[SavedState]) -> int:
    """The last of the states up to the instant."""
    times = [state.time for state in states]
    return max(0, int(np.searchsorted(times, instant, side="right")) - 1)


def compared(run: Run, half: Run) -> Run:
    """The run with what its metrics and those of the same with half the step tell."""
    moves = moved_metrics(compute_metrics(run), compute_metrics(half))
    half_step = {
        "step_s": half.step,
        "moved": {move.metric.path: [move.value, move.finer] for move in moves},
    }
    unresolved = [
        f"the {move.metric.label} is not resolved by steps of {1e3 * run.step:.3g} ms: {move.shown} "
        "with half of them"
        for move in moves
    ]
    if unresolved:
        unresolved[0] += f"; give a shorter simulator.max_step_size, such as {half.step / 2:.2g}"
    return dataclasses.replace(run, unresolved=tuple(unresolved), half_step=half_step)


def in_doubt(step: float) -> str:
    """What `Run.unresolved` says of a run in doubt that cannot be flown again."""
    return (
        f"parts of the run, flown again, differ with half of the steps of {1e3 * step:.3g} ms; give "
        f"a shorter simulator.max_step_size, such as {step / 4:.2g}"
    )
