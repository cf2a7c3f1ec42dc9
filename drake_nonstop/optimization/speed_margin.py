"""By how much a carrier may be slower than planned, and the margin that follows: share by share.

The assumptions under which the sum is a bound in continuous time, and what the shares are worth,
are in diagrams/speed_error_budget.md.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.carrier import carrier_acceleration, carrier_jerk, carrier_motion
from drake_nonstop.mechanics.planned_orbit import OrbitTerms
from drake_nonstop.mechanics.rotation import rotation_matrix
from drake_nonstop.mechanics.sampled_loop import (
    SampledLoop,
    bounded_response,
    growth,
    growth_in_turn,
    known_response,
    noise_deviation,
    overshoot,
    parts_of_turn,
    responses,
    step_response,
    waves_deviation,
)
from drake_nonstop.mechanics.signals import LoadReference, resting_reference
from drake_nonstop.mechanics.tethered_loop import (
    Cables,
    Carriers,
    Estimator,
    Inputs,
    Orbit,
    tethered_loop,
)
from drake_nonstop.model.system import Model
from drake_nonstop.optimization.horizon_problem import HorizonConfig, HorizonProblem, timed
from drake_nonstop.optimization.problem_config import LimitsConfig, amplitude_range
from drake_nonstop.optimization.terminal_set import product_limits

DEVIATIONS = 5.0  # standard deviations of noise: a normal value falls below with 2.9e-7
_PHASES = 24  # of the orbits, at which speeds and their rates are looked at
_LOOPS = 60  # about as many phases the loop is linearized: steps of forces between them count
_SEEMS_TO_GROW = 0.05  # per s
_SEEN = 3  # of these phases, at which the shortfalls are looked at
_MEMORY = 10.0  # s, of the inputs that matter for a shortfall
_LARGEST_GROWTH = 0.2  # per s, beyond which there is no margin
_AMPLITUDES = 25  # among which the plan's is looked for
_SPARSE = 5  # of the instants, one at which it is
_NEAR = 1.5  # of the speed that is aimed at, up to which a speed may dip below it
_AMPLITUDE_WEIGHT = 4.0  # of (A/A₀ − 1)² beside (ξ/ξ₀ − 1)², as plans weigh them
_FIRST = 0.02  # of ε, a margin to begin with
_REPEATS = 4  # of the margin, as a larger one asks for faster orbits
_LEAST_SPEED = 1e-9  # m/s
_SAME = 1.1  # of a margin, by which the next one is larger to begin with


@dataclass(frozen=True, kw_only=True, eq=False)
class Feedback:
    """What the loop does with errors of the load.

    Attributes:
        gains: of `mechanics.wrench.wrench_and_rate`, by name.
        deviations: (12,), standard deviations of the measured [e_R, e_p, e_ω, e_v]; SI.
        is_measured: (12,), 0 for what the controller takes as desired, else 1.
        delay: of the measurement, in samples.
        period: between samples, s.
        estimator: of the errors, behind the measurement; None: there is none.
    """

    gains: Mapping[str, Any]
    deviations: NDArray
    is_measured: NDArray
    delay: int
    period: float
    estimator: Estimator | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """The load's reference over a task.

    Attributes:
        times: (k,), s, the instants.
        references: (3, k, 22), at k instants, a `step` before, then, and a step after.
        step: s.
        jerk_jumps: (m, 3), m/s³, jumps of its jerk, in the load's frame; m may be 0.
    """

    times: NDArray
    references: NDArray
    step: float
    jerk_jumps: NDArray


class Gust(NamedTuple):
    """Coloured noise on the load, a sum of waves of equal size on each axis."""

    deviations: NDArray  # (6,), N m and N, in W, standard deviations
    frequencies: NDArray  # rad/s, of the waves


@dataclass(frozen=True, kw_only=True, eq=False)
class Disturbance:
    """What acts on the load besides cables and weight, in W.

    Attributes:
        believed: (k, 3), N, at the instants of the motion: forces that the controllers know of.
        unknown: (6,), [torque; force], N m and N, steady and not known to them.
        gusts: independent of one another.
    """

    believed: NDArray
    unknown: NDArray
    gusts: tuple[Gust, ...] = ()

    @property
    def is_any(self) -> bool:
        """Whether anything acts."""
        return bool(np.any(self.believed) or np.any(self.unknown) or self.gusts)


@dataclass(frozen=True, kw_only=True)
class SpeedMargin:
    """The shares of a margin, each m/s, of the largest shortfall of a speed."""

    tracking: float  # of the carriers behind held references
    jumps: float  # beyond the planned velocities, where the reference's jerk jumps
    grid: float  # between the instants of the constraints
    noise: float  # of the feedback, `DEVIATIONS` standard deviations
    delay: float  # of the feedback
    model: float  # of a wrench that is off by a share of the weight
    disturbance: float  # of steady forces on the load, and `DEVIATIONS` of those of gusts

    @property
    def total(self) -> float:
        """Their sum, m/s."""
        return math.fsum(vars(self).values())


class NoMarginError(RuntimeError):
    """Nothing bounds the errors; the message says why.

    Attributes:
        margin: that of the orbits without it, which may be too small for the faster ones with it;
            None where there is none.
    """

    def __init__(self, cause: str, margin: SpeedMargin | None = None):
        super().__init__(cause)
        self.margin = margin


def speed_margin(
    model: Model,
    plant: Model,
    limits: LimitsConfig,
    carriers: Carriers,
    feedback: Feedback,
    motion: Motion,
    *,
    instant_spacing: float,
    disturbance: Disturbance | None = None,
) -> SpeedMargin:
    """The margin of a loop, for a task.

    Each share is the largest of any carrier, at those constant ξ and A that keep the margin over
    the whole task with the least change of both.

    Args:
        model: what the controllers believe.
        plant: what is simulated.
        limits: ε, the nominal ξ and A, their bounds, and `model_error`.
        carriers: their controllers and references.
        feedback: the wrench controller's.
        motion: the load's.
        instant_spacing: s, between the instants of the constraints.
        disturbance: on the load; None: there is none.

    Raises:
        NoMarginError: a deviation of the loop grows from turn to turn, or a margin asks for orbits
            that need a larger one.
    """
    task = _Task(model, limits, motion)
    loops = _Loops(model, plant, carriers, feedback)
    margin = _FIRST * limits.speed_bound
    first: SpeedMargin | None = None
    for _ in range(_REPEATS):
        chosen = task.parameters_for(limits.speed_bound + margin)
        try:
            shares = _shares(task, loops, chosen, limits, instant_spacing, margin, disturbance)
        except NoMarginError as error:
            raise NoMarginError(str(error), first) from None
        if shares.total <= margin:
            return shares
        first = first or shares
        margin = _SAME * shares.total
    raise NoMarginError(
        f"a speed {margin:.3g} m/s above the bound needs orbits whose errors are larger still",
        first,
    )


@dataclass(frozen=True, eq=False)
class _Derivatives:
    """Of carriers at k instants and h phases, in the load's frame: (k, h, n, 3) each, SI."""

    velocities: NDArray
    accelerations: NDArray
    jerks: NDArray


class _Task:
    """The planned orbits along a reference."""

    def __init__(self, model: Model, limits: LimitsConfig, motion: Motion):
        self.model, self.limits, self.motion = model, limits, motion
        horizon = timed(HorizonConfig(), limits.frequency, model.control_period)
        problem = HorizonProblem(model, limits, horizon, lambda: "speed margin")
        self.axes = problem.axes
        before, now, after = (
            OrbitTerms.view(np.array([problem.terms_at(row) for row in rows]))
            for rows in motion.references
        )
        self.terms, step = now, motion.step
        self.second_rates = (after.rates - before.rates) / (2 * step)
        self.third_rates = (after.rates - 2 * now.rates + before.rates) / step**2
        desired = LoadReference.view(motion.references[1])
        turned = rotation_matrix(desired.quaternion)  # (k, 3, 3)
        self.accelerations, self.jerks = (
            np.einsum("kji,kj->ki", turned, vectors)
            for vectors in (desired.acceleration, desired.jerk)
        )
        self.cables: dict[str, Any] = {
            "rest_length": model.cable_length,
            "compliance": model.cable_compliance,
        }

    def parameters_for(self, speed: float) -> NDArray:
        """[ξ, A] (2,) nearest to the nominal ones that keep a speed (m/s) over the task."""
        low, high = amplitude_range(self.limits, self.model)
        amplitudes = np.linspace(low, high, _AMPLITUDES)
        amplitudes = np.sort(np.append(amplitudes, self.limits.amplitude))
        some = OrbitTerms(*(part[::_SPARSE] for part in self.terms))
        least, *_ = product_limits(
            some, self.axes, amplitudes, speed, math.inf, phase_count=_PHASES, **self.cables
        )
        products = least.max(axis=0)
        frequencies = np.maximum(products / amplitudes, self.limits.frequency)
        frequencies = np.minimum(frequencies, self.limits.frequency_bounds[1])
        change = (frequencies / self.limits.frequency - 1) ** 2
        change += _AMPLITUDE_WEIGHT * (amplitudes / self.limits.amplitude - 1) ** 2
        change += 1e3 * np.maximum(products / (amplitudes * frequencies) - 1, 0)
        best = int(np.argmin(change))
        return np.array([frequencies[best], amplitudes[best]])

    def derivatives(self, parameters: NDArray, extra: NDArray | None = None) -> _Derivatives:
        """The carriers' motion for constant [ξ, A] (2,).

        `extra`, (n, 3) or (k, n, 3), adds to their forces.

        Rates of forces are those in the load's frame, which turns slowly beside the orbits.
        """
        xi, A = parameters
        angles = 2 * np.pi * np.arange(_PHASES) / _PHASES
        p, q = self.axes
        cosine, sine = np.cos(angles)[:, None, None], np.sin(angles)[:, None, None]
        u, along = cosine * p + sine * q, cosine * q - sine * p  # (h, n, 3)
        added = np.zeros((1, self.model.n, 3)) if extra is None else extra.reshape(-1, *p.shape)
        f0 = self.terms.forces[:, None] + added[:, None]
        slow = self.second_rates[:, None], self.third_rates[:, None]
        f = f0 + A * u
        omega = self.terms.angular_velocity[:, None, None]
        r = self.terms.rates[:, None] + np.cross(omega, f) + A * xi * along
        shape, count = f.shape, f[..., 0].size
        rest = resting_reference()

        def flat(values: NDArray) -> NDArray:
            return np.broadcast_to(values, shape).reshape(-1, 3)

        higher = slow[0] - A * xi**2 * u, slow[1] - A * xi**3 * along
        forces = [flat(part) for part in (f, r, *higher)]
        cables = self.cables | {"attachments": np.zeros((count, 3))}
        _, swing = carrier_motion(rest, forces[0], forces[1], **cables)
        acceleration = carrier_acceleration(rest, *forces[:3], **cables)
        jerk = carrier_jerk(rest, *forces, **cables)
        return _Derivatives(
            swing.reshape(shape) + self.terms.velocities[:, None],
            acceleration.reshape(shape) + self.accelerations[:, None, None],
            jerk.reshape(shape) + self.jerks[:, None, None],
        )

    def orbit(self, parameters: NDArray, angle: float) -> Orbit:
        """The orbits' phase at an angle (rad) above the load as at the start, at rest."""
        xi, A = parameters
        p, q = self.axes
        u, along = (
            math.cos(angle) * p + math.sin(angle) * q,
            math.cos(angle) * q - math.sin(angle) * p,
        )
        forces, rates = self.terms.forces[0] + A * u, A * xi * along
        rest = resting_reference()
        none = np.zeros((self.model.n, 3))
        _, swing = carrier_motion(rest, forces, rates, attachments=none, **self.cables)
        return Orbit(forces, rates, -(A * xi**2) * u, -(A * xi**3) * along, swing)


class TurnOfLoops(NamedTuple):
    """The linear sampled loop at phases that fill a turn of the carriers."""

    orbits: list[Orbit]
    loops: list[SampledLoop]
    samples: int  # that each of them lasts
    rate: float  # 1/s, at which a deviation grows from turn to turn, the largest one

    def growth_in_turn(self, radius: float) -> float:
        """The logarithm of how many times a deviation of the load's pose grows within a turn.

        An attitude's size is that of the distance it makes at the radius in m.
        """
        scale = np.repeat([radius, 1.0], 3)
        return math.log(growth_in_turn(self.loops, self.samples, scale))


def turn_of_loops(
    model: Model,
    plant: Model,
    carriers: Carriers,
    feedback: Feedback,
    frequency: float,
    orbit: Callable[[float], Orbit],
) -> TurnOfLoops:
    """The loop of load, cables, carriers and controllers along the orbits.

    It is linearized at some 60 phases; where it seems to grow, at every sample, since forces that
    step from phase to phase move what is lightly damped.

    Args:
        model: what the controllers believe.
        plant: what is simulated.
        carriers: their controllers and references.
        feedback: the wrench controller's.
        frequency: ξ, rad/s.
        orbit: that at a phase in rad.
    """
    cables = Cables(
        attachments=plant.attachments,
        stiffness=plant.cable_stiffness,
        damping=plant.cable_damping,
        rest_length=plant.cable_length,
        compliance=model.cable_compliance,
    )
    turn = 2 * math.pi / frequency

    def at_phases(about: float) -> TurnOfLoops:
        samples, count = parts_of_turn(turn, feedback.period, about)
        orbits = [orbit(2 * math.pi * i / count) for i in range(count)]
        loops = [
            tethered_loop(
                plant.load,
                cables,
                carriers,
                feedback.gains,
                along,
                pseudo_inverse=model.pseudo_inverse,
                period=feedback.period,
                delay=feedback.delay,
                is_measured=feedback.is_measured,
                estimator=feedback.estimator,
            )
            for along in orbits
        ]
        return TurnOfLoops(orbits, loops, samples, math.log(growth(loops, samples)) / turn)

    found = at_phases(_LOOPS)
    if found.samples == 1 or found.rate < _SEEMS_TO_GROW:
        return found
    return at_phases(turn / feedback.period)


class _Loops:
    """The linear loop along the orbits."""

    def __init__(self, model: Model, plant: Model, carriers: Carriers, feedback: Feedback):
        self.model, self.plant = model, plant
        self.carriers, self.feedback = carriers, feedback
        self.places = Inputs.of(model.n)

    @property
    def _with_delay(self) -> str:
        late = self.feedback.delay * self.feedback.period
        return f"with a measurement that is {late:g} s late " if late else ""

    def responses(self, task: _Task, parameters: NDArray) -> Iterator[tuple[Orbit, NDArray]]:
        """Phases, and how shortfalls there depend on inputs, for [ξ, A] (2,).

        Raises:
            NoMarginError: a deviation grows from turn to turn.
        """
        found = turn_of_loops(
            self.model,
            self.plant,
            self.carriers,
            self.feedback,
            float(parameters[0]),
            partial(task.orbit, parameters),
        )
        if found.rate > _LARGEST_GROWTH:
            raise NoMarginError(
                f"the linear loop {self._with_delay}grows by {found.rate:.3g} per s along the "
                "orbits"
            )
        lags = math.ceil(_MEMORY / self.feedback.period)
        count = len(found.loops)
        for i in range(0, count, max(1, count // _SEEN)):
            yield found.orbits[i], responses(found.loops, found.samples, i, lags)


def _shares(
    task: _Task,
    loops: _Loops,
    parameters: NDArray,
    limits: LimitsConfig,
    instant_spacing: float,
    margin: float,
    disturbance: Disturbance | None,
) -> SpeedMargin:
    """The shares at [ξ, A] (2,), for a margin in m/s."""
    motion = task.derivatives(parameters)
    speeds = np.linalg.norm(motion.velocities, axis=-1)
    acceleration, jerk = (
        float(np.max(np.linalg.norm(part, axis=-1)))
        for part in (motion.accelerations, motion.jerks)
    )
    xi, phase = float(parameters[0]), 2 * math.pi / _PHASES
    around = (np.roll(motion.jerks, -1, axis=1) - motion.jerks) / phase
    snap = xi * float(np.max(np.linalg.norm(around, axis=-1)))
    n, places, feedback = task.model.n, loops.places, loops.feedback
    tracking = jumps = noise = delay = disturbed = 0.0
    for orbit, g in loops.responses(task, parameters):

        def bounded(place: slice, groups: int, bounds: Any, rates: Any, g: NDArray = g) -> float:
            bounds, rates = (np.broadcast_to(values, groups) for values in (bounds, rates))
            return bounded_response(g[..., place], groups, bounds, rates, feedback.period)

        held = bounded(places.acceleration, n, acceleration, jerk)
        held += bounded(places.jerk, n, jerk, snap)
        held += bounded(places.snap, n, snap, xi * snap)
        tracking = max(tracking, held)
        if len(task.motion.jerk_jumps) > 0:
            jumps = max(jumps, _of_jump(g[..., places.velocity], task, orbit, limits))
        if np.any(feedback.deviations):
            spread = noise_deviation(g[..., places.measurement], feedback.deviations)
            noise = max(noise, DEVIATIONS * spread)
        if feedback.delay:
            late = known_response(g[..., places.measurement], _late(task.motion, feedback))
            delay = max(delay, late)
        if disturbance is not None:
            wrench = g[..., places.disturbance]
            disturbed = max(disturbed, _of_disturbance(wrench, disturbance, task, feedback.period))
    if disturbance is not None:
        disturbed += _of_believed(disturbance.believed, task, parameters, speeds)
    return SpeedMargin(
        tracking=tracking,
        jumps=jumps,
        grid=grid_dip(motion, speeds, limits.speed_bound + margin, instant_spacing),
        noise=noise,
        delay=delay,
        model=_of_model_error(task, parameters, speeds, limits) if limits.model_error else 0.0,
        disturbance=disturbed,
    )


def grid_dip(motion: _Derivatives, speeds: NDArray, speed: float, instant_spacing: float) -> float:
    """By how much (m/s) speeds that are kept at instants may be lower between two of them.

    A function that is kept at two instants Δ apart is at most Δ²/8 times the largest of its second
    rate below them in between; |v|'' = (a·a + v·j)/|v| − (v·a)²/|v|³. Speeds far above the one that
    is aimed at do not matter.
    """
    v, a, j = motion.velocities, motion.accelerations, motion.jerks
    slow = np.maximum(speeds, 1e-9)
    along = (v * a).sum(axis=-1)
    second = ((a * a).sum(axis=-1) + (v * j).sum(axis=-1)) / slow - along**2 / slow**3
    near = speeds < _NEAR * speed
    return float(instant_spacing**2 / 8 * np.max(second, initial=0.0, where=near))


def _of_jump(g: NDArray, task: "_Task", orbit: Orbit, limits: LimitsConfig) -> float:
    """By how much (m/s) a carrier is slower than both speeds before and after a planned jump.

    Its velocity goes from one to the other, on a chord Δv long, which is Δv²/(8 v) below two speeds
    v, and overshoots. A horizon keeps a share of Δv there by itself: what is left counts. `g`
    (lags, j n, 3n) are the responses to jumps of the planned velocities.
    """
    columns = _velocity_jumps(task, orbit) @ task.motion.jerk_jumps.T
    n = task.model.n
    # The first output, just after the jump, is the jump itself.
    steps = (g.reshape(len(g), -1, n, g.shape[-1]) @ columns).reshape(-1, n, columns.shape[1])
    sizes = np.linalg.norm(columns.reshape(n, 3, -1), axis=1)
    chords = np.minimum(sizes**2 / (8 * max(limits.speed_bound, _LEAST_SPEED)), sizes)
    kept = limits.overshoot if isinstance(limits, HorizonConfig) else 0.0
    return max(0.0, float(np.max(overshoot(steps) + chords - kept * sizes)))


def _velocity_jumps(task: _Task, orbit: Orbit) -> NDArray:
    """The jumps (3n, 3) of the planned velocities for jumps of the reference's jerk, m/s³.

    M G† [0; m e], as in `mechanics.tethered_loop`.
    """
    model = task.model
    rates = (model.pseudo_inverse[:, 3:] * model.load_mass).reshape(model.n, 3, 3)
    tension = np.linalg.norm(orbit.forces, axis=1)
    jumps = []
    for f, T, rate in zip(orbit.forces, tension, rates, strict=True):
        across = np.eye(3) - np.outer(f, f) / T**2
        jumps.append((model.cable_length / T * across + model.cable_compliance * np.eye(3)) @ rate)
    return np.concatenate(jumps)


def _late(motion: Motion, feedback: Feedback) -> NDArray:
    """What a delay does to the measured errors at the samples of a task, (samples, 12).

    The load as it was is behind the reference by the delay times [ω, v, α, a], in its frame.
    """
    desired = LoadReference.view(motion.references[1])
    turned = rotation_matrix(desired.quaternion)
    late = feedback.delay * feedback.period
    behind = np.hstack(
        [
            np.einsum("kji,kj->ki", turned, part)
            for part in (
                desired.angular_velocity,
                desired.velocity,
                desired.angular_acceleration,
                desired.acceleration,
            )
        ]
    )
    samples = np.arange(0.0, motion.times[-1], feedback.period)
    errors = [np.interp(samples, motion.times, column, left=0.0) for column in behind.T]
    return -late * np.stack(errors, axis=-1)


def _of_disturbance(g: NDArray, disturbance: Disturbance, task: _Task, period: float) -> float:
    """By how much (m/s) gusts and unknown forces on the load slow a carrier down.

    `g` (lags, j n, 6) are the responses to a wrench in the load's frame, as at the start. The gusts
    are taken as held for a sample.
    """
    start = rotation_matrix(LoadReference.view(task.motion.references[1, 0]).quaternion)
    in_world = np.concatenate([g[..., :3] @ start.T, g[..., 3:] @ start.T], axis=-1)
    variance = 0.0
    for gust in disturbance.gusts:
        spread = waves_deviation(in_world, gust.deviations, gust.frequencies, period)
        variance += spread**2
    steady = step_response(in_world, disturbance.unknown)
    return DEVIATIONS * math.sqrt(variance) + steady


def _of_believed(forces: NDArray, task: _Task, parameters: NDArray, speeds: NDArray) -> float:
    """By how much (m/s) speeds fall as the cables bear forces (k, 3) on the load, in W, as well.

    The plan leaves them out: it is one in still air.
    """
    if not np.any(forces):
        return 0.0
    turned = rotation_matrix(LoadReference.view(task.motion.references[1]).quaternion)
    borne = -np.einsum("kji,kj->ki", turned, forces)
    extra = (borne @ task.model.pseudo_inverse[:, 3:].T).reshape(-1, task.model.n, 3)
    changed = task.derivatives(parameters, extra)
    return float(np.max(speeds - np.linalg.norm(changed.velocities, axis=-1), initial=0.0))


def _of_model_error(
    task: _Task, parameters: NDArray, speeds: NDArray, limits: LimitsConfig
) -> float:
    """By how much (m/s) speeds fall where the wrench controller adds a share of the weight.

    Whatever the model of the load lacks, the feedback adds in the end: a force of up to
    `model_error` m g of any direction, which changes the tensions and with them the speeds.
    """
    model = task.model
    force = limits.model_error * model.load_mass * model.gravity
    fall = 0.0
    for direction in np.vstack([np.eye(3), -np.eye(3)]):
        extra = (model.pseudo_inverse[:, 3:] @ (force * direction)).reshape(model.n, 3)
        changed = task.derivatives(parameters, extra)
        fall = max(fall, float(np.max(speeds - np.linalg.norm(changed.velocities, axis=-1))))
    return fall


def with_margin(config: Any, margin: SpeedMargin | None) -> Any:
    """The config of a layer with what is computed for it, if there is anything."""
    return config if margin is None else replace(config, speed_margin=margin.total)
