"""How a deviation grows, within a part of a turn, while a cable is nearly slack.

A force moves the place of a carrier above its load by L/T times it, and its velocity as its cable
turns. With little tension T that is much within a sample, and the sampled loop of load, carriers
and feedback is unstable for that part of the turn, which an analysis without samples does not tell.
"""

import math
from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.grasp import cable_forces_and_rates
from drake_nonstop.mechanics.internal_force import internal_force
from drake_nonstop.mechanics.rotation import rotation_matrix
from drake_nonstop.mechanics.signals import LOAD_STATE_SIZE, WRENCH_SIZE, LoadReference
from drake_nonstop.mechanics.tethered_loop import Cables, Orbit, tethered_loop
from drake_nonstop.mechanics.wrench import NO_FEEDBACK, wrench_and_rate
from drake_nonstop.simulation.task import Task

LITTLE_TENSION = 0.3  # of an equal share of the weight, below which a cable is looked at
_WITHIN = 0.5  # s, in which a deviation grows; slower growth is that of `LoadDeviations`
_SCREEN = 4  # samples, one at which tensions are looked at
_MOST_SAMPLES = 600  # at which the loop is linearized, those with the least tension first
_LARGEST = 1e12  # of a growth


class SampledGrowth(NamedTuple):
    """The largest growth of a deviation of the load's position and attitude within half a second.

    Attitudes count with the radius of the attachments.
    """

    factor: float  # of its size
    start: float  # s
    end: float  # s
    tension: float  # N, the least of a cable at that time
    cable: int  # from 1 on


def sampled_growth(
    task: Task,
    parameters: Callable[[float], NDArray],
    duration: float | None = None,
    *,
    enough: float = _LARGEST,
) -> SampledGrowth | None:
    """The largest growth along a plan; None: no cable has little tension, or the loop is not known.

    The loop is linearized at each sample, `mechanics.tethered_loop`.

    Args:
        task: what is flown.
        parameters: [ξ (rad/s), A (N)] (2,) at a time in s.
        duration: s, from the start; None: all of the task.
        enough: a factor with which the search ends.
    """
    is_known = task.carriers is not None and task.feedback is not None
    if not is_known or not math.isfinite(task.flown.cable_stiffness):
        return None
    assert task.feedback is not None
    period = task.feedback.period
    count = max(2, int((task.duration if duration is None else duration) / period))
    times = period * np.arange(count)
    values = np.array([parameters(time) for time in times])
    angles = np.concatenate([[0.0], np.cumsum(period * (values[1:, 0] + values[:-1, 0]) / 2)])
    forces = [_orbit(task, times[k], angles[k], values[k]).forces for k in range(0, count, _SCREEN)]
    tensions = np.linalg.norm(forces, axis=-1)
    share = task.flown.load_mass * task.flown.gravity / task.flown.n
    found = None
    left = _MOST_SAMPLES
    for first, end in _stretches(tensions.min(axis=1), LITTLE_TENSION * share):
        samples = range(max(first - 1, 0) * _SCREEN, min((end + 1) * _SCREEN, count))[:left]
        left -= len(samples)
        if len(samples) == 0:
            break
        maps = (_transition(task, _orbit(task, times[k], angles[k], values[k])) for k in samples)
        factor, start, last = _largest(maps, task, math.ceil(_WITHIN / period), enough)
        if found is None or factor > found.factor:
            near = tensions[first:end]
            cable = int(np.argmin(near.min(axis=0)))
            begin, finish = float(times[samples[start]]), float(times[samples[last]] + period)
            found = SampledGrowth(factor, begin, finish, float(near.min()), cable + 1)
            if factor >= enough:
                break
    return found


def _orbit(task: Task, time: float, angle: float, parameters: NDArray) -> Orbit:
    """The forces and their rates, in the load's frame; velocities, which do not matter, are 0."""
    model, reference = task.model, task.reference(time)
    state = reference[:LOAD_STATE_SIZE]
    wrench, rate = wrench_and_rate(
        model.load,
        state,
        reference,
        np.zeros(WRENCH_SIZE),
        task.wind,
        feedforward=1.0,
        **NO_FEEDBACK,
    )
    pattern = model.pattern
    internal = np.concatenate(
        internal_force(parameters, np.array([angle]), phases=pattern.phases, orders=pattern.orders)
    )
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
    return Orbit(forces @ turned, rates @ turned, np.zeros_like(forces))


def _transition(task: Task, orbit: Orbit) -> NDArray:
    assert task.carriers is not None
    assert task.feedback is not None
    flown, feedback = task.flown, task.feedback
    cables = Cables(
        attachments=flown.attachments,
        stiffness=flown.cable_stiffness,
        damping=flown.cable_damping,
        rest_length=flown.cable_length,
        compliance=task.model.cable_compliance,
    )
    return tethered_loop(
        flown.load,
        cables,
        task.carriers,
        feedback.gains,
        orbit,
        pseudo_inverse=task.model.pseudo_inverse,
        period=feedback.period,
        delay=feedback.delay,
        is_measured=feedback.is_measured,
    ).transition


def _stretches(tensions: NDArray, limit: float) -> list[tuple[int, int]]:
    """First and end of each in which tensions (k,) are below a limit, the least tension first."""
    is_low = np.concatenate([[False], tensions < limit, [False]])
    edges = np.flatnonzero(np.diff(is_low.astype(int))).reshape(-1, 2).tolist()
    return sorted(((a, b) for a, b in edges), key=lambda ends: float(tensions[slice(*ends)].min()))


def _largest(
    maps: Iterable[NDArray], task: Task, window: int, enough: float
) -> tuple[float, int, int]:
    """The largest growth of a pose within `window` maps, and the first and last map of it."""
    radius = float(np.linalg.norm(task.flown.attachments, axis=1).max())
    scale = np.array([radius] * 3 + [1.0] * 3)
    states: NDArray | None = None
    best = (0.0, 0, 0)
    for k, transition in enumerate(maps):
        begun = np.zeros((len(transition), 1, 6))
        begun[:6, 0] = np.diag(1 / scale)
        states = begun if states is None else np.concatenate([states, begun], axis=1)[:, -window:]
        states = np.tensordot(transition, states, axes=1)
        poses = np.moveaxis(states[:6] * scale[:, None, None], 1, 0)
        factors = np.linalg.norm(poses, ord=2, axis=(1, 2))
        j = int(np.argmax(factors))
        best = max(best, (float(factors[j]), k + 1 - len(factors) + j, k))
        if best[0] >= enough:
            break
    return best
