"""The state of a system as one of its output ports shows it.

The states of a MultibodyPlant come positions first, those of a discrete plant are discrete, and a
block may show its state in any other form: what a port shows is all that is known of it.
"""

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import InitializeParams, Simulator
from pydrake.systems.framework import Context, EventStatus, OutputPort, System

_STEP = 2.0**-16  # of the differences: a power of two, so that those of most states are exact
_PRECISION = 1e-12  # of what a port shows, in SI units or relative to larger values
_ITERATIONS = 30
_HALVINGS = 6  # of a step that does not bring the port closer to its value
_SHARE = 0.1  # of the error that a step with slopes from elsewhere has to leave at most
_LONGEST_PERIOD = 1.0  # s, between updates of a discrete state
_MOST_STEPS = 100  # until the second of them
_SMALLEST = 1e-9  # of the largest singular value: what a port does not show


def state_values(context: Context) -> NDArray:
    """All numeric states of a system in one array, the continuous ones first."""
    groups = range(context.num_discrete_state_groups())
    discrete = [context.get_discrete_state(i).CopyToVector() for i in groups]
    return np.concatenate([context.get_continuous_state_vector().CopyToVector(), *discrete])


def set_state_values(context: Context, values: NDArray) -> None:
    """Sets all numeric states of a system, in the order of `state_values`."""
    count = context.num_continuous_states()
    if count:
        context.SetContinuousState(values[:count])
    set_discrete_values(context, values[count:])


def set_discrete_values(context: Context, values: NDArray) -> None:
    """Sets the discrete states of a system, its groups one after the other."""
    start = 0
    for i in range(context.num_discrete_state_groups()):
        end = start + context.get_discrete_state(i).size()
        context.SetDiscreteState(i, values[start:end])
        start = end


def copied_context(system: System, context: Context) -> Context:
    """A context of a system by itself, whose inputs have the values of now."""
    copy = system.CreateDefaultContext()
    copy.SetTimeStateAndParametersFrom(context)
    system.FixInputPortsFrom(system, context, copy)
    return copy


class PortState:
    """The numeric states of a system that one of its vector-valued ports shows.

    Contexts are the system's own, and may be a part of a diagram's.
    """

    def __init__(self, system: System, port: OutputPort):
        self._system, self._port = system, port
        self._inverse: NDArray | None = None  # (states, entries), of slopes that were found last
        self._is_continuous: bool | None = None  # whether it shows continuous states; unknown yet

    def show(self, context: Context, value: NDArray) -> None:
        """Moves the state as little as possible for the port to show a value.

        By Gauss-Newton's method on differences of the port, which are found anew only where
        earlier ones do not fit: for a port that shows its state in another order, or a linear
        function of it, once. Where the port cannot show the value the state is one of those that
        come closest; nothing is raised.
        """
        state = state_values(context)
        if not len(state):
            return
        precise = _PRECISION * np.maximum(1.0, np.abs(value))
        error = value - self._port.Eval(context)
        is_fresh = False
        for _ in range(_ITERATIONS):
            if np.all(np.abs(error) <= precise) or not np.all(np.isfinite(error)):
                break
            if self._inverse is None:
                self._inverse = np.linalg.pinv(self.slopes(context), rcond=_SMALLEST)
                is_fresh = True
            step = self._inverse @ error
            for _ in range(_HALVINGS if is_fresh else 1):
                set_state_values(context, state + step)
                after = value - self._port.Eval(context)
                limit = 1.0 if is_fresh else _SHARE
                is_closer = np.linalg.norm(after) < limit * np.linalg.norm(error)
                if is_closer:
                    break
                step = step / 2
            if is_closer:
                state, error = state_values(context), after
                is_fresh = False
                continue
            set_state_values(context, state)
            self._inverse = None
            if is_fresh:
                break

    def slopes(self, context: Context) -> NDArray:
        """The Jacobian (entries, states) of the port by central differences."""
        state = state_values(context)
        columns = []
        for step in _STEP * np.eye(len(state)):
            ends = []
            for moved in (state + step, state - step):
                set_state_values(context, moved)
                ends.append(self._port.Eval(context).copy())
            columns.append((ends[0] - ends[1]) / (2 * _STEP))
        set_state_values(context, state)
        return np.column_stack(columns) if columns else np.zeros((self._port.size(), 0))

    def is_continuous(self, context: Context) -> bool:
        """Whether the port shows continuous states, perhaps among others."""
        if self._is_continuous is None:
            count = context.num_continuous_states()
            self._is_continuous = count > 0 and (
                context.has_only_continuous_state() or bool(np.any(self.slopes(context)[:, :count]))
            )
        return self._is_continuous

    def rate(self, context: Context) -> NDArray:
        """The rate of what the port shows, of discrete states its change in one update per second.

        Of continuous states it is the difference of the port along their rate. With discrete ones
        the system is stepped alone, with its inputs held, until the port has changed twice: what
        lies between the two is the period. A port that does not change has a rate of zero.
        """
        if not self.is_continuous(context):
            return self._change(context)
        state = state_values(context)
        rate = np.zeros(len(state))
        derivatives = self._system.EvalTimeDerivatives(context)
        rate[: context.num_continuous_states()] = derivatives.CopyToVector()
        shown = []
        for values in (state - _STEP * rate, state + _STEP * rate):
            set_state_values(context, values)
            shown.append(self._port.Eval(context).copy())
        set_state_values(context, state)
        return (shown[1] - shown[0]) / (2 * _STEP)

    def _change(self, context: Context) -> NDArray:
        """The change per second of the port in the first update of a discrete state."""
        alone = copied_context(self._system, context)
        last, last_time = self._port.Eval(alone).copy(), alone.get_time()
        updates: list[float] = []  # times in s
        changes: list[NDArray] = []
        steps = 0

        def watch(now: Context) -> EventStatus:
            nonlocal last, last_time, steps
            shown = self._port.Eval(now).copy()
            if np.any(shown != last):
                updates.append(last_time)  # a step begins with its events
                changes.append(shown - last)
            last, last_time, steps = shown, now.get_time(), steps + 1
            if len(changes) == 2 or steps > _MOST_STEPS:
                return EventStatus.ReachedTermination(self._system, "")
            return EventStatus.DidNothing()

        simulator = Simulator(self._system, alone)
        simulator.Initialize(InitializeParams(suppress_initialization_events=True))
        simulator.set_monitor(watch)
        simulator.AdvanceTo(last_time + _LONGEST_PERIOD)
        if len(changes) < 2:
            return np.zeros(self._port.size())
        return changes[0] / (updates[1] - updates[0])
