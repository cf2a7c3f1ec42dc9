"""A load of two bodies: a pendulum, a fifth of the mass, hangs below the platform.

The controllers know nothing of it. The run starts where the whole hangs at rest.
"""

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RevoluteJoint, RotationalInertia, SpatialInertia
from pydrake.systems.framework import Diagram, DiagramBuilder

from drake_nonstop import Model, PointForces, compute_metrics, load_scenario, simulate

LENGTH, DAMPING = 0.4, 0.005  # m and N m s, of the pendulum


def load(model: Model) -> Diagram:
    """The platform, whose state is `load_state`, and the pendulum, whose angle is a signal, too."""
    plant = MultibodyPlant(time_step=0.0)
    inertia = RotationalInertia(*np.diag(model.load.inertia))
    bob_mass = model.load_mass / 5
    inertia = SpatialInertia.MakeFromCentralInertia(model.load_mass - bob_mass, [0, 0, 0], inertia)
    platform = plant.AddRigidBody("platform", plant.AddModelInstance("platform"), inertia)
    inertia = SpatialInertia.SolidSphereWithMass(bob_mass, 0.05).Shift([0, 0, LENGTH])
    bob = plant.AddRigidBody("bob", plant.AddModelInstance("bob"), inertia)  # its origin: the hinge
    frames = platform.body_frame(), bob.body_frame()
    plant.AddJoint(RevoluteJoint("hinge", *frames, axis=[0, 1, 0], damping=DAMPING))
    plant.Finalize()

    builder = DiagramBuilder()
    builder.AddSystem(plant)
    forces = builder.AddSystem(PointForces([platform] * model.n, model.attachments))
    builder.Connect(forces.get_output_port(), plant.get_applied_spatial_force_input_port())
    builder.ExportInput(forces.get_input_port(), "cable_forces")
    for body, signal in ((platform, "load_state"), (bob, "pendulum_state")):
        builder.ExportOutput(plant.get_state_output_port(body.model_instance()), signal)
    return builder.Build()


def main(duration: float = 15.0) -> None:
    """Flies the quintic task with the pendulum below the load."""
    scenario = load_scenario("quintic", [f"simulation_duration={duration}"])
    run = simulate(scenario, load_plant=load)
    angle, _ = run.signal("pendulum_state").T
    error = 1e3 * compute_metrics(run)["load"]["position_error_mean_m"]
    print(f"mean load error    {error:.2f} mm")
    print(f"pendulum swings    up to {np.rad2deg(np.max(np.abs(angle))):.2f} degrees")


if __name__ == "__main__":
    main()
