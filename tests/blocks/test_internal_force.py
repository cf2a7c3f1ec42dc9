"""The internal-force trajectories."""

import numpy as np
import pytest
from helpers import fix, model, output, outputs

from drake_nonstop.blocks.internal_force import InternalForceTrajectory, PlannedInternalForce

PARAMETERS = np.array([1.7, 0.9])


counts = pytest.mark.parametrize("n", [3, 4, 6])


@counts
def test_internal_forces_in_closed_form(n):
    block = InternalForceTrajectory(model(n))
    context = block.CreateDefaultContext()
    fix(block, context, parameters=PARAMETERS, phase=np.array([0.4, 5.0]))
    angles = 0.4 + 2 * np.pi * np.arange(n) / n
    expected = np.concatenate([0.9 * np.cos(angles), -0.9 * 1.7 * np.sin(angles)])
    np.testing.assert_allclose(
        output(block, context, "internal_force"), expected, rtol=0, atol=1e-14
    )


@counts
def test_a_plan_without_rates_is_the_trajectory_of_constant_parameters(n):
    of_plan = outputs(
        PlannedInternalForce(model(n)), planned=np.array([0.4, *PARAMETERS, *[0] * 5])
    )
    constant = outputs(
        InternalForceTrajectory(model(n)), parameters=PARAMETERS, phase=np.array([0.4, 5.0])
    )
    angles = 0.4 + 2 * np.pi * np.arange(n) / n
    higher = np.concatenate([-0.9 * 1.7**2 * np.cos(angles), 0.9 * 1.7**3 * np.sin(angles)])
    for found in (of_plan, constant):
        np.testing.assert_allclose(found["internal_force_higher_rates"], higher, rtol=0, atol=1e-13)
    np.testing.assert_allclose(of_plan["internal_force"], constant["internal_force"], atol=1e-14)
