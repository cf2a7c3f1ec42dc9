"""Drake's Simulator as the engine of a run, and what the engines of a run have in common."""

from typing import Protocol

from pydrake.systems.analysis import InitializeParams, Simulator

from drake_nonstop.simulation.monitor import Monitor
from drake_nonstop.simulation.recording import Recording


class Engine(Protocol):
    """Flies a run, or as much of it as it can, and records it."""

    def fly(self, duration: float, monitor: Monitor) -> None:
        """Flies up to a time, and sets the context to the end of what was flown.

        It goes on from where another engine has recorded steps.

        Args:
            duration: s.
            monitor: of the run, which is asked after steps.
        """
        ...


class DiagramRun:
    """Flies a run by Drake's Simulator.

    Args:
        simulator: of the diagram around the loop, at its present state.
        recording: takes the signals.
    """

    def __init__(self, simulator: Simulator, recording: Recording):
        self._simulator, self._recording = simulator, recording

    def fly(self, duration: float, monitor: Monitor) -> None:
        """As `Engine.fly`."""
        is_begun = self._recording.has_steps
        if is_begun:
            self._recording.drop_last_step()  # it is taken again
        self._simulator.Initialize(InitializeParams(suppress_initialization_events=is_begun))
        if not monitor.has_ended:
            self._simulator.AdvanceTo(duration)
