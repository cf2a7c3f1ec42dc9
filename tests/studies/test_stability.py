"""The numbers of the Floquet analysis."""

import numpy as np
import pytest
from helpers import nightly_beyond

from drake_nonstop import LeafBlock, load_scenario
from drake_nonstop.studies import stability

WEAK = ["carrier_controller.velocity_gain=0.05"]
FINE = ["simulator_config.max_step_size=0.0004"]  # 25 steps in a sample
HEAVY = ["simulated.load_mass=1.1"]
CASES = [
    ("quintic", HEAVY, True, 3),
    ("three_carriers", FINE, True, 3),
    ("three_carriers", [], True, 15),
    ("three_carriers", WEAK, None, 15),
    ("quintic", HEAVY, True, 15),
]


@pytest.mark.parametrize(
    ("name", "overrides", "is_stable", "phases"), nightly_beyond(1, "studies", CASES)
)
def test_exact_maps_are_those_of_differences(name, overrides, is_stable, phases, monkeypatch):
    """Also at few phases, where both have the same error of interpolation."""
    scenario = load_scenario(name, overrides)
    assert is_stable in (None, stability.linearize(scenario).is_stable)
    monkeypatch.setattr(stability, "_PHASES", phases)
    exact = stability.linearize(scenario)
    monkeypatch.setattr(stability, "reason_against", lambda *_, **__: "it is not to be compiled")
    differenced = stability.linearize(scenario)
    assert exact.is_stable == differenced.is_stable
    assert exact.rate == pytest.approx(differenced.rate, rel=1e-6, abs=1e-7)
    ours, others = (np.abs(found.multipliers) for found in (exact, differenced))
    np.testing.assert_allclose(ours, others, rtol=1e-5, atol=1e-6)
    for name, share in differenced.shares.items():
        assert exact.shares[name] == pytest.approx(share, abs=1e-4)


def test_maps_are_exact_however_many_steps_a_sample_has(monkeypatch):
    monkeypatch.setattr(stability, "_differenced_map", None)
    monkeypatch.setattr(stability, "_PHASES", 1)
    assert stability.linearize(load_scenario("three_carriers", FINE)).period > 0


def test_the_height_of_aircraft_decays_as_its_correction_says():
    """A load that follows its carriers, whose references move slowly: exp(-0.03 T)."""
    found = stability.linearize(load_scenario("aircraft_rest"))
    assert found.largest < 0.95
    is_real = np.abs(found.multipliers.imag) < 1e-6
    (height,) = (m.real for m in found.multipliers[is_real] if 0.6 < m.real < 0.8)
    assert height == pytest.approx(np.exp(-0.03 * found.period), rel=3e-3)


class LateFeedback(LeafBlock):
    """The load's state of a sample before, by an update that no trace knows."""

    is_sampled = True

    def __init__(self, model):
        super().__init__()
        self.read = self.DeclareVectorInputPort("load_state", 13)
        state = self.DeclareDiscreteState(np.eye(13)[0])
        self.DeclareStateOutputPort("measured_load_state", state)
        self.DeclareInitializationDiscreteUpdateEvent(self.sample)
        self.DeclarePeriodicDiscreteUpdateEvent(0.01, 0.01, self.sample)

    def sample(self, context, discrete_state):
        discrete_state.set_value(self.read.Eval(context))


@pytest.mark.nightly("studies")
def test_a_loop_with_a_block_that_is_not_traced_is_differenced(monkeypatch):
    monkeypatch.setattr(stability, "_PHASES", 7)
    scenario = load_scenario("three_carriers")
    made = stability.make_nonstop
    monkeypatch.setattr(
        stability,
        "make_nonstop",
        lambda scenario, **options: made(scenario, load_feedback=LateFeedback, **options),
    )
    found = stability.linearize(scenario)
    assert found.is_stable
    assert found.shares["load_feedback"] >= 0
