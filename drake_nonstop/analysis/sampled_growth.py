"""How fast deviations of the sampled loop of load, cables, carriers and controllers grow.

`LoadDeviations` has a load whose controller is continuous and whose carriers are where they should
be. Samples take damping away from the load's fast rotation, and where a cable has little tension T,
a force moves its carrier by L/T times as much within a sample.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.analysis.sampled_maps import largest_growth
from drake_nonstop.analysis.task import Task
from drake_nonstop.analysis.tethered_loop import Carriers, Feedback, Orbit, growth_rate, maps_at
from drake_nonstop.mechanics.rotation import cross
from drake_nonstop.mechanics.signals import PlannedParameters, constant_plan
from drake_nonstop.model.system import Model
from drake_nonstop.planning.carriers import orbit_terms

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


def growth_on_the_way(task: Task, planned: Planned, *, phases: int = 24) -> SampledGrowth:
    """Growth of the loop of `tethered_loop`, linearized along the plan.

    A loop whose Floquet multipliers are small may still lose the load: where a cable is nearly
    slack for a part of each turn, deviations grow in it before they decay. An attitude's size is
    that of the distance it makes at the attachment that is farthest from the centre.

    Args:
        task: what is flown.
        planned: the plan.
        phases: of a nominal turn, at which the loop is linearized. Between them the maps from
            sample to sample are interpolated, which overrates what grows where tension is small.
    """
    if (loop := _loop_of(task)) is None:
        return SampledGrowth()
    period = loop[-1].period
    turn = 2 * math.pi / task.limits.frequency
    knots = np.linspace(0.0, task.duration, 1 + phases * max(1, round(task.duration / turn)))
    orbits = (
        _orbit(task, task.reference(float(time)), float(values[0]), values[1:3])
        for time, values in zip(knots, planned(knots), strict=True)
    )
    maps = maps_at(*loop, orbits)
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


def sampled_rate(task: Task) -> float:
    """1/s, at which a deviation grows from turn to turn at the task's start; NaN: not known."""
    if (loop := _loop_of(task)) is None:
        return math.nan
    orbit = partial(_orbit, task, task.reference(0.0), parameters=task.nominal)
    return growth_rate(*loop, float(task.nominal[0]), orbit)


def _loop_of(task: Task) -> tuple[Model, Model, Carriers, Feedback] | None:
    """Parts of the loop; None: they are not known."""
    carriers, feedback = task.response.carriers, task.response.feedback
    stretches = bool(np.all(np.isfinite(task.flown.cable_stiffness)))
    if carriers is None or feedback is None or not stretches:
        return None
    measured = task.response.measured_gains or {}
    feedback = replace(feedback, gains={**feedback.gains, **measured})
    return task.model, task.flown, carriers, feedback


def _orbit(task: Task, reference: NDArray, angle: float, parameters: NDArray) -> Orbit:
    """Cable forces and their rates above a load on its reference, in the load's frame."""
    model, pattern = task.model, task.model.pattern
    terms = orbit_terms(model, [reference], [task.wind])
    series = PlannedParameters.view(constant_plan(np.array([angle]), *parameters)).series
    own = pattern.forces(*series)
    forces, rates, *_ = (part[0] for part in (terms.forces + own).rates)
    _, _, second, third = (part[0] for part in own.rates)
    rates = rates + cross(terms.motion.angular_velocity.rates[0][0], forces)
    return Orbit(forces, rates, second, third)
