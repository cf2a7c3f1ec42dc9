"""How fast deviations of the sampled loop of load, cables, carriers and controllers grow.

`LoadDeviations` has a load whose controller is continuous and whose carriers are where they should
be. Samples take damping away from the load's fast rotation, and where a cable has little tension T,
a force moves its carrier by L/T times as much within a sample.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.analysis.task import Task
from drake_nonstop.mechanics.grasp import cable_forces_and_rates
from drake_nonstop.mechanics.internal_force import (
    internal_force,
)
from drake_nonstop.mechanics.rotation import rotation_matrix
from drake_nonstop.mechanics.sampled_loop import largest_growth
from drake_nonstop.mechanics.signals import LOAD_STATE_SIZE, LoadReference
from drake_nonstop.mechanics.wrench import feedforward_wrench
from drake_nonstop.model.system import Model
from drake_nonstop.optimization.tethered_loop import (
    Carriers,
    Feedback,
    Orbit,
    loops_at,
    turn_of_loops,
)

_STARTS = 60  # at most, from which on deviations are followed
_PER_TURN = 4  # likewise

Planned = Callable[[NDArray], NDArray]  # θ, ξ, A and their rates (k, 8) at times (k,), s


class SampledGrowth(NamedTuple):
    """How a deviation of the load's pose grows on the way of a task, at most.

    NaN: the loop is not known, or cables do not stretch.
    """

    growth: float = math.nan  # logarithm of how many times, at least 0
    start: float = math.nan  # s, from when on
    end: float = math.nan  # s, until when

    @property
    def sentence(self) -> str:
        """How much, and when."""
        times = math.exp(self.growth)
        return f"{times:.2g} times from t = {self.start:.1f} to {self.end:.1f} s"


def growth_on_the_way(
    task: Task, planned: Planned, gains: Mapping[str, Any] | None = None, *, phases: int = 24
) -> SampledGrowth:
    """That of the loop of `optimization.tethered_loop`, linearized along the plan.

    A loop whose Floquet multipliers are small may still lose the load: where a cable is nearly
    slack for a part of each turn, deviations grow in it before they decay. An attitude's size is
    that of the distance it makes at the attachment that is farthest from the centre.

    Args:
        task: what is flown.
        planned: the plan.
        gains: in place of the wrench controller's.
        phases: of a nominal turn, at which the loop is linearized. Between them the maps from
            sample to sample are interpolated, which overrates what grows where tension is small.
    """
    if (loop := _loop_of(task, gains)) is None:
        return SampledGrowth()
    period = loop[-1].period
    turn = 2 * math.pi / task.limits.frequency
    knots = np.linspace(0.0, task.duration, 1 + phases * max(1, round(task.duration / turn)))
    orbits = (
        _orbit(task, task.reference(float(time)), float(values[0]), values[1:3])
        for time, values in zip(knots, planned(knots), strict=True)
    )
    maps = [each.transition for each in loops_at(*loop, orbits)]
    count = max(1, round(task.duration / period))
    at = np.arange(count) * (len(knots) - 1) / count

    def transitions() -> Iterator[NDArray]:
        for place in at:
            share = place % 1
            yield (1 - share) * maps[int(place)] + share * maps[int(place) + 1]

    radius = float(np.linalg.norm(task.flown.attachments, axis=1).max())
    spacing = max(1, round(turn / _PER_TURN / period), -(-count // _STARTS))
    found = largest_growth(transitions(), np.repeat([radius, 1.0], 3), spacing=spacing)
    return SampledGrowth(math.log(found.times), found.first * period, found.last * period)


def sampled_rate(
    task: Task,
    reference: NDArray,
    parameters: NDArray,
    gains: Mapping[str, Any] | None = None,
) -> float:
    """1/s, at which a deviation grows from turn to turn, the largest one; NaN: it is not known.

    Args:
        task: what is flown.
        reference: (22,) of the load, whose motion stays as it is.
        parameters: [ξ (rad/s), A (N)] (2,).
        gains: in place of the wrench controller's.
    """
    if (loop := _loop_of(task, gains)) is None:
        return math.nan
    orbit = partial(_orbit, task, reference, parameters=parameters)
    return turn_of_loops(*loop, float(parameters[0]), orbit).rate


def _loop_of(
    task: Task, gains: Mapping[str, Any] | None
) -> tuple[Model, Model, Carriers, Feedback] | None:
    """What the loop consists of, with these gains; None: it is not known."""
    carriers, feedback = task.response.carriers, task.response.feedback
    if carriers is None or feedback is None or not math.isfinite(task.flown.cable_stiffness):
        return None
    if gains is not None:
        feedback = replace(feedback, gains={**feedback.gains, **gains})
    return task.model, task.flown, carriers, feedback


def _orbit(task: Task, reference: NDArray, angle: float, parameters: NDArray) -> Orbit:
    """The forces and their rates, in the load's frame; velocities, which do not matter, are 1."""
    model, state = task.model, reference[:LOAD_STATE_SIZE]
    wrench, rate = feedforward_wrench(model.load, reference, task.wind)
    pattern = model.pattern
    *internal, second, third = internal_force(
        parameters, np.array([angle]), phases=pattern.phases, orders=pattern.orders
    )
    forces, rates = cable_forces_and_rates(
        state,
        wrench,
        rate,
        np.concatenate(internal),
        pseudo_inverse=model.pseudo_inverse,
        basis=pattern.basis,
        offset=pattern.offset,
    )
    turned = rotation_matrix(LoadReference.view(reference).quaternion)
    return Orbit(
        forces @ turned,
        rates @ turned,
        (pattern.basis @ second).reshape(-1, 3),
        (pattern.basis @ third).reshape(-1, 3),
        np.ones_like(forces),
    )
