"""By how much a carrier may be slower than planned, and the margin that follows: share by share.

The assumptions under which the sum is a bound in continuous time, and what the shares are worth,
are in docs/speed_error_budget.md.
"""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.carrier import cable_vectors
from drake_nonstop.mechanics.planned_orbit import (
    OrbitTerms,
    PlannedOrbit,
    orbit_directions,
    rates_of_forces,
)
from drake_nonstop.mechanics.rotation import rotation_matrix
from drake_nonstop.mechanics.sampled_loop import (
    bounded_response,
    known_response,
    noise_deviation,
    overshoot,
    responses,
    step_response,
    waves_deviation,
)
from drake_nonstop.mechanics.signals import LoadReference
from drake_nonstop.model.descriptions import Gusts
from drake_nonstop.model.system import Model
from drake_nonstop.optimization.horizon_config import HorizonConfig, timed
from drake_nonstop.optimization.orbit_constraints import OrbitConstraints
from drake_nonstop.optimization.problem_config import LimitsConfig, amplitude_range, with_fields_of
from drake_nonstop.optimization.terminal_set import product_limits
from drake_nonstop.optimization.tethered_loop import (
    Carriers,
    Feedback,
    Inputs,
    Orbit,
    TurnOfLoops,
    turn_of_loops,
)

DEVIATIONS = 5.0  # standard deviations of noise: a normal value falls below with 2.9e-7
_PHASES = 48  # of the orbits, at which speeds and their rates are looked at
_ANGLES = 2 * np.pi * np.arange(_PHASES) / _PHASES
_SEEN = 12  # of these phases, at which the responses are looked at
_MEMORY = 10.0  # s, of the inputs that matter for a shortfall
_LARGEST_GROWTH = 0.2  # per s, beyond which there is no margin
_AMPLITUDES = 25  # among which the plan's is looked for
_SPARSE = 5  # of the instants, one at which it is
_FIRST = 0.02  # of ε, a margin to begin with
_REPEATS = 6  # of the margin, as a larger one asks for faster orbits
_LEAST_SPEED = 1e-9  # m/s
_ROUNDING = 1e-9
_LEAST_MARGIN = 1e-3  # of ε, for what plans are off by
_MOST_UNCLOSED = 1.0  # of ε, the largest margin that is used where none suffices
_NEXT = 1.1  # of what is needed, the next margin to try


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

    @property
    def desired(self) -> LoadReference:
        """The reference at the instants."""
        return LoadReference.view(self.references[1])

    def in_load_frame(self, vectors: NDArray) -> NDArray:
        """Vectors (k, 3) at the instants, in W, in the load's frame."""
        turned: NDArray = np.einsum("kji,kj->ki", rotation_matrix(self.desired.quaternion), vectors)
        return turned


@dataclass(frozen=True, kw_only=True, eq=False)
class Disturbance:
    """Forces on the load besides cables and weight, in W.

    Attributes:
        believed: (k, 3), N, at the instants of the motion: forces that the controllers know of.
        unknown: (6,), [torque; force], N m and N, steady and not known to them.
        gusts: (6,) each, in N m and N, independent of one another.
    """

    believed: NDArray
    unknown: NDArray
    gusts: tuple[Gusts, ...] = ()


@dataclass(frozen=True, kw_only=True)
class SpeedMargin:
    """The shares of a margin, each m/s, of the carrier and the phase where it has to be largest."""

    tracking: float  # of the carriers behind held references
    jumps: float  # beyond the planned velocities, where the reference's jerk jumps
    grid: float  # between the instants of the constraints
    noise: float  # of the feedback, `DEVIATIONS` standard deviations
    delay: float  # of the feedback
    model: float  # of a wrench that is off by a share of the weight
    disturbance: float  # of steady forces on the load, and `DEVIATIONS` of those of gusts
    speed_credit: float  # not positive: the carrier is as much faster there than it has to be
    deficit: float = 0.0  # not positive: what no orbits cover

    @property
    def total(self) -> float:
        """Their sum, m/s, at least 0."""
        return max(0.0, math.fsum(vars(self).values()))


class NoMarginError(RuntimeError):
    """Nothing bounds the errors; the message says why.

    Attributes:
        margin: that of the orbits without it, as far as it is covered: at most ε. None where there
            is none, or its own orbits cannot be flown.
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

    The orbits are those of the constant ξ and A that keep the margin over the whole task with the
    least change of both. A shortfall counts as far as it is larger than what its carrier is faster
    there than the bound and the margin, at every instant of the task.

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
    task = _OrbitsAlongTask(model, plant, limits, carriers, feedback, motion)
    bound = limits.speed_bound

    def shares_at(parameters: NDArray, margin: float) -> SpeedMargin:
        return _shares(task, parameters, bound + margin, instant_spacing, disturbance)

    margin = _FIRST * bound
    chosen, is_kept = task.parameters_for(bound + margin)
    could_be_kept = is_kept
    first = shares = shares_at(chosen, margin)
    for _ in range(_REPEATS):
        if not is_kept:
            cause = "no constant xi and A within bounds and limits have them"
            break
        if shares.total <= margin:
            return shares
        margin = _NEXT * shares.total
        chosen, is_kept = task.parameters_for(bound + margin)
        try:
            shares = shares_at(chosen, margin) if is_kept else shares
        except NoMarginError as error:
            cause = str(error)
            break
    else:
        cause = "their errors are larger still"
    cause = f"a speed {margin:.3g} m/s above the bound needs faster orbits, and {cause}"
    # What can be had of it, if its own orbits can be flown.
    covered = min(first.total, _MOST_UNCLOSED * bound)
    chosen, is_kept = task.parameters_for(bound + covered)
    if (could_be_kept and not is_kept) or task.turn(chosen).rate > _LARGEST_GROWTH:
        raise NoMarginError(cause)
    raise NoMarginError(cause, replace(first, deficit=covered - first.total))


class _OrbitsAlongTask:
    """The planned orbits along a reference, and the linear loop along the orbits."""

    def __init__(
        self,
        model: Model,
        plant: Model,
        limits: LimitsConfig,
        carriers: Carriers,
        feedback: Feedback,
        motion: Motion,
    ):
        self.model, self.limits, self.motion, self.feedback = model, limits, motion, feedback
        self._loop = model, plant, carriers, feedback
        self._amplitude_weight = with_fields_of(HorizonConfig, limits).amplitude_weight
        horizon = timed(HorizonConfig(), limits.frequency, model.control_period)
        problem = OrbitConstraints(model, limits, horizon, lambda: "speed margin")
        self.axes, self._max_speed = problem.axes, problem.max_speed
        before, now, after = (
            OrbitTerms.view(problem.all_terms(np.array(rows))) for rows in motion.references
        )
        self.terms, step = now, motion.step
        self.second_rates = (after.rates - before.rates) / (2 * step)
        self.third_rates = (after.rates - 2 * now.rates + before.rates) / step**2
        desired = motion.desired
        self.accelerations, self.jerks = map(
            motion.in_load_frame, (desired.acceleration, desired.jerk)
        )
        self.cables: dict[str, Any] = {
            "rest_length": model.cable_length,
            "compliance": model.cable_compliance,
        }
        self._directions = orbit_directions(self.axes, _ANGLES)

    def parameters_for(self, speed: float) -> tuple[NDArray, bool]:
        """[ξ, A] (2,) nearest to the nominal ones that keep a speed (m/s) over the task.

        And the limits of speeds from above. Also whether they do: where none within the bounds do,
        they are those that come closest.
        """
        low, high = amplitude_range(self.limits, self.model)
        amplitudes = np.linspace(low, high, _AMPLITUDES)
        amplitudes = np.sort(np.append(amplitudes, self.limits.amplitude))
        some = OrbitTerms(*(part[::_SPARSE] for part in self.terms))
        least, most, *_ = product_limits(
            some, self.axes, amplitudes, speed, self._max_speed, phase_count=_PHASES, **self.cables
        )
        products = least.max(axis=0)
        frequencies = np.maximum(products / amplitudes, self.limits.frequency)
        highest = np.minimum(most.min(axis=0) / amplitudes, self.limits.frequency_bounds[1])
        frequencies = np.minimum(frequencies, highest)
        change = (frequencies / self.limits.frequency - 1) ** 2
        change += self._amplitude_weight * (amplitudes / self.limits.amplitude - 1) ** 2
        change += 1e3 * np.maximum(products / (amplitudes * frequencies) - 1, 0)
        best = int(np.argmin(change))
        found = np.array([frequencies[best], amplitudes[best]])
        return found, bool(products[best] <= (1 + _ROUNDING) * found[0] * found[1])

    def derivatives(self, parameters: NDArray) -> list[NDArray]:
        """Velocities, accelerations and jerks (k, h, n, 3) for constant [ξ, A] (2,), SI.

        In the load's frame, at k instants and h phases. Rates of forces are those in this frame,
        which turns slowly beside the orbits.
        """
        forces, (xi, A) = self._forces(parameters), parameters
        u, along, _ = self._directions
        second = self.second_rates[:, None] - A * xi**2 * u
        third = self.third_rates[:, None] - A * xi**3 * along
        _, swing, bending, jerk = cable_vectors([*forces, second, third], **self.cables)
        return [
            swing + self.terms.velocities[:, None],
            bending + self.accelerations[:, None, None],
            jerk + self.jerks[:, None, None],
        ]

    def speeds(self, parameters: NDArray, extra: NDArray | float = 0.0) -> NDArray:
        """The carriers' speeds (k, h, n), m/s, for constant [ξ, A] (2,).

        `extra`, (n, 3) or (k, 1, n, 3), adds to their forces.
        """
        _, rates = cable_vectors(self._forces(parameters, extra), **self.cables)
        found: NDArray = np.linalg.norm(rates + self.terms.velocities[:, None], axis=-1)
        return found

    def _forces(self, parameters: NDArray, extra: NDArray | float = 0.0) -> tuple[NDArray, NDArray]:
        """Forces and their rates (k, h, n, 3)."""
        terms = OrbitTerms(*(part[:, None] for part in self.terms))
        terms = terms._replace(forces=terms.forces + extra)
        orbit = PlannedOrbit.constant(_ANGLES, *parameters)
        return rates_of_forces(terms.of_flight, self._directions, orbit)[:2]

    def speed_credit(self, parameters: NDArray, speed: float) -> NDArray:
        """How much faster than a speed (m/s) carriers are at phases (h, n), m/s, at least 0.

        The least over the task, of the orbits for [ξ, A] (2,) and of those with the nominal ξ or A:
        a plan may be anywhere between them, and pass by slow phases that it does not meet.
        """
        xi, A = parameters
        own = self.limits
        least = np.full((_PHASES, self.model.n), np.inf)
        for other in itertools.product((xi, own.frequency), (A, own.amplitude)):
            least = np.minimum(least, self.speeds(np.array(other)).min(axis=0))
        return np.maximum(least - speed, 0.0)

    def orbit(self, parameters: NDArray, angle: float) -> Orbit:
        """The orbits' phase at an angle (rad) above the load as at the start, at rest."""
        xi, A = parameters
        u, along, _ = (part[0] for part in orbit_directions(self.axes, np.array([angle])))
        forces, rates = self.terms.forces[0] + A * u, A * xi * along
        _, swing = cable_vectors([forces, rates], **self.cables)
        return Orbit(forces, rates, -(A * xi**2) * u, -(A * xi**3) * along, swing)

    def turn(self, parameters: NDArray) -> TurnOfLoops:
        """The loop along the orbits of [ξ, A] (2,)."""
        return turn_of_loops(*self._loop, float(parameters[0]), partial(self.orbit, parameters))

    def responses(self, parameters: NDArray) -> tuple[list[Orbit], Iterator[NDArray]]:
        """Orbits at phases, and how shortfalls there depend on inputs, for [ξ, A] (2,).

        Raises:
            NoMarginError: a deviation grows from turn to turn.
        """
        found = self.turn(parameters)
        if found.rate > _LARGEST_GROWTH:
            late = self.feedback.delay * self.feedback.period
            with_delay = f"with a measurement that is {late:g} s late " if late else ""
            raise NoMarginError(
                f"the linear loop {with_delay}grows by {found.rate:.3g} per s along the orbits"
            )
        lags = math.ceil(_MEMORY / self.feedback.period)
        count = len(found.loops)
        seen = np.unique(np.arange(_SEEN) * count // _SEEN).tolist()
        g = responses(found.loops, found.samples, seen, lags)
        return [found.orbits[i] for i in seen], g


def _shares(
    task: _OrbitsAlongTask,
    parameters: NDArray,
    speed: float,
    instant_spacing: float,
    disturbance: Disturbance | None,
) -> SpeedMargin:
    """The shares at [ξ, A] (2,), of plans that keep a speed in m/s."""
    motion = task.derivatives(parameters)
    speeds = np.linalg.norm(motion[0], axis=-1)
    # Of each carrier at each phase: (h, n).
    shares = {name: np.zeros(speeds.shape[1:]) for name in SpeedMargin.__dataclass_fields__}
    for name, values in _of_responses(task, parameters, motion, disturbance).items():
        # The larger of those before and after each phase.
        after = np.arange(_PHASES) * len(values) // _PHASES
        shares[name] += np.maximum(values[after], np.roll(values, -1, axis=0)[after])
    if disturbance is not None and np.any(disturbance.believed):
        # Plans, those in still air, leave them out.
        borne = -task.motion.in_load_frame(disturbance.believed)
        borne = (borne @ task.model.pseudo_inverse[:, 3:].T).reshape(-1, 1, task.model.n, 3)
        falls = speeds - task.speeds(parameters, borne)
        shares["disturbance"] += np.max(falls, axis=0, initial=0.0)
    if task.limits.model_error:
        shares["model"] += _of_model_error(task, parameters, speeds)
    shares["grid"] += grid_dip(motion, speeds, instant_spacing).max(axis=0)
    needed = np.sum([*shares.values()], axis=0)
    shares["speed_credit"] -= np.minimum(task.speed_credit(parameters, speed), needed)
    worst = np.unravel_index(np.argmax(needed + shares["speed_credit"]), needed.shape)
    return SpeedMargin(**{name: float(part[worst]) for name, part in shares.items()})


def _of_responses(
    task: _OrbitsAlongTask,
    parameters: NDArray,
    motion: list[NDArray],
    disturbance: Disturbance | None,
) -> dict[str, NDArray]:
    """The shares that follow from the loop's response, by their names: (h, n), at even phases."""
    n, feedback = task.model.n, task.feedback
    places = Inputs.of(n)
    xi, (_, accelerations, jerks) = float(parameters[0]), motion
    snaps = xi * (np.roll(jerks, -1, axis=1) - jerks) / (2 * math.pi / _PHASES)
    acceleration, jerk, snap = (
        float(np.max(np.linalg.norm(part, axis=-1))) for part in (accelerations, jerks, snaps)
    )
    orbits, found = task.responses(parameters)
    shares = {name: np.zeros((len(orbits), n)) for name in SpeedMargin.__dataclass_fields__}

    late = _late(task.motion, feedback) if feedback.delay else None

    def note(name: str, h: int, outputs: NDArray) -> None:
        shares[name][h] += outputs.reshape(-1, n).max(axis=0)

    for h, (orbit, g) in enumerate(zip(orbits, found, strict=True)):
        for place, bound, rate in (
            (places.acceleration, acceleration, jerk),
            (places.jerk, jerk, snap),
            (places.snap, snap, xi * snap),
        ):
            bounds, rates = (np.full(n, value) for value in (bound, rate))
            held = bounded_response(g[..., place], n, bounds, rates, feedback.period)
            note("tracking", h, held)
        if len(task.motion.jerk_jumps) > 0:
            note("jumps", h, _of_jump(g[..., places.velocity], task, orbit))
        if np.any(feedback.deviations):
            spread = noise_deviation(g[..., places.measurement], feedback.deviations)
            note("noise", h, DEVIATIONS * spread)
        if late is not None:
            note("delay", h, known_response(g[..., places.measurement], late))
        if disturbance is not None:
            wrench = g[..., places.disturbance]
            note("disturbance", h, _of_disturbance(wrench, disturbance, task))
    return shares


def grid_dip(motion: list[NDArray], speeds: NDArray, instant_spacing: float) -> NDArray:
    """By how much (m/s) speeds (k, h, n) kept at instants may be lower between two of them.

    A function that is kept at two instants Δ apart is at most Δ²/8 times the largest of its second
    rate below them in between; |v|'' = (a·a + v·j)/|v| − (v·a)²/|v|³.
    """
    v, a, j = motion
    slow = np.maximum(speeds, _LEAST_SPEED)
    along = (v * a).sum(axis=-1)
    second = ((a * a).sum(axis=-1) + (v * j).sum(axis=-1)) / slow - along**2 / slow**3
    return instant_spacing**2 / 8 * np.maximum(second, 0.0)


def _of_jump(g: NDArray, task: _OrbitsAlongTask, orbit: Orbit) -> NDArray:
    """By how much (m/s) carriers (n,) are slower than both speeds before and after a planned jump.

    Its velocity goes from one to the other, on a chord Δv long, which is Δv²/(8 v) below two speeds
    v, and overshoots. A horizon keeps a share of Δv there by itself: what is left counts. `g`
    (lags, j n, 3n) are the responses to jumps of the planned velocities.
    """
    model, n, limits = task.model, task.model.n, task.limits
    # The rates of the forces jump by M G† [0; m e], as in `optimization.tethered_loop`.
    rates = (model.pseudo_inverse[:, 3:] * model.load_mass).reshape(n, 3, 3)
    _, jumps = cable_vectors([orbit.forces[..., None], rates], axis=1, **task.cables)
    columns = jumps.reshape(-1, 3) @ task.motion.jerk_jumps.T
    # The first output, just after the jump, is the jump itself.
    steps = (g.reshape(len(g), -1, n, g.shape[-1]) @ columns).reshape(-1, n, columns.shape[1])
    sizes = np.linalg.norm(columns.reshape(n, 3, -1), axis=1)
    chords = np.minimum(sizes**2 / (8 * max(limits.speed_bound, _LEAST_SPEED)), sizes)
    kept = getattr(limits, "overshoot", 0.0)
    return np.max(overshoot(steps) + chords - kept * sizes, axis=1, initial=0.0)


def _late(motion: Motion, feedback: Feedback) -> NDArray:
    """Errors that a delay adds to the measured ones at the samples of a task, (samples, 12).

    The load as it was is behind the reference by the delay times [ω, v, α, a], in its frame.
    """
    desired = motion.desired
    late = feedback.delay * feedback.period
    parts = desired[2:6]  # ω, v, α and a
    behind = np.hstack([motion.in_load_frame(part) for part in parts])
    samples = np.arange(0.0, motion.times[-1], feedback.period)
    errors = [np.interp(samples, motion.times, column, left=0.0) for column in behind.T]
    return -late * np.stack(errors, axis=-1)


def _of_disturbance(g: NDArray, disturbance: Disturbance, task: _OrbitsAlongTask) -> NDArray:
    """By how much (m/s) gusts and unknown forces on the load slow carriers down, (j n,).

    `g` (lags, j n, 6) are the responses to a wrench in the load's frame, as at the start. The gusts
    are taken as held for a sample.
    """
    start = rotation_matrix(LoadReference.view(task.motion.references[1, 0]).quaternion)
    in_world = np.concatenate([g[..., :3] @ start.T, g[..., 3:] @ start.T], axis=-1)
    variance = np.zeros(g.shape[1])
    for gust in disturbance.gusts:
        variance += waves_deviation(in_world, *gust, task.feedback.period) ** 2
    return DEVIATIONS * np.sqrt(variance) + step_response(in_world, disturbance.unknown)


def _of_model_error(task: _OrbitsAlongTask, parameters: NDArray, speeds: NDArray) -> NDArray:
    """By how much (m/s) speeds fall, (h, n), as the wrench controller adds a share of the weight.

    Whatever the model of the load lacks, the feedback adds in the end: a force of up to
    `model_error` m g of any direction, which changes the tensions and with them the speeds: by the
    larger of both signs along each axis, which count as the parts of a gradient.
    """
    model = task.model
    force = task.limits.model_error * model.load_mass * model.gravity
    squares = np.zeros(speeds.shape)
    for axis in force * np.eye(3):
        extra = (model.pseudo_inverse[:, 3:] @ axis).reshape(-1, 3)
        falls = [speeds - task.speeds(parameters, sign * extra) for sign in (1, -1)]
        squares += np.max(falls, axis=0, initial=0.0) ** 2
    return np.sqrt(squares).max(axis=0)


def with_margin(config: Any, margin: SpeedMargin | None) -> Any:
    """The config of a layer with what is computed for it, if there is anything."""
    if margin is None:
        return config
    return replace(config, speed_margin=max(margin.total, _LEAST_MARGIN * config.speed_bound))
