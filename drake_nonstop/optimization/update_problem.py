"""The nonstop problem of one update, in numbers."""

import math

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics import nonstop
from drake_nonstop.mechanics.signals import Parameters
from drake_nonstop.optimization.margins import FEASIBILITY_TOLERANCE
from drake_nonstop.optimization.search_problem import SearchProblem
from drake_nonstop.optimization.traced_problem import SpeedTerms, TracedProblem
from drake_nonstop.optimization.update_data import UpdateData
from drake_nonstop.systems.tracing import NotFiniteError

_MIN_SPEEDS_FOR_ARRAYS = 90  # from this number on arrays are faster than a trace


class UpdateProblem:
    """min cost(x) such that margins(x) ≥ 0, over x = [ξ, A] (2,), in rad/s and N, within `bounds`.

    Args:
        traced: what all updates share.
        data: of the update.
    """

    def __init__(self, traced: TracedProblem, data: UpdateData):
        self._traced = traced
        self.data = data
        self.vector = np.concatenate(data)  # (61,), for the functions of `UpdateSolver.functions`
        self.previous = data.previous.copy()
        # The last x, its margins and the least of them: the search has computed the answer's.
        self._last: tuple[NDArray | None, NDArray, float] = (None, self.previous, 0.0)
        self._search_problem: SearchProblem | None = None

    @property
    def bounds(self) -> tuple[NDArray, NDArray]:
        """The lower and upper bounds (2,) of x, within reach at the limits of its rates."""
        return self._traced.bounds(self.previous)

    @property
    def phase_jumps(self) -> bool:
        """Whether the phase jumps with ξ, as `PaperPhase` does, rather than accumulates it."""
        return bool(self.data.phase[1] != 0)

    def cost(self, x: NDArray) -> float:
        """The cost of the step to x."""
        return float(self._traced.cost(x, self.vector)[0][0])

    def margins(self, x: NDArray) -> NDArray:
        """The margins of all constraints at x, in the order of `ConstraintMargins`; for reading.

        Raises:
            NotFiniteError: one is not, such as that of a cable without any tension.
        """
        return self._margins_and_worst(x)[0]

    def worst_margin(self, x: NDArray) -> float:
        """The least margin of all constraints at x."""
        return self._margins_and_worst(x)[1]

    def feasible_cost(self, x: NDArray) -> float:
        """The cost of the step to x, inf where x does not fulfil the constraints."""
        is_feasible = self.worst_margin(x) >= -FEASIBILITY_TOLERANCE
        return self.cost(x) if is_feasible else np.inf

    def slowest_speed(self, x: NDArray) -> float:
        """The slowest predicted speed (m/s) at x."""
        margins, worst = self._margins_and_worst(x)
        count = self._traced.constraints.speed_count
        if len(margins) > count:
            worst = float(margins[:count].min())
        bound, unit = float(self.data.speed_bound[0]), float(self.data.speed_unit[0])
        return math.sqrt(max(0.0, worst * unit * unit + bound * bound))

    @property
    def search_problem(self) -> SearchProblem:
        """The problem with the phases of now, which do not depend on ξ where they accumulate it."""
        if self._search_problem is None:
            self._search_problem = self.search_problem_at(float(self.previous[0]))
        return self._search_problem

    def search_problem_at(self, frequency: float) -> SearchProblem:
        """The problem with the phases that `frequency` (rad/s) gives."""
        traced, data, previous = self._traced, self.data, self.previous
        constraints, config = traced.constraints, traced.config
        flat = traced.terms(np.array([frequency, previous[1]]), self.vector)
        terms = SpeedTerms.from_flat(*[term.copy() for term in flat])
        lower, upper = self.bounds

        def amplitude_margins(amplitudes: NDArray) -> NDArray:
            values = nonstop.polynomial_values(terms.polynomials[:, :, None], amplitudes[:, None])
            tensions = nonstop.speed_squares(values, **traced.cables)[3]
            margins = constraints.of_amplitudes(amplitudes, tensions, terms.forces, terms.levers)
            return np.min([margin.min(axis=1) for margin in margins], axis=0)

        return SearchProblem(
            polynomials=terms.polynomials,
            **traced.cables,
            amplitude_margins=amplitude_margins if constraints.limit_amplitude else None,
            angles=terms.angles,
            previous=previous,
            nominal=traced.nominal,
            lower=lower,
            upper=upper,
            speed_bound=data.speed_bound[0],
            speed_unit=data.speed_unit[0],
            max_speed=constraints.max_speed,
            internal_force_weight=config.internal_force_weight,
            internal_force_rate_weight=config.internal_force_rate_weight,
            anchor_weight=float(data.anchor_weight[0]),
        )

    def _margins_and_worst(self, x: NDArray) -> tuple[NDArray, float]:
        if x is not self._last[0]:
            margins = self._computed_margins(x)
            self._last = x, margins, float(margins.min())
        return self._last[1], self._last[2]

    def _computed_margins(self, x: NDArray) -> NDArray:
        constraints = self._traced.constraints
        if (
            constraints.speed_count < _MIN_SPEEDS_FOR_ARRAYS
            or constraints.limit_amplitude
            or constraints.limit_high_speeds
            or self.phase_jumps
        ):
            return self._traced.margins(x, self.vector)[0].copy()
        with np.errstate(divide="ignore", invalid="ignore"):
            frequency, amplitude = Parameters.view(x)
            margins = self.search_problem.margins(amplitude, frequency)[0][0, 0]
        if not np.isfinite(margins).all():
            raise NotFiniteError(self._traced.name())
        return margins
