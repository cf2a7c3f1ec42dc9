import numpy as np
from nonstop_cases import START, TIGHTENING, moving, update_data, update_solver

from drake_nonstop.optimization.update_data import ModelParameters, UpdateData, update_data_size


def test_the_view_of_a_vector_is_its_parts_in_order_and_writes_to_it():
    vector = np.arange(float(update_data_size(12)))
    parts = UpdateData.view(vector)
    np.testing.assert_array_equal(np.concatenate(parts), vector)
    beliefs = ModelParameters.view(parts.beliefs)
    np.testing.assert_array_equal(np.concatenate(beliefs), parts.beliefs)
    assert beliefs.offset.shape == (12,)
    beliefs.offset[-1:] = -1.0
    assert vector[-1] == -1.0


def test_update_data_are_found_by_their_names():
    inputs, solver = moving(1), update_solver(orbit_points=16, anchor_weight=2.0)
    second_rate = np.arange(6.0)
    data = solver.update_data(
        previous=START,
        phase=inputs["phase"],
        load_state=inputs["measured_load_state"],
        reference=inputs["reference"],
        wrench=inputs["wrench"],
        wrench_rate=inputs["wrench_rate"],
        wrench_second_rate=second_rate,
        speed_bound=0.5,
        updates=7,
    )
    assert np.concatenate(data).shape == (64,)
    assert np.concatenate(solver.problem(data).data).shape == (update_data_size(0),)
    parts = UpdateData.view(np.concatenate(data))
    np.testing.assert_array_equal(parts.previous, START)
    np.testing.assert_array_equal(parts.load_state, inputs["measured_load_state"])
    for name in ("phase", "reference", "wrench", "wrench_rate"):
        np.testing.assert_array_equal(getattr(parts, name), inputs[name])
    np.testing.assert_array_equal(parts.wrench_second_rate, second_rate)
    np.testing.assert_allclose(parts.speed_bound, [0.5 * (1 + TIGHTENING)], rtol=1e-15)
    np.testing.assert_array_equal(parts.speed_unit, parts.speed_bound)
    # The fourth of four updates that share 16 phases.
    np.testing.assert_allclose(parts.orbit_turn, [3 * 2 * np.pi / 16], rtol=1e-15)
    np.testing.assert_array_equal(parts.anchor_weight, [0.0])  # the reference moves


def test_margins_without_a_bound_have_the_unit_one():
    inputs = moving(1)
    data = update_data(inputs, 0.0)
    assert (data.speed_bound[0], data.speed_unit[0]) == (0.0, 1.0)
