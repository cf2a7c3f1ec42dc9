"""Lines that bow, against straight ones and the plant's nodes, which have closed forms."""

import numpy as np
import pytest

from drake_nonstop.mechanics import bowed_line
from drake_nonstop.mechanics.bowed_line import TimeWindow, bowed_lines, lines_between
from drake_nonstop.mechanics.carrier import carrier_motion
from drake_nonstop.mechanics.lumped_cable import CableMaterial, lumped_cables
from drake_nonstop.mechanics.signals import LOAD_REFERENCE_SIZE

CABLE = CableMaterial(150.0, 120.0, 0.0, 1e-3, 970.0, 1.1, 0.02, 1.225, 9.81)
WINDOW = TimeWindow.of(0.75, 9)
STILL = np.zeros(3)
SQUARE = np.array([[1.5, 0.0, 0.0], [0.0, 1.5, 0.0], [-1.5, 0.0, 0.0], [0.0, -1.5, 0.0]])


def turned(vectors, rate):
    """Vectors (n, 3) that turn about the vertical, at the instants of the window: (k, n, 3)."""
    cosine, sine = np.cos(rate * WINDOW.times), np.sin(rate * WINDOW.times)
    x, y = vectors[:, 0], vectors[:, 1]
    level = [np.outer(cosine, x) - np.outer(sine, y), np.outer(sine, x) + np.outer(cosine, y)]
    return np.stack([*level, np.broadcast_to(vectors[:, 2], level[0].shape)], axis=-1)


def test_lines_without_mass_and_drag_are_straight_as_in_eq_1():
    forces, rates, second, third = np.random.default_rng(1).normal(size=(4, 4, 3))
    forces = 10 * forces + [0, 0, 40]
    t = WINDOW.times[:, None, None]
    over_window = forces + t * rates + t**2 / 2 * second + t**3 / 6 * third
    reference = np.eye(LOAD_REFERENCE_SIZE)[0]
    kept = np.broadcast_to(SQUARE, over_window.shape)
    for nodes in (1, 5):
        lines = bowed_lines(
            over_window, kept, STILL, WINDOW, cable=CABLE._replace(diameter=0.0), nodes=nodes
        )
        cables = {"attachments": SQUARE, "rest_length": 150.0, "compliance": 1 / 120.0}
        expected = carrier_motion(reference, forces, rates, second, third, **cables)
        for made, known, allowed in zip(
            WINDOW.at_present(lines.ends), expected, (1e-12, 1e-6, 1e-5, 1e-3), strict=True
        ):
            assert made == pytest.approx(known, abs=allowed)
        assert np.array_equal(lines.forces, over_window)


def test_lines_that_turn_with_their_load_are_in_equilibrium_as_nodes_of_the_plant(monkeypatch):
    monkeypatch.setattr(bowed_line, "_PASSES", 12)
    rate, wind = 0.5, np.array([0.0, 0.0, 1.0])
    forces = turned(np.column_stack([5 * SQUARE[:, :2], np.full(4, 24.5)]), rate)
    gusts = np.outer([0.0, 0.5, -0.5, 2.0], [0.0, 0.0, 1.0])
    lines = bowed_lines(
        forces, turned(SQUARE, rate), wind, WINDOW, cable=CABLE, nodes=6, gusts=gusts
    )
    ends, end_rates, *_ = WINDOW.at_present(lines.ends)
    moving = [WINDOW.at_present(node) for node in lines.nodes]
    places, velocities, accelerations = (np.stack([m[i] for m in moving]) for i in range(3))
    load_state = np.eye(13)[0]
    load_state[9] = rate
    plant = lumped_cables(
        np.concatenate([places.ravel(), velocities.ravel()]),
        load_state,
        np.concatenate([ends.ravel(), end_rates.ravel()]),
        (wind + gusts).ravel(),
        wind,
        attachments=SQUARE,
        cable=CABLE,
        max_damping_ratio=0.0,
    )
    made = plant.rates[places.size :].reshape(places.shape)
    assert accelerations == pytest.approx(-(rate**2) * places * [1, 1, 0], abs=1e-4)
    assert made == pytest.approx(accelerations, abs=1e-4)
    assert plant.load_forces == pytest.approx(WINDOW.at_present(forces)[0], abs=1e-6)
    assert plant.carrier_forces == pytest.approx(WINDOW.at_present(lines.forces)[0], abs=1e-6)


def test_lines_between_given_ends_are_those_that_end_there_and_pull_so():
    forces = turned(np.column_stack([5 * SQUARE[:, :2], np.full(4, 24.5)]), 0.5)
    attachments, wind = turned(SQUARE, 0.5), np.array([1.0, 0.0, 0.5])
    of_all = {"cable": CABLE, "nodes": 3, "gusts": np.outer([0.0, 0.5, -0.5, 2.0], [0, 1.0, 1.0])}
    lines = bowed_lines(forces, attachments, wind, WINDOW, **of_all)
    ends = np.stack(WINDOW.at_present(lines.ends)[:2])
    off = np.array([0.3, -0.2, 0.5]) + WINDOW.times[:, None, None] * np.array([0.1, 0.2, -0.1])
    expected = [*zip(*(WINDOW.at_present(node)[:2] for node in lines.nodes), strict=True)]
    for guess in (forces + off, forces + np.array([0, 0, 8])):
        found = lines_between(guess, attachments, ends, wind, WINDOW, **of_all)
        for nodes, known in zip(found, expected, strict=True):
            np.testing.assert_allclose(nodes, known, atol=1e-7)
    assert lines_between(forces, attachments, np.inf * ends, wind, WINDOW, **of_all) is None
