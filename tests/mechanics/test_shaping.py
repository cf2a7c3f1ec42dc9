"""Numbers smoothed by three equal poles."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.primitives import LinearSystem

from drake_nonstop.mechanics.shaping import Smoothing

CASES = pytest.mark.parametrize(("bandwidth", "period"), [(40.0, 0.01), (3.0, 0.05), (200.0, 0.02)])
START = (0.7, 0.4, -0.3)


@CASES
def test_a_step_is_that_of_drakes_linear_system(bandwidth, period):
    w = bandwidth
    A = np.array([[0, 0, 0, 0], [w, -w, 0, 0], [0, w, -w, 0], [0, 0, 1, 0]])
    chain = LinearSystem(A, np.eye(4)[:, :1], np.eye(4), np.zeros((4, 1)))
    simulator = Simulator(chain)
    chain.get_input_port().FixValue(simulator.get_context(), 1.7)
    simulator.get_mutable_context().SetContinuousState([*START, 0.0])
    simulator.get_mutable_integrator().set_target_accuracy(1e-9)
    simulator.AdvanceTo(period)
    expected = simulator.get_context().get_continuous_state_vector().CopyToVector()
    after = Smoothing(bandwidth=bandwidth, period=period).after(*START, 1.7)
    np.testing.assert_allclose(after, expected, rtol=0, atol=1e-9)


@CASES
def test_rates_are_the_slopes_of_the_smoothed_number(bandwidth, period):
    first_rate, step = 1.7, 1e-3 / bandwidth

    def third(time):
        return Smoothing(bandwidth=bandwidth, period=time).after(*START, first_rate)[2]

    smoothing = Smoothing(bandwidth=bandwidth, period=period)
    found = smoothing.rates(*START, first_rate)
    # The Taylor series of the exact motion ahead, fitted to polynomials of sixth order.
    times = step * np.arange(1, 60)
    fitted = np.polynomial.polynomial.polyfit(times / times[-1], [*map(third, times)], 8)
    expected = [fitted[k] * np.prod(np.arange(1, k + 1)) / times[-1] ** k for k in (1, 2, 3)]
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    assert smoothing.stage_rates(*START)[1] == found[0]
