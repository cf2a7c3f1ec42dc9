"""What the aircraft of a task need along a plan of ξ and A."""

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.analysis.aircraft_margins import asked_load
from drake_nonstop.analysis.orbit_terms import motion_above, orbit_terms
from drake_nonstop.analysis.task import Task
from drake_nonstop.mechanics.aircraft import FlightNeeds
from drake_nonstop.mechanics.cable import forces_under_other_wrench, wrenches_of
from drake_nonstop.mechanics.planned_orbit import OrbitMotion, PlannedOrbit, needs_of_motion
from drake_nonstop.model.system import Model


class NeedsAlong:
    """What the simulated aircraft of a task need on plans that they follow exactly.

    The carriers fly the orbits of the load that the controllers believe in, or, where they follow
    the measured one, of the simulated load; the cables hold the simulated one.

    Args:
        task: with aircraft.
        times: (k,), s, of the plans.
    """

    def __init__(self, task: Task, times: NDArray):
        assert task.flown.aircraft is not None
        self._aircraft, self._plant = task.flown.aircraft, task.flown
        self._believed = task.carried
        above = _height_of_carriers(self._believed)
        winds = [task.wind_at(time, above) for time in times]
        references = [task.reference(time) for time in times]
        load = asked_load(self._believed, self._plant)
        self._terms = orbit_terms(self._believed, references, winds, load)
        self._wrenches: NDArray | None = None
        if self._believed is not self._plant:
            held = orbit_terms(self._plant, references, winds).forces
            self._wrenches = wrenches_of(held, self._plant.attachments)

    def needs(self, planned: NDArray) -> FlightNeeds:
        """What they need, (k, n) each, of the plan's values (k, 8), in the mean wind up there."""
        return needs_of_motion(self._aircraft, self._motion(planned), self._terms.up[:, None])

    def cable_forces(self, planned: NDArray) -> NDArray:
        """The forces (k, n, 3) of the cables on the load, N, in L, of the plan's values (k, 8)."""
        return self._motion(planned).forces

    def _motion(self, planned: NDArray) -> OrbitMotion:
        """The carriers' motion, and the forces of the simulated cables."""
        motion = motion_above(self._believed, self._terms, PlannedOrbit.of_planned(planned))
        if self._wrenches is None:
            return motion
        forces = forces_under_other_wrench(
            motion.forces,
            self._plant.attachments,
            self._wrenches,
            rest_length=self._plant.cable_length,
            stiffness=self._plant.cable_stiffness,
        )
        return motion._replace(forces=forces)


def _height_of_carriers(model: Model) -> float:
    """How far above their load the carriers are in the mean, m, where it rests without sway."""
    weight = np.array([0, 0, 0, 0, 0, model.load_mass * model.gravity])
    forces = (model.pseudo_inverse @ weight + model.pattern.offset).reshape(-1, 3)
    return model.cable_length * float(np.mean(forces[:, 2] / np.linalg.norm(forces, axis=1)))
