"""The named parts of flat signals: order, shapes, and views in place of copies."""

import numpy as np
import pytest

from drake_nonstop.mechanics import signals

SIZES = {
    signals.Pose: signals.POSE_SIZE,
    signals.LoadState: signals.LOAD_STATE_SIZE,
    signals.LoadReference: signals.LOAD_REFERENCE_SIZE,
    signals.Wrench: signals.WRENCH_SIZE,
    signals.TrackingError: signals.TRACKING_ERROR_SIZE,
    signals.Parameters: signals.PARAMETERS_SIZE,
    signals.Phase: signals.PHASE_SIZE,
    signals.InternalForce: 8,
}
KINDS = pytest.mark.parametrize("kind", SIZES, ids=lambda kind: kind.__name__)


@KINDS
def test_the_parts_are_the_whole_vector_in_order(kind):
    values = np.arange(float(SIZES[kind]))
    np.testing.assert_array_equal(np.concatenate(kind.view(values)), values)


@pytest.mark.parametrize("lead", [(), (5,)])
def test_carrier_states_have_a_row_for_each_carrier(lead):
    values = np.random.default_rng(2).normal(size=(*lead, 24))
    states = signals.CarrierStates.view(values)
    assert states.positions.shape == states.velocities.shape == (*lead, 4, 3)
    np.testing.assert_array_equal(states.positions[..., 1, :], values[..., 3:6])
    np.testing.assert_array_equal(states.velocities[..., 1, :], values[..., 15:18])
    np.testing.assert_array_equal(states.flat(), values)
    assert np.shares_memory(states.positions, values)


def test_parts_have_the_names_and_the_places_of_the_layout():
    zero, one, two, three = (np.full(3, k) for k in range(4))
    error = signals.TrackingError(zero, one, velocity=three, angular_velocity=two)
    assert error.layout.names == ("orientation", "position", "angular_velocity", "velocity")
    assert [error.orientation, error.position, error.angular_velocity, error.velocity] == [*error]
    assert [part[0] for part in error] == [0, 1, 2, 3]
    for parts, named in [((), {}), ((zero,), {"angle": one}), ((zero, one, two), {})]:
        with pytest.raises(TypeError, match="Phase: give angle, slope, each once"):
            signals.Phase(*parts, **named)
