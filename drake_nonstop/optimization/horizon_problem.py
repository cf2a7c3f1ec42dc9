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
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.internal_force import orbit_axes
from drake_nonstop.mechanics.planned_orbit import (
    FlightTerms,
    OrbitTerms,
    PlannedOrbit,
    PlannedSpeeds,
    flight_along_reference,
    orbit_along_reference,
    planned_gaps,
    planned_needs,
    planned_speeds,
)
from drake_nonstop.mechanics.reference_preview import ReferencePreview
from drake_nonstop.mechanics.rigid_load import STILL_AIR, RigidLoad
from drake_nonstop.mechanics.signals import (
    LOAD_REFERENCE_SIZE,
    WIND_SIZE,
    PlannedParameters,
)
from drake_nonstop.model.system import Model
from drake_nonstop.optimization.diagnostics import BOUND
from drake_nonstop.optimization.flight_limits import FlightLimits
from drake_nonstop.optimization.limits import Of
from drake_nonstop.optimization.margins import ConstraintMargins
from drake_nonstop.optimization.plan import DEGREE, Plan, spline_rows
from drake_nonstop.optimization.problem_config import LimitsConfig, tightened_bound
from drake_nonstop.optimization.separation import SeparationConstraint
from drake_nonstop.optimization.terminal_set import (
    TerminalSet,
    least_distance_squares,
    product_limits,
)
from drake_nonstop.optimization.traced_problem import beliefs_of
from drake_nonstop.optimization.update_data import Beliefs
from drake_nonstop.systems.tracing import ElementwiseFunction, TracedFunction
from drake_nonstop.validation import non_negative, positive

_OTHERS_SHARE = 0.3  # of the weight of the speed bound's slack: that of the other limits

# Aircraft have their limits at one in so many instants, at least so many between two knots: what
# they need has fewer dips in a turn than speeds that pass low values.
_FLIGHT_EVERY, _LEAST_FLIGHTS = 4, 5

_NEIGHBOURS = (-1, 1, 2)  # of an instant, which tell how low a speed is between two

_Horizon = TypeVar("_Horizon", bound="HorizonConfig")
Reference = Callable[[float], NDArray]  # the load's reference (22,) at a time in s


@dataclass(kw_only=True)
class HorizonConfig:
    """The horizon, its cost and its constraints; with those of a `LimitsConfig`.

    With `fixed_coefficients` 0 the problem is one of a plan that has no predecessor.
    """

    horizon: float = non_negative(0.0)  # s; 0: nearly two turns, 15 intervals of knots at least
    knot_spacing: float = non_negative(0.0)  # s, and between two plans; 0: an eighth of a turn
    instants: int = 20  # between two knots, at which the carriers' flight is constrained
    terminal_knots: int = 4  # of the last part, in which all phases of the orbit are constrained
    terminal_instants: int = 2  # of it, between two knots
    terminal_phases: int = 24  # of the orbit
    terminal_amplitudes: int = 33  # of the table
    amplitude_weight: float = positive(4.0)  # w_A
    smoothing: float = positive(0.4)  # τ, in intervals between knots
    slack_weight: float = positive(100.0)  # ρ
    fixed_coefficients: int = 4  # the first of ξ and A: 4 for three continuous rates
    overshoot: float = non_negative(0.35)  # of a carrier's velocity, of a jump of the plan's
    settling_time: float = non_negative(0.1)  # s, of that overshoot
    orbit_tightening: float = non_negative(0.005)  # of the nominal orbits' speed, the least margin


def timed(config: _Horizon, frequency: float, control_period: float) -> _Horizon:
    """The config with its times, as they follow from the nominal ξ (rad/s) where they are 0.

    The knots then are whole control periods (s) apart; 0: there is none.
    """
    turn = 2 * math.pi / frequency
    spacing = config.knot_spacing
    if spacing == 0:
        spacing = turn / 8
        if control_period > 0:
            spacing = max(round(spacing / control_period), 1) * control_period
    return replace(
        config, knot_spacing=spacing, horizon=config.horizon or _knots(turn, spacing) * spacing
    )


def _knots(turn: float, spacing: float) -> int:
    """The intervals between knots in nearly two turns: 15 of an eighth of one."""
    return max(15, math.ceil(1.8 * turn / spacing))


class HorizonData(NamedTuple):
    """What varies from plan to plan."""

    start_time: float  # s
    start_angle: float  # θ, rad
    flat_terms: NDArray  # (k, 9n + 3), the `OrbitTerms` at the instants
    terminal: TerminalSet  # at the terminal instants
    speed_bound: float  # m/s, tightened
    aims: NDArray  # (k, n), m/s, what speeds have to reach at the instants: no less than that
    # (f, 15n + 9), the `FlightTerms` at those with limits of flight; (f, 0) where there are none
    flat_flight: NDArray
    wind: NDArray  # (3,) or (k, 3), m/s, that aircraft fly in

    @property
    def terms(self) -> OrbitTerms:
        """Those at the instants."""
        return OrbitTerms.view(self.flat_terms)

    @property
    def speed_unit(self) -> float:
        """What scales the margins of squared speeds, m²/s²; without a bound any speed is enough."""
        return self.speed_bound**2 or 1.0


class Slopes(NamedTuple):
    """Matrices (p, N) at p instants by the coefficients of ξ/ξ₀ or of A/A₀.

    The rates ξ̇ and Ä count where aircraft have limits.
    """

    angle: NDArray  # rad
    frequency: NDArray  # rad/s
    amplitude: NDArray  # N
    amplitude_rate: NDArray  # N/s
    frequency_rate: NDArray  # rad/s²
    amplitude_second_rate: NDArray  # N/s²


class Table(NamedTuple):
    """Where margins belong: one row per instant, one column per constraint."""

    instants: NDArray  # (k,), the rows of the slopes
    width: int

    @property
    def shape(self) -> tuple[int, int]:
        """The numbers of instants and of constraints."""
        return len(self.instants), self.width

    @property
    def size(self) -> int:
        """The number of margins."""
        return math.prod(self.shape)


@dataclass(frozen=True, eq=False)
class Linearization:
    """The constraints about a plan, as margins and their gradients.

    A margin is negative where its constraint is not fulfilled without slack. Speeds dip between
    instants, too: where the cubic Hermite spline through the margins has a minimum between two
    instants, the margin at the first of them is that minimum. It is a mean of four neighbours, with
    weights that are fixed to first order, since there the spline does not change with its place.
    The last margins are those of whole orbits, at evenly spaced phases.
    """

    margins: NDArray  # (r,)
    gradients: NDArray  # (g, r), by θ, ξ, A and Ȧ, and with limits of flight by ξ̇ and Ä
    instant_of: NDArray  # (r,), the row of the slopes
    slack_of: NDArray  # (r,), the number of the slack
    slopes: Slopes
    tables: tuple[Table, ...]  # of the first margins, one after the other
    weights: NDArray  # (3, r), of the same constraint at its table's `_NEIGHBOURS`
    widths: NDArray  # (r,), of the tables; 0 in none
    orbits: tuple[int, int, int]  # the last margins are those of k instants, h phases, m limits

    def changes(self, step: NDArray) -> NDArray:
        """What a step (2, N) of the coefficients adds to the margins (r,), to first order."""
        c, d = step
        slopes, rates = self.slopes, self._with_rates
        of_instants = np.stack(
            [
                slopes.angle @ c,
                slopes.frequency @ c,
                slopes.amplitude @ d,
                slopes.amplitude_rate @ d,
                *([slopes.frequency_rate @ c, slopes.amplitude_second_rate @ d] if rates else []),
            ]
        )
        parts = []
        for start, table in self._placed:
            gradients = self.gradients[:, start : start + table.size].reshape(-1, *table.shape)
            parts.append(np.einsum("ikm,ik->km", gradients, of_instants[:, table.instants]).ravel())
        end = self._last
        parts.append((self.gradients[:, end:] * of_instants[:, self.instant_of[end:]]).sum(axis=0))
        changes = np.concatenate(parts)
        found = changes.copy()
        for weights, shift in zip(self.weights, _NEIGHBOURS, strict=True):
            dips = np.flatnonzero(weights)
            neighbours = changes[dips + shift * self.widths[dips]]
            found[dips] += weights[dips] * (neighbours - changes[dips])
        return found

    def jacobian(self, chosen: NDArray, fixed: int = 0) -> NDArray:
        """The rows of chosen margins, by all but the first coefficients of ξ, then of A."""
        found = self._rows(chosen, fixed)
        own = found.copy()
        for weights, shift in zip(self.weights, _NEIGHBOURS, strict=True):
            dips = np.flatnonzero(weights[chosen])
            numbers = chosen[dips]
            neighbours = self._rows(numbers + shift * self.widths[numbers], fixed)
            found[dips] += weights[chosen[dips], None] * (neighbours - own[dips])
        return found

    def _rows(self, chosen: NDArray, fixed: int) -> NDArray:
        gradients, instants = self.gradients[:, chosen, None], self.instant_of[chosen]
        by = [g * slope[instants, fixed:] for g, slope in zip(gradients, self.slopes, strict=False)]
        if self._with_rates:
            return np.hstack([by[0] + by[1] + by[4], by[2] + by[3] + by[5]])
        return np.hstack([by[0] + by[1], by[2] + by[3]])

    @property
    def _with_rates(self) -> bool:
        return len(self.gradients) == len(self.slopes)

    @cached_property
    def _placed(self) -> list[tuple[int, Table]]:
        """The tables with the numbers of their first margins."""
        starts = np.cumsum([0, *(table.size for table in self.tables[:-1])])
        return list(zip(starts.tolist(), self.tables, strict=True))

    @cached_property
    def _last(self) -> int:
        """The number of the first margin that is in no table."""
        return sum(table.size for table in self.tables)

    def dips(self, margins: NDArray, largest: float) -> NDArray:
        """The numbers of margins of at most `largest` that are the least of their neighbours.

        Neighbours are those of the same constraint at the instants before and after, or at the
        phases of an orbit; the table's limits have none. `margins` (r,) are about the same plan or
        of a step from it.
        """
        found = []
        for start, table in self._placed:
            values = margins[start : start + table.size].reshape(table.shape)
            is_dip = values <= largest
            is_dip[1:] &= values[1:] <= values[:-1]
            is_dip[:-1] &= values[:-1] < values[1:]
            found.append(np.flatnonzero(is_dip) + start)
        start, end = self._last, len(margins) - math.prod(self.orbits)
        found.append(np.flatnonzero(margins[start:end] <= largest) + start)
        orbits = margins[end:].reshape(self.orbits)
        before, after = np.roll(orbits, 1, axis=1), np.roll(orbits, -1, axis=1)
        is_low = (orbits <= largest) & (orbits <= before) & (orbits < after)
        return np.concatenate([*found, np.flatnonzero(is_low) + end])

    def with_neighbours(self, chosen: NDArray, margins: NDArray, largest: float) -> NDArray:
        """The numbers of chosen margins, and of those before and after that are at most that."""
        found = [chosen]
        for start, table in self._placed:
            end = start + table.size
            own = chosen[(chosen >= start) & (chosen < end)]
            near = np.concatenate([own - table.width, own + table.width])
            near = near[(near >= start) & (near < end)]
            found.append(near[margins[near] <= largest])
        return np.concatenate(found)


class HorizonProblem:
    """What all plans of one model and config share.

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
        beliefs: Beliefs | None = None,
    ):
        config = timed(config, limits.frequency, model.control_period)
        self.model, self.limits, self.config, self.name = model, limits, config, name
        self.intervals = round(config.horizon / config.knot_spacing)
        self.count = self.intervals + DEGREE  # of the coefficients of ξ, and of A
        beliefs = beliefs or beliefs_of(model, limits)
        self.nominal = beliefs.nominal
        self._bounds = np.stack([beliefs.lower, beliefs.upper])
        self._beliefs = np.concatenate(beliefs)
        self.rest_length = float(beliefs.rest_length[0])  # m
        self.compliance = float(beliefs.compliance[0])  # m/N
        self._cables: dict[str, Any] = {
            "rest_length": self.rest_length,
            "compliance": self.compliance,
        }
        self.axes = orbit_axes(model.pattern.basis, model.pattern.phases)
        low, high = self._bounds[:, 1]
        self.amplitudes = np.linspace(low, high, config.terminal_amplitudes)
        spacing = config.knot_spacing
        end = self.intervals * spacing
        count = self.intervals * config.instants
        # Where coefficients are fixed, so is the value at the start: no instant is there.
        self._first_instant = 1 if config.fixed_coefficients else 0
        self.instants = end / count * np.arange(self._first_instant, count + 1)
        self._instant_spacing = end / count
        self._per_knot = count // self.intervals  # instants
        count = len(self.instants)
        self._terminal_per_knot = config.terminal_instants
        back = np.arange(self._terminal_per_knot * config.terminal_knots)[::-1]
        # Some of the instants, the same ones in each interval.
        self._terminal_at = count - 1 - back * self._per_knot // self._terminal_per_knot
        self.terminal_instants = self.instants[self._terminal_at]
        # The last instant of each interval is one of those at which flight is limited.
        flown = max(math.ceil(self._per_knot / _FLIGHT_EVERY), min(_LEAST_FLIGHTS, self._per_knot))
        back = np.arange(flown * self.intervals)[::-1]
        self._flight_at = count - 1 - back * self._per_knot // flown
        if self._first_instant == 0:
            self._flight_at = np.append(0, self._flight_at)
        self._flights_per_knot = flown
        # What aircraft need on whole orbits is limited at the ends of the intervals.
        self._orbits_of = np.arange(1, config.terminal_knots + 1) * self._terminal_per_knot - 1
        self._limits = ConstraintMargins(limits, 0)
        self.max_speed = self._limits.max_speed  # m/s, tightened
        self._flight_limits = FlightLimits(limits)
        self._orbit_angles = 2 * np.pi * np.arange(config.terminal_phases) / config.terminal_phases
        self._separation: SeparationConstraint | None = None
        if self._limits.min_separation > 0:
            self._separation = SeparationConstraint(self._limits.min_separation, self.axes)
        self._pairs = np.array(np.triu_indices(model.n, 1))
        if self._separation is not None:
            pairs = self._pairs.shape[1]
            self._planned_gaps = self._elementwise(self._gaps_of_one, [4, *[6] * 4], pairs)
        rows = spline_rows(self.instants, self.intervals, spacing)
        self._rows = rows
        self._flight_rows = type(rows)(*(part[self._flight_at] for part in rows))
        frequency, amplitude = self.nominal
        every = np.concatenate([np.arange(count), self._terminal_at])
        self._slopes = Slopes(
            frequency * rows.integral[every],
            frequency * rows.value[every],
            amplitude * rows.value[every],
            amplitude * rows.rate[every],
            frequency * rows.rate[every],
            amplitude * rows.second_rate[every],
        )
        self._place_constraints()
        self.hessian = self._hessian()
        self._axis_columns = np.hstack(self.axes).T[:, None]
        self._planned_speeds = self._elementwise(self._speeds_of_one, [4, 12, 6], model.n)
        self._terms = self._traced(orbit_along_reference)
        self._flight_terms: TracedFunction | None = None
        if self._limits_flight:
            self._flight_terms = self._traced(flight_along_reference)
            flown = len(self._flight_at) + len(self._orbits_of) * len(self._orbit_angles)
            self._planned_flight = self._elementwise(
                self._flight_margins_of_one, [6, 24, 6], model.n, flown
            )

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
        """Those (2, N) of the nominal ξ and A."""
        return np.ones((2, self.count))

    def terms_at(self, reference: NDArray, wind: NDArray = STILL_AIR) -> NDArray:
        """The flat `OrbitTerms` (9n + 3,) of a reference (22,), in a wind (3,) in m/s, in W."""
        return self._terms(reference, self._beliefs, wind)[0].copy()

    def all_terms(self, references: NDArray, winds: NDArray) -> NDArray:
        """The flat `OrbitTerms` (k, 9n + 3) of references (k, 22), in winds (3,) or (k, 3)."""
        return self._terms.of_rows(self._stacked(references, winds))

    def flight_terms(self, references: NDArray, winds: NDArray) -> NDArray:
        """The flat `FlightTerms` (k, 15n + 9) likewise; (k, 0) without limits of flight."""
        function = self._flight_terms
        if function is None:
            return np.zeros((len(references), 0))
        return function.of_rows(self._stacked(references, winds))

    def _stacked(self, references: NDArray, winds: NDArray) -> NDArray:
        """What functions take of references (k, 22), in winds (3,) or (k, 3)."""
        count = len(references)
        own = np.broadcast_to(self._beliefs, (count, len(self._beliefs)))
        return np.hstack([references, own, np.broadcast_to(winds, (count, WIND_SIZE))])

    def orbit_flight_margins(
        self, flat_flight: NDArray, frequency: float, amplitude: float
    ) -> NDArray:
        """The worst margins (k,) of aircraft's limits over whole orbits of constant ξ and A.

        Of flat `FlightTerms` (k, 15n + 9), with limits of flight.
        """
        angles, count = self._orbit_angles, len(flat_flight)
        orbit = PlannedOrbit.constant(np.tile(angles, count), frequency, amplitude)
        terms = FlightTerms.view(np.repeat(flat_flight, len(angles), axis=0))
        margins = self._flight_margins(terms, self.axes, orbit)
        worst: NDArray = np.min(margins, axis=(0, 2)).reshape(count, -1).min(axis=1)
        return worst

    def _flight_margins(
        self, terms: FlightTerms, axes: tuple[NDArray, NDArray], orbit: PlannedOrbit
    ) -> list[NDArray]:
        """The margins (k, n) of aircraft's limits, of numbers or symbols."""
        aircraft = self.model.aircraft
        assert aircraft is not None
        needs = planned_needs(aircraft, terms, axes, orbit, **self._cables)
        return self._flight_limits.margins(aircraft, needs)

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
        count = self._per_knot if known is not None else len(self.instants)
        flown = self._flights_per_knot if known is not None else len(self._flight_at)
        references = references_at(reference, self.times(start_time)[-count:])
        winds = np.broadcast_to(wind, (len(self.instants), WIND_SIZE))
        at = self._flight_at[-flown:]
        flat = self.all_terms(references, winds[-count:])
        flight = self.flight_terms(references[at - len(self.instants)], winds[at])
        if known is not None:
            flat = np.concatenate([known.flat_terms[count:], flat])
            flight = np.concatenate([known.flat_flight[flown:], flight])
        aims = self._aims(flat, speed_bound, bound)
        if known is None:
            places = self._terminal_at
            terminal = self.terminal_set(flat[places], aims[places, :, None])
        else:
            places = self._terminal_at[-self._terminal_per_knot :]
            new = self.terminal_set(flat[places], aims[places, :, None])
            terminal = known.terminal.continued(new, self._terminal_per_knot)
        return HorizonData(start_time, start_angle, flat, terminal, bound, aims, flight, wind)

    def jump_margins(self, flat_terms: NDArray, spacing: float) -> NDArray:
        """What the speeds (k, n) have to keep above the bound after jumps of the plan, m/s.

        Where the jerk of the reference jumps, so do the planned velocities, by at most
        (L₀/T + 1/K_c) ‖Δd₀‖, T without A. The carriers then swing past the new velocity by a share
        of the jump, the `overshoot`, within the `settling_time`. Own derivation.

        Args:
            flat_terms: (k, 9n + 3), at evenly spaced instants.
            spacing: s, of the instants.
        """
        terms, config = OrbitTerms.view(flat_terms), self.config
        jumps = np.zeros(terms.forces.shape[:2])
        changes = np.linalg.norm(np.diff(terms.rates, axis=0), axis=2)
        jumps[1:] = self._reach(terms)[1:] * changes
        largest = jumps.copy()
        for i in range(1, math.ceil(config.settling_time / spacing)):
            largest[i:] = np.maximum(largest[i:], jumps[:-i])
        return config.overshoot * largest

    def _reach(self, terms: OrbitTerms) -> NDArray:
        """By how much (k, n) a carrier moves with a force across its cable, m/N."""
        return self.rest_length / np.linalg.norm(terms.forces, axis=2) + self.compliance

    def _aims(self, flat_terms: NDArray, speed_bound: float, tightened: float) -> NDArray:
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
        counts = knot * self._per_knot + self._first_instant + np.arange(len(self.instants))
        return counts * (spacing / self._per_knot)

    def terminal_set(
        self,
        flat_terms: NDArray,
        speed_bound: NDArray | float,
        amplitudes: NDArray | None = None,
    ) -> TerminalSet:
        """The terminal set of flat terms (k, 9n + 3), for a bound in m/s or those (k, n, 1).

        Over a table of A (a,) in N; None: that of all plans.
        """
        amplitudes = self.amplitudes if amplitudes is None else amplitudes
        terms = OrbitTerms.view(flat_terms)
        least, most, *tension_squares = product_limits(
            terms,
            self.axes,
            amplitudes,
            speed_bound,
            self._limits.max_speed,
            phase_count=self.config.terminal_phases,
            **self._cables,
        )
        margins = np.full(least.shape, np.inf)
        for squares in tension_squares:
            for margin in self._limits.of_tensions(squares):
                margins = np.minimum(margins, margin)
        if self._separation is not None:
            for row, forces in zip(margins, terms.forces, strict=True):
                np.minimum(row, self._orbit_separation_margins(forces, amplitudes), out=row)
        return TerminalSet(amplitudes, least, most, margins)

    def amplitude_margins(
        self, data: HorizonData, every: int
    ) -> Callable[[NDArray], NDArray] | None:
        """Tells the worst margin (a,) of A (a,) in what does not depend on ξ, over whole orbits.

        At every so many instants of the horizon; None where there is no such limit.
        """
        if not self._limits.limit_tensions and self._separation is None:
            return None
        terms = OrbitTerms.view(data.flat_terms[::every])

        def worst(amplitudes: NDArray) -> NDArray:
            margins = np.full(len(amplitudes), np.inf)
            if self._limits.limit_tensions:
                limits = product_limits(
                    terms,
                    self.axes,
                    amplitudes,
                    0.0,
                    np.inf,
                    phase_count=self.config.terminal_phases,
                    **self._cables,
                )
                for squares in limits[2:]:
                    for margin in self._limits.of_tensions(squares):
                        margins = np.minimum(margins, margin.min(axis=0))
            if self._separation is not None:
                for forces in terms.forces:
                    found = self._orbit_separation_margins(forces, amplitudes)
                    margins = np.minimum(margins, found)
            return margins

        return worst

    def _orbit_separation_margins(self, forces: NDArray, amplitudes: NDArray) -> NDArray:
        """The worst margin (a,) of the separation over a whole orbit at A (a,)."""
        assert self._separation is not None
        squares = least_distance_squares(
            self._separation,
            forces,
            amplitudes,
            attachments=self.model.attachments,
            pairs=self._pairs,
            **self._cables,
        )
        return squares / self._limits.min_separation**2 - 1

    def plan(self, data: HorizonData, coefficients: NDArray) -> Plan:
        """The plan of coefficients (2, N)."""
        return Plan(
            data.start_time, data.start_angle, self.config.knot_spacing, self.nominal, coefficients
        )

    def cost(self, coefficients: NDArray) -> float:
        """The cost of coefficients (2, N), without slack."""
        away = (coefficients - 1).ravel()
        return float(away @ self.hessian @ away) / 2

    def speeds(self, data: HorizonData, coefficients: NDArray) -> PlannedSpeeds:
        """The squared speeds and tensions (k, n) at the instants."""
        return PlannedSpeeds(*self._speeds_and_slopes(data, coefficients)[0])

    def _speeds_and_slopes(
        self, data: HorizonData, coefficients: NDArray
    ) -> tuple[NDArray, NDArray]:
        """The parts (2, k, n) of `speeds`, and their gradients (2, 4, k, n) by θ, ξ, A and Ȧ."""
        orbit = self._orbit(data, coefficients)
        return self._planned_speeds(orbit, data.terms.columns, self._axis_columns)

    def _orbit(self, data: HorizonData, coefficients: NDArray) -> NDArray:
        """θ, ξ, A and Ȧ (4, k, 1) at the instants."""
        c, d = coefficients
        frequency, amplitude = self.nominal
        rows = self._rows
        values = [
            data.start_angle + frequency * (rows.integral @ c),
            frequency * (rows.value @ c),
            amplitude * (rows.value @ d),
            amplitude * (rows.rate @ d),
        ]
        return np.stack(values)[:, :, None]

    def values_along(self, of: Of, terms: OrbitTerms, planned: NDArray) -> NDArray:
        """Speeds, tensions or separations (k, c) at k instants, of the plan's values (k, 8) there.

        In m/s, N or m, of the carriers, the cables or the pairs of carriers.
        """
        values = PlannedParameters.view(planned)
        angle, amplitude = values.angle[:, 0], values.amplitude[:, 0]
        if of is Of.SEPARATION:
            squares = planned_gaps(
                terms.forces,
                self.axes,
                angle,
                amplitude,
                attachments=self.model.attachments,
                pairs=self._pairs,
                **self._cables,
            )
            return np.sqrt(squares)
        found = planned_speeds(
            terms,
            self.axes,
            angle,
            values.frequency[:, 0],
            amplitude,
            values.amplitude_rate[:, 0],
            **self._cables,
        )
        return np.sqrt(found.squares if of is Of.SPEED else found.tension_squares)

    def linearization(self, data: HorizonData, coefficients: NDArray) -> Linearization:
        """The constraints about coefficients (2, N)."""
        values, slopes = self._speeds_and_slopes(data, coefficients)
        limits, bound, unit = self._limits, data.speed_bound, math.sqrt(data.speed_unit)
        margins = limits.of_speeds(values[0], bound, unit)
        gradients = [slopes[0] / unit**2]
        gradients += [factor * slopes[0] for factor in limits.speed_factors]
        if limits.limit_tensions:
            margins += limits.of_tensions(values[1])
            gradients += [factor * slopes[1] for factor in limits.tension_factors]
        if self._separation is not None:
            squares, slopes = self._gaps(data, coefficients)
            factor = 1 / limits.min_separation**2
            margins.append(factor * squares[0] - 1)
            gradients.append(factor * slopes[0])
        of_instants, weights = _with_dips(np.concatenate(margins, axis=1))
        # What carriers have to keep beyond the bound steps with time: no minimum follows from it.
        of_instants[:, : self.model.n] -= (data.aims**2 - bound**2) / unit**2
        terminal, of_terminal = self._terminal_margins(data, coefficients)
        found = [of_instants.ravel(), terminal]
        by = [_columns(np.concatenate(gradients, axis=2)), of_terminal]
        all_weights = [_columns(weights)]
        if self._limits_flight:
            flight, of_flight = self._flight_linearization(data, coefficients)
            count = len(self._flight_at)
            dipping, weights = _with_dips(flight[:count])
            of_orbits = _columns(of_flight[:, count:])
            of_orbits[[0, 3, 4, 5]] = 0  # the orbits are of constant ξ and A, at given phases
            found = [of_instants.ravel(), dipping.ravel(), terminal, flight[count:].ravel()]
            by = [_with_zero_rates(part) for part in by]
            by = [by[0], _columns(of_flight[:, :count]), by[1], of_orbits]
            all_weights.append(_columns(weights))
        all_margins = np.concatenate(found)
        all_weights.append(np.zeros((len(_NEIGHBOURS), np.count_nonzero(self._widths == 0))))
        return Linearization(
            all_margins,
            np.hstack(by),
            self._instant_of,
            self._slack_of,
            self._slopes,
            self._tables,
            np.hstack(all_weights),
            self._widths,
            self._orbits,
        )

    def margins(self, data: HorizonData, coefficients: NDArray) -> NDArray:
        """The margins (r,) of `linearization`."""
        return self.linearization(data, coefficients).margins

    def slacks(self, margins: NDArray) -> NDArray:
        """The least slacks (`slack_count`,) that margins (r,) need."""
        slacks = np.zeros(self.slack_count)
        violated = np.flatnonzero(~(margins >= 0))
        np.maximum.at(slacks, self._slack_of[violated], -margins[violated])
        return slacks

    def missed(self, margins: NDArray, tolerance: float) -> set[str]:
        """What margins (r,) miss by more than a tolerance, by the names of `missed_limits`."""
        return {*self._names[~(margins >= -tolerance)].tolist()} - {""}

    @property
    def slack_count(self) -> int:
        """One per interval between knots and one of the terminal set, for each kind of limit."""
        return len(self.slack_weights)

    def angle_rows(self) -> NDArray:
        """The matrix (intervals, N) of θ at the knots after the start, by the coefficients of ξ."""
        knots = self.config.knot_spacing * np.arange(1, self.intervals + 1)
        rows = spline_rows(knots, self.intervals, self.config.knot_spacing)
        return self.nominal[0] * rows.integral

    def _place_constraints(self) -> None:
        """Tells where margins belong: their instants, and their slacks.

        The bound on the speeds has slack of its own, all limits of aircraft together, and all
        others together.
        """
        limits, n, count = self._limits, self.model.n, len(self.instants)
        pairs = limits.separation_kinds
        sizes = [n] * (len(limits.kinds) - 1) + [self._pairs.shape[1]] * len(pairs)
        others = sum(sizes)
        of_flight = n * len(self._flight_limits.kinds)
        tables = [Table(np.arange(count), n + others), Table(self._flight_at, of_flight)]
        self._tables = tuple(table for table in tables if table.width)
        slack_kinds = [np.repeat([0, 1], [n, others]), np.full(of_flight, 2 if others else 1)]
        is_limited = [True, limits.limit_high_speeds, self._limits_amplitude]
        self._terminal_kinds = np.flatnonzero(is_limited)
        terminal = np.arange(len(self.terminal_instants))
        phases = len(self._orbit_angles) if of_flight else 0
        self._orbits = (len(self._orbits_of), phases, of_flight)
        orbits = math.prod(self._orbits)
        ends = len(terminal) * len(self._terminal_kinds) + orbits
        pieces = np.floor(self.instants / self.config.knot_spacing - 1e-9).clip(0).astype(int)
        slack_of_kind = (self.intervals + 1) * np.arange(3)
        of_terminal = self.intervals + slack_of_kind[np.minimum(self._terminal_kinds, 1)]
        of_tables = [
            (pieces[table.instants, None] + slack_of_kind[kinds]).ravel()
            for table, kinds in zip(tables, slack_kinds, strict=True)
        ]
        self._slack_of = np.concatenate(
            [
                *of_tables,
                np.repeat(of_terminal, len(terminal)),
                np.full(orbits, self.intervals + slack_of_kind[2 if others else 1]),
            ]
        )
        self._instant_of = np.concatenate(
            [
                *(np.repeat(table.instants, table.width) for table in tables),
                np.tile(count + terminal, len(of_terminal)),
                np.repeat(count + self._orbits_of, phases * of_flight),
            ]
        )
        self._widths = np.concatenate(
            [np.repeat([t.width for t in tables], [t.size for t in tables]), np.zeros(ends, int)]
        )
        # Of the terminal set, what does not depend on ξ is one margin, of any limit of these.
        fast = len(limits.speed_factors)
        apart = [*limits.kinds[1 + fast :], *pairs]
        terminal_names = [
            BOUND,
            limits.kinds[1] if fast == 1 else "",
            apart[0] if len(apart) == 1 else "",
        ]
        own = np.repeat(self._flight_limits.kinds, n)
        self._names = np.concatenate(
            [
                np.tile(np.repeat([*limits.kinds, *pairs], [n, *sizes]), count),
                np.tile(own, len(self._flight_at)),
                np.repeat(np.array(terminal_names)[self._terminal_kinds], len(terminal)),
                np.tile(own, len(self._orbits_of) * phases),
            ]
        )
        weights = np.full(self.intervals + 1, self.config.knot_spacing)
        weights[-1] *= self.config.terminal_knots
        shares = [1.0] + [_OTHERS_SHARE] * ((others > 0) + (of_flight > 0))
        self.slack_weights = self.config.slack_weight * np.outer(shares, weights).ravel()

    @property
    def _limits_flight(self) -> bool:
        return bool(self._flight_limits.kinds)

    def _flight_linearization(
        self, data: HorizonData, coefficients: NDArray
    ) -> tuple[NDArray, NDArray]:
        """Those of aircraft's limits (k, m) and their gradients (6, k, m), by the `Slopes`.

        At those instants, and after them at all phases of orbits at the ends of the last intervals.
        """
        c, d = coefficients
        frequency, amplitude = self.nominal
        rows, angles = self._flight_rows, self._orbit_angles
        along = PlannedOrbit(
            data.start_angle + frequency * (rows.integral @ c),
            frequency * (rows.value @ c),
            frequency * (rows.rate @ c),
            amplitude * (rows.value @ d),
            amplitude * (rows.rate @ d),
            amplitude * (rows.second_rate @ d),
        )
        at = np.searchsorted(self._flight_at, self._terminal_at[self._orbits_of])
        every = np.repeat(at, len(angles))
        zero = np.zeros(len(every))
        around = PlannedOrbit(
            np.tile(angles, len(at)),
            along.frequency[every],
            zero,
            along.amplitude[every],
            zero,
            zero,
        )
        terms = FlightTerms.view(np.concatenate([data.flat_flight, data.flat_flight[every]]))
        orbit = np.hstack([along, around])[:, :, None]
        margins, slopes = self._planned_flight(orbit, terms.columns, self._axis_columns)
        count = len(along.angle) + len(every)
        slopes = slopes[:, [0, 1, 3, 4, 2, 5]].transpose(1, 2, 0, 3)
        return margins.swapaxes(0, 1).reshape(count, -1), slopes.reshape(len(orbit), count, -1)

    @property
    def _limits_amplitude(self) -> bool:
        return self._limits.limit_tensions or self._separation is not None

    def _gaps(self, data: HorizonData, coefficients: NDArray) -> tuple[NDArray, NDArray]:
        """The squared distances (1, k, m) of all pairs at the instants.

        And their gradients (1, 4, k, m) by θ, ξ, A and Ȧ.
        """

        def of_both(vectors: NDArray) -> NDArray:
            """Those (k, n, 3) of both carriers of a pair, (6, k, m)."""
            both = np.moveaxis(vectors[:, self._pairs], (1, 3), (0, 1))
            return both.reshape(6, *both.shape[2:])

        constants = (of_both(part[None]) for part in (*self.axes, self.model.attachments))
        orbit = self._orbit(data, coefficients)
        return self._planned_gaps(orbit, of_both(data.terms.forces), *constants)

    def _terminal_margins(
        self, data: HorizonData, coefficients: NDArray
    ) -> tuple[NDArray, NDArray]:
        """The margins of the terminal set, and their gradients by θ, ξ, A and Ȧ.

        A ξ/s − 1 by a fixed unit of s, the same from above, and what does not depend on ξ.
        """
        c, d = coefficients
        frequency, amplitude = self.nominal
        rows = self._rows.value[self._terminal_at]
        xi, A = frequency * (rows @ c), amplitude * (rows @ d)
        (least, most, others), slopes = data.terminal.at(A)
        unit, zero = frequency * amplitude, np.zeros(len(A))
        with np.errstate(invalid="ignore"):
            margins = np.stack([(A * xi - least) / unit, (most - A * xi) / unit, others])
            gradients = np.stack(
                [
                    [zero, A / unit, (xi - slopes[0]) / unit, zero],
                    [zero, -A / unit, (slopes[1] - xi) / unit, zero],
                    [zero, zero, slopes[2], zero],
                ],
                axis=1,
            )
        kinds = self._terminal_kinds
        return margins[kinds].ravel(), gradients[:, kinds].reshape(4, -1)

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

    def _speeds_of_one(self, orbit: NDArray, terms: NDArray, axes: NDArray) -> PlannedSpeeds:
        """`planned_speeds` of one carrier at an instant."""
        own = OrbitTerms.view(terms[None])
        return planned_speeds(
            own, (axes[None, :3], axes[None, 3:]), *orbit[:, None], **self._cables
        )

    def _gaps_of_one(self, orbit: NDArray, *both: NDArray) -> NDArray:
        """`planned_gaps` of one pair of carriers at an instant."""
        forces, p, q, attachments = (vectors.reshape(2, 3) for vectors in both)
        return planned_gaps(
            forces[None],
            (p, q),
            orbit[:1],
            orbit[2:3],
            attachments=attachments,
            pairs=np.array([[0], [1]]),
            **self._cables,
        )

    def _flight_margins_of_one(
        self, orbit: NDArray, terms: NDArray, axes: NDArray
    ) -> list[NDArray]:
        """`_flight_margins` of one aircraft at an instant."""
        own = FlightTerms.view(terms[None])
        planned = PlannedOrbit(*orbit[:, None])
        return self._flight_margins(own, (axes[None, :3], axes[None, 3:]), planned)

    def _elementwise(
        self, function: Callable, sizes: list[int], width: int, instants: int = 0
    ) -> ElementwiseFunction:
        """A function of one carrier or pair at an instant, for all of them; 0: at all instants."""
        key = function.__name__, self.model.aircraft, self.limits, self.rest_length, self.compliance
        return ElementwiseFunction(
            function, sizes, (instants or len(self.instants), width), key=key
        )

    def _traced(self, terms: Callable[..., NDArray]) -> TracedFunction:
        """The flat terms that a function has of a load, a reference, a wind and a model."""
        model = self.model

        def of_reference(reference: NDArray, vector: NDArray, wind: NDArray) -> NDArray:
            beliefs = Beliefs.view(vector)
            load = RigidLoad(
                mass=beliefs.load_mass,
                inertia=beliefs.load_inertia.reshape(3, 3),
                drag=beliefs.load_drag,
                angular_drag=beliefs.load_angular_drag,
                gravity=beliefs.gravity,
            )
            return terms(
                load,
                reference,
                STILL_AIR if model.aircraft is None else wind,
                pseudo_inverse=model.pseudo_inverse,
                offset=beliefs.offset if len(beliefs.offset) else np.zeros(3 * model.n),
                attachments=model.attachments,
            )

        key = terms.__name__, model.attachments, model.pseudo_inverse, model.aircraft is None
        sizes = [LOAD_REFERENCE_SIZE, len(self._beliefs), WIND_SIZE]
        return TracedFunction(of_reference, sizes, name=self.name, key=key)


def _columns(parts: NDArray) -> NDArray:
    """An array (g, k, m) as (g, k m)."""
    return parts.reshape(len(parts), -1)


def _with_zero_rates(gradients: NDArray) -> NDArray:
    """Gradients (4, ...) by θ, ξ, A and Ȧ with those by ξ̇ and Ä, (6, ...)."""
    return np.concatenate([gradients, np.zeros((2, *gradients.shape[1:]))])


def _with_dips(margins: NDArray) -> tuple[NDArray, NDArray]:
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


def references_at(reference: Reference, times: NDArray) -> NDArray:
    """The references (k, 22) at times (k,) in s."""
    if isinstance(reference, ReferencePreview):
        return reference.at(times)
    return np.array([reference(time) for time in times])
