"""A scenario to a run: the simulated signals of every block."""

import dataclasses
import time
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from pydrake.systems.analysis import (
    ApplySimulatorConfig,
    GetIntegrationSchemes,
    Simulator,
)
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, LeafSystem

from drake_nonstop.blocks.fused_plant import FusedPlant
from drake_nonstop.diagrams.nonstop import make_nonstop, replaced
from drake_nonstop.optimization.diagnostics import Diagnostics
from drake_nonstop.scenario.schema import Scenario, check
from drake_nonstop.simulation.diagnosis import raising_block, source_of_fault
from drake_nonstop.simulation.equilibrium import set_equilibrium
from drake_nonstop.simulation.monitor import Monitor, SampleInstants
from drake_nonstop.simulation.recording import WALL_TIME, Recording, RecordingError, require_room
from drake_nonstop.simulation.run import Run, RunInterrupted, RunStopped, StepAction
from drake_nonstop.simulation.step_size import stable_config
from drake_nonstop.systems.tracing import LARGEST, NotFiniteError
from drake_nonstop.validation import ScenarioError, ScenarioWarning, one_line, require

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
        replacements: blocks in place of the scenario's, see `make_nonstop`. Those with a config
            are in the run's scenario.

    Raises:
        ScenarioError: the scenario cannot be built, or there is no room for its signals.
        RunStopped: the run diverged, a block failed, or the disk is full; carries the run up to
            there.
        RunInterrupted: Ctrl-C; carries the run up to there.
    """
    check(scenario)
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
    stated = scenario.speed_bound
    scenario, replacements = replaced(scenario, replacements)
    nonstop = make_nonstop(scenario, **replacements)
    if any(isinstance(block, FusedPlant) for block in nonstop.GetSystems()):
        config = stable_config(scenario.simulator, nonstop, _at_equilibrium(nonstop))
        if config is not scenario.simulator:  # the steps are the block's own
            shorter = dataclasses.replace(scenario, simulator=config)
            nonstop = make_nonstop(shorter, **replacements)
    if after_step is None:  # which may end a run of any duration
        require_room(nonstop, scenario)
    builder = DiagramBuilder()
    builder.AddSystem(nonstop)
    recording = Recording(builder, nonstop)
    builder.AddNamedSystem("sample_instants", SampleInstants())
    visualizers = [viewer(builder, nonstop, scenario) for viewer in viewers]
    simulator = Simulator(builder.Build())
    context = simulator.get_mutable_context()
    recording.start(context)
    start = time.perf_counter()

    def finished(stopped: str = "") -> Run:
        wall_time = time.perf_counter() - start - monitor.waited
        return _collect(scenario, nonstop, recording, wall_time=wall_time, stopped=stopped)

    monitor = Monitor(
        simulator,
        nonstop,
        sample=recording.take_sample,
        progress=progress,
        after_step=after_step,
    )
    nonstop_context = nonstop.GetMyMutableContextFromRoot(context)
    try:
        set_equilibrium(nonstop, nonstop_context)
        _warn_of_other_bound(nonstop, nonstop_context, stated)
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
        message = f"the run was interrupted at t = {context.get_time():.4f} s"
        raise RunInterrupted(finished(message)) from None
    except NotFiniteError as error:
        message = (
            f"the run diverged at t = {context.get_time():.4f} s: "
            f"{source_of_fault(error, nonstop, nonstop_context)} made a value that is not "
            f"finite, or beyond {LARGEST:.0e} in SI units; the loop may be unstable, or "
            "simulator.max_step_size too large"
        )
        raise RunStopped(message, finished(message)) from None
    except RecordingError as error:
        message = f"the run stopped at t = {context.get_time():.4f} s: {error}"
        raise RunStopped(message, finished(message)) from None
    except Exception as error:
        cause = f"{raising_block(error)}{one_line(error)}"
        message = f"the run stopped at t = {context.get_time():.4f} s: {cause}"
        raise RunStopped(message, finished(message)) from error
    if context.get_time() < scenario.duration:
        return finished(f"the run was ended at t = {context.get_time():.4f} s")
    return finished()


def _warn_of_other_bound(nonstop: Diagram, context: Context, stated: float) -> None:
    """Warns where a replacement brings a speed bound of its own, by which a run is judged."""
    if nonstop.HasOutputPort("speed_bound"):
        (own,) = nonstop.GetOutputPort("speed_bound").Eval(context)
        if own != stated:
            message = (
                f"optimization_layer: the run is judged by the {own:g} m/s of the replacement, "
                f"not by the scenario's speed bound of {stated:g} m/s"
            )
            warnings.warn(message, ScenarioWarning, stacklevel=3)


def _at_equilibrium(nonstop: Diagram) -> Context:
    context = nonstop.CreateDefaultContext()
    set_equilibrium(nonstop, context)
    return context


def _collect(
    scenario: Scenario,
    nonstop: Diagram,
    recording: Recording,
    *,
    wall_time: float,
    stopped: str,
) -> Run:
    times, signals, steps = recording.collect()
    solve_times = np.zeros(0)
    if "diagnostics" in steps and WALL_TIME in steps:
        updates = np.flatnonzero(
            np.diff(Diagnostics.view(steps["diagnostics"]).updates, prepend=0.0)
        )
        solve_times = steps[WALL_TIME][updates, 0]
    return Run(
        scenario=scenario,
        diagram=nonstop,
        time=times,
        signals=signals,
        steps=steps,
        solve_times=solve_times,
        wall_time=wall_time,
        stopped=stopped,
    )
