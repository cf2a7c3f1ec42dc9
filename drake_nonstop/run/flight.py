"""A run in the making: its loop, what flies and records it, and what ends it."""

import contextlib
import dataclasses
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from pydrake.systems.analysis import (
    ApplySimulatorConfig,
    InitializeParams,
    Simulator,
    SimulatorConfig,
)
from pydrake.systems.framework import Context, Diagram

from drake_nonstop.diagrams.nonstop import make_nonstop, replaced
from drake_nonstop.loop.start import PlantStates, set_equilibrium
from drake_nonstop.run.built_loop import BuiltLoop, Viewer
from drake_nonstop.run.compiled_run import (
    CompiledRun,
    Flying,
    compiled_loop_of,
    tell_not_compiled,
)
from drake_nonstop.run.interruption import ALL, Interruption
from drake_nonstop.run.monitor import EndingBlocks, Monitor
from drake_nonstop.run.preparation import (
    LoopMaker,
    cause_of_divergence,
    check_simulation,
    stable_config,
    warn_of_other_bound,
)
from drake_nonstop.run.recording import (
    RUN_SIGNALS,
    RecordingError,
    require_room,
)
from drake_nonstop.run.run import Run, RunInterrupted, RunStopped, StepAction
from drake_nonstop.scenario.fields import warn_of_angles
from drake_nonstop.scenario.schema import COMPILED, DIAGRAM, ENGINES, Scenario, check, drawn
from drake_nonstop.systems.diagnosis import raising_block, source_of_fault
from drake_nonstop.systems.tracing import LARGEST, NotFiniteError
from drake_nonstop.systems.wiring import loop_in
from drake_nonstop.validation import ScenarioError, ScenarioWarning, one_line, require


@dataclass(frozen=True, kw_only=True)
class Request:
    """Request to `simulate`; the fields are its arguments.

    Raises:
        ScenarioError: one of them is none.
    """

    scenario: Scenario
    progress: Callable[[float], None] | None = None
    viewers: Sequence[Viewer] = ()
    after_step: Callable[[Simulator, Diagram], StepAction] | None = None
    make_loop: LoopMaker = make_nonstop
    engine: str | None = None
    flights: int = 1  # runs like it that are to be flown; not one of the arguments
    replacements: dict[str, Any] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        check(self.scenario)
        require_engine(self.engine)
        remedy = "give a function that takes a scenario and returns a Diagram, such as make_nonstop"
        require(callable(self.make_loop), "make_loop", self.make_loop, remedy)
        remedy = "give a list of functions, such as [show_in(meshcat)]"
        require(isinstance(self.viewers, (list, tuple)), "viewers", self.viewers, remedy)
        for viewer in self.viewers:
            require(callable(viewer), "viewers", viewer, remedy)

    @property
    def asked_engine(self) -> str:
        """The engine in place of the scenario's, or that."""
        return self.engine or self.scenario.engine


def require_engine(engine: str | None) -> None:
    """Raises ScenarioError where this argument of `simulate` is none."""
    remedy = f"give {', '.join(ENGINES)}, or None"
    require(engine in (None, *ENGINES), "engine", engine, remedy)


class Flight:
    """One flight of a request's loop.

    Attributes:
        scenario: with the configs of the replacements, and with drawn numbers.
        nonstop: the loop's diagram.
        engine: the one that flies it, as in `Run`.
        context: of the diagram around the loop.
        monitor: what happens after its steps.

    Raises:
        ScenarioError: the loop cannot be built.
    """

    def __init__(self, request: Request, interruption: Interruption):
        self._request, self._interruption = request, interruption
        self._is_second = interruption.collect is not None  # of a run that is there already
        self._replacements: dict[str, Any] = {}
        scenario, _ = drawn(request.scenario)  # which the request has checked
        self._stated_bound = scenario.speed_bound
        if request.replacements:
            scenario, self._replacements = replaced(request.scenario, request.replacements)
            scenario = scenario.sampled()
        self.scenario = scenario
        check_simulation(scenario)
        made = request.make_loop, scenario, self._replacements
        self._loop = BuiltLoop(*made, request.viewers)
        self.nonstop = nonstop = self._loop.nonstop
        self._logs, self._visualizers = self._loop.logs, self._loop.visualizers
        self._simulator = Simulator(self._loop.diagram)
        self.context = self._simulator.get_mutable_context()
        self._ending = EndingBlocks(loop_in(nonstop, RUN_SIGNALS), self.context)
        self.monitor = Monitor(
            self._simulator,
            nonstop,
            interruption,
            progress=request.progress,
            after_step=request.after_step,
            ending=self._ending,
        )
        self._start = time.perf_counter()
        self.engine = DIAGRAM

    @property
    def loop_context(self) -> Context:
        """The loop's own."""
        return self.nonstop.GetMyMutableContextFromRoot(self.context)

    def prepare(self) -> SimulatorConfig:
        """Sets the equilibrium and warns of what a user may not expect; the integrator's config."""
        request, scenario, nonstop = self._request, self.scenario, self.nonstop
        self._interruption.check()  # and again after what takes long
        set_equilibrium(nonstop, self.loop_context)
        self._interruption.check()
        PlantStates(nonstop).declare_defaults(self.loop_context)
        warn_of_other_bound(nonstop, self.loop_context, self._stated_bound)
        if not self._is_second:  # it has been said
            warn_of_angles(scenario)
        config = stable_config(scenario, nonstop, self.loop_context)
        if request.after_step is None:  # which may end a run of any duration
            require_room(self._logs.sizes, dataclasses.replace(scenario, simulator_config=config))
        ApplySimulatorConfig(config, self._simulator)
        self._interruption.check()
        return config

    def fly(self, config: SimulatorConfig) -> Flying[None]:
        """Flies to the end, the compiled engine what it can, Drake's Simulator the rest.

        Where the diagram is simulated instead, the run's `engine` says why, and so does a
        ScenarioWarning where `compiled` was asked for.
        """
        engine = self._request.asked_engine
        compiled = self._compiled(config, engine) if engine != DIAGRAM else None
        self._interruption.check()
        self._simulator.set_monitor(self.monitor)
        self._start = time.perf_counter()
        if not self._is_second:
            self._interruption.collect = lambda: self.run(self._interrupted)
        try:
            duration = self.scenario.simulation_duration
            is_begun = compiled is not None and (yield from compiled.fly(duration, self.monitor))
            if compiled is not None and compiled.failure:
                tell_not_compiled(compiled.failure, engine)
                self.engine += f", {DIAGRAM}: {compiled.failure}"
            elif not is_begun and compiled is not None:
                self.engine = f"{DIAGRAM}: shorter than a sample of the controllers"
            if not (is_begun and self._is_over):
                parameters = InitializeParams(suppress_initialization_events=is_begun)
                self._simulator.Initialize(parameters)
                if not self.monitor.has_ended:
                    self._simulator.AdvanceTo(duration)
            for visualizer in self._visualizers:  # the last step may have been skipped
                visualizer.ForcedPublish(visualizer.GetMyContextFromRoot(self.context))
        finally:
            self._simulator.clear_monitor()  # each would keep the other alive

    def _compiled(self, config: SimulatorConfig, engine: str) -> CompiledRun | None:
        """The compiled engine; None: it cannot fly this."""
        request = self._request
        given = {"viewers": request.viewers, "after_step": request.after_step}
        steering = [name for name, value in given.items() if value]
        flights = self._request.flights
        loop = compiled_loop_of(self.scenario, self._logs, config, steering, flights)
        if isinstance(loop, str):
            tell_not_compiled(f"{loop};", engine)
            self.engine = f"{DIAGRAM}: {loop}"
            return None
        compiled = CompiledRun(loop, self._logs, self.context, self._ending)
        self.engine = f"{COMPILED}: {compiled.evaluator}"
        return compiled

    @property
    def _is_cut(self) -> bool:
        return self.monitor.has_ended or self._interruption.number > 0

    @property
    def _is_over(self) -> bool:
        return self._is_cut or self.context.get_time() >= self.scenario.simulation_duration

    def run(self, stopped: str = "") -> Run:
        """The part that has been flown, and what has stopped it."""
        self._interruption.patience = ALL  # nothing may come between a run and who keeps it
        make_loop = self._request.make_loop
        own = {} if make_loop is make_nonstop else {"make_loop": make_loop}
        return Run.from_logs(
            self._logs,
            self.context,
            self.scenario,
            step=self._simulator.get_integrator().get_maximum_step_size(),
            wall_time=time.perf_counter() - self._start - self.monitor.waited,
            engine=self.engine,
            stopped=stopped,
            replacements=own | self._replacements,
        )

    @property
    def early_end(self) -> str | None:
        """Reason for an early end, "" a block's own decision; None: there is none."""
        if self._interruption.number:
            return self._interrupted
        if self.monitor.has_ended:
            return ""
        if self.context.get_time() < self.scenario.simulation_duration:
            return f"the run was ended{self._now}"
        return None

    @property
    def _interrupted(self) -> str:
        return f"the run was interrupted at t = {self.monitor.time:.4f} s"

    @property
    def _now(self) -> str:
        return f" at t = {self.context.get_time():.4f} s"

    def _stopped(self, cause: str) -> RunStopped:
        message = f"the run {cause}"
        return RunStopped(message, self.run(message))

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
        except GeneratorExit:  # nothing waits for it any more
            raise
        except KeyboardInterrupt:
            raise RunInterrupted(self.run(self._interrupted)) from None
        except NotFiniteError as error:
            source = source_of_fault(error, self.nonstop, self.loop_context)
            cause = cause_of_divergence(self.nonstop)
            raise self._stopped(
                f"diverged{self._now}: {source} made a value that is not finite, or beyond "
                f"{LARGEST:.0e} in SI units; {cause}"
            ) from None
        except RecordingError as error:
            raise self._stopped(f"stopped{self._now}: {error}") from None
        except BaseException as error:  # such as the SystemExit of a block
            if self._interruption.number:  # which may have become another error in C++
                raise RunInterrupted(self.run(self._interrupted)) from None
            if isinstance(error, ScenarioError) and self.context.get_time() == 0:
                raise
            raise self._stopped(
                f"stopped{self._now}: {raising_block(error)}{one_line(error)}"
            ) from error
        finally:
            if not self._is_second:
                self._interruption.collect = None


@contextlib.contextmanager
def without_warnings() -> Iterator[None]:
    """Leaves out what a scenario's warnings have told already."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ScenarioWarning)
        yield
