"""The internal-force trajectory."""

import numpy as np
import pytest
from helpers import model, outputs

from drake_nonstop.blocks.internal_force import PlannedInternalForce


@pytest.mark.parametrize("n", [3, 4, 6])
def test_internal_forces_of_constant_parameters_in_closed_form(n):
    found = outputs(PlannedInternalForce(model(n)), planned=np.array([0.4, 1.7, 0.9, *[0] * 5]))
    angles = 0.4 + 2 * np.pi * np.arange(n) / n
    first = np.concatenate([0.9 * np.cos(angles), -0.9 * 1.7 * np.sin(angles)])
    higher = np.concatenate([-0.9 * 1.7**2 * np.cos(angles), 0.9 * 1.7**3 * np.sin(angles)])
    np.testing.assert_allclose(found["internal_force"], first, rtol=0, atol=1e-14)
    np.testing.assert_allclose(found["internal_force_higher_rates"], higher, rtol=0, atol=1e-13)
