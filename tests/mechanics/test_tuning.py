import numpy as np
import pytest

from drake_nonstop.mechanics.tuning import pid_gains


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
