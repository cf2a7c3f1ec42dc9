"""The whole loop, linearized about a phase of the carriers' orbits above a load at rest.

The load's errors, the carriers' deviations from their planned motion, the integrals of the wrench
controller and the samples that a delay keeps are the state. All vectors are in the load's frame as
desired.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.carrier import cable_vectors
from drake_nonstop.mechanics.rigid_load import RigidLoad
from drake_nonstop.mechanics.rotation import skew
from drake_nonstop.mechanics.sampled_loop import SampledLoop, sampled_loop

LOAD_ERRORS = 12  # [e_R, e_p, e_ω, e_v]
_INTEGRALS = 6
_WRENCH = 6  # [torque; force]
_COMPLEX_STEP = 1e-30j  # N and N/s


@dataclass(frozen=True, kw_only=True, eq=False)
class Carriers:
    """The carriers' controllers, per unit of their mass, and what reaches them of the cables.

    Attributes:
        position_gain: K_p/m_c, 1/s².
        velocity_gain: K_d/m_c, 1/s.
        integral_gain: K_i/m_c, 1/s³.
        mass: kg, where weight and cables pull at the carriers, and the desired cable forces are
            feedforward; 0: nothing does.
        has_feedforward: whether the references' accelerations are.
        hold: order of the references' motion within a sample: 1 goes on along their velocity, 2
            along their acceleration, too, 3 along their jerk; 0: they are continuous.
    """

    position_gain: float
    velocity_gain: float
    integral_gain: float = 0.0
    mass: float = 0.0
    has_feedforward: bool = True
    hold: int = 3


@dataclass(frozen=True, kw_only=True, eq=False)
class Cables:
    """Of n cables: what the plant has, and what the controllers believe of them.

    Attributes:
        attachments: b (n, 3), m.
        stiffness: K_c, N/m, of the plant.
        damping: B_c, N s/m, of the plant.
        rest_length: L₀, m.
        compliance: 1/K_c that the references stretch by, m/N.
    """

    attachments: NDArray
    stiffness: float
    damping: float
    rest_length: float
    compliance: float


class Estimator(NamedTuple):
    """The errors of a filter of the load's state: d⁺ = (I − K) F d + K (those of its measurement).

    Its predictions are taken as exact, as they are to T²/12 times a change of the acceleration
    where rates are measured exactly. Phases that each stand still would make that change jump.
    """

    gain: NDArray  # K (12, 12)
    transition: NDArray  # F (12, 12)

    @classmethod
    def of(cls, rotation_gain: NDArray, translation_gain: NDArray, period: float) -> "Estimator":
        """That of gains (2, 2) of [pose; rate], which goes on with its rates for a period in s."""
        gain = np.zeros((4, 4))
        gain[::2, ::2], gain[1::2, 1::2] = rotation_gain, translation_gain
        transition = np.eye(4) + period * np.eye(4, k=2)
        return cls(np.kron(gain, np.eye(3)), np.kron(transition, np.eye(3)))


class Orbit(NamedTuple):
    """The cables' forces and the carriers' velocities at a phase of the orbits."""

    forces: NDArray  # (n, 3), N
    rates: NDArray  # (n, 3), N/s
    second_rates: NDArray  # (n, 3), N/s²
    third_rates: NDArray  # (n, 3), N/s³
    velocities: NDArray  # (n, 3), m/s

    def later(self, time: float) -> tuple[NDArray, NDArray]:
        """The forces and their rates a short time (s) later, by Taylor's series."""
        half, third = time * time / 2, time**3 / 6
        return (
            self.forces + time * self.rates + half * self.second_rates + third * self.third_rates,
            self.rates + time * self.second_rates + half * self.third_rates,
        )


class Inputs(NamedTuple):
    """The places of the inputs of `tethered_loop`'s loop."""

    acceleration: slice  # (3n,), m/s², of the planned motion at a sample
    jerk: slice  # (3n,), m/s³
    snap: slice  # (3n,), m/s⁴
    measurement: slice  # (12,), errors of the measured load: rad, m, rad/s and m/s
    velocity: slice  # (3n,), m/s, by which the planned velocities jumped just after a sample
    disturbance: slice  # (6,), N m and N, of a wrench on the load that stays for a sample

    @classmethod
    def of(cls, n: int) -> "Inputs":
        """Those of n carriers."""
        sizes = [3 * n, 3 * n, 3 * n, LOAD_ERRORS, 3 * n, _WRENCH]
        ends = np.cumsum([0, *sizes]).tolist()
        return cls(*(slice(a, b) for a, b in pairwise(ends)))


def tethered_loop(
    load: RigidLoad,
    cables: Cables,
    carriers: Carriers,
    gains: Mapping[str, Any],
    orbit: Orbit,
    *,
    pseudo_inverse: NDArray,
    period: float,
    delay: int = 0,
    is_measured: NDArray | None = None,
    estimator: Estimator | None = None,
) -> SampledLoop:
    """The loop at a phase; outputs are the carriers' shortfalls of speed (n,), m/s.

    A carrier's shortfall is −v·δv/‖v‖, δv its velocity less the planned one.

    The measured errors y = [e_R, e_p, e_ω, e_v] of a sample, with those of the measurement, make
    (eqs. 14-16, 19-22 and their rates, `mechanics.wrench`)

        δF = −K_p e_p − K_v e_v − K_i ∫e_p,   δτ likewise of e_R and e_ω,
        δF' = −K_p e_v − K_v (δF − B_L e_v)/m − K_i e_p,   δτ' likewise,
        δf = e_R × f + G† [δτ; δF − e_R × F],   δf' = e_ω × f + e_R × f' + G† [δτ'; δF' − e_ω × F],
        δp_d = M δf,   δv_d = M δf' + M' δf,   M = (L₀/T)(I − q qᵀ) + I/K_c,
        δa_d = L₀ (∂q̈/∂f δf + ∂q̈/∂ḟ δf'),   q = f/T,   δj_d likewise,

    and the carriers' loops m_c p̈ = K_p (p_d − p) + K_d (v_d − v) + m_c a_d. Between samples
    references go on by their hold, which leaves them behind the planned motion by a τ²/2 + j τ³/6
    of a first-order one, by j τ³/6 of a second-order one, by s τ⁴/24 of one of third order, with
    the snap s; a feedforward that stands still is behind by j τ, that of the third order by s τ²/2,
    none at all by a + j τ. The cables' forces are

        δf_i = (K_c q qᵀ + (T/ℓ)(I − q qᵀ) + B_c q q̇ᵀ) (δp_i − e_p − e_R × b_i)
             + B_c q qᵀ (their rates),

    with q and T in the middle of the sample: commands are half a sample behind them, which takes
    damping away from what oscillates across a cable that turns.

    Left out are products of deviations and the reference's own turning. Own derivation.

    Args:
        load: the load.
        cables: the cables.
        carriers: the carriers and their references.
        gains: of `mechanics.wrench.wrench_and_rate`, by name.
        orbit: the phase.
        pseudo_inverse: G† (3n, 6).
        period: T of the samples, s.
        delay: of the measurement, in samples.
        is_measured: (12,), 0 for errors that the controller takes as zero, else 1; None: all 1.
        estimator: of the load, whose estimate then takes the measurement's place; or None.
    """
    n = len(orbit.forces)
    size = 3 * n
    # The state: errors of the load, carriers, their integrals, those of the controller, samples of
    # the delay, the estimate; then what is held in a sample: reference, its acceleration that is
    # missing, the feedforward that is, the jerk that is, the planned snap, desired forces, and
    # wrench on the load.
    sizes = {
        "load": LOAD_ERRORS,
        "position": size,
        "velocity": size,
        "carrier_integral": size if carriers.integral_gain else 0,
        "integral": _INTEGRALS,
        "samples": LOAD_ERRORS * delay,
        "estimate": LOAD_ERRORS if estimator else 0,
        "desired_position": size,
        "desired_velocity": size,
        "missing_acceleration": size,
        "missing_feedforward": size,
        "missing_jerk": size,
        "snap": size if carriers.hold == 3 else 0,
        "desired_force": size if carriers.mass else 0,
        "disturbance": _WRENCH,
    }
    ends = np.cumsum([0, *sizes.values()]).tolist()
    at = {name: slice(a, b) for name, a, b in zip(sizes, ends, ends[1:], strict=False)}
    M = np.zeros((ends[-1], ends[-1]))
    e_R, e_p, e_omega, e_v = (slice(3 * i, 3 * i + 3) for i in range(4))
    eye, unit = np.eye(3), np.eye(size)
    M[e_R, e_omega] = M[e_p, e_v] = eye
    M[e_v, e_v] -= load.drag / load.mass * eye
    inverse = np.linalg.inv(load.inertia)
    M[e_omega, e_omega] -= load.angular_drag * inverse
    position, velocity = at["position"], at["velocity"]
    M[position, velocity] = unit
    M[velocity, position] = -carriers.position_gain * unit
    M[velocity, velocity] = -carriers.velocity_gain * unit
    M[velocity, at["desired_position"]] = carriers.position_gain * unit
    M[velocity, at["desired_velocity"]] = carriers.velocity_gain * unit
    M[velocity, at["missing_feedforward"]] = -unit
    if carriers.integral_gain:
        integral = at["carrier_integral"]
        M[integral, position], M[integral, at["desired_position"]] = -unit, unit
        M[velocity, integral] = carriers.integral_gain * unit
    M[at["desired_position"], at["desired_velocity"]] = unit
    M[at["desired_velocity"], at["missing_acceleration"]] = -unit
    if carriers.hold:
        M[at["missing_acceleration"], at["missing_jerk"]] = unit
    if carriers.hold or not carriers.has_feedforward:
        M[at["missing_feedforward"], at["missing_jerk"]] = unit
    if carriers.hold == 3:
        M[at["missing_jerk"], at["snap"]] = unit
    if carriers.mass:
        M[velocity, at["desired_force"]] = unit / carriers.mass
    M[e_omega, at["disturbance"]] = np.hstack([inverse, np.zeros((3, 3))])
    M[e_v, at["disturbance"]] = np.hstack([np.zeros((3, 3)), eye / load.mass])
    middle = zip(cables.attachments, *orbit.later(period / 2), strict=True)
    for i, (b, f, f_rate) in enumerate(middle):
        T = np.linalg.norm(f)
        along = np.outer(f, f) / T**2
        length = cables.rest_length + T / cables.stiffness
        spring = cables.stiffness * along + T / length * (eye - along)
        spring += cables.damping * np.outer(f, (eye - along) @ f_rate) / T**2
        own = slice(position.start + 3 * i, position.start + 3 * i + 3)
        own_rate = slice(velocity.start + 3 * i, velocity.start + 3 * i + 3)
        force = np.zeros((3, ends[-1]))  # δf_i by the state
        force[:, own], force[:, own_rate] = spring, cables.damping * along
        force[:, e_p], force[:, e_v] = -spring, -cables.damping * along
        force[:, e_R] = spring @ skew(b)
        force[:, e_omega] = cables.damping * along @ skew(b)
        M[e_v] += force / load.mass
        M[e_omega] += inverse @ skew(b) @ force
        M[e_omega, e_R] += inverse @ skew(f) @ skew(b)  # of (e_R × b) × f
        if carriers.mass:
            M[own_rate] -= force / carriers.mass
    command = _commands(load, cables, gains, orbit, pseudo_inverse)
    seen = np.ones(LOAD_ERRORS) if is_measured is None else is_measured
    y = at["samples"] if delay else at["load"]
    y = slice(y.stop - LOAD_ERRORS, y.stop)
    S = np.eye(ends[-1])
    for name in (*list(sizes)[7:],):
        S[at[name], at[name]] = 0
    parts = [slice(i * size, (i + 1) * size) for i in range(5)]
    held = {"desired_position": parts[0], "desired_velocity": parts[1]}
    if carriers.mass:
        held["desired_force"] = parts[2]
    if carriers.hold >= 2:
        held["missing_acceleration"] = parts[3]
    if carriers.has_feedforward:
        held["missing_feedforward"] = parts[3]
    if carriers.hold == 3:
        held["missing_jerk"] = parts[4]
    places = Inputs.of(n)
    B = np.zeros((ends[-1], places.disturbance.stop))
    # What the controller gets of the state and of the measurement's errors.
    measured, errors = np.zeros((LOAD_ERRORS, ends[-1])), np.eye(LOAD_ERRORS)
    if estimator:
        errors, estimate = estimator.gain, at["estimate"]
        measured[:, estimate] = (np.eye(LOAD_ERRORS) - errors) @ estimator.transition
        S[estimate], B[estimate, places.measurement] = measured, errors
    measured[:, y] = np.eye(LOAD_ERRORS)
    for name, rows in held.items():
        S[at[name]] = (command.of_errors[rows] * seen) @ measured
        S[at[name], at["integral"]] = command.of_integrals[rows]
        B[at[name], places.measurement] = (command.of_errors[rows] * seen) @ errors
    # What is not measured, or has no integral gain, is not integrated.
    has_gain = np.any(command.of_integrals, axis=0)
    S[at["integral"], at["integral"]] = np.diag(has_gain * seen[:_INTEGRALS])
    added = period * (np.eye(LOAD_ERRORS) * seen)[:_INTEGRALS] * has_gain[:, None]
    S[at["integral"]] += added @ measured
    B[at["integral"], places.measurement] = added @ errors
    if delay:
        samples = at["samples"]
        S[samples, samples] = np.eye(LOAD_ERRORS * delay, k=-LOAD_ERRORS)
        S[samples.start : samples.start + LOAD_ERRORS, at["load"]] = np.eye(LOAD_ERRORS)
    if carriers.hold == 1:
        B[at["missing_acceleration"], places.acceleration] = unit
    if not carriers.has_feedforward:
        B[at["missing_feedforward"], places.acceleration] = unit
    if carriers.hold == 3:
        B[at["snap"], places.snap] = unit
    else:
        B[at["missing_jerk"], places.jerk] = unit
    B[velocity, places.velocity] = -unit
    B[position, places.velocity] = -period * unit  # of the time that it is not noticed
    B[at["disturbance"], places.disturbance] = np.eye(_WRENCH)
    outputs = np.zeros((n, ends[-1]))
    for i, v in enumerate(orbit.velocities):
        outputs[i, velocity.start + 3 * i : velocity.start + 3 * i + 3] = -v / np.linalg.norm(v)
    whole = sampled_loop(M, S, B, outputs, period=period)
    kept = ends[7]  # what is held begins anew at each sample
    return whole._replace(
        transition=whole.transition[:kept, :kept],
        input=whole.input[:kept],
        outputs=whole.outputs[:, :, :kept],
    )


class _Commands(NamedTuple):
    """How references [δp_d, δv_d, δf, −δa_d, −δj_d] (15n) depend on errors and on integrals."""

    of_errors: NDArray  # (15n, 12)
    of_integrals: NDArray  # (15n, 6), of [∫e_R, ∫e_p]


def _commands(
    load: RigidLoad,
    cables: Cables,
    gains: Mapping[str, Any],
    orbit: Orbit,
    pseudo_inverse: NDArray,
) -> _Commands:
    eye, n = np.eye(3), len(orbit.forces)

    def matrix(name: str) -> NDArray:
        gain = np.asarray(gains[name], float)
        return gain if gain.shape == (3, 3) else float(gain.ravel()[0]) * eye

    K_R, K_omega, K_iR = (
        matrix(f"{name}_gain")
        for name in ("orientation", "angular_velocity", "orientation_integral")
    )
    K_p, K_v, K_i = (
        matrix(f"{name}_gain") for name in ("position", "velocity", "position_integral")
    )
    inverse = np.linalg.inv(load.inertia)
    # Columns: e_R, e_p, e_ω, e_v, ∫e_R, ∫e_p.
    columns = [slice(3 * i, 3 * i + 3) for i in range(6)]
    R, p, omega, v, i_R, i_p = columns
    wrench, rate = np.zeros((6, 18)), np.zeros((6, 18))
    torque, force = slice(0, 3), slice(3, 6)
    wrench[torque, R], wrench[torque, omega], wrench[torque, i_R] = -K_R, -K_omega, -K_iR
    wrench[force, p], wrench[force, v], wrench[force, i_p] = -K_p, -K_v, -K_i
    angular = inverse @ wrench[torque]
    angular[:, omega] -= load.angular_drag * inverse
    linear = wrench[force] / load.mass
    linear[:, v] -= load.drag / load.mass * eye
    rate[torque], rate[force] = -K_omega @ angular, -K_v @ linear
    rate[torque, omega] -= K_R
    rate[torque, R] -= K_iR
    rate[force, v] -= K_p
    rate[force, p] -= K_i
    total = orbit.forces.sum(axis=0)
    wrench[force, R] += skew(total)  # −e_R × F
    rate[force, omega] += skew(total)
    forces = (pseudo_inverse @ wrench).reshape(n, 3, 18)
    rates = (pseudo_inverse @ rate).reshape(n, 3, 18)
    positions, velocities = np.zeros((n, 3, 18)), np.zeros((n, 3, 18))
    for i, (f, f_rate) in enumerate(zip(orbit.forces, orbit.rates, strict=True)):
        forces[i][:, R] -= skew(f)  # e_R × f
        rates[i][:, omega] -= skew(f)
        rates[i][:, R] -= skew(f_rate)
        T = np.linalg.norm(f)
        q = f / T
        across = eye - np.outer(q, q)
        q_rate, T_rate = across @ f_rate / T, q @ f_rate
        swing = cables.rest_length / T
        mobility = swing * across + cables.compliance * eye
        turning = np.outer(q_rate, q) + np.outer(q, q_rate)
        mobility_rate = -swing * (T_rate / T * across + turning)
        positions[i] = mobility @ forces[i]
        velocities[i] = mobility @ rates[i] + mobility_rate @ forces[i]
    both = np.concatenate([forces, rates], axis=1)  # (n, 6, 18)
    accelerations, jerks = (-part @ both for part in bending(orbit, cables.rest_length))
    made = (positions, velocities, forces, accelerations, jerks)
    all_of_them = np.concatenate([part.reshape(3 * n, 18) for part in made])
    return _Commands(all_of_them[:, :12], all_of_them[:, 12:])


def bending(orbit: Orbit, rest_length: float) -> tuple[NDArray, NDArray]:
    """How accelerations and jerks (n, 3, 6) depend on [f; ḟ], for constant f̈ and f⃛.

    By complex steps (Squire and Trapp, SIAM Review 40, 1998), which are exact to round-off.
    """
    n = len(orbit.forces)
    parts = [np.repeat(part, 6, axis=0).astype(complex) for part in orbit[:4]]
    for part, first in zip(parts[:2], (0, 3), strict=True):
        part.reshape(n, 6, 3)[:, first : first + 3] += _COMPLEX_STEP * np.eye(3)
    found = cable_vectors(parts, rest_length=rest_length, compliance=0.0)
    acceleration, jerk = (
        np.swapaxes(part.imag.reshape(n, 6, 3), 1, 2) / _COMPLEX_STEP.imag for part in found[2:]
    )
    return acceleration, jerk
