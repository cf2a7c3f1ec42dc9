"""The equilibrium that a run starts from."""

import contextlib
import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram

from drake_nonstop.loop.plant_states import PlantStates
from drake_nonstop.mechanics.rotation import rotate_quaternion
from drake_nonstop.mechanics.signals import (
    LOAD_REFERENCE_SIZE,
    LOAD_STATE_SIZE,
    LoadReference,
    LoadState,
    Wrench,
)
from drake_nonstop.systems.diagnosis import source_of_fault
from drake_nonstop.systems.port_state import copied_context
from drake_nonstop.systems.tracing import LARGEST, NotFiniteError
from drake_nonstop.systems.wiring import (
    innermost,
    require_own_context,
    require_signals,
    unconnected,
)
from drake_nonstop.validation import ScenarioError, require, warn_user

# What the loop has to make, with sizes; None: 6 for each carrier. No block alone makes all.
LOOP_SIGNALS = {
    "load_state": LOAD_STATE_SIZE,
    "reference": LOAD_REFERENCE_SIZE,
    "carrier_state": None,
    "carrier_reference": None,
}

_STEP = 1e-6  # of the differences, in SI units
_REST = 1e-6  # m/s² and rad/s², the acceleration that counts as rest
_ENOUGH = 0.3  # of the residual before a step, where its slopes do for the next one
_REACH = 0.5  # m and rad, of the linear model
_NEAR = np.repeat([_REACH, 0.0], [7, 6])  # of a load that may be at its equilibrium: as fast
_DROPS = (0.0, 0.001, 0.003, 0.01, 0.03, 0.1)  # m, below the reference, to start looking from


def set_equilibrium(nonstop: Diagram, context: Context, traced: Any = None) -> None:
    """Sets load and carriers in `context` to the equilibrium of the loop as configured.

    The carriers start on their references, with their velocities; the load starts where
    the cables then hold it at rest: on its reference where the controllers know the
    cables, lower or higher where they do not. Newton's method on the built diagram, with its
    initialization events, finds the pose, whatever the blocks are. Inputs of the loop, where a
    box was left out, are held at their values at the start. A load whose reference moves at the
    start has that velocity and that acceleration. Further states keep their values, but for those
    that a block trims: what a block of one's own may offer is in `loop/plant_states.py`.

    The blocks with these states are those that make the signals `load_state` and `carrier_state`,
    found by the names of their output ports, whatever the blocks are called, however deep in
    `nonstop` they are, and whether it exports the ports or not; where several blocks have a port of
    that name, the one that it exports counts. A load that is at its equilibrium already stays where
    it is. A `TracedStart` of the context finds it sooner, if `traced` is one.

    Raises:
        ScenarioError: the cables cannot hold the load, a block does not show the state that is
            set, or makes a value that is not finite, or is far too large; no block makes a signal,
            or two do, or an input is not connected; the context is that of another system.
    """
    require_own_context("set_equilibrium", nonstop, context)
    require_signals(nonstop, LOOP_SIGNALS, "set_equilibrium", is_exporting=False)
    nonstop, context = innermost(nonstop, context, LOOP_SIGNALS)
    if traced is not None and _settle_traced(nonstop, context, traced):
        return
    trial = copied_context(nonstop, context)
    with block_named(nonstop, trial):
        _settle(nonstop, trial)
    PlantStates(nonstop).take_over(context, trial)


def set_default_equilibrium(nonstop: Diagram) -> None:
    """Makes the equilibrium that `set_equilibrium` finds the start of a diagram's new contexts.

    For a loop that was wired by hand, once it is built; `make_nonstop` does it by itself. A
    ScenarioWarning names a block whose default state cannot be set, see `loop/plant_states.py`.

    Raises:
        ScenarioError: as of `set_equilibrium`.
    """
    require(isinstance(nonstop, Diagram), "diagram", nonstop, "give a built Diagram of floats")
    context = nonstop.CreateDefaultContext()
    set_equilibrium(nonstop, context)
    loop, own = innermost(nonstop, context, LOOP_SIGNALS)
    for message in PlantStates(loop).declare_defaults(own):
        warn_user(message)


@contextlib.contextmanager
def block_named(nonstop: Diagram, context: Context) -> Iterator[None]:
    """Turns an error of a value or a missing one into a ScenarioError that names the block."""
    try:
        yield
    except NotFiniteError as error:
        source = source_of_fault(error, nonstop, context)
        raise ScenarioError(
            f"start = {source}: it makes a value that is not finite, or beyond {LARGEST:.0e} in SI "
            "units; give its parameters, and those of the blocks before it, values closer to the "
            "defaults, or correct the block"
        ) from None
    except RuntimeError as error:
        missing = unconnected(nonstop, context) if "is not connected" in str(error) else ""
        if not missing:
            raise
        raise ScenarioError(missing) from None


def _settle(nonstop: Diagram, trial: Context) -> None:
    """Sets a context of the loop alone to the equilibrium, with all that is sampled or held."""
    plant = PlantStates(nonstop)
    start = trial.Clone()
    simulator = Simulator(nonstop, trial)
    reference = plant.required(trial, "reference")
    settled: dict[str, NDArray] = {}

    def acceleration(load_state: NDArray) -> NDArray:
        trial.SetTimeStateAndParametersFrom(start)
        settled["load_state"] = load_state
        plant.set_states(trial, **settled)
        simulator.Initialize()  # whatever samples or holds takes its first value
        settled["carrier_state"] = plant.required(trial, "carrier_reference")
        plant.set_states(trial, **settled)
        plant.trim(trial, **settled)
        return plant.load_acceleration(trial)

    residual = _searched(acceleration, plant.states(trial).get("load_state"), reference)
    if np.max(np.abs(residual)) < _REST:
        return
    cause = _cause_of_motion(plant, trial, plant.load_acceleration(trial))
    cause += plant.acceleration_source(trial)
    raise ScenarioError(
        f"start = an acceleration of {np.max(np.abs(residual)):.2g} m/s^2 beside that of the "
        f"reference: the cables do not hold the load near its reference; {cause}"
    )


def _settle_traced(nonstop: Diagram, context: Context, traced: Any) -> bool:
    """The same by the traced functions, in the context; False: the diagram has to tell the rest."""
    plant = PlantStates(nonstop)
    start = traced.state.copy()
    given = start[traced.load].copy()
    settled: list[NDArray] = []

    def acceleration(load_state: NDArray) -> NDArray:
        start[traced.load] = load_state
        state = traced.initialized(start)
        start[traced.carriers] = state[traced.carriers] = traced.rest(state)[0]
        settled[:] = [load_state, state[traced.carriers]]
        rate = LoadState.view(traced.rest(state)[1][traced.load])
        return np.concatenate([rate.angular_velocity, rate.velocity])

    try:
        residual = _searched(acceleration, given, plant.required(context, "reference"))
    except Exception:  # whatever a block may raise, which its diagram does again
        return False
    if not np.max(np.abs(residual)) < _REST:
        return False
    plant.set_states(context, load_state=settled[0], carrier_state=settled[1])
    return True


def _searched(
    acceleration: Callable[[NDArray], NDArray], given: NDArray | None, reference: NDArray
) -> NDArray:
    """What an acceleration (6,) has beside the reference's where the search for rest ends.

    It is the load's, of a state of it (13,); `given` is that of now, None: it has none.
    """
    desired = LoadReference.view(reference)
    desired_rate = np.concatenate([desired.angular_acceleration, desired.acceleration])

    def settle(offset: NDArray) -> NDArray:
        """The same at a rotation and shift from the reference."""
        return acceleration(_moved(reference[:LOAD_STATE_SIZE], offset)) - desired_rate

    if given is not None and np.all(np.abs(given - reference[:LOAD_STATE_SIZE]) <= _NEAR):
        residual = acceleration(given) - desired_rate
        if np.max(np.abs(residual)) < _REST / 1e3:
            return residual
    for drop in _DROPS:
        residual, is_far = _newton(settle, np.array([0, 0, 0, 0, 0, -drop]))
        if np.max(np.abs(residual)) < _REST or is_far:  # far from the other starts, too
            break
    return residual


def _cause_of_motion(plant: PlantStates, context: Context, acceleration: NDArray) -> str:
    """Why no cables can hold the load at its reference, and what to change."""
    tensions = plant.signal(context, "tensions")
    if tensions is None or np.any(tensions > 0):
        return (
            "give system and simulated loads of about the same mass, their cables about the same "
            "length, stiff enough for the weight, and an amplitude that keeps them taut"
        )
    fall = -LoadReference.view(plant.required(context, "reference")).acceleration[2]
    if acceleration[5] < -fall:
        return (
            "all of them are slack, so that it falls; give simulated.cable_length close to "
            "system.cable_length"
        )
    causes = []
    if (wrench := plant.signal(context, "disturbance_wrench")) is not None:
        lift = Wrench.view(wrench).force[2]
        causes += [f"load_disturbance lifts it with {lift:.3g} N"] if lift > 0 else []
    if (wind := plant.signal(context, "load_wind")) is not None:
        updraught = wind[2]
        causes += [f"wind blows upwards with {updraught:.3g} m/s"] if updraught > 0 else []
    causes += [f"load_trajectory accelerates downwards by {fall:.3g} m/s^2"] if fall > 0 else []
    return (
        "all of them are slack, and cannot push it down; reduce what asks for that at t = 0, or "
        f"let it start later: {', '.join(causes) or 'the forces on the load'}"
    )


def on_reference(nonstop: Diagram, context: Context) -> None:
    """Sets load and carriers to their references at the context's time, with their velocities.

    Whatever samples or holds takes its first value.
    """
    loop, own = innermost(nonstop, context, LOOP_SIGNALS)
    plant = PlantStates(loop)
    simulator = Simulator(nonstop, context)
    plant.set_states(own, load_state=plant.required(own, "reference")[:LOAD_STATE_SIZE])
    simulator.Initialize()
    plant.set_states(own, carrier_state=plant.required(own, "carrier_reference"))
    plant.trim_cables(own)


def _newton(function: Callable[[NDArray], NDArray], start: NDArray) -> tuple[NDArray, bool]:
    """Drives the function (6,) of an offset (6,) to zero.

    The slopes are corrected by what a step shows (C. G. Broyden, A class of methods for solving
    nonlinear simultaneous equations, Mathematics of Computation 19, 1965), and found anew where a
    step has not made it much smaller.

    Returns its last value, and whether each step would have led further than the linear model
    reaches.
    """
    offset, residual, is_far = start, function(start), True
    slopes, last = np.zeros((6, 6)), math.inf
    for _ in range(20):
        size = np.max(np.abs(residual))
        if size < _REST / 1e3:
            break
        if not size < _ENOUGH * last:
            slopes = _slopes(function, offset, residual)
        try:
            step = np.linalg.solve(slopes, residual)
        except np.linalg.LinAlgError:  # what nothing turns, such as a point mass, stays as it is
            step = np.linalg.lstsq(slopes, residual, rcond=None)[0]
        is_far &= bool(np.max(np.abs(step)) > _REACH)
        while np.max(np.abs(step)) > _REACH:
            step = step / 2
        offset = offset - step
        residual, before, last = function(offset), residual, size
        length, change = step @ step, residual - before
        if length > 0 and np.all(np.isfinite(change)):
            slopes = slopes - np.outer(change + slopes @ step, step) / length
        else:
            last = 0.0
    return residual, is_far


def _slopes(function: Callable[[NDArray], NDArray], at: NDArray, value: NDArray) -> NDArray:
    """The Jacobian by differences from the value: steps need no more."""
    columns = [(function(at + step) - value) / _STEP for step in _STEP * np.eye(len(at))]
    return np.column_stack(columns)


def _moved(state: NDArray, offset: NDArray) -> NDArray:
    """A load state (13,) rotated by a rotation vector and shifted, both in W (6,)."""
    rotation_vector, shift = np.split(offset, 2)
    quaternion, position, *twist = LoadState.view(state)
    rotated = rotate_quaternion(quaternion, rotation_vector)
    return np.concatenate([rotated, position + shift, *twist])
