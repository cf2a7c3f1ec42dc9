import numpy as np
import pytest
from helpers import SHAPES, Motion, difference, irregular, rotation

from drake_nonstop.mechanics.cable import (
    cable_forces_and_tensions,
    forces_under_other_wrench,
    wrenches_of,
)
from drake_nonstop.mechanics.rotation import rotation_matrix

LENGTH, STIFFNESS, DAMPING = 0.8, 500.0, 0.3
CONSTANTS = {"rest_length": LENGTH, "stiffness": STIFFNESS, "damping": DAMPING}
UP = np.array([0.0, 0.0, 3.0])


def straight(stretch, stretch_rate):
    """Force and tension of a cable that pulls straight up on a load at rest."""
    carrier = np.array([0, 0, LENGTH + stretch, 0, 0, stretch_rate])
    load_state = np.array([1.0, *np.zeros(12)])
    force, tension = cable_forces_and_tensions(
        load_state, carrier, attachments=np.zeros((1, 3)), **CONSTANTS
    )
    return force[0], tension[0]


@pytest.mark.parametrize("stretch_rate", [-1000.0, -20.0, -1.0, 0.0, 1.0, 20.0])
def test_cable_never_pushes_and_has_no_jump_where_it_goes_slack(stretch_rate):
    stretches = np.linspace(-2e-3, 2e-3, 401)
    forces, tensions = zip(*(straight(s, stretch_rate) for s in stretches), strict=True)
    spring = STIFFNESS * np.maximum(stretches, 0)
    expected = np.clip(STIFFNESS * stretches + DAMPING * stretch_rate, 0, 2 * spring)
    np.testing.assert_allclose(tensions, expected, atol=1e-9)
    np.testing.assert_array_equal(np.array(forces)[:, 2], tensions)


@pytest.mark.parametrize("shape", ["regular-4", "spatial-5"])
def test_taut_cables_between_moving_load_and_moving_carriers(shape):
    attachments = SHAPES[shape]
    n = len(attachments)
    load, carriers = Motion(8), [Motion(20 + i) for i in range(n)]

    def cables(t):
        """The vectors from the attachments to the carriers, 2 m and more above them."""
        state = load.state(t)
        ends = state[4:7] + attachments @ rotation(state[:4]).T
        return np.array([c.state(t)[4:7] + UP for c in carriers]) - ends

    def lengths(t):
        return np.linalg.norm(cables(t), axis=1)

    time = 1.1
    carrier_state = np.concatenate(
        [c.state(time)[4:7] + UP for c in carriers] + [c.state(time)[10:13] for c in carriers]
    )
    forces, tensions = cable_forces_and_tensions(
        load.state(time), carrier_state, attachments=attachments, **CONSTANTS
    )
    expected = STIFFNESS * (lengths(time) - LENGTH) + DAMPING * difference(lengths, time)
    np.testing.assert_allclose(tensions, expected, rtol=1e-12, atol=0)
    directions = cables(time) / lengths(time)[:, None]
    np.testing.assert_allclose(forces, expected[:, None] * directions, rtol=1e-11)


@pytest.mark.parametrize("n", [3, 4, 7])
def test_forces_under_another_wrench_are_those_of_a_load_that_has_moved_to_where_it_has_it(n):
    rng = np.random.default_rng(n)
    points = irregular(n) + np.array([0, 0, 0.1])
    carriers = 1.05 * LENGTH * np.array([0, 0, 1.0]) + 1.4 * points + 0.05 * rng.normal(size=(n, 3))
    state = np.concatenate([carriers.ravel(), np.zeros(3 * n)])
    own = {
        "rest_length": LENGTH * (1 + 0.01 * np.arange(n)),
        "stiffness": STIFFNESS * (1 + 0.2 * np.arange(n)),
    }
    still = {**CONSTANTS, **own, "damping": 0.0, "attachments": points}
    rest = np.array([1.0, *np.zeros(12)])
    forces, _ = cable_forces_and_tensions(rest, state, **still)

    def error(size):
        moved = rest.copy()
        moved[1:7] = size * np.array([0.2, -0.1, 0.3, 0.2, -0.3, 0.1])  # half a turn, and a way
        moved[:4] /= np.linalg.norm(moved[:4])
        expected, _ = cable_forces_and_tensions(moved, state, **still)
        levers = points @ rotation_matrix(moved[:4]).T
        found = forces_under_other_wrench(
            forces[None],
            points,
            wrenches_of(expected, levers)[None],
            **own,
        )
        return np.max(np.abs(found[0] - expected)) / np.max(np.abs(forces - expected))

    assert error(1e-3) < 0.02
    assert error(1e-4) < 0.11 * error(1e-3)  # it is of the first order
