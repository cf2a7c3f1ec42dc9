"""A live run: shown in a Meshcat page while it goes on, with controls that change it."""

import math
from collections.abc import Callable
from typing import Any

from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram

from drake_nonstop.planning.problem_config import LEAST_BOUND
from drake_nonstop.run.run import Run, RunInterrupted, RunStopped, StepAction
from drake_nonstop.run.simulate import simulate
from drake_nonstop.scenario.schema import Scenario, sample
from drake_nonstop.validation import is_number, require
from drake_nonstop.view.nonstop_visualizer import show_in

# The controls' labels. Meshcat cuts long labels off, and ignores what a control with a name that
# is not ASCII sends.
PAUSE = "pause / resume"
STOP = "stop"
BOUND = "bound, m/s"
RATE = "x real time"
_KEYS = {PAUSE: "Space", STOP: ""}  # no key for what cannot be undone

_HIGHEST_BOUND = 3.0  # of the scenario's ε, the end of the slider
_RATES = 0.1, 10.0


def run_live(
    scenario: Scenario,
    meshcat: Meshcat,
    *,
    realtime_rate: float = 1.0,
    progress: Callable[[float], None] | None = None,
    **replacements: Any,
) -> Run:
    """Runs a scenario that is shown live, with controls in the page, and returns the run.

    It ends with the scenario's `simulation_duration`, or when "stop" is pressed.

    Args:
        scenario: what to run.
        meshcat: the Meshcat to show it in. Controls are added to it, and removed at the end.
        realtime_rate: simulated s per s of wall time; 0 for as fast as possible.
        progress: see `simulate`.
        replacements: see `simulate`.

    Raises:
        ScenarioError, RunStopped, RunInterrupted: see `simulate`.
    """
    require(
        is_number(realtime_rate) and realtime_rate >= 0,
        "--realtime",
        realtime_rate,
        "give a finite number that is not negative, 0 for as fast as possible",
    )
    scenario, _ = sample(scenario)
    controls = _Controls(meshcat, scenario, realtime_rate)
    try:
        run = simulate(
            scenario,
            progress=progress,
            viewers=[show_in(meshcat)],
            after_step=controls.after_step,
            **replacements,
        )
        run.is_steered = controls.is_steered
        return run
    except (RunStopped, RunInterrupted) as ended:
        ended.run.is_steered = controls.is_steered
        raise
    finally:
        controls.delete()


class _Controls:
    """The buttons and sliders of a page, and their effects on a run."""

    def __init__(self, meshcat: Meshcat, scenario: Scenario, realtime_rate: float):
        self._meshcat = meshcat
        self._realtime_rate = realtime_rate
        self._has_started = self.is_steered = False
        bound = scenario.speed_bound
        highest = _HIGHEST_BOUND * bound or 1.0
        for name, key in _KEYS.items():
            meshcat.AddButton(name, key)
        meshcat.AddSlider(BOUND, 0.0, highest, highest / 300, bound)
        low, high = _RATES
        rate = realtime_rate or high
        meshcat.AddSlider(RATE, min(low, rate), max(high, rate), 0.1, rate)
        # Meshcat may round a slider's value: it is applied only once the slider was moved.
        self._applied = {name: meshcat.GetSliderValue(name) for name in (BOUND, RATE)}

    def after_step(self, simulator: Simulator, nonstop: Diagram) -> StepAction:
        """Applies the sliders that were moved; see `simulate`."""
        root = simulator.get_mutable_context()
        layer = nonstop.GetSubsystemByName("optimization_layer")
        if not self._has_started:
            self._has_started = True
            simulator.set_target_realtime_rate(self._realtime_rate)
            is_commanded = nonstop.HasOutputPort("speed_bound_command")
            if not hasattr(layer, "set_speed_bound") or is_commanded:  # it has no effect
                self._meshcat.DeleteSlider(BOUND)
                del self._applied[BOUND]
        own = layer.GetMyMutableContextFromRoot(root)
        for name, applied in self._applied.items():
            value = self._meshcat.GetSliderValue(name)
            if value == applied:
                continue
            self._applied[name] = value
            if name == RATE:
                simulator.set_target_realtime_rate(value)
                simulator.ResetStatistics()  # or it would make up for the time before
            else:
                self.is_steered = True
                bound = value if value >= LEAST_BOUND else 0.0
                bound = min(bound, 0.999 * getattr(layer, "highest_speed_bound", math.inf))
                layer.set_speed_bound(own, bound)
        if self._meshcat.GetButtonClicks(STOP) > 0:
            return StepAction.END
        is_paused = self._meshcat.GetButtonClicks(PAUSE) % 2 == 1
        return StepAction.WAIT if is_paused else StepAction.CONTINUE

    def delete(self) -> None:
        """Removes these controls from the page, and no others."""
        for name in _KEYS:
            self._meshcat.DeleteButton(name)
        for name in self._applied:
            self._meshcat.DeleteSlider(name)
