"""What plans over a horizon need to know of the load's motion, at the instants of their limits."""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.planned_orbit import OrbitTerms
from drake_nonstop.mechanics.rigid_load import STILL_AIR
from drake_nonstop.mechanics.signals import LOAD_REFERENCE_SIZE, WIND_SIZE
from drake_nonstop.optimization.orbit_constraints import OrbitConstraints
from drake_nonstop.optimization.problem_config import tightened_bound
from drake_nonstop.optimization.terminal_set import TerminalTables

if TYPE_CHECKING:
    from drake_nonstop.optimization.bowed_margins import BowLosses

# Aircraft have their limits at one in so many instants, at least so many between two knots: what
# they need has fewer dips in a turn than speeds that pass low values.
_FLIGHT_EVERY, _LEAST_FLIGHTS = 4, 5

_INTERVALS_AHEAD = 2  # for which what a plan needs to know is found at once
_SAME_KNOT = 1e-9  # intervals

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
    losses: "BowLosses | None" = None  # of margins; None: cables are straight

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


class HorizonMotions(OrbitConstraints):
    """Tells what plans need to know, once the instants of a `HorizonProblem` are placed."""

    def _place_instants(self) -> None:
        """Tells the instants at which carriers are limited, and which of them have more limits."""
        config = self.config
        self.intervals = intervals = round(config.horizon / config.knot_spacing)
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
        self.flight_at = last - back * config.instants // flown
        if self._first_instant == 0:
            self.flight_at = np.append(0, self.flight_at)
        self._flights_per_knot = flown
        # What aircraft need on whole orbits is limited at the ends of the intervals.
        ends = np.arange(1, config.terminal_knots + 1) * config.terminal_instants - 1
        self.orbits_of = np.searchsorted(self.flight_at, self.terminal_at[ends])

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
        config, motion, later, known = self.config, None, 0, None
        if last is not None:
            if last.speed_bound == bound and np.array_equal(last.wind, wind):
                if last.start_time == start_time:
                    return last._replace(start_angle=start_angle)
                motion = last.motion
                later = self._intervals_later(motion, start_time)
            known = last.motion.references
        if motion is None or later > motion.ahead:
            ahead = 0 if motion is None else _INTERVALS_AHEAD
            references = self._references(start_time, reference, known, ahead)
            motion = self._motion(start_time, references, speed_bound, wind, ahead, motion)
            later = 0
        count, flights = len(self.instants), len(self.flight_at)
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

    def _intervals_later(self, known: KnownReferences | HorizonMotion, start_time: float) -> int:
        """How many intervals a time (s) is after the start of what is known.

        Beyond all that is known where they are no whole ones, or below zero.
        """
        intervals = (start_time - known.start_time) / self.config.knot_spacing
        later = round(intervals)
        is_whole = abs(intervals - later) < _SAME_KNOT and later >= 0
        return later if is_whole else known.ahead + self.intervals + 1

    def _references(
        self, start_time: float, reference: Reference, known: KnownReferences | None, ahead: int
    ) -> KnownReferences:
        """References from a time on, for plans that start so many intervals later, or fewer.

        Those that are known, of the same motion, are taken.
        """
        config, rows = self.config, np.zeros((0, LOAD_REFERENCE_SIZE))
        if known is not None:
            later = self._intervals_later(known, start_time)
            rows = known.rows[later * config.instants :]
            if later + ahead <= known.ahead:
                return KnownReferences(start_time, known.ahead - later, rows)
            ahead = _INTERVALS_AHEAD
        left = getattr(reference, "end_time", math.inf) - (start_time + config.horizon)
        ahead = int(min(max(left / config.knot_spacing, 0.0), ahead))
        times = self.times(start_time, len(self.instants) + ahead * config.instants)
        new = references_at(reference, times[len(rows) :])
        return KnownReferences(start_time, ahead, np.concatenate([rows, new]))

    def _motion(
        self,
        start_time: float,
        references: KnownReferences,
        speed_bound: float,
        wind: NDArray,
        ahead: int,
        known: HorizonMotion | None,
    ) -> HorizonMotion:
        """The terms of a motion, also for plans that start so many intervals later, or fewer.

        Those that are `known`, of the same bound and wind, are taken.
        """
        config, bound = self.config, tightened_bound(self.limits, speed_bound)
        ahead = min(ahead, references.ahead) if wind.ndim == 1 else 0

        def extended(numbers: NDArray, each: int) -> NDArray:
            """Numbers of instants, of which there are so many in an interval, goes on with them."""
            later = config.instants * np.arange(1, ahead + 1)[:, None]
            return np.append(numbers, later + numbers[-each:])

        count = len(self.instants) + ahead * config.instants
        flight_at = extended(self.flight_at, self._flights_per_knot)
        terminal_at = extended(self.terminal_at, config.terminal_instants)
        rows, winds = references.rows[:count], np.broadcast_to(wind, (count, WIND_SIZE))
        flat, flight = np.zeros((2, 0))
        if known is not None:
            later = self._intervals_later(known, start_time)
            flat = known.flat_terms[later * config.instants :]
            flight = known.flat_flight[later * self._flights_per_knot :]
        at = flight_at[len(flight) :]
        flight = _joined(flight, self.flight_terms(rows[at], winds[at]))
        flat = _joined(flat, self.all_terms(rows[len(flat) :], winds[len(flat) :]))
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
            references=references,
            flat_terms=flat,
            flat_flight=flight,
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


def references_at(reference: Reference, times: NDArray) -> NDArray:
    """The references (k, 22) at times (k,) in s."""
    at = getattr(reference, "at", None)  # of a `ReferencePreview`
    return np.array([reference(time) for time in times]) if at is None else at(times)


def _joined(rows: NDArray, others: NDArray) -> NDArray:
    return np.concatenate([rows, others]) if len(rows) else others
