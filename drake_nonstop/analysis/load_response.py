"""How a load on cables, and what its controllers command, respond to small deviations."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.cable import cable_forces_and_tensions
from drake_nonstop.mechanics.carrier import carrier_motion
from drake_nonstop.mechanics.grasp import cable_forces_and_rates
from drake_nonstop.mechanics.rigid_load import STILL_AIR, RigidLoad, load_state_rate
from drake_nonstop.mechanics.rotation import norm, quaternion_product
from drake_nonstop.mechanics.signals import (
    LOAD_REFERENCE_SIZE,
    LOAD_STATE_SIZE,
    TRACKING_ERROR_SIZE,
    WIND_SIZE,
    WRENCH_SIZE,
    LoadReference,
    LoadState,
)
from drake_nonstop.mechanics.wrench import FEEDBACK_GAINS, wrench_and_rate
from drake_nonstop.model.system import Model
from drake_nonstop.systems.tracing import TracedFunction

_LARGEST = 1e100  # of a Jacobian's entries, which are in mixed units


class Response(NamedTuple):
    """Derivatives of a loop of n carriers at an instant, in W.

    Of what is commanded by [errors (12), integrals (6)]: desired positions, velocities,
    accelerations and jerks (3n each). Of the load's [ω̇; v̇] by [errors (12), integrals (6),
    carriers' positions and velocities (3n each)].
    """

    commands: NDArray  # (12n, 18)
    load: NDArray  # (6, 18 + 6n)


class LoadResponse:
    """The exact derivatives of load, cables and commands about carriers on their references.

    Args:
        model: of the wrench's distribution, and of what the references stretch by.
        plant: of the load and its cables.
        stiffness: N/m, of the cables, one for all or (n,).
        stretch: m/N, likewise, by which the cables are longer where the carriers are.
        is_above_load: whether the references are above the load, instead of above its reference.
        is_brief: whether only positions and velocities are commanded, which takes half the time.
    """

    def __init__(
        self,
        model: Model,
        plant: Model,
        *,
        stiffness: float | NDArray,
        stretch: float | NDArray,
        is_above_load: bool = False,
        is_brief: bool = False,
    ):
        n, load = plant.n, plant.load
        self.n, self.load, self.pseudo_inverse = n, load, model.pseudo_inverse
        numbers = [load.mass, load.drag, load.angular_drag, load.gravity]
        of_cables = [plant.cable_length, model.cable_compliance, stiffness, plant.cable_damping]
        each = [np.broadcast_to(number, n) for number in (*of_cables, stretch)]
        parts = [plant.attachments, self.pseudo_inverse, load.inertia, numbers, *each]
        self._constants = np.concatenate([np.asarray(part, float).ravel() for part in parts])
        sizes = [
            TRACKING_ERROR_SIZE + WRENCH_SIZE + 6 * n,
            12 * n,
            LOAD_REFERENCE_SIZE,
            WIND_SIZE,
            30,
        ]
        self._rates = TracedFunction(
            lambda *values: _trace(n, is_above_load, is_brief, *values),
            [*sizes, len(self._constants)],
            name=lambda: "the response of the load",
            largest=_LARGEST,
            jacobian_of=0,
            key=("response of a load", n, is_above_load, is_brief),
        )
        self._commands = (6 if is_brief else 12) * n  # rows of the Jacobian

    def along(
        self,
        reference: NDArray,
        internals: NDArray,
        gains: Mapping[str, Any],
        *,
        is_measured: NDArray,
        wind: NDArray = STILL_AIR,
    ) -> list[Response]:
        """The derivatives at k phases, where the load is on its reference (22,).

        Args:
            reference: of the load.
            internals: (k, 4, 3n), N, what the cables' forces have beside those of the wrench, and
                their rate, in L; then their second and third rates, in W.
            gains: those of `FEEDBACK_GAINS`, each a number or (1,), the orientation's also (3, 3).
            is_measured: (12,), 0 for errors that the controllers take as zero, else 1.
            wind: (3,), m/s, in W.
        """
        n, count = self.n, self._commands
        scalars = [np.ravel(gains[name])[:1] for name in FEEDBACK_GAINS[:3]]
        matrices = [
            np.ravel(gain if np.ndim(gain := gains[name]) == 2 else np.ravel(gain)[0] * np.eye(3))
            for name in FEEDBACK_GAINS[3:]
        ]
        packed = np.concatenate([*scalars, *matrices])
        on_reference = np.zeros(TRACKING_ERROR_SIZE + WRENCH_SIZE + 6 * n)
        found = []
        for internal in internals.reshape(len(internals), -1):
            *_, jacobian = self._rates(
                on_reference, internal, reference, wind, packed, self._constants
            )
            commands = jacobian[:count, : TRACKING_ERROR_SIZE + WRENCH_SIZE].copy()
            commands[:, :TRACKING_ERROR_SIZE] *= is_measured
            found.append(Response(commands, jacobian[count:].copy()))
        return found


def _trace(
    n: int,
    is_above_load: bool,
    is_brief: bool,
    deviation: NDArray,
    internal: NDArray,
    reference: NDArray,
    wind: NDArray,
    gains: NDArray,
    constants: NDArray,
) -> tuple[NDArray, ...]:
    """Commands, and the load's angular acceleration and acceleration."""
    shapes = [(n, 3), (3 * n, 6), (3, 3), *[(1,)] * 4, *[(n,)] * 5]
    ends = np.cumsum([math.prod(shape) for shape in shapes])
    attachments, pseudo_inverse, inertia, *numbers = (
        part.reshape(shape)
        for part, shape in zip(np.split(constants, ends[:-1]), shapes, strict=True)
    )
    mass, drag, angular_drag, gravity, length, compliance, stiffness, damping, stretch = numbers
    load = RigidLoad(
        mass=mass, inertia=inertia, drag=drag, angular_drag=angular_drag, gravity=gravity
    )
    given: dict[str, Any] = {name: gains[i : i + 1] for i, name in enumerate(FEEDBACK_GAINS[:3])}
    given |= dict(zip(FEEDBACK_GAINS[3:], gains[3:].reshape(3, 3, 3), strict=True))
    errors, integrals, carriers = np.split(
        deviation, [TRACKING_ERROR_SIZE, TRACKING_ERROR_SIZE + WRENCH_SIZE]
    )
    turn, shift, turning, speeding = np.split(errors, 4)
    turn = np.concatenate([0 * turn[:1] + 1, turn / 2])
    desired = LoadReference.view(reference)
    state = np.concatenate(
        [
            quaternion_product(turn / norm(turn), desired.quaternion),
            desired.position + shift,
            desired.angular_velocity + turning,
            desired.velocity + speeding,
        ]
    )
    own, second, third = np.split(internal, [6 * n, 9 * n])
    distribution = {
        "pseudo_inverse": pseudo_inverse,
        "basis": np.eye(3 * n),
        "offset": np.zeros(3 * n),
    }

    def commanded(state: NDArray, integrals: NDArray) -> tuple[NDArray, NDArray]:
        wrench, rate = wrench_and_rate(
            load, state, reference, integrals, wind, feedforward=1.0, **given
        )
        return cable_forces_and_rates(state, wrench, rate, own, **distribution)

    taut = {"attachments": attachments, "rest_length": length}
    held = commanded(reference[:LOAD_STATE_SIZE], np.zeros(WRENCH_SIZE))
    there = carrier_motion(reference, *held, **taut, compliance=stretch)
    on_load, _ = cable_forces_and_tensions(
        state,
        np.concatenate([part.ravel() for part in there]) + carriers,
        attachments=attachments,
        rest_length=length + norm(held[0])[:, 0] * (stretch - 1 / stiffness),
        stiffness=stiffness,
        damping=damping,
    )
    rate = load_state_rate(
        load, state, on_load.ravel(), np.zeros(WRENCH_SIZE), wind, attachments=attachments
    )
    moved = LoadState.view(rate)
    forces = commanded(state, integrals)
    higher = (part.reshape(n, 3) for part in (second, third))
    positions, velocities, *_ = carrier_motion(
        state if is_above_load else reference, *forces, **taut, compliance=compliance
    )
    if is_brief:
        return positions, velocities, moved.angular_velocity, moved.velocity
    _, _, accelerations, jerks = carrier_motion(
        reference, *forces, *higher, **taut, compliance=compliance
    )
    return positions, velocities, accelerations, jerks, moved.angular_velocity, moved.velocity
