"""The loop linearized at its start: its fastest mode, and how fast a deviation grows."""

import math
from collections.abc import Callable
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram

from drake_nonstop.loop.equilibrium import LOOP_SIGNALS
from drake_nonstop.loop.plant_states import PlantStates
from drake_nonstop.loop.traced_start import TracedStart
from drake_nonstop.mechanics.signal_layouts import SAMPLE_TIME
from drake_nonstop.mechanics.signals import LOAD_STATE_SIZE, SIGNAL_PERIOD, CarrierStates, LoadState
from drake_nonstop.systems.port_state import copied_context
from drake_nonstop.systems.wiring import innermost, output_names

_STEPS = (1e-6, 1e-8, 1e-10)  # SI units; one after the other, where the rates have a kink
_KINK = 0.02  # of the difference of two slopes to their sum, from which on they do not agree
_HALVINGS = 10  # of a step whose matrix has the norm 1: growth is then exact to 1e-8 of it


class LinearizedLoop:
    """The plant between two samples of the controllers, and what a sample changes.

    ẋ = A x + G x_k: A with the controllers' inputs held, G from the load's state at the sample
    to the rates by way of what the controllers make of it. References are as in the middle
    between two samples; delays, integrals and the optimization layer are left out.

    The carriers move with the load there: cables that change their length may have tensions that
    end at zero, which hides what their damping does. Aircraft, which cannot fly at its speed, keep
    their own.

    Args:
        nonstop: the loop.
        context: at the start.
        control_period: the controllers' sample time in s; 0: continuous.

    Attributes:
        is_continuous: whether the states of load and carriers are; others have steps of their own.
    """

    def __init__(self, nonstop: Diagram, context: Context, control_period: float):
        nonstop, context = innermost(nonstop, context, LOOP_SIGNALS)
        self._nonstop, plant = nonstop, PlantStates(nonstop)
        self._period = control_period or SIGNAL_PERIOD
        self._trial = trial = copied_context(nonstop, context)
        Simulator(nonstop, trial).Initialize()
        load = LoadState.view(nonstop.GetOutputPort("load_state").Eval(trial))
        carriers = nonstop.GetOutputPort("carrier_state").Eval(trial).copy()
        positions, velocities = CarrierStates.view(carriers)
        if not nonstop.HasOutputPort("aircraft_state"):
            turning = np.cross(load.angular_velocity, positions - load.position)
            velocities[:] = load.velocity + turning
            plant.try_to_set(trial, carrier_state=carriers)
        self.is_continuous = plant.is_continuous(trial)
        self._start = trial.get_continuous_state_vector().CopyToVector()
        blocks = nonstop.GetSystems()
        holds = [block for block in blocks if SAMPLE_TIME in output_names(block)]
        self._hold = holds[0] if holds and control_period > 0 else None
        self._dynamics = _slopes(self._rate, self._start)

    @property
    def fastest_mode(self) -> float:
        """The largest magnitude (rad/s) of the eigenvalues of A."""
        return float(np.max(np.abs(np.linalg.eigvals(self._dynamics)), initial=0.0))

    def growths(self, step: float) -> tuple[float, float]:
        """How fast the least stable deviation grows, in 1/s: exactly, and with steps of some s.

        The steps are those of a third-order Runge-Kutta scheme.
        """
        dynamics, feedback, period = self._dynamics, self._feedback, self._period
        unit = np.eye(len(dynamics))

        def growth(step: float) -> float:
            count = max(1, math.ceil(period / step - 1e-9))
            part = dynamics * period / count
            mean = unit + part / 2 + part @ part / 6
            moved, held = unit + part @ mean, mean @ feedback * period / count  # of x, and of x_k
            while count % 2 == 0:  # two steps in one
                moved, held, count = moved @ moved, moved @ held + held, count // 2
            sample_map = unit
            for _ in range(count):
                sample_map = moved @ sample_map + held
            return math.log(np.max(np.abs(np.linalg.eigvals(sample_map)))) / period

        # By short steps: SciPy's exponential would add the 0.2 s of its import to each run.
        size = np.linalg.norm(np.concatenate([dynamics, feedback], axis=1) * period, 1)
        halvings = _HALVINGS + math.ceil(math.log2(1 + size))
        return growth(period / 2**halvings), growth(step)

    def _rate(self, state: NDArray) -> NDArray:
        self._set(state)
        return self._rate_now()

    def _set(self, state: NDArray) -> None:
        if len(state):
            self._trial.SetContinuousState(state)

    def _rate_now(self) -> NDArray:
        rate: NDArray = self._nonstop.EvalTimeDerivatives(self._trial).CopyToVector()
        return rate

    @cached_property
    def _feedback(self) -> NDArray:
        """G, by forward differences."""
        if self._hold is None:
            return np.zeros_like(self._dynamics)
        trial = self._trial
        port = self._nonstop.GetOutputPort("load_state")

        def load_state(state: NDArray) -> NDArray:
            self._set(state)
            return port.Eval(trial).copy()

        steps = _STEPS[0] * np.eye(len(self._start))
        shown = np.column_stack(  # (13, states), what the port shows of them
            [
                (load_state(self._start + step) - load_state(self._start - step)) / (2 * _STEPS[0])
                for step in steps
            ]
        )
        self._set(self._start)
        samples = self._nonstop.GetMutableSubsystemContext(self._hold, trial)
        held = samples.get_discrete_state(0).CopyToVector()  # the measured load state
        trial.SetTime(trial.get_time() + self._period / 2)
        middle = self._rate_now()
        columns = []
        for direction in np.eye(LOAD_STATE_SIZE):
            samples.SetDiscreteState(0, held + _STEPS[0] * direction)
            columns.append((self._rate_now() - middle) / _STEPS[0])
        return np.column_stack(columns) @ shown


class LinearizedTrace(LinearizedLoop):
    """The same by a loop's traced functions, whose carriers are points.

    Args:
        traced: the loop's start.
        control_period: as of `LinearizedLoop`.
    """

    is_continuous = True

    def __init__(self, traced: TracedStart, control_period: float):
        self._traced, self._period = traced, control_period or SIGNAL_PERIOD
        self._has_hold = control_period > 0
        self._state = state = traced.initialized(traced.state)
        load, carriers = LoadState.view(state[traced.load]), state[traced.carriers]
        positions, velocities = CarrierStates.view(carriers)
        turning = np.cross(load.angular_velocity, positions - load.position)
        velocities[:] = load.velocity + turning
        self._start = state[traced.continuous]
        self._dynamics = _slopes(self._rate, self._start)

    def _rate(self, state: NDArray) -> NDArray:
        now = self._state.copy()
        now[self._traced.continuous] = state
        return self._rate_of(now)

    def _rate_of(self, state: NDArray, at: float = 0.0) -> NDArray:
        return self._traced.rest(state, at)[1][self._traced.continuous]

    @cached_property
    def _feedback(self) -> NDArray:
        size, traced = len(self._start), self._traced
        if traced.held is None or not self._has_hold:
            return np.zeros((size, size))
        middle = self._rate_of(self._state, self._period / 2)
        columns = []
        for k in range(LOAD_STATE_SIZE):
            moved = self._state.copy()
            moved[traced.held + k] += _STEPS[0]
            columns.append((self._rate_of(moved, self._period / 2) - middle) / _STEPS[0])
        shown = np.eye(len(self._state))[traced.load][:, traced.continuous]
        return np.column_stack(columns) @ shown


def _slopes(function: Callable[[NDArray], NDArray], at: NDArray) -> NDArray:
    """The Jacobian where the function may have kinks: tensions that end at zero.

    Central differences where those on both sides agree, if need be with shorter steps, within
    which a tension that is damped strongly does not end; the steeper side of a kink.
    """
    middle = function(at)
    columns = []
    for direction in np.eye(len(at)):
        for step in _STEPS:
            above = function(at + step * direction) - middle
            below = middle - function(at - step * direction)
            if np.max(np.abs(above - below)) <= _KINK * np.max(np.abs(above + below)):
                columns.append((above + below) / (2 * step))
                break
        else:
            steeper = max(above, below, key=lambda side: float(np.max(np.abs(side))))
            columns.append(steeper / step)
    return np.column_stack(columns) if columns else np.zeros((0, 0))
