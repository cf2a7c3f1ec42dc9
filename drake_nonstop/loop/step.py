"""The longest stable step of a loop's integrator, by the fastest mode of the linearized loop."""

import copy
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator, SimulatorConfig
from pydrake.systems.framework import Context, Diagram

from drake_nonstop.loop.start import (
    LOOP_SIGNALS,
    PlantStates,
    block_named,
    copied_context,
)
from drake_nonstop.mechanics.signals import SIGNAL_PERIOD, CarrierStates, LoadState
from drake_nonstop.systems.block import set_state_values, state_values
from drake_nonstop.systems.equation_loop import EquationLoop, without_equations
from drake_nonstop.systems.wiring import (
    context_in,
    loop_in,
    ports_of,
    require_context,
    require_signals,
)
from drake_nonstop.validation import ScenarioError, require, warn_user

SHORTEST_STEP = 5e-5  # s; with a shorter one a run of 15 s would take minutes
_STABLE_TURN = 1.6  # rad, of the fastest mode in a step; third-order Runge-Kutta: 1.73
# Numbers of steps in a signals' period; a compiled loop is one of its step, too.
_COUNTS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 25, 32, 40, 50, 64, 80, 100, 125, 160, 200)
_DIFFERENCE = 1e-7  # SI units; so close to a state, tensions that are damped strongly do not end


def largest_step(diagram: Diagram, context: Context) -> float:
    """The longest step, in s, with which the third-order Runge-Kutta scheme of a loop is stable.

    An explicit scheme diverges, at first unnoticed, where the fastest mode turns too far in a step.
    The modes are the eigenvalues of the Jacobian of the continuous states' rates, with sampled
    states and the layer's answers held. Infinite where nothing moves.

    Args:
        diagram: the loop, or a diagram around it.
        context: of the diagram, at the start of a flight.

    Raises:
        ScenarioError: the diagram is no loop, the context is not its own, an input has no value,
            or a block makes a value that is not finite.
    """
    modes = np.linalg.eigvals(rates_jacobian(diagram, context))
    fastest = float(np.max(np.abs(modes), initial=0.0))
    return _STABLE_TURN / fastest if fastest > 0 else math.inf


def with_largest_step(
    config: SimulatorConfig, diagram: Diagram, context: Context
) -> SimulatorConfig:
    """The configuration of a loop's integrator, with a step of at most `largest_step`.

    A shorter step than the configuration's is a whole part of 10 ms, the signals' period, and a
    ScenarioWarning tells of it. There are few such steps, so that loops whose numbers differ little
    have the same. Steps of any scheme but the third-order Runge-Kutta one without
    error control are the user's, and stay.

    Args:
        config: of the integrator; it stays as it is.
        diagram: the loop, or a diagram around it.
        context: of the diagram, at the start of a flight.

    Raises:
        ScenarioError: steps would have to be shorter than 50 µs, or as of `largest_step`.
    """
    if config.integration_scheme != "runge_kutta3" or config.use_error_control:
        return config
    longest = largest_step(diagram, context)
    require(
        longest >= SHORTEST_STEP,
        "fastest mode",
        f"{_STABLE_TURN / longest:.3g} rad/s",
        "give less stiffness, damping, drag or gain to what moves so fast, or heavier bodies; it "
        f"asks for steps below {SHORTEST_STEP:g} s",
    )
    if config.max_step_size <= longest:
        return config
    # A whole part of the signals' period, so that no step is cut short by it.
    step = SIGNAL_PERIOD / next(n for n in _COUNTS if n * longest >= SIGNAL_PERIOD)
    warn_user(
        f"simulator_config.max_step_size = {config.max_step_size:g}: steps of {step:.3g} s are "
        "taken instead, for the sake of the fastest mode of the loop"
    )
    return with_step(config, step)


def with_step(config: SimulatorConfig, step: float) -> SimulatorConfig:
    """The configuration with a step in s: the same object where it has that step."""
    if config.max_step_size == step:
        return config
    config = copy.deepcopy(config)
    config.max_step_size = step
    return config


def rates_jacobian(diagram: Diagram, context: Context) -> NDArray:
    """The Jacobian (k, k) of the rates of a diagram's continuous states.

    It is CasADi's of a loop whose blocks have equations, and found by differences elsewhere, as
    where an equation has no slope.

    Sampled and discrete states are held, as the initialization of the loop leaves them.

    The carriers move with the load there: cables that change their length may have tensions that
    end at zero, which hides what their damping does. Aircraft, which cannot fly at its speed, keep
    their own velocities.

    Args:
        diagram: the loop, or a diagram around it.
        context: of the diagram; it stays as it is.
    """
    require_context("largest_step", diagram, context)
    require_signals(diagram, LOOP_SIGNALS, "largest_step", is_exporting=False)
    trial = copied_context(diagram, context)
    with block_named(diagram, trial):
        loop = loop_in(diagram, LOOP_SIGNALS)
        own = context_in(diagram, loop, trial)
        initialized = copied_context(loop, own)  # alone: what is around it shows and logs nothing
        Simulator(loop, initialized).Initialize()
        own.SetStateAndParametersFrom(initialized)
        _move_with_load(loop, own)
        if loop is diagram and not without_equations(loop):
            exact = EquationLoop(loop).rates_jacobian(trial)
            if np.all(np.isfinite(exact)):  # unlike the slope of a norm at zero
                return exact

        def rate(state: NDArray) -> NDArray:
            trial.SetContinuousState(state)
            rates: NDArray = diagram.EvalTimeDerivatives(trial).CopyToVector()
            return rates

        start = trial.get_continuous_state_vector().CopyToVector()
        return _jacobian(rate, start) if len(start) else np.zeros((0, 0))


def _move_with_load(loop: Diagram, context: Context) -> None:
    """Sets the carriers' velocities to those of a rigid body with the load; not of aircraft."""
    if ports_of(loop, "aircraft_state"):
        return
    plant = PlantStates(loop)
    load_state, carriers = plant.signals(context, "load_state", "carrier_state").values()
    load = LoadState.view(load_state)
    positions, velocities = CarrierStates.view(carriers)
    velocities[:] = load.velocity + np.cross(load.angular_velocity, positions - load.position)
    before = state_values(context)
    try:
        plant.set_states(context, carrier_state=carriers)
    except ScenarioError:  # of carriers whose port shows another motion
        set_state_values(context, before)


def _jacobian(function: Callable[[NDArray], NDArray], at: NDArray) -> NDArray:
    """The Jacobian of a function that may have kinks, of which it has the steeper side."""
    middle, columns = function(at), []
    for step in _DIFFERENCE * np.eye(len(at)):
        sides = function(at + step) - middle, middle - function(at - step)
        columns.append(max(sides, key=lambda side: float(np.max(np.abs(side)))) / _DIFFERENCE)
    return np.column_stack(columns)
