import numpy as np
import pytest
from helpers import GAINS, INERTIA, Motion, difference, rotation
from scipy.integrate import solve_ivp

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


def swinging(t, quaternion):
    """A reference that moves in every way, with an angular jerk."""
    return np.concatenate([quaternion, Motion(16).reference(t)[4:]])


def spinning_up(t, quaternion):
    """The same with a constant angular acceleration, as the feedforward's rate takes it."""
    reference, alpha = swinging(t, quaternion), np.array([0.5, -0.8, 0.3])
    omega = np.array([0.4, 0.2, -0.6]) + alpha * (t - 0.6)
    return np.concatenate([reference[:7], omega, reference[10:13], alpha, reference[16:]])


CASES = [
    (GAINS, 0.0, swinging),
    (GAINS, 0.5, spinning_up),
    *((NO_GAINS | {name: GAINS[name]}, 0.0, swinging) for name in GAINS),
    (NO_GAINS, 1.0, spinning_up),
]


@pytest.mark.parametrize(("gains", "feedforward", "reference_at"), CASES)
def test_wrench_rate_is_the_difference_of_the_wrench(gains, feedforward, reference_at):
    """Along the motion that the model makes under w_d, by SciPy.

    `reference_at(t, q)` is the reference with the orientation q, which is integrated together with
    the load and with the controller's integrals, from random values.
    """
    start, rng = 0.6, np.random.default_rng(14)
    desired = Motion(16).reference(start)[:4]
    initial = np.concatenate([Motion(15).state(start), 0.3 * rng.normal(size=6), desired])

    def control(t, y):
        signals = LOAD, y[:13], reference_at(t, y[19:]), y[13:19], WIND
        return wrench_and_rate(*signals, **gains, feedforward=feedforward)

    def rate(t, y):
        still, reference = {"attachments": np.zeros((1, 3))}, reference_at(t, y[19:])
        moved = load_state_rate(LOAD, y[:13], np.zeros(3), control(t, y)[0], WIND, **still)
        error = tracking_error(y[:13], reference)[:6]
        return np.concatenate([moved, error, quaternion_rate(y[19:], reference[7:10])])

    def wrench(t):
        flown = solve_ivp(rate, (start, t), initial, "DOP853", rtol=1e-13, atol=1e-13)
        return control(t, flown.y[:, -1])[0]

    # The differences see the load's own frequencies, up to K_ω / J = 6 1/s: h⁴ 6⁵ / 30 = 4e-9.
    expected = difference(wrench, start, 2e-3)
    np.testing.assert_allclose(control(start, initial)[1], expected, rtol=0, atol=1e-8)
