"""Drake's Simulator as the engine of a run, and what the engines of a run have in common."""

from collections.abc import Callable
from typing import Protocol

from pydrake.systems.analysis import InitializeParams, Simulator
from pydrake.systems.framework import Diagram

from drake_nonstop.simulation.monitor import Monitor
from drake_nonstop.simulation.recording import Recording
from drake_nonstop.simulation.short_flights import RestorableState, SavedState


class Engine(Protocol):
    """Flies a run, or as much of it as it can, and records it."""

    def fly(
        self,
        duration: float,
        monitor: Monitor,
        saves_at: Callable[[], float],
        *,
        is_begun: bool = False,
    ) -> bool:
        """Flies up to a time, and sets the context to the end of what was flown.

        Args:
            duration: s.
            monitor: of the run, which is asked after steps.
            saves_at: tells the time, s, from which on the monitor saves the next state.
            is_begun: whether another engine has flown the run's first part.

        Returns:
            Whether anything was flown and recorded.
        """
        ...

    def take_sample(self) -> None:
        """Records the signals at an instant at which the monitor samples."""
        ...

    def saved_state(self) -> RestorableState:
        """The present state, for a flight from there."""
        ...


class DiagramRun:
    """Flies a run by Drake's Simulator.

    Args:
        simulator: of the diagram around the loop, at its present state.
        nonstop: the loop's diagram.
        recording: takes the signals.
    """

    def __init__(self, simulator: Simulator, nonstop: Diagram, recording: Recording):
        self._simulator, self._nonstop, self._recording = simulator, nonstop, recording

    def fly(
        self,
        duration: float,
        monitor: Monitor,
        saves_at: Callable[[], float],
        *,
        is_begun: bool = False,
    ) -> bool:
        """As `Engine.fly`."""
        if is_begun:
            self._recording.drop_last_step()  # it is taken again
        self._simulator.Initialize(InitializeParams(suppress_initialization_events=is_begun))
        if not monitor.has_ended:
            self._simulator.AdvanceTo(duration)
        return True

    def take_sample(self) -> None:
        """As `Engine.take_sample`."""
        self._recording.take_sample()

    def saved_state(self) -> RestorableState:
        """As `Engine.saved_state`."""
        context = self._simulator.get_context()
        return SavedState.of(self._nonstop.GetMyContextFromRoot(context))
