"""The nonstop problem over a horizon: splines of ξ and A that keep every carrier above the bound.

With ξ = ξ₀ B(t) c and A = A₀ B(t) d, uniform splines of fourth degree, so that θ is linear in c,

    min ∫ (ξ/ξ₀ − 1)² + w_A (A/A₀ − 1)² + τ⁴ (second rates)² + τ⁶ (third rates)² + ρ slack dt

such that ‖v_i(t_k)‖² ≥ ((1 + m) ε)² (1 − slack) at the predicted phases θ(t_k), and, in the last
part of the horizon, A ξ ≥ s(t, A) (1 − slack), above which no phase of the orbit is too slow. The
rates are those of ξ/ξ₀ and A/A₀.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics import nonstop
from drake_nonstop.mechanics.planned_orbit import (
    OrbitTerms,
    PlannedSpeeds,
    orbit_along_reference,
    planned_speeds,
)
from drake_nonstop.mechanics.rigid_load import RigidLoad
from drake_nonstop.mechanics.signals import LOAD_REFERENCE_SIZE
from drake_nonstop.model.system import Model
from drake_nonstop.optimization.plan import DEGREE, Plan, spline_rows
from drake_nonstop.optimization.problem_config import LimitsConfig
from drake_nonstop.optimization.terminal_set import LeastProducts, least_products
from drake_nonstop.optimization.traced_problem import beliefs_of
from drake_nonstop.optimization.update_data import Beliefs
from drake_nonstop.systems.tracing import TracedFunction

Reference = Callable[[float], NDArray]  # the load's reference (22,) at a time in s


@dataclass(kw_only=True)
class HorizonConfig:
    """The horizon, its cost and its constraints; with those of a `NonstopProblemConfig`."""

    horizon: float = 6.0  # s
    knot_spacing: float = 0.4  # s, also the time between two plans
    instant_spacing: float = 0.02  # s, between instants at which speeds are constrained
    neighbours: int = 2  # instants of which a step of the solver constrains the slowest
    terminal_time: float = 1.6  # s, the last part, with all phases of the orbit
    terminal_spacing: float = 0.2  # s, between instants in it
    terminal_phases: int = 24
    terminal_amplitudes: int = 33  # of the table
    amplitude_weight: float = 4.0  # w_A
    smoothing_time: float = 0.4  # s, τ
    slack_weight: float = 100.0  # ρ
    fixed_coefficients: int = 4  # the first of ξ and A: 4 for three continuous rates


class HorizonData(NamedTuple):
    """What varies from plan to plan."""

    start_time: float  # s
    start_angle: float  # θ, rad
    flat_terms: NDArray  # (k, 9n + 3), the `OrbitTerms` at the instants
    terminal: LeastProducts  # at the terminal instants
    speed_bound: float  # m/s, tightened

    @property
    def terms(self) -> OrbitTerms:
        """Those at the instants."""
        return OrbitTerms.view(self.flat_terms)

    @property
    def speed_unit(self) -> float:
        """What scales the margins of squared speeds, m²/s²; without a bound any speed is enough."""
        return self.speed_bound**2 or 1.0


class Linearization(NamedTuple):
    """The constraints about a plan, as margins and their Jacobian by the free coefficients.

    A margin is negative where its constraint is not fulfilled without slack. `slack_of` tells the
    slack of each: one per interval between knots, and a last one for the terminal set.
    """

    margins: NDArray  # (r,)
    jacobian: NDArray  # (r, 2N)
    slack_of: NDArray  # (r,), whole numbers


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
        self.model, self.limits, self.config = model, limits, config
        self.intervals = round(config.horizon / config.knot_spacing)
        self.count = self.intervals + DEGREE  # of the coefficients of ξ, and of A
        self.slack_count = self.intervals + 1
        beliefs = beliefs or beliefs_of(model, limits)
        self.nominal = beliefs.nominal
        self._bounds = np.stack([beliefs.lower, beliefs.upper])
        self._beliefs = np.concatenate(beliefs)
        self.rest_length = float(beliefs.rest_length[0])  # m
        self.compliance = float(beliefs.compliance[0])  # m/N
        self._cables = {"rest_length": self.rest_length, "compliance": self.compliance}
        self.axes = nonstop.orbit_axes(model.pattern.basis, model.pattern.phases)
        low, high = self._bounds[:, 1]
        self.amplitudes = np.linspace(low, high, config.terminal_amplitudes)
        spacing = config.knot_spacing
        end = self.intervals * spacing
        count = self.intervals * round(spacing / config.instant_spacing)
        # The value at the start is given by the fixed coefficients: no instant is there.
        self.instants = end / count * np.arange(1, count + 1)
        self._terminal_per_knot = max(1, round(spacing / config.terminal_spacing))
        count = self._terminal_per_knot * round(config.terminal_time / spacing)
        self.terminal_instants = end - spacing / self._terminal_per_knot * np.arange(count)[::-1]
        self._rows = spline_rows(self.instants, self.intervals, spacing)
        self._terminal_rows = spline_rows(self.terminal_instants, self.intervals, spacing).value
        pieces = np.floor(self.instants / spacing - 1e-9).astype(int)
        self._slack_of = np.repeat(pieces, model.n)
        self.hessian = self._hessian()
        self._terms = TracedFunction(
            self._trace_terms,
            [LOAD_REFERENCE_SIZE, len(self._beliefs)],
            name=name,
            key=("orbit along reference", model.attachments, model.pseudo_inverse),
        )

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

    def terms_at(self, reference: NDArray) -> NDArray:
        """The flat `OrbitTerms` (9n + 3,) of a reference (22,)."""
        return self._terms(reference, self._beliefs)[0].copy()

    def data(
        self,
        start_time: float,
        start_angle: float,
        reference: Reference,
        speed_bound: float,
        last: HorizonData | None = None,
    ) -> HorizonData:
        """The data of a plan from a time in s and phase in rad on, for ε in m/s.

        Where `last` is of the same bound, and began one interval between knots before, what both
        have in common is taken from it.
        """
        bound = (1 + self.limits.tightening) * speed_bound
        spacing = self.config.knot_spacing
        known, known_terminal = None, None
        is_next = last is not None and abs(start_time - last.start_time - spacing) < 1e-9
        if last is not None and is_next and last.speed_bound == bound:
            known = last.flat_terms[len(self.instants) // self.intervals :]
            known_terminal = last.terminal.products[self._terminal_per_knot :]

        def terms_at(instants: NDArray) -> NDArray:
            return np.array([self.terms_at(reference(start_time + t)) for t in instants])

        flat = _continued(known, self.instants, terms_at)
        products = _continued(
            known_terminal,
            self.terminal_instants,
            lambda instants: np.array([self.least_products(t, bound) for t in terms_at(instants)]),
        )
        return HorizonData(
            start_time, start_angle, flat, LeastProducts(self.amplitudes, products), bound
        )

    def least_products(self, terms: NDArray, speed_bound: float) -> NDArray:
        """Row (a,) of `LeastProducts` for flat terms and the tightened bound in m/s."""
        return least_products(
            OrbitTerms.view(terms),
            self.axes,
            self.amplitudes,
            speed_bound,
            phase_count=self.config.terminal_phases,
            **self._cables,
        )

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
        """The squared speeds (k, n) at the instants, and their gradients."""
        c, d = coefficients
        frequency, amplitude = self.nominal
        rows = self._rows
        return planned_speeds(
            data.terms,
            self.axes,
            data.start_angle + frequency * (rows.integral @ c),
            frequency * (rows.value @ c),
            amplitude * (rows.value @ d),
            amplitude * (rows.rate @ d),
            **self._cables,
        )

    def margins(self, data: HorizonData, coefficients: NDArray) -> NDArray:
        """The margins (r,) of `linearization`."""
        squares = self.speeds(data, coefficients).squares
        return np.concatenate(
            [
                ((squares - data.speed_bound**2) / data.speed_unit).ravel(),
                self._terminal_margins(data, coefficients)[0],
            ]
        )

    def linearization(
        self, data: HorizonData, coefficients: NDArray, largest: float = math.inf
    ) -> Linearization:
        """The constraints about coefficients (2, N), without those of margins above `largest`.

        Of the speeds of a carrier at neighbouring instants it is the slowest.
        """
        speeds = self.speeds(data, coefficients)
        unit = data.speed_unit
        margins = ((speeds.squares - data.speed_bound**2) / unit).ravel()
        near = self._least_of_neighbours(margins)
        near = near[margins[near] <= largest]
        by_angle, by_frequency, by_amplitude, by_rate = (speeds.gradients / unit).reshape(4, -1)[
            :, near, None
        ]
        instant = near // self.model.n
        rows = self._rows
        frequency, amplitude = self.nominal
        value = rows.value[instant]
        of_speeds = np.hstack(
            [
                frequency * (by_angle * rows.integral[instant] + by_frequency * value),
                amplitude * (by_amplitude * value + by_rate * rows.rate[instant]),
            ]
        )
        terminal, of_terminal = self._terminal_margins(data, coefficients)
        return Linearization(
            np.concatenate([margins[near], terminal]),
            np.vstack([of_speeds, of_terminal]),
            np.concatenate([self._slack_of[near], np.full(len(terminal), self.intervals)]),
        )

    def slacks(self, margins: NDArray, slack_of: NDArray | None = None) -> NDArray:
        """The least slacks (`slack_count`,) that margins (r,) need."""
        if slack_of is None:
            terminal = np.full(len(self.terminal_instants), self.intervals)
            slack_of = np.concatenate([self._slack_of, terminal])
        slacks = np.zeros(self.slack_count)
        np.maximum.at(slacks, slack_of, -margins)
        return slacks

    @property
    def slack_weights(self) -> NDArray:
        """The cost of each slack: ρ times the time of its constraints."""
        weights = np.full(self.slack_count, self.config.knot_spacing)
        weights[-1] = self.config.terminal_time
        return self.config.slack_weight * weights

    def angle_rows(self) -> NDArray:
        """The matrix (intervals, N) of θ at the knots after the start, by the coefficients of ξ."""
        knots = self.config.knot_spacing * np.arange(1, self.intervals + 1)
        rows = spline_rows(knots, self.intervals, self.config.knot_spacing)
        return self.nominal[0] * rows.integral

    def _least_of_neighbours(self, margins: NDArray) -> NDArray:
        """The numbers of those margins of speeds (k n,) that are the least in their groups."""
        n = self.model.n
        size = math.gcd(self.config.neighbours, len(self.instants))
        groups = margins.reshape(-1, size, n)
        chosen = size * np.arange(len(groups))[:, None] + groups.argmin(axis=1)
        return (chosen * n + np.arange(n)).ravel()

    def _terminal_margins(
        self, data: HorizonData, coefficients: NDArray
    ) -> tuple[NDArray, NDArray]:
        """A ξ/s − 1 at the terminal instants (k,), by a fixed unit of s, and its Jacobian."""
        c, d = coefficients
        frequency, amplitude = self.nominal
        rows = self._terminal_rows
        xi, A = frequency * (rows @ c), amplitude * (rows @ d)
        least, slope = data.terminal.at(A)
        unit = frequency * amplitude
        jacobian = [A[:, None] * frequency * rows, (xi - slope)[:, None] * amplitude * rows]
        return (A * xi - least) / unit, np.hstack(jacobian) / unit

    def _hessian(self) -> NDArray:
        """That (2N, 2N) of the cost by both splines' coefficients."""
        config = self.config
        nodes, weights = np.polynomial.legendre.leggauss(DEGREE + 1)  # exact for their squares
        spacing = config.knot_spacing
        times = (np.arange(self.intervals)[:, None] + (nodes + 1) / 2).ravel() * spacing
        weights = np.tile(weights, self.intervals)[:, None] * spacing / 2
        rows = spline_rows(times, self.intervals, spacing)
        tau = config.smoothing_time

        def square(row: NDArray) -> NDArray:
            return row.T @ (weights * row)

        smooth = tau**4 * square(rows.second_rate) + tau**6 * square(rows.third_rate)
        hessian = np.zeros((2 * self.count, 2 * self.count))
        hessian[: self.count, : self.count] = 2 * (square(rows.value) + smooth)
        hessian[self.count :, self.count :] = 2 * (
            config.amplitude_weight * square(rows.value) + smooth
        )
        return hessian

    def _trace_terms(self, reference: NDArray, vector: NDArray) -> NDArray:
        beliefs = Beliefs.view(vector)
        load = RigidLoad(
            mass=beliefs.load_mass,
            inertia=beliefs.load_inertia.reshape(3, 3),
            drag=beliefs.load_drag,
            angular_drag=beliefs.load_angular_drag,
            gravity=beliefs.gravity,
        )
        model = self.model
        return orbit_along_reference(
            load,
            reference,
            pseudo_inverse=model.pseudo_inverse,
            offset=beliefs.offset if len(beliefs.offset) else np.zeros(3 * model.n),
            attachments=model.attachments,
        )


def _continued(
    known: NDArray | None, instants: NDArray, make: Callable[[NDArray], NDArray]
) -> NDArray:
    """Rows for instants (k,), of which the first are `known`."""
    if known is None or len(known) == 0:
        return make(instants)
    return np.concatenate([known, make(instants[len(known) :])])
