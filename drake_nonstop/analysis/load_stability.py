"""How a small deviation of the load grows while its carriers follow their references exactly.

A quick analysis of a formation: the load and the integrals of its controller, without the carriers'
own dynamics and without samples. `studies.stability` has the whole loop, and takes seconds.
"""

import functools
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.analysis.load_response import LoadResponse
from drake_nonstop.analysis.sampled_maps import AT_ONCE, interpolated
from drake_nonstop.mechanics.internal_force import internal_force
from drake_nonstop.mechanics.rigid_load import STILL_AIR
from drake_nonstop.mechanics.rotation import rotation_matrix, skew
from drake_nonstop.mechanics.signals import TRACKING_ERROR_SIZE, WRENCH_SIZE, LoadReference
from drake_nonstop.mechanics.wrench import FEEDBACK_GAINS, NO_FEEDBACK
from drake_nonstop.model.system import Model
from drake_nonstop.validation import require

_PHASES = 16  # of a turn at which the Jacobian is evaluated
_TURN_OF_FASTEST = 4.0  # rad, that the fastest mode turns in a step, which a series integrates
_LEAST_STEPS, _MOST_STEPS = 48, 4096  # of a turn
_STRETCH = 1e-3  # of their length, at an equal share of the weight: cables taken not to stretch

_SMALL = 0.5  # a norm, up to which a series of twelve powers is exact to rounding
_SERIES = [[1 / math.factorial(start + k) for k in range(4)] for start in (0, 4, 8)]

_ERRORS = TRACKING_ERROR_SIZE  # of rotation, position, angular velocity and velocity
_ALL = np.ones(_ERRORS)
_SIZE = _ERRORS + WRENCH_SIZE  # with the integrals


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
        is_measured: (12,), 0 for errors of the load that the controllers take as zero, else 1.
    """

    def __init__(
        self,
        model: Model,
        *,
        carrier_stiffness: float = math.inf,
        is_above_load: bool = False,
        is_measured: NDArray = _ALL,
    ):
        self.model = model
        share = model.load_mass * model.gravity / model.n
        compliance = model.cable_compliance
        compliance = np.where(compliance > 0, compliance, _STRETCH * model.cable_length / share)
        self._response = LoadResponse(
            model,
            model,
            stiffness=1 / (compliance + 1 / carrier_stiffness),
            stretch=model.cable_compliance,
            is_above_load=is_above_load,
            is_brief=True,
        )
        self._is_measured = is_measured

    def jacobians(
        self,
        reference: NDArray,
        parameters: NDArray,
        angles: NDArray,
        gains: Mapping[str, Any] = NO_FEEDBACK,
        *,
        wind: NDArray = STILL_AIR,
    ) -> NDArray:
        """The Jacobians (k, 18, 18) at phases θ (k,), rad; other arguments as of `growth`."""
        desired = LoadReference.view(reference)
        rotation = rotation_matrix(desired.quaternion)
        jacobians = np.zeros((len(angles), _SIZE, _SIZE))
        jacobians[:, :6, 6:12] = np.eye(6)
        jacobians[:, 12:15, :3], jacobians[:, 15:, 3:6] = rotation.T, np.eye(3)
        jacobians[:, 12:, :6] *= self._is_measured[:6]
        pattern = self.model.pattern
        waves = internal_force(parameters, angles[:, None], phases=pattern.phases)
        internals = np.zeros((len(angles), 4, 3 * self.model.n))
        internals[:, :2] = np.stack(waves[:2], axis=1) @ pattern.basis.T
        internals[:, 0] += pattern.offset
        along = self._response.along(
            reference, internals, gains, is_measured=self._is_measured, wind=wind
        )
        for k, found in enumerate(along):
            jacobians[k, 6:12] = found.load[:, :_SIZE]
            carriers = found.commands[: 6 * self.model.n]
            jacobians[k, 6:12] += found.load[:, _SIZE:] @ carriers
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
        wind: NDArray = STILL_AIR,
    ) -> Growth:
        """The multipliers over a turn, with the reference's motion as it is at an instant.

        Args:
            reference: (22,) of the load; its velocities and accelerations stay as they are.
            parameters: [ξ (rad/s), A (N)] (2,), constant.
            gains: those of `FEEDBACK_GAINS`, each a number or (1,), the orientation's also (3, 3),
                in L.
            wind: (3,), m/s, in W.

        Raises:
            ScenarioError: the load is so light, or its cables are so stiff, that a turn has too
                many oscillations to be looked at, or a number is not finite.
        """
        angles = 2 * np.pi * np.arange(_PHASES) / _PHASES
        jacobians = self.jacobians(reference, parameters, angles, gains, wind=wind)
        if not any(np.any(gains[name]) for name in FEEDBACK_GAINS if "integral" in name):
            jacobians = jacobians[:, :_ERRORS, :_ERRORS]
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
    count = max(_LEAST_STEPS, math.ceil(period * fastest / _TURN_OF_FASTEST))
    # Rates in units of the fastest mode, so that the matrices are of its size.
    scale = np.ones(jacobians.shape[1])
    scale[6:12] = max(fastest, 1 / period)
    scaled = jacobians * scale / scale[:, None]
    step, gauss, turn = period / count, math.sqrt(3) / 6, np.eye(len(scale))
    for start in range(0, count, AT_ONCE):
        middles = np.arange(start, min(start + AT_ONCE, count)) + 0.5
        first, second = (interpolated(scaled, (middles + side) / count) for side in (-gauss, gauss))
        exponent = step / 2 * (first + second)
        exponent += math.sqrt(3) / 12 * step**2 * (second @ first - first @ second)
        turn = functools.reduce(lambda turn, step: step @ turn, _exponentials(exponent), turn)
    return turn


def _exponentials(matrices: NDArray) -> NDArray:
    """The exponentials of matrices (k, s, s), by their series where they are small, and squares.

    SciPy's takes them one by one, and 0.2 s for its import.
    """
    norm = float(np.max(np.abs(matrices).sum(axis=2)))
    squarings = max(0, math.ceil(math.log2(norm / _SMALL))) if 0 < norm < math.inf else 0
    part = matrices / 2**squarings
    second = part @ part
    powers = np.stack(
        [np.broadcast_to(np.eye(len(part[0])), part.shape), part, second, second @ part]
    )
    low, middle, high = np.tensordot(_SERIES, powers, 1)
    fourth = second @ second
    found = low + fourth @ (middle + fourth @ (high + fourth / math.factorial(12)))
    for _ in range(squarings):
        found = found @ found
    return found
