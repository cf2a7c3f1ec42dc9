import dataclasses
import math

import numpy as np
import pytest
from helpers import INERTIA, irregular, regular, spatial

from drake_nonstop.mechanics.grasp import grasp_matrix
from drake_nonstop.model.pattern import HamiltonianCycleConfig
from drake_nonstop.model.system import Model, SystemOverrides, SystemParameters, overridden
from drake_nonstop.validation import ScenarioError


def make(control_period=0.0, pattern=None, field="system", **fields):
    return Model(
        SystemParameters(**fields), pattern or HamiltonianCycleConfig(), control_period, field=field
    )


def test_default_system_is_the_papers():
    model = make()
    assert (model.n, model.m) == (4, 4)
    assert model.load_mass == model.load.mass == 1.0
    assert model.load.drag == 0.7
    assert model.cable_length == 0.8
    assert model.cable_stiffness == 500
    assert model.cable_damping == 0.1
    assert model.carrier_mass == 0.1
    assert model.gravity == 9.81
    np.testing.assert_array_equal(model.load.inertia, 0.01 * np.eye(3))
    np.testing.assert_array_equal(np.abs(model.attachments), [[0.75, 0.75, 0]] * 4)


@pytest.mark.parametrize("attachments", [regular(3), irregular(5), spatial(6)])
def test_constants_that_follow_from_the_system(attachments):
    model = make(attachments=attachments.tolist(), load_inertia=INERTIA.tolist())
    n = len(attachments)
    assert (model.n, model.m) == (n, n)
    grasp = grasp_matrix(attachments)
    np.testing.assert_allclose(grasp @ model.pseudo_inverse, np.eye(6), rtol=0, atol=1e-13)
    np.testing.assert_allclose(
        model.pseudo_inverse, grasp.T @ np.linalg.inv(grasp @ grasp.T), rtol=0, atol=1e-13
    )
    np.testing.assert_allclose(model.load.inertia_inverse @ INERTIA, np.eye(3), rtol=0, atol=1e-13)
    assert model.cable_compliance == 1 / 500


def test_infinite_stiffness_is_no_compliance():
    assert make(cable_stiffness=math.inf).cable_compliance == 0


POSITIVE = ["load_mass", "cable_length", "carrier_mass", "gravity"]
NON_NEGATIVE = ["load_drag", "cable_damping"]


@pytest.mark.parametrize("name", [*POSITIVE, *NON_NEGATIVE, "cable_stiffness"])
def test_bad_number_is_named(name):
    for value in (-1.0, math.nan, -math.inf, True, "1.0", None):
        with pytest.raises(ScenarioError) as error:
            make(**{name: value})
        assert str(error.value).startswith(f"system.{name} = {value}: give a")


@pytest.mark.parametrize("name", [*POSITIVE, "cable_stiffness"])
def test_zero_is_refused(name):
    with pytest.raises(ScenarioError, match=f"system.{name} = 0.0: give a"):
        make(**{name: 0.0})


@pytest.mark.parametrize("name", [*POSITIVE, *NON_NEGATIVE])
def test_infinity_is_refused(name):
    with pytest.raises(ScenarioError, match=f"system.{name} = inf: give a finite"):
        make(**{name: math.inf})


@pytest.mark.parametrize("name", NON_NEGATIVE)
def test_zero_is_allowed_where_nothing_divides_by_it(name):
    model = make(**{name: 0.0})
    assert {"load_drag": model.load.drag, "cable_damping": model.cable_damping}[name] == 0


@pytest.mark.parametrize("period", [-0.01, math.nan, math.inf])
def test_bad_control_period_is_named(period):
    with pytest.raises(ScenarioError, match=f"control_period = {period}: give"):
        make(control_period=period)


def test_errors_carry_the_name_of_the_system():
    with pytest.raises(ScenarioError, match=r"^simulated\.attachments = "):
        make(field="simulated", attachments=[[0.0, 0, 0]])


@pytest.mark.parametrize(
    ("attachments", "reason"),
    [
        ([], "give n x 3 finite numbers"),
        ([[1.0, 0, 0], [0, 1.0, 0]], "give 3 or more"),
        ([[1.0, 0], [0, 1.0], [1.0, 1.0]], "give n x 3 finite numbers"),
        ([[1.0, 0, 0], [0, 1.0, 0], [0, 0]], "give n x 3 finite numbers"),
        ([[1.0, 0, 0], [0, 1.0, 0], [0, math.nan, 0]], "give n x 3 finite numbers"),
        ([1.0, 2.0, 3.0], "give n x 3 finite numbers"),
        ("square", "give n x 3 finite numbers"),
        ([[1.0, 2, 3], [2.0, 4, 6], [-1.0, -2, -3]], "rank below 6"),
        ([[0.0, 0, 1], [1.0, 0, 1], [2.0, 0, 1], [5.0, 0, 1]], "rank below 6"),
        ([[0.0, 0, 0]] * 4, "rank below 6"),
        ([[1.0, 0, 0], [0, 1.0, 0], [-1.0, 0, 0], [-1.0, 0, 0]], "different attachment"),
    ],
)
def test_bad_attachments_are_refused(attachments, reason):
    with pytest.raises(ScenarioError, match=rf"system\.attachments = .*{reason}"):
        make(attachments=attachments)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_attachments_of_any_size_are_judged_alike(scale):
    model = make(attachments=(scale * regular(4)).tolist())
    np.testing.assert_allclose(
        grasp_matrix(model.attachments) @ model.pseudo_inverse, np.eye(6), rtol=0, atol=1e-9
    )
    with pytest.raises(ScenarioError, match="rank below 6"):
        make(attachments=[[k * scale, 0.0, 0.0] for k in (0, 1, 3)])


@pytest.mark.parametrize(
    "inertia",
    [
        [[0.01, 0, 0], [0, 0.01, 0], [0, 0, 0.03]],  # triangle inequality
        [[0.01, 0, 0], [0, -0.01, 0], [0, 0, 0.01]],
        [[0.0, 0, 0], [0, 0.01, 0], [0, 0, 0.01]],
        [[0.01, 0.001, 0], [0, 0.01, 0], [0, 0, 0.01]],  # not symmetric
        [[0.01, 0.02, 0], [0.02, 0.01, 0], [0, 0, 0.01]],  # indefinite
    ],
)
def test_inertia_of_no_body_is_refused(inertia):
    with pytest.raises(ScenarioError, match=r"system\.load_inertia = .*triangle inequality"):
        make(load_inertia=inertia)


@pytest.mark.parametrize(
    "inertia", [[[0.01, 0, 0]], [0.01, 0.01, 0.01], [[math.nan, 0, 0], [0, 1, 0], [0, 0, 1]], None]
)
def test_inertia_of_wrong_shape_or_values_is_refused(inertia):
    with pytest.raises(ScenarioError, match=r"system\.load_inertia = .*give 3 x 3 finite numbers"):
        make(load_inertia=inertia)


def test_inertia_of_a_thin_plate_is_accepted():
    np.testing.assert_array_equal(
        np.diag(make(load_inertia=[[0.1, 0, 0], [0, 0.2, 0], [0, 0, 0.3]]).load.inertia),
        [0.1, 0.2, 0.3],
    )


def test_overrides_replace_single_fields():
    system = SystemParameters(load_mass=2.0, load_drag=0.3)
    result = overridden(system, SystemOverrides(load_drag=0.0, gravity=1.62))
    assert result == dataclasses.replace(system, load_drag=0.0, gravity=1.62)
    assert overridden(system, SystemOverrides()) == system
    assert {f.name for f in dataclasses.fields(SystemOverrides)} == {
        f.name for f in dataclasses.fields(SystemParameters)
    }
