"""A scenario to a run: the simulated signals of every block."""

import contextlib
import dataclasses
import functools
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from pydrake.systems.analysis import (
    ApplySimulatorConfig,
    GetIntegrationSchemes,
    InitializeParams,
    Simulator,
)
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, LeafSystem

from drake_nonstop.diagrams.nonstop import make_nonstop, replaced
from drake_nonstop.loop.block_events import NotCompilableError
from drake_nonstop.loop.equilibrium import block_named, set_equilibrium
from drake_nonstop.loop.plant_states import PlantStates
from drake_nonstop.scenario.proportions import out_of_proportion, warn_of_angles
from drake_nonstop.scenario.scene_config import check_scene
from drake_nonstop.scenario.schema import AUTO, COMPILED, DIAGRAM, Scenario, check
from drake_nonstop.simulation.aircraft_margins import margins_of_loop
from drake_nonstop.simulation.compiled_run import CompiledRun, compiled_loop_of, tell_not_compiled
from drake_nonstop.simulation.formation import growth_complaint
from drake_nonstop.simulation.interruption import ALL, Interruption, current_interruption
from drake_nonstop.simulation.monitor import Monitor, SampleInstants
from drake_nonstop.simulation.recording import (
    RUN_SIGNALS,
    Recording,
    RecordingError,
    control_period_of,
    require_room,
)
from drake_nonstop.simulation.run import (
    Run,
    RunInterrupted,
    RunStopped,
    StepAction,
    StepCheck,
)
from drake_nonstop.simulation.short_flights import SavedState
from drake_nonstop.simulation.step_check import (
    SavedStates,
    compared,
    growth_in_doubt,
    in_doubt,
    is_in_doubt,
)
from drake_nonstop.simulation.step_size import ChosenStep, chosen_step, with_half_the_step
from drake_nonstop.simulation.task import task_of_loop
from drake_nonstop.systems.block import LOOP, is_of_package, release
from drake_nonstop.systems.diagnosis import raising_block, source_of_fault
from drake_nonstop.systems.tracing import LARGEST, NotFiniteError
from drake_nonstop.systems.wiring import innermost, input_names, nested, require_signals
from drake_nonstop.validation import ScenarioError, ScenarioWarning, called, one_line, require

# Makes the loop's diagram of a scenario, and of replacements as `make_nonstop` takes them.
LoopMaker = Callable[..., Diagram]

# Adds a system beside the loop's diagram, which the builder has already, and returns it.
Viewer = Callable[[DiagramBuilder, Diagram, Scenario], LeafSystem]


def simulate(
    scenario: Scenario,
    *,
    progress: Callable[[float], None] | None = None,
    viewers: Sequence[Viewer] = (),
    after_step: Callable[[Simulator, Diagram], StepAction] | None = None,
    check_step: StepCheck = StepCheck.WHOLE,
    make_loop: LoopMaker | None = None,
    engine: str | None = None,
    **replacements: Any,
) -> Run:
    """Simulates a scenario from its equilibrium and returns all signals.

    The step is the scenario's, or a shorter one where the loop's fastest mode or the commanded
    motion needs it; a ScenarioWarning says so. Parts of the run are flown again with half the
    step. Where that makes a difference the whole run is, and `Run.unresolved` says which metrics
    move.

    Args:
        scenario: what to run; where fields hold distributions, numbers are drawn with its
            `random_seed`, and are in the run's scenario.
        progress: called with the simulated time now and then.
        viewers: functions that show the run while it goes on, such as `show_in(meshcat)`. Each
            adds a system to the builder, connected to the loop's diagram, and returns it. A
            forced publish of the system shows the end of the run.
        after_step: called with the simulator and the loop's diagram after every step. It may
            change parameters of the context, such as the optimization layer's ε, or the
            simulator's real-time rate, and have the run wait or end.
        check_step: what is flown again with half the step. With `after_step`, which may change a
            run, no more than PARTS are; what is in doubt then is said to be unresolved.
        make_loop: makes the loop's diagram of a scenario and of the replacements without a config;
            None: `make_nonstop` does. One of the user's own exports its signals by their names,
            as `connect_by_name` does; the loop may be inside of it.
        engine: "diagram" or "compiled", in place of the scenario's; None: that.
        replacements: blocks in place of the scenario's, and `extra` ones, see `make_nonstop`.
            Those with a config are in the run's scenario.

    Raises:
        ScenarioError: the scenario cannot be built, or there is no room for its signals.
        RunStopped: the run diverged, a block failed, or the disk is full; carries the run up to
            there.
        RunInterrupted: Ctrl-C; carries the run up to there.
    """
    with current_interruption() as interruption, interruption.patient(1):
        try:
            fly = functools.partial(
                _simulate,
                scenario,
                interruption,
                progress,
                viewers,
                after_step,
                check_step,
                make_nonstop if make_loop is None else make_loop,
                replacements=replacements,
            )
            try:
                run = fly(engine)
            except NotCompilableError as error:
                tell_not_compiled(f"{error};", stacklevel=3)
                with _told():
                    run = fly(DIAGRAM)
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
    check_step: StepCheck,
    make_loop: LoopMaker,
    engine: str | None,
    replacements: dict[str, Any],
) -> Run:
    check(scenario)
    remedy = f"give {DIAGRAM} or {COMPILED}, or None"
    require(engine in (None, DIAGRAM, COMPILED), "engine", engine, remedy)
    engine = engine or scenario.engine
    remedy = "give a function that takes a scenario and returns a Diagram, such as make_nonstop"
    require(callable(make_loop), "make_loop", make_loop, remedy)
    remedy = "give a list of functions, such as [show_in(meshcat)]"
    require(isinstance(viewers, (list, tuple)), "viewers", viewers, remedy)
    for viewer in viewers:
        require(callable(viewer), "viewers", viewer, remedy)
    is_second = interruption.collect is not None  # of a run that is there already
    stated = scenario.sampled().speed_bound
    scenario, replacements = replaced(scenario, replacements)
    scenario = scenario.sampled()
    arguments = (
        replacements if make_loop is make_nonstop else {"make_loop": make_loop, **replacements}
    )
    check_simulation(scenario)
    nonstop = _loop(make_loop, scenario, replacements)
    builder = DiagramBuilder()
    builder.AddSystem(nonstop)
    recording = Recording(builder, nonstop)
    builder.AddNamedSystem("sample_instants", SampleInstants(control_period_of(nonstop)))
    remedy = "give functions that take the builder, the loop's diagram and the scenario"
    visualizers = [called("viewers", remedy, v, builder, nonstop, scenario) for v in viewers]
    simulator = Simulator(builder.Build())
    context = simulator.get_mutable_context()
    recording.start(context)
    start = time.perf_counter()

    def interrupted() -> str:
        return f"the run was interrupted at t = {monitor.time:.4f} s"

    def finished(stopped: str = "") -> Run:
        interruption.patience = ALL  # nothing may come between a run and who keeps it
        return Run.from_logs(
            recording,
            context,
            scenario,
            step=simulator.get_integrator().get_maximum_step_size(),
            wall_time=time.perf_counter() - start - monitor.waited,
            stopped=stopped,
            replacements=arguments,
        )

    saved = SavedStates()

    flown: CompiledRun | None = None

    def sample(now: float) -> None:
        if flown is None:
            recording.take_sample()
        if now >= saved.next_time:
            saved.save(SavedState.of(nonstop_context) if flown is None else flown.saved_state())

    monitor = Monitor(
        simulator,
        nonstop,
        interruption,
        sample=sample,
        progress=progress,
        after_step=after_step,
        is_over=_end(nonstop, context),
    )
    nonstop_context = nonstop.GetMyMutableContextFromRoot(context)
    try:
        set_equilibrium(nonstop, nonstop_context)
        PlantStates(nonstop).declare_defaults(nonstop_context)
        _warn_of_other_bound(nonstop, nonstop_context, stated)
        if not is_second:  # it has been said
            warn_of_angles(scenario)
            _warn_of_margins(scenario, nonstop, nonstop_context)
            _warn_of_growth(scenario, nonstop, nonstop_context)
        chosen = with_chosen_step(scenario, nonstop, nonstop_context)
        if after_step is None:  # which may end a run of any duration
            require_room(nonstop, dataclasses.replace(scenario, simulator_config=chosen.config))
        ApplySimulatorConfig(chosen.config, simulator)
        given = {"viewers": viewers, "after_step": after_step}
        steering = [name for name, value in given.items() if value]
        loop = compared = None
        if engine == COMPILED:
            loop = compiled_loop_of(scenario, nonstop, recording, chosen.config, steering)
        if loop is not None and not all(map(is_of_package, nonstop.GetSystems())):
            with _told():
                compared = Simulator(_loop(make_loop, scenario, replacements))
            ApplySimulatorConfig(chosen.config, compared)
        with monitor:
            simulator.set_monitor(monitor)
            start = time.perf_counter()
            if not is_second:
                interruption.collect = lambda: finished(interrupted())
            is_begun = False
            if loop is not None:
                flown = CompiledRun(loop, recording, context, _ending(nonstop), compared)
                is_begun = flown.fly(scenario.simulation_duration, monitor, lambda: saved.next_time)
                flown = None
            is_over = monitor.has_ended or interruption.number > 0
            is_over |= context.get_time() >= scenario.simulation_duration
            if not (is_begun and is_over):
                if is_begun:
                    recording.drop_last_step()
                simulator.Initialize(InitializeParams(suppress_initialization_events=is_begun))
                if not monitor.has_ended:
                    simulator.AdvanceTo(scenario.simulation_duration)
            for visualizer in visualizers:  # the last step may have been skipped
                visualizer.ForcedPublish(visualizer.GetMyContextFromRoot(context))
    except NotCompilableError:
        release(nonstop)
        raise
    except KeyboardInterrupt:
        raise RunInterrupted(finished(interrupted())) from None
    except NotFiniteError as error:
        message = (
            f"the run diverged at t = {context.get_time():.4f} s: "
            f"{source_of_fault(error, nonstop, nonstop_context)} made a value that is not "
            f"finite, or beyond {LARGEST:.0e} in SI units; "
            + _cause_of_divergence(scenario, nonstop, context.get_time())
        )
        raise RunStopped(message, finished(message)) from None
    except RecordingError as error:
        message = f"the run stopped at t = {context.get_time():.4f} s: {error}"
        raise RunStopped(message, finished(message)) from None
    except BaseException as error:  # such as the SystemExit of a block
        if interruption.number:  # which may have become another error on its way through C++
            raise RunInterrupted(finished(interrupted())) from None
        if isinstance(error, ScenarioError) and context.get_time() == 0:
            raise
        cause = f"{raising_block(error)}{one_line(error)}"
        message = f"the run stopped at t = {context.get_time():.4f} s: {cause}"
        raise RunStopped(message, finished(message)) from error
    finally:
        if not is_second:
            interruption.collect = None
    if interruption.number:
        return finished(interrupted())
    if monitor.has_ended:
        return finished()  # as it is: another step may end it elsewhere
    if context.get_time() < scenario.simulation_duration:
        return finished(f"the run was ended at t = {context.get_time():.4f} s")
    run = finished()
    if chosen.unresolved and check_step is not StepCheck.NOTHING:
        return dataclasses.replace(run, unresolved=(chosen.unresolved,))
    if check_step is StepCheck.NOTHING:
        return run
    if is_in_doubt(run, saved.states, nonstop_context):
        doubt = in_doubt(run)
    elif chosen.is_in_doubt:
        doubt = growth_in_doubt(run)
    else:
        return run
    if check_step is StepCheck.PARTS or after_step is not None:
        return dataclasses.replace(run, unresolved=(doubt,))
    return _verified(run, progress, doubt, engine)


@contextlib.contextmanager
def _told() -> Iterator[None]:
    """Leaves out what a scenario's warnings have told already."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ScenarioWarning)
        yield


def verify_step(run: Run, *, progress: Callable[[float], None] | None = None) -> Run:
    """Flies a run's scenario again with half its steps; the run with what that shows.

    `unresolved` has a sentence for each metric that moves, see `moved_metrics`; `half_step` has the
    shorter step in s and both values of each of these metrics by its path.

    Args:
        run: what is verified; one that was not steered.
        progress: as of `simulate`.

    Raises:
        ScenarioError: the run is not one of `simulate`.
        RunInterrupted: Ctrl-C; carries the run.
    """
    remedy = "give a run of simulate, which can make the loop again (make_loop=...)"
    require(run.replacements is not None, "run", "from logs", remedy)
    return _verified(run, progress)


def _verified(
    run: Run,
    progress: Callable[[float], None] | None,
    doubt: str = "",
    engine: str | None = None,
) -> Run:
    """As `verify_step`; an interrupted run keeps the doubt for which it is flown again."""
    finer = with_half_the_step(run.scenario.simulator_config, run.step)
    duration = float(run.steps["time"][-1])
    scenario = dataclasses.replace(
        run.scenario, simulator_config=finer, simulation_duration=duration
    )
    doubted = dataclasses.replace(run, unresolved=(*run.unresolved, doubt)) if doubt else run
    try:
        with _told(), current_interruption() as interruption:
            interruption.collect = lambda: doubted
            half = simulate(
                scenario,
                progress=progress,
                check_step=StepCheck.NOTHING,
                engine=None if engine == AUTO else engine,
                **(run.replacements or {}),
            )
    except RunInterrupted:
        raise RunInterrupted(doubted) from None
    except (RunStopped, ScenarioError) as error:
        said = f"with half of the steps of {1e3 * run.step:.3g} ms {error}"
        return dataclasses.replace(run, unresolved=(*run.unresolved, said))
    finally:
        interruption.collect = None
    return compared(run, half)


def _loop(make_loop: LoopMaker, scenario: Scenario, replacements: dict[str, Any]) -> Diagram:
    """The loop's diagram, whose contexts need not start at the equilibrium.

    Raises:
        ScenarioError: it is none, does not export its signals, or has inputs that nothing makes.
    """
    if make_loop is make_nonstop:
        replacements = {"at_equilibrium": False, **replacements}
    remedy = "give a function that takes a scenario and replacements, as make_nonstop does"
    nonstop = called("make_loop", remedy, make_loop, scenario, **replacements)
    require(
        isinstance(nonstop, Diagram), "make_loop", nonstop, "return a Diagram from the function"
    )
    require_signals(nonstop, RUN_SIGNALS, "make_loop")
    missing = ", ".join(input_names(nonstop))
    remedy = "no block makes these signals; give one that does, in a box or as an extra one"
    require(not missing, "inputs", missing, remedy)
    if not nonstop.get_name():
        nonstop.set_name(LOOP)
    return nonstop


def check_simulation(scenario: Scenario) -> None:
    """Raises ScenarioError for what a loop is built without and no run is flown with."""
    schemes = GetIntegrationSchemes()
    require(
        scenario.simulator_config.integration_scheme in schemes,
        "simulator_config.integration_scheme",
        scenario.simulator_config.integration_scheme,
        f"give one of {', '.join(schemes)}",
    )
    check_scene(scenario.scene)


def with_chosen_step(scenario: Scenario, nonstop: Diagram, context: Context) -> ChosenStep:
    """The scenario's `simulator_config`, or one with a shorter step, which a warning tells."""
    try:
        with block_named(nonstop, context):
            chosen = chosen_step(
                scenario.simulator_config,
                nonstop,
                context,
                control_period=scenario.control_period,
                duration=scenario.simulation_duration,
                length=scenario.system.cable_length,
            )
    except ScenarioError as error:
        raise ScenarioError("; ".join([str(error), *out_of_proportion(scenario)])) from None
    if chosen.reasons:
        warnings.warn(
            f"simulator_config.max_step_size = {scenario.simulator_config.max_step_size:g}: "
            f"steps of {chosen.config.max_step_size:.3g} s are taken instead, for the sake of "
            f"{' and '.join(chosen.reasons)}",
            ScenarioWarning,
            stacklevel=4,
        )
    return chosen


def _warn_of_margins(scenario: Scenario, nonstop: Diagram, context: Context) -> None:
    """Warns where aircraft cannot fly the orbit above the resting load within their limits."""
    if not nonstop.HasOutputPort("aircraft_state"):
        return
    with contextlib.suppress(ScenarioError):  # there is no such orbit
        found = margins_of_loop(scenario, nonstop, context)
        if not found.is_flyable:
            message = f"{found.verdict}; drake-nonstop check shows all margins"
            warnings.warn(message, ScenarioWarning, stacklevel=4)


def _growth_complaint(
    scenario: Scenario, nonstop: Diagram, context: Context, time: float, *, in_samples: bool
) -> str:
    """What to say of a formation that is unstable at the start, in a flight of a time in s."""
    with contextlib.suppress(ScenarioError):  # what is no formation
        task = task_of_loop(scenario, *innermost(nonstop, context, RUN_SIGNALS))
        if task is not None:
            return growth_complaint(task, time, in_samples=in_samples)
    return ""


def _warn_of_growth(scenario: Scenario, nonstop: Diagram, context: Context) -> None:
    """Warns where a small deviation of the load grows from the start on."""
    duration = scenario.simulation_duration
    complaint = _growth_complaint(scenario, nonstop, context, duration, in_samples=False)
    if complaint:
        warnings.warn(complaint, ScenarioWarning, stacklevel=4)


_FOUR_DIGITS: Any = {"float_kind": "{:.4g}".format}


def _cause_of_divergence(scenario: Scenario, nonstop: Diagram, time: float) -> str:
    """Why a run may have diverged at a time in s, and the gains with which it did."""
    cause = "; ".join(out_of_proportion(scenario))
    if not cause:
        context = nonstop.CreateDefaultContext()
        cause = _growth_complaint(scenario, nonstop, context, time, in_samples=True)
    cause = cause or "the loop may be unstable, or simulator_config.max_step_size too large"
    gains = [
        f"{block.get_name()}.{name} = {np.array2string(np.asarray(value), formatter=_FOUR_DIGITS)}"
        for block in nested(nonstop, RUN_SIGNALS)[-1].GetSystems()
        for name, value in getattr(block, "gains", {}).items()
    ]
    return f"{cause}; gains in use: {', '.join(gains)}" if gains else cause


def _warn_of_other_bound(nonstop: Diagram, context: Context, stated: float) -> None:
    """Warns where a replacement brings a speed bound of its own, by which a run is judged."""
    if nonstop.HasOutputPort("speed_bound") and not nonstop.HasOutputPort("speed_bound_command"):
        (own,) = nonstop.GetOutputPort("speed_bound").Eval(context)
        if own != stated:
            message = (
                f"optimization_layer: the run is judged by the {own:g} m/s of the replacement, "
                f"not by the scenario's speed bound of {stated:g} m/s"
            )
            warnings.warn(message, ScenarioWarning, stacklevel=4)


def _ending(nonstop: Diagram) -> list[Any]:
    """The blocks of the loop that may end the run, with a method `ends_run(context, shown)`.

    It gets the block's own context, and what the port shows that `ending_signal` names.
    """
    loop = nested(nonstop, RUN_SIGNALS)[-1]
    return [block for block in loop.GetSystems() if hasattr(block, "ends_run")]


def _end(nonstop: Diagram, context: Context) -> Callable[[], bool] | None:
    """Whether a block ends the run, of those that may; None: there are none."""
    blocks = _ending(nonstop)
    if not blocks:
        return None

    def ends(block: Any) -> bool:
        own = block.GetMyContextFromRoot(context)
        return bool(block.ends_run(own, block.GetOutputPort(block.ending_signal).Eval(own)))

    return lambda: any(map(ends, blocks))
