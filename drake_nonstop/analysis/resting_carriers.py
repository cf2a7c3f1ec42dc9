"""The motion of carriers above a load at rest, and what aircraft need."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.aircraft import FlightNeeds, flown_aircraft
from drake_nonstop.mechanics.bowed_orbit import BowedMotion, CableShape, bowed_motion
from drake_nonstop.mechanics.cable import forces_under_other_wrench, wrenches_of
from drake_nonstop.mechanics.planned_orbit import (
    FlightTerms,
    OrbitMotion,
    needs_of_motion,
    turning_terms,
)
from drake_nonstop.mechanics.rigid_load import RigidLoad
from drake_nonstop.mechanics.signals import (
    LoadReference,
    Pose,
    resting_reference,
)
from drake_nonstop.mechanics.wrench import feedforward_wrench
from drake_nonstop.model.system import Model
from drake_nonstop.planning.carriers import motion_above


class RestingCarriers(NamedTuple):
    """Carriers that fly the orbits which the controllers believe in exactly, at k instants.

    Above its desired position the load is the believed one: a lighter load rises by what the cables
    stretch less, which is too little for a controller to notice. To the side the cables hardly hold
    it, and the controller comes to ask for what its drag needs. The cables hold the simulated load.
    """

    believed: Model
    plant: Model
    wind: NDArray  # (3,), m/s, in W, at the load and at the carriers
    shape: CableShape | None  # of bowed cables; None: the references' cables are straight
    terms: FlightTerms
    held: FlightTerms  # of the simulated load

    def motion(self, planned: NDArray) -> OrbitMotion:
        """The carriers' motion along a plan (k, 8), and the forces of the simulated cables."""
        motion, plant = motion_above(self.believed, self.terms, planned), self.plant
        if self.believed is plant:
            return motion
        R_LW = self.held.motion.axes.coefficients[0]
        levers, held = (part @ R_LW for part in (plant.attachments, self.held.forces.rates[0]))
        forces = forces_under_other_wrench(
            motion.forces,
            levers,
            wrenches_of(held, levers),
            rest_length=plant.cable_length,
            stiffness=plant.cable_stiffness,
        )
        return motion._replace(forces=forces)

    def needs(self, motion: OrbitMotion, bowed: BowedMotion | None = None) -> FlightNeeds:
        """Needs of the simulated aircraft (k, n) for this motion, or for that on bowed cables."""
        assert self.plant.aircraft is not None
        aircraft = flown_aircraft(self.plant.aircraft, bears_cable_drag=bowed is None)
        motion = motion if bowed is None else bowed.motion
        return needs_of_motion(aircraft, motion, self.wind)

    def bowed(self, planned: NDArray, straight: OrbitMotion) -> BowedMotion | None:
        """The carriers' motion where `BowedCarrierTrajectory` has them; None: cables are straight.

        Where the simulated cables pull with other forces at the load than those of the model,
        carriers pull with as much more.

        Args:
            planned: (k, 8), `PlannedParameters` at the instants.
            straight: their `motion`.
        """
        if self.shape is None:
            return None
        found = bowed_motion(
            self.terms,
            self.believed.pattern.forces,
            planned,
            self.shape,
            self.wind,
            attachments=self.believed.attachments,
        )
        pulls = found.motion.forces - found.at_load + straight.forces
        return found._replace(motion=found.motion._replace(forces=pulls))


def resting_carriers(
    believed: Model,
    plant: Model,
    pose: NDArray,
    times: NDArray,
    *,
    yaw_rate: float,
    load_wind: NDArray,
    shape: CableShape | None = None,
) -> RestingCarriers:
    """Carriers above a load that rests, but for a steady turn about the vertical.

    With w the wind at the load, the cables hold it against its weight and the wind's drag,
    F = m g e₃ − B_L w, and turn it by the torque ω × J ω + C_L ω in L. The pose (7,) is that in W
    at t = 0, of which the attitude counts, the times (k,) are in s, the `yaw_rate` in rad/s, and
    the wind (3,) in m/s, in W. The `shape` is that of bowed cables.
    """
    rest = resting_reference()
    own = LoadReference.view(rest)
    own.quaternion[:], own.angular_velocity[2] = Pose.view(pose).quaternion, yaw_rate
    turn = np.full(len(times), yaw_rate), yaw_rate * times

    def terms(model: Model, load: RigidLoad) -> FlightTerms:
        return turning_terms(
            rest,
            *feedforward_wrench(load, rest, load_wind),
            *turn,
            pseudo_inverse=model.pseudo_inverse,
            offset=model.pattern.offset,
        )

    flown = terms(believed, replace(believed.load, drag=plant.load.drag))
    held = flown if believed is plant else terms(plant, plant.load)
    return RestingCarriers(believed, plant, load_wind, shape, flown, held)
