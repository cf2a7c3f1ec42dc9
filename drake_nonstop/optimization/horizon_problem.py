"""The nonstop problem over a horizon: splines of ξ and A that keep every carrier above the bound.

With ξ = ξ₀ B(t) c and A = A₀ B(t) d, uniform splines of fourth degree, so that θ is linear in c,

    min ∫ (ξ/ξ₀ − 1)² + w_A (A/A₀ − 1)² + τ⁴ (second rates)² + τ⁶ (third rates)² + ρ slack dt

such that ‖v_i(t_k)‖² ≥ ((1 + m) ε)² (1 − slack) at the predicted phases θ(t_k), and, in the last
part of the horizon, A ξ ≥ s(t, A) (1 − slack), above which no phase of the orbit is too slow. The
rates are those of ξ/ξ₀ and A/A₀. Limits on speeds from above, on tensions and on the distances
between carriers are constraints of the same kind, with slack of their own. Limits on the rates of
ξ and A, and their bounds, hold for the coefficients, and so at all times.

The speeds of aircraft are those through the air. The limits of their lift, bank, climb and thrust
are constraints, with slack of their own, at some of the predicted phases and, in the last part, at
all phases of the orbit of the ξ and A there, taken as constant: these limits are not monotone in ξ.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.bowed_orbit import CableShape
from drake_nonstop.mechanics.planned_orbit import (
    FlightTerms,
    OrbitTerms,
    PlannedOrbit,
    planned_gaps,
    planned_speeds,
    term_columns,
)
from drake_nonstop.model.system import Model
from drake_nonstop.optimization.bowed_margins import BowedMargins
from drake_nonstop.optimization.diagnostics import BOUND
from drake_nonstop.optimization.elementwise import ElementwiseFunction
from drake_nonstop.optimization.horizon_config import HorizonConfig, timed
from drake_nonstop.optimization.horizon_motion import HorizonData, HorizonMotions
from drake_nonstop.optimization.limits import Of
from drake_nonstop.optimization.linearization import (
    ConstraintBlock,
    ConstraintLayout,
    Linearization,
    with_dips,
)
from drake_nonstop.optimization.plan import DEGREE, Plan, spline_rows
from drake_nonstop.optimization.problem_config import LimitsConfig
from drake_nonstop.optimization.update_data import ModelParameters

_OTHERS_SHARE = 0.3  # of the weight of the speed bound's slack: that of the other limits


_RATES = [2, 4, 5]  # of a `PlannedOrbit`: zero on orbits of constant ξ and A
_NOT_OF_ORBITS = [0, *_RATES]  # by which the needs on these have no derivatives


class MarginFunction(NamedTuple):
    """Margins of the carriers, or of pairs of them, at some instants of a plan.

    The function is one of an orbit (6), terms, constants, and the bound with its unit (2).
    """

    function: ElementwiseFunction
    instants: NDArray  # (r,), the numbers of those of the plan
    along: int  # so many are of the plan, the others of whole orbits of its ξ and A there
    angles: NDArray  # (r,), rad, the phases of the others
    places: NDArray  # (margins, r, carriers), the numbers of the constraints
    source: str  # of the terms, a field of `HorizonData`
    rows: NDArray  # (r,), those of the source
    columns: NDArray  # (terms, carriers), likewise
    constants: NDArray  # (..., 1, carriers)

    def orbits(self, orbit: PlannedOrbit) -> NDArray:
        """The orbit's entries (6, r, 1)."""
        found = np.stack(orbit)[:, self.instants, None]
        found[0, self.along :, 0] = self.angles[self.along :]
        found[_RATES, self.along :] = 0
        return found

    def inputs(self, data: HorizonData, orbit: PlannedOrbit) -> tuple[NDArray, ...]:
        """The inputs of the function, (..., r, carriers) or what broadcasts to it."""
        terms = np.moveaxis(getattr(data, self.source)[self.rows][:, self.columns], 1, 0)
        scale = np.array([data.speed_bound, data.speed_unit])[:, None, None]
        return self.orbits(orbit), terms, self.constants, scale


class HorizonProblem(HorizonMotions):
    """The problem of all plans of one model and config.

    Args:
        model: what the controllers believe.
        limits: ε, `tightening`, the nominal ξ and A, and their bounds.
        config: the horizon.
        name: tells what evaluates the terms, for the error of a value that is not finite.
        beliefs: numbers in place of those of model and limits.
        shape: of cables that bow, see `BowedMargins`; None: they are straight.
    """

    def __init__(
        self,
        model: Model,
        limits: LimitsConfig,
        config: HorizonConfig,
        name: Callable[[], str],
        *,
        beliefs: ModelParameters | None = None,
        shape: CableShape | None = None,
    ):
        config = timed(config, limits.frequency, model.control_period)
        super().__init__(model, limits, config, name, beliefs=beliefs, shape=shape)
        self._place_instants()
        self.count = self.intervals + DEGREE  # of the coefficients of ξ, and of A
        self._place_constraints()
        rows = spline_rows(self.instants, self.intervals, config.knot_spacing)
        xi, A = self.nominal
        self.terminal_unit = float(xi * A)  # N/s, of the margins of A ξ
        self.jacobians = PlannedOrbit(
            angle=xi * rows.integral,
            frequency=xi * rows.value,
            frequency_rate=xi * rows.rate,
            amplitude=A * rows.value,
            amplitude_rate=A * rows.rate,
            amplitude_second_rate=A * rows.second_rate,
        )
        self.hessian = self._hessian()

    @property
    def largest_differences(self) -> NDArray:
        """The limits (2, 1) on the differences of neighbouring coefficients: those of the rates.

        The rate of a spline is a spline of such differences by the spacing.
        """
        rates = np.array([self.limits.max_frequency_rate, self.limits.max_amplitude_rate])
        return (self.config.knot_spacing * rates / self.nominal)[:, None]

    @property
    def bounds(self) -> tuple[NDArray, NDArray]:
        """The lower and upper bounds (2, 1) of the coefficients of ξ/ξ₀ and A/A₀.

        A spline stays within the range of its coefficients.
        """
        low, high = self._bounds
        return (low / self.nominal)[:, None], (high / self.nominal)[:, None]

    @property
    def is_compiled(self) -> bool:
        """Whether C evaluates all functions."""
        functions = [self.limits_of_carriers, *(part.function for part in self.functions)]
        return all(function.memory.evaluate for function in functions)

    def nominal_coefficients(self) -> NDArray:
        """Coefficients (2, N) of the nominal ξ and A."""
        return np.ones((2, self.count))

    def amplitude_margins(
        self, data: HorizonData, every: int
    ) -> Callable[[NDArray], NDArray] | None:
        """Tells the worst margin (a,) of A (a,) in what does not depend on ξ, over whole orbits.

        At every so many instants of the horizon; None where there is no such limit.
        """
        if not self.constraints.names(Of.TENSION, Of.SEPARATION):
            return None
        flat = data.flat_terms[::every]
        return lambda A: self.terminal_set(flat, 0.0, A).amplitude_margins.min(axis=0)

    def plan(self, data: HorizonData, coefficients: NDArray) -> Plan:
        """The plan of coefficients (2, N)."""
        return Plan(
            data.start_time, data.start_angle, self.config.knot_spacing, self.nominal, coefficients
        )

    def cost(self, coefficients: NDArray) -> float:
        """The cost of coefficients (2, N), without slack."""
        away = (coefficients - 1).ravel()
        return float(away @ self.hessian @ away) / 2

    def orbit(self, data: HorizonData, coefficients: NDArray) -> PlannedOrbit:
        """Phase, ξ and A with their rates (k,) at the instants."""
        angle, *others = (rows @ coefficients[i // 3] for i, rows in enumerate(self.jacobians))
        return PlannedOrbit(data.start_angle + angle, *others)

    def speeds(self, data: HorizonData, coefficients: NDArray) -> NDArray:
        """The carriers' speeds (k, n), m/s, at the instants."""
        return self.values_along(Of.SPEED, data.terms, self.orbit(data, coefficients))

    def bowed(self, data: HorizonData, coefficients: NDArray) -> HorizonData:
        """The data with what margins lose as cables bow along a plan of coefficients (2, N)."""
        if self._bowed_margins is None:
            return data
        return data._replace(losses=self._bowed_margins.losses(data, coefficients))

    def linearization(self, data: HorizonData, coefficients: NDArray) -> Linearization:
        """The constraints about coefficients (2, N)."""
        orbit, size = self.orbit(data, coefficients), len(self.layout.names)
        margins, gradients, weights = np.zeros(size), np.zeros((6, size)), np.zeros((3, size))
        for part in self.functions:
            values, slopes = part.function(*part.inputs(data, orbit))
            slopes[:, _NOT_OF_ORBITS, part.along :] = 0
            margins[part.places], gradients[:, part.places] = values, slopes.swapaxes(0, 1)
        self._set_terminal(data, orbit, margins, gradients)
        if data.losses is not None:
            margins -= data.losses.at(orbit, self.layout.instants)
            gradients -= data.losses.slopes
        speeds = margins[self._speed_places]
        slowest = data.speed_of(speeds.min())
        for place in self.neighbouring:
            dipping, own_weights = with_dips(margins[place])
            margins[place], weights[:, place] = dipping, own_weights
        # What carriers have to keep beyond the bound steps with time: no minimum follows from it.
        margins[self._speed_places] -= data.excess
        return Linearization(margins, gradients, weights, self.jacobians, self.layout, slowest)

    def judged(self, data: HorizonData, coefficients: NDArray) -> tuple[NDArray, float]:
        """The margins (r,) of `linearization`, and the least speed at the instants, m/s."""
        found = self.linearization(self.bowed(data, coefficients), coefficients)
        return found.margins, found.slowest

    def slacks(self, margins: NDArray) -> NDArray:
        """The least slacks, as many as `slack_weights`, that margins (r,) need."""
        slacks = np.zeros(len(self.slack_weights))
        violated = np.flatnonzero(~(margins >= 0))
        np.maximum.at(slacks, self.layout.slacks[violated], -margins[violated])
        return slacks

    def missed(self, margins: NDArray, tolerance: float) -> set[str]:
        """Limits missed by more than a tolerance, of margins (r,), by names of `missed_limits`."""
        return {*self.layout.names[~(margins >= -tolerance)].tolist()} - {""}

    def angle_rows(self) -> NDArray:
        """The matrix (intervals, N) of θ at the knots after the start, by the coefficients of ξ."""
        knots = self.config.knot_spacing * np.arange(1, self.intervals + 1)
        rows = spline_rows(knots, self.intervals, self.config.knot_spacing)
        return self.nominal[0] * rows.integral

    def _place_constraints(self) -> None:
        """Tells where margins belong: their instants, slacks and names.

        The bound on the speeds has slack of its own, all limits of aircraft together, and all
        others together: one per interval between knots and one of the last part, of each.
        """
        limits, n, slacks = self.constraints, self.model.n, self.intervals + 1
        fast, tensions = limits.names(Of.SPEED), limits.names(Of.TENSION)
        pairs = limits.names(Of.SEPARATION)
        names = np.array([BOUND, *fast, *tensions] * n).reshape(n, -1).T.ravel()
        names = np.append(names, np.repeat(pairs, self.pairs.shape[1]))
        of_flight = np.repeat(limits.names(Of.FLIGHT), n)
        has_others = len(names) > n
        kinds, flight_kind = (names != BOUND) * 1, 1 + has_others
        pieces = np.floor(self.instants / self.config.knot_spacing - 1e-9).clip(0).astype(int)
        along = np.arange(len(self.instants))[:, None]
        blocks = [ConstraintBlock(along, pieces[:, None] + slacks * kinds, names, 0)]
        if self._limits_flight:
            at, first = self.flight_at[:, None], slacks * flight_kind
            blocks.append(ConstraintBlock(at, pieces[at] + first, of_flight, 0))
        # Of the terminal set, what does not depend on ξ is one margin, of any limit of these.
        apart = tensions + pairs
        only = [(names[0] if len(names) == 1 else "") for names in ([BOUND], fast, apart)]
        self.terminal_kinds = np.flatnonzero([True, bool(fast), bool(apart)])
        last = self.intervals + slacks * (self.terminal_kinds > 0)
        terminal_names = np.array(only)[self.terminal_kinds]
        blocks.append(
            ConstraintBlock(self.terminal_at, last[:, None], terminal_names[:, None], None)
        )
        if self._limits_flight:
            phases = np.zeros((len(self.orbit_angles), 1), int)
            at = self.flight_at[self.orbits_of, None, None]
            slack = self.intervals + first + phases
            blocks.append(ConstraintBlock(at, slack, of_flight, 1))
        self.layout = ConstraintLayout.of_blocks(blocks)
        weights = np.full(slacks, self.config.knot_spacing)
        weights[-1] *= self.config.terminal_knots
        shares = [1.0] + [_OTHERS_SHARE] * (has_others + self._limits_flight)
        self.slack_weights = self.config.slack_weight * np.outer(shares, weights).ravel()
        shapes = [np.broadcast_shapes(*(part.shape for part in block[:3])) for block in blocks]
        numbers = np.split(np.arange(len(self.layout.names)), np.cumsum([*map(np.prod, shapes)]))
        places = [own.reshape(shape) for own, shape in zip(numbers, shapes, strict=False)]
        self.neighbouring = places[: 1 + self._limits_flight]
        self._speed_places = places[0][:, :n]
        self.terminal_places = places[1 + self._limits_flight]
        self._make_functions(places)
        self._bowed_margins = (
            None
            if self.shape is None
            else BowedMargins(
                self, self.shape, places[0], places[1::2] if self._limits_flight else []
            )
        )

    def _make_functions(self, places: list[NDArray]) -> None:
        """Makes the functions of margins, of constraints numbered as in each block."""
        count, n = len(self.instants), self.model.n
        every = np.arange(count)
        pairs = places[0].shape[1] - (self.pairs.shape[1] if self._keeps_apart else 0)
        of_carriers = places[0][:, :pairs].reshape(count, -1, n).swapaxes(0, 1)
        of_terms = term_columns(n)
        along: dict[str, Any] = {"instants": every, "along": count, "angles": np.zeros(count)}
        numbers = np.repeat(self.numbers[:, None, None], n, axis=2)
        axes = np.concatenate([np.hstack(self.axes).T[:, None], numbers])
        size = len(axes)
        self.functions = [
            MarginFunction(
                self._elementwise(self._carrier_margins, [6, 12, size, 2], (count, n)),
                **along,
                places=of_carriers,
                source="flat_terms",
                rows=every,
                columns=of_terms,
                constants=axes,
            )
        ]
        if self._keeps_apart:
            of_pairs = places[0][None, :, pairs:]
            vectors = (*self.axes, self.model.attachments)
            constants = [part[chosen].T for part in vectors for chosen in self.pairs]
            constants.append(np.repeat(self.numbers[:, None], of_pairs.shape[2], axis=1))
            self.functions.append(
                MarginFunction(
                    self._elementwise(
                        self._gap_margins, [6, 6, size + 12, 2], (count, of_pairs.shape[2])
                    ),
                    **along,
                    places=of_pairs,
                    source="flat_terms",
                    rows=every,
                    columns=np.concatenate([of_terms[:3, chosen] for chosen in self.pairs]),
                    constants=np.concatenate(constants)[:, None],
                )
            )
        if self._limits_flight:
            at, angles = self.flight_at, self.orbit_angles
            orbits = np.repeat(self.orbits_of, len(angles))
            of_both = [part.reshape(-1, part.shape[-1] // n, n) for part in (places[1], places[3])]
            rows = np.concatenate([np.arange(len(at)), orbits])
            self.functions.append(
                MarginFunction(
                    self._elementwise(
                        self._flight_margins_of_one, [6, 24, size, 2], (len(rows), n)
                    ),
                    instants=at[rows],
                    along=len(at),
                    angles=np.append(np.zeros(len(at)), np.tile(angles, len(self.orbits_of))),
                    places=np.concatenate(of_both).swapaxes(0, 1),
                    source="flat_flight",
                    rows=rows,
                    columns=term_columns(n, 5, 3),
                    constants=axes,
                )
            )

    def _set_terminal(
        self, data: HorizonData, orbit: PlannedOrbit, margins: NDArray, gradients: NDArray
    ) -> None:
        """Sets the margins of the terminal set among all, and their gradients.

        A ξ/s − 1 by a fixed unit of s, the same from above, and what does not depend on ξ.
        """
        xi, A = orbit.frequency[self.terminal_at], orbit.amplitude[self.terminal_at]
        (least, most, others), slopes = data.terminal.at(A)
        unit = self.terminal_unit
        by_xi, by_A = gradients[1], gradients[3]
        zero, kinds, places = np.zeros(len(A)), self.terminal_kinds, self.terminal_places
        with np.errstate(invalid="ignore"):
            values = np.stack([(A * xi - least) / unit, (most - A * xi) / unit, others])
            margins[places] = values[kinds]
            by_xi[places] = np.stack([A / unit, -A / unit, zero])[kinds]
            rates = (xi - slopes[0]) / unit, (slopes[1] - xi) / unit, slopes[2]
            by_A[places] = np.stack(rates)[kinds]

    def _hessian(self) -> NDArray:
        """That (2N, 2N) of the cost by both splines' coefficients."""
        config = self.config
        nodes, weights = np.polynomial.legendre.leggauss(DEGREE + 1)  # exact for their squares
        spacing = config.knot_spacing
        times = (np.arange(self.intervals)[:, None] + (nodes + 1) / 2).ravel() * spacing
        weights = np.tile(weights, self.intervals)[:, None] * spacing / 2
        rows = spline_rows(times, self.intervals, spacing)
        tau = config.smoothing * spacing

        def square(row: NDArray) -> NDArray:
            return row.T @ (weights * row)

        smooth = tau**4 * square(rows.second_rate) + tau**6 * square(rows.third_rate)
        hessian = np.zeros((2 * self.count, 2 * self.count))
        hessian[: self.count, : self.count] = 2 * (square(rows.value) + smooth)
        hessian[self.count :, self.count :] = 2 * (
            config.amplitude_weight * square(rows.value) + smooth
        )
        return hessian

    def _carrier_margins(
        self, orbit: NDArray, terms: NDArray, constants: NDArray, scale: NDArray
    ) -> list[NDArray]:
        """The margins of one carrier's speed and tension at an instant.

        `constants` are its axes and the `numbers`; `scale` are the bound on its speed and the unit
        of that, m/s.
        """
        cables, constraints, _ = self._of_numbers(constants[6:])
        own, axes = OrbitTerms.view(terms[None]), (constants[None, :3], constants[None, 3:6])
        squares, tension_squares = planned_speeds(
            own, axes, PlannedOrbit(*orbit[:, None]), **cables
        )
        tensions = constraints.of_squares(Of.TENSION, tension_squares)
        return [*constraints.of_speeds(squares, scale[:1], scale[1:]), *tensions]

    def _gap_margins(
        self, orbit: NDArray, forces: NDArray, constants: NDArray, scale: NDArray
    ) -> list[NDArray]:
        """The margins of the distance of one pair of carriers at an instant."""
        cables, constraints, _ = self._of_numbers(constants[18:])
        forces, (p, q, attachments) = forces.reshape(2, 3), constants[:18].reshape(3, 2, 3)
        squares = planned_gaps(
            forces[None],
            (p, q),
            PlannedOrbit(*orbit[:, None]),
            attachments=attachments,
            pairs=np.array([[0], [1]]),
            **cables,
        )
        return constraints.of_squares(Of.SEPARATION, squares)

    def _flight_margins_of_one(
        self, orbit: NDArray, terms: NDArray, constants: NDArray, scale: NDArray
    ) -> list[NDArray]:
        """`_flight_margins` of one aircraft at an instant."""
        own, axes = FlightTerms.view(terms[None]), (constants[None, :3], constants[None, 3:6])
        return self._flight_margins(own, axes, PlannedOrbit(*orbit[:, None]), constants[6:])

    def _elementwise(
        self, function: Callable, sizes: list[int], shape: tuple[int, int]
    ) -> ElementwiseFunction:
        """A function of one carrier or pair at an instant, for all of them."""
        key = function.__name__, self.constraints.names(*Of)
        return ElementwiseFunction(function, sizes, shape, key=key, compiles=True)
