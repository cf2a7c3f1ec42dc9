"""Internal-force patterns: a scenario's entry that all blocks with λ share.

| config | m | the force that cable i has beside its share of the wrench |
| --- | --- | --- |
| `HamiltonianCycle` | n | of opposite forces along the edges of a cycle, those of its two edges |
| `Carousel` | 2 | A (cos(θ − β_i), sin(θ − β_i), 0) |
| `SpreadCarousel` | 2 | the same and C r_i |
| `EllipticCarousel` | 2 | C r_i and an ellipse that leans |
| `ConstantSpread` | 1 | C r_i alone |

r_i is outward and β_i its angle. A config makes N₀, φ and f̃⁰ (see `mechanics.internal_force`) for
given attachments; any class with such a `make` is one.
"""

import math
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.grasp import grasp_matrix
from drake_nonstop.mechanics.internal_force import (
    elliptic_carousel,
    even_phases,
    hamiltonian_cycle,
    orbit_axes,
    orbit_forces,
    spread,
    without_wrench,
)
from drake_nonstop.mechanics.taylor import Quantity
from drake_nonstop.validation import (
    StrictFields,
    checked,
    fulfilling,
    non_negative,
    number_with,
    positive,
    require,
    require_array,
    require_ranges,
    whole,
)

_CIRCLE = [0.0, -math.pi / 2]  # rad, phases of two forces that rotate together
_MIN_SINE = 1e-3  # of an angle that counts as different from zero


@dataclass(frozen=True)
class InternalForcePattern:
    """N₀ (3n, m), φ (m,) in rad and f̃⁰ (3n,) in N, in the load frame."""

    basis: NDArray
    phases: NDArray
    offset: NDArray

    def forces(self, angle: Quantity, amplitude: Quantity) -> Quantity:
        """N₀ λ (..., n, 3), N, in L, at θ in rad and A in N, (..., 1) each."""
        return orbit_forces(orbit_axes(self.basis, self.phases), angle, amplitude)

    @property
    def is_constant(self) -> bool:
        """Whether there is no force but the offset."""
        return not np.any(self.basis)


class _Pattern(StrictFields):
    """A pattern that is checked before its forces are made."""

    has_directions: ClassVar[bool] = True  # each attachment has one, from the middle of all

    def make(self, attachments: NDArray) -> InternalForcePattern:
        """The pattern for attachments (n, 3) in L.

        Raises:
            ScenarioError: a field is out of its range or of another shape, the attachments do not
                suit the pattern, or the force in a cable would stop its carrier.
        """
        require_ranges("pattern", self)
        meaning = "one position per cable, in L"
        attachments = require_array("attachments", attachments, [None, 3], meaning)
        radii = np.linalg.norm((attachments - attachments.mean(axis=0))[:, :2], axis=1)
        require(
            not self.has_directions or np.all(radii > 1e-6 * np.max(radii)),
            "system.attachments",
            attachments.tolist(),
            "one is in the middle of all, so that a carousel has no direction for its cable; move "
            "it, or give another pattern",
        )
        return self._forces(attachments)

    def _forces(self, attachments: NDArray) -> InternalForcePattern:
        """The forces for attachments that have been checked."""
        raise NotImplementedError


@dataclass(kw_only=True)
class HamiltonianCycleConfig(_Pattern):
    """The paper's pattern: opposite forces along the edges of a closed cycle, m = n.

    Neighbouring edges may not be collinear, nor neighbouring phases coincide modulo π: a carrier
    would then stop twice a turn.
    """

    has_directions = False

    phases: list[float] = field(default_factory=list)  # rad, n of them; none: 2π (k-1)/n

    def _forces(self, attachments: NDArray) -> InternalForcePattern:
        n, shown = len(attachments), attachments.tolist()
        edges = attachments - np.roll(attachments, -1, axis=0)
        lengths = np.linalg.norm(edges, axis=1)
        remedy = "give neighbouring cables different attachment points"
        require(np.all(lengths > 1e-9 * np.max(lengths)), "system.attachments", shown, remedy)
        phases = even_phases(n)
        if self.phases:
            phases = require_array(
                "pattern.phases", self.phases, [n], "a phase for each cable; [] for equal steps"
            )
        return InternalForcePattern(hamiltonian_cycle(attachments), phases, np.zeros(3 * n))


class _Ellipses(_Pattern):
    """Forces whose ends move on ellipses about a constant outward pull, m = 2.

    A row of the table above is such a config: what is no field of it is as here.
    """

    spread: float = 0.0  # N
    phase_turns: int = -2
    radial: float = 1.0
    tangential: float = 1.0
    vertical: float = 0.0

    def _forces(self, attachments: NDArray) -> InternalForcePattern:
        n, turns = len(attachments), self.phase_turns
        suitable = self.suitable_turns(n)
        remedy = f"with {n} cables the forces would have a net wrench on the load; give "
        remedy += " or ".join(map(str, suitable)) + f" (modulo {n})" if suitable else _CIRCULAR
        require(turns % n in suitable, "pattern.phase_turns", turns, remedy)
        forces = elliptic_carousel(attachments, phase_turns=turns, **self._sizes)
        outward = self.spread * spread(attachments)
        return InternalForcePattern(without_wrench(attachments, forces), np.array(_CIRCLE), outward)

    @property
    def _sizes(self) -> dict[str, float]:
        return {name: getattr(self, name) for name in ("radial", "tangential", "vertical")}

    def suitable_turns(self, n: int) -> list[int]:
        """The numbers of turns, modulo n, whose forces on n attachments have no wrench."""
        angles = 2 * np.pi * np.arange(n) / n
        polygon = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
        limit, found = 1e-9 * max(map(abs, self._sizes.values())), []
        for turns in range(n):
            forces = elliptic_carousel(polygon, phase_turns=turns, **self._sizes)
            if np.all(np.abs(grasp_matrix(polygon) @ forces) <= limit):
                found.append(turns)
        return found


@dataclass(kw_only=True)
class CarouselConfig(_Ellipses):
    """Forces that rotate together: the carriers keep apart at constant speed, cables cross.

    On a regular polygon every carrier flies a circle above its attachment, all at the same speed;
    for other attachments the pattern is projected on the null space.
    """


@dataclass(kw_only=True)
class SpreadCarouselConfig(_Ellipses):
    """The carousel with a constant outward pull: neither carriers nor cables meet.

    Each carrier circles about an axis of its own that leans outward. Cables do not cross as long as
    the amplitude A stays below `spread`: bound it there (`optimization_layer.amplitude_bounds`).
    """

    spread: float = positive(2.5)  # N, the constant outward pull C of every cable


_MAX_TURNS = 100
_CIRCULAR = "vertical = 0 and radial = tangential"
_finite = number_with(math.isfinite, "give a finite number")


@dataclass(kw_only=True)
class EllipticCarouselConfig(_Ellipses):
    """Orbits that lean and climb: amplitudes of their own along the radius, the tangent and e₃.

    m = 2. With β_i the angle of attachment i, r_i outward, t_i tangential and φ_i = θ + κ β_i,
    cable i pulls with

        (C + A_r cos φ_i) r_i + A_t sin φ_i t_i + (f₀ − B cos φ_i) e₃,

    f₀ its share of the weight. A_r, A_t and B are `radial`, `tangential` and `vertical` times the
    amplitude A of the parameters: with A = 1 N they are in N. `SpreadCarousel` is κ = −2 with
    A_r = A_t.

    On regular polygons of n attachments the forces have no wrench where A_t ≠ 0 and κ ≢ 0 (modulo
    n), A_r ≠ −A_t needs κ ≢ −1, A_r ≠ A_t needs κ ≢ 1, and B ≠ 0 needs κ ≢ ±1. For other
    attachments they are projected on the null space.
    """

    spread: float = non_negative(2.5)  # N, the constant outward pull C of every cable
    # κ: turns of the phase in one round of the attachments
    phase_turns: int = whole(-2, -_MAX_TURNS, _MAX_TURNS)
    radial: float = checked(1.0, _finite)  # A_r / A
    # A_t / A, and not 0: a carrier that swings on a line would stop
    tangential: float = fulfilling(
        1.0, lambda size: size != 0 and math.isfinite(size), "give a finite number other than 0"
    )
    vertical: float = checked(0.0, _finite)  # B / A


@dataclass(kw_only=True)
class ConstantSpreadConfig(_Pattern):
    """A constant outward pull alone, for a load that turns, and its carriers with it.

    m = 1, a coordinate without any force. The carriers keep their places above the load, and move
    because it turns: `load_trajectory: !SteadyTurn`. There is no amplitude: that of the
    `optimization_layer`, which has to be `ConstantParameters`, is 0.
    """

    spread: float = positive(2.5)  # N, the constant outward pull C of every cable

    def _forces(self, attachments: NDArray) -> InternalForcePattern:
        nothing, outward = np.zeros((attachments.size, 1)), self.spread * spread(attachments)
        return InternalForcePattern(nothing, np.zeros(1), outward)


def check_pattern(
    pattern: InternalForcePattern, attachments: NDArray, gravity_forces: NDArray
) -> None:
    """Checks the conditions on every pattern.

    `gravity_forces` (n, 3) are the shares of a resting, level load's weight, in L. What is refused
    stops a carrier at any amplitude A, with cables of any length.

    Raises:
        ScenarioError: the pattern has a net wrench, or some carrier would stop: the
            force in its cable moves on a line, or in a plane through the attachment. A pattern
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
    axes = np.stack([constant, *orbit_axes(pattern.basis, pattern.phases)], axis=1)
    mean, *ellipse = np.linalg.norm(axes, axis=2).T
    sizes = mean * (ellipse[0] ** 2 + ellipse[1] ** 2) / 2  # whichever phase the axes belong to
    for i in np.flatnonzero(np.abs(np.linalg.det(axes)) <= _MIN_SINE * sizes):
        require(
            False,
            "pattern.phases",
            pattern.phases.tolist(),
            f"cable {i + 1} swings in a plane or not at all, so its carrier would stop; "
            "choose other phases, sizes or attachments, or another basis",
        )
