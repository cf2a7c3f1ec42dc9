"""A plant of your own around the loop: a crate is set down on a table, with contact and a camera.

The crate is a body of the user's MultibodyPlant, which computes its contact with the table. The box
of the load is left out, so that the loop has an input port `load_state`; what it makes of it, the
cables' forces, acts on the crate. A camera sees the crate of the plant, and carriers and cables
that `AddGeometry` adds to the same SceneGraph.
"""

import itertools

import matplotlib.image
import numpy as np
from pydrake.geometry import (
    Box,
    ClippingRange,
    DepthRange,
    DepthRenderCamera,
    HalfSpace,
    MakeRenderEngineVtk,
    RenderCameraCore,
    RenderEngineVtkParams,
    SceneGraph,
    Sphere,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import RotationalInertia, SpatialInertia
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.sensors import CameraInfo, RgbdSensor

from drake_nonstop import (
    AddGeometry,
    LogSignals,
    Model,
    PointForces,
    Run,
    compute_metrics,
    load_scenario,
    make_nonstop,
    set_equilibrium,
    with_largest_step,
)

SIZE, FOOT = np.array([0.6, 0.6, 0.2]), 0.02  # m, of the crate and of its feet, which are spheres
DROP, TABLE = 0.3, 0.295  # m, that the reference goes down, and the table lets the crate go down
EYE, TARGET = np.array([-1.0, -3.0, 1.0]), np.array([0.0, 0.0, 0.2])  # m, in W


def add_crate(builder: DiagramBuilder, model: Model) -> tuple[MultibodyPlant, SceneGraph]:
    """The plant with the load of a model and a table, in steps of 2 ms; it may have more."""
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.002)
    moments = RotationalInertia(*np.diag(model.load.inertia))
    inertia = SpatialInertia.MakeFromCentralInertia(model.load_mass, np.zeros(3), moments)
    rough, world = CoulombFriction(0.5, 0.5), plant.world_body()
    table = RigidTransform([0, 0, -TABLE - SIZE[2] / 2])
    crate = plant.AddRigidBody("crate", inertia)
    plant.RegisterCollisionGeometry(world, table, HalfSpace(), "table", rough)
    for k, (x, y) in enumerate(itertools.product((-1, 1), (-1, 1))):
        foot = np.array([x, y, -1]) * SIZE / 2 + [0, 0, FOOT]
        plant.RegisterCollisionGeometry(crate, RigidTransform(foot), Sphere(FOOT), f"{k}", rough)
    top, below = Box(2.0, 2.0, 0.02), RigidTransform([0, 0, -0.01])
    plant.RegisterVisualGeometry(world, table @ below, top, "table", [0.6, 0.6, 0.6, 1.0])
    plant.RegisterVisualGeometry(crate, RigidTransform(), Box(*SIZE), "crate", [0.8, 0.5, 0.2, 1])
    plant.Finalize()
    return plant, scene_graph


def add_camera(builder: DiagramBuilder, scene_graph: SceneGraph) -> RgbdSensor:
    """A camera that stands at EYE and looks at TARGET."""
    background = RenderEngineVtkParams(default_clear_color=[0.97, 0.97, 0.98])
    scene_graph.AddRenderer("vtk", MakeRenderEngineVtk(background))
    size = CameraInfo(width=900, height=600, fov_y=np.radians(40))
    lens = RenderCameraCore("vtk", size, ClippingRange(0.1, 50.0), RigidTransform())
    ahead = (TARGET - EYE) / np.linalg.norm(TARGET - EYE)
    right = np.cross(ahead, [0, 0, 1]) / np.linalg.norm(np.cross(ahead, [0, 0, 1]))
    R_WB = RotationMatrix(np.column_stack([right, np.cross(ahead, right), ahead]))
    depth = DepthRenderCamera(lens, DepthRange(0.1, 40.0))
    camera = RgbdSensor(scene_graph.world_frame_id(), RigidTransform(R_WB, EYE), depth)
    builder.AddNamedSystem("camera", camera)
    builder.Connect(scene_graph.get_query_output_port(), camera.query_object_input_port())
    return camera


def main(duration: float = 4.0) -> None:
    """Sets the crate down and saves what the camera sees then."""
    down = f"load_trajectory=!RestToRest {{displacement: [0, 0, {-DROP}], start_time: 0.5}}"
    scenario = load_scenario("quintic", [down, "load_trajectory.move_time=2.5"])
    model = Model(scenario.system, scenario.pattern, scenario.control_period)
    builder = DiagramBuilder()
    plant, scene_graph = add_crate(builder, model)
    crate = plant.GetBodyByName("crate")
    forces = builder.AddSystem(PointForces([crate] * model.n, model.attachments))
    builder.Connect(forces.get_output_port(), plant.get_applied_spatial_force_input_port())

    loop = builder.AddSystem(make_nonstop(scenario, load_plant=None))
    builder.Connect(plant.get_state_output_port(), loop.GetInputPort("load_state"))
    builder.Connect(loop.GetOutputPort("cable_forces"), forces.get_input_port())
    AddGeometry(builder, loop, scene_graph, scenario, collides=False)
    logs = LogSignals.AddToBuilder(builder, loop)
    camera = add_camera(builder, scene_graph)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    set_equilibrium(diagram, context)  # of the whole diagram: the crate is not in the loop
    config = with_largest_step(scenario.simulator_config, diagram, context)
    ApplySimulatorConfig(config, simulator)
    simulator.AdvanceTo(duration)

    metrics = compute_metrics(Run.from_logs(logs, context, scenario))
    own = plant.GetMyContextFromRoot(context)
    contacts = plant.get_contact_results_output_port().Eval(own)
    pairs = range(contacts.num_point_pair_contacts())
    lift = sum(contacts.point_pair_contact_info(k).contact_force()[2] for k in pairs)
    image = camera.color_image_output_port().Eval(camera.GetMyContextFromRoot(context))
    matplotlib.image.imsave("table.png", image.data)
    print(f"largest load error  {1e3 * metrics['load']['position_error_max_m']:.1f} mm")
    print(f"crate at            {plant.GetPositions(own)[6]:.3f} m")
    print(f"the table carries   {abs(lift):.2f} N of {model.load_mass * 9.81:.2f} N")


if __name__ == "__main__":
    main()
