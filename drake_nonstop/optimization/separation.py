"""The constraint that keeps carriers apart over a whole orbit.

The distances depend on A, not on ξ. An encounter is a pair of carriers at a phase. There are
n (n − 1)/2 times 36 of them, of which a few decide: the search knows those alone, and learns of
others where its answer violates them. An answer that violates none is that to the whole problem.
"""

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.nonstop import nearest_squares, orbit_positions
from drake_nonstop.mechanics.planned_orbit import orbit_directions
from drake_nonstop.optimization.constraints import FEASIBILITY_TOLERANCE

_PHASES = 36  # of a whole turn, at which carriers are kept apart
_HALF_STEP = np.pi / _PHASES  # rad
_MOST_LEARNED = 16  # encounters at a time
_NEAR = 1.05  # times the least separation: close enough to know of
_MOST_DISTANCES = 2**20  # at a time: bounds the memory
_ROUND_OFF = 1e-12  # relative, of squared distances from scalar products
# |a − b|² of two vectors [a, 1, |a|²], as a bilinear form.
_SQUARE_OF_DIFFERENCE = np.diag([-2.0, -2.0, -2.0, 0.0, 0.0])
_SQUARE_OF_DIFFERENCE[3, 4] = _SQUARE_OF_DIFFERENCE[4, 3] = 1.0


class SeparationConstraint:
    """What all updates share.

    Args:
        min_separation: m, of any two carriers.
        axes: p and q (n, 3) of `mechanics.nonstop.orbit_axes`.
    """

    def __init__(self, min_separation: float, axes: tuple[NDArray, NDArray]):
        self.min_separation = min_separation
        u, along, _ = orbit_directions(axes, 2 * np.pi * np.arange(_PHASES) / _PHASES)
        # (3, phases, n) each
        self.directions, self.direction_rates = (
            np.ascontiguousarray(np.moveaxis(part, -1, 0)) for part in (u, along)
        )


class Separation:
    """The constraint in one update, and the encounters that the search knows.

    Args:
        constraint: what all updates share.
        forces: f₀ (n, 3), N, of `OrbitTerms`.
        levers: (n, 3), m, likewise.
        rest_length: m, of the cables.
        compliance: m/N, of the cables.
    """

    def __init__(
        self,
        constraint: SeparationConstraint,
        forces: NDArray,
        levers: NDArray,
        *,
        rest_length: float,
        compliance: float,
    ):
        self._constraint = constraint
        self._cables = {"rest_length": rest_length, "compliance": compliance}
        self._forces, self._levers = forces.T.copy(), levers.T.copy()
        self._scans: dict[float, tuple[float, NDArray]] = {}  # by amplitude
        self._known = np.zeros((3, 0), int)  # phases, and carriers twice
        self._known_terms: tuple[NDArray, ...] = ()
        self._last: tuple[NDArray | None, NDArray] = None, np.zeros(0)

    def worst_margin(self, amplitude: float) -> float:
        """The margin of the closest encounter at an amplitude (N); inf where none is violated."""
        return self._scan(amplitude)[0]

    @property
    def has_known(self) -> bool:
        """Whether an encounter is known."""
        return bool(self._known_terms)

    def known_margins(self, amplitudes: NDArray) -> NDArray:
        """The worst margin (k,) of the known encounters at amplitudes (k,), N; inf if none is."""
        if amplitudes is not self._last[0]:
            self._last = amplitudes, self._known_margins(amplitudes)
        return self._last[1]

    def learns_from(self, amplitude: float) -> bool:
        """Whether the closest encounter at an amplitude (N) is violated and was not known.

        From now on it is known, as are others that are about as close.
        """
        is_kept = self.worst_margin(amplitude) >= -FEASIBILITY_TOLERANCE
        return not is_kept and self.learn_near(amplitude)

    def learn_near(self, amplitude: float) -> bool:
        """Learns of the closest encounters at an amplitude (N); whether the first of them is new.

        Those that are far from being violated do not count.
        """
        closest = self._scan(amplitude)[1]
        if closest.shape[1] == 0 or (self._known == closest[:, :1]).all(axis=0).any():
            return False
        self._known = np.unique(np.concatenate([self._known, closest], axis=1), axis=1)
        phases, first, second = self._known
        directions = self._constraint.directions, self._constraint.direction_rates
        pairs = np.stack([first, second])
        self._known_terms = (
            self._forces[:, pairs, None],
            self._levers[:, pairs, None],
            *(terms[:, phases, pairs][..., None] for terms in directions),
        )
        self._last = None, self._last[1]
        return True

    def _known_margins(self, amplitudes: NDArray) -> NDArray:
        if not self._known_terms:
            return np.full(len(amplitudes), np.inf)
        forces, levers, directions, direction_rates = self._known_terms
        positions, rates = orbit_positions(
            amplitudes, forces, levers, directions, direction_rates, **self._cables
        )  # (3, 2, encounters, k)
        return self._margins(positions[:, 0] - positions[:, 1], rates[:, 0] - rates[:, 1]).min(
            axis=0
        )

    def _margins(self, gaps: NDArray, gap_rates: NDArray) -> NDArray:
        squares = nearest_squares(gaps, gap_rates, _HALF_STEP)
        return squares / self._constraint.min_separation**2 - 1

    def _scan(self, amplitude: float) -> tuple[float, NDArray]:
        """The worst margin at an amplitude, and the closest encounters (3, m); see above."""
        if amplitude in self._scans:
            return self._scans[amplitude]
        constraint = self._constraint
        with np.errstate(divide="ignore", invalid="ignore"):
            positions, rates = orbit_positions(
                amplitude,
                self._forces[:, None],
                self._levers[:, None],
                constraint.directions,
                constraint.direction_rates,
                **self._cables,
            )  # (3, phases, n)
        close = _close_encounters(positions, rates, _NEAR * constraint.min_separation)
        worst = np.inf if np.isfinite(positions.sum()) else np.nan
        if worst == np.inf and close.shape[1] > 0:
            phases, first, second = close
            margins = self._margins(
                positions[:, phases, first] - positions[:, phases, second],
                rates[:, phases, first] - rates[:, phases, second],
            )
            closest = np.argsort(margins, kind="stable")[:_MOST_LEARNED]
            least, close = float(margins[closest[0]]), close[:, closest]
            worst = least if least < 0 else np.inf
        self._scans[amplitude] = worst, close
        return worst, close


def _close_encounters(positions: NDArray, rates: NDArray, distance: float) -> NDArray:
    """Encounters (3, m) of carriers (3, phases, n); the closest is among them if below `distance`.

    Squared distances of all pairs at a phase are a product of matrices. The orbits' tangents
    shorten a distance by no more than the lengths of both within half a step.
    """
    phase_count, count = positions.shape[1:]
    squares = (positions * positions).sum(axis=0)
    slack = _ROUND_OFF * squares.max()
    reach = 2 * _HALF_STEP * np.sqrt((rates * rates).sum(axis=0).max())
    factors = np.empty((phase_count, 5, count))
    factors[:, :3] = positions.transpose(1, 0, 2)
    factors[:, 3] = 1
    factors[:, 4] = squares
    step = max(1, _MOST_DISTANCES // count**2)
    found = []
    for start in range(0, phase_count, step):
        some = factors[start : start + step]
        distance_squares = ((some.swapaxes(1, 2) @ _SQUARE_OF_DIFFERENCE) @ some).reshape(
            len(some), -1
        )
        distance_squares[:, :: count + 1] = np.inf
        nearest = np.sqrt(max(distance_squares.min(), 0.0) + slack)
        limit = (min(nearest, distance) + reach) ** 2 + slack
        if nearest**2 <= limit + slack:
            close = np.flatnonzero(distance_squares <= limit)
            phases, pairs = np.divmod(close, count * count)
            first, second = np.divmod(pairs, count)
            found.append(np.stack([phases + start, first, second])[:, first < second])
    return np.concatenate(found, axis=1) if found else np.zeros((3, 0), int)
