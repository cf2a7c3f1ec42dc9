"""Carriers with a limit, a lag, weight and cable, in closed form."""

import numpy as np
import pytest
from helpers import fix, model
from pydrake.autodiffutils import ExtractGradient, InitializeAutoDiff

from drake_nonstop.blocks.carrier_dynamics import LimitedCarriers, LimitedCarriersConfig

LOADED = {"has_weight": True, "feels_cable": True}


@pytest.mark.parametrize("n", [3, 6])
@pytest.mark.parametrize("options", [{}, {"has_weight": True}, {"feels_cable": True}, LOADED])
def test_limited_carriers_feel_weight_cable_and_their_limit(rng, n, options):
    config = LimitedCarriersConfig(max_acceleration=9.0, lag=0.1, **options)
    block = LimitedCarriers(model(n, carrier_mass=0.25), config)
    state, cables = rng.normal(size=(3, n, 3)), rng.normal(size=3 * n)
    context = block.CreateDefaultContext()
    context.SetContinuousState(state.ravel())
    fix(block, context, carrier_forces=np.arange(3.0 * n))
    if config.feels_cable:
        fix(block, context, carrier_cable_forces=cables)
    moved, pulled, own = block.EvalTimeDerivatives(context).CopyToVector().reshape(3, n, 3)
    np.testing.assert_array_equal(moved, state[1])
    felt = np.array([0, 0, -9.81]) * config.has_weight
    felt = felt - config.feels_cable * cables.reshape(n, 3) / 0.25
    np.testing.assert_allclose(pulled - state[2], felt, atol=1e-12)
    commands = np.arange(3.0 * n).reshape(n, 3) / 0.25
    sizes = np.linalg.norm(commands, axis=1, keepdims=True)
    assert sizes.min() < 9 < sizes.max()
    limited = commands * np.minimum(1, 9 / sizes)
    np.testing.assert_allclose(own, (limited - state[2]) / 0.1, atol=1e-9)


def test_a_limited_carrier_without_a_command_has_derivatives():
    block = LimitedCarriers(model())
    converted = block.ToAutoDiffXd()
    context = converted.CreateDefaultContext()
    fix(converted, context, carrier_forces=InitializeAutoDiff(np.zeros(12)).ravel())
    slopes = ExtractGradient(converted.EvalTimeDerivatives(context).CopyToVector())[24:]
    expected = np.eye(12) / (model().carrier_mass * block.config.lag)
    np.testing.assert_allclose(slopes, expected, atol=1e-9)
