"""The numbers of the Floquet analysis."""

from functools import reduce

import numpy as np

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
