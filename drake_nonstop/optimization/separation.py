"""Distances of carriers over whole orbits, which depend on A alone."""

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.nonstop import nearest_squares, orbit_positions
from drake_nonstop.mechanics.planned_orbit import orbit_directions

_PHASES = 36  # of a whole turn, at which carriers are kept apart
_HALF_STEP = np.pi / _PHASES  # rad
_MOST_DISTANCES = 2**18  # at a time: bounds the memory
_ROUND_OFF = 1e-12  # relative, of squared distances from scalar products


class OrbitDistances:
    """Distances of carriers with axes p and q (n, 3), see `internal_force.orbit_axes`.

    An encounter is a pair of carriers at a phase: of encounters (3, m) the first row are the
    numbers of the phases, the others those of the carriers.
    """

    def __init__(self, axes: tuple[NDArray, NDArray]):
        self._count = len(axes[0])
        self._all = np.arange(_PHASES)[:, None], np.arange(self._count)[None]
        self._is_once = np.triu(np.ones((self._count, self._count), bool), 1)
        u, along, _ = orbit_directions(axes, 2 * np.pi * np.arange(_PHASES) / _PHASES)
        # (3, phases, n) each
        self._directions, self._direction_rates = (
            np.ascontiguousarray(np.moveaxis(part, -1, 0)) for part in (u, along)
        )

    def pairs(self) -> NDArray:
        """The pairs (2, m) of carriers."""
        return np.array(np.triu_indices(self._count, 1))

    def every(self) -> NDArray:
        """All encounters (3, m)."""
        return self._encounters(np.ones((_PHASES, self._count, self._count), bool))

    def near(
        self,
        distance: float,
        amplitude: float,
        forces: NDArray,
        levers: NDArray,
        **cables: float,
    ) -> NDArray:
        """The encounters (3, m) that may be closer than a distance (m); others as below.

        The tangents shorten a distance by no more than the lengths of both within half a step.
        """
        positions, rates = self._orbits(np.array([amplitude]), forces, levers, self._all, **cables)
        points = positions[:, 0].transpose(1, 2, 0)  # (phases, n, 3)
        sizes = (points * points).sum(axis=2, keepdims=True)
        one = np.ones(sizes.shape)
        others = np.concatenate([-2 * points, one, sizes], axis=2)
        squares = np.concatenate([points, sizes, one], axis=2) @ others.swapaxes(1, 2)
        reach = 2 * _HALF_STEP * np.sqrt((rates * rates).sum(axis=0).max())
        most = (distance + reach) ** 2 + _ROUND_OFF * sizes.max()
        return self._encounters(~(squares > most))  # what is no number counts

    def least_squares(
        self,
        encounters: NDArray,
        amplitudes: NDArray,
        forces: NDArray,
        levers: NDArray,
        **cables: float,
    ) -> NDArray:
        """The least squared distances (a, m), m², of encounters (3, m), for constant A.

        Args:
            encounters: (3, m)
            amplitudes: (a,), N.
            forces: (n, 3), N, those of `OrbitTerms` at an instant.
            levers: (n, 3), m, of the attachments.
            cables: their `rest_length` in m and `compliance` in m/N.
        """
        phases, first, second = encounters
        size = max(1, _MOST_DISTANCES // max(len(first), 1))
        found = []
        for start in range(0, len(amplitudes), size):
            part = amplitudes[start : start + size]
            if 2 * len(first) < _PHASES * self._count:  # few: no other carriers' orbits
                both = np.array([first, second])
                orbits = self._orbits(part, forces, levers, (phases, both), **cables)
                gaps, gap_rates = (values[..., 0, :] - values[..., 1, :] for values in orbits)
            else:
                orbits = self._orbits(part, forces, levers, self._all, **cables)
                gaps, gap_rates = (
                    values[..., phases, first] - values[..., phases, second] for values in orbits
                )
            found.append(nearest_squares(gaps, gap_rates, _HALF_STEP))
        return np.concatenate(found)

    def _encounters(self, chosen: NDArray) -> NDArray:
        """Encounters (3, m) of chosen pairs (phases, n, n), each pair once."""
        numbers = np.flatnonzero(chosen & self._is_once)
        return np.array(np.unravel_index(numbers, chosen.shape))

    def _orbits(
        self,
        amplitudes: NDArray,
        forces: NDArray,
        levers: NDArray,
        places: tuple[NDArray, NDArray],
        **cables: float,
    ) -> tuple[NDArray, NDArray]:
        """Positions and rates by the phase (3, a, p, m) at phases and of carriers by their numbers.

        Both numbers of `places` broadcast to (p, m).
        """
        phases, carriers = places
        return orbit_positions(
            amplitudes[:, None, None],
            forces.T[:, None, carriers],
            levers.T[:, None, carriers],
            self._directions[:, None, phases, carriers],
            self._direction_rates[:, None, phases, carriers],
            **cables,
        )
