"""The carriers: double integrators, with weight and cable, and ideal."""

import numpy as np
import pytest
from helpers import fix, model, output, outputs
from pydrake.systems.analysis import Simulator

from drake_nonstop.blocks.carrier_dynamics import (
    CarrierDynamics,
    IdealCarriers,
    LoadedCarrierDynamics,
    LoadedCarrierDynamicsConfig,
)
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.simulation.metrics import compute_metrics
from drake_nonstop.simulation.simulate import simulate
from drake_nonstop.systems.tracing import NotFiniteError

counts = pytest.mark.parametrize("n", [3, 4, 6])


@counts
def test_carriers_are_double_integrators(rng, n):
    block = CarrierDynamics(model(n, carrier_mass=0.25))
    context = block.CreateDefaultContext()
    state, forces = rng.normal(size=6 * n), rng.normal(size=3 * n)
    context.SetContinuousState(state)
    fix(block, context, carrier_forces=forces)
    rate = block.EvalTimeDerivatives(context)
    np.testing.assert_allclose(
        rate.CopyToVector(), [*state[3 * n :], *(4 * forces)], rtol=0, atol=1e-15
    )
    np.testing.assert_array_equal(output(block, context, "carrier_state"), state)


def test_pushed_carrier_moves_on_a_parabola():
    block = CarrierDynamics(model(3, carrier_mass=0.1))
    simulator = Simulator(block)
    context = simulator.get_mutable_context()
    fix(block, context, carrier_forces=np.arange(9.0))
    simulator.AdvanceTo(0.5)
    expected = np.concatenate([np.arange(9) / 0.1 * 0.5**2 / 2, np.arange(9) / 0.1 * 0.5])
    np.testing.assert_allclose(output(block, context, "carrier_state"), expected, rtol=1e-9)


def test_carrier_that_gets_no_number_is_named():
    block = LoadedCarrierDynamics(model())
    block.set_name("carrier_dynamics")
    context = block.CreateDefaultContext()
    fix(block, context, carrier_forces=np.full(12, np.inf), carrier_cable_forces=np.zeros(12))
    with pytest.raises(NotFiniteError, match="carrier_dynamics"):
        block.EvalTimeDerivatives(context)


def acceleration(block, **inputs):
    context = block.CreateDefaultContext()
    fix(block, context, **inputs)
    return block.EvalTimeDerivatives(context).CopyToVector()[12:].reshape(4, 3)


def test_carriers_feel_weight_cable_and_their_limit():
    free = LoadedCarrierDynamics(model())
    mass, gravity = model().carrier_mass, model().gravity
    forces = np.arange(12.0)
    cables = np.linspace(-1, 1, 12)
    expected = (forces - cables).reshape(4, 3) / mass - [0, 0, gravity]
    np.testing.assert_allclose(
        acceleration(free, carrier_forces=forces, carrier_cable_forces=cables), expected
    )
    limited = LoadedCarrierDynamics(model(), LoadedCarrierDynamicsConfig(max_force=5.0))
    got = acceleration(limited, carrier_forces=forces, carrier_cable_forces=np.zeros(12))
    applied = mass * (got + np.array([0, 0, gravity]))
    sizes = np.linalg.norm(forces.reshape(4, 3), axis=1)
    np.testing.assert_allclose(np.linalg.norm(applied, axis=1), np.minimum(sizes, 5.0))
    np.testing.assert_allclose(np.cross(applied, forces.reshape(4, 3)), 0, atol=1e-12)


LOADED = ["carrier_dynamics=!LoadedCarrierDynamics {}", "carrier_controller=!LoadedCarrierPid {}"]


@pytest.mark.nightly("flights")
@pytest.mark.parametrize("mass", [0.9, 1.0, 1.1])
def test_with_the_cables_reaction_and_a_wrong_mass_the_bound_holds(mass):
    run = simulate(load_scenario("quintic", [*LOADED, f"simulated.load_mass={mass}"]))
    metrics = compute_metrics(run)
    assert metrics["carriers"]["time_below_bound_s"] == 0
    assert metrics["load"]["position_error_final_m"] <= 1.2e-3
    assert metrics["optimizer"]["relaxed"] + metrics["optimizer"]["held"] == 0


@pytest.mark.slow
def test_with_the_cables_reaction_carriers_stay_on_their_references():
    """Of a load that is heavier than believed, which only the cables tell."""
    settings = [*LOADED, "optimization_layer=ConstantParameters", "simulation_duration=0.5"]
    distances = []
    for mass in (1.0, 1.1):
        run = simulate(load_scenario("quintic", [*settings, f"simulated.load_mass={mass}"]))
        places = [run.signal(name)[:, :12] for name in ("carrier_state", "carrier_reference")]
        distances.append(np.abs(places[0] - places[1]).max())
    # Weight and believed pull are fed forward; without that, weight and cable, 3.4 N, would move
    # the carriers by 3.4 mm at 1000 N/m. A quarter of 0.1 kg moves them by 0.25 mm.
    assert distances[0] < 3e-4
    assert distances[1] < distances[0] + 2.5e-4


@pytest.mark.slow
def test_carriers_too_weak_for_the_load_let_it_down(fleet):
    run = fleet.run("that_falls")  # of four LoadedCarrierDynamics with 1 N each
    assert run.signal("load_state")[-1, 6] < -0.1


def test_ideal_carriers_are_where_they_should_be(rng):
    values = rng.normal(size=24)
    state = outputs(IdealCarriers(model()), carrier_reference=values)["carrier_state"]
    np.testing.assert_array_equal(state, values)
