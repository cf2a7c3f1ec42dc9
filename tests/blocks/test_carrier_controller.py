"""The carrier controllers: plain, with feedforward, and tuned."""

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

counts = pytest.mark.parametrize("n", [3, 4, 6])


@counts
def test_carrier_pid_in_closed_form(rng, n):
    gains = {"position_gain": 900.0, "velocity_gain": 7.0, "integral_gain": 11.0}
    block = CarrierPid(model(n), CarrierPidConfig(**gains))
    context = block.CreateDefaultContext()
    reference, state = rng.normal(size=(2, 6 * n))
    integral = rng.normal(size=3 * n)
    fix(block, context, carrier_reference=reference, carrier_state=state)
    context.SetContinuousState(integral)
    error = reference - state
    expected = 900 * error[: 3 * n] + 7 * error[3 * n :] + 11 * integral
    np.testing.assert_allclose(
        output(block, context, "carrier_forces"), expected, rtol=1e-12, atol=1e-10
    )
    np.testing.assert_allclose(
        block.EvalTimeDerivatives(context).CopyToVector(), error[: 3 * n], rtol=0, atol=1e-15
    )


@pytest.mark.parametrize("n", [3, 4])
def test_default_tuned_gains_of_the_papers_carriers_are_those_of_the_pid(rng, n):
    inputs = {"carrier_reference": rng.normal(size=6 * n), "carrier_state": rng.normal(size=6 * n)}
    inputs["carrier_reference_acceleration"] = rng.normal(size=3 * n)
    plain = outputs(FeedforwardCarrierPid(model(n)), **inputs)["carrier_forces"]
    for mass, share in ((0.1, 1), (6.0, 60)):
        tuned = outputs(TunedFeedforwardCarrierPid(model(n, carrier_mass=mass)), **inputs)
        np.testing.assert_allclose(tuned["carrier_forces"], share * plain, rtol=1e-13)


@pytest.mark.parametrize("integral_gain", [0.0, 3.0])
def test_feedforward_adds_the_mass_times_the_acceleration_of_the_reference(rng, integral_gain):
    body = model(4, carrier_mass=0.3)
    acceleration = rng.normal(size=12)
    inputs = {"carrier_reference": rng.normal(size=24), "carrier_state": rng.normal(size=24)}
    plain = outputs(CarrierPid(body, CarrierPidConfig(integral_gain=integral_gain)), **inputs)
    config = FeedforwardCarrierPidConfig(integral_gain=integral_gain)
    block = FeedforwardCarrierPid(body, config)
    forces = outputs(block, **inputs, carrier_reference_acceleration=acceleration)
    expected = plain["carrier_forces"] + 0.3 * acceleration
    np.testing.assert_allclose(forces["carrier_forces"], expected, rtol=1e-12, atol=1e-11)
