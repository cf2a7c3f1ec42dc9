"""The carriers: double integrators, free, or with a limit, a lag, weight and cable."""

import numpy as np
import pytest
from helpers import fix, model, output
from pydrake.autodiffutils import ExtractGradient, InitializeAutoDiff
from pydrake.systems.analysis import Simulator

from drake_nonstop.blocks.carrier_dynamics import (
    LimitedCarriers,
    LimitedCarriersConfig,
)
from drake_nonstop.run.simulate import simulate
from drake_nonstop.scenario.loading import load_scenario

counts = pytest.mark.parametrize("n", [3, 4, 6])


LOADED = {"has_weight": True, "feels_cable": True}
WEIGHTY = "carrier_dynamics=!LimitedCarriers {has_weight: true, feels_cable: true}"


def test_a_limited_carrier_follows_a_step_exponentially():
    """v = a (t − τ (1 − e^{−t/τ})), and its integral, of a command a at rest."""
    lag, time, command = 0.2, 0.7, np.linspace(-1, 1, 9)
    block = LimitedCarriers(model(3, carrier_mass=0.5), LimitedCarriersConfig(lag=lag))
    simulator = Simulator(block)
    simulator.get_mutable_integrator().set_target_accuracy(1e-11)
    context = simulator.get_mutable_context()
    fix(block, context, carrier_forces=0.5 * command)
    simulator.AdvanceTo(time)
    rise = 1 - np.exp(-time / lag)
    shares = [time**2 / 2 - lag * time + lag**2 * rise, time - lag * rise]
    expected = np.concatenate([share * command for share in shares])
    np.testing.assert_allclose(output(block, context, "carrier_state"), expected, atol=1e-9)
    state = context.get_continuous_state_vector().CopyToVector()
    np.testing.assert_allclose(state[18:], rise * command, atol=1e-9)


def rates(block, state, **inputs):
    """Rates (3, n, 3) of positions, velocities and the carriers' own accelerations."""
    context = block.CreateDefaultContext()
    context.SetContinuousState(state)
    fix(block, context, **inputs)
    return block.EvalTimeDerivatives(context).CopyToVector().reshape(3, -1, 3)


@counts
@pytest.mark.parametrize("options", [{}, {"has_weight": True}, {"feels_cable": True}, LOADED])
def test_limited_carriers_feel_weight_cable_and_their_limit(rng, n, options):
    config = LimitedCarriersConfig(max_acceleration=9.0, lag=0.1, **options)
    body = model(n, carrier_mass=0.25)
    block = LimitedCarriers(body, config)
    state = rng.normal(size=(3, n, 3))
    forces, cables = np.arange(3.0 * n), rng.normal(size=3 * n)
    pull = {"carrier_cable_forces": cables} if config.feels_cable else {}
    moved, pulled, own = rates(block, state.ravel(), carrier_forces=forces, **pull)
    np.testing.assert_array_equal(moved, state[1])
    felt = np.array([0, 0, -9.81]) * config.has_weight
    felt = felt - config.feels_cable * cables.reshape(n, 3) / 0.25
    np.testing.assert_allclose(pulled - state[2], felt, atol=1e-12)
    commands, limited = forces.reshape(n, 3) / 0.25, state[2] + 0.1 * own
    sizes = np.linalg.norm(commands, axis=1)
    assert np.any(sizes < 9)
    assert np.any(sizes > 9)
    np.testing.assert_allclose(np.linalg.norm(limited, axis=1), np.minimum(sizes, 9))
    np.testing.assert_allclose(np.cross(limited, commands), 0, atol=1e-11)


def test_a_limited_carrier_without_a_command_has_derivatives():
    block = LimitedCarriers(model())
    converted, context = block.ToAutoDiffXd(), block.CreateDefaultContext()
    fix(block, context, carrier_forces=np.zeros(12))
    own = converted.CreateDefaultContext()
    forces = InitializeAutoDiff(np.zeros(12)).ravel()
    converted.GetInputPort("carrier_forces").FixValue(own, forces)
    rate = converted.EvalTimeDerivatives(own).CopyToVector()
    slopes = ExtractGradient(rate)[24:]
    expected = np.eye(12) / (model().carrier_mass * block.config.lag)
    np.testing.assert_allclose(slopes, expected, atol=1e-9)


@pytest.mark.slow
def test_loaded_carriers_sag_by_weight_and_pull_over_the_gain():
    """‖m_c g e₃ + f‖/K_p, of what the cables pull with."""
    settings = ["optimization_layer=ConstantParameters", "simulation_duration=2"]
    settings += [WEIGHTY, "load_trajectory.start_time=20"]
    run = simulate(load_scenario("quintic", settings))
    places = [run.signal(name)[-1, :12] for name in ("carrier_state", "carrier_reference")]
    sag = (places[0] - places[1]).reshape(4, 3)
    pull = run.signal("cable_forces")[-1].reshape(4, 3)
    expected = -(pull + np.array([0, 0, 0.1 * 9.81])) / 1000
    np.testing.assert_allclose(sag, expected, atol=4e-5)
