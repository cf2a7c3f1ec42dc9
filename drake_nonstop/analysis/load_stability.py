"""How a small deviation of the load grows while its carriers follow their references exactly.

A quick analysis of a formation: the load and the integrals of its controller, without the carriers'
own dynamics and without samples. `studies.stability` has the whole loop, and takes minutes.
"""

import functools
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.cable import cable_forces_and_tensions
from drake_nonstop.mechanics.carrier import carrier_motion
from drake_nonstop.mechanics.grasp import cable_forces_and_rates
from drake_nonstop.mechanics.internal_force import internal_force
from drake_nonstop.mechanics.rigid_load import RigidLoad, load_state_rate
from drake_nonstop.mechanics.rotation import quaternion_product, skew
from drake_nonstop.mechanics.sampled_loop import interpolated
from drake_nonstop.mechanics.signals import (
    LOAD_REFERENCE_SIZE,
    LOAD_STATE_SIZE,
    WIND_SIZE,
    WRENCH_SIZE,
    LoadReference,
    LoadState,
    TrackingError,
)
from drake_nonstop.mechanics.wrench import (
    FEEDBACK_GAINS,
    NO_FEEDBACK,
    tracking_error,
    wrench_and_rate,
)
from drake_nonstop.model.system import Model
from drake_nonstop.systems.tracing import TracedFunction
from drake_nonstop.validation import require

_PHASES = 32  # of a turn at which the Jacobian is evaluated
_TURN_OF_FASTEST = 2.0  # rad, that the fastest mode turns in a step, which a series integrates
_LEAST_STEPS, _MOST_STEPS = 48, 4096  # of a turn
_STRETCH = 1e-3  # of their length, at an equal share of the weight: cables taken not to stretch
_LARGEST = 1e100  # of a Jacobian's entries, which are in mixed units

_MOTION = slice(0, 12)  # of rotation, position, angular velocity and velocity among deviations
_SIZE = 12 + WRENCH_SIZE  # with the integrals


class Growth(NamedTuple):
    """The Floquet multipliers of a load's small deviations over a turn of the carriers."""

    period: float  # s
    multipliers: NDArray  # (k,), complex, the largest magnitude first

    @property
    def rate(self) -> float:
        """The rate at which a deviation grows in the long run, 1/s; negative where it decays."""
        return math.log(max(abs(self.multipliers[0]), 1e-300)) / self.period


class LoadDeviations:
    """The small deviations of a load from its reference, under its controller.

    The carriers are where their references are, which move with what the wrench controller commands
    to the feedback of the load's state. The deviations (18,) are those of the load's attitude, as a
    rotation vector, and position, of its angular velocity and velocity, and of the controller's
    integrals, in axes that are those of W at an instant and turn with the load's reference; their
    Jacobians are exact.

    Args:
        model: of the load, the cables and the pattern.
        carrier_stiffness: N/m, by which carriers give way along their cables; inf: not at all.
        is_above_load: whether the carriers' references are above the measured load, as those of
            `MeasuredCarrierTrajectory`, instead of above the load's reference.
        measures_attitude: whether the controllers get the load's attitude; if not, the desired one,
            as from `DesiredAttitudeFeedback`.
    """

    def __init__(
        self,
        model: Model,
        *,
        carrier_stiffness: float = math.inf,
        is_above_load: bool = False,
        measures_attitude: bool = True,
    ):
        self.model = model
        share = model.load_mass * model.gravity / model.n
        compliance = model.cable_compliance or _STRETCH * model.cable_length / share
        self._stiffness = 1 / (compliance + 1 / carrier_stiffness)
        self._is_above_load, self._measures_attitude = is_above_load, measures_attitude
        n, m = model.n, model.m
        load = model.load
        self._constants = np.concatenate(
            [
                model.attachments.ravel(),
                model.pseudo_inverse.ravel(),
                model.pattern.basis.ravel(),
                model.pattern.offset,
                load.inertia.ravel(),
                [
                    load.mass,
                    load.drag,
                    load.angular_drag,
                    load.gravity,
                    model.cable_length,
                    model.cable_compliance,
                    self._stiffness,
                    model.cable_damping,
                ],
            ]
        )
        sizes = [_SIZE, 2 * m, LOAD_REFERENCE_SIZE, WIND_SIZE, 30, len(self._constants)]
        self._rates = TracedFunction(
            lambda *values: self._trace(n, m, *values),
            sizes,
            name=lambda: "the stability of the load",
            largest=_LARGEST,
            jacobian_of=0,
            key=("load deviations", n, m, is_above_load, measures_attitude),
        )

    def jacobians(
        self,
        reference: NDArray,
        parameters: NDArray,
        angles: NDArray,
        gains: Mapping[str, Any] = NO_FEEDBACK,
        *,
        wind: NDArray | None = None,
    ) -> NDArray:
        """The Jacobians (k, 18, 18) at phases θ (k,), rad; other arguments as of `growth`."""
        packed = np.concatenate(
            [_of_position(gains), *(_matrix(gains[name]).ravel() for name in FEEDBACK_GAINS[3:])]
        )
        calm = np.zeros(WIND_SIZE) if wind is None else wind
        desired = LoadReference.view(reference)
        jacobians = np.zeros((len(angles), _SIZE, _SIZE))
        jacobians[:, :6, 6:12] = np.eye(6)
        pattern = self.model.pattern
        for k, angle in enumerate(angles):
            internal = np.concatenate(
                internal_force(
                    parameters, np.array([angle]), phases=pattern.phases, orders=pattern.orders
                )[:2]
            )
            *_, jacobian = self._rates(
                np.zeros(_SIZE), internal, reference, calm, packed, self._constants
            )
            jacobians[k, 6:] = jacobian
        # In axes that turn with the load; there the deviation of the attitude has the rate δω.
        turning = skew(desired.angular_velocity)
        for start in (3, 6, 9, 15):
            jacobians[:, start : start + 3, start : start + 3] -= turning
        return jacobians

    def growth(
        self,
        reference: NDArray,
        parameters: NDArray,
        gains: Mapping[str, Any] = NO_FEEDBACK,
        *,
        wind: NDArray | None = None,
    ) -> Growth:
        """The multipliers over a turn, with the reference's motion as it is at an instant.

        Args:
            reference: (22,) of the load; its velocities and accelerations stay as they are.
            parameters: [ξ (rad/s), A (N)] (2,), constant.
            gains: those of `FEEDBACK_GAINS`, each a number or (1,), the orientation's also (3, 3),
                in L.
            wind: (3,), m/s, in W; None: there is none.

        Raises:
            ScenarioError: the load is so light, or its cables are so stiff, that a turn has too
                many oscillations to be looked at, or a number is not finite.
        """
        angles = 2 * np.pi * np.arange(_PHASES) / _PHASES
        jacobians = self.jacobians(reference, parameters, angles, gains, wind=wind)
        if not any(np.any(gains[name]) for name in FEEDBACK_GAINS if "integral" in name):
            jacobians = jacobians[:, _MOTION, _MOTION]
        period = 2 * math.pi / abs(float(parameters[0]))
        fastest = _fastest(jacobians)
        require(
            period * fastest <= _MOST_STEPS * _TURN_OF_FASTEST,
            "fastest mode",
            f"{fastest:.3g} rad/s",
            "give a heavier load, softer cables or smaller gains: with so many oscillations in a "
            "turn the stability of the formation is not told",
        )
        multipliers = np.linalg.eigvals(_monodromy(jacobians, period, fastest))
        order = np.argsort(-np.abs(multipliers), kind="stable")
        return Growth(period, multipliers[order])

    def _measured(self, state: NDArray, reference: NDArray) -> NDArray:
        """What the controllers get of a load's state."""
        if self._measures_attitude:
            return state
        (_, position, _, velocity), desired = LoadState.view(state), LoadState.view(reference)
        return np.concatenate([desired.quaternion, position, desired.angular_velocity, velocity])

    def _trace(
        self,
        n: int,
        m: int,
        deviation: NDArray,
        internal: NDArray,
        reference: NDArray,
        wind: NDArray,
        gains: NDArray,
        constants: NDArray,
    ) -> tuple[NDArray, NDArray, NDArray]:
        """The rates of angular velocity and velocity, and of the integrals."""
        shapes = [(n, 3), (3 * n, 6), (3 * n, m), (3 * n,), (3, 3), *[(1,)] * 8]
        ends = np.cumsum([math.prod(shape) for shape in shapes])
        parts = np.split(constants, ends[:-1])
        attachments, pseudo_inverse, basis, offset, inertia, *numbers = (
            part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)
        )
        mass, drag, angular_drag, gravity, length, compliance, stiffness, damping = numbers
        load = RigidLoad(
            mass=mass, inertia=inertia, drag=drag, angular_drag=angular_drag, gravity=gravity
        )
        given: dict[str, Any] = {
            name: gains[i : i + 1] for i, name in enumerate(FEEDBACK_GAINS[:3])
        }
        matrices = gains[3:].reshape(3, 3, 3)
        given |= {name: matrices[i] for i, name in enumerate(FEEDBACK_GAINS[3:])}
        desired = LoadReference.view(reference)
        one = 0 * deviation[:1] + 1
        turn = np.concatenate([one, deviation[:3] / 2])
        turn = turn / np.sqrt((turn * turn).sum(keepdims=True))
        state = np.concatenate(
            [
                quaternion_product(turn, desired.quaternion),
                desired.position + deviation[3:6],
                desired.angular_velocity + deviation[6:9],
                desired.velocity + deviation[9:12],
            ]
        )
        distribution: dict[str, NDArray] = {
            "pseudo_inverse": pseudo_inverse,
            "basis": basis,
            "offset": offset,
        }

        def commanded(state: NDArray, integrals: NDArray) -> tuple[NDArray, NDArray, NDArray]:
            state = self._measured(state, reference)
            wrench, rate = wrench_and_rate(
                load, state, reference, integrals, wind, feedforward=1.0, **given
            )
            forces, rates = cable_forces_and_rates(state, wrench, rate, internal, **distribution)
            positions, velocities = carrier_motion(
                state if self._is_above_load else reference,
                forces,
                rates,
                attachments=attachments,
                rest_length=length,
                compliance=compliance,
            )
            return forces, positions, velocities

        forces, _, _ = commanded(reference[:LOAD_STATE_SIZE], np.zeros(WRENCH_SIZE))
        tensions = np.sqrt((forces * forces).sum(axis=1, keepdims=True))
        _, positions, velocities = commanded(state, deviation[12:])
        # What a carrier gives way is a part of its cable, which then has another length.
        on_load, _ = cable_forces_and_tensions(
            state,
            np.concatenate([positions.ravel(), velocities.ravel()]),
            attachments=attachments,
            rest_length=length + tensions * (compliance - 1 / stiffness),
            stiffness=stiffness,
            damping=damping,
        )
        rate = load_state_rate(
            load, state, on_load.ravel(), np.zeros(WRENCH_SIZE), wind, attachments=attachments
        )
        of_state = LoadState.view(rate)
        error = TrackingError.view(tracking_error(self._measured(state, reference), reference))
        return (
            of_state.angular_velocity,
            of_state.velocity,
            np.concatenate([error.orientation, error.position]),
        )


def _of_position(gains: Mapping[str, Any]) -> NDArray:
    return np.array([float(np.ravel(gains[name])[0]) for name in FEEDBACK_GAINS[:3]])


def _matrix(gain: Any) -> NDArray:
    """A gain of the orientation as a matrix (3, 3)."""
    return gain if np.ndim(gain) == 2 else float(np.ravel(gain)[0]) * np.eye(3)


def _fastest(jacobians: NDArray) -> float:
    """The largest magnitude (rad/s) of the eigenvalues of some of the matrices (k, s, s)."""
    chosen = jacobians[:: max(1, len(jacobians) // 8)]
    if not np.all(np.isfinite(chosen)):
        return math.inf
    return float(np.max(np.abs(np.linalg.eigvals(chosen))))


def _monodromy(jacobians: NDArray, period: float, fastest: float) -> NDArray:
    """The map (s, s) over a turn of ẋ = J x, with J (k, s, s) at even phases of the turn.

    `fastest` is the fastest mode in rad/s.

    By the fourth-order Magnus expansion of steps with two Gauss points, with J interpolated
    trigonometrically; Blanes, Casas and Ros, BIT 42 (2002), eq. 3.2.
    """
    from scipy.linalg import expm  # here: the import takes 0.2 s, which runs do not need

    count = max(_LEAST_STEPS, math.ceil(period * fastest / _TURN_OF_FASTEST))
    # Rates in units of the fastest mode, so that the matrices are of its size.
    scale = np.ones(jacobians.shape[1])
    scale[6:12] = max(fastest, 1 / period)
    scaled = jacobians * scale / scale[:, None]
    step = period / count
    gauss = math.sqrt(3) / 6
    starts = np.arange(count) / count
    first, second = (
        interpolated(scaled, starts + (0.5 + side) / count) for side in (-gauss, gauss)
    )
    exponent = step / 2 * (first + second)
    exponent += math.sqrt(3) / 12 * step**2 * (second @ first - first @ second)
    return functools.reduce(lambda turn, step: step @ turn, expm(exponent))
