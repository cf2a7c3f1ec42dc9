"""A run in the making: its loop, what flies and records it, and what ends it."""

import contextlib
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from pydrake.systems.analysis import (
    ApplySimulatorConfig,
    InitializeParams,
    Simulator,
    SimulatorConfig,
)
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, LeafSystem

from drake_nonstop.diagrams.nonstop import make_nonstop, replaced
from drake_nonstop.loop.start import PlantStates, set_equilibrium
from drake_nonstop.loop.step import with_largest_step
from drake_nonstop.run.compiled_run import (
    NOT_COMPILED,
    CompiledRun,
    reason_not_compiled,
    recorded_loop,
)
from drake_nonstop.run.interruption import ALL, Interruption
from drake_nonstop.run.monitor import EndingBlocks, Monitor
from drake_nonstop.run.preparation import (
    LoopMaker,
    check_simulation,
    loop_of,
)
from drake_nonstop.run.recording import (
    RUN_SIGNALS,
    LogSignals,
    RecordingError,
)
from drake_nonstop.run.run import Run, RunInterrupted, RunStopped, StepAction
from drake_nonstop.scenario.fields import warn_of_angles
from drake_nonstop.scenario.schema import COMPILED, DIAGRAM, ENGINES, Scenario, check, drawn
from drake_nonstop.systems.diagnosis import raising_block, source_of_fault
from drake_nonstop.systems.tracing import LARGEST, NotFiniteError
from drake_nonstop.systems.wiring import loop_in
from drake_nonstop.validation import (
    ScenarioError,
    ScenarioWarning,
    called,
    one_line,
    require,
    warn_user,
)

# Adds a system beside the loop's diagram, which the builder has already, and returns it.
Viewer = Callable[[DiagramBuilder, Diagram, Scenario], LeafSystem]


def require_engine(engine: str | None) -> None:
    """Raises ScenarioError where this argument of `simulate` is none."""
    remedy = f"give {', '.join(ENGINES)}, or None"
    is_one = engine is None or (isinstance(engine, str) and engine in ENGINES)
    require(is_one, "engine", engine, remedy)


class Flight:
    """A run in the making, stage by stage.

    It is built here; `prepare` finds its start and its step; `compiled_run.fly_together` flies what
    a compiled loop can; `finish` has Drake's Simulator fly the rest, and returns what was recorded.
    What ends a stage goes through `kept`.

    Args:
        interruption: what Ctrl-C leaves.
        scenario, ...: as of `simulate`.
        flights: runs like it that are to be flown.

    Attributes:
        scenario: with the configs of the replacements, and with drawn numbers.
        nonstop: the loop's diagram.
        engine: the one that flies it, as in `Run`.
        context: of the diagram around the loop.
        compiled: what the compiled engine flies of it: one, or none.

    Raises:
        ScenarioError: the loop cannot be built.
    """

    def __init__(
        self,
        interruption: Interruption,
        scenario: Scenario,
        *,
        progress: Callable[[float], None] | None = None,
        viewers: Sequence[Viewer] = (),
        after_step: Callable[[Simulator, Diagram], StepAction] | None = None,
        make_loop: LoopMaker | None = None,
        engine: str | None = None,
        flights: int = 1,
        **replacements: Any,
    ):
        check(scenario)
        require_engine(engine)
        remedy = "give a function that takes a scenario and returns a Diagram, such as make_nonstop"
        require(make_loop is None or callable(make_loop), "make_loop", make_loop, remedy)
        remedy = "give a list of functions, such as [show_in(meshcat)]"
        require(isinstance(viewers, (list, tuple)), "viewers", viewers, remedy)
        for viewer in viewers:
            require(callable(viewer), "viewers", viewer, remedy)
        remedy = "give a function of the Simulator and its diagram that returns a StepAction"
        require(after_step is None or callable(after_step), "after_step", after_step, remedy)
        self._interruption, self._flights = interruption, flights
        own, _ = drawn(scenario)
        self._replacements = dict[str, Any]()
        if replacements:
            own, self._replacements = replaced(scenario, replacements)
            own = own.sampled()
        self.scenario, self._asked_engine = own, engine or own.engine
        check_simulation(own)
        self.nonstop = loop_of(make_loop or make_nonstop, own, self._replacements)
        if make_loop is not None:
            self._replacements = {"make_loop": make_loop, **self._replacements}
        builder = DiagramBuilder()
        builder.AddSystem(self.nonstop)
        self._logs = LogSignals(builder, self.nonstop, uses_files=True)
        remedy = "give functions that take the builder, the loop's diagram and the scenario"
        self._visualizers = [
            called("viewers", remedy, viewer, builder, self.nonstop, own) for viewer in viewers
        ]
        self._simulator = Simulator(builder.Build())
        self.context = self._simulator.get_mutable_context()
        self._ending = EndingBlocks(loop_in(self.nonstop, RUN_SIGNALS), self.context)
        self._monitor = Monitor(
            self._simulator,
            self.nonstop,
            interruption,
            progress=progress,
            after_step=after_step,
            ending=self._ending,
        )
        given = {"viewers": viewers, "after_step": after_step}
        self._steering = [name for name, value in given.items() if value]
        self._start = time.perf_counter()
        self.engine, self.compiled = DIAGRAM, list[CompiledRun]()

    @property
    def _loop_context(self) -> Context:
        return self.nonstop.GetMyMutableContextFromRoot(self.context)

    def prepare(self) -> None:
        """Sets the equilibrium and the integrator's step, and makes the compiled loop.

        Where there is none the run's `engine` says why, and so does a ScenarioWarning where
        `compiled` was asked for.
        """
        scenario, nonstop = self.scenario, self.nonstop
        self._interruption.check()  # and again after what takes long
        set_equilibrium(nonstop, self._loop_context, start_error=scenario.start_error)
        self._interruption.check()
        PlantStates(nonstop).declare_defaults(self._loop_context)
        warn_of_angles(scenario)
        config = with_largest_step(scenario.simulator_config, nonstop, self._loop_context)
        ApplySimulatorConfig(config, self._simulator)
        self._interruption.check()
        if self._asked_engine != DIAGRAM:
            self._compile(config)
            self._interruption.check()
        self._start = time.perf_counter()

    def _compile(self, config: SimulatorConfig) -> None:
        scenario, logs, period = self.scenario, self._logs, self.scenario.control_period
        reason = reason_not_compiled(scenario, logs, config, self._steering)
        if reason:
            self._tell_not_compiled(f"{reason};")
            self.engine = f"{DIAGRAM}: {reason}"
            return
        duration = scenario.simulation_duration
        loop = recorded_loop(logs, config, period, compiles=None)
        loop.prepare(int(duration / period), self._flights)
        run = CompiledRun(loop, logs, self.context, self._ending, self._monitor, duration)
        self.engine, self.compiled = f"{COMPILED}: {run.evaluator}", [run]

    def _tell_not_compiled(self, reason: str) -> None:
        if self._asked_engine == COMPILED:
            warn_user(f"{NOT_COMPILED}: {reason} the diagram is simulated instead")

    def finish(self) -> Run:
        """Flies what no compiled loop has flown by Drake's Simulator; the run."""
        is_begun = False
        for compiled in self.compiled:
            if compiled.error is not None:
                raise compiled.error
            is_begun = compiled.is_begun
            if compiled.failure:
                self._tell_not_compiled(compiled.failure)
                self.engine += f", {DIAGRAM}: {compiled.failure}"
            elif not is_begun:
                self.engine = f"{DIAGRAM}: shorter than a sample of the controllers"
        self._simulator.set_monitor(self._monitor)
        try:
            if not (is_begun and self._is_over):
                parameters = InitializeParams(suppress_initialization_events=is_begun)
                self._simulator.Initialize(parameters)
                if not self._monitor.has_ended:
                    self._simulator.AdvanceTo(self.scenario.simulation_duration)
            for visualizer in self._visualizers:  # the last step may have been skipped
                visualizer.ForcedPublish(visualizer.GetMyContextFromRoot(self.context))
        finally:
            self._simulator.clear_monitor()  # each would keep the other alive
        return self._run(self._early_end)

    @property
    def _is_over(self) -> bool:
        is_cut = self._monitor.has_ended or self._interruption.number > 0
        return is_cut or self.context.get_time() >= self.scenario.simulation_duration

    def _run(self, stopped: str) -> Run:
        """The part that has been flown, and what has stopped it."""
        self._interruption.patience = ALL  # nothing may come between a run and who keeps it
        return Run.from_logs(
            self._logs,
            self.context,
            self.scenario,
            step=self._simulator.get_integrator().get_maximum_step_size(),
            wall_time=time.perf_counter() - self._start - self._monitor.waited,
            engine=self.engine,
            stopped=stopped,
            replacements=self._replacements,
        )

    @property
    def _early_end(self) -> str:
        """Reason for an early end; "": there is none, or it is a block's own decision."""
        if self._interruption.number:
            return self._interrupted
        is_early = self.context.get_time() < self.scenario.simulation_duration
        return f"the run was ended{self._now}" if is_early and not self._monitor.has_ended else ""

    @property
    def _interrupted(self) -> str:
        return f"the run was interrupted at t = {self._monitor.time:.4f} s"

    @property
    def _now(self) -> str:
        return f" at t = {self.context.get_time():.4f} s"

    def _stopped(self, cause: str) -> RunStopped:
        message = f"the run {cause}"
        return RunStopped(message, self._run(message))

    @contextlib.contextmanager
    def kept(self) -> Iterator[None]:
        """Has whatever ends the flight carry the run up to there.

        Raises:
            RunStopped: it diverged, a block failed, or the disk is full.
            RunInterrupted: Ctrl-C.
            ScenarioError: it cannot begin.
        """
        try:
            yield
        except KeyboardInterrupt:
            raise RunInterrupted(self._run(self._interrupted)) from None
        except NotFiniteError as error:
            source = source_of_fault(error, self.nonstop, self._loop_context)
            raise self._stopped(
                f"diverged{self._now}: {source} made a value that is not finite, or beyond "
                f"{LARGEST:.0e} in SI units; the loop may be unstable, or "
                "simulator_config.max_step_size too large"
            ) from None
        except RecordingError as error:
            raise self._stopped(f"stopped{self._now}: {error}") from None
        except BaseException as error:  # such as the SystemExit of a block
            if self._interruption.number:  # which may have become another error in C++
                raise RunInterrupted(self._run(self._interrupted)) from None
            if isinstance(error, ScenarioError) and self.context.get_time() == 0:
                raise
            raise self._stopped(
                f"stopped{self._now}: {raising_block(error)}{one_line(error)}"
            ) from error


@contextlib.contextmanager
def without_warnings() -> Iterator[None]:
    """Leaves out what a scenario's warnings have told already."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ScenarioWarning)
        yield
