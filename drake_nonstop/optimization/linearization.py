"""The constraints of a plan about given coefficients, to first order."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.planned_orbit import PlannedOrbit

_NEIGHBOURS = (-1, 1, 2)  # of an instant, which tell how low a speed is between two


class ConstraintBlock(NamedTuple):
    """Constraints that lie side by side, in arrays that broadcast to one shape."""

    instants: NDArray  # the rows of the coefficients' Jacobians
    slacks: NDArray  # the numbers of the slacks
    names: NDArray  # of `missed_limits`; "": of none
    # Along which neighbours are: 0 at the instants before and after, 1 at the phases of a whole
    # orbit; None: there are none.
    axis: int | None


class ConstraintLayout(NamedTuple):
    """Where the margins (r,) of blocks belong, one after the other."""

    instants: NDArray  # as of `ConstraintBlock`, flat
    slacks: NDArray
    names: NDArray
    before: NDArray  # the numbers of the neighbours; -1: there is none
    after: NDArray
    widths: NDArray  # from an instant to the next, where these are neighbours; else 0

    @classmethod
    def of_blocks(cls, blocks: Iterable[ConstraintBlock]) -> "ConstraintLayout":
        """The layout of blocks one after the other."""
        found, start = [], 0
        for *own, axis in blocks:
            parts = np.broadcast_arrays(*own)
            shape, size = parts[0].shape, parts[0].size
            numbers = start + np.arange(size).reshape(shape)
            before = after = np.full(shape, -1)
            if axis is not None:
                before, after = (np.roll(numbers, shift, axis) for shift in (1, -1))
            if axis == 0:
                before[:1], after[-1:] = -1, -1
            widths = np.full(size, shape[1] if axis == 0 else 0)
            found.append([*(part.ravel() for part in (*parts, before, after)), widths])
            start += size
        return cls(*map(np.concatenate, zip(*found, strict=True)))


@dataclass(frozen=True, eq=False)
class Linearization:
    """The constraints about a plan, as margins and their gradients.

    A margin is negative where its constraint is not fulfilled without slack. Speeds dip between
    instants, too: where the cubic Hermite spline through the margins has a minimum between two
    instants, the margin at the first of them is that minimum. It is a mean of four neighbours, with
    weights that are fixed to first order, since there the spline does not change with its place.
    """

    margins: NDArray  # (r,)
    gradients: NDArray  # (6, r), by the entries of the `PlannedOrbit` at the instant
    weights: NDArray  # (3, r), of the same constraint at the `_NEIGHBOURS`
    jacobians: PlannedOrbit  # matrices (k, N), of its entries by the coefficients of ξ, or of A
    layout: ConstraintLayout
    slowest: float  # m/s, the least speed at the instants

    def changes(self, step: NDArray) -> NDArray:
        """Change of the margins (r,) by a step (2, N) of the coefficients, to first order."""
        of_instants = np.stack([rows @ step[i // 3] for i, rows in enumerate(self.jacobians)])
        changes = (self.gradients * of_instants[:, self.layout.instants]).sum(axis=0)
        found: NDArray = changes.copy()
        for weights, shift in zip(self.weights, _NEIGHBOURS, strict=True):
            dips = np.flatnonzero(weights)
            neighbours = changes[dips + shift * self.layout.widths[dips]]
            found[dips] += weights[dips] * (neighbours - changes[dips])
        return found

    def jacobian(self, chosen: NDArray, fixed: int = 0) -> NDArray:
        """The rows of chosen margins, by all but the first coefficients of ξ, then of A."""
        found = self._rows(chosen, fixed)
        own = found.copy()
        for weights, shift in zip(self.weights, _NEIGHBOURS, strict=True):
            dips = np.flatnonzero(weights[chosen])
            numbers = chosen[dips]
            neighbours = self._rows(numbers + shift * self.layout.widths[numbers], fixed)
            found[dips] += weights[chosen[dips], None] * (neighbours - own[dips])
        return found

    def _rows(self, chosen: NDArray, fixed: int) -> NDArray:
        gradients, instants = self.gradients[:, chosen, None], self.layout.instants[chosen]
        parts = [
            g * rows[instants, fixed:] for g, rows in zip(gradients, self.jacobians, strict=True)
        ]
        return np.hstack([parts[0] + parts[1] + parts[2], parts[3] + parts[4] + parts[5]])

    def dips(self, margins: NDArray, largest: float) -> NDArray:
        """The numbers of margins of at most `largest` that are the least of their neighbours.

        `margins` (r,) are about the same plan or of a step from it.
        """
        padded = np.append(margins, np.inf)  # what has no neighbour has one of -1
        is_dip = (margins <= padded[self.layout.before]) & (margins < padded[self.layout.after])
        return np.flatnonzero(is_dip & (margins <= largest))

    def with_neighbours(self, chosen: NDArray, margins: NDArray, largest: float) -> NDArray:
        """The numbers of chosen margins, and of those at the instants next to them.

        Of the latter those that are at most `largest`.
        """
        own = chosen[self.layout.widths[chosen] > 0]
        near = np.concatenate([self.layout.before[own], self.layout.after[own]])
        near = near[near >= 0]
        return np.concatenate([chosen, near[margins[near] <= largest]])


def with_dips(margins: NDArray) -> tuple[NDArray, NDArray]:
    """Margins (k, m) with the minima of `Linearization`, and the weights (3, k, m)."""
    slopes = (margins[2:] - margins[:-2]) / 2
    instants, columns = np.nonzero((slopes[:-1] < 0) & (slopes[1:] > 0))
    start, end = slopes[instants, columns], slopes[instants + 1, columns]
    instants += 1
    rise = margins[instants + 1, columns] - margins[instants, columns]
    # The root x of the derivative start + b x + a x², which is positive at 1.
    a, b = 3 * (start + end - 2 * rise), 2 * (3 * rise - 2 * start - end)
    x = -2 * start / (b + np.sqrt(b * b - 4 * a * start))
    of_end = x * x * (3 - 2 * x)
    of_start_slope, of_end_slope = x * (1 - x) ** 2, -x * x * (1 - x)
    weights = np.zeros((len(_NEIGHBOURS), *margins.shape))
    weights[:, instants, columns] = (
        -of_start_slope / 2,
        of_end + of_start_slope / 2,
        of_end_slope / 2,
    )
    found = margins.copy()
    here = margins[instants, columns]
    for weight, shift in zip(weights, _NEIGHBOURS, strict=True):
        difference = margins[instants + shift, columns] - here
        found[instants, columns] += weight[instants, columns] * difference
    return found, weights
