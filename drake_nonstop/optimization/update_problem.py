"""The nonstop problem of one update, in numbers."""

import math
from collections.abc import Callable
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics import nonstop
from drake_nonstop.mechanics.signals import Parameters
from drake_nonstop.optimization.amplitude_intervals import allowed_intervals
from drake_nonstop.optimization.constraints import FEASIBILITY_TOLERANCE
from drake_nonstop.optimization.diagnostics import BOUND
from drake_nonstop.optimization.limits import Of
from drake_nonstop.optimization.search_problem import SearchProblem
from drake_nonstop.optimization.traced_problem import (
    MIN_SPEEDS_FOR_ARRAYS,
    SpeedTerms,
    TracedProblem,
)
from drake_nonstop.optimization.update_data import ModelParameters, UpdateData
from drake_nonstop.systems.tracing import NotFiniteError

_MOST_LEARNED = 16  # encounters at a time
_NEAR = 1.1  # times the least separation: close enough to know of


class UpdateProblem:
    """min cost(x) such that margins(x) ≥ 0, over x = [ξ, A] (2,), in rad/s and N, within `bounds`.

    `traced` is what all updates share.
    """

    def __init__(self, traced: TracedProblem, data: UpdateData):
        self._traced = traced
        if len(data.beliefs) == 0:
            data = data._replace(beliefs=traced.beliefs)
        self.data = data
        self.vector = np.concatenate(data)  # for the functions of `UpdateSolver.functions`
        self.previous = data.previous.copy()
        # The last x, its margins and the least of them: the search has computed the answer's.
        self._last: tuple[NDArray | None, NDArray, float] = (None, self.previous, 0.0)
        self._search_problem: SearchProblem | None = None

    @cached_property
    def beliefs(self) -> ModelParameters:
        """Parameters that the controllers believe."""
        return ModelParameters.view(self.data.beliefs)

    @property
    def bounds(self) -> tuple[NDArray, NDArray]:
        """The lower and upper bounds (2,) of x, within reach at the limits of its rates."""
        return self._traced.bounds(self.previous, self.beliefs)

    @property
    def known_bounds(self) -> tuple[NDArray, NDArray]:
        """`bounds`, with A in the interval next to A⁻ that the known encounters allow, if any."""
        lower, upper = self.bounds
        if self._keeps_apart and self._known_encounters.size > 0:
            start = float(self.previous[1])
            intervals = allowed_intervals(
                self._known_separation_margins, float(lower[1]), float(upper[1]), start
            )
            if intervals:
                distances = [max(low - start, start - high) for low, high in intervals]
                lower[1], upper[1] = intervals[int(np.argmin(distances))]
        return lower, upper

    @property
    def phase_jumps(self) -> bool:
        """Whether the phase jumps with ξ, as `PaperPhase` does, rather than accumulates it."""
        return bool(self.data.phase[1] != 0)

    def cost(self, x: NDArray) -> float:
        """The cost of the step to x."""
        return float(self._traced.cost(x, self.vector)[0][0])

    def margins(self, x: NDArray) -> NDArray:
        """The margins of all constraints at x, in the order of `TracedProblem`; for reading.

        That of the separation is the last.

        Raises:
            NotFiniteError: one is not, such as that of a cable without any tension.
        """
        return self._margins_and_worst(x)[0]

    @property
    def speed_count(self) -> int:
        """How many margins, the first ones, are those of the speed bound."""
        return self._traced.speed_count

    def infeasibility_order(self, margins: NDArray) -> tuple[float, float]:
        """Score of an infeasible point, larger for the better one, see `least_infeasible`."""
        return min(float(margins[: self.speed_count].min()), 0.0), float(margins.min())

    def margins_but_separation(self, x: NDArray) -> NDArray:
        """The margins (r,) at x but for that of the separation."""
        traced = self._traced
        if traced.speed_count < MIN_SPEEDS_FOR_ARRAYS or traced.has_flight_limits:
            return traced.margins(x, self.vector)[0].copy()
        frequency, amplitude = Parameters.view(x)
        terms = self._terms_at(float(frequency[0])) if self.phase_jumps else self._terms
        with np.errstate(divide="ignore", invalid="ignore"):
            margins = traced.margins_of(terms, frequency, amplitude, self.data)
        if not np.isfinite(margins).all():
            raise NotFiniteError(traced.name())
        return margins

    def margins_and_jacobian(self, x: NDArray) -> tuple[NDArray, NDArray]:
        """The margins (r,) at x but for that of the separation, and their Jacobian (r, 2)."""
        margins, jacobian = self._traced.margins_and_jacobian(x, self.vector)
        return margins.copy(), jacobian.copy()

    def missed_kinds(self, x: NDArray) -> list[str]:
        """The names of the limits that are not kept at x, as of `missed_limits`."""
        names = self._traced.constraints.names
        kinds = [BOUND, *names(Of.SPEED, Of.TENSION, Of.FLIGHT)]
        margins = self.margins(x)
        worst = margins[: len(kinds) * self.speed_count].reshape(len(kinds), -1)
        missed: list[str] = np.array(kinds)[worst.min(axis=1) < -FEASIBILITY_TOLERANCE].tolist()
        if self._keeps_apart and margins[-1] < -FEASIBILITY_TOLERANCE:
            missed += names(Of.SEPARATION)
        return missed

    def margins_on_grid(self, amplitudes: NDArray, frequencies: NDArray) -> tuple[NDArray, NDArray]:
        """The worst margin (k, q) of the speeds, and that of all else, with limits of aircraft.

        At amplitudes (k,), N, and frequencies (q,), rad/s; with the phases that these give.
        """
        columns = frequencies[:, None] if self.phase_jumps else [frequencies]
        parts = [self._on_grid(amplitudes, column) for column in columns]
        speeds, others = (np.concatenate(of_all, axis=1) for of_all in zip(*parts, strict=True))
        return speeds, others

    def _on_grid(self, amplitudes: NDArray, frequencies: NDArray) -> tuple[NDArray, NDArray]:
        """The same, with the phases of the first frequency."""
        traced, shape = self._traced, (len(amplitudes), len(frequencies))
        first = float(frequencies[0])
        own = self.search_problem
        if self.phase_jumps:
            own = self._search_problem_of(self._terms_at(first))
        speeds, others = own.margins(amplitudes, frequencies)
        if not traced.has_flight_limits:
            return speeds, others
        x = np.array([first, self.previous[1]])
        flat, angles = (part.copy() for part in traced.flight_terms(x, self.vector))
        rows, count = len(angles), len(amplitudes) * len(frequencies)
        flight = traced.flight_margins(
            np.tile(flat.reshape(rows, -1), (count, 1)),
            np.tile(angles, count),
            np.repeat(np.tile(frequencies, len(amplitudes)), rows),
            np.repeat(np.repeat(amplitudes, len(frequencies)), rows),
            self.data,
        )
        worst = np.min([of_kind.reshape(count, -1).min(axis=1) for of_kind in flight], axis=0)
        return speeds, np.minimum(others, worst.reshape(shape))

    def worst_margin(self, x: NDArray) -> float:
        """The least margin of all constraints at x."""
        return self._margins_and_worst(x)[1]

    def is_feasible(self, x: NDArray) -> bool:
        """Whether x fulfils the constraints."""
        return self.worst_margin(x) >= -FEASIBILITY_TOLERANCE

    def feasible_cost(self, x: NDArray) -> float:
        """The cost of the step to x, inf where x does not fulfil the constraints."""
        return self.cost(x) if self.is_feasible(x) else np.inf

    def learns_from(self, x: NDArray) -> bool:
        """Whether carriers come too close at x that are not known to.

        `search_problem` and `known_bounds` know of them from now on.
        """
        if not self._keeps_apart or self.margins(x)[-1] >= -FEASIBILITY_TOLERANCE:
            return False
        known = {*map(tuple, self._known_encounters.T)}
        near = self._closest_within(self._traced.constraints.min_separation, x)
        unknown = [encounter for encounter in near.T if tuple(encounter) not in known]
        if not unknown:
            return False
        self._known_encounters = np.column_stack([self._known_encounters, *unknown])
        self._search_problem = None
        return True

    def slowest_speed(self, x: NDArray) -> float:
        """The slowest predicted speed (m/s) at x."""
        margins, worst = self._margins_and_worst(x)
        count = self._traced.speed_count
        if len(margins) > count:
            worst = float(margins[:count].min())
        bound, unit = float(self.data.speed_bound[0]), float(self.data.speed_unit[0])
        return math.sqrt(max(0.0, worst * unit * unit + bound * bound))

    @property
    def search_problem(self) -> SearchProblem:
        """The problem with the phases of now, which do not depend on ξ where they accumulate it."""
        if self._search_problem is None:
            self._search_problem = self._search_problem_of(self._terms)
        return self._search_problem

    @cached_property
    def _terms(self) -> SpeedTerms:
        return self._terms_at(float(self.previous[0]))

    def _terms_at(self, frequency: float) -> SpeedTerms:
        flat = self._traced.terms(np.array([frequency, self.previous[1]]), self.vector)
        return SpeedTerms.from_flat(*[term.copy() for term in flat])

    @property
    def _keeps_apart(self) -> bool:
        return self._traced.constraints.min_separation > 0

    @cached_property
    def _known_encounters(self) -> NDArray:
        """The encounters (3, m) that the search knows: at first those that are near at A⁻."""
        return self._closest_within(_NEAR * self._traced.constraints.min_separation, self.previous)

    def _known_separation_margins(self, amplitudes: NDArray) -> NDArray:
        """The worst margin (k,) of these at amplitudes (k,), N."""
        return self._separation_margins(amplitudes, self._known_encounters)

    def _separation_margins(self, amplitudes: NDArray, encounters: NDArray) -> NDArray:
        """The worst margin (k,) of encounters at amplitudes (k,), N; inf if there are none."""
        squares = self._distance_squares(amplitudes, encounters)
        (margins,) = self._traced.constraints.of_squares(Of.SEPARATION, squares)
        worst: NDArray = margins.min(axis=1, initial=np.inf)
        return worst

    def _distance_squares(self, amplitudes: NDArray, encounters: NDArray) -> NDArray:
        """The least squared distances (k, m), m², of encounters at amplitudes (k,), N."""
        terms = self._terms
        return self._traced.distances.least_squares(
            encounters, amplitudes, terms.forces, terms.levers, **self._cables
        )

    def _closest_within(self, distance: float, x: NDArray) -> NDArray:
        """The closest encounters (3, m) within a distance (m) at x, at most so many at a time."""
        near = self._encounters_within(distance, x)
        order = np.argsort(self._distance_squares(x[1:], near)[0], kind="stable")
        return near[:, order[:_MOST_LEARNED]]

    def _encounters_within(self, distance: float, x: NDArray) -> NDArray:
        terms, amplitude = self._terms, float(x[1])
        return self._traced.distances.near(
            distance, amplitude, terms.forces, terms.levers, **self._cables
        )

    @property
    def _cables(self) -> dict[str, float]:
        return {
            "rest_length": float(self.beliefs.rest_length[0]),
            "compliance": float(self.beliefs.compliance[0]),
        }

    def _search_problem_of(self, terms: SpeedTerms) -> SearchProblem:
        traced, data, previous, config = self._traced, self.data, self.previous, self._traced.config
        lower, upper = self.bounds
        return SearchProblem(
            polynomials=terms.polynomials,
            **self._cables,
            amplitude_margins=self._amplitude_margins(terms.polynomials),
            angles=terms.angles,
            previous=previous,
            nominal=self.beliefs.nominal,
            lower=lower,
            upper=upper,
            speed_bound=data.speed_bound[0],
            speed_unit=data.speed_unit[0],
            max_speed=traced.constraints.max_speed,
            internal_force_weight=config.internal_force_weight,
            internal_force_rate_weight=config.internal_force_rate_weight,
            anchor_weight=float(data.anchor_weight[0]),
        )

    def _amplitude_margins(self, polynomials: NDArray) -> Callable[[NDArray], NDArray] | None:
        """The worst margin (k,) at amplitudes (k,) in the known constraints that ξ is not in."""
        constraints = self._traced.constraints
        keeps_apart = self._keeps_apart and self._known_encounters.size > 0
        if not constraints.names(Of.TENSION) and not keeps_apart:
            return None

        def worst_margins(amplitudes: NDArray) -> NDArray:
            worst = np.full(len(amplitudes), np.inf)
            p0, p1, p2 = polynomials[nonstop.TENSION][:, :, None]
            squares = p0 + amplitudes * (p1 + amplitudes * p2)
            for margins in constraints.of_squares(Of.TENSION, squares):
                worst = np.minimum(worst, margins.min(axis=0))
            if keeps_apart:
                worst = np.minimum(worst, self._known_separation_margins(amplitudes))
            return worst

        return worst_margins

    def _margins_and_worst(self, x: NDArray) -> tuple[NDArray, float]:
        if x is not self._last[0]:
            margins = self.margins_but_separation(x)
            if self._keeps_apart:
                margins = np.append(margins, self._separation_margin(x))
            self._last = x, margins, float(margins.min())
        return self._last[1], self._last[2]

    def _separation_margin(self, x: NDArray) -> float:
        """The margin of the closest encounter at x; inf where none is too close."""
        with np.errstate(divide="ignore", invalid="ignore"):
            near = self._encounters_within(self._traced.constraints.min_separation, x)
            margin = float(self._separation_margins(x[1:], near)[0])
        if math.isnan(margin):
            raise NotFiniteError(self._traced.name())
        return margin if margin < 0 else math.inf
