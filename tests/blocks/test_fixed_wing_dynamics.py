"""Aircraft as a block: their trim, and their stall."""

import numpy as np
import pytest
from helpers import fix, model, output

from drake_nonstop import AircraftParameters
from drake_nonstop.blocks.carrier_dynamics import FixedWingDynamics, FixedWingDynamicsConfig
from drake_nonstop.mechanics.aircraft import air_force
from drake_nonstop.mechanics.signals import AircraftState

RASCAL = AircraftParameters(model="rascal_110")


def flown(n=3, config=None, **inputs):
    """The block and a context in flight at 15 m/s along x, with inputs."""
    block = FixedWingDynamics(model(n, aircraft=RASCAL, cable_length=150.0), config)
    context = block.CreateDefaultContext()
    given = ("aircraft_command", "carrier_cable_forces", "wind")
    fix(block, context, **dict.fromkeys(given, np.zeros(3 * n)) | inputs)
    state = context.get_continuous_state_vector().CopyToVector()
    state[: 6 * n] = np.concatenate([np.arange(3.0 * n), np.tile([15.0, 0.0, 0.0], n)])
    context.SetContinuousState(state)
    return block, context


@pytest.mark.parametrize("n", [3, 6])
def test_trim_gives_the_acceleration(rng, n):
    pull, wind = rng.uniform(-5, 10, 3 * n), rng.uniform(-2, 2, 3 * n)
    acceleration = rng.uniform(-0.7, 0.7, 3 * n)
    block, context = flown(n, carrier_cable_forces=pull, wind=wind)
    before = output(block, context, "carrier_state")
    block.trim(context, acceleration)
    found = output(block, context, "carrier_acceleration")
    np.testing.assert_allclose(found, acceleration, atol=1e-9)
    np.testing.assert_array_equal(output(block, context, "carrier_state"), before)
    # Newton's second law with the forces of the shown state.
    shown = AircraftState.view(output(block, context, "aircraft_state"))
    air = (before[3 * n :] - wind).reshape(n, 3)
    force = air_force(block.model.aircraft, air, shown.lift, shown.bank, shown.thrust)
    expected = (force - pull.reshape(n, 3)) / 6.0 - [0, 0, 9.81]
    np.testing.assert_allclose(acceleration, expected.ravel(), atol=1e-9)
    np.testing.assert_allclose(shown.airspeed, np.linalg.norm(air, axis=1), rtol=1e-12)


def ends_run(block, context):
    return block.ends_run(context, output(block, context, block.ending_signal))


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
