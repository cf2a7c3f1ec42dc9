"""The force distribution is the mechanics'."""

import numpy as np
import pytest
from helpers import Motion, fix, model, output

from drake_nonstop.blocks.force_distribution import CableForceDistribution
from drake_nonstop.mechanics.grasp import cable_forces_and_rates

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
