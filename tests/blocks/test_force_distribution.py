"""The force distribution is the mechanics'."""

import numpy as np
import pytest
from helpers import fix, model, output

from drake_nonstop.blocks.force_distribution import CableForceDistribution

counts = pytest.mark.parametrize("n", [3, 4, 6])


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
