"""The longest step that the integrator is stable at, and that resolves the commanded motion."""

import copy
import math

import numpy as np
from pydrake.systems.analysis import Simulator, SimulatorConfig
from pydrake.systems.framework import Context, Diagram

from drake_nonstop.mechanics.signals import CarrierStates, LoadReference, LoadState
from drake_nonstop.simulation.equilibrium import fastest_mode, on_reference
from drake_nonstop.simulation.run import SIGNAL_PERIOD
from drake_nonstop.simulation.short_flights import SavedState, ShortFlights, difference
from drake_nonstop.validation import require

SHORTEST_STEP = 1e-5  # s; with a shorter one a run would not come to an end
_STABLE_STEP = 1.6  # rad, the fastest mode's turn in a step; third-order Runge-Kutta: 1.73

_INSTANTS = 50  # of the reference that are compared
_TRIAL = 0.03  # s, of a trial flight, or longer: three samples of the controllers
_SMALL_JUMP = 3e-4  # of the cables' length
_RESOLVED = 0.1  # the largest `difference` of trial flights whose steps are kept
_HALVINGS = 4  # of the step at most


def stable_config(config: SimulatorConfig, nonstop: Diagram, context: Context) -> SimulatorConfig:
    """The configuration with a step that the fixed-step Runge-Kutta scheme is stable at.

    Explicit schemes blow up, at first in silence, where the step is too long for the
    fastest mode; for the third-order one that is at 1.73 divided by the mode's rad/s.
    Steps of any other scheme, and shorter ones, are the user's.

    Raises:
        ScenarioError: the fastest mode asks for steps that would take for ever.
    """
    if not has_chosen_steps(config):
        return config
    mode = fastest_mode(nonstop, context)
    longest = _STABLE_STEP / mode
    require(
        longest >= SHORTEST_STEP,
        "fastest mode",
        f"{mode:.3g} rad/s",
        "give cables of less stiffness and damping, or heavier bodies; it asks for steps below "
        f"{SHORTEST_STEP:g} s",
    )
    if config.max_step_size <= longest:
        return config
    # A whole part of the signals' period, so that no step is cut short by it.
    return with_step(config, SIGNAL_PERIOD / math.ceil(SIGNAL_PERIOD / longest))


def resolving_config(
    config: SimulatorConfig,
    nonstop: Diagram,
    context: Context,
    *,
    control_period: float,
    duration: float,
    length: float,
) -> SimulatorConfig:
    """The configuration with a step that resolves the most demanding commanded motion.

    Between the controllers' samples the carriers' references move along straight lines. At each
    sample they jump by what the motion curves meanwhile, and a carrier rings. From the instant of
    the reference at which it curves most, a short trial is flown with the step and with halves
    of it, until a half makes no difference. Small jumps are not tried.

    Args:
        config: with a step that is stable.
        nonstop: the loop.
        context: at the start.
        control_period: the controllers' sample time in s.
        duration: of the run, in s.
        length: of the cables, in m.
    """
    if not has_chosen_steps(config):
        return config
    time, curvature = _most_demanding(nonstop, context, duration)
    if curvature * control_period**2 / 2 < _SMALL_JUMP * length:
        return config
    flights = ShortFlights(nonstop, context, config, control_period)
    try:
        flights.context.SetTime(time)
        on_reference(nonstop, flights.context)
        start = SavedState.of(flights.context)
        time = max(_TRIAL, 3 * control_period)
        flown = flights.fly(start, time)
        for halvings in range(_HALVINGS):
            finer = flights.fly(start, time, 2 ** (halvings + 1))
            if difference(flown, finer) <= _RESOLVED:
                break
            flown = finer
    except Exception:  # whatever blocks may raise there: the run itself will tell
        return config
    return with_step(config, config.max_step_size / 2**halvings) if halvings else config


def has_chosen_steps(config: SimulatorConfig) -> bool:
    """Whether the steps are those of the default scheme, and of the length that is asked for."""
    return config.integration_scheme == "runge_kutta3" and not config.use_error_control


def with_step(config: SimulatorConfig, step: float) -> SimulatorConfig:
    """The configuration with another step, in s."""
    config = copy.deepcopy(config)
    config.max_step_size = step
    return config


def with_half_the_step(config: SimulatorConfig, step: float) -> SimulatorConfig:
    """The configuration with half a step (s) that a run took, or a finer accuracy as well."""
    config = with_step(config, max(SHORTEST_STEP, step / 2))
    config.accuracy /= 8  # of a third-order scheme's error
    return config


def _most_demanding(nonstop: Diagram, context: Context, duration: float) -> tuple[float, float]:
    """When the reference curves most (s), and by how much a carrier's path does (m/s²)."""
    port = nonstop.GetOutputPort("reference")
    moved = nonstop.CreateDefaultContext()
    moved.SetTimeStateAndParametersFrom(context)
    Simulator(nonstop, moved).Initialize()  # whatever samples or holds takes its first value
    load = LoadState.view(nonstop.GetOutputPort("load_state").Eval(moved))
    carriers = CarrierStates.view(nonstop.GetOutputPort("carrier_state").Eval(moved))
    lever = np.max(np.linalg.norm(carriers.positions - load.position, axis=1))
    times = np.linspace(0, duration, _INSTANTS, endpoint=False)
    references = []
    for time in times:
        moved.SetTime(time)
        references.append(port.Eval(moved).copy())
    reference = LoadReference.view(np.array(references))
    turning = np.linalg.norm(reference.angular_acceleration, axis=1)
    turning = turning + np.sum(reference.angular_velocity**2, axis=1)
    curvatures = np.linalg.norm(reference.acceleration, axis=1) + lever * turning
    hardest = np.argmax(curvatures)
    return float(times[hardest]), float(curvatures[hardest])
