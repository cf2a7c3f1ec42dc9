"""The motion of carriers above their load, along a plan or at rest, and what aircraft need."""

import functools
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.analysis.task import Task
from drake_nonstop.mechanics.aircraft import FlightNeeds, flown_aircraft
from drake_nonstop.mechanics.bowed_orbit import BowedMotion, CableShape, bowed_motion
from drake_nonstop.mechanics.cable import forces_under_other_wrench, wrenches_of
from drake_nonstop.mechanics.planned_orbit import (
    Directions,
    FlightTerms,
    OrbitMotion,
    PlannedOrbit,
    flight_along_reference,
    needs_of_motion,
    orbit_motion,
    pattern_directions,
    turned_motions,
    turning_terms,
)
from drake_nonstop.mechanics.rigid_load import STILL_AIR, RigidLoad
from drake_nonstop.mechanics.rotation import rotation_matrix
from drake_nonstop.mechanics.signals import LoadReference, Pose, resting_reference
from drake_nonstop.mechanics.wrench import feedforward_wrench
from drake_nonstop.model.system import Model


def orbit_terms(
    model: Model,
    references: Sequence[NDArray] | NDArray,
    winds: Sequence[NDArray] | NDArray,
    load: RigidLoad | None = None,
) -> FlightTerms:
    """Data of orbits besides the plan, at k references (22,) with their winds (3,).

    `load` is what moves so; None: that of the model.
    """
    rows = [
        flight_along_reference(
            load or model.load,
            reference,
            wind,
            pseudo_inverse=model.pseudo_inverse,
            offset=model.pattern.offset,
            attachments=model.attachments,
        )
        for reference, wind in zip(references, winds, strict=True)
    ]
    return FlightTerms.view(np.array(rows))


def directions_of(model: Model, angle: NDArray) -> Directions:
    """u, u′ and u″ (k, n, 3) of a model's pattern at phases (k,), rad."""
    pattern = model.pattern
    return pattern_directions(pattern.basis, pattern.phases, pattern.orders, angle)


def motion_above(model: Model, terms: FlightTerms, orbit: PlannedOrbit) -> OrbitMotion:
    """The motion of a model's carriers at k instants, with terms there or at one."""
    return orbit_motion(
        terms,
        directions_of(model, orbit.angle),
        orbit,
        rest_length=model.cable_length,
        compliance=model.cable_compliance,
    )


class CarriersAlong(NamedTuple):
    """Carriers that fly the orbits which the controllers believe in exactly, at k instants.

    Above its desired position the load is the believed one: a lighter load rises by what the cables
    stretch less, which is too little for a controller to notice. To the side the cables hardly hold
    it, and the controller comes to ask for what its drag needs. The cables hold the simulated load.
    """

    believed: Model
    plant: Model
    load: RigidLoad  # that moves so
    references: NDArray  # (k, 22), of the load
    load_winds: NDArray  # (k, 3), m/s, in W, at the load
    winds: NDArray  # (k, 3), m/s, in W, at the carriers' mean height
    shape: CableShape | None  # of bowed cables; None: the references' cables are straight
    terms: FlightTerms
    held: FlightTerms  # of the simulated load

    @classmethod
    def of(
        cls,
        believed: Model,
        plant: Model,
        references: NDArray,
        load_winds: NDArray,
        winds: NDArray,
        shape: CableShape | None,
        terms: Callable[[Model, RigidLoad], FlightTerms],
    ) -> "CarriersAlong":
        """Returns the carriers with the `terms` of a model, and of what moves so."""
        load = replace(believed.load, drag=plant.load.drag)
        flown = terms(believed, load)
        held = flown if believed is plant else terms(plant, plant.load)
        return cls(believed, plant, load, references, load_winds, winds, shape, flown, held)

    @property
    def orientations(self) -> NDArray:
        """The load's orientations (k, 3, 3)."""
        return rotation_matrix(LoadReference.view(self.references).quaternion)

    def motion(self, orbit: PlannedOrbit) -> OrbitMotion:
        """The carriers' motion, and the forces of the simulated cables."""
        motion, plant = motion_above(self.believed, self.terms, orbit), self.plant
        if self.believed is plant:
            return motion
        forces = forces_under_other_wrench(
            motion.forces,
            plant.attachments,
            wrenches_of(self.held.forces, plant.attachments),
            rest_length=plant.cable_length,
            stiffness=plant.cable_stiffness,
        )
        return motion._replace(forces=forces)

    def needs(self, motion: OrbitMotion, bowed: BowedMotion | None = None) -> FlightNeeds:
        """Needs of the simulated aircraft (k, n) for this motion, or for that on bowed cables."""
        assert self.plant.aircraft is not None
        aircraft = flown_aircraft(self.plant.aircraft, bears_cable_drag=bowed is None)
        motion = motion if bowed is None else bowed.motion
        return needs_of_motion(aircraft, motion, self.terms.up[:, None])

    def bowed(
        self, planned: NDArray, straight: OrbitMotion, winds: NDArray | None = None
    ) -> BowedMotion | None:
        """The carriers' motion where `BowedCarrierTrajectory` has them; None: cables are straight.

        Where the simulated cables pull with other forces at the load than those of the model,
        carriers pull with as much more.

        Args:
            planned: (k, 8), `PlannedParameters` at the instants.
            straight: their `motion`.
            winds: (k, n, 3), m/s, in W, at the carriers; None: those at their mean height.
        """
        if self.shape is None:
            return None
        R_WL = self.orientations
        # The terms' velocities are through the air at the mean height, or, in winds, in still air.
        frame, above = (self.winds, 0 * straight.forces) if winds is None else (0.0, winds @ R_WL)
        at_load = (self.load_winds - frame)[:, None] @ R_WL
        directions = functools.partial(directions_of, self.believed)
        found = bowed_motion(
            self.terms,
            directions,
            planned,
            self.shape,
            at_load,
            above - at_load,
            attachments=self.believed.attachments,
            offset=self.believed.pattern.offset,
        )
        motion = found.motion
        pulls = motion.forces - found.at_load + straight.forces
        velocities = motion.velocities - above
        return found._replace(motion=motion._replace(forces=pulls, velocities=velocities))


def carriers_along(task: Task, times: NDArray) -> CarriersAlong:
    """Returns a task's carriers at times (k,), s, in the mean wind at their mean height."""
    above = _height_of_carriers(task.carried)
    at_load, winds = (
        np.array([task.wind_at(time, height) for time in times]) for height in (0.0, above)
    )
    references = np.array([task.reference(time) for time in times])
    return CarriersAlong.of(
        task.carried,
        task.flown,
        references,
        at_load,
        winds,
        task.response.references.shape,
        lambda model, load: orbit_terms(model, references, winds, load),
    )


def resting_carriers(
    believed: Model,
    plant: Model,
    pose: NDArray,
    times: NDArray,
    *,
    yaw_rate: float,
    load_wind: NDArray,
    shape: CableShape | None = None,
) -> CarriersAlong:
    """Carriers above a load that rests, but for a steady turn about the vertical.

    With w the wind at the load, the cables hold it against its weight and the wind's drag,
    F = m g e₃ − B_L w, and turn it by the torque ω × J ω + C_L ω in L. Their velocities are those
    in still air. The pose (7,) is that in W at t = 0, the times (k,) are in s, the `yaw_rate` in
    rad/s, and the wind (3,) in m/s, in W. The `shape` is that of bowed cables.
    """
    rest = resting_reference()
    own = LoadReference.view(rest)
    own.quaternion[:], own.angular_velocity[2] = Pose.view(pose).quaternion, yaw_rate
    turn = np.full(len(times), yaw_rate), yaw_rate * times

    def terms(model: Model, load: RigidLoad) -> FlightTerms:
        return turning_terms(
            rest,
            *feedforward_wrench(load, rest, load_wind),
            STILL_AIR,
            *turn,
            pseudo_inverse=model.pseudo_inverse,
            offset=model.pattern.offset,
            attachments=model.attachments,
        )

    load_winds = np.tile(load_wind, (len(times), 1))
    turned = turned_motions(rest, *turn)
    return CarriersAlong.of(believed, plant, turned, load_winds, load_winds, shape, terms)


def _height_of_carriers(model: Model) -> float:
    """How far above their load the carriers are in the mean, m, where it rests without sway."""
    weight = np.array([0, 0, 0, 0, 0, model.load_mass * model.gravity])
    forces = (model.pseudo_inverse @ weight + model.pattern.offset).reshape(-1, 3)
    return model.cable_length * float(np.mean(forces[:, 2] / np.linalg.norm(forces, axis=1)))
