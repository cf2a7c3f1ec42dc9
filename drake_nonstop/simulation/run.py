"""What a simulation produces, and how it may end."""

import difflib
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from numpy.typing import NDArray
from pydrake.systems.framework import Diagram

from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.validation import ScenarioError

SIGNAL_PERIOD = 0.01  # s, of the signals that are written


@dataclass(kw_only=True)
class Run:
    """What a simulation produced.

    `signals` maps "block.port" to the samples of every signal but wall times, and accelerations and
    jerks of carriers that no block reads, (samples, size), at the instants `time` (samples,),
    100 Hz; `steps` maps the names of a few ports
    to their values at every step, (steps, size), and "time" to the steps' times (steps,), from
    t = 0 on: the integrator's steps, or the controllers' samples where the plant is fused. A
    value at an instant is that before the controllers' update at that instant. `solve_times`
    (updates,) are the wall times of the optimization layer's updates, `wall_time` that of the
    whole simulation but for pauses, in s.
    Beyond 32 MB, some 100 s of flight, `signals` and `steps` are in temporary files, which are
    removed with the run: each array is mapped to memory when it is asked for, and cannot be
    written to.
    A run that `is_steered` was changed from outside while it went on. `stopped` says why a run
    ended before its time, and is empty where it did not. `step` is the longest step of the
    integrator, s; `unresolved` has a sentence for each result that it does not resolve, and
    `half_step` what `verify_step` found. `replacements` are the functions that made blocks in place
    of the scenario's.
    """

    scenario: Scenario
    diagram: Diagram
    time: NDArray
    signals: Mapping[str, NDArray]
    steps: Mapping[str, NDArray]
    solve_times: NDArray
    wall_time: float
    is_steered: bool = False
    stopped: str = ""
    step: float = 0.0
    unresolved: tuple[str, ...] = ()
    half_step: dict[str, Any] | None = None
    replacements: dict[str, Any] = field(default_factory=dict)

    def signal(self, port: str) -> NDArray:
        """The signal of that port name, or of "block.port": (samples, size).

        Raises:
            UnknownSignalError: there is none.
        """
        for name in self.signals:
            if port in (name, name.split(".")[1]):
                return self.signals[name]
        close = difflib.get_close_matches(str(port), list(self.signals), n=3, cutoff=0.4)
        raise UnknownSignalError(
            f"signal = {port}: give a port of the run, "
            f"such as {' or '.join(close or list(self.signals)[:3])}"
        )


class UnknownSignalError(ScenarioError, KeyError):
    """A run has no signal of that name."""

    __str__ = Exception.__str__  # a KeyError's is in quotation marks


class StepAction(Enum):
    """What a run does after a step."""

    CONTINUE = 1
    WAIT = 2  # and ask again
    END = 3


class StepCheck(Enum):
    """What `simulate` flies again, with half the step."""

    NOTHING = 1
    PARTS = 2
    WHOLE = 3  # where parts leave a doubt


class RunStopped(RuntimeError):  # noqa: N818 - the end of a run; its message has the cause
    """A run ended before its time; `run` holds the signals up to there."""

    def __init__(self, message: str, run: Run):
        super().__init__(message)
        self.run = run


class RunInterrupted(KeyboardInterrupt):
    """A run was interrupted from the keyboard; `run` holds the signals up to there."""

    def __init__(self, run: Run):
        super().__init__(run.stopped)
        self.run = run
