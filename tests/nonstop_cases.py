"""Inputs of the optimization layer, and the speeds that follow from first principles."""

import numpy as np
from helpers import INERTIA, Motion, difference, regular, rotation
from pydrake.common.eigen_geometry import AngleAxis
from pydrake.math import RotationMatrix

LENGTH, COMPLIANCE, SHARE = 0.8, 1 / 500, 9.81 / 4  # of the default model, n = 4
START = np.array([2.0, 1.2])
AT_REST = {
    "measured_load_state": np.array([1.0, *np.zeros(12)]),
    "reference": np.array([1.0, *np.zeros(21)]),
    "wrench": np.array([0, 0, 0, 0, 0, 9.81]),
    "wrench_rate": np.zeros(6),
    "phase": np.zeros(2),
}


def speed_at_rest(frequency, amplitude):
    """The speed of every carrier over a level square at rest, at every phase."""
    tension = np.hypot(amplitude, SHARE)
    return frequency * amplitude * (LENGTH + COMPLIANCE * tension) / tension


def moving(seed, slope=0.0):
    """Inputs of a load that swings about a moving reference; `slope` is ∂θ/∂ξ."""
    rng = np.random.default_rng(seed)
    reference = Motion(seed).reference(0.7)
    state = reference[:13] + 0.03 * rng.normal(size=13)
    state[:4] /= np.linalg.norm(state[:4])
    torque, force = 0.01 * rng.uniform(-1, 1, 3), 0.5 * rng.uniform(-1, 1, 3)
    return {
        "measured_load_state": state,
        "reference": reference,
        "wrench": np.array([*torque, *force]) + AT_REST["wrench"],
        "wrench_rate": rng.uniform(-0.3, 0.3, 6),
        "phase": np.array([rng.uniform(0, 2 * np.pi), slope]),
    }


def ahead(pose, twist, acceleration, time):
    """(R, p) after a time at constant accelerations; its first two rates at 0 are exact."""
    turn = time * twist[:3] + time**2 / 2 * acceleration[:3]
    angle = np.linalg.norm(turn)
    R = rotation(pose[:4])
    if angle > 0:
        R = RotationMatrix(AngleAxis(angle, turn / angle)).matrix() @ R
    return R, pose[4:] + time * twist[3:] + time**2 / 2 * acceleration[3:]


def cables(x, inputs, time=0.0, *, load_motion="desired", second_rate=0.0):
    """Positions (4, 3) of the default model's carriers and tensions (4, 1) of its cables.

    From first principles: by the pseudo-inverse of the grasp matrix in the world frame.
    """
    state, reference, wrench, rate, (theta, slope) = inputs.values()
    R_0, omega, velocity = rotation(state[:4]), state[7:10], state[10:]
    J = R_0 @ INERTIA @ R_0.T
    alpha = np.linalg.solve(J, wrench[:3] - np.cross(omega, J @ omega))
    acceleration = np.array([*alpha, *(wrench[3:] - 0.7 * velocity - [0, 0, 9.81])])
    attachments = regular(4)
    R, p = ahead(state[:7], state[7:], acceleration, time)
    R_motion, p_motion = R, p
    if load_motion == "desired":
        R_motion, p_motion = ahead(reference[:7], reference[7:13], reference[13:19], time)
    grasp = np.zeros((6, 12))
    internal = np.zeros(12)
    for i, lever in enumerate(attachments @ R.T):
        grasp[3:, 3 * i : 3 * i + 3] = np.eye(3)
        for j, axis in enumerate(np.eye(3)):
            grasp[:3, 3 * i + j] = np.cross(lever, axis)
        edge = R @ (attachments[i] - attachments[(i + 1) % 4])
        angle = theta + (x[0] - START[0]) * slope + x[0] * time + np.pi / 2 * i
        push = x[1] * np.cos(angle) * edge / np.linalg.norm(edge)
        internal[3 * i : 3 * i + 3] += push
        following = 3 * ((i + 1) % 4)
        internal[following : following + 3] -= push
    w = wrench + time * rate + time**2 / 2 * second_rate
    forces = (np.linalg.pinv(grasp) @ w + internal).reshape(4, 3)
    tensions = np.linalg.norm(forces, axis=1, keepdims=True)
    positions = p_motion + attachments @ R_motion.T + (LENGTH / tensions + COMPLIANCE) * forces
    return positions, tensions


def carrier_speeds(x, inputs, time=0.0, *, wind=0.0, **arguments):
    """The speeds (4,) through the air that carriers will have, by differences of positions."""
    velocities = difference(lambda t: cables(x, inputs, t, **arguments)[0], time)
    return np.linalg.norm(velocities - wind, axis=1)


def speed_bound_above(inputs, share, **arguments):
    """A bound that the start misses: its slowest carrier's speed, times 1 + share."""
    return (1 + share) * np.min(carrier_speeds(START, inputs, **arguments))


def change_cost(x, inputs, previous=START):
    """Eq. 26 for the default model, written out."""
    before = inputs["phase"][0] + np.pi / 2 * np.arange(4)
    after = before + (x[0] - previous[0]) * inputs["phase"][1]
    jump = x[1] * np.cos(after) - previous[1] * np.cos(before)
    rate_jump = x[0] * x[1] * np.sin(after) - previous[0] * previous[1] * np.sin(before)
    return np.sum((x - previous) ** 2) + np.sum(jump**2) + np.sum(rate_jump**2)
