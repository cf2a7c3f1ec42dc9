"""Carriers that measure their tension: the load and the cables that they find."""

import numpy as np
import pytest
from helpers import spatial
from scipy.spatial.transform import Rotation

from drake_nonstop import load_scenario, make_nonstop, set_equilibrium
from drake_nonstop.mechanics import load_share
from drake_nonstop.mechanics.grasp import grasp_matrix

MASS, CENTRE = 1.1, np.array([0.03, -0.02, 0.0])  # of the model's mass; m, in L


def test_tensions_tell_the_mass_and_the_centre_of_mass(rng):
    """Of a turned load, whose cables carry it with their forces and no internal force is left."""
    attachments = spatial(4) - spatial(4).mean(axis=0)
    grasp = grasp_matrix(attachments)
    known = {"attachments": attachments, "pseudo_inverse": np.linalg.pinv(grasp)}
    axes = Rotation.from_rotvec([0.02, -0.01, 0.8]).as_matrix().T
    wrench = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 98.1])
    spread = np.column_stack([attachments[:, :2], np.zeros(4)]) * 8
    spread -= (known["pseudo_inverse"] @ grasp @ spread.ravel()).reshape(4, 3)
    forces = ((known["pseudo_inverse"] @ wrench).reshape(4, 3) + spread) @ axes
    level, weights = attachments[:, :2], known["pseudo_inverse"][2::3, 5:]
    slopes = np.linalg.solve(level.T @ (weights * level), MASS * CENTRE[:2])
    share = np.append(MASS - 1, slopes)

    carried = load_share.shared_forces(forces, axes, share, **known)

    torque = np.cross(attachments - CENTRE, carried @ axes.T).sum(axis=0)
    np.testing.assert_allclose(torque, 0.0, atol=1e-12)
    np.testing.assert_allclose(carried.sum(axis=0), MASS * forces.sum(axis=0), atol=1e-12)
    tensions, found = np.linalg.norm(carried, axis=1), np.zeros(3)
    for _ in range(300):
        believed = load_share.shared_forces(forces, axes, found, **known)
        found += 0.1 * load_share.observed_share(tensions, believed, forces, attachments)
    mass, centre = load_share.share_of_mass(found, known["pseudo_inverse"], attachments)
    np.testing.assert_allclose(mass, MASS, rtol=1e-6)
    np.testing.assert_allclose(centre, CENTRE, atol=1e-6)


def test_bows_that_change_along_an_orbit_tell_the_drag_from_lengths():
    longer, log_drag, lengths = np.array([0.3, -0.2, 0.1, 0.0]), np.log(1.3), np.full(4, 150.0)
    found, found_drag = np.zeros(4), np.zeros(1)
    for time in np.arange(0.0, 800.0, 0.1):
        bow = 0.6 + 0.3 * np.sin(0.6 * time + np.arange(4) * np.pi / 2)  # with the model's drag
        believed = np.exp(2 * found_drag) * bow
        seems = longer - found - (np.exp(2 * log_drag) * bow - believed)
        found += 0.1 * 0.2 * seems
        found_drag += 0.1 * 0.3 * load_share.observed_drag(seems, believed, lengths)
    np.testing.assert_allclose([*found, *found_drag], [*longer, log_drag], atol=1e-3)
    little = load_share.observed_drag(longer, np.full(4, 0.015), lengths)  # a bow that tells little
    np.testing.assert_allclose(little, [-0.2 * 0.015 / (8 * 0.015**2 + 4 * 0.15**2)], rtol=1e-12)


@pytest.mark.slow
def test_a_run_starts_with_what_tensions_tell_and_the_load_on_its_reference():
    attachments = [[1.41, 0, 0], [-0.09, 1.5, 0], [-1.59, 0, 0], [-0.09, -1.5, 0]]
    errors = {"load_mass": 11, "cable_length": 151.5, "attachments": attachments}
    overrides = [f"simulated.{name}={value}" for name, value in errors.items()]
    scenario = load_scenario("aircraft_rest_cables", overrides)
    diagram = make_nonstop(scenario, at_equilibrium=False)
    context = diagram.CreateDefaultContext()
    set_equilibrium(diagram, context)
    names = ("load_mass_estimate", "cable_length_estimate", "centre_of_mass_estimate", "load_state")
    mass, lengths, centre, load = (diagram.GetOutputPort(name).Eval(context) for name in names)
    np.testing.assert_allclose(mass, [11.0], atol=0.05)
    np.testing.assert_allclose(lengths, [151.5] * 4, atol=0.05)
    np.testing.assert_allclose(centre, [0.09, 0.0, 0.0], atol=0.01)
    np.testing.assert_allclose(load, np.eye(13)[0], atol=1e-9)
