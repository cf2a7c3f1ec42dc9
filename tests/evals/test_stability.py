"""Predicted and simulated stability, on both sides of the boundary."""

import numpy as np
import pytest
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator

from drake_nonstop.analysis.stability import at_rest, linearize
from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.loop.start import PlantStates, set_equilibrium
from drake_nonstop.loop.step import with_largest_step
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.scenario.overrides import changed
from drake_nonstop.systems.tracing import NotFiniteError


def growth_per_turn(resting, turns):
    """By what factor a small disturbance of a simulated loop grows in a turn, median of some.

    Infinite where the loop diverges before. Two runs, one of which starts beside the
    equilibrium; the linearization has no part in it.
    """
    period = 2 * np.pi / resting.optimization_layer.frequency
    nonstop = make_nonstop(resting)
    equilibrium = nonstop.CreateDefaultContext()
    set_equilibrium(nonstop, equilibrium)
    config = with_largest_step(resting.simulator_config, nonstop, equilibrium)
    runs = []
    for size in (0.0, 1e-8):
        context = equilibrium.Clone()
        for seed, name in enumerate(("load_state", "carrier_state")):
            state = nonstop.GetOutputPort(name).Eval(context).copy()
            noise = np.random.default_rng(seed).standard_normal(len(state))
            PlantStates(nonstop).set_states(context, **{name: state + size * noise})
        simulator = Simulator(nonstop, context)
        ApplySimulatorConfig(config, simulator)
        states = []
        # A number of samples of the swinging over the last tenth of each turn.
        for time in period * np.add.outer(np.arange(turns), np.linspace(0.9, 1.0, 12)).ravel():
            try:
                simulator.AdvanceTo(time)
            except NotFiniteError:
                return np.inf
            states.append(
                np.concatenate(
                    [
                        nonstop.GetOutputPort("load_state").Eval(context)[7:],
                        nonstop.GetOutputPort("carrier_state").Eval(context),
                    ]
                )
            )
        runs.append(np.array(states).reshape(turns, 12, -1))
    distances = np.linalg.norm(runs[1] - runs[0], axis=2).max(axis=1)
    return np.median(distances[1:] / distances[:-1])


MASS, K_P = "simulated.carrier_mass={}", "carrier_controller.position_gain={}"
K_D, PERIOD = "carrier_controller.velocity_gain={}", "control_period={}"
DELAY = "load_feedback=!NoisyFeedback {{delay: {}}}"

# A few per cent and more off the boundary, on either side of it: the last stable one or two, and
# the first unstable ones, of each parameter.
SETTINGS = [
    ("paper_quintic", MASS, (0.115, 0.124), (0.136, 0.15)),
    ("paper_quintic", K_P, (240, 1900), (205, 2150)),
    ("paper_quintic", K_D, (1.21, 1.3), (1.05, 1.11)),
    ("paper_quintic", DELAY, (0.01,), (0.02,)),
    ("paper_quintic", PERIOD, (0.018,), (0.0205,)),
    ("quintic", MASS, (0.36, 0.39), (0.45, 0.5)),
    ("quintic", DELAY, (0.02,), (0.03,)),
]
CASES = [
    (name, setting.format(value), is_stable)
    for name, setting, *values in SETTINGS
    for is_stable, some in zip((True, False), values, strict=True)
    for value in some
]


@pytest.mark.nightly("studies")
@pytest.mark.parametrize(("name", "setting", "is_stable"), CASES)
def test_prediction_and_simulation_agree(name, setting, is_stable):
    scenario = at_rest(load_scenario(name))
    scenario = changed(scenario, [setting])
    predicted = linearize(scenario)
    assert predicted.is_stable == is_stable
    simulated = growth_per_turn(scenario, 3)
    assert (simulated < 1) == is_stable


def test_there_are_twenty_cases():
    assert len(CASES) >= 20


@pytest.fixture(scope="module")
def paper_quintic():
    """The linearized shipped scenario, whose carriers weigh 0.1 kg and whose step is 5 ms."""
    return linearize(load_scenario("paper_quintic"))


@pytest.mark.nightly("studies")
def test_printed_gains_are_unstable_on_a_heavy_carrier_and_stable_on_a_light_one(paper_quintic):
    """Theory: 0.1 kg is stable, 0.3 kg and 1 kg diverge, within 4 s."""
    assert load_scenario("paper_quintic").system.carrier_mass == 0.1
    assert paper_quintic.is_stable
    for mass in (0.3, 1.0):
        found = linearize(load_scenario("paper_quintic", [f"system.carrier_mass={mass}"]))
        assert not found.is_stable
        assert found.rate > 2  # 1/s: in 4 s by more than 3000 times
        # It is the carriers that swing: too slow for a load that bounces at √(4·500/1) rad/s.
        assert found.shares["carrier_dynamics"] > 0.5


@pytest.mark.nightly("studies")
def test_a_shorter_step_shows_what_a_long_one_damps(paper_quintic):
    """The printed gains, sampled at 100 Hz, are stable by the damping of the 5 ms step only."""
    assert paper_quintic.is_stable
    fine = load_scenario("paper_quintic", ["simulator_config.max_step_size=0.001"])
    found = linearize(fine)
    assert found.largest == pytest.approx(growth_per_turn(at_rest(fine), 3), rel=0.1)
    assert found.largest > 3


def test_a_load_at_rest_is_measured_without_noise_by_the_same_filter():
    noisy = "{position_noise: 0.01, delay: 0.02, process_acceleration: 3}"
    scenario = load_scenario("quintic", [f"load_feedback=!FilteredFeedback {noisy}"])
    feedback = at_rest(scenario).load_feedback
    assert (feedback.position_noise, feedback.process_acceleration) == (0.0, 3.0)
    assert feedback.delay == scenario.load_feedback.delay
