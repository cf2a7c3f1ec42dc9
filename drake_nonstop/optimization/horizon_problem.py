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

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.planned_orbit import (
    FlightTerms,
    OrbitTerms,
    PlannedOrbit,
    planned_gaps,
    planned_speeds,
)
from drake_nonstop.mechanics.rigid_load import STILL_AIR
from drake_nonstop.mechanics.signals import WIND_SIZE
from drake_nonstop.model.system import Model
from drake_nonstop.optimization.diagnostics import BOUND
from drake_nonstop.optimization.horizon_config import HorizonConfig, timed
from drake_nonstop.optimization.limits import Of
from drake_nonstop.optimization.linearization import (
    ConstraintBlock,
    ConstraintLayout,
    Linearization,
    with_dips,
)
from drake_nonstop.optimization.orbit_constraints import OrbitConstraints
from drake_nonstop.optimization.plan import DEGREE, Plan, spline_rows
from drake_nonstop.optimization.problem_config import LimitsConfig, tightened_bound
from drake_nonstop.optimization.terminal_set import TerminalSet
from drake_nonstop.optimization.update_data import ModelParameters
from drake_nonstop.systems.tracing import ElementwiseFunction

_OTHERS_SHARE = 0.3  # of the weight of the speed bound's slack: that of the other limits

# Aircraft have their limits at one in so many instants, at least so many between two knots: what
# they need has fewer dips in a turn than speeds that pass low values.
_FLIGHT_EVERY, _LEAST_FLIGHTS = 4, 5

Reference = Callable[[float], NDArray]  # the load's reference (22,) at a time in s


class HorizonData(NamedTuple):
    """Data that vary from plan to plan."""

    start_time: float  # s
    start_angle: float  # θ, rad
    flat_terms: NDArray  # (k, 9n + 3), the `OrbitTerms` at the instants
    terminal: TerminalSet  # at the terminal instants
    speed_bound: float  # m/s, tightened
    target_speeds: (
        NDArray  # (k, n), m/s, what speeds have to reach at the instants: no less than that
    )
    # (f, 15n + 9), the `FlightTerms` at those with limits of flight; (f, 0) where there are none
    flat_flight: NDArray
    wind: NDArray  # (3,) or (k, 3), m/s, that aircraft fly in

    @property
    def terms(self) -> OrbitTerms:
        """Data at the instants."""
        return OrbitTerms.view(self.flat_terms)


class HorizonProblem(OrbitConstraints):
    """The problem of all plans of one model and config.

    Args:
        model: what the controllers believe.
        limits: ε, `tightening`, the nominal ξ and A, and their bounds.
        config: the horizon.
        name: tells what evaluates the terms, for the error of a value that is not finite.
        beliefs: numbers in place of those of model and limits.
    """

    def __init__(
        self,
        model: Model,
        limits: LimitsConfig,
        config: HorizonConfig,
        name: Callable[[], str],
        *,
        beliefs: ModelParameters | None = None,
    ):
        config = timed(config, limits.frequency, model.control_period)
        super().__init__(model, limits, config, name, beliefs=beliefs)
        self.intervals = round(config.horizon / config.knot_spacing)
        self.count = self.intervals + DEGREE  # of the coefficients of ξ, and of A
        self._place_instants()
        self._place_constraints()
        rows = spline_rows(self.instants, self.intervals, config.knot_spacing)
        xi, A = self.nominal
        self._jacobians = PlannedOrbit(
            angle=xi * rows.integral,
            frequency=xi * rows.value,
            frequency_rate=xi * rows.rate,
            amplitude=A * rows.value,
            amplitude_rate=A * rows.rate,
            amplitude_second_rate=A * rows.second_rate,
        )
        self.hessian = self._hessian()
        self._axis_columns = np.hstack(self.axes).T[:, None]
        shape = len(self.instants), model.n
        self._margins_along = [self._elementwise(self._carrier_margins, [6, 12, 6, 2], shape)]
        if self._keeps_apart:
            shape = len(self.instants), self._pairs.shape[1]
            self._margins_along.append(self._elementwise(self._gap_margins, [6] * 5, shape))
        if self._limits_flight:
            shape = len(self._flight_at) + len(self._orbits_of) * len(self._orbit_angles), model.n
            self._planned_flight = self._elementwise(self._flight_margins_of_one, [6, 24, 6], shape)

    def _place_instants(self) -> None:
        """Tells the instants at which carriers are limited, and which of them have more limits."""
        config, intervals = self.config, self.intervals
        count = intervals * config.instants
        # Where coefficients are fixed, so is the value at the start: no instant is there.
        self._first_instant = 1 if config.fixed_coefficients else 0
        end = intervals * config.knot_spacing
        self.instants = end / count * np.arange(self._first_instant, count + 1)
        self._instant_spacing = end / count
        last = len(self.instants) - 1
        back = np.arange(config.terminal_instants * config.terminal_knots)[::-1]
        # Some of the instants, the same ones in each interval.
        self._terminal_at = last - back * config.instants // config.terminal_instants
        # The last instant of each interval is one of those at which flight is limited.
        flown = max(
            math.ceil(config.instants / _FLIGHT_EVERY), min(_LEAST_FLIGHTS, config.instants)
        )
        back = np.arange(flown * intervals)[::-1]
        self._flight_at = last - back * config.instants // flown
        if self._first_instant == 0:
            self._flight_at = np.append(0, self._flight_at)
        self._flights_per_knot = flown
        # What aircraft need on whole orbits is limited at the ends of the intervals.
        ends = np.arange(1, config.terminal_knots + 1) * config.terminal_instants - 1
        self._orbits_of = np.searchsorted(self._flight_at, self._terminal_at[ends])

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

    def nominal_coefficients(self) -> NDArray:
        """Coefficients (2, N) of the nominal ξ and A."""
        return np.ones((2, self.count))

    def data(
        self,
        start_time: float,
        start_angle: float,
        reference: Reference,
        speed_bound: float,
        last: HorizonData | None = None,
        wind: NDArray = STILL_AIR,
    ) -> HorizonData:
        """The data of a plan from a time in s and phase in rad on, for ε in m/s.

        Where `last` is of the same reference, bound and wind, and began at the same time or one
        interval between knots before, what both have in common is taken from it. The wind (3,) in
        m/s, in W, is that of the whole horizon, or those (k, 3) at its instants, without `last`; it
        counts for aircraft.
        """
        bound = tightened_bound(self.limits, speed_bound)
        spacing = self.config.knot_spacing
        wind = STILL_AIR if self.model.aircraft is None else wind
        is_alike = last is not None and last.speed_bound == bound and (last.wind == wind).all()
        if last is not None and is_alike and last.start_time == start_time:
            return last._replace(start_angle=start_angle)
        is_next = last is not None and abs(start_time - last.start_time - spacing) < 1e-9
        known = last if is_next and is_alike else None
        count = self.config.instants if known is not None else len(self.instants)
        flown = self._flights_per_knot if known is not None else len(self._flight_at)
        references = references_at(reference, self.times(start_time)[-count:])
        winds = np.broadcast_to(wind, (len(self.instants), WIND_SIZE))
        at = self._flight_at[-flown:]
        flat = self.all_terms(references, winds[-count:])
        flight = self.flight_terms(references[at - len(self.instants)], winds[at])
        if known is not None:
            flat = np.concatenate([known.flat_terms[count:], flat])
            flight = np.concatenate([known.flat_flight[flown:], flight])
        target_speeds = self._target_speeds(flat, speed_bound, bound)
        if known is None:
            places = self._terminal_at
            terminal = self.terminal_set(flat[places], target_speeds[places, :, None])
        else:
            places = self._terminal_at[-self.config.terminal_instants :]
            new = self.terminal_set(flat[places], target_speeds[places, :, None])
            terminal = known.terminal.continued(new, self.config.terminal_instants)
        return HorizonData(
            start_time, start_angle, flat, terminal, bound, target_speeds, flight, wind
        )

    def _target_speeds(self, flat_terms: NDArray, speed_bound: float, tightened: float) -> NDArray:
        """The speeds (k, n) in m/s that carriers have to keep in the plan, at k instants.

        Where carriers pass low speeds they are off by a share of what their orbits' speeds are
        elsewhere.
        """
        terms = OrbitTerms.view(flat_terms)
        if speed_bound == 0:
            return np.zeros(terms.forces.shape[:2])
        frequency, amplitude = self.nominal
        sizes = np.linalg.norm(self.axes[0], axis=1)
        orbits = frequency * amplitude * sizes * self._reach(terms)
        least = np.maximum(tightened, speed_bound + self.config.orbit_tightening * orbits)
        return least + self.jump_margins(flat_terms, self._instant_spacing)

    def times(self, start_time: float) -> NDArray:
        """The times (k,) of the instants, those of two plans that start at knots to the bit."""
        spacing = self.config.knot_spacing
        knot = round(start_time / spacing)
        if abs(start_time - knot * spacing) > 1e-9 * max(1.0, start_time):
            return start_time + self.instants
        counts = knot * self.config.instants + self._first_instant + np.arange(len(self.instants))
        return counts * (spacing / self.config.instants)

    def amplitude_margins(
        self, data: HorizonData, every: int
    ) -> Callable[[NDArray], NDArray] | None:
        """Tells the worst margin (a,) of A (a,) in what does not depend on ξ, over whole orbits.

        At every so many instants of the horizon; None where there is no such limit.
        """
        if not self._constraints.names(Of.TENSION, Of.SEPARATION):
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
        angle, *others = (rows @ coefficients[i // 3] for i, rows in enumerate(self._jacobians))
        return PlannedOrbit(data.start_angle + angle, *others)

    def speeds(self, data: HorizonData, coefficients: NDArray) -> NDArray:
        """The carriers' speeds (k, n), m/s, at the instants."""
        return self.values_along(Of.SPEED, data.terms, self.orbit(data, coefficients))

    def linearization(self, data: HorizonData, coefficients: NDArray) -> Linearization:
        """The constraints about coefficients (2, N)."""
        orbit, bound = self.orbit(data, coefficients), data.speed_bound
        unit = bound or 1.0  # m/s, of the margins of speeds; without a bound any speed is enough
        columns = np.stack(orbit)[:, :, None]
        scale = np.array([bound, unit])[:, None, None]
        given: list[tuple[NDArray, ...]] = [(data.terms.columns, self._axis_columns, scale)]
        if self._keeps_apart:
            given.append(self._of_pairs(data.terms.forces))
        functions = zip(self._margins_along, given, strict=True)
        along, by_along = _side_by_side(*(function(columns, *own) for function, own in functions))
        along, weights = with_dips(along)
        # What carriers have to keep beyond the bound steps with time: no minimum follows from it.
        along[:, : self.model.n] -= (data.target_speeds**2 - bound**2) / unit**2
        terminal, by_terminal = self._terminal_margins(data, orbit)
        margins, gradients, all_weights = [along, terminal], [by_along, by_terminal], [weights]
        if self._limits_flight:
            flight, by_flight = self._flight_margins_along(data, orbit)
            count = len(self._flight_at)
            dipping, weights = with_dips(flight[:count])
            by_orbits = by_flight[:, count:].copy()
            by_orbits[[0, 2, 4, 5]] = 0  # the orbits are of constant ξ and A, at given phases
            margins = [along, dipping, terminal, flight[count:]]
            gradients = [by_along, by_flight[:, :count], by_terminal, by_orbits]
            all_weights.append(weights)
        flat = np.concatenate([part.ravel() for part in margins])
        found = np.zeros((3, len(flat)))
        dips = np.hstack([part.reshape(3, -1) for part in all_weights])
        found[:, : dips.shape[1]] = dips
        by = np.hstack([part.reshape(6, -1) for part in gradients])
        return Linearization(flat, by, found, self._jacobians, self.layout)

    def margins(self, data: HorizonData, coefficients: NDArray) -> NDArray:
        """The margins (r,) of `linearization`."""
        return self.linearization(data, coefficients).margins

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
        limits, n, slacks = self._constraints, self.model.n, self.intervals + 1
        fast, tensions = limits.names(Of.SPEED), limits.names(Of.TENSION)
        pairs = limits.names(Of.SEPARATION)
        names = np.array([BOUND, *fast, *tensions] * n).reshape(n, -1).T.ravel()
        names = np.append(names, np.repeat(pairs, self._pairs.shape[1]))
        of_flight = np.repeat(limits.names(Of.FLIGHT), n)
        has_others = len(names) > n
        kinds, flight_kind = (names != BOUND) * 1, 1 + has_others
        pieces = np.floor(self.instants / self.config.knot_spacing - 1e-9).clip(0).astype(int)
        along = np.arange(len(self.instants))[:, None]
        blocks = [ConstraintBlock(along, pieces[:, None] + slacks * kinds, names, 0)]
        # Of the terminal set, what does not depend on ξ is one margin, of any limit of these.
        apart = tensions + pairs
        only = [(names[0] if len(names) == 1 else "") for names in ([BOUND], fast, apart)]
        is_limited = np.array([True, bool(fast), bool(apart)])
        self._terminal_kinds = np.flatnonzero(is_limited)
        last = self.intervals + slacks * (self._terminal_kinds > 0)
        terminal_names = np.array(only)[self._terminal_kinds]
        blocks.append(
            ConstraintBlock(self._terminal_at, last[:, None], terminal_names[:, None], None)
        )
        if self._limits_flight:
            at, first = self._flight_at[:, None], slacks * flight_kind
            blocks.insert(1, ConstraintBlock(at, pieces[at] + first, of_flight, 0))
            phases = np.zeros((len(self._orbit_angles), 1), int)
            at = self._flight_at[self._orbits_of, None, None]
            slack = self.intervals + first + phases
            blocks.append(ConstraintBlock(at, slack, of_flight, 1))
        self.layout = ConstraintLayout.of_blocks(blocks)
        weights = np.full(slacks, self.config.knot_spacing)
        weights[-1] *= self.config.terminal_knots
        shares = [1.0] + [_OTHERS_SHARE] * (has_others + self._limits_flight)
        self.slack_weights = self.config.slack_weight * np.outer(shares, weights).ravel()

    def _flight_margins_along(
        self, data: HorizonData, orbit: PlannedOrbit
    ) -> tuple[NDArray, NDArray]:
        """The margins (k, m) of aircraft's limits and their gradients (6, k, m).

        At those instants, and after them at all phases of orbits at the ends of the last intervals.
        """
        along = PlannedOrbit(*(values[self._flight_at] for values in orbit))
        every = np.repeat(self._orbits_of, len(self._orbit_angles))
        zero = np.zeros(len(every))
        angles = np.tile(self._orbit_angles, len(self._orbits_of))
        around = [angles, along.frequency[every], zero, along.amplitude[every], zero, zero]
        terms = FlightTerms.view(np.concatenate([data.flat_flight, data.flat_flight[every]]))
        columns = np.hstack([along, around])[:, :, None]
        return _side_by_side(self._planned_flight(columns, terms.columns, self._axis_columns))

    def _of_pairs(self, forces: NDArray) -> tuple[NDArray, ...]:
        """Forces (k, n, 3), p, q and attachments of both carriers of a pair, each (6, k, m)."""

        def of_both(vectors: NDArray) -> NDArray:
            both = np.moveaxis(vectors[:, self._pairs], (1, 3), (0, 1))
            return both.reshape(6, *both.shape[2:])

        constants = (*self.axes, self.model.attachments)
        return of_both(forces), *(of_both(part[None]) for part in constants)

    def _terminal_margins(self, data: HorizonData, orbit: PlannedOrbit) -> tuple[NDArray, NDArray]:
        """The margins (m, k) of the terminal set, and their gradients (6, m, k).

        A ξ/s − 1 by a fixed unit of s, the same from above, and what does not depend on ξ.
        """
        xi, A = orbit.frequency[self._terminal_at], orbit.amplitude[self._terminal_at]
        (least, most, others), slopes = data.terminal.at(A)
        unit = self.nominal[0] * self.nominal[1]
        gradients = np.zeros((6, 3, len(A)))
        with np.errstate(invalid="ignore"):
            margins = np.stack([(A * xi - least) / unit, (most - A * xi) / unit, others])
            gradients[1, :2] = A / unit, -A / unit
            gradients[3] = (xi - slopes[0]) / unit, (slopes[1] - xi) / unit, slopes[2]
        return margins[self._terminal_kinds], gradients[:, self._terminal_kinds]

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
        self, orbit: NDArray, terms: NDArray, axes: NDArray, scale: NDArray
    ) -> list[NDArray]:
        """The margins of one carrier's speed and tension at an instant.

        `scale` are the bound on its speed and the unit of that, m/s.
        """
        own, axis = OrbitTerms.view(terms[None]), (axes[None, :3], axes[None, 3:])
        squares, tension_squares = planned_speeds(
            own, axis, PlannedOrbit(*orbit[:, None]), **self._cables
        )
        tensions = self._constraints.of_squares(Of.TENSION, tension_squares)
        return [*self._constraints.of_speeds(squares, scale[:1], scale[1:]), *tensions]

    def _gap_margins(self, orbit: NDArray, *both: NDArray) -> list[NDArray]:
        """The margins of the distance of one pair of carriers at an instant."""
        forces, p, q, attachments = (vectors.reshape(2, 3) for vectors in both)
        squares = planned_gaps(
            forces[None],
            (p, q),
            PlannedOrbit(*orbit[:, None]),
            attachments=attachments,
            pairs=np.array([[0], [1]]),
            **self._cables,
        )
        return self._constraints.of_squares(Of.SEPARATION, squares)

    def _flight_margins_of_one(
        self, orbit: NDArray, terms: NDArray, axes: NDArray
    ) -> list[NDArray]:
        """`_flight_margins` of one aircraft at an instant."""
        own = FlightTerms.view(terms[None])
        planned = PlannedOrbit(*orbit[:, None])
        return self._flight_margins(own, (axes[None, :3], axes[None, 3:]), planned)

    def _elementwise(
        self, function: Callable, sizes: list[int], shape: tuple[int, int]
    ) -> ElementwiseFunction:
        """A function of one carrier or pair at an instant, for all of them."""
        key = function.__name__, self.model.aircraft, self.limits, self.rest_length, self.compliance
        return ElementwiseFunction(function, sizes, shape, key=key)


def _side_by_side(*parts: tuple[NDArray, NDArray]) -> tuple[NDArray, NDArray]:
    """Values (c, k, n) and gradients (c, 6, k, n), as (k, m) and (6, k, m) of all columns."""
    values = [found.swapaxes(0, 1).reshape(found.shape[1], -1) for found, _ in parts]
    slopes = [by.transpose(1, 2, 0, 3).reshape(6, by.shape[2], -1) for _, by in parts]
    return np.concatenate(values, axis=1), np.concatenate(slopes, axis=2)


def references_at(reference: Reference, times: NDArray) -> NDArray:
    """The references (k, 22) at times (k,) in s."""
    at = getattr(reference, "at", None)  # of a `ReferencePreview`
    return np.array([reference(time) for time in times]) if at is None else at(times)
