"""A compiled loop as one discrete system of a bigger diagram."""

import threading
from typing import TYPE_CHECKING

from pydrake.systems.framework import (
    Context,
    DiscreteValues,
)

from drake_nonstop.mechanics.signal_layouts import by_name
from drake_nonstop.systems.block import LeafBlock
from drake_nonstop.validation import require

if TYPE_CHECKING:
    from drake_nonstop.systems.compiled_loop import CompiledLoop


class CompiledSystem(LeafBlock):
    """A discrete system that flies a `CompiledLoop` from sample to sample of its controllers.

    It replaces the loop in a bigger diagram, and a Simulator runs it like any other system. Each
    signal of the loop is an output port of its name. From one sample to the next it shows the
    values of the loop's diagram at the first of the two, before the controllers' update. It starts
    from the default context of the loop's diagram, with its parameters, at t = 0, and goes on from
    any of its states: contexts may be copied, and set back.

    .. pydrake_system::

        name: CompiledSystem
        output_ports:
        - (the loop's signals)

    Args:
        loop: with signals once a sample.

    Raises:
        ScenarioError: signals are shown more often.
    """

    is_sampled = True

    def __init__(self, loop: "CompiledLoop"):
        super().__init__()
        shown = loop.shown_per_sample
        require(shown == 1, "loop.signal_period", shown, "give signal_period=None")
        self._loop = loop
        self._flight = loop.fly(loop.diagram.CreateDefaultContext())
        self._lock = threading.Lock()  # the flight is scratch memory of all contexts
        self._state = self.DeclareDiscreteState(self._flight.state)
        self._signals = []
        for name, size in loop.signals.items():
            self._signals.append(self.DeclareDiscreteState(size))
            self.DeclareStateOutputPort(name, self._signals[-1])
        period = loop.control_period
        self.DeclareInitializationDiscreteUpdateEvent(self._begin)
        self.DeclarePeriodicDiscreteUpdateEvent(period, period, self._advance)

    def _begin(self, context: Context, discrete_state: DiscreteValues) -> None:
        remedy = "start at 0, or go on with suppress_initialization_events"
        require(context.get_time() == 0, "context.time", context.get_time(), remedy)
        self._fly(context, discrete_state, 0)

    def _advance(self, context: Context, discrete_state: DiscreteValues) -> None:
        self._fly(context, discrete_state, round(context.get_time() / self._loop.control_period))

    def _fly(self, context: Context, discrete_state: DiscreteValues, sample: int) -> None:
        """Starts, or goes on to a sample from the last one."""
        self.require_floats("simulate the loop's diagram")
        with self._lock:
            self._flight.go_to(max(0, sample - 1), context.get_discrete_state(self._state).value())
            signals, _ = self._flight.advance() if sample else self._flight.start()
            discrete_state.set_value(self._state, self._flight.state)
        shown = by_name(self._loop.signals, signals.ravel())
        for index, values in zip(self._signals, shown.values(), strict=True):
            discrete_state.set_value(index, values)
