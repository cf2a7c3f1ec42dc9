"""A scenario to a run: the simulated signals of every block."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram

from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.loop.step import with_step
from drake_nonstop.run.built_loop import Viewer
from drake_nonstop.run.compiled_run import Flying, flown_alone
from drake_nonstop.run.flight import Flight, Request, without_warnings
from drake_nonstop.run.interruption import Interruption, current_interruption
from drake_nonstop.run.preparation import LoopMaker
from drake_nonstop.run.run import Run, RunInterrupted, RunStopped, StepAction, StepCheck
from drake_nonstop.run.short_flights import finer
from drake_nonstop.run.step_check import compared, in_doubt, is_in_doubt
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.systems.native import asking
from drake_nonstop.validation import ScenarioError, require


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

    The step is the scenario's, or a shorter one where the loop's fastest mode needs it, see
    `with_largest_step`; a ScenarioWarning says so. Parts of the run are flown again with half the
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
        engine: "auto", "diagram" or "compiled", in place of the scenario's; None: that. By "auto"
            the compiled engine flies what it can, and the run's `engine` says what flew it.
        replacements: blocks in place of the scenario's, and `extra` ones, see `make_nonstop`.
            Those with a config are in the run's scenario.

    Raises:
        ScenarioError: the scenario cannot be built, or there is no room for its signals.
        RunStopped: the run diverged, a block failed, or the disk is full; carries the run up to
            there.
        RunInterrupted: Ctrl-C; carries the run up to there.
    """
    request = Request(
        scenario=scenario,
        progress=progress,
        viewers=viewers,
        after_step=after_step,
        check_step=check_step,
        make_loop=make_nonstop if make_loop is None else make_loop,
        engine=engine,
        replacements=replacements,
    )
    return _simulated(request)


def _simulated(request: Request) -> Run:
    with (
        current_interruption() as interruption,
        interruption.patient(1),
        asking(interruption.check),
    ):
        try:
            run = flown_alone(simulating(request, interruption))
        except RunStopped:
            raise
        except Exception:
            if interruption.count > 1:  # a KeyboardInterrupt that went through C++
                raise KeyboardInterrupt from None
            raise
    if interruption.number:
        raise RunInterrupted(run)
    return run


def simulating(request: Request, interruption: Interruption) -> Flying[Run]:
    """The run of a request as `simulate` makes it, whose flight may be one of several.

    It is flown again with half its step where that is in doubt.
    """
    flight = Flight(request, interruption)
    with flight.kept():
        yield from flight.fly(flight.prepare())
    if flight.early_end is not None:
        return flight.run(flight.early_end)  # as it is: another step may end it elsewhere
    run = flight.run()
    states = flight.monitor.saved.states
    if request.check_step is StepCheck.NOTHING or not is_in_doubt(run, states, flight.loop_context):
        return run
    doubt = in_doubt(run)
    if request.check_step is StepCheck.PARTS or request.after_step is not None:
        return dataclasses.replace(run, unresolved=(doubt,))
    return _verified(run, request.progress, doubt, request.engine)


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
    """Verifies the step; an interrupted run keeps the doubt for which it is flown again."""
    config = finer(with_step(run.scenario.simulator_config, run.step), 2)
    duration = float(run.steps["time"][-1])
    scenario = dataclasses.replace(
        run.scenario, simulator_config=config, simulation_duration=duration
    )
    doubted = dataclasses.replace(run, unresolved=(*run.unresolved, doubt)) if doubt else run
    try:
        with without_warnings(), current_interruption() as interruption:
            interruption.collect = lambda: doubted
            replacements = {**(run.replacements or {})}
            request = Request(
                scenario=scenario,
                progress=progress,
                check_step=StepCheck.NOTHING,
                make_loop=replacements.pop("make_loop", make_nonstop),
                engine=engine,
                replacements=replacements,
            )
            half = _simulated(request)
    except RunInterrupted:
        raise RunInterrupted(doubted) from None
    except (RunStopped, ScenarioError) as error:
        said = f"with half of the steps of {1e3 * run.step:.3g} ms {error}"
        return dataclasses.replace(run, unresolved=(*run.unresolved, said))
    finally:
        interruption.collect = None
    return compared(run, half)
