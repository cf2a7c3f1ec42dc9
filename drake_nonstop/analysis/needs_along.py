"""What the aircraft of a task need along a plan of ξ and A."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.analysis.aircraft_margins import asked_load
from drake_nonstop.analysis.task import Task
from drake_nonstop.mechanics.cable import forces_under_other_wrench, wrenches_of
from drake_nonstop.mechanics.nonstop import orbit_axes
from drake_nonstop.mechanics.planned_orbit import (
    FlightNeeds,
    FlightTerms,
    PlannedOrbit,
    flight_along_reference,
    flight_needs,
    flight_products,
    planned_cable_forces,
)
from drake_nonstop.mechanics.rigid_load import RigidLoad
from drake_nonstop.mechanics.signals import PlannedParameters
from drake_nonstop.model.system import Model


class NeedsAlong:
    """What the simulated aircraft of a task need on plans that they follow exactly.

    The carriers fly the orbits of the load that the controllers believe in, or, where they follow
    the measured one, of the simulated load; the cables hold the simulated one.

    Args:
        task: with aircraft, and an internal force of the first harmonic.
        times: (k,), s, of the plans.
    """

    def __init__(self, task: Task, times: NDArray):
        assert task.flown.aircraft is not None
        self._aircraft, self._plant = task.flown.aircraft, task.flown
        self._believed = task.carried
        above = _height_of_carriers(self._believed)
        winds = [task.wind_at(time, above) for time in times]
        load = asked_load(self._believed, self._plant)
        self._terms = _terms_of(task, self._believed, load, times, winds)
        self._axes = orbit_axes(self._believed.pattern.basis, self._believed.pattern.phases)
        self._wrenches: NDArray | None = None
        if self._believed is not self._plant:
            held = _terms_of(task, self._plant, self._plant.load, times, winds).forces
            self._wrenches = wrenches_of(held, self._plant.attachments)

    def needs(self, planned: NDArray) -> FlightNeeds:
        """What they need, (k, n) each, of the plan's values (k, 8), in the mean wind up there."""
        products = flight_products(
            self._aircraft,
            self._terms,
            self._axes,
            _orbit_of(planned),
            rest_length=self._believed.cable_length,
            compliance=self._believed.cable_compliance,
            cable_forces=self.cable_forces(planned),
        )
        return flight_needs(self._aircraft, products)

    def cable_forces(self, planned: NDArray) -> NDArray:
        """The forces (k, n, 3) of the cables on the load, N, in L, of the plan's values (k, 8)."""
        forces = planned_cable_forces(self._terms, self._axes, _orbit_of(planned))
        if self._wrenches is None:
            return forces
        return forces_under_other_wrench(
            forces,
            self._plant.attachments,
            self._wrenches,
            rest_length=self._plant.cable_length,
            stiffness=self._plant.cable_stiffness,
        )


def _orbit_of(planned: NDArray) -> PlannedOrbit:
    parts = PlannedParameters.view(planned)
    return PlannedOrbit(*(getattr(parts, name)[:, 0] for name in PlannedOrbit._fields))


def _terms_of(
    task: Task, model: Model, load: RigidLoad, times: NDArray, winds: Sequence[NDArray]
) -> FlightTerms:
    """What the orbits of a model depend on besides the plan, at times (k,), s, with their winds."""
    flat = [
        flight_along_reference(
            load,
            task.reference(time),
            wind,
            pseudo_inverse=model.pseudo_inverse,
            offset=model.pattern.offset,
            attachments=model.attachments,
        )
        for time, wind in zip(times, winds, strict=True)
    ]
    return FlightTerms.view(np.array(flat))


def _height_of_carriers(model: Model) -> float:
    """How far above their load the carriers are in the mean, m, where it rests without sway."""
    weight = np.array([0, 0, 0, 0, 0, model.load_mass * model.gravity])
    forces = (model.pseudo_inverse @ weight + model.pattern.offset).reshape(-1, 3)
    return model.cable_length * float(np.mean(forces[:, 2] / np.linalg.norm(forces, axis=1)))
