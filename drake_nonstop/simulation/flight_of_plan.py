"""What the aircraft of a task need on their way, along the plan that keeps the bound."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.aircraft import thrust_limits
from drake_nonstop.mechanics.cable import forces_under_other_wrench, wrenches_of
from drake_nonstop.mechanics.nonstop import orbit_axes
from drake_nonstop.mechanics.planned_flight import (
    FlightTerms,
    PlannedOrbit,
    flight_along_reference,
    flight_needs,
    flight_products,
    planned_cable_forces,
)
from drake_nonstop.mechanics.rigid_load import RigidLoad
from drake_nonstop.mechanics.signals import PLANNED_SIZE, PlannedParameters
from drake_nonstop.model.system import Model
from drake_nonstop.simulation.aircraft_margins import (
    AircraftNeeds,
    FlightLimits,
    FlightMargin,
    FlightRanges,
    asked_load,
    quantities_of_each,
)
from drake_nonstop.simulation.speed_check import SpeedCheck
from drake_nonstop.simulation.task import Task


class FlightOfPlan(NamedTuple):
    """The aircraft's margins along a plan, each where it is least."""

    margins: tuple[FlightMargin, ...]  # phases are the plan's θ, from 0 to 2π
    times: tuple[float, ...]  # s, of each
    ranges: FlightRanges  # of what they need, and what straight cables leave out

    @property
    def is_flyable(self) -> bool:
        """Whether all limits are kept."""
        return all(margin.is_kept for margin in self.margins)

    @property
    def verdict(self) -> str:
        """Whether the aircraft can fly the plan; if not, what is missed, and what to change."""
        if self.is_flyable:
            return "the aircraft can fly the way within all limits"
        missed = ", ".join(
            f"{margin.sentence} at t = {time:.1f} s, carrier {margin.carriers[0]}"
            for margin, time in zip(self.margins, self.times, strict=True)
            if not margin.is_kept
        )
        return (
            f"system.aircraft: they cannot fly the way within their limits: {missed}; give a "
            "slower motion, a reference_governor, or, where they are not given yet, the layer's "
            "max_lift_share, max_bank, max_climb and max_thrust_share"
        )

    @property
    def dictionary(self) -> dict[str, Any]:
        """The same for a JSON file; angles are in rad."""
        return {
            "verdict": self.verdict,
            "is_flyable": self.is_flyable,
            "margins": [
                margin.dictionary | {"time_s": time}
                for margin, time in zip(self.margins, self.times, strict=True)
            ],
            "ranges": self.ranges.dictionary,
        }


def _height_of_carriers(model: Model) -> float:
    """How far above their load the carriers are in the mean, m, where it rests without sway."""
    weight = np.array([0, 0, 0, 0, 0, model.load_mass * model.gravity])
    forces = (model.pseudo_inverse @ weight + model.pattern.offset).reshape(-1, 3)
    return model.cable_length * float(np.mean(forces[:, 2] / np.linalg.norm(forces, axis=1)))


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


def flight_of_plan(task: Task, speeds: SpeedCheck, limits: FlightLimits) -> FlightOfPlan | None:
    """The margins of a task's aircraft along its best plan, in the mean wind at their mean height.

    The aircraft follow the plan exactly, above the load that the controllers believe in, see
    `asked_load`, and hold the simulated one. None where there are no aircraft, the internal force
    has other harmonics than the first, or a layer without a speed bound changes ξ and A: there is
    no plan.

    Args:
        task: what is flown.
        speeds: with its best plan; without one ξ and A are the nominal ones.
        limits: what the needs are held against.
    """
    model, pattern, aircraft = task.flown, task.flown.pattern, task.flown.aircraft
    believed = model if task.is_above_load else task.model
    is_free = task.changes_parameters and task.limits.speed_bound == 0
    if aircraft is None or is_free or any(order != 1 for order in pattern.harmonics):
        return None
    times, plan = speeds.plan_times, speeds.plan
    above = _height_of_carriers(believed)
    winds = [task.wind_at(time, above) for time in times]
    terms = _terms_of(task, believed, asked_load(believed, model), times, winds)
    values = np.zeros((len(times), PLANNED_SIZE))
    parts = PlannedParameters.view(values)
    if plan is None:
        parts.frequency[:], parts.amplitude[:] = task.nominal
        parts.angle[:] = times[:, None] * task.limits.frequency
    else:
        values[:] = [plan.values(time) for time in times]
    orbit = PlannedOrbit(*(getattr(parts, name)[:, 0] for name in PlannedOrbit._fields))
    axes = orbit_axes(believed.pattern.basis, pattern.phases)
    forces = planned_cable_forces(terms, axes, orbit)
    if believed is not model:
        held = _terms_of(task, model, model.load, times, winds).forces
        forces = forces_under_other_wrench(
            forces,
            model.attachments,
            wrenches_of(held, model.attachments),
            rest_length=model.cable_length,
            stiffness=model.cable_stiffness,
        )
    products = flight_products(
        aircraft,
        terms,
        axes,
        orbit,
        rest_length=believed.cable_length,
        compliance=believed.cable_compliance,
        cable_forces=forces,
    )
    needed = flight_needs(aircraft, products)
    least, most = thrust_limits(aircraft, needed.airspeed)
    needs = AircraftNeeds(
        needed.airspeed, needed.lift, needed.bank, needed.climb, needed.thrust, least, most
    )
    quantities = [*quantities_of_each(aircraft, needs, limits)]
    return FlightOfPlan(
        tuple(quantity.worst(orbit.angle % (2 * math.pi)) for quantity in quantities),
        tuple(float(times[quantity.worst_place[0]]) for quantity in quantities),
        FlightRanges.of(aircraft, needs, forces, model.attachments),
    )
