"""The margins of carriers' limits at points of plans, with their gradients, as one traced function.

A point is the values of `planned`, the load's reference and the wind there. A margin is negative
where its limit is not kept: ‖v_i‖²/ε² − 1 of a speed, and likewise the other rows of the table of
limits, and those of two carriers' distance. Where cables bow, the margins are those of carriers at
their upper ends, see `mechanics.bowed_orbit`, with gradients by differences.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.aircraft import Aircraft, flown_aircraft
from drake_nonstop.mechanics.bowed_orbit import CableShape, bowed_motion
from drake_nonstop.mechanics.cable import within
from drake_nonstop.mechanics.internal_force import orbit_axes, orbit_forces
from drake_nonstop.mechanics.load_motion import LoadMotion
from drake_nonstop.mechanics.lumped_cable import CableMaterial
from drake_nonstop.mechanics.planned_orbit import (
    FlightTerms,
    OrbitMotion,
    needs_of_motion,
    orbit_motion,
)
from drake_nonstop.mechanics.rotation import absolute
from drake_nonstop.mechanics.signals import (
    LOAD_REFERENCE_SIZE,
    PLANNED_SIZE,
    WIND_SIZE,
    PlannedParameters,
)
from drake_nonstop.model.block import rigid_load
from drake_nonstop.model.system import Model
from drake_nonstop.planning.constraints import Constraints
from drake_nonstop.planning.diagnostics import BOUND
from drake_nonstop.planning.limits import Of
from drake_nonstop.planning.model_parameters import ModelParameters
from drake_nonstop.systems.grid_function import GridFunction

_AIRCRAFT, _MATERIAL = "aircraft.", "material."  # begin the names of numbers
_LEAST = 1e-12  # m², beside a square that may vanish
POINT_SIZE = PLANNED_SIZE + LOAD_REFERENCE_SIZE + WIND_SIZE + 2


class _CarrierMotion(NamedTuple):
    """A carrier's motion (1, 1, 3) through the air, and what its margins need besides."""

    motion: OrbitMotion
    at_load: NDArray  # N, its cable's force on the load
    faster: NDArray  # m, the change of its velocity with ξ on straight cables
    parts: dict[str, NDArray]  # its numbers, of each kind


class CarrierMargins:
    """The margins of all carriers, and of their pairs, of one model and table of limits.

    A point (35,) is a `planned` (8,), a reference (22,) and a wind (3,), m/s, in W; then 1 on a
    whole orbit of constant ξ and A, else 0; and half the way to the next point, s, on orbits rad.

    Args:
        model: what the controllers believe.
        constraints: the limits.
        beliefs: numbers in place of those of the model.
        steps: (8,), of differences by the entries of `planned`, on cables that bow.
        shape: of cables that bow; None: they are straight.

    Attributes:
        names: (r,), of the rows of margins: of carriers, those of the bound first, and of pairs.
        by: (g,), the entries of `planned` by which margins have gradients.
    """

    def __init__(
        self,
        model: Model,
        constraints: Constraints,
        beliefs: ModelParameters,
        steps: NDArray,
        shape: CableShape | None = None,
    ):
        self._model, self._constraints, self._steps, self._shape = model, constraints, steps, shape
        self._numbers = self._numbers_of(beliefs)
        of_carriers = [BOUND, *constraints.names(Of.SPEED, Of.TENSION, Of.FLIGHT)]
        of_pairs = constraints.names(Of.SEPARATION)
        self._pairs = np.array(np.triu_indices(model.n, 1))
        counts = [model.n] * len(of_carriers) + [self._pairs.shape[1]] * len(of_pairs)
        self.names = np.repeat([*of_carriers, *of_pairs], counts)
        self._functions = [self._function(self._margins_of_carrier)]
        if of_pairs:
            self._functions.append(self._function(self._margins_of_pair, 2))
        every = np.arange(PLANNED_SIZE)
        by = np.unique(np.concatenate([function.by for function in self._functions]))
        self.by = by if shape is None else every

    def __call__(self, points: NDArray, bounds: NDArray) -> tuple[NDArray, NDArray]:
        """The margins (r, p) at points (35, p), and their gradients (g, r, p).

        For speed bounds (n,) of the carriers, m/s; where one is 0 any speed is enough.
        """
        if self._shape is None:
            return self._exact(points, bounds)
        steps = np.zeros((POINT_SIZE, 1 + PLANNED_SIZE))
        steps[:PLANNED_SIZE, 1:] = np.diag(self._steps)
        many = points[:, None] + steps[..., None]
        values, _ = self._exact(many.reshape(POINT_SIZE, -1), bounds)
        values = values.reshape(len(values), 1 + PLANNED_SIZE, -1)
        differences = (values[:, 1:] - values[:, :1]) / self._steps[:, None]
        return values[:, 0].copy(), np.moveaxis(differences, 1, 0)

    @property
    def resting_speeds(self) -> NDArray:
        """The carriers' speeds (n,), m/s, per ξ A in N/s, nearly, about a level load at rest."""
        numbers = self._numbers
        weight = numbers["load"][0, 0] * numbers["load"][12, 0] * np.eye(6)[5]
        forces = (self._model.pseudo_inverse @ weight).reshape(-1, 3) + numbers["offset"].T
        rest_length, compliance = numbers["cable"]
        reach = rest_length / np.linalg.norm(forces, axis=1) + compliance  # m/N, across a cable
        return np.linalg.norm(numbers["axes"][:3], axis=0) * reach

    def _exact(self, points: NDArray, bounds: NDArray) -> tuple[NDArray, NDArray]:
        """The margins, and those gradients that CasADi makes."""
        scale = np.stack([bounds, np.where(bounds > 0, bounds, 1.0)])
        numbers = np.vstack([*(self._numbers | {"scale": scale}).values()])
        of_pairs = np.concatenate(numbers[:, self._pairs].swapaxes(0, 1))
        shape = len(self.names), points.shape[1]
        margins, gradients, first = np.empty(shape), np.zeros((len(self.by), *shape)), 0
        for function, own in zip(self._functions, (numbers, of_pairs), strict=False):
            values, derivatives = function(points, own)
            rows = slice(first, first := first + values.shape[0] * values.shape[1])
            margins[rows] = values.reshape(-1, shape[1])
            if function.by.size:
                by = np.searchsorted(self.by, function.by)
                own_shape = len(by), -1, shape[1]
                gradients[by, rows] = derivatives.swapaxes(0, 1).reshape(own_shape)
        return margins, gradients

    def _function(self, margins: Callable, carriers: int = 1) -> GridFunction:
        """A function of margins, of a point and of the numbers of so many carriers."""
        count, shape = sum(map(len, self._numbers.values())), self._shape
        window = () if shape is None else (shape.nodes, *shape.window.times)
        kinds = {name: len(part) for name, part in self._numbers.items()}
        key = margins.__name__, *kinds.items(), *self._constraints.names(*Of), *window
        by = 0 if shape is not None else PLANNED_SIZE
        return GridFunction(margins, POINT_SIZE, carriers * count, key=key, by=by)

    def _numbers_of(self, beliefs: ModelParameters) -> dict[str, NDArray]:
        """Numbers of the carriers, (c, n) of each kind; the first are the bound and its unit."""
        model, n = self._model, self._model.n

        def shared(*parts: Any) -> NDArray:
            return np.repeat(np.concatenate([*map(np.ravel, parts)])[:, None], n, axis=1)

        def single(part: Any) -> NDArray:
            return np.broadcast_to(np.ravel(part), (1, n))

        lengths = beliefs.rest_length, beliefs.compliance
        offset = beliefs.offset if len(beliefs.offset) else np.zeros(3 * n)
        numbers = {
            "scale": np.ones((2, n)),
            "load": shared(*beliefs[:5]),
            "cable": np.vstack([*map(single, lengths)]),
            "limits": shared(self._constraints.values),
            "offset": offset.reshape(n, 3).T,
            "attachment": model.attachments.T,
            "inverse": model.pseudo_inverse.reshape(n, 18).T,
            "axes": np.hstack(orbit_axes(model.pattern.basis, model.pattern.phases)).T,
        }
        for name, part in {} if model.aircraft is None else model.aircraft._asdict().items():
            numbers[_AIRCRAFT + name] = (single if name.startswith("cable_") else shared)(part)
        if self._shape is not None:
            for name, part in self._shape.of_length(*lengths).cable._asdict().items():
                numbers[_MATERIAL + name] = single(part)
        return numbers

    def _named(self, numbers: NDArray) -> dict[str, NDArray]:
        """The kinds of one carrier's numbers (c,)."""
        ends = np.cumsum([len(part) for part in self._numbers.values()])
        return dict(zip(self._numbers, np.split(numbers, ends[:-1]), strict=True))

    def _motion_of(self, point: NDArray, numbers: NDArray) -> "_CarrierMotion":
        """A carrier's motion at a point, which ends with the mark of whole orbits."""
        parts = self._named(numbers)
        planned, reference, wind, _ = np.split(
            point, np.cumsum([PLANNED_SIZE, LOAD_REFERENCE_SIZE, WIND_SIZE])
        )
        load, ends = parts["load"], {"attachments": parts["attachment"][None]}
        terms = FlightTerms.along(
            rigid_load(load[:1], load[1:10].reshape(3, 3), *np.split(load[10:], 3)),
            LoadMotion.along(reference[None]),
            wind,
            pseudo_inverse=parts["inverse"].reshape(3, 6),
            offset=parts["offset"],
        )
        cables = parts["cable"]
        p, q = parts["axes"].reshape(2, 1, 3)
        pattern = functools.partial(orbit_forces, (p, q))

        def straight(planned: NDArray) -> OrbitMotion:
            series = PlannedParameters.view(planned[None]).series
            own = {"rest_length": cables[:1], "compliance": cables[1:], **ends}
            return orbit_motion(terms, pattern(*series), **own)

        now = straight(planned)
        # On whole orbits velocities are affine in ξ.
        faster = straight(planned + np.eye(PLANNED_SIZE)[1]).velocities - now.velocities
        at_load = now.forces
        if self._shape is not None:
            material = [parts[_MATERIAL + name][:, None] for name in CableMaterial._fields]
            shape = self._shape._replace(cable=CableMaterial(*material))
            bowed = bowed_motion(terms, pattern, planned[None], shape, wind, **ends)
            now, at_load = bowed.motion, bowed.at_load
        now = now._replace(velocities=now.velocities - wind)
        return _CarrierMotion(now, at_load, faster, parts)

    def _margins_of_carrier(self, point: NDArray, numbers: NDArray) -> list[NDArray]:
        """The margins of one carrier at a point.

        The bound holds for the least speed within half the time between two points, at a constant
        acceleration. On whole orbits the part of the velocity that grows with ξ counts with its
        sign: there a plan must not end on a branch of slow orbits, from which nothing leads back.
        """
        motion, at_load, faster, parts = self._motion_of(point, numbers)
        constraints, scale = self._constraints.with_values(parts["limits"][:, None]), parts["scale"]
        is_whole, reach = point[-2:-1], point[-1:]
        half = reach * (1 - is_whole + is_whole / point[1:2])
        time = -_product(motion.velocities, motion.accelerations) / (
            _product(motion.accelerations, motion.accelerations) + _LEAST
        )
        velocity = motion.velocities + within(time, -half, half)[..., None] * motion.accelerations
        along, square = _product(faster, velocity), _product(velocity, velocity)
        behind = along * (absolute(along) - along) / (_product(faster, faster) + _LEAST)
        squares = _product(motion.velocities, motion.velocities)
        found = constraints.of_speeds(squares, scale[:1], scale[1:])
        found[0] = found[0] + (square + is_whole * behind - squares) / (scale[1:] * scale[1:])
        found += constraints.of_squares(Of.TENSION, (at_load * at_load).sum(axis=-1))
        if constraints.names(Of.FLIGHT):
            aircraft = Aircraft(*(parts[_AIRCRAFT + name] for name in Aircraft._fields))
            aircraft = flown_aircraft(aircraft, bears_cable_drag=self._shape is None)
            found += constraints.of_flight(aircraft, needs_of_motion(aircraft, motion))
        return found

    def _margins_of_pair(self, point: NDArray, numbers: NDArray) -> list[NDArray]:
        """The margins of the distance of two carriers at a point."""
        ends = []
        for own in np.split(numbers, 2):
            carrier = self._motion_of(point, own)
            ends.append(carrier.motion.positions)
        gap = ends[0] - ends[1]
        constraints = self._constraints.with_values(carrier.parts["limits"][:, None])
        return constraints.of_squares(Of.SEPARATION, (gap * gap).sum(axis=-1))


def _product(a: NDArray, b: NDArray) -> NDArray:
    """The scalar products (...,) of vectors (..., 3)."""
    return (a * b).sum(axis=-1)
