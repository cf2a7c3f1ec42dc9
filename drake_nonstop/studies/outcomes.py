"""What a run comes to, among many that go on without the ones that fail."""

from collections.abc import Callable
from dataclasses import dataclass

from drake_nonstop.scenario.loading import Scenario
from drake_nonstop.simulation.simulate import Run, RunInterrupted, RunStopped, StepAction, simulate
from drake_nonstop.studies.workers import is_ending
from drake_nonstop.validation import ScenarioError, one_line

COMPLETED = "completed"
DIVERGED = "diverged"
FAILED = "failed"  # a block raised an error during the run
UNBUILDABLE = "unbuildable"


@dataclass(kw_only=True)
class Attempt:
    """An outcome, why it is not "completed", and the run up to where it ended, if there is one."""

    outcome: str
    message: str = ""
    run: Run | None = None


def attempt(scenario: Callable[[], Scenario]) -> Attempt | None:
    """Simulates what `scenario` returns, whatever it comes to; None: it was interrupted.

    Interrupted is a run by Ctrl-C, or in a worker whose results nobody waits for any more.
    """
    outcome, message = COMPLETED, ""
    try:
        run = simulate(
            scenario(),
            after_step=lambda simulator, diagram: (
                StepAction.END if is_ending() else StepAction.CONTINUE
            ),
        )
    except RunStopped as stopped:
        run, message = stopped.run, str(stopped)
        outcome = DIVERGED if stopped.__cause__ is None else FAILED
    except RunInterrupted:
        return None
    except ScenarioError as error:
        return Attempt(outcome=UNBUILDABLE, message=str(error))
    except (Exception, SystemExit) as error:  # whatever a block of the user's may raise
        return Attempt(outcome=UNBUILDABLE, message=one_line(error))
    if is_ending():
        return None
    return Attempt(outcome=outcome, message=message, run=run if len(run.time) > 0 else None)
