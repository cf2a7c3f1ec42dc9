import numpy as np
import pytest
from helpers import GAINS

from drake_nonstop.mechanics.tuning import correction_rate, load_gains, pid_gains


@pytest.mark.parametrize("frequency", [0.8, 20.0])
@pytest.mark.parametrize("damping", [0.0, 0.7, 1.3])
@pytest.mark.parametrize("integral_rate", [0.0, 0.3])
def test_poles_are_where_they_were_asked_for(frequency, damping, integral_rate):
    position, velocity, integral = pid_gains(frequency, damping, integral_rate)
    loop = np.array([[0, 1, 0], [0, 0, 1], [-integral, -position, -velocity]])  # of ∫e, e, ė
    root = np.emath.sqrt(damping**2 - 1)
    expected = [-damping * frequency + frequency * root, -damping * frequency - frequency * root]
    found = np.linalg.eigvals(loop)
    for pole in [*expected, -integral_rate]:
        assert np.min(np.abs(found - pole)) < 1e-7 * frequency


OF_PAPERS_LOAD = {
    name: 0.0
    if "integral" in name
    else gain / (4 if name.startswith(("orientation", "angular")) else 1)
    for name, gain in (GAINS | {"velocity_gain": 4.4}).items()
}


def test_the_papers_load_has_the_papers_gains_with_more_damping_and_a_quarter_of_its_torques():
    assert load_gains(1.0, 0.01, 0.8, 9.81) == OF_PAPERS_LOAD
    assert correction_rate(0.8, 9.81) == pytest.approx(0.3)


def loads(count):
    """Masses, moments of inertia, lengths of cables and gravities."""
    rng = np.random.default_rng(7)
    low, high = np.log([[0.1, 1e-4, 0.6, 1.6], [100.0, 100.0, 150.0, 25.0]])
    return np.exp(rng.uniform(low, high, (count, 4)))


@pytest.mark.parametrize(("mass", "moment", "length", "gravity"), loads(6))
def test_a_load_has_the_poles_of_the_papers_load_as_fast_as_its_cables_allow(
    mass, moment, length, gravity
):
    gains = load_gains(mass, moment, length, gravity)
    paper = (0.8 / 9.81) / (length / gravity)  # of the squares of the pendulums' frequencies
    speed = np.sqrt(11 * paper / (10 * paper + 1))
    for names, heavier in (([*GAINS][:3], mass), ([*GAINS][3:], moment / 0.01)):
        for name, power in zip(names, (2, 1, 3), strict=True):
            expected = OF_PAPERS_LOAD[name] * heavier * speed**power
            assert gains[name] == pytest.approx(expected, rel=1e-12)
