"""A scenario to a run: the simulated signals of every block."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram

from drake_nonstop.run.compiled_run import fly_together
from drake_nonstop.run.flight import Flight, Viewer
from drake_nonstop.run.interruption import current_interruption
from drake_nonstop.run.preparation import LoopMaker
from drake_nonstop.run.run import Run, RunInterrupted, RunStopped, StepAction
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.systems.native import asking


def simulate(
    scenario: Scenario,
    *,
    progress: Callable[[float], None] | None = None,
    viewers: Sequence[Viewer] = (),
    after_step: Callable[[Simulator, Diagram], StepAction] | None = None,
    make_loop: LoopMaker | None = None,
    engine: str | None = None,
    **replacements: Any,
) -> Run:
    """Simulates a scenario from its equilibrium and returns all signals.

    The step is the scenario's, or a shorter one where the loop's fastest mode needs it, see
    `with_largest_step`, with a ScenarioWarning. `verify_step` finds whether it resolves the
    metrics.

    Args:
        scenario: its distributions are drawn with its `random_seed`; the run's scenario has the
            numbers.
        progress: called with the simulated time now and then.
        viewers: functions that show the run while it goes on, such as `show_in(meshcat)`. Each
            adds a system to the builder, connected to the loop's diagram, and returns it. A
            forced publish of the system shows the end of the run.
        after_step: called with the simulator and the loop's diagram after every step. It may
            change parameters of the context, such as the optimization layer's ε, or the simulator's
            real-time rate, and pause or end the run.
        make_loop: makes the loop's diagram of a scenario and of the replacements without a config;
            None: `make_nonstop` does. One of the user's own exports its signals by their names,
            as `connect_by_name` does; the loop may be inside of it.
        engine: "auto", "diagram" or "compiled", in place of the scenario's; None: the scenario's.
            With "auto" the compiled engine flies if it can; the run's `engine` is the one that
            flew.
        replacements: blocks in place of the scenario's, and `extra` ones, see `make_nonstop`.
            Those with a config are in the run's scenario.

    Raises:
        ScenarioError: the scenario cannot be built, or there is no room for its signals.
        RunStopped: the run diverged, a block failed, or the disk is full; carries the run up to
            there.
        RunInterrupted: Ctrl-C; carries the run up to there.
    """
    with (
        current_interruption() as interruption,
        interruption.patient(1),
        asking(interruption.check),
        np.errstate(under="ignore"),  # a number below the smallest is zero, whatever a user has set
    ):
        try:
            flight = Flight(
                interruption,
                scenario,
                progress=progress,
                viewers=viewers,
                after_step=after_step,
                make_loop=make_loop,
                engine=engine,
                **replacements,
            )
            with flight.kept():
                flight.prepare()
                fly_together(flight.compiled)
                run = flight.finish()
        except RunStopped:
            raise
        except Exception:
            if interruption.count > 1:  # a KeyboardInterrupt that went through C++
                raise KeyboardInterrupt from None
            raise
    if interruption.number:
        raise RunInterrupted(run)
    return run
