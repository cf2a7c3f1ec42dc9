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
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.planned_orbit import (
    FlightTerms,
    OrbitTerms,
    PlannedOrbit,
    planned_gaps,
    planned_speeds,
    term_columns,
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
from drake_nonstop.optimization.terminal_set import TerminalTables
from drake_nonstop.optimization.update_data import ModelParameters
from drake_nonstop.systems.tracing import ElementwiseFunction

_OTHERS_SHARE = 0.3  # of the weight of the speed bound's slack: that of the other limits

# Aircraft have their limits at one in so many instants, at least so many between two knots: what
# they need has fewer dips in a turn than speeds that pass low values.
_FLIGHT_EVERY, _LEAST_FLIGHTS = 4, 5

_INTERVALS_AHEAD = 8  # for which what a plan needs to know is found at once
_SAME_KNOT = 1e-9  # intervals

_RATES = [2, 4, 5]  # of a `PlannedOrbit`: zero on orbits of constant ξ and A
_NOT_OF_ORBITS = [0, *_RATES]  # by which the needs on these have no derivatives

Reference = Callable[[float], NDArray]  # the load's reference (22,) at a time in s


class KnownReferences(NamedTuple):
    """References at the instants of a plan, and of plans that start some intervals later."""

    start_time: float  # s
    ahead: int  # intervals, by which a plan may start later
    rows: NDArray  # (k, 22)


class HorizonMotion(NamedTuple):
    """What plans need to know of a motion, from a time on, for one horizon and some intervals."""

    start_time: float  # s
    ahead: int  # intervals, by which a plan may start later
    references: KnownReferences
    flat_terms: NDArray  # (k, 9n + 3), the `OrbitTerms` at the instants
    flat_flight: NDArray  # (f, 15n + 9), as of `HorizonData`
    least: NDArray  # (k, n), m/s, that speeds have to reach where nothing jumps
    jumps: NDArray  # (k, n), m/s, that a jump at an instant adds, see `jump_margins`
    target_speeds: NDArray  # (k, n), m/s, with all that have not settled yet
    terminal: TerminalTables  # at the terminal instants


class HorizonData(NamedTuple):
    """Data that vary from plan to plan."""

    start_time: float  # s
    start_angle: float  # θ, rad
    flat_terms: NDArray  # (k, 9n + 3), the `OrbitTerms` at the instants
    terminal: TerminalTables  # at the terminal instants
    speed_bound: float  # m/s, tightened
    target_speeds: (
        NDArray  # (k, n), m/s, what speeds have to reach at the instants: no less than that
    )
    # (f, 15n + 9), the `FlightTerms` at those with limits of flight; (f, 0) where there are none
    flat_flight: NDArray
    wind: NDArray  # (3,) or (k, 3), m/s, that aircraft fly in
    motion: HorizonMotion  # of which these are a part

    @property
    def terms(self) -> OrbitTerms:
        """Data at the instants."""
        return OrbitTerms.view(self.flat_terms)

    @property
    def speed_unit(self) -> float:
        """That of the margins of speeds, m/s; without a bound any speed is enough."""
        return self.speed_bound or 1.0

    @property
    def excess(self) -> NDArray:
        """By how much (k, n) margins of speeds have to be above those of the bound."""
        return (self.target_speeds**2 - self.speed_bound**2) / self.speed_unit**2

    def speed_of(self, margin: float) -> float:
        """The speed in m/s of a margin."""
        return math.sqrt(max(margin * self.speed_unit**2 + self.speed_bound**2, 0.0))


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

    def _place_instants(self) -> None:
        """Tells the instants at which carriers are limited, and which of them have more limits."""
        config, intervals = self.config, self.intervals
        count = intervals * config.instants
        # Where coefficients are fixed, so is the value at the start: no instant is there.
        self._first_instant = 1 if config.fixed_coefficients else 0
        end = intervals * config.knot_spacing
        self.instants = end / count * np.arange(self._first_instant, count + 1)
        self._settling_instants = self.settling_instants(end / count)
        last = len(self.instants) - 1
        back = np.arange(config.terminal_instants * config.terminal_knots)[::-1]
        # Some of the instants, the same ones in each interval.
        self.terminal_at = last - back * config.instants // config.terminal_instants
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
        self._orbits_of = np.searchsorted(self._flight_at, self.terminal_at[ends])

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

        Where `last` is of the same reference, bound and wind, what is known of the motion is taken
        from it; where that ends, the motion is found for some plans at once. The wind (3,) in
        m/s, in W, is that of the whole horizon, or those (k, 3) at its instants, without `last`; it
        counts for aircraft.
        """
        bound = tightened_bound(self.limits, speed_bound)
        wind = STILL_AIR if self.model.aircraft is None else wind
        config, motion, later, known = self.config, None, None, None
        if last is not None:
            if last.speed_bound == bound and np.array_equal(last.wind, wind):
                if last.start_time == start_time:
                    return last._replace(start_angle=start_angle)
                motion = last.motion
                later = self._intervals_later(motion.start_time, motion.ahead, start_time)
            known = last.motion.references
        if motion is None or later is None:
            ahead, later = (0 if motion is None else _INTERVALS_AHEAD), 0
            references = self._references(start_time, reference, known, ahead)
            motion = self._motion(start_time, references, speed_bound, wind, ahead)
        count, flights = len(self.instants), len(self._flight_at)
        at, flight_at = later * config.instants, later * self._flights_per_knot
        target_speeds = motion.target_speeds[at : at + count]
        if later and speed_bound > 0:  # no jump before the start of a plan counts
            target_speeds = target_speeds.copy()
            settled = slice(at, at + self._settling_instants)
            jumps = motion.jumps[settled].copy()
            jumps[0] = 0
            target_speeds[: len(jumps)] = motion.least[settled] + np.maximum.accumulate(jumps)
        return HorizonData(
            start_time,
            start_angle,
            motion.flat_terms[at : at + count],
            motion.terminal.part(later * config.terminal_instants, len(self.terminal_at)),
            bound,
            target_speeds,
            motion.flat_flight[flight_at : flight_at + flights],
            wind,
            motion,
        )

    def _intervals_later(self, first: float, most: int, start_time: float) -> int | None:
        """How many intervals a time (s) is after a first one; None: no whole one, or too many."""
        intervals = (start_time - first) / self.config.knot_spacing
        later = round(intervals)
        is_known = abs(intervals - later) < _SAME_KNOT and 0 <= later <= most
        return later if is_known else None

    def _references(
        self, start_time: float, reference: Reference, known: KnownReferences | None, ahead: int
    ) -> KnownReferences:
        """References from a time on, for plans that start so many intervals later, or fewer.

        Those that are known, of the same motion, are taken where they reach as far.
        """
        config = self.config
        if known is not None:
            later = self._intervals_later(known.start_time, known.ahead - ahead, start_time)
            if later is not None:
                return KnownReferences(
                    start_time, known.ahead - later, known.rows[later * config.instants :]
                )
            ahead = max(ahead, _INTERVALS_AHEAD)
        left = getattr(reference, "end_time", math.inf) - (start_time + config.horizon)
        ahead = int(min(max(left / config.knot_spacing, 0.0), ahead))
        times = self.times(start_time, len(self.instants) + ahead * config.instants)
        return KnownReferences(start_time, ahead, references_at(reference, times))

    def _motion(
        self,
        start_time: float,
        known: KnownReferences,
        speed_bound: float,
        wind: NDArray,
        ahead: int,
    ) -> HorizonMotion:
        """The terms of a motion, also for plans that start so many intervals later, or fewer."""
        config, bound = self.config, tightened_bound(self.limits, speed_bound)
        ahead = min(ahead, known.ahead) if wind.ndim == 1 else 0

        def extended(numbers: NDArray, each: int) -> NDArray:
            """Numbers of instants, of which there are so many in an interval, goes on with them."""
            later = config.instants * np.arange(1, ahead + 1)[:, None]
            return np.append(numbers, later + numbers[-each:])

        count = len(self.instants) + ahead * config.instants
        flight_at = extended(self._flight_at, self._flights_per_knot)
        terminal_at = extended(self.terminal_at, config.terminal_instants)
        references = known.rows[:count]
        winds = np.broadcast_to(wind, (count, WIND_SIZE))
        flat = self.all_terms(references, winds)
        terms = OrbitTerms.view(flat)
        least, jumps = np.zeros((2, count, self.model.n))
        target_speeds = least
        if speed_bound > 0:
            # Where carriers pass low speeds they are off by a share of their orbits' speeds.
            sizes = float(np.prod(self.nominal)) * np.linalg.norm(self.axes[0], axis=1)
            orbits = sizes * self._reach(terms)
            least = np.maximum(bound, speed_bound + config.orbit_tightening * orbits)
            jumps = self.jump_margins(terms)
            target_speeds = least + self.settled(jumps, self._settling_instants)
        return HorizonMotion(
            start_time=start_time,
            ahead=ahead,
            references=known,
            flat_terms=flat,
            flat_flight=self.flight_terms(references[flight_at], winds[flight_at]),
            least=least,
            jumps=jumps,
            target_speeds=target_speeds,
            terminal=self.terminal_tables(flat[terminal_at], target_speeds[terminal_at]),
        )

    def times(self, start_time: float, count: int | None = None) -> NDArray:
        """The times of so many instants, those of two plans that start at knots to the bit.

        None: those of a plan.
        """
        spacing = self.config.knot_spacing / self.config.instants
        knot = round(start_time / self.config.knot_spacing)
        numbers = self._first_instant + np.arange(len(self.instants) if count is None else count)
        if abs(start_time - knot * self.config.knot_spacing) > 1e-9 * max(1.0, start_time):
            return start_time + numbers * spacing
        return (knot * self.config.instants + numbers) * spacing

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
        angle, *others = (rows @ coefficients[i // 3] for i, rows in enumerate(self.jacobians))
        return PlannedOrbit(data.start_angle + angle, *others)

    def speeds(self, data: HorizonData, coefficients: NDArray) -> NDArray:
        """The carriers' speeds (k, n), m/s, at the instants."""
        return self.values_along(Of.SPEED, data.terms, self.orbit(data, coefficients))

    def linearization(self, data: HorizonData, coefficients: NDArray) -> Linearization:
        """The constraints about coefficients (2, N)."""
        orbit, size = self.orbit(data, coefficients), len(self.layout.names)
        margins, gradients, weights = np.zeros(size), np.zeros((6, size)), np.zeros((3, size))
        for part in self.functions:
            values, slopes = part.function(*part.inputs(data, orbit))
            slopes[:, _NOT_OF_ORBITS, part.along :] = 0
            margins[part.places], gradients[:, part.places] = values, slopes.swapaxes(0, 1)
        speeds = margins[self._speed_places]
        slowest = data.speed_of(speeds.min())
        for place in self.neighbouring:
            dipping, own_weights = with_dips(margins[place])
            margins[place], weights[:, place] = dipping, own_weights
        # What carriers have to keep beyond the bound steps with time: no minimum follows from it.
        margins[self._speed_places] -= data.excess
        self._set_terminal(data, orbit, margins, gradients)
        return Linearization(margins, gradients, weights, self.jacobians, self.layout, slowest)

    def judged(self, data: HorizonData, coefficients: NDArray) -> tuple[NDArray, float]:
        """The margins (r,) of `linearization`, and the least speed at the instants, m/s."""
        found = self.linearization(data, coefficients)
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
        if self._limits_flight:
            at, first = self._flight_at[:, None], slacks * flight_kind
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
            phases = np.zeros((len(self._orbit_angles), 1), int)
            at = self._flight_at[self._orbits_of, None, None]
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

    def _make_functions(self, places: list[NDArray]) -> None:
        """Makes the functions of margins, of constraints numbered as in each block."""
        count, n = len(self.instants), self.model.n
        every = np.arange(count)
        pairs = places[0].shape[1] - (self._pairs.shape[1] if self._keeps_apart else 0)
        of_carriers = places[0][:, :pairs].reshape(count, -1, n).swapaxes(0, 1)
        of_terms = term_columns(n)
        along: dict[str, Any] = {"instants": every, "along": count, "angles": np.zeros(count)}
        axes = np.hstack(self.axes).T[:, None]
        self.functions = [
            MarginFunction(
                self._elementwise(self._carrier_margins, [6, 12, 6, 2], (count, n)),
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
            constants = [part[chosen].T for part in vectors for chosen in self._pairs]
            self.functions.append(
                MarginFunction(
                    self._elementwise(self._gap_margins, [6, 6, 18, 2], (count, of_pairs.shape[2])),
                    **along,
                    places=of_pairs,
                    source="flat_terms",
                    rows=every,
                    columns=np.concatenate([of_terms[:3, chosen] for chosen in self._pairs]),
                    constants=np.concatenate(constants)[:, None],
                )
            )
        if self._limits_flight:
            at, angles = self._flight_at, self._orbit_angles
            orbits = np.repeat(self._orbits_of, len(angles))
            of_both = [part.reshape(-1, part.shape[-1] // n, n) for part in (places[1], places[3])]
            rows = np.concatenate([np.arange(len(at)), orbits])
            self.functions.append(
                MarginFunction(
                    self._elementwise(self._flight_margins_of_one, [6, 24, 6, 2], (len(rows), n)),
                    instants=at[rows],
                    along=len(at),
                    angles=np.append(np.zeros(len(at)), np.tile(angles, len(self._orbits_of))),
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

    def _gap_margins(
        self, orbit: NDArray, forces: NDArray, constants: NDArray, scale: NDArray
    ) -> list[NDArray]:
        """The margins of the distance of one pair of carriers at an instant."""
        forces, (p, q, attachments) = forces.reshape(2, 3), constants.reshape(3, 2, 3)
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
        self, orbit: NDArray, terms: NDArray, axes: NDArray, scale: NDArray
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


def references_at(reference: Reference, times: NDArray) -> NDArray:
    """The references (k, 22) at times (k,) in s."""
    at = getattr(reference, "at", None)  # of a `ReferencePreview`
    return np.array([reference(time) for time in times]) if at is None else at(times)
