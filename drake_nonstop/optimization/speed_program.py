"""The problem of one update of the optimization layer, and its certified answer."""

import math
from collections.abc import Callable
from enum import IntEnum
from functools import cached_property
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics import nonstop
from drake_nonstop.mechanics.rigid_load import load_acceleration
from drake_nonstop.model.system import Model
from drake_nonstop.optimization.local_solver import LocalSolver
from drake_nonstop.optimization.search import (
    FEASIBILITY_TOLERANCE,
    SearchProblem,
    fastest,
    nearest_feasible,
    on_grid,
)
from drake_nonstop.systems.tracing import NotFiniteError, TracedFunction

if TYPE_CHECKING:
    from drake_nonstop.blocks.optimization_layer import NonstopOptimizerConfig

DATA_SIZE = 61
_SAME_COST = 1e-4  # relative; what the global search finds has to be cheaper by more
_RESTING = 1e-3  # m/s, rad/s, m/s², rad/s²; a reference that moves less rests
_MANY_SPEEDS = 90  # from so many on arrays are faster than a trace
_SEPARATION_TURNS = 36  # of a whole turn, in which carriers are kept apart


class Outcome(IntEnum):
    """How an update of the layer ended; the first entry of `diagnostics`."""

    NONE = 0  # no update yet
    KEPT = 1  # the previous parameters fulfil the constraints: they are the optimum
    SOLVED = 2  # parameters were found that fulfil the constraints
    RELAXED = 3  # none were: those of the largest worst speed margin were taken
    HELD = 4  # nor any with a larger one: the previous ones stay


class SpeedProgram:
    """The problem of one update, built once and solved with the data of each.

    `data` (61), from `update_data`, holds what varies from update to update. A margin is
    negative where a constraint is not fulfilled: ‖v_i‖²/ε² − 1 of the speeds, with the
    tightened ε, which come first, and likewise of the other constraints that are enabled.
    Answers depend on the arguments alone.
    """

    def __init__(self, model: Model, config: "NonstopOptimizerConfig", name: Callable[[], str]):
        self._model, self._config, self._name = model, config, name
        self._nominal = np.array([config.frequency, config.amplitude])
        self._lower, self._upper = np.transpose(
            [config.frequency_bounds, amplitude_bounds(config, model)]
        )
        points = config.look_ahead_points
        self._instants = np.linspace(0, config.period, points) if points > 1 else np.zeros(1)
        turn_count = config.orbit_points // config.orbit_updates if config.orbit_points > 1 else 0
        self._turns = 2 * np.pi * np.arange(turn_count) / max(turn_count, 1)
        # The speeds of n carriers are constrained at each of these, by its number: at every
        # instant, and at the last one at the turns of the orbit ahead.
        self._instant_of_row = np.minimum(np.arange(points + turn_count), points - 1)
        self._speed_count = len(self._instant_of_row) * model.n
        axes = nonstop.orbit_axes(model.pattern.basis, model.pattern.phases)
        self._axes = _without_round_off(axes[0]), _without_round_off(axes[1])
        self._pairs = np.array(list(combinations(range(model.n), 2))).T
        larger, smaller = 1 + config.tightening, 1 - config.tightening
        self._min_tension, self._max_tension = (
            larger * config.min_tension,
            smaller * config.max_tension,
        )
        self._max_speed = smaller * config.max_speed
        self._min_separation = larger * config.min_separation

        self._cables = {"rest_length": model.cable_length, "compliance": model.cable_compliance}

        self._terms = self._compiled(self._trace_terms)
        self._margins = self._compiled(self._trace_margins)
        self._cost = self._compiled(self._trace_cost)
        self._local: LocalSolver | None = None
        if config.solver in LocalSolver.NAMES:
            self._local = LocalSolver(
                config.solver, DATA_SIZE, *self.functions(with_gradients=True), self._speed_count
            )

    def update_data(
        self,
        previous: NDArray,
        phase: NDArray,
        load_state: NDArray,
        reference: NDArray,
        wrench: NDArray,
        wrench_rate: NDArray,
        wrench_second_rate: NDArray,
        speed_bound: float,
        updates: int = 0,
    ) -> NDArray:
        """The data (61) of an update.

        They are the arguments, ε tightened, the unit of its margins, what the number of
        `updates` before this one turns the phases of the orbit ahead on by, and the weight of
        the anchor, which is let go while the reference is on its way.
        """
        config = self._config
        anchor_weight = config.anchor_weight
        if anchor_weight > 0 and np.abs(reference[7:19]).max() > _RESTING:
            anchor_weight = 0.0
        turn = 2 * math.pi * (updates % config.orbit_updates) / config.orbit_points
        bound = (1 + config.tightening) * speed_bound
        unit = bound or 1.0  # m/s; without a bound every speed is above it
        rest = np.array([bound, unit, turn, anchor_weight])
        return np.concatenate(
            (previous, phase, load_state, reference, wrench, wrench_rate, wrench_second_rate, rest)
        )

    def solve(self, data: NDArray) -> tuple[NDArray, Outcome, float]:
        """The next [ξ, A] (2,), how they were found, and the slowest speed to come (m/s)."""
        update = _Update(self, data)
        previous, margins_before = update.previous, update.margins(update.previous)
        before = float(margins_before.min())
        slowest_before = self._slowest(margins_before, before, data)
        if before >= -FEASIBILITY_TOLERANCE and not self._is_pulled(data):
            return previous, Outcome.KEPT, slowest_before
        parameters = self._best(update)
        margins = update.margins(parameters)
        worst = float(margins.min())
        if before >= -FEASIBILITY_TOLERANCE and (
            worst < -FEASIBILITY_TOLERANCE
            or self.cost(parameters, data) >= self.cost(previous, data)
        ):
            return previous, Outcome.KEPT, slowest_before
        if worst >= -FEASIBILITY_TOLERANCE:
            return parameters, Outcome.SOLVED, self._slowest(margins, worst, data)
        if self._order(margins) > self._order(margins_before):
            return parameters, Outcome.RELAXED, self._slowest(margins, worst, data)
        return previous, Outcome.HELD, slowest_before

    def margins_in(self, update: "_Update", x: NDArray) -> NDArray:
        """The margins of all constraints at [ξ, A].

        Raises:
            NotFiniteError: one is not, such as that of a cable without any tension.
        """
        are_many = self._speed_count >= _MANY_SPEEDS and update.data[3] == 0
        if are_many and not (self._amplitude_is_constrained or np.isfinite(self._max_speed)):
            with np.errstate(divide="ignore", invalid="ignore"):
                margins = update.problem.margins(x[1:], x[:1])[0][0, 0]
            if not np.isfinite(margins).all():
                raise NotFiniteError(self._name())
            return margins
        return self._margins(x, update.data)[0].copy()

    def _order(self, margins: NDArray) -> tuple[float, float]:
        """By what one infeasible point is better than another, see `least_infeasible`."""
        speeds = float(margins[: self._speed_count].min())
        return min(speeds, 0.0), float(margins.min())

    def _is_pulled(self, data: NDArray) -> bool:
        """Whether the anchor asks for something else than the previous parameters."""
        return data[60] > 0 and not np.allclose(data[:2], self._nominal, rtol=1e-6, atol=0)

    def worst_margin(self, parameters: NDArray, data: NDArray) -> float:
        """The least margin of all constraints."""
        return float(np.min(self._margins(parameters, data)[0]))

    def slowest(self, parameters: NDArray, data: NDArray) -> float:
        """The slowest speed to come (m/s)."""
        margins = self._margins(parameters, data)[0]
        return self._slowest(margins, float(margins.min()), data)

    def cost(self, parameters: NDArray, data: NDArray) -> float:
        """The cost of the step to `parameters`."""
        return float(self._cost(parameters, data)[0][0])

    def feasible_cost(self, parameters: NDArray, data: NDArray) -> float:
        """The cost of the step to `parameters`, inf where they do not fulfil the constraints."""
        is_feasible = self.worst_margin(parameters, data) >= -FEASIBILITY_TOLERANCE
        return self.cost(parameters, data) if is_feasible else np.inf

    def bounds(self, previous: NDArray) -> tuple[NDArray, NDArray]:
        """The lower and upper bounds (2,) of [ξ, A], within reach at the limits of their rates."""
        step = self._config.period * np.array(
            [self._config.max_frequency_rate, self._config.max_amplitude_rate]
        )
        return np.maximum(self._lower, previous - step), np.minimum(self._upper, previous + step)

    def functions(self, *, with_gradients: bool = False) -> tuple[TracedFunction, TracedFunction]:
        """The cost and the margins of [ξ, A] and the data, for solvers of any kind."""
        if not with_gradients:
            return self._cost, self._margins
        return (
            self._compiled(self._trace_cost, jacobian_of=0),
            self._compiled(self._trace_margins, jacobian_of=0),
        )

    def search_problem(self, data: NDArray, frequency: float) -> SearchProblem:
        """The problem with the phases that `frequency` gives; an accumulated one ignores it."""
        previous = data[:2].copy()
        config = self._config
        polynomials, forces, levers, angles = (
            term.copy() for term in self._terms(np.array([frequency, previous[1]]), data)
        )
        polynomials = polynomials.reshape(10, 3, -1)
        forces, levers = forces.reshape(-1, 3), levers.reshape(-1, 3)
        lower, upper = self.bounds(previous)

        def amplitude_margins(amplitudes: NDArray) -> NDArray:
            values = nonstop.polynomial_values(polynomials[:, :, None], amplitudes[:, None])
            tensions = nonstop.speed_squares(values, **self._cables)[3]
            margins = self._margins_of_amplitudes(amplitudes, tensions, forces, levers)
            return np.min([margin.min(axis=1) for margin in margins], axis=0)

        return SearchProblem(
            polynomials=polynomials,
            **self._cables,
            amplitude_margins=amplitude_margins if self._amplitude_is_constrained else None,
            angles=angles,
            previous=previous,
            nominal=self._nominal,
            lower=lower,
            upper=upper,
            speed_bound=data[57],
            speed_unit=data[58],
            max_speed=self._max_speed,
            internal_force_weight=config.internal_force_weight,
            internal_force_rate_weight=config.internal_force_rate_weight,
            anchor_weight=float(data[60]),
        )

    def _best(self, update: "_Update") -> NDArray:
        """The feasible point of the least cost; where none is found that of the largest margin."""
        if self._local is None:
            return self._searched(update)[0]
        data, bounds = update.data, self.bounds(update.previous)
        parameters = self._local.nearest(data, *bounds)
        cost = self.feasible_cost(parameters, data)
        if self._config.global_search:
            other, other_cost = self._searched(update)
            is_best = np.isfinite(cost) and cost * (1 - _SAME_COST) <= other_cost
            return parameters if is_best else other
        if np.isfinite(cost):
            return parameters
        return self._local.fastest(data, *bounds)

    def _searched(self, update: "_Update") -> tuple[NDArray, float]:
        """The point that a search finds and its cost, inf where it is infeasible.

        A printed phase, which jumps with ξ, asks for a grid.
        """
        data, count = update.data, self._speed_count
        if self._config.solver == "grid" or data[3] != 0:
            return on_grid(
                lambda frequency: self.search_problem(data, frequency),
                float(data[0]),
                lambda x: self.cost(x, data),
            )

        def speed_margins(x: NDArray) -> NDArray:
            """The worse margin of each speed, which may be bounded on either side."""
            margins = update.margins(x)
            if not np.isfinite(self._max_speed):
                return margins[:count]
            return np.minimum(margins[:count], margins[count : 2 * count])

        before = speed_margins(update.previous)
        parameters, cost = nearest_feasible(update.problem, before, speed_margins)
        if np.isfinite(cost):
            return parameters, cost
        parameters = fastest(update.problem)
        if update.margins(parameters).min() < -FEASIBILITY_TOLERANCE:
            return parameters, np.inf
        cost = self.cost(parameters, data)
        # A way so narrow that the search had missed it.
        nearer, lower_cost = nearest_feasible(
            update.problem, before, speed_margins, float(parameters[1])
        )
        return (nearer, lower_cost) if lower_cost < cost else (parameters, cost)

    def _slowest(self, margins: NDArray, worst: float, data: NDArray) -> float:
        """The slowest speed (m/s) behind the margins, the least of which is `worst`."""
        if len(margins) > self._speed_count:
            worst = float(margins[: self._speed_count].min())
        bound, unit = data[57:59].tolist()
        return math.sqrt(max(0.0, worst * unit * unit + bound * bound))

    @property
    def _amplitude_is_constrained(self) -> bool:
        """Whether a constraint that does not depend on ξ is enabled."""
        return self._min_tension > 0 or np.isfinite(self._max_tension) or self._min_separation > 0

    def _margins_of_amplitudes(
        self, amplitudes: NDArray, tension_squares: NDArray, forces: NDArray, levers: NDArray
    ) -> list[NDArray]:
        """The margins, (k, …) each, of the enabled constraints that do not depend on ξ."""
        margins = []
        if self._min_tension > 0:
            margins.append(tension_squares / self._min_tension**2 - 1)
        if np.isfinite(self._max_tension):
            margins.append(1 - tension_squares / self._max_tension**2)
        if self._min_separation > 0:
            squares = nonstop.separation_squares(
                amplitudes,
                forces,
                levers,
                self._axes[0],
                self._axes[1],
                turns=2 * np.pi * np.arange(_SEPARATION_TURNS) / _SEPARATION_TURNS,
                pairs=self._pairs,
                **self._cables,
            )
            margins.append(squares.reshape(len(amplitudes), -1) / self._min_separation**2 - 1)
        return margins

    def _compiled(self, function: Callable, jacobian_of: int | None = None) -> TracedFunction:
        # A solver may try the far ends of the bounds, where values are huge and sound.
        return TracedFunction(
            function,
            [2, DATA_SIZE],
            name=self._name,
            largest=1e100,
            jacobian_of=jacobian_of,
            key=(function.__name__, vars(self._model), self._config),
        )

    def _trace_orbits(self, data: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        """The products (25, instants, n), and the last instant's forces and levers (n, 3)."""
        state, reference, *wrenches = np.split(data[4:57], [13, 35, 41, 47])
        model = self._model
        accelerations = load_acceleration(model.load, state, wrenches[0])
        products = []
        for instant in self._instants:
            ahead = motion = nonstop.advance(state, *accelerations, instant)
            if self._config.load_motion == "desired":
                motion = nonstop.advance(
                    reference[:13], reference[13:16], reference[16:19], instant
                )
            forces, rates, levers, velocities, omega = nonstop.orbit_ahead(
                ahead,
                motion,
                *wrenches,
                time=instant,
                pseudo_inverse=_without_round_off(model.pseudo_inverse),
                offset=model.pattern.offset,
                attachments=model.attachments,
            )
            products.append(nonstop.speed_products(forces, rates, velocities, omega, *self._axes))
        return np.stack(products, axis=1), forces, levers

    def _trace_terms(self, x: NDArray, data: NDArray) -> tuple[NDArray, ...]:
        """What `search_problem` needs: the polynomials (10, 3, p), forces, levers and angles."""
        products, forces, levers = self._trace_orbits(data)
        angle = nonstop.phase_of(x, data[:2], data[2:4])
        ahead = angle + data[:1] * self._instants
        cosine, sine = np.cos(ahead), np.sin(ahead)
        first = ahead[-1:] + data[59:60]
        turn_cosine, turn_sine = np.cos(self._turns), np.sin(self._turns)
        polynomials = nonstop.speed_polynomials(
            np.concatenate([cosine, np.cos(first) * turn_cosine - np.sin(first) * turn_sine])[
                :, None
            ],
            np.concatenate([sine, np.sin(first) * turn_cosine + np.cos(first) * turn_sine])[
                :, None
            ],
            products[:, self._instant_of_row],
        )
        angles = angle + self._model.pattern.phases
        return polynomials.reshape(10, 3, -1), forces, levers, angles

    def _trace_margins(self, x: NDArray, data: NDArray) -> NDArray:
        polynomials, forces, levers, _ = self._terms.traced(x, data)
        polynomials = polynomials.reshape(10, 3, -1)
        forces, levers = forces.reshape(-1, 3), levers.reshape(-1, 3)
        values = nonstop.polynomial_values(polynomials[:, :, None], x[1:, None])
        c, b, a, tension_squares = nonstop.speed_squares(values, **self._cables)
        s = x[:1] * x[1:]
        squares = c + s * (2 * b + s * a)
        bound, unit = data[57:58], data[58:59]
        margins = [(squares - bound * bound) / (unit * unit)]
        if np.isfinite(self._max_speed):
            margins.append(1 - squares / self._max_speed**2)
        margins += self._margins_of_amplitudes(x[1:], tension_squares, forces, levers)
        return np.concatenate(margins, axis=1)[0]

    def _trace_cost(self, x: NDArray, data: NDArray) -> NDArray:
        return nonstop.change_cost(
            x,
            data[:2],
            data[2:4],
            phases=self._model.pattern.phases,
            internal_force_weight=self._config.internal_force_weight,
            internal_force_rate_weight=self._config.internal_force_rate_weight,
            anchor_weight=data[60:],
            nominal=self._nominal,
        )


class _Update:
    """What the solution of one update takes more than once: `data`, and `previous` = [ξ⁻, A⁻]."""

    def __init__(self, program: SpeedProgram, data: NDArray):
        self._program = program
        self.data, self.previous = data, data[:2].copy()
        self._margins: tuple[Any, Any] = None, None  # the last ones, after their [ξ, A]

    @cached_property
    def problem(self) -> SearchProblem:
        """That of the search."""
        return self._program.search_problem(self.data, self.data[0])

    def margins(self, x: NDArray) -> NDArray:
        """The margins of all constraints at [ξ, A]."""
        if x is not self._margins[0]:
            self._margins = x, self._program.margins_in(self, x)
        return self._margins[1]


def amplitude_bounds(config: "NonstopOptimizerConfig", model: Model) -> list[float]:
    """The bounds on A: the config's, or those that follow from the load's weight."""
    if config.amplitude_bounds != []:
        return config.amplitude_bounds
    share = model.load_mass * model.gravity / model.n
    return [min(0.004 * share, config.amplitude / 2), max(3 * share, 2 * config.amplitude)]


def _without_round_off(matrix: NDArray) -> NDArray:
    """The matrix with entries that are zero but for round-off set to zero: fewer operations."""
    return np.where(np.abs(matrix) > 1e-14 * np.max(np.abs(matrix)), matrix, 0.0)
