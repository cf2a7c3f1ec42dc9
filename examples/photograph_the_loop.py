"""Photograph the loop: load, cables and carriers in a SceneGraph, seen by a camera of Drake's."""

import matplotlib.image
import numpy as np
from pydrake.geometry import (
    ClippingRange,
    DepthRange,
    DepthRenderCamera,
    MakeRenderEngineVtk,
    RenderCameraCore,
    RenderEngineVtkParams,
    SceneGraph,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.sensors import CameraInfo, RgbdSensor

from drake_nonstop import (
    AddGeometry,
    load_scenario,
    make_nonstop,
    set_equilibrium,
    with_largest_step,
)

EYE, TARGET = np.array([-1.0, -3.0, 2.0]), np.array([0.15, 0.1, 0.5])  # m, in W


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
    """Flies the quintic task for `duration` seconds and saves what the camera sees then."""
    scenario = load_scenario("quintic")
    builder = DiagramBuilder()
    loop = builder.AddSystem(make_nonstop(scenario))
    scene_graph = builder.AddSystem(SceneGraph())
    AddGeometry(builder, loop, scene_graph, scenario)
    camera = add_camera(builder, scene_graph)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    set_equilibrium(loop, loop.GetMyMutableContextFromRoot(context))
    config = with_largest_step(scenario.simulator_config, diagram, context)
    ApplySimulatorConfig(config, simulator)
    simulator.AdvanceTo(duration)
    image = camera.color_image_output_port().Eval(camera.GetMyContextFromRoot(context))
    matplotlib.image.imsave("loop.png", image.data)
    error = loop.GetOutputPort("tracking_error").Eval(loop.GetMyContextFromRoot(context))[3:6]
    print(f"load error  {1e3 * np.linalg.norm(error):.2f} mm, seen in loop.png")


if __name__ == "__main__":
    main()
