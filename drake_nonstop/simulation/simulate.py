"""A scenario to a run: the simulated signals of every block."""

import copy
import dataclasses
import math
import signal
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import (
    ApplySimulatorConfig,
    GetIntegrationSchemes,
    Simulator,
    SimulatorConfig,
)
from pydrake.systems.framework import (
    Context,
    Diagram,
    DiagramBuilder,
    EventStatus,
    LeafSystem,
    OutputPort,
    PortDataType,
    TriggerType,
)
from pydrake.systems.primitives import LogVectorOutput, Multiplexer, VectorLog

from drake_nonstop.blocks.fused_plant import FusedPlant
from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.scenario.loading import Scenario
from drake_nonstop.simulation.equilibrium import fastest_mode, set_equilibrium
from drake_nonstop.systems.block import LeafBlock
from drake_nonstop.systems.tracing import LARGEST, NotFiniteError
from drake_nonstop.systems.wiring import output_names
from drake_nonstop.validation import ScenarioError, one_line, require

_WAITING_PERIOD = 0.02  # s of wall time, between two questions of a run that waits
_REPORT_PERIOD = 0.1  # s of wall time, between two calls of `progress`
SIGNAL_PERIOD = 0.01  # s, of the signals that are written

_AT_SAMPLE = 1e-6  # of the period, from an instant to what counts as there

_SHORTEST_STEP = 1e-5  # s; with a shorter one a run would not come to an end
_STABLE_STEP = 1.6  # rad, the fastest mode's turn in a step; third-order Runge-Kutta: 1.73

_WALL_TIME = "solve_time"  # differs from run to run: kept out of the signals

# What the metrics judge by the step, and where the optimization layer's updates show.
_EVERY_STEP = (
    "load_state",
    "carrier_state",
    "tensions",
    "diagnostics",
    "speed_bound",
    _WALL_TIME,
)


@dataclass(kw_only=True)
class Run:
    """What a simulation produced.

    `signals` maps "block.port" to the samples of every signal but wall times, (samples,
    size), at the instants `time` (samples,), 100 Hz; `steps` maps the names of a few ports
    to their values at every step, (steps, size), and "time" to the steps' times (steps,), from
    t = 0 on: the integrator's steps, or the controllers' samples where the plant is fused. A
    value at an instant is that before the controllers' update at that instant. `solve_times`
    (updates,) are the wall times of the optimization layer's updates, `wall_time` that of the
    whole simulation but for pauses, in s.
    A run that `is_steered` was changed from outside while it went on.
    """

    scenario: Scenario
    diagram: Diagram
    time: NDArray
    signals: dict[str, NDArray]
    steps: dict[str, NDArray]
    solve_times: NDArray
    wall_time: float
    is_steered: bool = False

    def signal(self, port: str) -> NDArray:
        """The signal of that port name, whichever block makes it: (samples, size)."""
        for name, values in self.signals.items():
            if name.split(".")[1] == port:
                return values
        raise KeyError(port)


class StepAction(Enum):
    """What a run does after a step."""

    CONTINUE = 1
    WAIT = 2  # and ask again
    END = 3


# Adds a system beside the loop's diagram, which the builder has already, and returns it.
Viewer = Callable[[DiagramBuilder, Diagram, Scenario], LeafSystem]


class RunStopped(RuntimeError):  # noqa: N818 - a run stopped; the cause is told
    """A run ended before its time; `run` holds the signals up to there."""

    def __init__(self, message: str, run: Run):
        super().__init__(message)
        self.run = run


class RunInterrupted(KeyboardInterrupt):
    """A run was interrupted from the keyboard; `run` holds the signals up to there."""

    def __init__(self, run: Run):
        super().__init__()
        self.run = run


def simulate(
    scenario: Scenario,
    *,
    progress: Callable[[float], None] | None = None,
    viewers: Sequence[Viewer] = (),
    after_step: Callable[[Simulator, Diagram], StepAction] | None = None,
    **replacements: Any,
) -> Run:
    """Simulates a scenario from its equilibrium and returns all signals.

    Args:
        scenario: what to run.
        progress: called with the simulated time now and then.
        viewers: functions that show the run while it goes on, such as `show_in(meshcat)`. Each
            adds a system to the builder, connected to the loop's diagram, and returns it. A
            forced publish of the system shows the end of the run.
        after_step: called with the simulator and the loop's diagram after every step. It may
            change parameters of the context, such as the optimization layer's ε, or the
            simulator's real-time rate, and have the run wait or end.
        replacements: blocks in place of the scenario's, see `make_nonstop`.

    Raises:
        ScenarioError: the scenario cannot be built.
        RunStopped: the run diverged or a block failed; carries the run up to there.
        RunInterrupted: Ctrl-C; carries the run up to there.
    """
    schemes = GetIntegrationSchemes()
    require(
        scenario.simulator.integration_scheme in schemes,
        "simulator.integration_scheme",
        scenario.simulator.integration_scheme,
        f"give one of {', '.join(schemes)}",
    )
    for name, block in replacements.items():
        require(block is not None, f"replacement {name}", None, "give a block; see make_nonstop")
    for viewer in viewers:
        require(callable(viewer), "viewers", viewer, "give functions, such as show_in(meshcat)")
    nonstop = make_nonstop(scenario, **replacements)
    if any(isinstance(block, FusedPlant) for block in nonstop.GetSystems()):
        config = stable_config(scenario.simulator, nonstop, _at_equilibrium(nonstop))
        if config is not scenario.simulator:  # the steps are the block's own
            shorter = dataclasses.replace(scenario, simulator=config)
            nonstop = make_nonstop(shorter, **replacements)
    builder = DiagramBuilder()
    builder.AddSystem(nonstop)
    outputs = [nonstop.get_output_port(i) for i in range(nonstop.num_output_ports())]
    ports = {
        port.get_name(): port
        for port in outputs
        if port.get_data_type() == PortDataType.kVectorValued
    }
    stepped = {name: port for name, port in ports.items() if name in _EVERY_STEP}
    sampled = {name: port for name, port in ports.items() if name != _WALL_TIME}
    step_sink = LogVectorOutput(
        _stacked(builder, stepped), builder, {TriggerType.kPerStep}, publish_period=0.0
    )
    sample_sink = LogVectorOutput(
        _stacked(builder, sampled), builder, {TriggerType.kForced}, publish_period=0.0
    )
    builder.AddNamedSystem("sample_instants", _SampleInstants())
    visualizers = [viewer(builder, nonstop, scenario) for viewer in viewers]
    simulator = Simulator(builder.Build())
    context = simulator.get_mutable_context()
    start = time.perf_counter()

    def finished() -> Run:
        return _collect(
            scenario,
            nonstop,
            _split(sample_sink.FindLog(context), sampled),
            _split(step_sink.FindLog(context), stepped),
            wall_time=time.perf_counter() - start - monitor.waited,
        )

    sample_context = sample_sink.GetMyContextFromRoot(context)
    monitor = _Monitor(
        simulator,
        nonstop,
        sample=lambda: sample_sink.ForcedPublish(sample_context),
        progress=progress,
        after_step=after_step,
    )
    try:
        nonstop_context = nonstop.GetMyMutableContextFromRoot(context)
        set_equilibrium(nonstop, nonstop_context)
        ApplySimulatorConfig(stable_config(scenario.simulator, nonstop, nonstop_context), simulator)
        with monitor:
            simulator.set_monitor(monitor)
            start = time.perf_counter()
            simulator.Initialize()
            simulator.AdvanceTo(scenario.duration)
            for visualizer in visualizers:  # the last step may have been skipped
                visualizer.ForcedPublish(visualizer.GetMyContextFromRoot(context))
            if monitor.is_interrupted:
                raise KeyboardInterrupt
    except ScenarioError:
        raise
    except KeyboardInterrupt:
        raise RunInterrupted(finished()) from None
    except NotFiniteError as error:
        raise RunStopped(
            f"the run diverged at t = {context.get_time():.4f} s: {error} a value that is not "
            f"finite, or beyond {LARGEST:.0e} in SI units; the loop may be unstable, or "
            "simulator.max_step_size too large",
            finished(),
        ) from None
    except Exception as error:
        cause = f"{_blame(error)}{one_line(error)}"
        message = f"the run stopped at t = {context.get_time():.4f} s: {cause}"
        raise RunStopped(message, finished()) from error
    return finished()


def _at_equilibrium(nonstop: Diagram) -> Context:
    context = nonstop.CreateDefaultContext()
    set_equilibrium(nonstop, context)
    return context


def _blame(error: BaseException) -> str:
    """Which block raised the error, where one did, and in which line."""
    blamed = ""
    for frame, line in traceback.walk_tb(error.__traceback__):
        block = frame.f_locals.get("self")
        if isinstance(block, LeafSystem):
            name = block.box() if isinstance(block, LeafBlock) else block.get_name()
            blamed = f"{name} ({Path(frame.f_code.co_filename).name}:{line}): "
    return blamed


def stable_config(config: SimulatorConfig, nonstop: Diagram, context: Context) -> SimulatorConfig:
    """The configuration with a step that the fixed-step Runge-Kutta scheme is stable at.

    Explicit schemes blow up, at first in silence, where the step is too long for the
    fastest mode; for the third-order one that is at 1.73 divided by the mode's rad/s.
    Steps of any other scheme, and shorter ones, are the user's.
    """
    if config.integration_scheme != "runge_kutta3" or config.use_error_control:
        return config
    mode = fastest_mode(nonstop, context)
    longest = _STABLE_STEP / mode
    require(
        longest >= _SHORTEST_STEP,
        "fastest mode",
        f"{mode:.3g} rad/s",
        f"give softer cables or heavier bodies; it asks for steps below {_SHORTEST_STEP:g} s",
    )
    if config.max_step_size > longest:
        # A whole part of the signals' period, so that no step is cut short by it.
        config = copy.deepcopy(config)
        config.max_step_size = SIGNAL_PERIOD / math.ceil(SIGNAL_PERIOD / longest)
    return config


class _SampleInstants(LeafBlock):
    """Has the integrator's steps end at the instants of the signals' samples.

    A log's own period does not: it starts at 0 and the controllers' at their first sample, so
    that a rounding apart every tenth step or so had no length.
    """

    def __init__(self) -> None:
        super().__init__()
        self.DeclarePeriodicPublishEvent(
            period_sec=SIGNAL_PERIOD, offset_sec=SIGNAL_PERIOD, publish=lambda context: None
        )


class _Monitor:
    """Takes samples, reports progress, asks what to do, and ends the run at a Ctrl-C's step.

    A KeyboardInterrupt raised wherever Python happens to be may surface, on its way through
    C++, as an error of a block or a solver; so the first Ctrl-C is only noted. A second one
    interrupts at once.
    """

    def __init__(
        self,
        simulator: Simulator,
        nonstop: Diagram,
        *,
        sample: Callable[[], None],
        progress: Callable[[float], None] | None,
        after_step: Callable[[Simulator, Diagram], StepAction] | None,
    ):
        self._simulator = simulator
        self._nonstop = nonstop
        self._sample = sample
        self._samples = 0
        self._progress = progress
        self._after_step = after_step
        self._last_report = 0.0
        self._previous_handler: Any = None
        self.is_interrupted = False
        self.waited = 0.0  # s of wall time

    def __call__(self, root_context: Context) -> EventStatus:
        if root_context.get_time() > (self._samples - _AT_SAMPLE) * SIGNAL_PERIOD:
            self._sample()
            self._samples += 1
        if self.is_interrupted:
            return EventStatus.ReachedTermination(self._nonstop, "interrupted")
        now = time.perf_counter()
        if self._progress is not None and now - self._last_report > _REPORT_PERIOD:
            self._last_report = now
            self._progress(root_context.get_time())
        if self._after_step is not None and self._ends():
            return EventStatus.ReachedTermination(self._nonstop, "ended")
        return EventStatus.DidNothing()

    def _ends(self) -> bool:
        then = self._after_step(self._simulator, self._nonstop)  # type: ignore[misc]
        if then is StepAction.WAIT:
            start = time.perf_counter()
            while then is StepAction.WAIT and not self.is_interrupted:
                time.sleep(_WAITING_PERIOD)
                then = self._after_step(self._simulator, self._nonstop)  # type: ignore[misc]
            self.waited += time.perf_counter() - start
            self._simulator.ResetStatistics()  # the real-time rate is kept from here on
        return then is StepAction.END or self.is_interrupted

    def __enter__(self) -> "_Monitor":
        if threading.current_thread() is threading.main_thread():
            self._previous_handler = signal.signal(signal.SIGINT, self._note)
        return self

    def __exit__(self, *exception: object) -> None:
        self._simulator.clear_monitor()  # each would keep the other for ever
        if self._previous_handler is not None:
            signal.signal(signal.SIGINT, self._previous_handler)

    def _note(self, number: int, frame: object) -> None:
        self.is_interrupted = True
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _stacked(builder: DiagramBuilder, ports: dict[str, OutputPort]) -> OutputPort:
    """One port for all: a sink per signal would slow every step of the diagram down."""
    multiplexer = builder.AddSystem(Multiplexer([port.size() for port in ports.values()]))
    for i, port in enumerate(ports.values()):
        builder.Connect(port, multiplexer.get_input_port(i))
    return multiplexer.get_output_port()


def _split(log: VectorLog, ports: dict[str, OutputPort]) -> tuple[NDArray, dict[str, NDArray]]:
    """The times of a log, and its stacked signals by name, (samples, size) each."""
    ends = np.cumsum([port.size() for port in ports.values()])
    pieces = np.split(log.data(), ends[:-1])
    signals = {name: piece.T.copy() for name, piece in zip(ports, pieces, strict=True)}
    return log.sample_times().copy(), signals


def _collect(
    scenario: Scenario,
    nonstop: Diagram,
    samples: tuple[NDArray, dict[str, NDArray]],
    steps: tuple[NDArray, dict[str, NDArray]],
    *,
    wall_time: float,
) -> Run:
    (times, signals), (step_times, step_signals) = samples, steps
    solve_times = np.zeros(0)
    if "diagnostics" in step_signals and _WALL_TIME in step_signals:
        updates = np.flatnonzero(np.diff(step_signals["diagnostics"][:, 1], prepend=0.0))
        solve_times = step_signals[_WALL_TIME][updates, 0]
    return Run(
        scenario=scenario,
        diagram=nonstop,
        time=SIGNAL_PERIOD * np.arange(len(times)),  # without the rounding of the events' times
        signals={
            f"{block.get_name()}.{name}": signals[name]
            for block in nonstop.GetSystems()
            for name in output_names(block)
            if name in signals
        },
        steps={"time": step_times} | step_signals,
        solve_times=solve_times,
        wall_time=wall_time,
    )
