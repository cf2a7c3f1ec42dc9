"""The nonstop problem over a horizon: splines of ξ and A that keep every carrier above the bound.

With ξ = ξ₀ B(t) c and A = A₀ B(t) d, uniform splines of fourth degree, so that θ is linear in c,

    min ∫ (ξ/ξ₀ − 1)² + w_A (A/A₀ − 1)² + τ⁴ (second rates)² + τ⁶ (third rates)² + ρ slack dt

such that every margin, such as ‖v_i‖²/ε² − 1 with ε tightened, is at least −slack at each of the
points: instants of the plan, at the predicted phases θ(t_k), and, in the last part of the horizon,
all phases of the orbit of the ξ and A there, taken as constant. The rates are those of ξ/ξ₀ and
A/A₀. The limits are the rows of the table of limits; their slacks are three per interval between
knots: of the bound, of limits of aircraft, and of all others. Limits on the rates of ξ and A, and
their bounds, hold for the coefficients, and so at all times.

The speeds of aircraft are those through the air. Where cables bow, the margins are those of the
carriers at their upper ends, see `mechanics.bowed_orbit`.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.bowed_orbit import CableShape
from drake_nonstop.mechanics.rigid_load import STILL_AIR
from drake_nonstop.mechanics.signals import (
    LOAD_REFERENCE_SIZE,
    PLANNED_SIZE,
    WIND_SIZE,
    constant_plan,
)
from drake_nonstop.model.system import Model
from drake_nonstop.planning.carrier_margins import CarrierMargins
from drake_nonstop.planning.constraints import Constraints
from drake_nonstop.planning.diagnostics import BOUND
from drake_nonstop.planning.horizon_config import HorizonConfig, timed
from drake_nonstop.planning.limits import Of
from drake_nonstop.planning.measured_margin import PLANS_OF_RISE
from drake_nonstop.planning.model_parameters import ModelParameters, model_parameters_of
from drake_nonstop.planning.plan import DEGREE, Plan, spline_rows
from drake_nonstop.planning.problem_config import LimitsConfig, tightened_bound

_OTHERS_SHARE = 0.3  # of the weight of the speed bound's slack: that of the other limits
_STEP = 1e-4  # of θ in rad, and of the nominal ξ and A and their rates, for differences
_MOST_NODES = 4  # of the cables of plans: chords are 0.1 % too long
AMPLITUDE_WEIGHT = 4.0  # w_A
SLACK_WEIGHT = 100.0  # ρ
TERMINAL_KNOTS = 4  # of the last part, in which all phases of the orbit are constrained
_TERMINAL_INSTANTS = 2  # of it, between two knots
TERMINAL_PHASES = 24  # of the orbit
ORBIT_TIGHTENING = 0.005  # of the nominal orbits' speed, the least margin
_BOWED_EVERY = 4  # of the instants, at which margins of bowed cables are found
_OF_XI, _OF_AMPLITUDE = [0, 1, 3, 5], [2, 4, 6, 7]  # the entries of `planned`

Reference = Callable[[float], NDArray]  # the load's reference (22,) at a time in s


class HorizonData(NamedTuple):
    """Data that vary from plan to plan."""

    start_time: float  # s
    start_angle: float  # θ, rad
    speed_bounds: NDArray  # (n,), m/s, of the carriers, tightened
    references: NDArray  # (k, 22), at the instants
    # (27, p), the reference and the wind at the points; 1 on whole orbits, else 0; and half the way
    # to the next point, s, there rad
    motion: NDArray
    ease: NDArray  # (p,), that speeds may fall short of their margins by, where the bound has risen


@dataclass(frozen=True, eq=False)
class Linearization:
    """The margins about a plan, of r rows at p points, and their gradients."""

    margins: NDArray  # (r, p)
    gradients: NDArray  # (g, r, p), by the entries of `planned` at the point
    rows: NDArray  # (g, p, N), from the coefficients to these entries
    of_spline: NDArray  # (g,), the spline that each belongs to: 0 of ξ, 1 of A

    def changes(self, step: NDArray) -> NDArray:
        """Changes of the margins (r, p) by a step (2, N) of the coefficients, to first order."""
        moved = (self.rows @ step[self.of_spline][..., None])[..., 0]
        return np.einsum("grp,gp->rp", self.gradients, moved)

    def jacobian(self, chosen: tuple[NDArray, ...], fixed: int) -> NDArray:
        """Rows of chosen margins, by all but the first coefficients of ξ, then of A."""
        gradients, rows = self.gradients[:, chosen[0], chosen[1]], self.rows[:, chosen[1], fixed:]
        parts = [
            np.einsum("gc,gcn->cn", gradients[own], rows[own])
            for own in (self.of_spline == 0, self.of_spline == 1)
        ]
        return np.hstack(parts)


class HorizonProblem:
    """The problem of all plans of one model and config.

    Args:
        model: what the controllers believe.
        limits: ε, `tightening`, the nominal ξ and A, and their bounds.
        config: the horizon.
        beliefs: numbers in place of those of model and limits.
        shape: of cables that bow; None: they are straight.

    Attributes:
        count: N, of the coefficients of ξ, and of A.
        instants: (k,), s from the start.
        names: (r,), of the rows of margins, as `missed_limits` has them.
        slacks: (r, p), the numbers of the slacks.
        before: (p,), the numbers of the neighbouring points; p: there is none.
        after: (p,), likewise.
    """

    def __init__(
        self,
        model: Model,
        limits: LimitsConfig,
        config: HorizonConfig,
        *,
        beliefs: ModelParameters | None = None,
        shape: CableShape | None = None,
    ):
        config = timed(config, limits.frequency, model.control_period)
        shape = planned_shape(shape)
        if shape is not None:
            config = replace(config, instants=max(math.ceil(config.instants / _BOWED_EVERY), 4))
        self.model, self.limits, self.config, self.shape = model, limits, config, shape
        beliefs = beliefs or model_parameters_of(model, limits)
        self.nominal, self._lower, self._upper = beliefs.nominal, beliefs.lower, beliefs.upper
        self.constraints = Constraints(limits)
        self.intervals = config.intervals
        self.count = self.intervals + DEGREE
        self._place_points()
        xi, A = self.nominal
        fast = 1 / config.knot_spacing
        units = [1, xi, A, xi * fast, A * fast, xi * fast**2, A * fast**2, A * fast**3]
        steps = _STEP * np.array(units)
        self._margins = CarrierMargins(model, self.constraints, beliefs, steps, shape)
        self.names = self._margins.names
        self._place_slacks()
        self.hessian = self._hessian()

    # Points

    def _place_points(self) -> None:
        """Tells the instants, and the points: these, and all phases at some of them."""
        config, count = self.config, self.intervals * self.config.instants
        end = self.intervals * config.knot_spacing
        # Where coefficients are fixed, so is the value at the start: no instant is there.
        self._first_instant = 1 if config.fixed_coefficients else 0
        self.instants = end / count * np.arange(self._first_instant, count + 1)
        along, phases = len(self.instants), TERMINAL_PHASES
        back = np.arange(_TERMINAL_INSTANTS * TERMINAL_KNOTS)[::-1]
        ends = along - 1 - back * config.instants // _TERMINAL_INSTANTS
        self._along = along
        self._instant_of = np.concatenate([np.arange(along), np.repeat(ends, phases)])
        self.points = len(self._instant_of)
        self._phases = np.zeros(self.points)
        self._phases[along:] = np.tile(2 * np.pi * np.arange(phases) / phases, len(ends))
        self._kinds = np.zeros(
            (2, self.points)
        )  # whether of whole orbits, and half the way to the next
        self._kinds[:, along:] = np.array([[1.0], [np.pi / phases]])
        self._kinds[1, :along] = end / count / 2
        if not self._first_instant:  # nothing before the start counts
            self._kinds[1, 0] = 0
        on_orbits = np.arange(along, self.points).reshape(-1, phases)
        none = np.array([self.points])
        self.before, self.after = (
            np.concatenate([own, np.roll(on_orbits, shift, axis=1).ravel()])
            for own, shift in (
                (np.append(none, np.arange(along - 1)), 1),
                (np.append(np.arange(1, along), none), -1),
            )
        )
        rows = spline_rows(self.instants, self.intervals, config.knot_spacing)
        xi, A = self.nominal
        parts = [rows.integral, rows.value, rows.value, rows.rate, rows.rate]
        parts += [rows.second_rate, rows.second_rate, rows.third_rate]
        units = np.where(np.isin(np.arange(PLANNED_SIZE), _OF_XI), xi, A)
        self._rows = units[:, None, None] * np.stack(parts)[:, self._instant_of]
        self._rows[[0, 3, 4, 5, 6, 7], along:] = 0  # whole orbits are those of constant ξ and A
        self._of_spline = np.isin(np.arange(PLANNED_SIZE), _OF_AMPLITUDE).astype(int)

    def planned(self, data: HorizonData, coefficients: NDArray) -> NDArray:
        """The values (8, p) of `planned` at the points."""
        found = (self._rows @ coefficients[self._of_spline][..., None])[..., 0]
        found[0] += np.where(np.arange(self.points) < self._along, data.start_angle, self._phases)
        return found

    # Margins

    def _place_slacks(self) -> None:
        """Tells the slacks of the margins, and their weights."""
        slacks = self.intervals + 1
        flying = np.isin(self.names, self.constraints.names(Of.FLIGHT))
        kinds = np.where(self.names == BOUND, 0, np.where(flying, 2, 1))
        kinds = np.unique(kinds, return_inverse=True)[1]
        piece = np.floor(self.instants[self._instant_of] / self.config.knot_spacing - 1e-9).clip(0)
        piece[self._along :] = self.intervals
        self.slacks = slacks * kinds[:, None] + piece.astype(int)
        weights = np.full(slacks, self.config.knot_spacing)
        weights[-1] *= TERMINAL_KNOTS
        shares = [1.0] + [_OTHERS_SHARE] * int(kinds.max())
        self.slack_weights = SLACK_WEIGHT * np.outer(shares, weights).ravel()

    def linearization(self, data: HorizonData, coefficients: NDArray) -> Linearization:
        """The margins about coefficients (2, N)."""
        planned = self.planned(data, coefficients)
        points = np.concatenate([planned, data.motion])
        margins, gradients = self._margins(points, data.speed_bounds)
        margins[: self.model.n] += data.ease
        by = self._margins.by
        return Linearization(margins, gradients, self._rows[by], self._of_spline[by])

    def orbit_margins(self, data: HorizonData, parameters: NDArray) -> NDArray:
        """The worst margins (r, c) of constant [ξ, A] (2, c) over whole orbits.

        Each is taken at every second phase and knot.
        """
        count = parameters.shape[1]
        angles = self._phases[self._along :][:TERMINAL_PHASES:2]
        knots = data.motion[:, : self._along][:, :: 2 * self.config.instants].copy()
        knots[-2:] = np.array([[1], [2 * np.pi / TERMINAL_PHASES]])
        orbits = constant_plan(np.tile(angles, count), *np.repeat(parameters, len(angles), axis=1))
        planned = np.repeat(orbits.T, knots.shape[1], axis=1)
        points = np.concatenate([planned, np.tile(knots, len(orbits))])
        margins, _ = self._margins(points, data.speed_bounds)
        return margins.reshape(len(margins), count, -1).min(axis=-1)

    def squared_speeds(self, planned: NDArray, reference: NDArray, wind: NDArray) -> NDArray:
        """The carriers' squared speeds (n, p), m²/s², at values (8, p) of `planned`.

        Above one reference (22,), and through the air of a wind (3,), m/s, in W.
        """
        motion = np.tile(np.concatenate([reference, wind, [0, 0]])[:, None], planned.shape[1])
        points, n = np.concatenate([planned, motion]), self.model.n
        return self._margins(points, np.zeros(n))[0][:n]

    def slowest(self, data: HorizonData, margins: NDArray) -> float:
        """The least speed along the plan, m/s, of its margins (r, p)."""
        least = (margins[: self.model.n] - data.ease)[:, : self._along].min(axis=1)
        bounds = data.speed_bounds
        squares = least * np.where(bounds > 0, bounds, 1.0) ** 2 + bounds**2
        return math.sqrt(max(float(squares.min()), 0.0))

    def least_slacks(self, margins: NDArray) -> NDArray:
        """The least slacks, as many as `slack_weights`, that margins (r, p) need."""
        slacks = np.zeros(len(self.slack_weights))
        violated = ~(margins >= 0)
        with np.errstate(invalid="ignore"):  # where margins are no numbers, slacks are none
            np.maximum.at(slacks, self.slacks[violated], -margins[violated])
        return slacks

    def missed(self, margins: NDArray, tolerance: float) -> set[str]:
        """Names of the limits that margins (r, p) miss by more than a tolerance."""
        return {*self.names[np.any(~(margins >= -tolerance), axis=1)].tolist()}

    def dips(self, margins: NDArray, largest: float) -> NDArray:
        """Which margins (r, p), of at most `largest`, are the least of their neighbours'."""
        padded = np.hstack([margins, np.full((len(margins), 1), np.inf)])
        is_dip = (margins <= padded[:, self.before]) & (margins < padded[:, self.after])
        return is_dip & (margins <= largest)

    def with_neighbours(self, chosen: NDArray, margins: NDArray, largest: float) -> NDArray:
        """Which are chosen (r, p), or are next to those that are and at most `largest`."""
        padded = np.hstack([chosen, np.zeros((len(chosen), 1), bool)])
        near = padded[:, self.before] | padded[:, self.after]
        return chosen | (near & (margins <= largest))

    # Coefficients

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
        return (self._lower / self.nominal)[:, None], (self._upper / self.nominal)[:, None]

    def nominal_coefficients(self) -> NDArray:
        """Coefficients (2, N) of the nominal ξ and A."""
        return np.ones((2, self.count))

    def plan(self, data: HorizonData, coefficients: NDArray) -> Plan:
        """The plan of coefficients (2, N)."""
        spacing = self.config.knot_spacing
        return Plan(data.start_time, data.start_angle, spacing, self.nominal, coefficients)

    def cost(self, coefficients: NDArray) -> float:
        """The cost of coefficients (2, N), without slack."""
        away = (coefficients - 1).ravel()
        return float(away @ self.hessian @ away) / 2

    def angle_rows(self) -> NDArray:
        """The matrix (intervals, N) of θ at the knots after the start, by the coefficients of ξ."""
        knots = self.config.knot_spacing * np.arange(1, self.intervals + 1)
        rows = spline_rows(knots, self.intervals, self.config.knot_spacing)
        return self.nominal[0] * rows.integral

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
        hessian[self.count :, self.count :] = 2 * (AMPLITUDE_WEIGHT * square(rows.value) + smooth)
        return hessian

    # Data

    def data(
        self,
        start_time: float,
        start_angle: float,
        reference: Reference,
        speed_bound: float,
        last: HorizonData | None = None,
        wind: NDArray = STILL_AIR,
        share: float = 1.0,
    ) -> HorizonData:
        """The data of a plan from a time in s and phase in rad on, for ε in m/s.

        Of a bound that has risen speeds have to reach a `share` at the start, and all of it
        `PLANS_OF_RISE` knots later.

        Where `last` is of the same reference, what it has of it is taken. The wind (3,) in m/s, in
        W, is that of the whole horizon, or those (k, 3) at its instants; it counts for aircraft.
        """
        bound = tightened_bound(self.limits, speed_bound)
        # Where carriers pass low speeds they are off by a share of their orbits' speeds.
        orbits = float(np.prod(self.nominal)) * self._margins.resting_speeds
        of_orbits = speed_bound + ORBIT_TIGHTENING * orbits
        bounds = np.maximum(bound, of_orbits) if speed_bound > 0 else np.zeros(self.model.n)
        times, rows = self.times(start_time), np.zeros((0, LOAD_REFERENCE_SIZE))
        if last is not None:
            first = self.config.instants * round(
                (start_time - last.start_time) / self.config.knot_spacing
            )
            if first >= 0 and np.array_equal(self.times(last.start_time)[first:][:1], times[:1]):
                rows = last.references[first:]
        if len(rows) < len(times):
            rows = np.concatenate([rows, references_at(reference, times[len(rows) :])])
        own = STILL_AIR if self.model.aircraft is None else wind
        winds = np.broadcast_to(own, (len(rows), WIND_SIZE))
        motion = np.hstack([rows, winds]).T[:, self._instant_of]
        risen = self.instants[self._instant_of] / (PLANS_OF_RISE * self.config.knot_spacing)
        ease = 1 - np.minimum(share + (1 - share) * risen, 1.0) ** 2
        motion = np.vstack([motion, self._kinds])
        return HorizonData(start_time, start_angle, bounds, rows, motion, ease)

    def times(self, start_time: float) -> NDArray:
        """The times of the instants, s, those of two plans that start at knots to the bit."""
        spacing = self.config.knot_spacing / self.config.instants
        knot = round(start_time / self.config.knot_spacing)
        numbers = self._first_instant + np.arange(len(self.instants))
        if abs(start_time - knot * self.config.knot_spacing) > 1e-9 * max(1.0, start_time):
            return start_time + numbers * spacing
        return (knot * self.config.instants + numbers) * spacing


def planned_shape(shape: CableShape | None) -> CableShape | None:
    """Bowed cables as plans resolve them."""
    return shape and shape._replace(nodes=min(shape.nodes, _MOST_NODES))


def references_at(reference: Reference, times: NDArray) -> NDArray:
    """The references (k, 22) at times (k,) in s."""
    at = getattr(reference, "at", None)  # of a `ReferencePreview`
    return np.array([reference(time) for time in times]) if at is None else at(times)
