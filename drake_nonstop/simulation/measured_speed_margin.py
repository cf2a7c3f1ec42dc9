"""By how much carriers were slower than planned in a run."""

import math

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.blocks.wind import StillAirConfig
from drake_nonstop.mechanics.planned_orbit import OrbitTerms, PlannedOrbit
from drake_nonstop.mechanics.rigid_load import STILL_AIR
from drake_nonstop.mechanics.signals import (
    PLANNED_SIZE,
    SIGNAL_PERIOD,
    CarrierStates,
    Parameters,
    Phase,
    PlannedParameters,
)
from drake_nonstop.model.system import Model
from drake_nonstop.optimization.horizon_config import HorizonConfig, timed
from drake_nonstop.optimization.limits import Of
from drake_nonstop.optimization.orbit_constraints import OrbitConstraints
from drake_nonstop.optimization.problem_config import LimitsConfig
from drake_nonstop.simulation.run import Run
from drake_nonstop.simulation.signal_table import UnknownSignalError

_SETTLING = 5  # samples at 100 Hz, in which a carrier goes from one planned speed to another
_AHEAD = (56.0, -140.0, 120.0, -35.0)  # of the values 5, 6, 7 and 8 samples before: a cubic's value


def measured_speed_margin(run: Run) -> float | None:
    """By how much (m/s) a carrier was at most slower than planned, at 100 Hz, where it matters.

    That is what is below the slowest planned speed of all carriers within a nominal turn, half
    before and half after: a margin above the bound has to cover it. The planned speeds are those
    along the reference, in still air, of the ξ, A and θ that the loop flies: the signal `planned`,
    or `parameters` and `phase`. Where they jump, the lower one of before and after counts for
    50 ms; what a plan over a horizon keeps there beyond its margin is left out. None where there is
    no such signal, the layer keeps no speed bound, or it is one through air that moves.
    """
    limits, is_calm = run.scenario.optimization_layer, isinstance(run.scenario.wind, StillAirConfig)
    has_airspeed = run.scenario.system.aircraft is not None and not is_calm
    if not isinstance(limits, LimitsConfig) or has_airspeed:
        return None
    try:
        planned, references = _planned(run), run.signal("reference")
        states = CarrierStates.view(run.signal("carrier_state"))
    except UnknownSignalError:
        return None
    if len(planned) < 2:
        return None
    scenario = run.scenario
    model = Model(scenario.system, scenario.pattern, scenario.control_period)
    plans_ahead = isinstance(limits, HorizonConfig)
    config = limits if isinstance(limits, HorizonConfig) else HorizonConfig()
    horizon = timed(config, limits.frequency, scenario.control_period)
    problem = OrbitConstraints(model, limits, horizon, lambda: "planned speeds")
    flown = np.linalg.norm(states.velocities, axis=-1)
    # The first values are not those of a plan that has begun.
    terms = problem.all_terms(references[1:], STILL_AIR)
    planned_speed = problem.values_along(
        Of.SPEED, OrbitTerms.view(terms), PlannedOrbit.of_planned(planned[1:])
    )
    wanted = planned_speed.copy()
    if len(wanted) > _SETTLING + len(_AHEAD):
        # Where a plan jumps, as where the reference's jerk does, what it was before.
        count = len(wanted) - _SETTLING - len(_AHEAD) + 1
        before = sum(
            weight * planned_speed[len(_AHEAD) - 1 - i : len(_AHEAD) - 1 - i + count]
            for i, weight in enumerate(_AHEAD)
        )
        wanted[-count:] = np.minimum(wanted[-count:], before)
    if plans_ahead:
        jumps = problem.jump_margins(OrbitTerms.view(terms))
        wanted -= problem.settled(jumps, problem.settling_instants(SIGNAL_PERIOD))
    slowest = _least_around(planned_speed.min(axis=1), math.pi / limits.frequency)
    return float(np.max(np.minimum(wanted, slowest[:, None]) - flown[1:]))


def _least_around(values: NDArray, time: float) -> NDArray:
    """The least of samples (k,) at 100 Hz within a time (s) before and after each of them."""
    reach = round(time / SIGNAL_PERIOD)
    padded = np.pad(values, reach, constant_values=np.inf)
    return np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1).min(axis=1)


def _planned(run: Run) -> NDArray:
    """θ, ξ, A and their rates (k, 8) at the samples.

    What a sampled controller made at the sample before goes on to this one.
    """
    try:
        planned = np.array(run.signal("planned"))
    except UnknownSignalError:
        planned = np.zeros((len(run.time), PLANNED_SIZE))
        parameters = Parameters.view(run.signal("parameters"))
        parts = PlannedParameters.view(planned)
        parts.angle[:] = Phase.view(run.signal("phase")).angle
        parts.frequency[:], parts.amplitude[:] = parameters.frequency, parameters.amplitude
    T = run.scenario.control_period
    if T == 0:
        return planned
    now = PlannedParameters.view(planned)
    later = np.zeros_like(planned)
    parts = PlannedParameters.view(later)
    parts.angle[:] = now.angle + T * (
        now.frequency + T / 2 * (now.frequency_rate + T / 3 * now.frequency_second_rate)
    )
    parts.frequency[:] = now.frequency + T * (
        now.frequency_rate + T / 2 * now.frequency_second_rate
    )
    parts.amplitude[:] = now.amplitude + T * (
        now.amplitude_rate + T / 2 * (now.amplitude_second_rate + T / 3 * now.amplitude_third_rate)
    )
    parts.amplitude_rate[:] = now.amplitude_rate + T * (
        now.amplitude_second_rate + T / 2 * now.amplitude_third_rate
    )
    return later
