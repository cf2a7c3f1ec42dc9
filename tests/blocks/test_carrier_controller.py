"""The carrier controllers: plain, tuned, with feedforward and with weight."""

import numpy as np
import pytest
from helpers import fix, model, output, outputs

from drake_nonstop.blocks import carrier_controller
from drake_nonstop.blocks.carrier_controller import (
    CarrierPid,
    CarrierPidConfig,
    FeedforwardCarrierPid,
    FeedforwardCarrierPidConfig,
    LoadedCarrierPid,
    TunedCarrierPid,
    TunedCarrierPidConfig,
    TunedFeedforwardCarrierPid,
    TunedFeedforwardCarrierPidConfig,
)
from drake_nonstop.validation import ScenarioError

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


def test_carrier_pid_without_integral_gain_has_no_state(rng):
    block = CarrierPid(model())
    context = block.CreateDefaultContext()
    assert context.num_continuous_states() == 0
    reference, state = rng.normal(size=(2, 24))
    fix(block, context, carrier_reference=reference, carrier_state=state)
    error = reference - state
    np.testing.assert_allclose(
        output(block, context, "carrier_forces"), 1000 * error[:12] + 10 * error[12:], rtol=1e-12
    )
    assert block.EvalTimeDerivatives(context).size() == 0


@pytest.mark.parametrize("gain", ["position_gain", "velocity_gain", "integral_gain"])
@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf, False, None])
def test_bad_gain_of_the_carrier_controller_is_named(gain, value):
    with pytest.raises(ScenarioError, match=f"carrier_controller.{gain} = {value}: give"):
        CarrierPid(model(), CarrierPidConfig(**{gain: value}))


@pytest.mark.parametrize(
    ("make", "config", "message"),
    [
        (CarrierPid, CarrierPidConfig(integral_gain=-1.0), r"integral_gain = -1\.0"),
        (TunedCarrierPid, TunedCarrierPidConfig(frequency=0.0), r"frequency = 0\.0"),
        (
            TunedFeedforwardCarrierPid,
            TunedFeedforwardCarrierPidConfig(damping=-0.1),
            r"damping = -0\.1",
        ),
        (
            FeedforwardCarrierPid,
            FeedforwardCarrierPidConfig(position_gain=np.inf),
            "position_gain = inf",
        ),
    ],
)
def test_parameters_out_of_range_are_named(make, config, message):
    with pytest.raises(ScenarioError, match=message):
        make(model(), config)


@pytest.mark.parametrize("n", [3, 4])
def test_default_tuned_gains_of_the_papers_carriers_are_those_of_the_pid(rng, n):
    inputs = {"carrier_reference": rng.normal(size=6 * n), "carrier_state": rng.normal(size=6 * n)}
    tuned = outputs(TunedCarrierPid(model(n)), **inputs)["carrier_forces"]
    plain = outputs(CarrierPid(model(n)), **inputs)["carrier_forces"]
    np.testing.assert_allclose(tuned, plain, rtol=1e-13)
    heavy = outputs(TunedCarrierPid(model(n, carrier_mass=6.0)), **inputs)["carrier_forces"]
    np.testing.assert_allclose(heavy, 60 * plain, rtol=1e-13)


@pytest.mark.parametrize("integral_gain", [0.0, 3.0])
@pytest.mark.parametrize(
    ("make", "config", "without"),
    [
        (FeedforwardCarrierPid, FeedforwardCarrierPidConfig(), CarrierPid),
        (TunedFeedforwardCarrierPid, TunedFeedforwardCarrierPidConfig(), TunedCarrierPid),
    ],
)
def test_feedforward_adds_the_mass_times_the_acceleration_of_the_reference(
    rng, make, config, without, integral_gain
):
    body = model(4, carrier_mass=0.3)
    fields = vars(config)
    if "integral_gain" in fields:
        fields["integral_gain"] = integral_gain
    plain = getattr(carrier_controller, f"{without.__name__}Config")(**fields)
    acceleration = rng.normal(size=12)
    inputs = {"carrier_reference": rng.normal(size=24), "carrier_state": rng.normal(size=24)}
    expected = outputs(without(body, plain), **inputs)["carrier_forces"] + 0.3 * acceleration
    forces = outputs(make(body, config), **inputs, carrier_reference_acceleration=acceleration)
    np.testing.assert_allclose(forces["carrier_forces"], expected, rtol=1e-12, atol=1e-11)


def test_controller_of_loaded_carriers_carries_weight_and_cable():
    block = LoadedCarrierPid(model())
    context = block.CreateDefaultContext()
    still = np.arange(24.0)
    pull = np.linspace(-1, 1, 12)
    fix(block, context, carrier_reference=still, carrier_state=still, desired_cable_forces=pull)
    weight = [0, 0, model().carrier_mass * model().gravity]
    np.testing.assert_allclose(
        output(block, context, "carrier_forces").reshape(4, 3), pull.reshape(4, 3) + weight
    )
