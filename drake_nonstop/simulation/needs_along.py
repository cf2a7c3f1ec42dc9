"""What the aircraft of a task need along a plan of ξ and A."""

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.nonstop import orbit_axes
from drake_nonstop.mechanics.planned_flight import (
    FlightNeeds,
    FlightTerms,
    PlannedOrbit,
    flight_along_reference,
    flight_needs,
    flight_products,
)
from drake_nonstop.mechanics.signals import PLANNED_SIZE, PlannedParameters
from drake_nonstop.optimization.plan import Plan
from drake_nonstop.simulation.task import Task


def planned_values(task: Task, plan: Plan | None, times: NDArray) -> NDArray:
    """θ, ξ, A and their rates (k, 8) of a plan at times (k,), s; None: the nominal ξ and A."""
    values = np.zeros((len(times), PLANNED_SIZE))
    parts = PlannedParameters.view(values)
    if plan is None:
        parts.frequency[:], parts.amplitude[:] = task.nominal
        parts.angle[:] = times[:, None] * task.limits.frequency
    else:
        values[:] = [plan.values(time) for time in times]
    return values


class NeedsAlong:
    """What the simulated aircraft of a task need on plans that they follow exactly.

    Args:
        task: with aircraft, and an internal force of the first harmonic.
        times: (k,), s, of the plans.
    """

    def __init__(self, task: Task, times: NDArray):
        assert task.flown.aircraft is not None
        self._model, self._aircraft = task.flown, task.flown.aircraft
        model, above = task.flown, _height_of_carriers(task)
        self._flat = np.array(
            [
                flight_along_reference(
                    model.load,
                    task.reference(time),
                    task.wind_at(time, above),
                    pseudo_inverse=model.pseudo_inverse,
                    offset=model.pattern.offset,
                    attachments=model.attachments,
                )
                for time in times
            ]
        )

    def needs(self, planned: NDArray) -> FlightNeeds:
        """What they need, (k, n) each, of the plan's values (k, 8), in the mean wind up there."""
        model, parts = self._model, PlannedParameters.view(planned)
        products = flight_products(
            self._aircraft,
            FlightTerms.view(self._flat),
            orbit_axes(model.pattern.basis, model.pattern.phases),
            PlannedOrbit(*(getattr(parts, name)[:, 0] for name in PlannedOrbit._fields)),
            rest_length=model.cable_length,
            compliance=model.cable_compliance,
        )
        return flight_needs(self._aircraft, products)


def _height_of_carriers(task: Task) -> float:
    """How far above their load the carriers are in the mean, m, where it rests without sway."""
    model = task.flown
    weight = np.array([0, 0, 0, 0, 0, model.load_mass * model.gravity])
    forces = (model.pseudo_inverse @ weight + model.pattern.offset).reshape(-1, 3)
    return model.cable_length * float(np.mean(forces[:, 2] / np.linalg.norm(forces, axis=1)))
