"""A block with faults, for runs that do not complete; other processes can import it, too."""

import contextlib
import os
import sys
import time
from dataclasses import dataclass

import numpy as np
from pydrake.systems.framework import LeafSystem


def raises():
    raise ValueError("the wind broke")


def tells_threads():
    raise ValueError(f"threads: {os.environ['OPENBLAS_NUM_THREADS']}")


def interrupts():
    raise KeyboardInterrupt


def hangs():
    _say_so()
    while True:
        pass


def swallows():
    """Hangs, and lets no exception end it."""
    _say_so()
    while True:
        with contextlib.suppress(BaseException):
            time.sleep(0.01)


def _say_so():
    if "FAULT_FILE" in os.environ:
        open(os.environ["FAULT_FILE"], "w").close()


def signals(number):
    """Gets a signal; as pybind11 does it makes another error of a KeyboardInterrupt."""
    try:
        os.kill(os.getpid(), number)
        time.sleep(0.1)
    except KeyboardInterrupt:
        raise TypeError("incompatible constructor arguments") from None


FAULTS = {
    "raises": raises,
    "tells": tells_threads,
    "interrupts": interrupts,
    "hangs": hangs,
    "swallows": swallows,
    "exits": lambda: sys.exit(0),
    "dies": lambda: os._exit(9),
    "2": lambda: signals(2),
    "15": lambda: signals(15),
}


@dataclass(kw_only=True)
class FaultyWindConfig:
    force: float = 0.0  # N
    begin: float = 0.03  # s, of what comes in flight
    # "built" or "flown", and one of FAULTS or "diverges"; without it that of the environment, once,
    # so that scenarios be the same
    fault: str = ""
    seed: int = 0


class FaultyWind(LeafSystem):
    """A disturbance of the load."""

    def __init__(self, model, config):
        super().__init__()
        self.config = config
        self.DeclareVectorOutputPort("disturbance_wrench", 6, self.calc)
        self.fail("built")

    def calc(self, context, output):
        is_late = context.get_time() > self.config.begin
        force = np.nan if is_late and self.config.fault == "flown diverges" else self.config.force
        output.SetFromVector([0, 0, 0, 0, force, 0])
        if is_late:
            self.fail("flown")

    def fail(self, when):
        at, _, how = (self.config.fault or os.environ.get("FAULT", "")).partition(" ")
        if at == when and how in FAULTS:
            if not self.config.fault:
                del os.environ["FAULT"]
            FAULTS[how]()
