"""The force distributions: the mechanics', and with tensions within bounds."""

import math

import numpy as np
import pytest
from helpers import Motion, difference, fix, model, output
from scipy.optimize import minimize

from drake_nonstop.blocks.force_distribution import (
    BoundedTensionDistribution,
    BoundedTensionDistributionConfig,
    CableForceDistribution,
)
from drake_nonstop.mechanics.grasp import cable_forces_and_rates, grasp_matrix
from drake_nonstop.mechanics.rotation import rotation_matrix
from drake_nonstop.validation import ScenarioError

counts = pytest.mark.parametrize("n", [3, 4, 6])


@counts
def test_force_distribution_of_the_mechanics(rng, n):
    constants = model(n)
    block = CableForceDistribution(constants)
    context = block.CreateDefaultContext()
    inputs = {
        "measured_load_state": Motion(70).state(0.2),
        "wrench": rng.normal(size=6),
        "wrench_rate": rng.normal(size=6),
        "internal_force": rng.normal(size=2 * n),
    }
    fix(block, context, **inputs)
    forces, rates = cable_forces_and_rates(
        *inputs.values(),
        pseudo_inverse=constants.pseudo_inverse,
        basis=constants.pattern.basis,
        offset=constants.pattern.offset,
    )
    for name, expected in (
        ("desired_cable_forces", forces),
        ("desired_cable_force_rates", rates),
    ):
        np.testing.assert_allclose(
            output(block, context, name), expected.ravel(), rtol=0, atol=1e-13
        )


@counts
def test_level_load_at_rest_hangs_on_equal_vertical_forces(n):
    block = CableForceDistribution(model(n))
    context = block.CreateDefaultContext()
    fix(
        block,
        context,
        measured_load_state=np.array([1.0, *np.zeros(12)]),
        wrench=np.array([0, 0, 0, 0, 0, 9.81]),
        wrench_rate=np.zeros(6),
        internal_force=np.zeros(2 * n),
    )
    np.testing.assert_allclose(
        output(block, context, "desired_cable_forces"), [0, 0, 9.81 / n] * n, rtol=0, atol=1e-14
    )
    np.testing.assert_array_equal(output(block, context, "desired_cable_force_rates"), 0)


def bounded(n=4, **bounds):
    return BoundedTensionDistribution(model(n), BoundedTensionDistributionConfig(**bounds))


MOTION = Motion(5)


def inputs(time, n=4):
    """A smooth motion of the load, the wrench and the internal forces, with exact rates."""
    angles = 2 * time + 2 * np.pi * np.arange(n) / n
    swing = 1.3
    return {
        "measured_load_state": MOTION.state(time),
        "wrench": np.array([0, 0, 0, 0, 0, 9.81]) + 0.3 * np.sin(time + np.arange(6)),
        "wrench_rate": 0.3 * np.cos(time + np.arange(6)),
        "internal_force": swing * np.concatenate([np.cos(angles), -2 * np.sin(angles)]),
    }


def distributed(block, time, n=4):
    context = block.CreateDefaultContext()
    fix(block, context, **inputs(time, n))
    return [
        output(block, context, name)
        for name in ("desired_cable_forces", "desired_cable_force_rates")
    ]


def test_wide_bounds_change_nothing():
    plain = distributed(CableForceDistribution(model()), 0.3)
    np.testing.assert_array_equal(distributed(bounded(min_tension=0.1), 0.3), plain)


def test_rates_of_cables_that_hardly_differ_are_those_of_cables_alike():
    """Four cables on a bound, whose tensions three coordinates of the null space decide."""
    found = []
    for tilt in (0.0, 5e-7):  # rad
        block = bounded(min_tension=2.9)
        context = block.CreateDefaultContext()
        fix(
            block,
            context,
            measured_load_state=np.array([1.0, tilt / 2, *np.zeros(11)]),
            wrench=np.array([0, 0, 0, 0, 0, 9.81]),
            wrench_rate=np.array([0, 0, 0, 0.06, 0.06, 0.06]),
            internal_force=np.array([1.2, 0, 1.2, 0, 0, -2.4, 0, -2.4]),
        )
        names = "desired_cable_forces", "desired_cable_force_rates"
        found.append([output(block, context, name) for name in names])
    np.testing.assert_allclose(found[1], found[0], rtol=0, atol=1e-5)


def tensions(forces):
    return np.linalg.norm(forces.reshape(-1, 3), axis=1)


def wrench_of(forces, time, n=4):
    R_WL = rotation_matrix(MOTION.state(time)[:4])
    in_L = grasp_matrix(model(n).attachments) @ (forces.reshape(-1, 3) @ R_WL).ravel()
    return np.concatenate([R_WL @ in_L[:3], R_WL @ in_L[3:]])


@pytest.mark.parametrize("n", [3, 4, 6])
@pytest.mark.parametrize("time", [0.3, 1.1])
def test_bounds_are_kept_and_so_is_the_wrench(n, time):
    (plain, _) = distributed(CableForceDistribution(model(n)), time, n)
    low, high = np.quantile(tensions(plain), [0.4, 0.95])
    forces, _ = distributed(bounded(n, min_tension=low, max_tension=math.inf), time, n)
    assert tensions(plain).min() < low - 0.01
    assert tensions(forces).min() >= low - 1e-9
    np.testing.assert_allclose(wrench_of(forces, time, n), inputs(time, n)["wrench"], atol=1e-12)
    forces, _ = distributed(bounded(n, min_tension=0.01, max_tension=high), time, n)
    directions = plain.reshape(-1, 3) / tensions(plain)[:, None]
    assert np.max((directions * forces.reshape(-1, 3)).sum(axis=1)) <= high + 1e-9


def test_the_change_is_the_least_that_will_do():
    time = 0.3
    plain, _ = distributed(CableForceDistribution(model()), time)
    low = float(np.quantile(tensions(plain), 0.4))
    forces, _ = distributed(bounded(min_tension=low), time)
    directions = plain.reshape(-1, 3) / tensions(plain)[:, None]
    found = minimize(
        lambda change: change @ change,
        np.zeros(12),
        jac=lambda change: 2 * change,
        method="SLSQP",
        tol=1e-14,
        constraints=(
            {"type": "eq", "fun": lambda change: wrench_of(change, time)},
            {
                "type": "ineq",
                "fun": lambda change: (
                    (directions * (plain + change).reshape(4, 3)).sum(axis=1) - low
                ),
            },
        ),
    )
    assert found.success
    np.testing.assert_allclose(forces - plain, found.x, atol=1e-6)


@pytest.mark.parametrize("bounds", [{"min_tension": 2.7}, {"min_tension": 0.5, "max_tension": 2.9}])
def test_rates_are_those_of_the_forces(bounds):
    block = bounded(**bounds)
    changed = 0
    for time in np.arange(0.1, 3.0, 0.31):
        forces, rates = distributed(block, time)
        plain, _ = distributed(CableForceDistribution(model()), time)
        changed += np.abs(forces - plain).max() > 1e-3
        numeric = difference(lambda t: distributed(block, t)[0], time)
        np.testing.assert_allclose(rates, numeric, atol=1e-8)
    assert changed >= 3


def test_no_forces_within_the_bounds_is_an_error():
    with pytest.raises(RuntimeError, match=r"no cable forces with tensions from 0 to 1 N"):
        distributed(bounded(min_tension=0.0, max_tension=1.0), 0.3)


@pytest.mark.parametrize(
    ("bounds", "message"),
    [
        ({"min_tension": -1.0}, r"force_distribution\.min_tension = -1\.0: give"),
        ({"min_tension": 2.0, "max_tension": 1.0}, r"max_tension = 1\.0: give more than .* 2 N"),
        ({"max_tension": math.nan}, r"max_tension = nan: give more than"),
    ],
)
def test_bounds_that_make_no_sense(bounds, message):
    with pytest.raises(ScenarioError, match=message):
        bounded(**bounds)
