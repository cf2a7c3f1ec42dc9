"""Result of a simulation, and how it may end."""

import importlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context, Diagram

from drake_nonstop.planning.diagnostics import Diagnostics
from drake_nonstop.run.signal_table import SignalTable
from drake_nonstop.scenario.schema import DIAGRAM, Scenario
from drake_nonstop.validation import require, warn_user

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from drake_nonstop.run.recording import LogSignals

WALL_TIME = "solve_time"  # port; its values differ from run to run: `Run.signals` is without it


@dataclass(kw_only=True)
class Run(SignalTable):
    """Result of a simulation.

    `signals` maps "block.port" to the samples (samples, size) of that signal at the instants `time`
    (samples,), s, at 100 Hz. Wall times are not in it, nor are accelerations and jerks of carriers
    where no block reads them. `steps` maps the names of a few ports to their values (steps, size)
    at every step of the integrator, and "time" to the steps' times (steps,), s, from t = 0 on.
    Values are taken before the controllers' update at the same instant. `solve_times` (updates,),
    s, are the wall times of the optimization layer's updates. `wall_time`, s, is the time of the
    whole simulation without pauses; NaN: unknown. Beyond 32 MB, some 100 s of flight, `signals` and
    `steps` are in temporary files, which are removed with the run: the arrays are mapped to memory,
    and cannot be written to. `engine` is "compiled: C", "compiled: virtual machine" (CasADi's) or
    "diagram", with the reason where the scenario does not state it. `is_steered` is whether a user
    changed the loop during the run. `stopped` is the reason why a run ended before its time, else
    empty. `step` is the longest step of the integrator, s. `half_step` and `unresolved` are results
    of `verify_step`: `unresolved` has a sentence for each metric that the step does not resolve.
    `replacements` are the arguments of `simulate` that made the loop or its blocks in place of the
    scenario's; None: another function made the run.

    A run whose `replacements` can be pickled can be pickled, too, and so be sent between processes.
    Its diagram is left out, and is built again with its first use.
    """

    scenario: Scenario
    diagram: Diagram
    steps: Mapping[str, NDArray]
    solve_times: NDArray
    wall_time: float
    engine: str = DIAGRAM
    is_steered: bool = False
    stopped: str = ""
    step: float = 0.0
    unresolved: tuple[str, ...] = ()
    half_step: dict[str, Any] | None = None
    replacements: dict[str, Any] | None = field(default_factory=dict)

    def __repr__(self) -> str:
        """One line: the scenario, how long it flew, with how many samples and why it ended."""
        end = f"{self.time[-1]:g} s" if len(self.time) else "no samples"
        why = f", stopped: {self.stopped}" if self.stopped else ""
        return f"<Run of {self.scenario.name}: {end}, {len(self.signals)} signals{why}>"

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "diagram"}

    if not TYPE_CHECKING:  # with it type checkers would take any name

        def __getattr__(self, name: str) -> Any:
            """The diagram of a run that was pickled."""
            if name != "diagram" or "scenario" not in vars(self):
                raise AttributeError(f"a Run has no {name}", name=name, obj=self)
            self.diagram = built_again(self.scenario, self.replacements, repr(self))
            return self.diagram

    def plot(self, *names: str) -> "Figure":
        """Draws a figure of the run, or signals over time; the figure can be changed and saved.

        Args:
            names: one of the figures that `drake-nonstop run` writes, such as "tensions" or
                "carrier_paths_from_above"; or signals as of `columns`, a panel for each quantity.

        Raises:
            ScenarioError: there is no such figure or signal.
        """
        # By its name: figures are drawn in a room above that of runs.
        figures: Any = importlib.import_module("drake_nonstop.view.run_figures")
        return figures.make_figure(self, *names)

    @classmethod
    def from_logs(
        cls,
        logs: "LogSignals",
        context: Context,
        scenario: Scenario,
        *,
        wall_time: float = math.nan,
        step: float | None = None,
        engine: str = DIAGRAM,
        stopped: str = "",
        replacements: dict[str, Any] | None = None,
    ) -> "Run":
        """Returns the run that was logged in a context, for metrics, figures and a replay.

        Args:
            logs: what `LogSignals.AddToBuilder` returned for the loop.
            context: that of the whole diagram, such as a Simulator's, after the flight.
            scenario: has the system, limits and speed bound by which the run is judged.
            wall_time: that of the simulation, s; NaN: unknown.
            step: the longest step of the integrator, s; None: the longest that was logged.
            engine: as in `Run`.
            stopped: why the run ended before its time, if it did.
            replacements: as in `Run`.

        Raises:
            ScenarioError: `scenario` is no Scenario, the context is not that of the logs' diagram,
                nothing was logged, or the number of carriers is not the scenario's.
        """
        remedy = "give the Scenario that the loop was made from"
        require(isinstance(scenario, Scenario), "scenario", scenario, remedy)
        remedy = "give what LogSignals.AddToBuilder returns"
        require(hasattr(logs, "collect"), "logs", logs, remedy)
        time, signals, steps = logs.collect(context)
        remedy = "advance a Simulator with this context first"
        require(len(time) > 0 or stopped != "", "logs", "no samples", remedy)
        # Nine digits: differences of times have rounding errors.
        longest = float(f"{np.max(np.diff(steps['time']), initial=0.0):.9g}")
        carriers, given = steps["carrier_state"].shape[1] // 6, len(scenario.system.attachments)
        remedy = f"give the scenario of the loop, with {carriers} of them"
        require(carriers == given, "system.attachments", given, remedy)
        return cls(
            scenario=scenario,
            diagram=logs.nonstop,
            time=time,
            signals=signals,
            steps=steps,
            solve_times=solve_times_of(steps),
            wall_time=wall_time,
            engine=engine,
            stopped=stopped,
            step=longest if step is None else step,
            replacements=replacements,
            entries=logs.entries,
        )

    @staticmethod
    def load(folder: Path | str, *, trust: bool = False) -> "Run":
        """Returns the run whose results are in a folder, as if it had just flown.

        Its metrics, figures and replay are the same. Its diagram is built again from the scenario;
        a ScenarioWarning tells of a run with blocks that its scenario does not name.

        Args:
            folder: one that `write_results` or `drake-nonstop run` has written.
            trust: whether the scenario may import blocks of the user's own.

        Raises:
            ScenarioError: there is no such run, or it cannot be read.
        """
        from drake_nonstop.run.stored_run import load_run

        return load_run(folder, trust=trust)


def built_again(scenario: Scenario, replacements: dict[str, Any] | None, run: object) -> Diagram:
    """The loop's diagram of a run; a ScenarioWarning tells where it may be another one."""
    from drake_nonstop.diagrams.nonstop import make_nonstop
    from drake_nonstop.run.flight import without_warnings
    from drake_nonstop.run.preparation import loop_of

    if replacements is None:
        text = f"run = {run}: blocks that its scenario does not name were in the loop; its "
        warn_user(f"{text}diagram is that of the scenario")
    given = {"make_loop": make_nonstop, **(replacements or {})}
    with without_warnings():  # they were told before it flew
        return loop_of(given.pop("make_loop"), scenario, given)


def solve_times_of(steps: Mapping[str, NDArray]) -> NDArray:
    """Returns the wall times (updates,), s, of the optimization layer's updates made in Python."""
    if "diagnostics" not in steps or WALL_TIME not in steps:
        return np.zeros(0)
    counts = Diagnostics.view(steps["diagnostics"]).updates
    times = steps[WALL_TIME][np.flatnonzero(np.diff(counts, prepend=0.0)), 0]
    return times[times > 0]  # 0: a compiled loop kept the parameters


class StepAction(Enum):
    """Action of a run after a step, as the function `after_step` of `simulate` returns it."""

    CONTINUE = 1
    WAIT = 2  # then call `after_step` again, without a step
    END = 3


class RunStopped(RuntimeError):  # noqa: N818 - the end of a run; its message has the cause
    """A run ended before its time; `run` holds the signals up to there."""

    def __init__(self, message: str, run: Run):
        super().__init__(message)
        self.run = run

    def __reduce__(self) -> Any:
        return type(self), (*self.args, self.run)


class RunInterrupted(KeyboardInterrupt):
    """A run was interrupted from the keyboard; `run` holds the signals up to there."""

    def __init__(self, run: Run):
        super().__init__(run.stopped)
        self.run = run

    def __reduce__(self) -> Any:
        return type(self), (self.run,)


class RunsInterrupted(KeyboardInterrupt):
    """Runs were interrupted; `runs` are as of `simulate_many`, None for missing ones."""

    def __init__(self, runs: list[Run | BaseException | None]):
        ended = sum(run is not None for run in runs)
        super().__init__(f"interrupted: {ended} of {len(runs)} runs have ended, and are kept")
        self.runs = runs
