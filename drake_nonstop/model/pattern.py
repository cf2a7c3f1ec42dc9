"""Internal-force patterns: a scenario's entry that all blocks with λ share.

A pattern config makes N₀, φ and f̃⁰ (see `mechanics.internal_force`) for given attachments. Any
class with such a `make` is one.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.grasp import grasp_matrix
from drake_nonstop.mechanics.internal_force import (
    carousel,
    ellipse_axes,
    even_phases,
    hamiltonian_cycle,
    spread,
)
from drake_nonstop.validation import StrictFields, require, require_array, require_positive

_MIN_SINE = 1e-3  # of an angle that counts as different from zero


@dataclass(frozen=True)
class InternalForcePattern:
    """N₀ (3n, m), φ (m,) in rad and f̃⁰ (3n,) in N, in the load frame."""

    basis: NDArray
    phases: NDArray
    offset: NDArray


@dataclass(kw_only=True)
class HamiltonianCycleConfig(StrictFields):
    """The paper's pattern: opposite forces along the edges of a closed cycle, m = n."""

    phases: list[float] = field(default_factory=list)  # rad, n of them; none: 2π (k-1)/n

    def make(self, attachments: NDArray) -> InternalForcePattern:
        """The pattern for attachments (n, 3) in L.

        Raises:
            ScenarioError: neighbouring edges are collinear, or neighbouring phases
                coincide modulo π; a carrier would then stop twice a turn.
        """
        attachments = _checked(attachments)
        n = len(attachments)
        edges = attachments - np.roll(attachments, -1, axis=0)
        lengths = np.linalg.norm(edges, axis=1)
        require(
            np.all(lengths > 1e-9 * np.max(lengths)),
            "system.attachments",
            attachments.tolist(),
            "give neighbouring cables different attachment points",
        )
        units = edges / lengths[:, None]
        for i in range(n):
            require(
                np.linalg.norm(np.cross(units[i - 1], units[i])) > _MIN_SINE,
                "system.attachments",
                attachments.tolist(),
                f"the edges of the cycle that meet at attachment {i + 1} are collinear, so "
                "its carrier would stop; move it or reorder the attachments",
            )
        phases = even_phases(n)
        if self.phases:
            phases = require_array("pattern.phases", self.phases, [n], "one phase per cable")
        for k in range(n):
            require(
                abs(np.sin(phases[k] - phases[k - 1])) > _MIN_SINE,
                "pattern.phases",
                phases.tolist(),
                f"neighbouring phases {(k - 1) % n + 1} and {k + 1} coincide modulo pi, so "
                "a carrier would stop; set them apart",
            )
        return InternalForcePattern(hamiltonian_cycle(attachments), phases, np.zeros(3 * n))


@dataclass(kw_only=True)
class CarouselConfig(StrictFields):
    """Forces that rotate together: the carriers keep apart at constant speed, cables cross.

    m = 2. On a regular polygon every carrier flies a circle above its attachment, all at the
    same speed; for other attachments the pattern is projected on the null space.
    """

    def make(self, attachments: NDArray) -> InternalForcePattern:
        """The pattern for attachments (n, 3) in L; raises ScenarioError as `check_pattern`."""
        attachments = _checked(attachments)
        _require_directions(attachments)
        phases = np.array([0.0, -np.pi / 2])
        return InternalForcePattern(carousel(attachments), phases, np.zeros(3 * len(attachments)))


@dataclass(kw_only=True)
class SpreadCarouselConfig(StrictFields):
    """The carousel with a constant outward pull: neither carriers nor cables meet.

    m = 2. Each carrier circles about an axis of its own that leans outward. Cables do not
    cross as long as the amplitude A stays below `spread`: bound it there
    (`optimization_layer.amplitude_bounds`).
    """

    spread: float = 2.5  # N, the constant outward pull C of every cable

    def make(self, attachments: NDArray) -> InternalForcePattern:
        """The pattern for attachments (n, 3) in L.

        Raises:
            ScenarioError: the spread is not positive, or as `check_pattern`.
        """
        require_positive("pattern", spread=self.spread)
        attachments = _checked(attachments)
        wheel = CarouselConfig().make(attachments)
        return InternalForcePattern(wheel.basis, wheel.phases, self.spread * spread(attachments))


def _checked(attachments: Any) -> NDArray:
    """The attachments as an array; raises ScenarioError for what is no (n, 3)."""
    return require_array("attachments", attachments, [None, 3], "one position per cable, in L")


def _require_directions(attachments: NDArray) -> None:
    """Raises ScenarioError if an attachment has no direction from the centre of all."""
    from_centre = (attachments - attachments.mean(axis=0))[:, :2]
    radii = np.linalg.norm(from_centre, axis=1)
    require(
        np.all(radii > 1e-6 * np.max(radii)),
        "system.attachments",
        attachments.tolist(),
        "one is in the middle of all, so that a carousel has no direction for its cable; move "
        "it, or give another pattern",
    )


@dataclass(kw_only=True)
class LinearPatternConfig(StrictFields):
    """A user's pattern: any matrix and offset in the null space, any phases."""

    # N₀, 3n rows of m numbers, in L; none: that of the cycle
    basis: list[list[float]] = field(default_factory=list)
    phases: list[float] = field(default_factory=list)  # φ, m numbers, rad; none: 2π (k-1)/m
    offset: list[float] = field(default_factory=list)  # f̃⁰, 3n numbers, N, in L; none: 0

    def make(self, attachments: NDArray) -> InternalForcePattern:
        """The pattern for attachments (n, 3) in L; raises ScenarioError for wrong shapes."""
        attachments = _checked(attachments)
        rows = 3 * len(attachments)
        basis = hamiltonian_cycle(attachments)
        if self.basis:
            basis = require_array(
                "pattern.basis", self.basis, [rows, None], "3n rows, a column per phase"
            )
        phases = even_phases(basis.shape[1])
        if self.phases:
            columns = [basis.shape[1]]
            phases = require_array("pattern.phases", self.phases, columns, "one per column")
        offset = np.zeros(rows)
        if self.offset:
            offset = require_array("pattern.offset", self.offset, [rows], "3 per cable")
        return InternalForcePattern(basis, phases, offset)


def check_pattern(
    pattern: InternalForcePattern, attachments: NDArray, gravity_forces: NDArray
) -> None:
    """Checks the conditions on every pattern.

    `gravity_forces` (n, 3) are the shares of a resting, level load's weight, in L.

    Raises:
        ScenarioError: the pattern has a net wrench, or some carrier would stop: the
            force in its cable moves on a line, or in a plane through the attachment.
    """
    grasp = grasp_matrix(attachments)
    for name, value in (("basis", pattern.basis), ("offset", pattern.offset)):
        scale = np.max(np.abs(grasp)) * max(1.0, np.max(np.abs(value), initial=0.0))
        require(
            np.max(np.abs(grasp @ value), initial=0.0) < 1e-9 * scale,
            f"pattern.{name}",
            value.tolist(),
            "its forces have a net wrench on the load; project it on the null space of "
            "the grasp matrix",
        )
    constant = gravity_forces + pattern.offset.reshape(-1, 3)
    cosines, sines = ellipse_axes(pattern.basis, pattern.phases)
    for i, axes in enumerate(zip(cosines, sines, constant, strict=True)):
        volume = abs(np.linalg.det(np.stack(axes)))
        size = np.prod([np.linalg.norm(axis) for axis in axes])
        require(
            volume > _MIN_SINE * size,
            "pattern.phases",
            pattern.phases.tolist(),
            f"cable {i + 1} swings in a plane or not at all, so its carrier would stop; "
            "choose other phases or another basis",
        )
