"""Your own physics: load and carriers as free bodies of MultibodyPlants, continuous or discrete.

They have no equations, and the loop is flown by its diagram.
"""

from functools import partial

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RotationalInertia, SpatialInertia
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import MatrixGain

from drake_nonstop import Model, PointForces, compute_metrics, load_scenario, simulate


def load(model: Model, time_step: float) -> Diagram:
    """The load: a plant's state is in the order of `load_state`."""
    plant = MultibodyPlant(time_step)
    inertia = RotationalInertia(*np.diag(model.load.inertia))
    inertia = SpatialInertia.MakeFromCentralInertia(model.load_mass, np.zeros(3), inertia)
    forces = PointForces([plant.AddRigidBody("load", inertia)] * model.n, model.attachments)
    return block(plant, forces, "cable_forces", "load_state", np.eye(13))


def carriers(model: Model, time_step: float) -> Diagram:
    """The carriers, without weight as in the paper: all positions come before all velocities."""
    plant = MultibodyPlant(time_step)
    plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
    inertia, n = SpatialInertia.SolidSphereWithMass(model.carrier_mass, 0.05), model.n
    bodies = [plant.AddRigidBody(f"carrier_{i}", inertia) for i in range(n)]
    rows = [7 * i + k for i in range(n) for k in (4, 5, 6)]
    rows += [7 * n + 6 * i + k for i in range(n) for k in (3, 4, 5)]
    forces = PointForces(bodies, np.zeros((n, 3)))
    return block(plant, forces, "carrier_forces", "carrier_state", np.eye(13 * n)[rows])


def block(plant: MultibodyPlant, forces: PointForces, reads: str, makes: str, shown: np.ndarray):
    """A plant that the forces act on, with what is shown of its state, as a block of the loop."""
    plant.Finalize()
    builder = DiagramBuilder()
    state = MatrixGain(shown)
    [builder.AddSystem(system) for system in (plant, forces, state)]
    builder.Connect(forces.get_output_port(), plant.get_applied_spatial_force_input_port())
    builder.Connect(plant.get_state_output_port(), state.get_input_port())
    builder.ExportInput(forces.get_input_port(), reads)
    builder.ExportOutput(state.get_output_port(), makes)
    return builder.Build()


def main(duration: float = 15.0) -> None:
    """Flies the quintic task in both ways."""
    settings = [f"simulation_duration={duration}", "simulated.load_drag=0"]
    scenario = load_scenario("quintic", settings)
    for name, step in (("continuous", 0.0), ("discrete", 0.002)):
        plants = partial(load, time_step=step), partial(carriers, time_step=step)
        run = simulate(scenario, load_plant=plants[0], carrier_dynamics=plants[1])
        error = 1e3 * compute_metrics(run)["load"]["position_error_mean_m"]
        print(f"{name:10} mean load error {error:.3f} mm")


if __name__ == "__main__":
    main()
