"""Constraints of orbits of ξ and A above a load's reference: their terms, and all their phases."""

import functools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.aircraft import Aircraft
from drake_nonstop.mechanics.bowed_orbit import CableShape
from drake_nonstop.mechanics.internal_force import orbit_axes
from drake_nonstop.mechanics.planned_orbit import (
    FlightTerms,
    OrbitTerms,
    PlannedOrbit,
    flight_along_reference,
    orbit_along_reference,
    orbit_directions,
    planned_gaps,
    planned_needs,
    planned_speeds,
)
from drake_nonstop.mechanics.rigid_load import STILL_AIR
from drake_nonstop.mechanics.signals import LOAD_REFERENCE_SIZE, WIND_SIZE
from drake_nonstop.model.system import Model
from drake_nonstop.optimization.constraints import Constraints
from drake_nonstop.optimization.elementwise import ElementwiseFunction, RowsFunction
from drake_nonstop.optimization.horizon_config import HorizonConfig
from drake_nonstop.optimization.limits import Of
from drake_nonstop.optimization.problem_config import LimitsConfig
from drake_nonstop.optimization.separation import OrbitDistances
from drake_nonstop.optimization.terminal_set import (
    TerminalSet,
    TerminalTables,
    limits_of_carrier,
    product_limits,
)
from drake_nonstop.optimization.update_data import ModelParameters, model_parameters_of


class OrbitConstraints:
    """Tells how orbits of ξ and A keep the limits of one model and config.

    Args:
        model: what the controllers believe.
        limits: ε, `tightening`, the nominal ξ and A, and their bounds.
        config: of a horizon; the numbers of phases and amplitudes, and what follows jumps, count.
        name: tells what evaluates the terms, for the error of a value that is not finite.
        beliefs: numbers in place of those of model and limits.
        shape: of cables that bow; None: they are straight.

    Attributes:
        numbers: (c,), of cables (L₀ in m, 1/K_c in m/N), limits (`Constraints.values`), aircraft.
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
        self.model, self.limits, self.config, self.name = model, limits, config, name
        beliefs = beliefs or model_parameters_of(model, limits)
        self.nominal = beliefs.nominal
        self._bounds = np.stack([beliefs.lower, beliefs.upper])
        self._beliefs = np.concatenate(beliefs)
        self.rest_length = float(beliefs.rest_length[0])  # m
        self.compliance = float(beliefs.compliance[0])  # m/N
        self.cables: dict[str, Any] = {
            "rest_length": self.rest_length,
            "compliance": self.compliance,
        }
        self.axes = orbit_axes(model.pattern.basis, model.pattern.phases)
        low, high = self._bounds[:, 1]
        self.amplitudes = np.linspace(low, high, config.terminal_amplitudes)
        self.constraints = Constraints(limits)
        self.max_speed = self.constraints.max_speed  # m/s, tightened
        self._limits_flight = bool(self.constraints.names(Of.FLIGHT))
        self.orbit_angles = 2 * np.pi * np.arange(config.terminal_phases) / config.terminal_phases
        u, along, _ = orbit_directions(self.axes, self.orbit_angles)
        directions = np.concatenate([u, along], axis=2)
        self.orbit_directions = np.ascontiguousarray(np.moveaxis(directions, 2, 0))
        parts = [self.rest_length, self.compliance, *self.constraints.values]
        self.numbers = np.concatenate([*map(np.atleast_1d, [*parts, *(model.aircraft or ())])])
        self.limits_of_carriers = ElementwiseFunction(
            self._limits_of_carrier,
            [12, 6, 1, 1, len(self.numbers)],
            directions.shape[:2],
            key=("limits_of_carrier", self.constraints.names(*Of)),
            has_derivatives=False,
            compiles=True,
        )
        self._keeps_apart = self.constraints.min_separation > 0
        self._distances = OrbitDistances(self.axes)
        self.pairs, self._encounters = self._distances.pairs(), self._distances.every()
        self._terms = self._of_rows(orbit_along_reference)
        self.offset = beliefs.offset if len(beliefs.offset) else np.zeros(3 * model.n)
        self.shape = shape and shape.of_length(self.rest_length, self.compliance)
        if self._limits_flight or shape is not None:
            self._flight_terms = self._of_rows(flight_along_reference)

    def _limits_of_carrier(self, *given: NDArray) -> list[NDArray]:
        """`limits_of_carrier` of its first arguments and the `numbers`."""
        cables, constraints, _ = self._of_numbers(given[-1])
        tensions = functools.partial(constraints.of_squares, Of.TENSION)
        own = {"max_speed": constraints.max_speed, "margins_of_tension": tensions, **cables}
        return limits_of_carrier(*given[:-1], **own)

    def _of_numbers(self, numbers: NDArray) -> tuple[dict[str, Any], Constraints, Aircraft | None]:
        """Cables, constraints and aircraft of other `numbers`, such as symbols."""
        own = self.model.aircraft
        sizes = [1, 1, len(self.constraints.values), *map(np.size, own or ())]
        rest_length, compliance, values, *parts = np.split(numbers, np.cumsum(sizes)[:-1])
        return (
            {"rest_length": rest_length, "compliance": compliance},
            self.constraints.with_values(values[:, None]),
            None if own is None else Aircraft(*parts),
        )

    def all_terms(self, references: NDArray, winds: NDArray = STILL_AIR) -> NDArray:
        """The flat `OrbitTerms` (k, 9n + 3) of references (k, 22).

        In winds (3,) or (k, 3), in m/s, in W, which count for aircraft.
        """
        return self._terms(self._stacked(references, winds))

    def flight_terms(self, references: NDArray, winds: NDArray) -> NDArray:
        """The flat `FlightTerms` (k, 15n + 9) likewise; (k, 0) where nothing needs them."""
        if not self._limits_flight and self.shape is None:
            return np.zeros((len(references), 0))
        return self._flight_terms(self._stacked(references, winds))

    def _stacked(self, references: NDArray, winds: NDArray) -> NDArray:
        """Arguments of the functions for references (k, 22), in winds (3,) or (k, 3)."""
        count = len(references)
        own = np.broadcast_to(self._beliefs, (count, len(self._beliefs)))
        return np.hstack([references, own, np.broadcast_to(winds, (count, WIND_SIZE))])

    def orbit_flight_margins(
        self, flat_flight: NDArray, frequency: float, amplitude: float
    ) -> NDArray:
        """The worst margins (k,) of aircraft's limits over whole orbits of constant ξ and A.

        Of flat `FlightTerms` (k, 15n + 9), with limits of flight.
        """
        angles, count = self.orbit_angles, len(flat_flight)
        orbit = PlannedOrbit.constant(np.tile(angles, count), frequency, amplitude)
        terms = FlightTerms.view(np.repeat(flat_flight, len(angles), axis=0))
        margins = self._flight_margins(terms, self.axes, orbit, self.numbers)
        worst: NDArray = np.min(margins, axis=(0, 2)).reshape(count, -1).min(axis=1)
        return worst

    def _flight_margins(
        self,
        terms: FlightTerms,
        axes: tuple[NDArray, NDArray],
        orbit: PlannedOrbit,
        numbers: NDArray,
    ) -> list[NDArray]:
        """The margins (k, n) of aircraft's limits, of numbers or symbols."""
        cables, constraints, aircraft = self._of_numbers(numbers)
        assert aircraft is not None
        needs = planned_needs(aircraft, terms, axes, orbit, **cables)
        return constraints.of_flight(aircraft, needs)

    def jump_margins(self, terms: OrbitTerms) -> NDArray:
        """Excess of the speeds (k, n) above the bound that a jump of the plan asks for, m/s.

        At k evenly spaced instants, of the jump since the one before. Where the jerk of the
        reference jumps, so do the planned velocities, by at most (L₀/T + 1/K_c) ‖Δd₀‖, T without A.
        The carriers then swing past the new velocity by a share of the jump, the `overshoot`,
        within the `settling_time`. Own derivation.
        """
        jumps = np.zeros(terms.forces.shape[:2])
        jumps[1:] = self._reach(terms)[1:] * _lengths(np.diff(terms.rates, axis=0))
        return self.config.overshoot * jumps

    def settling_instants(self, spacing: float) -> int:
        """How many instants, so many s apart, a jump counts for."""
        return max(math.ceil(self.config.settling_time / spacing), 1)

    @staticmethod
    def settled(jumps: NDArray, instants: int) -> NDArray:
        """The largest (k, n) of the jumps at an instant and those before it, so many in all."""
        padded = np.concatenate([np.zeros((instants - 1, jumps.shape[1])), jumps])
        shifted = (padded[i : i + len(jumps)] for i in range(instants))
        return functools.reduce(np.maximum, shifted)

    def _reach(self, terms: OrbitTerms) -> NDArray:
        """By how much (k, n) a carrier moves with a force across its cable, m/N."""
        return self.rest_length / _lengths(terms.forces) + self.compliance

    def terminal_set(
        self, flat_terms: NDArray, speed_bound: NDArray | float, amplitudes: NDArray
    ) -> TerminalSet:
        """The terminal set of flat terms (k, 9n + 3), for a bound in m/s or those (k, n, 1).

        At amplitudes (a,) in N.
        """
        terms = OrbitTerms.view(flat_terms)
        least, most, *tension_squares = product_limits(
            terms,
            self.axes,
            amplitudes,
            speed_bound,
            self.constraints.max_speed,
            phase_count=self.config.terminal_phases,
            **self.cables,
        )
        margins = self._margins_apart(terms, amplitudes)
        for squares in tension_squares:
            for margin in self.constraints.of_squares(Of.TENSION, squares):
                margins = np.minimum(margins, margin)
        return TerminalSet(amplitudes, least, most, margins)

    def _margins_apart(self, terms: OrbitTerms, amplitudes: NDArray) -> NDArray:
        """The worst margins (k, a) of the distances of carriers; inf where none are limited."""
        margins = np.full((len(terms.forces), len(amplitudes)), np.inf)
        for row, forces in zip(margins, terms.forces if self._keeps_apart else (), strict=False):
            squares = self._distances.least_squares(
                self._encounters, amplitudes, forces, self.model.attachments, **self.cables
            ).min(axis=1)
            for margin in self.constraints.of_squares(Of.SEPARATION, squares):
                np.minimum(row, margin, out=row)
        return margins

    def terminal_tables(self, flat_terms: NDArray, bounds: NDArray) -> TerminalTables:
        """The tables over A of flat terms (k, 9n + 3), for bounds (k, n) in m/s."""
        terms = OrbitTerms.view(flat_terms)
        return TerminalTables(
            amplitudes=self.amplitudes,
            limits=np.full((3, len(bounds), len(self.amplitudes)), np.nan),
            apart=self._margins_apart(terms, self.amplitudes),
            flat_terms=flat_terms,
            bounds=bounds,
            function=self.limits_of_carriers,
            directions=self.orbit_directions,
            numbers=self.numbers,
        )

    def values_along(self, of: Of, terms: OrbitTerms, orbit: PlannedOrbit) -> NDArray:
        """Speeds, tensions or separations (k, c) at k instants, of the carriers, cables or pairs.

        In m/s, N or m.
        """
        if of is Of.SEPARATION:
            ends = {"attachments": self.model.attachments, "pairs": self.pairs}
            return np.sqrt(planned_gaps(terms.forces, self.axes, orbit, **ends, **self.cables))
        speeds, tensions = planned_speeds(terms, self.axes, orbit, **self.cables)
        return np.sqrt(speeds if of is Of.SPEED else tensions)

    def _of_rows(self, terms: Callable[..., NDArray]) -> RowsFunction:
        """The flat terms that a function has of a load, a reference, a wind and a model."""
        model = self.model

        def of_reference(reference: NDArray, vector: NDArray, wind: NDArray) -> NDArray:
            beliefs = ModelParameters.view(vector)
            return terms(
                beliefs.load,
                reference,
                STILL_AIR if model.aircraft is None else wind,
                pseudo_inverse=model.pseudo_inverse,
                offset=beliefs.offset if len(beliefs.offset) else np.zeros(3 * model.n),
                attachments=model.attachments,
            )

        key = terms.__name__, model.attachments, model.pseudo_inverse, model.aircraft is None
        sizes = [LOAD_REFERENCE_SIZE, len(self._beliefs), WIND_SIZE]
        return RowsFunction(of_reference, sizes, name=self.name, key=key)


def _lengths(vectors: NDArray) -> NDArray:
    """The Euclidean norms (k, n) of vectors (k, n, 3); faster than NumPy's."""
    return np.sqrt(np.einsum("...i,...i", vectors, vectors))
