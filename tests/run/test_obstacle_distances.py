"""How near bodies come to obstacles, at and between steps."""

import numpy as np
import pytest

from drake_nonstop.mechanics.rounded_box import nearest_to
from drake_nonstop.run.spacing import closest_approach
from drake_nonstop.scenario.obstacles import BoxConfig, GroundConfig, SphereConfig

TIMES = np.linspace(0, 3, 7)


def points(path):
    """One body, a point, along a path (k, 3)."""
    path = np.asarray(path, dtype=float)
    return np.stack([path, path], axis=1)[:, None, None]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", [SphereConfig, BoxConfig, GroundConfig])
def test_nothing_is_nearer_at_any_of_many_instants(kind, seed):
    rng = np.random.default_rng(seed)
    far = 6 * (seed % 2)  # for one of them, no contact
    place = far + rng.uniform(-1, 1, 3)
    where = {"height": -2.0 - far} if kind is GroundConfig else {"position": place}
    box = kind(**where).shape()
    segments = rng.normal(size=(7, 2, 2, 2, 3)) * 2
    found = closest_approach("cable", segments, TIMES, "it", box)
    fine = np.linspace(0, 3, 3001)
    flat = segments.reshape(7, -1)
    between = np.stack([np.interp(fine, TIMES, column) for column in flat.T], axis=1)
    distances = nearest_to(box, between.reshape(-1, 2, 2, 2, 3))[0].min(axis=2)
    least = distances.min()
    assert (found.distance > 0) == (least > 0) == (far > 0)
    assert least - 0.01 < found.distance < least + 1e-3
    if least > 0:
        assert distances.min(axis=1)[np.argmin(np.abs(fine - found.time))] < least + 0.02


def test_a_body_that_crosses_between_two_steps_is_found():
    wall = BoxConfig(position=[0.0, 0.0, 0.0], size=[0.01, 9.0, 9.0]).shape()
    path = [[-5, 0, 0], [-3, 0, 0], [-1, 0, 0], [1.02, 0, 0], [3, 0, 0], [5, 0, 0], [7, 0, 0]]
    found = closest_approach("carrier", points(path), TIMES, "wall", wall)
    assert found.distance < 0
    assert found.time == pytest.approx(1.0 + 0.5 / 2.02, abs=5e-3)


def test_the_first_contact_and_the_body_are_told():
    tower = BoxConfig(size=[2.0, 2.0, 9.0]).shape()
    paths = np.zeros((7, 2, 3))
    paths[:, 0] = [9.0, 9.0, 0.0]
    paths[:, 1, 0] = np.linspace(-3, 3, 7)
    bodies = np.stack([paths, paths], axis=2)[:, :, None]
    found = closest_approach("carrier", bodies, TIMES, "tower", tower)
    assert found.sentence == "carrier 2 hit tower at t = 1.50 s"
    assert found.distance == -1
    apart = closest_approach("carrier", points(paths[:, 0]), TIMES, "tower", tower)
    assert apart.sentence == "the carrier came within 11.3 m of tower at t = 0.00 s"
    assert apart.distance == pytest.approx(8 * 2**0.5)
    assert found.order < apart.order


def test_a_constant_distance_needs_no_closer_look_and_is_exact():
    angle = np.linspace(0, 20, 20_000)
    circle = 7 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    ground = GroundConfig(height=-2.0).shape()
    found = closest_approach("carrier", points(circle), angle, "ground", ground)
    assert found.distance == pytest.approx(2.0, abs=1e-9)
    ball = closest_approach(
        "carrier", points(circle), angle, "it", SphereConfig(radius=2.0).shape()
    )
    assert ball.distance == pytest.approx(5.0, abs=1e-3)


def test_a_body_at_rest_through_the_centre_of_a_sphere_needs_no_closer_look():
    segment = np.array([[0.0, 0.0, 0.0], [0.0, 80.0, 0.1]])
    bodies, ball = np.tile(segment, (7, 1, 1, 1, 1)), SphereConfig(radius=1e-3).shape()
    found = closest_approach("load", bodies, TIMES, "ball", ball)
    assert (found.distance, found.time) == (pytest.approx(-1e-3), 0.0)
