"""The cost and the margins of the nonstop problem, traced once for all updates."""

from collections.abc import Callable
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics import nonstop
from drake_nonstop.mechanics.internal_force import orbit_axes
from drake_nonstop.mechanics.planned_orbit import (
    FlightTerms,
    OrbitTerms,
    PlannedOrbit,
    flight_terms,
    orbit_directions,
    planned_needs,
)
from drake_nonstop.mechanics.rigid_load import STILL_AIR, load_acceleration
from drake_nonstop.mechanics.rotation import rotation_matrix
from drake_nonstop.mechanics.signals import (
    PARAMETERS_SIZE,
    WRENCH_SIZE,
    Parameters,
)
from drake_nonstop.model.system import Model
from drake_nonstop.optimization.constraints import Constraints
from drake_nonstop.optimization.limits import Of
from drake_nonstop.optimization.problem_config import NonstopProblemConfig
from drake_nonstop.optimization.separation import OrbitDistances
from drake_nonstop.optimization.update_data import (
    ModelParameters,
    UpdateData,
    model_parameters_of,
    update_data_size,
)
from drake_nonstop.systems.tracing import TracedFunction

MIN_SPEEDS_FOR_ARRAYS = 90  # from this number on arrays are faster than a trace


class SpeedTerms(NamedTuple):
    """Terms of the speeds of p carriers, at all instants and phases, besides ξ and A."""

    polynomials: NDArray  # (10, 3, p), of `mechanics.nonstop.speed_polynomials`
    forces: NDArray  # (n, 3), N, in L at the last instant
    levers: NDArray  # (n, 3), m, likewise
    angles: NDArray  # (m,), rad, θ + φ_k

    @classmethod
    def from_flat(
        cls, polynomials: NDArray, forces: NDArray, levers: NDArray, angles: NDArray
    ) -> "SpeedTerms":
        """The terms, each with its shape, from flat ones."""
        return cls(
            polynomials.reshape(nonstop.POLYNOMIALS_SHAPE),
            forces.reshape(-1, 3),
            levers.reshape(-1, 3),
            angles,
        )


class TracedProblem:
    """The problem of all updates of one model and config.

    Three traced functions of x = [ξ, A] (2,) and the flat vector of an `UpdateData`: `terms`,
    `margins` and `cost`. `margins` are those of the `speed_count` speeds above the bound, then,
    for each limit, those of speeds, of tensions and of aircraft; none of the separation. The speeds
    of aircraft are those through the air, of other carriers over the ground. `data_size` is that of
    the vector, and `beliefs` are those of model and config. Arguments are as of `UpdateSolver`.
    """

    def __init__(self, model: Model, config: NonstopProblemConfig, name: Callable[[], str]):
        self.model, self.config, self.name = model, config, name
        beliefs = model_parameters_of(model, config)
        self.beliefs = np.concatenate(beliefs)
        self.data_size = update_data_size(len(beliefs.offset))
        points = config.look_ahead_points
        instants = np.linspace(0, config.period, points) if points > 1 else np.zeros(1)
        self._points = points
        turn_count = config.orbit_points // config.orbit_updates if config.orbit_points > 1 else 0
        self._turns = 2 * np.pi * np.arange(turn_count) / max(turn_count, 1)
        # The speeds of n carriers are constrained at each of these, by its number: at every
        # instant, and at the turns of the orbit ahead, which is later where there are two or more.
        if points > 1 and turn_count > 0:
            instants = np.append(instants, config.period + config.look_ahead_time)
        self._instants = instants
        last = np.full(turn_count, len(instants) - 1)
        self._instant_of_row = np.append(np.arange(points), last)
        axes = orbit_axes(model.pattern.basis, model.pattern.phases)
        self._axes = _without_round_off(axes[0]), _without_round_off(axes[1])
        self.constraints = Constraints(config)
        self.speed_count = len(self._instant_of_row) * model.n
        self.distances = OrbitDistances(self._axes)
        self.has_flight_limits = bool(self.constraints.names(Of.FLIGHT))
        self.terms = self._compiled(self._trace_terms)
        self.cost = self._compiled(self._trace_cost)
        if self.speed_count < MIN_SPEEDS_FOR_ARRAYS or self.has_flight_limits:
            self.margins = self._compiled(self._trace_margins)
        if self.has_flight_limits:
            self.flight_terms = self._compiled(self._trace_flight_terms)
            self.margins_and_jacobian = self._compiled(self._trace_margins, jacobian_of=0)

    @cached_property
    def flight_terms(self) -> TracedFunction:
        """The flat `FlightTerms` at each of the rows, one after the other, and their phases."""
        return self._compiled(self._trace_flight_terms)

    @cached_property
    def margins_and_jacobian(self) -> TracedFunction:
        """`margins`, with their exact Jacobian by x as one more output."""
        return self._compiled(self._trace_margins, jacobian_of=0)

    @cached_property
    def margins(self) -> TracedFunction:
        """The margins but for that of the separation."""
        return self._compiled(self._trace_margins)

    def margins_of(
        self, terms: SpeedTerms, frequency: NDArray, amplitude: NDArray, data: UpdateData
    ) -> NDArray:
        """`margins` at ξ (1,) and A (1,), of numbers or symbols."""
        values = nonstop.polynomial_values(terms.polynomials[:, :, None], amplitude[:, None])
        beliefs = ModelParameters.view(data.beliefs)
        c, b, a, tension_squares = nonstop.speed_squares(
            values, rest_length=beliefs.rest_length, compliance=beliefs.compliance
        )
        s = frequency * amplitude
        squares = c + s * (2 * b + s * a)
        margins = [
            *self.constraints.of_speeds(squares, data.speed_bound, data.speed_unit),
            *self.constraints.of_squares(Of.TENSION, tension_squares),
        ]
        return np.concatenate(margins, axis=1)[0]

    def with_gradients(self) -> tuple[TracedFunction, TracedFunction]:
        """`cost` and `margins`, each with one more output: its exact Jacobian by x."""
        return self._compiled(self._trace_cost, jacobian_of=0), self.margins_and_jacobian

    def bounds(self, previous: NDArray, beliefs: ModelParameters) -> tuple[NDArray, NDArray]:
        """The lower and upper bounds (2,) of [ξ, A], within reach at the limits of their rates."""
        rates = [self.config.max_frequency_rate, self.config.max_amplitude_rate]
        step = self.config.period * np.array(rates)
        return np.maximum(beliefs.lower, previous - step), np.minimum(
            beliefs.upper, previous + step
        )

    def _compiled(self, function: Callable, jacobian_of: int | None = None) -> TracedFunction:
        # A solver may try the far ends of the bounds, where values are huge and sound.
        return TracedFunction(
            function,
            [PARAMETERS_SIZE, self.data_size],
            name=self.name,
            largest=1e100,
            jacobian_of=jacobian_of,
            key=(function.__name__, *self.geometry, self.config),
        )

    @property
    def geometry(self) -> tuple:
        """Key of the traces: values of the model that do not change."""
        pattern, model = self.model.pattern, self.model
        return (
            model.attachments,
            model.pseudo_inverse,
            pattern.basis,
            pattern.phases,
            model.offset_parameter,
            model.aircraft,
        )

    def _trace_instants(self, data: UpdateData) -> tuple[list[FlightTerms], NDArray]:
        """The terms at each instant, and the levers (n, 3) of the attachments at the last one."""
        state, reference, model = data.load_state, data.reference, self.model
        beliefs = ModelParameters.view(data.beliefs)
        wind = STILL_AIR if model.aircraft is None else data.wind
        load = beliefs.load
        accelerations = load_acceleration(load, state, data.wrench, wind)
        wrench_rate, second_rate = data.wrench_rate, self._second_rate(data)
        found = []
        for instant in self._instants:
            ahead = nonstop.advance(state, *accelerations, instant)
            motion = np.concatenate([ahead, *accelerations, np.zeros(3)])
            if self.config.load_motion == "desired":
                motion = nonstop.advanced_reference(reference, instant)
            terms = flight_terms(
                ahead,
                motion,
                data.wrench + instant * (wrench_rate + instant / 2 * second_rate),
                wrench_rate + instant * second_rate,
                second_rate,
                wind,
                pseudo_inverse=_without_round_off(model.pseudo_inverse),
                offset=beliefs.offset if len(beliefs.offset) else np.zeros(3 * model.n),
                attachments=model.attachments,
            )
            found.append(terms)
        turn = rotation_matrix(ahead[:4]).T @ rotation_matrix(motion[:4])
        return found, model.attachments @ turn.T

    def _second_rate(self, data: UpdateData) -> NDArray:
        """The wrench's second rate (6,) that counts: of aircraft none.

        It is a difference quotient. On cables of a hundred metres 1 N/s² is some 5 m/s², and a jump
        of the rate between two updates is no acceleration.
        """
        return data.wrench_second_rate if self.model.aircraft is None else np.zeros(WRENCH_SIZE)

    def _trace_flight_terms(self, x: NDArray, vector: NDArray) -> tuple[NDArray, NDArray]:
        """The flat `FlightTerms` (rows, 15n + 9), and the phases (rows,)."""
        data = UpdateData.view(vector)
        found = np.stack([terms.flat for terms in self._trace_instants(data)[0]])
        return found[self._instant_of_row], self._angles_of_rows(x, data)

    def _angles_of_rows(self, x: NDArray, data: UpdateData) -> NDArray:
        """The phases (rows,), rad."""
        angle = nonstop.phase_of(x, data.previous, data.phase)
        ahead = angle + Parameters.view(data.previous).frequency * self._instants
        return np.concatenate([ahead[: self._points], ahead[-1:] + data.orbit_turn + self._turns])

    def _trace_terms(self, x: NDArray, vector: NDArray) -> tuple[NDArray, ...]:
        """The `SpeedTerms`."""
        data = UpdateData.view(vector)
        instants, levers = self._trace_instants(data)
        parts = zip(*(terms.of_speeds for terms in instants), strict=True)
        rows = OrbitTerms(*(np.stack(part)[self._instant_of_row] for part in parts))
        u, along, _ = orbit_directions(self._axes, self._angles_of_rows(x, data))
        polynomials = nonstop.speed_polynomials(rows, u, along)
        angle = nonstop.phase_of(x, data.previous, data.phase)
        return SpeedTerms(
            polynomials.reshape(nonstop.POLYNOMIALS_SHAPE),
            instants[-1].forces,
            levers,
            angle + self.model.pattern.phases,
        )

    def _trace_margins(self, x: NDArray, vector: NDArray) -> NDArray:
        data = UpdateData.view(vector)
        terms = SpeedTerms.from_flat(*self.terms.traced(x, vector))
        margins = self.margins_of(terms, *Parameters.view(x), data)
        if not self.has_flight_limits:
            return margins
        flat, angles = self._trace_flight_terms(x, vector)
        flight = self.flight_margins(flat, angles, *Parameters.view(x), data)
        return np.concatenate([margins, *(of_kind.ravel() for of_kind in flight)])

    def flight_margins(
        self,
        flat_terms: NDArray,
        angles: NDArray,
        frequency: NDArray,
        amplitude: NDArray,
        data: UpdateData,
    ) -> list[NDArray]:
        """The margins (k, n) of limits of aircraft at k instants, of numbers or symbols.

        At θ (k,), ξ (k,) or (1,) and A likewise, of flat terms (k, 15n + 9).
        """
        aircraft, beliefs = self.model.aircraft, ModelParameters.view(data.beliefs)
        assert aircraft is not None
        aircraft = aircraft._replace(cable_length=beliefs.rest_length, gravity=beliefs.gravity)
        needs = planned_needs(
            aircraft,
            FlightTerms.view(flat_terms),
            self._axes,
            PlannedOrbit.constant(angles, frequency, amplitude),
            **beliefs.cables,
        )
        return self.constraints.of_flight(aircraft, needs)

    def _trace_cost(self, x: NDArray, vector: NDArray) -> NDArray:
        data = UpdateData.view(vector)
        return nonstop.change_cost(
            x,
            data.previous,
            data.phase,
            phases=self.model.pattern.phases,
            internal_force_weight=self.config.internal_force_weight,
            internal_force_rate_weight=self.config.internal_force_rate_weight,
            anchor_weight=data.anchor_weight,
            nominal=ModelParameters.view(data.beliefs).nominal,
        )


def _without_round_off(matrix: NDArray) -> NDArray:
    """The matrix with entries that are zero but for round-off set to zero: fewer operations."""
    return np.where(np.abs(matrix) > 1e-14 * np.max(np.abs(matrix)), matrix, 0.0)
