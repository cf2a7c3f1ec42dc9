"""How fast deviations of the sampled loop of load, cables, carriers and controllers grow.

`LoadDeviations` has a load whose controller is continuous and whose carriers are where they should
be. Samples take damping away from the load's fast rotation, and where a cable has little tension T,
a force moves its carrier by L/T times as much within a sample.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.grasp import cable_forces_and_rates
from drake_nonstop.mechanics.internal_force import (
    internal_force,
    internal_force_acceleration,
    internal_force_jerk,
)
from drake_nonstop.mechanics.rotation import rotation_matrix
from drake_nonstop.mechanics.signals import LOAD_STATE_SIZE, LoadReference
from drake_nonstop.mechanics.tethered_loop import Orbit
from drake_nonstop.mechanics.wrench import feedforward_wrench
from drake_nonstop.optimization.turn_of_loops import turn_of_loops
from drake_nonstop.simulation.task import Task

_PHASES = 24  # of a turn, about, at which the loop is linearized


class SampledGrowth(NamedTuple):
    """How deviations of the load grow; NaN: the loop is not known, or cables do not stretch."""

    rate: float = math.nan  # 1/s, from turn to turn, that of the largest Floquet multiplier
    in_turn: float = math.nan  # logarithm of how many times, at most, from any phase on in a turn


def sampled_growth(
    task: Task,
    reference: NDArray,
    parameters: NDArray,
    gains: Mapping[str, Any] | None = None,
) -> SampledGrowth:
    """That of the loop of `mechanics.tethered_loop`, linearized at phases of the orbits.

    A loop whose multipliers are small may still lose the load: where a cable is nearly slack for a
    part of each turn, deviations grow in it before they decay.

    Args:
        task: what is flown.
        reference: (22,) of the load, whose motion stays as it is.
        parameters: [ξ (rad/s), A (N)] (2,).
        gains: in place of the wrench controller's.
    """
    carriers, feedback = task.carriers, task.feedback
    if carriers is None or feedback is None or not math.isfinite(task.flown.cable_stiffness):
        return SampledGrowth()
    if gains is not None:
        feedback = replace(feedback, gains={**feedback.gains, **gains})
    found = turn_of_loops(
        task.model,
        task.flown,
        carriers,
        feedback,
        float(parameters[0]),
        lambda angle: _orbit(task, reference, angle, parameters),
        phases=_PHASES,
    )
    radius = float(np.linalg.norm(task.flown.attachments, axis=1).max())
    return SampledGrowth(found.rate, found.growth_in_turn(radius))


def _orbit(task: Task, reference: NDArray, angle: float, parameters: NDArray) -> Orbit:
    """The forces and their rates, in the load's frame; velocities, which do not matter, are 1."""
    model, state = task.model, reference[:LOAD_STATE_SIZE]
    wrench, rate = feedforward_wrench(model.load, reference, task.wind)
    pattern = model.pattern
    internal = np.concatenate(
        internal_force(parameters, np.array([angle]), phases=pattern.phases, orders=pattern.orders)
    )
    second = internal_force_acceleration(parameters, internal, orders=pattern.orders)
    forces, rates = cable_forces_and_rates(
        state,
        wrench,
        rate,
        internal,
        pseudo_inverse=model.pseudo_inverse,
        basis=pattern.basis,
        offset=pattern.offset,
    )
    turned = rotation_matrix(LoadReference.view(reference).quaternion)
    third = internal_force_jerk(parameters, internal, orders=pattern.orders)
    return Orbit(
        forces @ turned,
        rates @ turned,
        (pattern.basis @ second).reshape(-1, 3),
        (pattern.basis @ third).reshape(-1, 3),
        np.ones_like(forces),
    )
