"""Whether the formation that carries a load is stable, at rest and on its way."""

import contextlib
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.analysis.load_stability import Growth
from drake_nonstop.analysis.sampled_growth import (
    Planned,
    SampledGrowth,
    growth_on_the_way,
    sampled_rate,
)
from drake_nonstop.analysis.task import Task
from drake_nonstop.mechanics.grasp import grasp_matrix
from drake_nonstop.mechanics.rigid_load import STILL_AIR
from drake_nonstop.mechanics.signals import PlannedParameters, constant_plan
from drake_nonstop.mechanics.wrench import FEEDBACK_GAINS, NO_FEEDBACK
from drake_nonstop.model.pattern import LinearPatternConfig
from drake_nonstop.model.system import Model
from drake_nonstop.planning.carriers import motion_above, orbit_terms
from drake_nonstop.planning.plan import Plan
from drake_nonstop.validation import ScenarioError

_MOST_GROWN = 1.0  # logarithm of what becomes of a deviation of 1, of a sound task
_MOST_GROWN_IN_SAMPLES = 4.5  # likewise
_SURELY_LOST = math.log(1e5)  # likewise: what holds leave, some micrometres, is a part of a metre
_CLOSER = 96  # phases of a turn, where deviations grow in the samples at fewer
_GAIN_FACTORS = (2.0, 4.0, 8.0, 0.5, 0.25)
_HALVINGS = 6  # of the range of A
_LEAST_AMPLITUDE = 0.05  # of the nominal A
_HORIZONTAL_WEIGHT = 1e-3  # of an offset's horizontal forces beside the shares that it evens out
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
    growth: float  # at most, of the logarithm of a deviation, from any instant on: ∫ of the rate
    sampled_rate: float  # 1/s, of a deviation at rest, with samples and carriers; NaN: not known
    sampled: SampledGrowth  # likewise, on the way

    @property
    def is_stable(self) -> bool:
        """Whether no deviation grows beyond e times its size until the task's end.

        What grows in samples alone begins with what holds leave, some micrometres: it may grow 90
        times.
        """
        return self.growth < _MOST_GROWN and not self.is_lost_in_samples

    @property
    def is_lost_in_samples(self) -> bool:
        """Whether the sampled loop of load, carriers and controllers is unstable."""
        return self.sampled.growth >= _MOST_GROWN_IN_SAMPLES

    @property
    def is_in_doubt(self) -> bool:
        """Whether it is unstable, and yet a flight may end before the load is lost."""
        is_short = self.growth < _SURELY_LOST and not self.sampled.growth >= _SURELY_LOST
        return is_short and not self.is_stable

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
    """How the cables share the load's weight over an orbit of [ξ, A] (2,).

    The load's motion stays as it is in its reference (22,); the wind (3,) is in m/s, in W.
    """
    terms = orbit_terms(model, [reference], [STILL_AIR if wind is None else wind])
    planned = constant_plan(_ANGLES, *parameters)
    forces = motion_above(model, terms, planned).forces
    vertical = forces[..., 2]
    shares = vertical * model.n / (model.load_mass * model.gravity)
    elevations = np.arctan2(vertical, np.hypot(forces[..., 0], forces[..., 1]))
    return CableLoads(
        shares.min(axis=0),
        elevations.min(axis=0),
        shares.mean(axis=0),
        float(np.linalg.norm(forces, axis=-1).min()),
    )


def formation_at(task: Task, time: float, parameters: NDArray) -> FormationInstant:
    """The formation at a time (s) with [ξ, A] (2,)."""
    reference, gains = task.reference(time), task.response.measured_gains
    growth = partial(task.deviations.growth, reference, parameters, wind=task.wind)
    return FormationInstant(
        time,
        parameters,
        cable_loads(task.flown, reference, parameters, task.wind),
        growth(),
        None if gains is None else growth(gains),
    )


def find_formation(task: Task, plan: Plan | None = None, *, count: int = 8) -> Formation:
    """The formation at the start, at the middles of `count` equal parts of the way, and in samples.

    The plan is one of ξ and A; None: they are the nominal ones.
    """
    part = task.duration / count
    times = part * (np.arange(count) + 0.5)
    instants = tuple(
        formation_at(task, time, values[1:3])
        for time, values in zip(times.tolist(), task.planned(plan, times), strict=True)
    )
    return Formation(
        formation_at(task, 0.0, task.nominal),
        instants,
        _largest_growth([part * instant.rate for instant in instants]),
        sampled_rate(task),
        _growth_in_samples(task, partial(task.planned, plan)),
    )


def _growth_in_samples(task: Task, planned: Planned) -> SampledGrowth:
    found = growth_on_the_way(task, planned)
    if found.growth >= _MOST_GROWN_IN_SAMPLES:
        found = growth_on_the_way(task, planned, phases=_CLOSER)
    return found


def _largest_growth(parts: Sequence[float]) -> float:
    """The largest sum of successive parts, at least 0."""
    largest = total = 0.0
    for part in parts:
        total = max(0.0, total + part)
        largest = max(largest, total)
    return largest if math.isfinite(sum(parts)) else math.nan


def growth_complaint(task: Task, duration: float, *, in_samples: bool = False) -> str:
    """A sentence on a formation that is unstable at the task's start; "" where it is not.

    Args:
        task: whose start is looked at.
        duration: s, in which a deviation may grow; less than a turn of the carriers: nothing is
            looked at.
        in_samples: whether the sampled loop of load, carriers and controllers is looked at, too.
    """
    if not duration * task.limits.frequency >= 2 * math.pi:
        return ""
    gains = task.response.measured_gains or NO_FEEDBACK

    def rate(of_amplitude: float) -> float:
        parameters = task.nominal * np.array([1.0, of_amplitude])
        return task.deviations.growth(task.reference(0.0), parameters, gains, wind=task.wind).rate

    def is_stable(task: Task, of_amplitude: float = 1.0) -> bool:
        return rate(of_amplitude) * duration < _MOST_GROWN

    found = rate(1.0)
    remedy = "let drake-nonstop check try what helps"
    if found * duration < _MOST_GROWN:
        if not in_samples:
            return ""
        sampled = _growth_in_samples(replace(task, duration=duration), partial(task.planned, None))
        if not sampled.growth >= _MOST_GROWN_IN_SAMPLES:
            return ""
        return (
            "formation = unstable: in the samples of the controllers a small deviation of the "
            f"load grows {sampled.sentence}; {remedy}"
        )
    if (amplitude := _largest_amplitude(task, is_stable)) is not None:
        remedy = f"give optimization_layer.amplitude of at most {amplitude:.3g} N, or {remedy}"
    return (
        "formation = unstable: at the start a small deviation of the load grows by "
        f"{found:.2g} 1/s; {remedy}"
    )


def find_formation_remedies(
    task: Task, found: Formation, plan: Plan | None = None, *, worst: float = math.nan
) -> list[str]:
    """Remedies that make the formation stable with all cables taut where it is worst, each tried.

    Those are a smaller A, an offset in the null space that evens the shares out, other gains, and
    other attachments. `worst` is a time in s that counts, too; NaN: none.
    """
    first = [time for time in (worst, found.worst.time) if math.isfinite(time)]
    others = {
        0.0,
        *(instant.time for instant in found.on_the_way[:: len(found.on_the_way) // 3 + 1]),
    }
    times = [*first, *sorted(others - {*first})]

    def is_stable(task: Task, of_amplitude: float = 1.0) -> bool:
        def planned(times: NDArray) -> NDArray:
            values = task.planned(plan, times)
            PlannedParameters.view(values).amplitude[:] *= of_amplitude
            return values

        for time, values in zip(times, planned(np.array(times)), strict=True):
            loads = cable_loads(task.flown, task.reference(time), values[1:3], task.wind)
            if not np.min(loads.shares) > 0:
                return False
            if formation_at(task, time, values[1:3]).rate * task.duration >= _MOST_GROWN:
                return False
        if found.growth >= _MOST_GROWN:
            return True
        return not growth_on_the_way(task, planned).growth >= _MOST_GROWN_IN_SAMPLES

    remedies = []
    if (amplitude := _largest_amplitude(task, is_stable)) is not None:
        remedies.append(f"optimization_layer.amplitude={amplitude:.3g}")
    remedies += _other_gains(task, is_stable)
    for name, changed in _other_formations(task):
        with contextlib.suppress(ScenarioError):  # a formation that cannot be
            if is_stable(changed()):
                remedies.append(name)
    return remedies


_IsStable = Callable[..., bool]


def _largest_amplitude(task: Task, is_stable: _IsStable) -> float | None:
    """N, by bisection; None: no amplitude down to a small one helps."""
    low, high = _LEAST_AMPLITUDE, 1.0
    if not is_stable(task, of_amplitude=low):
        return None
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if is_stable(task, of_amplitude=middle) else (low, middle)
    return low * task.limits.amplitude


def _other_gains(task: Task, is_stable: _IsStable) -> list[str]:
    response, gains = task.response, task.response.measured_gains
    if response.feedback is None or not gains or not any(map(np.any, gains.values())):
        return []
    for factor in _GAIN_FACTORS:
        others = {name: factor * np.asarray(gains[name]) for name in FEEDBACK_GAINS}
        feedback = replace(response.feedback, gains={**gains, **others})
        if is_stable(replace(task, response=replace(response, feedback=feedback))):
            return [f"gains of the wrench controller {factor:g} times as large"]
    return []


def _other_formations(task: Task) -> Iterator[tuple[str, Callable[[], Task]]]:
    """Formations whose cables share the weight more evenly, and how to ask for them."""
    model = task.flown
    attachments = model.attachments
    offset = _evening_offset(model)
    if offset is not None:
        pattern = model.pattern
        config = LinearPatternConfig(
            basis=pattern.basis.tolist(),
            phases=pattern.phases.tolist(),
            offset=np.round(pattern.offset + offset, 12).tolist(),
        )
        said = f"pattern=LinearPattern with the offset {np.round(config.offset, 3).tolist()} N"
        yield said, lambda: task.changed(config)
    centred = attachments - attachments.mean(axis=0) * [1, 1, 0]
    angles = np.arctan2(centred[:, 1], centred[:, 0])
    first, radius = angles[0], np.linalg.norm(centred[:, :2], axis=1).mean()
    side = 1 if np.sin(np.diff(angles)).sum() >= 0 else -1
    even = first + side * 2 * np.pi * np.arange(model.n) / model.n
    polygon = np.stack([radius * np.cos(even), radius * np.sin(even), centred[:, 2]], axis=1)
    for places, what in ((centred, "about the centre of mass"), (polygon, "a regular polygon")):
        rounded = np.round(places, 3).tolist()
        said = f"system.attachments={rounded}, {what}"
        yield said, partial(task.changed, attachments=rounded)


def _evening_offset(model: Model) -> NDArray | None:
    """Forces (3n,), N, in L, without a wrench that even the vertical shares out, if any do."""
    weight = np.array([0.0, 0.0, 0.0, 0.0, 0.0, model.load_mass * model.gravity])
    held = model.pseudo_inverse @ weight + model.pattern.offset
    _, values, rows = np.linalg.svd(grasp_matrix(model.attachments))
    null_space = rows[len(values) :].T
    is_vertical = np.arange(3 * model.n) % 3 == 2
    weights = np.where(is_vertical, 1.0, _HORIZONTAL_WEIGHT)
    wanted = np.where(is_vertical, weight[-1] / model.n - held, 0.0)
    found = np.linalg.lstsq(weights[:, None] * null_space, weights * wanted, rcond=None)[0]
    offset: NDArray = null_space @ found
    return offset if np.max(np.abs(offset[is_vertical])) > 1e-3 * weight[-1] / model.n else None
