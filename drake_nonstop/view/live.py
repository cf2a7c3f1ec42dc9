"""A live run: shown in a Meshcat page while it goes on, with controls that change it."""

import math
import time
from collections.abc import Callable, Iterator
from typing import Any

from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram

from drake_nonstop.planning.problem_config import LEAST_BOUND
from drake_nonstop.run.interruption import current_interruption
from drake_nonstop.run.run import (
    Run,
    RunInterrupted,
    RunStopped,
    StepAction,
)
from drake_nonstop.run.run_quantities import carrier_speeds
from drake_nonstop.run.simulate import simulate
from drake_nonstop.scenario.schema import Scenario, sample
from drake_nonstop.validation import is_number, require
from drake_nonstop.view.nonstop_visualizer import show_in

# The controls' labels. Meshcat cuts long labels off, and ignores what a control with a name that
# is not ASCII sends.
PAUSE = "pause / resume"
RESTART = "restart"
STOP = "stop"
BOUND = "bound, m/s"
SLOWEST = "slowest, m/s"
RATE = "x real time"
_KEYS = {PAUSE: "Space", RESTART: "KeyR", STOP: ""}  # no key for what cannot be undone

_HIGHEST_BOUND = 3.0  # of the scenario's ε, the end of the slider
_GAUGE_RANGE = 10.0  # of the scenario's ε, the end of the gauge
_RATES = 0.1, 10.0
_GAUGE_PERIOD = 0.1  # s of wall time
_POLLING_PERIOD = 0.05  # s of wall time, after a run


def run_live(
    scenario: Scenario,
    meshcat: Meshcat,
    *,
    realtime_rate: float = 1.0,
    progress: Callable[[float], None] | None = None,
    **replacements: Any,
) -> Iterator[Run]:
    """Runs a scenario in view, with controls in the page, and yields every run that ends.

    A run ends with the scenario's `simulation_duration`, or when "stop" is pressed, which ends
    the live runs as well. After a run, "restart" starts the next one, as long as a page is
    connected; the live runs end when none is. During a run, "restart" discards it and starts the
    next one. The sliders keep their values.

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
        while True:
            controls.start_run()
            run = simulate(
                scenario,
                progress=progress,
                viewers=[show_in(meshcat)],
                after_step=controls.after_step,
                **replacements,
            )
            if controls.is_stopped or not controls.is_restarted:
                run.is_steered = controls.is_steered
                yield run
                controls.wait_after_run()
            if controls.is_stopped or not controls.is_restarted:
                return
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
        bound = scenario.speed_bound
        highest = _HIGHEST_BOUND * bound or 1.0
        gauge = _GAUGE_RANGE * bound or 10.0
        for name, key in _KEYS.items():
            meshcat.AddButton(name, key)
        meshcat.AddSlider(BOUND, 0.0, highest, highest / 300, bound)
        meshcat.AddSlider(SLOWEST, 0.0, gauge, gauge / 1000, 0.0)
        low, high = _RATES
        rate = realtime_rate or high
        meshcat.AddSlider(RATE, min(low, rate), max(high, rate), 0.1, rate)
        # Meshcat may round a slider's value: it is applied only once the slider was moved.
        self._initial = {name: meshcat.GetSliderValue(name) for name in (BOUND, RATE)}
        self.start_run()

    def start_run(self) -> None:
        """To be called before a run."""
        self._clicks = {name: self._meshcat.GetButtonClicks(name) for name in (PAUSE, RESTART)}
        self._applied = dict(self._initial)
        self._has_started = False
        self._last_gauge = 0.0
        self.is_steered = False

    @property
    def is_stopped(self) -> bool:  # in this run or before
        return self._meshcat.GetButtonClicks(STOP) > 0

    @property
    def is_restarted(self) -> bool:  # since the run started
        return self._meshcat.GetButtonClicks(RESTART) > self._clicks[RESTART]

    def after_step(self, simulator: Simulator, nonstop: Diagram) -> StepAction:
        """Applies the sliders that were moved, and shows the slowest speed in the page."""
        root = simulator.get_mutable_context()
        layer = nonstop.GetSubsystemByName("optimization_layer")
        if not self._has_started:
            self._has_started = True
            simulator.set_target_realtime_rate(self._realtime_rate)
            is_commanded = nonstop.HasOutputPort("speed_bound_command")
            is_of_no_effect = not hasattr(layer, "set_speed_bound") or is_commanded
            if is_of_no_effect and BOUND in self._meshcat.GetSliderNames():
                self._meshcat.DeleteSlider(BOUND)
        own = layer.GetMyMutableContextFromRoot(root)
        for name, value in self._take_changes().items():
            self.is_steered |= name != RATE
            if name == RATE:
                simulator.set_target_realtime_rate(value)
                simulator.ResetStatistics()  # or it would make up for the time before
            else:
                bound = value if value >= LEAST_BOUND else 0.0
                bound = min(bound, 0.999 * getattr(layer, "highest_speed_bound", math.inf))
                layer.set_speed_bound(own, bound)
        now = time.perf_counter()
        if now - self._last_gauge > _GAUGE_PERIOD:
            self._last_gauge = now
            carriers = nonstop.GetOutputPort("carrier_state")
            states = carriers.Eval(nonstop.GetMyContextFromRoot(root))
            self._meshcat.SetSliderValue(SLOWEST, carrier_speeds(states[None]).min())
        if self.is_stopped or self.is_restarted:
            return StepAction.END
        is_paused = (self._meshcat.GetButtonClicks(PAUSE) - self._clicks[PAUSE]) % 2 == 1
        return StepAction.WAIT if is_paused else StepAction.CONTINUE

    def _take_changes(self) -> dict[str, float]:
        """The sliders' values that have changed since the last call, by name."""
        names = self._applied.keys() & set(self._meshcat.GetSliderNames())
        values = {name: self._meshcat.GetSliderValue(name) for name in names}
        changes = {name: value for name, value in values.items() if value != self._applied[name]}
        self._applied |= changes
        return changes

    def delete(self) -> None:
        """Removes these controls from the page, and no others."""
        for name in set(_KEYS) & set(self._meshcat.GetButtonNames()):
            self._meshcat.DeleteButton(name)
        for name in {BOUND, SLOWEST, RATE} & set(self._meshcat.GetSliderNames()):
            self._meshcat.DeleteSlider(name)

    def wait_after_run(self) -> None:
        """Waits for "restart" or "stop", or until no page is connected."""
        with current_interruption() as interruption, interruption.patient(1):
            while not (self.is_stopped or self.is_restarted):
                if interruption.number:
                    raise KeyboardInterrupt
                if self._meshcat.GetNumActiveConnections() == 0:
                    return
                time.sleep(_POLLING_PERIOD)
