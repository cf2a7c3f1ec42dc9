"""The sampled loop of load, cables, carriers and controllers, linear about the carriers' orbits.

The load's errors, the carriers' deviations from their planned motion, the integrals of the wrench
controller and the samples that a delay keeps are the state. The load rests; all vectors are in its
frame as desired.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.analysis.load_response import LoadResponse, Response
from drake_nonstop.analysis.sampled_maps import map_of_turn, parts_of_turn
from drake_nonstop.mechanics.signals import (
    TRACKING_ERROR_SIZE,
    WRENCH_SIZE,
    LoadReference,
    resting_reference,
)
from drake_nonstop.model.descriptions import Estimator
from drake_nonstop.model.system import Model

_ERRORS = TRACKING_ERROR_SIZE  # of the load, [e_R, e_p, e_ω, e_v]
_LOOPS = 60  # phases of a turn, at which the loop is linearized


@dataclass(frozen=True, kw_only=True, eq=False)
class Carriers:
    """The carriers' controllers, per unit of their mass.

    Attributes:
        position_gain: K_p/m_c, 1/s².
        velocity_gain: K_d/m_c, 1/s.
        integral_gain: K_i/m_c, 1/s³.
        has_feedforward: whether the references' accelerations are.
        hold: order of the references' motion within a sample: 1 goes on along their velocity, 3
            along their acceleration and their jerk, too; 0: they are continuous.
    """

    position_gain: float
    velocity_gain: float
    integral_gain: float = 0.0
    has_feedforward: bool = True
    hold: int = 3


@dataclass(frozen=True, kw_only=True, eq=False)
class Feedback:
    """Feedback of errors of the load by the loop.

    Attributes:
        gains: of `mechanics.wrench.wrench_and_rate`, by name.
        is_measured: (12,), 0 for what the controller takes as desired, else 1.
        delay: of the measurement, in samples.
        period: between samples, s.
        estimator: of the errors, behind the measurement; None: there is none.
    """

    gains: Mapping[str, Any]
    is_measured: NDArray
    delay: int
    period: float
    estimator: Estimator | None = None


class Orbit(NamedTuple):
    """The cables' forces at a phase of the orbits."""

    forces: NDArray  # (n, 3), N
    rates: NDArray  # (n, 3), N/s
    second_rates: NDArray  # (n, 3), N/s²
    third_rates: NDArray  # (n, 3), N/s³

    def later(self, time: float) -> "Orbit":
        """The forces and their rates a short time (s) later, by Taylor's series."""
        half, third = time * time / 2, time**3 / 6
        return self._replace(
            forces=self.forces
            + time * self.rates
            + half * self.second_rates
            + third * self.third_rates,
            rates=self.rates + time * self.second_rates + half * self.third_rates,
        )


def _slices(sizes: Iterable[int]) -> list[slice]:
    return [slice(*ends) for ends in pairwise(np.cumsum([0, *sizes]).tolist())]


def growth_rate(
    model: Model,
    plant: Model,
    carriers: Carriers,
    feedback: Feedback,
    frequency: float,
    orbit: Callable[[float], Orbit],
) -> float:
    """1/s, at which a deviation of the loop grows from turn to turn of the orbits, at most.

    Growth is that of the maps between the phases, too: forces that step from phase to phase move
    what is lightly damped.

    Args:
        model: what the controllers believe.
        plant: what is simulated.
        carriers: their controllers and references.
        feedback: the wrench controller's.
        frequency: ξ, rad/s.
        orbit: that at a phase in rad.
    """
    turn = 2 * math.pi / frequency
    count = parts_of_turn(turn, feedback.period, _LOOPS)
    orbits = [orbit(2 * math.pi * i / count) for i in range(count)]
    maps = np.stack(maps_at(model, plant, carriers, feedback, orbits))
    whole = max(1, round(turn / feedback.period))
    growth = np.max(np.abs(np.linalg.eigvals(map_of_turn(maps, whole))))
    return math.log(growth) / (whole * feedback.period)


def maps_at(
    model: Model,
    plant: Model,
    carriers: Carriers,
    feedback: Feedback,
    orbits: Iterable[Orbit],
) -> list[NDArray]:
    """The maps (s, s) from sample to sample at phases; other arguments as of `growth_rate`.

    The measured errors of a sample make what is commanded: references and feedforwards, by
    `LoadResponse`. The carriers' loops are m_c p̈ = K_p (p_d − p) + K_d (v_d − v) + m_c a_d. Between
    samples references go on by their hold. The cables pull as in the middle of the sample: commands
    are half a sample behind them, which takes damping away from what oscillates across a cable that
    turns.

    Left out is the reference's own turning. Own derivation.
    """
    stiffness = plant.cable_stiffness
    response = LoadResponse(model, plant, stiffness=stiffness, stretch=1 / stiffness)
    return [_map_at(response, carriers, feedback, orbit) for orbit in orbits]


def _response_at(response: LoadResponse, feedback: Feedback, orbit: Orbit) -> Response:
    """That of a load which does not turn, and accelerates as the cables' forces have it."""
    force, force_rate = orbit.forces.sum(axis=0), orbit.rates.sum(axis=0)
    reference, load = resting_reference(), response.load
    desired = LoadReference.view(reference)
    desired.acceleration[:] = force / load.mass - [0, 0, load.gravity]
    desired.jerk[:] = (force_rate - load.drag * desired.acceleration) / load.mass
    of_force = response.pseudo_inverse[:, 3:]
    internal = np.stack([part.ravel() for part in orbit[:4]])
    internal[:2] -= of_force @ force, of_force @ force_rate
    given = reference, internal[None], feedback.gains
    (found,) = response.along(*given, is_measured=feedback.is_measured)
    return found


def _map_at(
    response: LoadResponse, carriers: Carriers, feedback: Feedback, orbit: Orbit
) -> NDArray:
    from scipy.linalg import expm  # here: the import takes 0.2 s, which few runs need

    n, period, delay = response.n, feedback.period, feedback.delay
    size = 3 * n
    # The state: errors of the load, carriers, their integrals, those of the controller, samples of
    # the delay, the estimate; then what is held in a sample: reference, its acceleration that is
    # missing, the feedforward that is, and the jerk that is.
    sizes = {
        "load": _ERRORS,
        "position": size,
        "velocity": size,
        "carrier_integral": size if carriers.integral_gain else 0,
        "integral": WRENCH_SIZE,
        "samples": _ERRORS * delay,
        "estimate": _ERRORS if feedback.estimator else 0,
        "desired_position": size,
        "desired_velocity": size,
        "missing_acceleration": size,
        "missing_feedforward": size,
        "missing_jerk": size,
    }
    at = dict(zip(sizes, _slices(sizes.values()), strict=True))
    kept, end = at["desired_position"].start, at["missing_jerk"].stop
    now = _response_at(response, feedback, orbit)
    middle = _response_at(response, feedback, orbit.later(period / 2))
    M = np.zeros((end, end))
    position, velocity = at["position"], at["velocity"]
    unit = np.eye(size)
    # All that `Response` has derivatives by, but the integrals.
    motion = np.r_[at["load"], position, velocity]
    by_motion = np.r_[:_ERRORS, _ERRORS + WRENCH_SIZE : _ERRORS + WRENCH_SIZE + 2 * size]
    M[:6, 6:12] = np.eye(6)
    M[6:12, motion] = middle.load[:, by_motion]
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

    S = np.eye(end)
    S[kept:] = 0
    measured = np.zeros((_ERRORS, end))  # what the controller gets of the state
    if feedback.estimator:
        estimate = at["estimate"]
        prediction = (np.eye(_ERRORS) - feedback.estimator.gain) @ feedback.estimator.transition
        measured[:, estimate] = prediction
        S[estimate] = measured
    last = (at["samples"] if delay else at["load"]).stop
    measured[:, last - _ERRORS : last] = np.eye(_ERRORS)
    parts = _slices([size] * 4)
    held = {"desired_position": parts[0], "desired_velocity": parts[1]}
    if carriers.hold == 3:
        held |= {"missing_acceleration": parts[2], "missing_jerk": parts[3]}
    if carriers.has_feedforward:
        held["missing_feedforward"] = parts[2]
    of_errors, of_integrals = np.split(now.commands, [_ERRORS], axis=1)
    for name, rows in held.items():
        sign = -1 if name.startswith("missing") else 1
        S[at[name]] = sign * of_errors[rows] @ measured
        S[at[name], at["integral"]] = sign * of_integrals[rows]
    # What is not measured, or has no integral gain, is not integrated.
    has_gain = np.any(of_integrals, axis=0)
    is_integrated = has_gain * feedback.is_measured[:WRENCH_SIZE]
    S[at["integral"], at["integral"]] = np.diag(is_integrated)
    S[at["integral"]] += period * np.diag(is_integrated) @ measured[:WRENCH_SIZE]
    if delay:
        samples = at["samples"]
        S[samples, samples] = np.eye(_ERRORS * delay, k=-_ERRORS)
        S[samples.start : samples.start + _ERRORS, at["load"]] = np.eye(_ERRORS)
    whole: NDArray = expm(M * period) @ S
    return whole[:kept, :kept]  # what is held begins anew at each sample
