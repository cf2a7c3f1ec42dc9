"""The numbers of the Floquet analysis."""

from functools import reduce

import numpy as np
import pytest

from drake_nonstop import load_scenario
from drake_nonstop.studies import stability


def test_matrices_are_interpolated_and_multiplied(rng):
    """Trigonometric polynomials of order 7 are met exactly; products are too small for threads."""
    size, count, phases = 97, 20, 2 * np.pi * np.arange(stability._PHASES) / stability._PHASES
    constant = np.eye(size)
    cosine, sine = rng.standard_normal((2, size, size)) / size

    def exact(phase):
        return constant + np.cos(3 * phase) * cosine + np.sin(7 * phase) * sine

    values = np.array([exact(phase) for phase in phases])
    steps = [*stability._interpolated(values, count)]
    expected = [exact(phase) for phase in 2 * np.pi * np.arange(count) / count]
    np.testing.assert_allclose(steps, expected, rtol=0, atol=1e-12)

    multiplications = []

    class Noting(np.ndarray):
        """A matrix that notes how large its products are."""

        def __matmul__(self, other):
            multiplications.append(self.size * other.shape[1])
            return np.asarray(self) @ other

    product = stability._product([step.view(Noting) for step in steps], size)
    backwards = reduce(lambda product, step: step @ product, expected)
    np.testing.assert_allclose(product, backwards, rtol=1e-10, atol=1e-10)
    assert sum(multiplications) == count * size**3
    assert max(multiplications) < 2**18


CASES = [
    ("three_carriers", [], True),
    ("three_carriers", ["carrier_controller.velocity_gain=0.05"], None),
    ("quintic", ["cables=IndividualCables", "simulated.load_mass=1.1"], True),
]


@pytest.mark.parametrize(("name", "overrides", "is_stable"), CASES)
def test_exact_maps_are_those_of_differences(name, overrides, is_stable, monkeypatch):
    scenario = load_scenario(name, overrides)
    exact = stability.linearize(scenario)
    monkeypatch.setattr(stability, "reason_against", lambda *loop: "it is not to be compiled")
    differenced = stability.linearize(scenario)
    assert exact.is_stable == differenced.is_stable
    assert is_stable in (None, exact.is_stable)
    assert exact.rate == pytest.approx(differenced.rate, rel=1e-6, abs=1e-7)
    ours, others = (np.abs(found.multipliers) for found in (exact, differenced))
    np.testing.assert_allclose(ours, others, rtol=1e-5, atol=1e-6)
    for name, share in differenced.shares.items():
        assert exact.shares[name] == pytest.approx(share, abs=1e-4)
