"""A scenario to a run: the simulated signals of every block."""

import dataclasses
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import (
    ApplySimulatorConfig,
    GetIntegrationSchemes,
    Simulator,
)
from pydrake.systems.framework import (
    Context,
    Diagram,
    DiagramBuilder,
    LeafSystem,
    OutputPort,
    PortDataType,
    TriggerType,
)
from pydrake.systems.primitives import LogVectorOutput, Multiplexer, VectorLog

from drake_nonstop.blocks.fused_plant import FusedPlant
from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.optimization.diagnostics import Diagnostics
from drake_nonstop.scenario.scene_config import check_scene
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.simulation.diagnosis import raising_block, source_of_fault
from drake_nonstop.simulation.equilibrium import set_equilibrium
from drake_nonstop.simulation.interruption import ALL, Interruption, current_interruption
from drake_nonstop.simulation.monitor import Monitor, SampleInstants
from drake_nonstop.simulation.run import SIGNAL_PERIOD, Run, RunInterrupted, RunStopped, StepAction
from drake_nonstop.simulation.step_size import stable_config
from drake_nonstop.systems.tracing import LARGEST, NotFiniteError
from drake_nonstop.systems.wiring import output_names
from drake_nonstop.validation import ScenarioError, one_line, require

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


# Adds a system beside the loop's diagram, which the builder has already, and returns it.
Viewer = Callable[[DiagramBuilder, Diagram, Scenario], LeafSystem]


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
    with current_interruption() as interruption, interruption.patient(1):
        try:
            run = _simulate(scenario, interruption, progress, viewers, after_step, replacements)
        except RunStopped:
            raise
        except Exception:
            if interruption.count > 1:  # a KeyboardInterrupt that went through C++
                raise KeyboardInterrupt from None
            raise
    if interruption.number:
        raise RunInterrupted(run)
    return run


def _simulate(
    scenario: Scenario,
    interruption: Interruption,
    progress: Callable[[float], None] | None,
    viewers: Sequence[Viewer],
    after_step: Callable[[Simulator, Diagram], StepAction] | None,
    replacements: dict[str, Any],
) -> Run:
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
    check_scene(scenario.scene)
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
    builder.AddNamedSystem("sample_instants", SampleInstants())
    visualizers = [viewer(builder, nonstop, scenario) for viewer in viewers]
    simulator = Simulator(builder.Build())
    context = simulator.get_mutable_context()
    start = time.perf_counter()

    def finished() -> Run:
        interruption.patience = ALL  # nothing may come between a run and who keeps it
        return _collect(
            scenario,
            nonstop,
            _split(sample_sink.FindLog(context), sampled),
            _split(step_sink.FindLog(context), stepped),
            wall_time=time.perf_counter() - start - monitor.waited,
        )

    sample_context = sample_sink.GetMyContextFromRoot(context)
    monitor = Monitor(
        simulator,
        nonstop,
        interruption,
        sample=lambda: sample_sink.ForcedPublish(sample_context),
        progress=progress,
        after_step=after_step,
    )
    nonstop_context = nonstop.GetMyMutableContextFromRoot(context)
    try:
        set_equilibrium(nonstop, nonstop_context)
        ApplySimulatorConfig(stable_config(scenario.simulator, nonstop, nonstop_context), simulator)
        with monitor:
            simulator.set_monitor(monitor)
            start = time.perf_counter()
            interruption.collect = finished
            simulator.Initialize()
            simulator.AdvanceTo(scenario.duration)
            for visualizer in visualizers:  # the last step may have been skipped
                visualizer.ForcedPublish(visualizer.GetMyContextFromRoot(context))
    except KeyboardInterrupt:
        raise RunInterrupted(finished()) from None
    except NotFiniteError as error:
        raise RunStopped(
            f"the run diverged at t = {context.get_time():.4f} s: "
            f"{source_of_fault(error, nonstop, nonstop_context)} made a value that is not "
            f"finite, or beyond {LARGEST:.0e} in SI units; the loop may be unstable, or "
            "simulator.max_step_size too large",
            finished(),
        ) from None
    except BaseException as error:  # such as the SystemExit of a block
        if interruption.number:  # a KeyboardInterrupt that went through C++
            raise RunInterrupted(finished()) from None
        if isinstance(error, ScenarioError) and context.get_time() == 0:
            raise
        cause = f"{raising_block(error)}{one_line(error)}"
        message = f"the run stopped at t = {context.get_time():.4f} s: {cause}"
        raise RunStopped(message, finished()) from error
    finally:
        interruption.collect = None
    return finished()


def _at_equilibrium(nonstop: Diagram) -> Context:
    context = nonstop.CreateDefaultContext()
    set_equilibrium(nonstop, context)
    return context


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
        updates = np.flatnonzero(
            np.diff(Diagnostics.view(step_signals["diagnostics"]).updates, prepend=0.0)
        )
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
