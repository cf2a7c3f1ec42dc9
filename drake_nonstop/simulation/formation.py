"""Whether the formation that carries a load is stable, at rest and on its way."""

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.grasp import in_load_frame
from drake_nonstop.mechanics.internal_force import internal_force
from drake_nonstop.mechanics.signals import LOAD_STATE_SIZE, WIND_SIZE, WRENCH_SIZE
from drake_nonstop.mechanics.wrench import wrench_and_rate
from drake_nonstop.model.system import Model
from drake_nonstop.simulation.load_stability import NO_GAINS, Growth, LoadDeviations
from drake_nonstop.simulation.task import Task

Parameters = Callable[[float], NDArray]  # [ξ (rad/s), A (N)] (2,) at a time in s

_ANGLES = 2 * np.pi * np.arange(72) / 72  # rad, of the orbit


class CableLoads(NamedTuple):
    """How n cables share a load's weight over an orbit, the least of each.

    A share is in units of an equal share m g / n, of the vertical force; the elevation is that of
    the force on the load, above the horizontal.
    """

    shares: NDArray  # (n,)
    elevations: NDArray  # (n,), rad
    mean_shares: NDArray  # (n,), over the orbit
    least_tension: float  # N


class FormationInstant(NamedTuple):
    """A formation at an instant, with the motion that the load has then."""

    time: float  # s
    parameters: NDArray  # (2,), [ξ (rad/s), A (N)]
    loads: CableLoads
    free: Growth  # without control
    controlled: Growth | None  # with the scenario's; None: it is not known

    @property
    def rate(self) -> float:
        """1/s, with control, or without where that is not known."""
        return (self.controlled or self.free).rate


class Formation(NamedTuple):
    """A formation at rest and at instants of its way."""

    at_rest: FormationInstant  # at the start, with the first ξ and A
    on_the_way: tuple[FormationInstant, ...]
    growth: float  # ∫ of the rate, of the logarithm of a deviation, at most, from any instant on

    @property
    def instants(self) -> tuple[FormationInstant, ...]:
        """All of them."""
        return (self.at_rest, *self.on_the_way)

    @property
    def worst(self) -> FormationInstant:
        """That with the largest rate."""
        return max(self.instants, key=lambda instant: instant.rate)


def cable_loads(
    model: Model, reference: NDArray, parameters: NDArray, wind: NDArray | None = None
) -> CableLoads:
    """How the cables share the load's weight over an orbit.

    Args:
        model: of load, cables and pattern.
        reference: (22,) of the load, whose motion stays as it is over the orbit.
        parameters: [ξ (rad/s), A (N)] (2,).
        wind: at the load (3,), m/s, in W.
    """
    pattern = model.pattern
    state = reference[:LOAD_STATE_SIZE]
    calm = np.zeros(WIND_SIZE)
    wrench, rate = wrench_and_rate(
        model.load,
        state,
        reference,
        np.zeros(WRENCH_SIZE),
        calm if wind is None else wind,
        feedforward=1.0,
        **NO_GAINS,
    )
    R_LW, _, wrench_L, _ = in_load_frame(state, wrench, rate)
    values, _ = internal_force(
        parameters, _ANGLES[:, None], phases=pattern.phases, orders=pattern.orders
    )
    forces = model.pseudo_inverse @ wrench_L + pattern.offset + values @ pattern.basis.T
    forces = forces.reshape(len(_ANGLES), model.n, 3) @ R_LW
    vertical = forces[..., 2]
    shares = vertical * model.n / (model.load_mass * model.gravity)
    elevations = np.arctan2(vertical, np.hypot(forces[..., 0], forces[..., 1]))
    return CableLoads(
        shares.min(axis=0),
        elevations.min(axis=0),
        shares.mean(axis=0),
        float(np.linalg.norm(forces, axis=-1).min()),
    )


def formation_at(
    task: Task,
    deviations: LoadDeviations,
    time: float,
    parameters: NDArray,
    gains: Mapping[str, Any] | None,
) -> FormationInstant:
    """The formation at a time (s) with [ξ, A] (2,); gains as of `Task`."""
    reference = task.reference(time)
    controlled = None
    if gains is not None:
        controlled = deviations.growth(reference, parameters, gains, wind=task.wind)
    return FormationInstant(
        time,
        parameters,
        cable_loads(task.flown, reference, parameters, task.wind),
        deviations.growth(reference, parameters, wind=task.wind),
        controlled,
    )


def find_formation(task: Task, parameters: Parameters | None = None, *, count: int = 8) -> Formation:
    """The formation at the start and at `count` instants of a task.

    Args:
        task: what is flown.
        parameters: ξ and A over the time, such as those of a plan; None: the nominal ones.
        count: of the instants on the way, at the middles of equal parts of it.
    """
    at = parameters or (lambda time: task.nominal)
    deviations, gains = task.deviations(), task.effective_gains
    at_rest = formation_at(task, deviations, 0.0, task.nominal, gains)
    part = task.duration / count
    instants = tuple(
        formation_at(task, deviations, time, at(time), gains)
        for time in part * (np.arange(count) + 0.5)
    )
    largest = total = 0.0
    for instant in instants:
        total = max(0.0, total + part * instant.rate)
        largest = max(largest, total)
    return Formation(at_rest, instants, largest)
