"""How much smaller the margins of a plan are on bowed cables than on straight ones.

Plans are made with straight cables, whose carriers follow from ξ and A at the same instant. Where
cables bow, each margin is lowered by what it loses on the bowed cables of the plan that a search
begins with, to first order in θ, ξ, A and their rates at its instant: the answer is exact where it
no longer changes. Such corrections are common where a cheap model stands in for a dear one
(Alexandrov and Lewis, Optimization and Engineering 2, 413, 2001).
"""

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.aircraft import flown_aircraft
from drake_nonstop.mechanics.bowed_orbit import CableShape, bowed_motion
from drake_nonstop.mechanics.planned_orbit import (
    FlightTerms,
    OrbitMotion,
    PlannedOrbit,
    needs_of_motion,
    orbit_directions,
    orbit_motion,
    squared_gaps,
)
from drake_nonstop.mechanics.signals import PLANNED_SIZE, PlannedParameters
from drake_nonstop.optimization.horizon_motion import HorizonData
from drake_nonstop.optimization.limits import Of
from drake_nonstop.optimization.plan import spline_rows

if TYPE_CHECKING:
    from drake_nonstop.optimization.horizon_problem import HorizonProblem

_LEAST_SPEED = 1e-3  # m/s, that a margin of a whole orbit is taken over
_STEP = 1e-4  # of θ in rad, and of the nominal ξ and A and their rates, for derivatives
_MOST_NODES = 4  # of the cables of plans: chords are 0.1 % too long
# The entries of a `PlannedOrbit` among the values of `planned`.
_OF_PLANNED = np.eye(PLANNED_SIZE)[[0, 1, 3, 2, 4, 6]]
_NOT_OF_ORBITS = np.array([[0], [2], [4], [5]])  # on which whole orbits do not depend


class BowLosses(NamedTuple):
    """By how much margins are smaller on bowed cables, about a plan and to first order."""

    values: NDArray  # (r,)
    slopes: NDArray  # (6, r), by the entries of the `PlannedOrbit` at the constraint's instant
    plan: NDArray  # (6, k), these entries at the instants

    def at(self, orbit: PlannedOrbit, instants: NDArray) -> NDArray:
        """Losses (r,) along another plan, of constraints at these instants (r,)."""
        change = np.stack(orbit) - self.plan
        found: NDArray = self.values + (self.slopes * change[:, instants]).sum(axis=0)
        return found


class BowedMargins:
    """Tells what the constraints of one `HorizonProblem` lose on bowed cables.

    Margins along the plan are found where those of aircraft are, and are linear in time between.

    Args:
        problem: whose constraints are placed.
        shape: of the cables.
        along: the numbers of its constraints on carriers along the plan.
        flying: those of limits of flight along it, and on whole orbits; empty: there are none.
    """

    def __init__(
        self,
        problem: "HorizonProblem",
        shape: CableShape,
        along: NDArray,
        flying: Sequence[NDArray],
    ):
        self._problem, self._along, self._flying = problem, along, flying
        self._shape = shape._replace(nodes=min(shape.nodes, _MOST_NODES))
        at = problem.instants[problem.flight_at]
        rows = [np.interp(problem.instants, at, row) for row in np.eye(len(at))]
        self._between = np.stack(rows, axis=1)
        spline = spline_rows(at, problem.intervals, problem.config.knot_spacing)
        (xi, amplitude), fast = problem.nominal, 1 / problem.config.knot_spacing
        units = [1, xi, xi * fast, amplitude, amplitude * fast, amplitude * fast**2]
        self._steps = _STEP * np.array(units)
        self._xi_second = xi * spline.second_rate
        self._amplitude_third = amplitude * spline.third_rate
        orbits = [problem.terminal_places, *flying[1:]]
        self._of_all_phases = np.concatenate([places.ravel() for places in orbits])

    def losses(self, data: HorizonData, coefficients: NDArray) -> BowLosses:
        """Losses about coefficients (2, N)."""
        problem, count = self._problem, len(self._problem.flight_at)
        plan = problem.orbit(data, coefficients)
        planned, rows = self._planned(plan, coefficients)
        # As it is, and with another θ, ξ, ξ̇, A, Ȧ and Ä.
        others = planned + np.vstack([np.zeros(6), np.diag(self._steps)])[:, None] @ _OF_PLANNED
        terms = FlightTerms.view(np.tile(data.flat_flight[rows], (len(others), 1)))
        straight, bowed = self._motions(terms, others.reshape(-1, PLANNED_SIZE))
        up = terms.up[:, None]
        before = self._margins(data, straight, up, is_straight=True)
        after = self._margins(data, bowed, up, is_straight=False)
        of_carriers, of_flight = (
            (a - b).reshape(len(others), len(rows), -1) for a, b in zip(before, after, strict=True)
        )
        found = np.zeros((len(others), len(problem.layout.names)))
        found[:, self._along] = self._between @ of_carriers[:, :count]
        found[:, problem.terminal_places] = self._of_orbits(others, straight, bowed)
        for places, lost in zip(self._flying, np.split(of_flight, [count], axis=1), strict=False):
            found[:, places] = lost.reshape(-1, *places.shape)
        slopes = (found[1:] - found[0]) / self._steps[:, None]
        slopes[_NOT_OF_ORBITS, self._of_all_phases] = 0
        return BowLosses(found[0], slopes, np.stack(plan))

    def _planned(self, plan: PlannedOrbit, coefficients: NDArray) -> tuple[NDArray, NDArray]:
        """Values (r, 8) of `planned` along a plan and on whole orbits, and their terms' rows (r,).

        The plan is taken where flight is limited, and the orbits at the ends of its last intervals.
        """
        problem, angles = self._problem, self._problem.orbit_angles
        own = PlannedOrbit(*(values[problem.flight_at] for values in plan)).planned
        along = PlannedParameters.view(own)
        along.frequency_second_rate[:, 0] = self._xi_second @ coefficients[0]
        along.amplitude_third_rate[:, 0] = self._amplitude_third @ coefficients[1]
        ends = np.repeat(problem.flight_at[problem.orbits_of], len(angles))
        phases = np.tile(angles, len(problem.orbits_of))
        whole = PlannedOrbit.constant(phases, plan.frequency[ends], plan.amplitude[ends])
        rows = np.append(np.arange(len(own)), np.repeat(problem.orbits_of, len(angles)))
        return np.concatenate([own, whole.planned]), rows

    def _motions(self, terms: FlightTerms, planned: NDArray) -> tuple[OrbitMotion, OrbitMotion]:
        """Carriers on straight and on bowed cables."""
        problem, orbit = self._problem, PlannedOrbit.of_planned(planned)
        directions = partial(orbit_directions, problem.axes)
        straight = orbit_motion(terms, directions(orbit.angle), orbit, **problem.cables)
        geometry = {"attachments": problem.model.attachments, "offset": problem.offset}
        return straight, bowed_motion(terms, directions, planned, self._shape, **geometry).motion

    def _margins(
        self, data: HorizonData, motion: OrbitMotion, up: NDArray, *, is_straight: bool
    ) -> tuple[NDArray, NDArray]:
        """The margins of carriers and pairs (k, c), and those of flight (k, f)."""
        problem, constraints = self._problem, self._problem.constraints
        squares = (motion.velocities * motion.velocities).sum(axis=-1)
        found = constraints.of_speeds(squares, data.speed_bound, data.speed_unit)
        # The tensions that are limited are those at the load, which stay.
        found += [np.zeros(squares.shape)] * len(constraints.names(Of.TENSION))
        found += constraints.of_squares(Of.SEPARATION, self._gaps(motion))
        flying: list[NDArray] = [np.zeros((len(squares), 0))]
        if problem.model.aircraft is not None:
            aircraft = flown_aircraft(problem.model.aircraft, bears_cable_drag=is_straight)
            needs = needs_of_motion(aircraft, motion, up)
            flying += constraints.of_flight(aircraft, needs)
        return np.hstack(found), np.hstack(flying)

    def _gaps(self, motion: OrbitMotion) -> NDArray:
        """The squared distances (k, pairs) of carriers, m²."""
        return squared_gaps(self._problem.model.attachments + motion.cables, self._problem.pairs)

    def _of_orbits(self, planned: NDArray, straight: OrbitMotion, bowed: OrbitMotion) -> NDArray:
        """What the margins (..., kinds, instants) of the terminal set lose.

        Of values (..., r, 8) of `_planned`. Speeds are nearly as A ξ, of which those margins are.
        """
        problem, lead = self._problem, planned.shape[:-2]
        of_squares, ends = problem.constraints.of_squares, len(problem.orbits_of)

        def on_orbits(values: NDArray) -> NDArray:
            of_each = values.reshape(*planned.shape[:-1], -1)[..., len(problem.flight_at) :, :]
            return of_each.reshape(*lead, ends, -1)

        slowest, fastest, gaps = [], [], []
        for motion in (straight, bowed):
            speeds = on_orbits(np.linalg.norm(motion.velocities, axis=-1))
            slowest.append(np.maximum(speeds.min(axis=-1), _LEAST_SPEED))
            fastest.append(np.maximum(speeds.max(axis=-1), _LEAST_SPEED))
            apart = of_squares(Of.SEPARATION, on_orbits(self._gaps(motion)))
            none = np.zeros((*lead, ends))
            gaps.append(min((m.min(axis=-1) for m in apart), key=np.min, default=none))
        orbits = PlannedParameters.view(planned)
        product = on_orbits(orbits.frequency * orbits.amplitude)[..., 0] / problem.terminal_unit
        lost = [
            product * (slowest[0] / slowest[1] - 1),
            product * (fastest[1] / fastest[0] - 1),
            gaps[0] - gaps[1],
        ]
        of_kinds = np.stack(lost, axis=-2)[..., problem.terminal_kinds, :]
        return np.repeat(of_kinds, problem.config.terminal_instants, axis=-1)
