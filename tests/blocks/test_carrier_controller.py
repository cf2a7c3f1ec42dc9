"""The carrier controllers in closed form: plain, with feedforward, and tuned."""

import numpy as np
import pytest
from helpers import fix, model, output, outputs

from drake_nonstop.blocks.carrier_controller import (
    CarrierPid,
    CarrierPidConfig,
    FeedforwardCarrierPid,
    FeedforwardCarrierPidConfig,
    TunedFeedforwardCarrierPid,
)

GAINS = {"position_gain": 900.0, "velocity_gain": 7.0, "integral_gain": 11.0}


@pytest.mark.parametrize("n", [3, 6])
@pytest.mark.parametrize(
    ("kind", "config", "mass"),
    [(CarrierPid, CarrierPidConfig, 0), (FeedforwardCarrierPid, FeedforwardCarrierPidConfig, 0.3)],
)
def test_forces_are_those_of_the_errors_their_integral_and_the_acceleration(
    rng, n, kind, config, mass
):
    block = kind(model(n, carrier_mass=0.3), config(**GAINS))
    context = block.CreateDefaultContext()
    reference, state = rng.normal(size=(2, 6 * n))
    integral, acceleration = rng.normal(size=(2, 3 * n))
    fix(block, context, carrier_reference=reference, carrier_state=state)
    if mass:
        fix(block, context, carrier_reference_acceleration=acceleration)
    context.SetContinuousState(integral)
    position, velocity = np.split(reference - state, 2)
    expected = 900 * position + 7 * velocity + 11 * integral + mass * acceleration
    np.testing.assert_allclose(output(block, context, "carrier_forces"), expected, atol=1e-10)
    rates = block.EvalTimeDerivatives(context).CopyToVector()
    np.testing.assert_allclose(rates, position, rtol=0, atol=1e-15)


@pytest.mark.parametrize("n", [3, 4])
def test_default_tuned_gains_of_the_papers_carriers_are_those_of_the_pid(rng, n):
    inputs = {"carrier_reference": rng.normal(size=6 * n), "carrier_state": rng.normal(size=6 * n)}
    inputs["carrier_reference_acceleration"] = rng.normal(size=3 * n)
    plain = outputs(FeedforwardCarrierPid(model(n)), **inputs)["carrier_forces"]
    for mass, share in ((0.1, 1), (6.0, 60)):
        tuned = outputs(TunedFeedforwardCarrierPid(model(n, carrier_mass=mass)), **inputs)
        np.testing.assert_allclose(tuned["carrier_forces"], share * plain, rtol=1e-13)
