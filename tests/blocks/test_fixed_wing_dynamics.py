"""Aircraft as a block: states, trim, energies, stall and parameters of the context."""

import numpy as np
import pytest
from aircraft_loops import controller, flying
from helpers import ends_run, fix, model, output

from drake_nonstop import (
    compute_metrics,
    make_nonstop,
    simulate,
)
from drake_nonstop.blocks.carrier_dynamics import (
    FixedWingDynamics,
    FixedWingDynamicsConfig,
)
from drake_nonstop.mechanics.aircraft import air_force
from drake_nonstop.mechanics.signals import AircraftState
from drake_nonstop.model.aircraft import AircraftParameters
from drake_nonstop.run.outcome import RunOutcome
from drake_nonstop.systems.equation_block import EquationBlock
from drake_nonstop.systems.equations import Equations

RASCAL = AircraftParameters(model="rascal_110")


def set_carriers(context, value):
    """Positions and velocities, which come first."""
    state = context.get_continuous_state_vector().CopyToVector()
    context.SetContinuousState(np.append(value, state[len(value) :]))


def flown(n=3, config=None, **inputs):
    """The block and a context in flight at 15 m/s along x, with inputs."""
    block = FixedWingDynamics(model(n, aircraft=RASCAL, cable_length=150.0), config)
    context = block.CreateDefaultContext()
    given = {"aircraft_command": 3 * n, "carrier_cable_forces": 3 * n, "wind": 3 * n}
    fix(block, context, **{name: np.zeros(size) for name, size in given.items()} | inputs)
    velocities = np.tile([15.0, 0.0, 0.0], n)
    set_carriers(context, np.concatenate([np.arange(3.0 * n), velocities]))
    return block, context


@pytest.mark.parametrize("n", [3, 6])
def test_trim_gives_the_acceleration(rng, n):
    pull, wind = rng.uniform(-5, 10, 3 * n), rng.uniform(-2, 2, 3 * n)
    acceleration = rng.uniform(-0.7, 0.7, 3 * n)
    block, context = flown(n, carrier_cable_forces=pull, wind=wind)
    before = output(block, context, "carrier_state")
    block.trim(context, acceleration)
    np.testing.assert_allclose(
        output(block, context, "carrier_acceleration"), acceleration, atol=1e-9
    )
    np.testing.assert_array_equal(output(block, context, "carrier_state"), before)
    # Newton's second law with the forces of the shown state.
    shown = AircraftState.view(output(block, context, "aircraft_state"))
    air = (before[3 * n :] - wind).reshape(n, 3)
    aircraft = block.model.aircraft
    force = air_force(aircraft, air, shown.lift, shown.bank, shown.thrust)
    expected = (force - pull.reshape(n, 3)) / 6.0 - [0, 0, 9.81]
    np.testing.assert_allclose(acceleration, expected.ravel(), atol=1e-9)
    np.testing.assert_allclose(shown.airspeed, np.linalg.norm(air, axis=1), rtol=1e-12)


@pytest.mark.parametrize("cause", ["lift", "speed", "gust"])
def test_a_stall_ends_a_run(cause):
    block, context = flown()
    assert not ends_run(block, context)
    states = context.get_continuous_state_vector().CopyToVector()
    if cause == "lift":
        states[18 + 1] = 1.4
    elif cause == "speed":
        states[9] = 8.3
    else:
        states[18:21] = 1.2
        fix(block, context, wind=np.array([0, 0, 0, 0, 0, 0.7, 0, 0, 0]))
    context.SetContinuousState(states)
    assert ends_run(block, context)
    other, its_context = flown(config=FixedWingDynamicsConfig(stops_at_stall=False))
    assert not other.ends_run(its_context, output(block, context, "aircraft_state"))


@pytest.fixture(scope="module")
def loop():
    return make_nonstop(flying(), carrier_controller=controller)


def test_new_contexts_start_in_trim(loop):
    """The aircraft have the acceleration of their reference, and the load is at rest."""
    context = loop.CreateDefaultContext()
    np.testing.assert_allclose(
        output(loop, context, "carrier_acceleration"),
        output(loop, context, "carrier_reference_acceleration"),
        atol=1e-8,
    )
    shown = AircraftState.view(output(loop, context, "aircraft_state"))
    assert np.all(shown.lift < 0.8 * 1.4)


@pytest.mark.slow
@pytest.mark.parametrize("stops", [True, False])
def test_a_run_goes_on_to_its_first_stall(stops):
    """The second aircraft is told to pull up, and stalls within the half second."""
    scenario = flying(
        f"carrier_dynamics.stops_at_stall={'true' if stops else 'false'}",
        "simulation_duration=0.6",
    )
    run = simulate(scenario, carrier_controller=stalling)
    metrics = compute_metrics(run)
    assert metrics["outcome"] == RunOutcome.STALLED
    shown = AircraftState.view(run.steps["aircraft_state"])
    time = run.steps["time"]
    (first,) = np.flatnonzero(np.any(shown.lift >= 1.4 * (1 - 1e-9), axis=1))[:1]
    assert 0 < time[first] < 0.6
    (reason,) = [text for text in metrics["reasons"] if "stalled" in text]
    assert reason.startswith(f"carrier 2 stalled at t = {time[first]:.3f} s")
    assert time[-1] == (time[first] if stops else 0.6)
    assert np.max(shown.lift) <= 1.4 * (1 + 1e-12)


def stalling(model):
    """All aircraft hold what they are trimmed to, but for the second, which pulls up."""
    n = model.n
    command = np.concatenate([[0.7, 3.0, 0.7], np.zeros(n), np.full(n, 15.0)])
    equations = Equations(
        lambda state: command + 0 * state[: 3 * n],
        inputs={"carrier_state": 6 * n},
        outputs={"aircraft_command": 3 * n},
    )
    return EquationBlock(equations)
