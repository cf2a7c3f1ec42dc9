"""Internal-force patterns: a scenario's entry that all blocks with λ share.

A pattern config makes N₀, φ and f̃⁰ (see `mechanics.internal_force`) for given attachments. Any
class with such a `make` is one.
"""

import itertools
import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.grasp import grasp_matrix
from drake_nonstop.mechanics.internal_force import (
    carousel,
    elliptic_carousel,
    even_phases,
    hamiltonian_cycle,
    orbit_axes,
    spread,
    without_wrench,
)
from drake_nonstop.validation import (
    StrictFields,
    checked,
    non_negative,
    number_with,
    positive,
    require,
    require_array,
    require_ranges,
    whole,
)

_MIN_SINE = 1e-3  # of an angle that counts as different from zero
_INSTANTS = 2048  # of a turn of the highest harmonic, at which rates of forces are compared
# Of a force's fastest rate, below which one counts as zero. Where a rate is zero, one at an instant
# is at most π / 2048 of the fastest, by Bernstein's inequality.
_SLOWEST = 2e-3


@dataclass(frozen=True)
class InternalForcePattern:
    """N₀ (3n, m), φ (m,) in rad and f̃⁰ (3n,) in N, in the load frame.

    `harmonics` are the orders h (m,) of the coordinates, λ_k = A cos(h_k θ + φ_k); none: all 1.
    """

    basis: NDArray
    phases: NDArray
    offset: NDArray
    harmonics: tuple[int, ...] = ()

    @property
    def orders(self) -> NDArray:
        """The orders h (m,) of the harmonics."""
        return np.array(self.harmonics or [1.0] * len(self.phases), dtype=float)

    @property
    def is_constant(self) -> bool:
        """Whether there is no force but the offset."""
        return not np.any(self.basis)


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

    spread: float = positive(2.5)  # N, the constant outward pull C of every cable

    def make(self, attachments: NDArray) -> InternalForcePattern:
        """The pattern for attachments (n, 3) in L.

        Raises:
            ScenarioError: the spread is not positive, or as `check_pattern`.
        """
        require_ranges("pattern", self)
        attachments = _checked(attachments)
        wheel = CarouselConfig().make(attachments)
        return InternalForcePattern(wheel.basis, wheel.phases, self.spread * spread(attachments))


_MAX_TURNS = 100
_MAX_SIZE = 1e6
_check_size = number_with(
    lambda size: abs(size) <= _MAX_SIZE, f"give a number of at most {_MAX_SIZE:g}"
)
_ELLIPSE = ("radial", "tangential", "vertical", "second_harmonic")  # whose sizes are times A


@dataclass(kw_only=True)
class EllipticCarouselConfig(StrictFields):
    """Orbits that lean and climb: amplitudes of their own along the radius, the tangent and e₃.

    m = 2, or 4 with a second harmonic. With β_i the angle of attachment i, r_i outward, t_i
    tangential and φ_i = θ + κ β_i, cable i pulls with

        (C + A_r cos φ_i) r_i + A_t sin φ_i t_i + (f₀ − B cos φ_i) e₃,

    f₀ its share of the weight. A_r, A_t and B are `radial`, `tangential` and `vertical` times the
    amplitude A of the parameters: with A = 1 N they are in N. `SpreadCarousel` is κ = −2 with
    A_r = A_t. `second_harmonic` h makes the ground speed differ between the directions of flight,
    as in wind: h A e^{2i(φ_i + β_i)} is added to the horizontal force, in the complex plane. Well
    below half of A_r/A and A_t/A it lets no carrier stop; where it is so large that a force stands
    still for an instant, it is refused, see `check_pattern`.

    On regular polygons of n attachments the forces have no wrench where A_t ≠ 0 and κ ≢ 0 (modulo
    n), A_r ≠ −A_t needs κ ≢ −1, A_r ≠ A_t needs κ ≢ 1, B ≠ 0 needs κ ≢ ±1, and h ≠ 0 needs
    2κ ≢ −2 and 2κ ≢ −1. For other attachments they are projected on the null space.
    """

    spread: float = non_negative(2.5)  # N, the constant outward pull C of every cable
    # κ: turns of the phase in one round of the attachments
    phase_turns: int = whole(-2, -_MAX_TURNS, _MAX_TURNS)
    radial: float = checked(1.0, _check_size)  # A_r / A
    tangential: float = checked(  # A_t / A
        1.0,
        _check_size,
        number_with(
            lambda size: size != 0,
            "give another number than 0: a carrier that swings on a line would stop",
        ),
    )
    vertical: float = checked(0.0, _check_size)  # B / A
    second_harmonic: float = non_negative(0.0, _check_size)  # h: its horizontal force / A
    # rad, of the flight that it makes the fastest, from x to y in L: that of the wind
    second_harmonic_direction: float = checked(0.0, _check_size)

    def make(self, attachments: NDArray) -> InternalForcePattern:
        """The pattern for attachments (n, 3) in L.

        Raises:
            ScenarioError: a number is out of its range, or the forces would have a wrench on a
                regular polygon of n attachments, or the second harmonic makes one of them stand
                still, or as `check_pattern`.
        """
        attachments = _checked(attachments)
        _require_directions(attachments)
        require_ranges("pattern", self)
        n, turns = len(attachments), self.phase_turns
        sizes = {name: getattr(self, name) for name in _ELLIPSE}
        if not self._suits(n, turns, sizes):
            require(False, "pattern.phase_turns", turns, _remedy(self, n, sizes))
        basis, phases = self._forces(attachments, turns, sizes), np.array([0.0, -np.pi / 2] * 2)
        count = 4 if self.second_harmonic > 0 else 2
        pattern = InternalForcePattern(
            without_wrench(attachments, basis[:, :count]),
            phases[:count],
            self.spread * spread(attachments),
            (1, 1, 2, 2) if count == 4 else (),
        )
        cable, harmonic = _standing_force(pattern), self.second_harmonic
        if cable is not None:
            stops = f"the force in cable {cable} stands still, so that its carrier would stop"
            remedy = _moving_remedy(pattern, harmonic)
            require(False, "pattern.second_harmonic", harmonic, f"{stops}; {remedy}")
        return pattern

    def _forces(self, attachments: NDArray, turns: int, sizes: dict[str, float]) -> NDArray:
        return elliptic_carousel(
            attachments,
            phase_turns=turns,
            second_harmonic_direction=self.second_harmonic_direction,
            **sizes,
        )

    def _suits(self, n: int, turns: int, sizes: dict[str, float]) -> bool:
        """Whether such forces on a regular polygon of n attachments have no wrench."""
        angles = 2 * np.pi * np.arange(n) / n
        polygon = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
        forces = self._forces(polygon, turns % n, sizes)
        limit = 1e-9 * np.max(np.abs(forces))
        return bool(np.all(np.abs(grasp_matrix(polygon) @ forces) <= limit))

    def suitable_turns(self, n: int, **sizes: float) -> list[int]:
        """The numbers of turns, modulo n, for n attachments and `sizes` such as vertical = 0."""
        given = {name: getattr(self, name) for name in _ELLIPSE} | sizes
        return [turns for turns in range(n) if self._suits(n, turns, given)]


def _remedy(config: EllipticCarouselConfig, n: int, sizes: dict[str, float]) -> str:
    """Least change that makes elliptic carousels of n attachments possible."""
    changes: list[tuple[dict[str, float], str]] = [
        ({}, ""),
        ({"second_harmonic": 0.0}, " with second_harmonic = 0"),
        ({"vertical": 0.0}, " with vertical = 0"),
        ({"vertical": 0.0, "second_harmonic": 0.0}, " with vertical = second_harmonic = 0"),
    ]
    round_ = {"vertical": 0.0, "second_harmonic": 0.0, "radial": sizes["tangential"]}
    changes.append((round_, " with radial = tangential and vertical = second_harmonic = 0"))
    for change, words in changes:
        turns = config.suitable_turns(n, **change)
        if turns:
            numbers = " or ".join(map(str, turns))
            return (
                f"with {n} cables the forces would have a net wrench on the load; give {numbers} "
                f"(modulo {n}){words}"
            )
    raise AssertionError("a circle suits every number of cables")


def _moving_remedy(pattern: InternalForcePattern, harmonic: float) -> str:
    """Remedy for a force that stands still in an elliptic carousel with that second harmonic."""
    ratios = []  # of the slowest rate of the first order to the fastest one of the second
    for ellipses in zip(*_ellipses(pattern), strict=True):
        (_, least), (most, _) = (np.linalg.svd(axes, compute_uv=False) for axes in ellipses)
        ratios.append(least / (2 * most))
    if min(ratios) < _MIN_SINE:
        return "give another number, and another radial or vertical one than 0"
    return f"give at most {0.9 * harmonic * min(ratios):.2g}"


@dataclass(kw_only=True)
class ConstantSpreadConfig(StrictFields):
    """A constant outward pull alone, for a load that turns, and its carriers with it.

    m = 1, a coordinate without any force. The carriers keep their places above the load, and move
    because it turns: `load_trajectory: !SteadyTurn`. There is no amplitude: that of the
    `optimization_layer`, which has to be `ConstantParameters`, is 0.
    """

    spread: float = positive(2.5)  # N, the constant outward pull C of every cable

    def make(self, attachments: NDArray) -> InternalForcePattern:
        """The pattern for attachments (n, 3) in L.

        Raises:
            ScenarioError: the spread is not positive, or an attachment is in the middle of all.
        """
        require_ranges("pattern", self)
        attachments = _checked(attachments)
        _require_directions(attachments)
        nothing = np.zeros((attachments.size, 1))
        return InternalForcePattern(nothing, np.zeros(1), self.spread * spread(attachments))


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

    `gravity_forces` (n, 3) are the shares of a resting, level load's weight, in L. What is refused
    stops a carrier at any amplitude A. With harmonics of several orders and vertical internal
    forces a carrier may also stop at some A only, where its force changes along itself: that is
    left to the speeds of a run, since a pattern does not know A.

    Raises:
        ScenarioError: the pattern has a net wrench, or some carrier would stop: the
            force in its cable moves on a line, or in a plane through the attachment, or stands
            still for an instant, as harmonics of several orders may make it. A pattern
            without any internal force but its offset is for a load that turns, and passes.
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
    if pattern.is_constant:
        return
    constant = gravity_forces + pattern.offset.reshape(-1, 3)
    axes = [constant[:, None], *_ellipses(pattern)]
    for i, of_cable in enumerate(zip(*axes, strict=True)):
        require(
            _span_space(np.concatenate(of_cable)),
            "pattern.phases",
            pattern.phases.tolist(),
            f"cable {i + 1} swings in a plane or not at all, so its carrier would stop; "
            "choose other phases or another basis, or other amplitudes",
        )
    cable = _standing_force(pattern)
    require(
        cable is None,
        "pattern.harmonics",
        pattern.harmonics,
        f"the force in cable {cable} stands still, so that its carrier would stop; "
        "choose other phases, or other amplitudes of one order",
    )


def _ellipses(pattern: InternalForcePattern) -> list[NDArray]:
    """Two conjugate axes (n, 2, 3) of each cable's ellipse, in L, for each order that there is."""
    found = []
    for order in np.unique(pattern.orders):
        columns = pattern.orders == order
        axes = orbit_axes(pattern.basis[:, columns], pattern.phases[columns])
        found.append(np.stack(axes, axis=1))
    return found


def _standing_force(pattern: InternalForcePattern) -> int | None:
    """The number of the first cable whose force stands still for an instant; None: no one's does.

    Of one order they do so on a line only, which is not looked for.
    """
    orders = pattern.orders
    if len(np.unique(orders)) < 2:
        return None
    count = math.ceil(_INSTANTS * np.max(np.abs(orders)))
    instants = np.linspace(0, 2 * np.pi, count, endpoint=False)
    rates = (orders * np.sin(instants[:, None] * orders + pattern.phases)) @ pattern.basis.T
    speeds = np.linalg.norm(rates.reshape(count, -1, 3), axis=2)
    slow = np.flatnonzero(speeds.min(axis=0) < _SLOWEST * speeds.max(axis=0))
    return int(slow[0]) + 1 if len(slow) > 0 else None


def _span_space(vectors: NDArray) -> bool:
    """Whether vectors (k, 3) span space: the volume of some three is not small for their size."""
    for three in itertools.combinations(vectors, 3):
        size = np.prod([np.linalg.norm(vector) for vector in three])
        if abs(np.linalg.det(np.stack(three))) > _MIN_SINE * size:
            return True
    return False
