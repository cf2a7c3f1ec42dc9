"""The longest step that the integrator is stable at."""

import copy
import math

from pydrake.systems.analysis import SimulatorConfig
from pydrake.systems.framework import Context, Diagram

from drake_nonstop.simulation.equilibrium import fastest_mode
from drake_nonstop.simulation.run import SIGNAL_PERIOD
from drake_nonstop.validation import require

_SHORTEST_STEP = 1e-5  # s; with a shorter one a run would not come to an end
_STABLE_STEP = 1.6  # rad, the fastest mode's turn in a step; third-order Runge-Kutta: 1.73


def stable_config(config: SimulatorConfig, nonstop: Diagram, context: Context) -> SimulatorConfig:
    """The configuration with a step that the fixed-step Runge-Kutta scheme is stable at.

    Explicit schemes blow up, at first in silence, where the step is too long for the
    fastest mode; for the third-order one that is at 1.73 divided by the mode's rad/s.
    Steps of any other scheme, and shorter ones, are the user's.
    """
    if config.integration_scheme != "runge_kutta3" or config.use_error_control:
        return config
    mode = fastest_mode(nonstop, context)
    longest = _STABLE_STEP / mode
    require(
        longest >= _SHORTEST_STEP,
        "fastest mode",
        f"{mode:.3g} rad/s",
        f"give softer cables or heavier bodies; it asks for steps below {_SHORTEST_STEP:g} s",
    )
    if config.max_step_size > longest:
        # A whole part of the signals' period, so that no step is cut short by it.
        config = copy.deepcopy(config)
        config.max_step_size = SIGNAL_PERIOD / math.ceil(SIGNAL_PERIOD / longest)
    return config
