"""Sampled linear loops, against closed forms, worst inputs and random ones."""

import math
from functools import reduce

import numpy as np
import pytest

from drake_nonstop.mechanics.sampled_loop import (
    bounded_response,
    interpolated,
    known_response,
    largest_growth,
    map_of_turn,
    noise_deviation,
    overshoot,
    responses,
    sampled_loop,
    step_response,
    waves_deviation,
)

FREQUENCY, DAMPING = 100.0, 0.5  # rad/s, of the carriers
PERIOD = 0.001  # s
NO_RATE = np.array([np.inf])


def velocity_of_acceleration():
    """A carrier's velocity under an acceleration that is held for a period."""
    dynamics = np.zeros((3, 3))  # [position, velocity, held acceleration]
    dynamics[0, 1] = dynamics[1, 2] = 1
    dynamics[1, :2] = -(FREQUENCY**2), -2 * DAMPING * FREQUENCY
    reset = np.diag([1.0, 1.0, 0.0])
    inputs = np.array([[0.0], [0.0], [1.0]])
    return sampled_loop(dynamics, reset, inputs, np.array([[0.0, 1.0, 0.0]]), period=PERIOD)


@pytest.fixture(scope="module")
def g():
    return next(responses([velocity_of_acceleration()], 10, [0], 300))


def closed_form_gain():
    """∫|v| of an impulse of acceleration: twice the sum of the extremes of its position."""
    root = math.sqrt(1 - DAMPING**2)
    first = math.exp(-DAMPING / root * math.acos(DAMPING)) / FREQUENCY
    return 2 * first / (1 - math.exp(-math.pi * DAMPING / root))


def driven(inputs):
    """The velocities of that carrier, by many small steps of its own equation."""
    position = velocity = 0.0
    steps = 50
    step = PERIOD / steps
    seen = []
    for value in inputs:
        for _ in range(steps):
            velocity += step * (
                value - FREQUENCY**2 * position - 2 * DAMPING * FREQUENCY * velocity
            )
            position += step * velocity
        seen.append(velocity)
    return np.array(seen)


def test_the_peak_to_peak_gain_is_the_closed_form(g):
    gain = bounded_response(g, 1, np.ones(1), NO_RATE, PERIOD).max()
    assert gain == pytest.approx(closed_form_gain(), rel=0.01)


def test_a_bang_bang_input_attains_the_gain_and_no_random_one_exceeds_it(g):
    gain = bounded_response(g, 1, np.ones(1), NO_RATE, PERIOD).max()
    rows = g.reshape(len(g), 3)[:, -1]  # of the instant before the next sample
    worst = np.sign(rows[::-1])
    assert driven(worst)[-1] == pytest.approx(gain, rel=0.02)
    random = np.random.default_rng(5).choice([-1.0, 1.0], 1000)
    assert np.max(np.abs(driven(random))) < gain


def test_inputs_that_vary_slowly_have_a_smaller_bound_that_holds(g):
    frequency = 5.0
    gain = bounded_response(g, 1, np.ones(1), NO_RATE, PERIOD).max()
    slow = bounded_response(g, 1, np.ones(1), np.array([frequency]), PERIOD).max()
    flown = np.max(np.abs(driven(np.sin(frequency * PERIOD * np.arange(1500)))))
    assert flown < slow < 0.1 * gain
    assert slow < 3 * flown


def test_a_steady_input_is_bounded_by_what_it_settles_to(g):
    steady = bounded_response(g, 1, np.ones(1), np.zeros(1), PERIOD).max()
    assert steady == pytest.approx(0, abs=1e-6)  # a constant force moves no carrier for ever


def test_noise_spreads_the_output_as_a_monte_carlo_does(g):
    noise = 0.3 * np.random.default_rng(7).standard_normal(6000)
    assert noise_deviation(g, np.array([0.3])).max() == pytest.approx(
        np.std(driven(noise)), rel=0.05
    )


def test_a_jump_of_velocity_overshoots_by_the_closed_form():
    dynamics = np.array([[0.0, 1.0], [-(FREQUENCY**2), -2 * DAMPING * FREQUENCY]])
    loop = sampled_loop(
        dynamics, np.eye(2), np.array([[0.0], [1.0]]), np.array([[0.0, -1.0]]), period=PERIOD
    )
    instants = next(responses([loop], 10, [0], 300)).reshape(-1, 1, 1)
    times = np.linspace(0, 0.1, 200001)
    root = math.sqrt(1 - DAMPING**2)
    angle = FREQUENCY * root * times
    velocity = np.exp(-DAMPING * FREQUENCY * times) * (
        np.cos(angle) - DAMPING / root * np.sin(angle)
    )
    assert overshoot(instants).max() == pytest.approx(-velocity.min(), rel=1e-3)


def test_the_map_of_a_turn_is_the_product_of_maps_between_the_phases(rng):
    count, samples = 15, 150
    constant = np.eye(3)
    cosine, sine = rng.standard_normal((2, 3, 3)) / samples

    def steps(turns):
        angles = 2 * np.pi * np.arange(turns)[:, None, None] / turns
        return constant + np.cos(3 * angles) * cosine + np.sin(7 * angles) * sine

    expected = reduce(lambda turn, step: step @ turn, steps(samples))
    np.testing.assert_allclose(map_of_turn(steps(count), samples), expected, atol=1e-12)


def test_the_largest_growth_is_that_from_the_worst_sample_to_the_worst():
    maps = np.stack([np.diag([factor, 1.0]) for factor in (0.5, 0.5, 3.0, 2.0, 0.5)])
    assert largest_growth(maps, np.ones(1), spacing=1) == pytest.approx((6, 2, 4))
    assert largest_growth(maps, np.ones(1), spacing=3) == pytest.approx((2, 3, 4))
    assert largest_growth(maps[:2], np.ones(1), spacing=1) == (1, 0, 0)


def test_growth_of_several_states_is_the_largest_singular_value():
    rng = np.random.default_rng(3)
    maps, scale = rng.normal(size=(5, 4, 4)), np.array([2.0, 0.5])
    whole = np.linalg.multi_dot(maps[::-1])[:2, :2]
    sizes = np.linalg.svd(scale[:, None] * whole / scale, compute_uv=False)
    found = largest_growth(maps, scale, spacing=5)
    assert found.times >= sizes.max()
    if found.last == 5:
        assert found.times == pytest.approx(sizes.max())


def test_growth_beyond_all_bounds_is_followed_no_further():
    found = largest_growth((10.0 * np.eye(1) for _ in range(1000)), np.ones(1), spacing=7)
    assert (found.first, found.last) == (0, 12)


@pytest.mark.parametrize("count", [8, 9])
def test_a_function_of_the_phase_is_interpolated_between_even_phases(count):
    def function(turns):
        angles = 2 * np.pi * np.asarray(turns)[:, None, None]
        return 1 + np.cos(angles) - 2 * np.sin(3 * angles) * np.ones((1, 1, 2))

    between = np.array([0.0, 0.13, 0.77])
    found = interpolated(function(np.arange(count) / count), between)
    np.testing.assert_allclose(found, function(between), atol=1e-12)


def test_a_known_input_gives_the_largest_output_of_its_simulation(g):
    inputs = np.random.default_rng(2).standard_normal((400, 1))
    flown = driven(inputs[:, 0])
    # `g` sees three instants of a sample, the simulation the last one before the next.
    last = g.reshape(len(g), 3, 1)[:, -1:]
    assert known_response(last, inputs).max() == pytest.approx(np.max(flown), rel=0.03)


def test_an_input_that_stays_gives_the_largest_velocity_of_the_closed_form(g):
    root = math.sqrt(1 - DAMPING**2)
    peak = math.exp(-DAMPING / root * math.acos(DAMPING)) / FREQUENCY
    assert step_response(g, np.array([2.0])).max() == pytest.approx(2 * peak, rel=0.01)


@pytest.mark.parametrize("frequency", [0.0, 30.0, 100.0, 200.0])
def test_a_wave_spreads_the_output_by_its_closed_form_gain(g, frequency):
    s = 1j * frequency
    gain = abs(s / (s**2 + 2 * DAMPING * FREQUENCY * s + FREQUENCY**2))
    spread = waves_deviation(g, np.array([0.3]), np.array([frequency]), PERIOD).max()
    assert spread == pytest.approx(0.3 * gain, rel=0.02, abs=1e-6)
