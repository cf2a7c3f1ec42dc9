"""Cables of nodes against lines in closed form, and against Drake's MultibodyPlant."""

from itertools import chain, pairwise

import numpy as np
import pytest
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import LinearSpringDamper, SpatialInertia, UnitInertia
from scipy.optimize import least_squares

from drake_nonstop.mechanics.lumped_cable import (
    CableMaterial,
    lumped_cables,
    nodes_of,
    segment_shares,
    straight_nodes,
)

LENGTH, STIFFNESS, GRAVITY, AIR = 150.0, 120.0, 9.81, 1.225
CABLE = CableMaterial(LENGTH, STIFFNESS, 2.0, 1e-3, 970.0, 1.1, 0.0, AIR, GRAVITY)
SOFT = CABLE._replace(stiffness=3.0)  # so that segments are taut in a line of chords
ONE = np.zeros((1, 3))  # attachment of one cable, in the load's origin
REST = np.array([1.0, *np.zeros(12)])


def moved(state, carrier, wind=(0, 0, 0), cable=CABLE, ratio=0.3):
    """Of one cable from the origin to a carrier (6,)."""
    flow = np.array(wind, float)
    return lumped_cables(
        *(state, REST, np.asarray(carrier, float), flow, flow),
        attachments=ONE,
        cable=cable,
        max_damping_ratio=ratio,
    )


def settled(carrier, nodes, wind=(0, 0, 0), cable=CABLE, *, start=None, bow=(0, 0, 0)):
    """Nodes (N, 3) without acceleration, with velocities as of a line that turns, and all else.

    Sought from points (N, 3), or from a line with a bow (3,), m.
    """
    carrier, places = np.asarray(carrier, float), (np.arange(nodes) + 0.5)[:, None] / nodes
    state = straight_nodes(REST, carrier, attachments=ONE, nodes=nodes)
    positions, velocities = np.split(state, 2)
    positions = positions + (4 * places * (1 - places) * bow).ravel()

    def flown(positions):
        return moved(np.concatenate([positions, velocities]), carrier, wind, cable)

    begin = positions if start is None else np.ravel(start)
    found = least_squares(lambda p: flown(p).rates[3 * nodes :], begin, xtol=1e-12, ftol=1e-15)
    assert np.max(np.abs(found.fun)) * cable.mass / nodes < 1e-9
    return found.x.reshape(-1, 3), flown(found.x)


def elastic_catenary(level, low, s):
    """Points (..., 2) of a line by its arc s, with the tension (level, low), N, at s = 0."""
    w, stiff = SOFT.mass * GRAVITY / LENGTH, SOFT.stiffness * LENGTH
    up = low + w * s
    x = level * s / stiff + level / w * (np.arcsinh(up / level) - np.arcsinh(low / level))
    z = (low * s + w * s**2 / 2) / stiff + (np.hypot(level, up) - np.hypot(level, low)) / w
    return np.stack([x, z], axis=-1)


def test_a_hanging_line_is_a_catenary_with_an_error_of_second_order():
    level, low = 1.5, 0.4  # N; it weighs 1.1 N
    end = elastic_catenary(level, low, LENGTH)
    errors = []
    for nodes in (6, 12, 24):
        expected = elastic_catenary(level, low, (np.arange(nodes) + 0.5) * LENGTH / nodes)
        start = np.insert(expected, 1, 0.0, axis=1)
        places, found = settled([end[0], 0, end[1], 0, 0, 0], nodes, cable=SOFT, start=start)
        np.testing.assert_allclose(places[:, [0, 2]], expected, atol=12 / nodes**2)
        errors.append(np.linalg.norm(found.load_forces[0] - [level, 0, low]))
        top = found.carrier_forces[0] - found.load_forces[0]
        np.testing.assert_allclose(top, [0, 0, CABLE.mass * GRAVITY], atol=1e-6)  # all its weight
    assert errors[1] < 0.012
    np.testing.assert_allclose(np.log2(np.divide(errors[:-1], errors[1:])), 2.0, atol=0.1)


@pytest.mark.parametrize("diameter", [0.7e-3, 1e-3])
def test_a_taut_line_in_the_drag_of_a_turn_is_as_much_shorter_as_its_bow_asks_for(diameter):
    """ΔL = (9/14) L (ρ C_D d V² L/(24 T))², of small slopes, with one end that rests."""
    cable = CABLE._replace(diameter=diameter, gravity=0.0)
    speed, height = 15.3, 149.6
    errors = []
    for nodes in (6, 12):
        _, found = settled([0, 0, height, speed, 0, 0], nodes, cable=cable, bow=(-5, 0, 0))
        tension = np.mean(found.tensions)
        bow = AIR * cable.drag * diameter * speed**2 * LENGTH / (24 * tension)
        shorter = LENGTH * (1 + tension / (STIFFNESS * LENGTH)) - height
        errors.append(shorter / (9 / 14 * LENGTH * bow**2) - 1)
    assert abs(errors[0]) < 0.1
    assert abs(errors[1]) < 0.02


def test_a_towed_line_is_straight_at_the_angle_at_which_its_drag_across_bears_its_weight():
    """½ ρ C_D d U² sin² φ = (m g/L) cos φ, φ against the flow; no other angle is straight."""
    flow = 10.0
    weight, drag = CABLE.mass * GRAVITY / LENGTH, AIR / 2 * CABLE.drag * CABLE.diameter * flow**2
    cosine = -weight / (2 * drag) + np.sqrt((weight / (2 * drag)) ** 2 + 1)
    bows = []
    for angle in (np.arccos(cosine), np.arccos(cosine) + 0.02):
        way = np.array([-np.cos(angle), 0.0, np.sin(angle)])  # upstream, and up
        places, _ = settled([*(150.1 * way), 0, 0, 0], 8, wind=(flow, 0, 0))
        bows.append(np.max(np.linalg.norm(np.cross(places, way), axis=1)))
    assert bows[0] < 1e-6 < 1e-2 < bows[1]
    rubbing = CABLE._replace(friction=0.02)
    way = np.array([-cosine, 0.0, np.sqrt(1 - cosine**2)])
    rubbed = settled([*(150.1 * way), 0, 0, 0], 8, wind=(flow, 0, 0), cable=rubbing)[1]
    least, most = rubbed.tensions[[0, -1], 0]
    along = np.pi * 0.02 * AIR / 2 * CABLE.diameter * (flow * cosine) ** 2 * LENGTH
    assert most - least == pytest.approx(along + CABLE.mass * GRAVITY * way[2], rel=1e-3)


def plant_of(nodes, end, cable):
    """One cable in the air-free plant of Drake, with a small ball for each node."""
    plant = MultibodyPlant(0.0)
    plant.mutable_gravity_field().set_gravity_vector([0, 0, -GRAVITY])
    ball = SpatialInertia(cable.mass / nodes, np.zeros(3), UnitInertia.SolidSphere(0.01))
    bodies = [plant.AddRigidBody(f"node_{k}", ball) for k in range(nodes)]
    places = [(body, np.zeros(3)) for body in bodies]
    places = [(plant.world_body(), np.zeros(3)), *places, (plant.world_body(), end)]
    for share, ends in zip(segment_shares(nodes).ravel(), pairwise(places), strict=True):
        spring = cable.rest_length * share, cable.stiffness / share, cable.damping / share
        plant.AddForceElement(LinearSpringDamper(*chain(*ends), *spring))
    plant.Finalize()
    return plant


def test_accelerations_are_those_of_drakes_bodies_and_springs():
    rng = np.random.default_rng(3)
    cable = CABLE._replace(damping=0.02, drag=0.0)
    nodes, end = 5, np.array([4.0, 2.0, 151.0])
    plant = plant_of(nodes, end, cable)
    context = plant.CreateDefaultContext()
    carrier = np.concatenate([end, np.zeros(3)])
    for _ in range(5):
        state = straight_nodes(REST, carrier, attachments=ONE, nodes=nodes)
        state += rng.uniform(-1, 1, 6 * nodes) * np.repeat([0.03, 0.1], 3 * nodes)
        positions, velocities = nodes_of(state, 1)
        poses = [[1, 0, 0, 0, *position] for position in positions[:, 0]]
        twists = [[0, 0, 0, *velocity] for velocity in velocities[:, 0]]
        context.SetContinuousState([*chain(*poses), *chain(*twists)])
        rates = plant.EvalTimeDerivatives(context).CopyToVector()
        expected = rates[7 * nodes :].reshape(-1, 6)[:, 3:].ravel()
        found = moved(state, carrier, cable=cable, ratio=1e6)
        assert np.min(found.tensions) > 0
        np.testing.assert_allclose(found.rates[3 * nodes :], expected, rtol=1e-9, atol=1e-9)
