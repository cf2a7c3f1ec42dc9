import numpy as np
import pytest
from helpers import GAINS, INERTIA, Motion, difference, nightly_beyond, rotation

from drake_nonstop.mechanics.rigid_load import RigidLoad, load_state_rate
from drake_nonstop.mechanics.rotation import quaternion_rate
from drake_nonstop.mechanics.wrench import tracking_error, wrench_and_rate

LOAD = RigidLoad(mass=1.3, inertia=INERTIA, drag=0.7, gravity=9.7)
WIND = np.array([3.0, -2.0, 0.5])  # m/s
NO_GAINS = dict.fromkeys(GAINS, 0.0)


def test_errors_on_two_independent_motions():
    state, reference = Motion(10).state(0.5), Motion(11).reference(0.5)
    R, R_d = rotation(state[:4]), rotation(reference[:4])
    S = (R_d.T @ R - R.T @ R_d) / 2
    omega, desired_omega = R.T @ state[7:10], R_d.T @ reference[7:10]  # each in its own frame
    expected = np.concatenate(
        [
            [S[2, 1], S[0, 2], S[1, 0]],
            state[4:7] - reference[4:7],
            omega - R.T @ R_d @ desired_omega,
            state[10:13] - reference[10:13],
        ]
    )
    error = tracking_error(state, reference)
    np.testing.assert_allclose(error, expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize("feedforward", [0.0, 1.0, 0.4])
def test_wrench_in_closed_form(rng, feedforward):
    actual, desired, time = Motion(12), Motion(13), 1.4
    state, reference, integrals = actual.state(time), desired.reference(time), rng.normal(size=6)
    R = rotation(state[:4])
    omega = R.T @ state[7:10]
    e_R, e_p, e_omega, e_v = tracking_error(state, reference).reshape(4, 3)
    # RᵀR_d ω_d, with ω_d in D, is Rᵀ of the world's ω_d.
    desired_omega_rate = difference(
        lambda t: rotation(actual.state(t)[:4]).T @ desired.reference(t)[7:10], time
    )
    force = np.array([0, 0, 1.3 * 9.7]) - 5 * e_p - 2 * e_v - 0.9 * integrals[3:]
    force += feedforward * (1.3 * reference[16:19] + 0.7 * reference[10:13])
    torque = np.cross(omega, INERTIA @ omega) - 0.5 * e_R - 0.06 * e_omega - 0.1 * integrals[:3]
    torque += feedforward * INERTIA @ desired_omega_rate
    wrench, _ = wrench_and_rate(LOAD, state, reference, integrals, **GAINS, feedforward=feedforward)
    np.testing.assert_allclose(wrench, [*(R @ torque), *force], rtol=0, atol=1e-11)


def differences_of_wrench(gains, feedforward, reference_at):
    """(ẇ_d, its differences) along the motion that the model makes under w_d.

    `reference_at(t, q)` is the reference with the orientation q, which is integrated
    together with the load and with the controller's integrals, from random values.
    """
    start, step = 0.6, 2e-3
    rng = np.random.default_rng(14)
    state = Motion(15).state(start)
    desired = Motion(16).reference(start)[:4]
    initial = np.concatenate([state, 0.3 * rng.normal(size=6), desired])

    def control(t, y):
        return wrench_and_rate(
            LOAD,
            y[:13],
            reference_at(t, y[19:]),
            y[13:19],
            WIND,
            **gains,
            feedforward=feedforward,
        )

    def rate(t, y):
        reference = reference_at(t, y[19:])
        load_rate = load_state_rate(
            LOAD, y[:13], np.zeros(3), control(t, y)[0], WIND, attachments=np.zeros((1, 3))
        )
        error = tracking_error(y[:13], reference)[:6]
        return np.concatenate([load_rate, error, quaternion_rate(y[19:], reference[7:10])])

    def advanced(t, y, h):
        k1 = rate(t, y)
        k2 = rate(t + h / 2, y + h / 2 * k1)
        k3 = rate(t + h / 2, y + h / 2 * k2)
        k4 = rate(t + h, y + h * k3)
        return y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

    def wrench(t):
        y, count = initial, 8
        h = (t - start) / count
        for i in range(count):
            y = advanced(start + i * h, y, h)
        return control(t, y)[0]

    return control(start, initial)[1], difference(wrench, start, step)


def swinging(t, quaternion):
    """A reference that moves in every way, with an angular jerk."""
    return np.concatenate([quaternion, Motion(16).reference(t)[4:]])


def spinning_up(t, quaternion):
    """The same with a constant angular acceleration, as the feedforward's rate takes it."""
    reference = swinging(t, quaternion)
    alpha = np.array([0.5, -0.8, 0.3])
    omega = np.array([0.4, 0.2, -0.6]) + alpha * (t - 0.6)
    return np.concatenate([reference[:7], omega, reference[10:13], alpha, reference[16:]])


# The differences see the load's own frequencies, up to K_ω / J = 6 1/s: h⁴ 6⁵ / 30 = 4e-9.
RATE_TOLERANCE = 1e-8


@pytest.mark.parametrize("gain", nightly_beyond(1, "studies", ["all", *GAINS, None]))
def test_wrench_rate_without_feedforward_is_the_difference_of_the_wrench(gain):
    gains = GAINS if gain == "all" else {**NO_GAINS, **({gain: GAINS[gain]} if gain else {})}
    rate, expected = differences_of_wrench(gains, 0.0, swinging)
    np.testing.assert_allclose(rate, expected, rtol=0, atol=RATE_TOLERANCE)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gains", "feedforward"),
    nightly_beyond(2, "studies", [(NO_GAINS, 1.0), (GAINS, 0.5), (NO_GAINS, 0.5), (GAINS, 1.0)]),
)
def test_wrench_rate_with_feedforward_is_the_difference_of_the_wrench(gains, feedforward):
    rate, expected = differences_of_wrench(gains, feedforward, spinning_up)
    np.testing.assert_allclose(rate, expected, rtol=0, atol=RATE_TOLERANCE)


def test_table_gains_damp_the_rotation():
    J, K_omega, K_R, K_i = 0.01, 0.06, 0.5, 0.1
    load = RigidLoad(mass=1.3, inertia=J * np.eye(3), drag=0.7, gravity=9.7)
    reference = np.array([1.0, *np.zeros(21)])

    def rate(y):
        """Of [∫e_R, small rotation, ω] about x."""
        state = np.array([1.0, y[1] / 2, *np.zeros(5), y[2], *np.zeros(5)])
        integrals = np.array([y[0], *np.zeros(5)])
        wrench, _ = wrench_and_rate(load, state, reference, integrals, **GAINS, feedforward=1.0)
        load_rate = load_state_rate(load, state, np.zeros(3), wrench, attachments=np.zeros((1, 3)))
        return np.array([tracking_error(state, reference)[0], y[2], load_rate[7]])

    h = 1e-6
    matrix = np.column_stack([(rate(h * e) - rate(-h * e)) / (2 * h) for e in np.eye(3)])
    poles = np.sort_complex(np.linalg.eigvals(matrix))
    expected = np.sort_complex(np.roots([J, K_omega, K_R, K_i]))
    np.testing.assert_allclose(poles, expected, rtol=1e-6)
    assert np.max(poles.real) < 0
    np.testing.assert_allclose(poles[0], -2.90 - 6.36j, atol=0.01)
