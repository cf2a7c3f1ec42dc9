"""The loop's bodies in a SceneGraph, as Drake's own queries, cameras and viewers find them."""

import numpy as np
import pytest
from aircraft_runs import aircraft_run, instant_of
from helpers import irregular, rotation, spatial
from pydrake.geometry import (
    ClippingRange,
    ColorRenderCamera,
    DepthRange,
    DepthRenderCamera,
    MakeRenderEngineVtk,
    RenderCameraCore,
    RenderEngineVtkParams,
    Role,
    SceneGraph,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, PassThrough
from pydrake.systems.sensors import CameraInfo, RgbdSensor
from scenes import ListCanvas

from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.mechanics.signals import CarrierStates, Pose
from drake_nonstop.model.load_file import read_load
from drake_nonstop.model.system import SystemParameters
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.systems.tracing import NotFiniteError
from drake_nonstop.validation import ScenarioError
from drake_nonstop.view.geometry import AddGeometry, NonstopGeometry
from drake_nonstop.view.scene import Scene

CABLE = 0.8  # m
UPRIGHT = np.array([1.0, *np.zeros(12)])


def described(attachments):
    return Scenario(
        system=SystemParameters(attachments=np.asarray(attachments).tolist(), cable_length=CABLE)
    )


def states(attachments, seed=0, stretch=1.0):
    """Random states of a load and of carriers at that many cable lengths from it."""
    rng = np.random.default_rng(seed)
    load = rng.normal(size=13)
    p_WA = attachments @ rotation(load[:4]).T + load[4:7]
    away = rng.normal(size=p_WA.shape)
    away *= stretch * CABLE / np.linalg.norm(away, axis=1, keepdims=True)
    return load, CarrierStates(p_WA + away, rng.normal(size=p_WA.shape)).flat()


class Loop:
    """Something with the ports of a loop that holds any values, in a diagram with its geometry."""

    def __init__(self, attachments, names=("loop",), add_viewer=None, **options):
        builder = DiagramBuilder()
        self.scene_graph = builder.AddSystem(SceneGraph())
        self.geometries, self._sources = [], []
        for name in names:
            inner = DiagramBuilder()
            sources = [
                inner.AddSystem(ConstantVectorSource(value))
                for value in (UPRIGHT, np.zeros(6 * len(attachments)))
            ]
            for source, port in zip(sources, ("load_state", "carrier_state"), strict=True):
                inner.ExportOutput(source.get_output_port(), port)
            loop = builder.AddNamedSystem(name, inner.Build())
            self._sources.append(sources)
            self.geometries.append(
                AddGeometry(builder, loop, self.scene_graph, described(attachments), **options)
            )
        self.seen_by = add_viewer(builder, self.scene_graph) if add_viewer else None
        self.diagram = builder.Build()
        self.context = self.diagram.CreateDefaultContext()

    @property
    def geometry(self):
        return self.geometries[0]

    def set(self, load_state, carrier_state, which=0):
        for source, value in zip(self._sources[which], (load_state, carrier_state), strict=True):
            context = source.GetMyMutableContextFromRoot(self.context)
            source.get_mutable_source_value(context).set_value(value)

    def query(self):
        port = self.scene_graph.get_query_output_port()
        return port.Eval(self.scene_graph.GetMyContextFromRoot(self.context))

    def pose(self, frame):
        return self.query().GetPoseInWorld(frame)

    def solid(self, frame):
        """The only shape of the frame that collides."""
        inspector = self.scene_graph.model_inspector()
        (found,) = inspector.GetGeometries(frame, Role.kProximity)
        return found


@pytest.mark.nightly("engines")
@pytest.mark.parametrize("scalar", ["AutoDiffXd", "Expression"])
def test_a_diagram_with_geometry_converts_and_has_poses_of_floats_only(scalar):
    loop = Loop(irregular(4), names=("one", "two"))
    load, carriers = states(irregular(4))
    loop.set(load, carriers, which=1)
    expected = loop.pose(loop.geometries[1].load_frame)
    other = loop.diagram.ToAutoDiffXd() if scalar == "AutoDiffXd" else loop.diagram.ToSymbolic()
    geometry = other.GetSubsystemByName("two_geometry")
    context = geometry.GetMyContextFromRoot(other.CreateDefaultContext())
    with pytest.raises(ScenarioError) as error:
        geometry.GetOutputPort("geometry_pose").Eval(context)
    assert str(error.value) == (
        f"scalar type of two_geometry = {scalar}: it computes with floating-point numbers only; "
        "look at the scene in a context of the diagram that was converted"
    )
    loop.diagram = loop.diagram.Clone()
    loop.scene_graph = next(s for s in loop.diagram.GetSystems() if type(s) is SceneGraph)
    root = loop.diagram.CreateDefaultContext()
    root.SetTimeStateAndParametersFrom(loop.context)
    loop.context = root
    assert loop.pose(loop.geometries[1].load_frame).IsExactlyEqualTo(expected)


def add_camera(builder, scene_graph):
    """Looks at the origin from 4 m above it."""
    scene_graph.AddRenderer("vtk", MakeRenderEngineVtk(RenderEngineVtkParams()))
    core = RenderCameraCore(
        "vtk", CameraInfo(300, 300, np.radians(60)), ClippingRange(0.1, 20.0), RigidTransform()
    )
    camera = RgbdSensor(
        scene_graph.world_frame_id(),
        RigidTransform(RotationMatrix.MakeXRotation(np.pi), [0.0, 0.0, 4.0]),
        ColorRenderCamera(core),
        DepthRenderCamera(core, DepthRange(0.1, 10.0)),
    )
    builder.AddSystem(camera)
    builder.Connect(scene_graph.get_query_output_port(), camera.query_object_input_port())
    return camera


@pytest.mark.parametrize("attachments", [irregular(3), spatial(7)])
def test_poses_are_those_of_the_states(attachments):
    made = Loop(attachments)
    for seed in range(5):
        load, carriers = states(attachments, seed)
        made.set(load, carriers)
        pose, parts = Pose.view(load), CarrierStates.view(carriers)
        X_WL = RigidTransform(RotationMatrix(rotation(pose.quaternion)), pose.position)
        assert made.pose(made.geometry.load_frame).IsNearlyEqualTo(X_WL, 1e-12)
        for i, frame in enumerate(made.geometry.carrier_frames):
            carrier, start, end = made.pose(frame), X_WL @ attachments[i], parts.positions[i]
            np.testing.assert_allclose(carrier.translation(), end, atol=1e-12)
            nose, _, top = carrier.rotation().matrix().T
            speed = np.linalg.norm(parts.velocities[i])
            np.testing.assert_allclose(speed * nose, parts.velocities[i], atol=1e-12)
            assert top @ (end - start) > 0
            for half, (near, far) in zip(
                made.geometry.cable_frames[i], ((start, end), (end, start)), strict=True
            ):
                along = made.pose(half).rotation().matrix()[:, 2] * np.linalg.norm(far - near)
                np.testing.assert_allclose(made.pose(half).translation(), near, atol=1e-12)
                np.testing.assert_allclose(along, far - near, atol=1e-12)


@pytest.mark.parametrize("stretch", [0.65, 1.0, 1.15])
def test_a_cable_is_whole_from_its_attachment_to_its_carrier(stretch):
    attachments = spatial(4)
    made = Loop(attachments)
    load, carriers = states(attachments, seed=1, stretch=stretch)
    made.set(load, carriers)
    lower, upper = made.geometry.cable_frames[2]
    start, end = made.pose(lower).translation(), made.pose(upper).translation()
    assert np.linalg.norm(end - start) == pytest.approx(stretch * CABLE)
    ids = {made.solid(lower), made.solid(upper)}
    for share in (-0.02, 0.0, 0.25, 0.5, 0.75, 1.0, 1.02):
        found = made.query().ComputeSignedDistanceToPoint(start + share * (end - start))
        distance = min(each.distance for each in found if each.id_G in ids)
        if 0 <= share <= 1:
            assert distance < 1e-9
        else:
            assert distance == pytest.approx(0.02 * stretch * CABLE, abs=1e-9)


def test_only_bodies_that_meet_collide():
    attachments = 0.4 * irregular(4)
    made = Loop(attachments)
    above = attachments + np.array([0, 0, CABLE])
    made.set(UPRIGHT, [*above.ravel(), *np.ones(12)])
    assert made.query().ComputePointPairPenetration() == []
    above[[0, 1]] = above[[1, 0]]  # cables 0 and 1 cross
    made.set(UPRIGHT, [*above.ravel(), *np.ones(12)])
    inspector = made.scene_graph.model_inspector()
    names = [
        {inspector.GetName(inspector.GetFrameId(each)) for each in (pair.id_A, pair.id_B)}
        for pair in made.query().ComputePointPairPenetration()
    ]
    assert names
    assert all(any("cables::0" in name for name in pair) for pair in names)
    assert all(any("cables::1" in name for name in pair) for pair in names)
    above[1] = above[0] + [0.05, 0, 0]  # and carriers 0 and 1 meet
    made.set(UPRIGHT, [*above.ravel(), *np.ones(12)])
    ids = {made.solid(frame) for frame in made.geometry.carrier_frames[:2]}
    radius = 0.1 * (CABLE + np.linalg.norm(attachments, axis=1).max())
    (depth,) = [
        pair.depth
        for pair in made.query().ComputePointPairPenetration()
        if {pair.id_A, pair.id_B} == ids
    ]
    assert depth == pytest.approx(2 * radius - 0.05, abs=1e-12)


@pytest.mark.nightly("flights")
def test_a_camera_sees_load_cables_and_carriers_by_labels_of_their_own():
    attachments = irregular(3)
    made = Loop(attachments, add_viewer=add_camera)
    outside = 1.6 * attachments + [0, 0, 0.5]
    made.set(UPRIGHT, [*outside.ravel(), *np.ones(9)])
    context = made.seen_by.GetMyContextFromRoot(made.context)
    seen = set(made.seen_by.label_image_output_port().Eval(context).data.ravel().tolist())
    inspector = made.scene_graph.model_inspector()
    labels = [
        {
            int(inspector.GetPerceptionProperties(each).GetProperty("label", "id"))
            for each in inspector.GetGeometries(frame, Role.kPerception)
        }
        for frame in inspector.FramesForSource(made.geometry.source)
    ]
    assert all(len(each) == 1 for each in labels)
    different = set.union(*labels)
    assert len(different) == 1 + 3 + 3
    assert different <= seen
    picture = made.seen_by.color_image_output_port().Eval(context).data
    depth = made.seen_by.depth_image_32F_output_port().Eval(context).data
    assert len(np.unique(picture.reshape(-1, 4), axis=0)) > 10
    # The wing of a carrier that flies level at 0.5 m is 3.5 m below the camera.
    assert np.isclose(depth, 3.5, atol=0.1).sum() > 20


def test_the_loop_of_a_scenario_is_seen_as_it_flies():
    scenario = load_scenario("three_carriers")
    builder = DiagramBuilder()
    loop = builder.AddSystem(make_nonstop(scenario))
    scene_graph = builder.AddSystem(SceneGraph())
    geometry = AddGeometry(builder, loop, scene_graph, scenario)
    simulator = Simulator(builder.Build())
    context = simulator.get_mutable_context()
    rng = np.random.default_rng(0)
    inside = loop.GetMyMutableContextFromRoot(context)
    for _ in range(3):
        state = inside.get_mutable_continuous_state_vector()
        state.SetFromVector(rng.normal(size=state.size()))
        query = scene_graph.get_query_output_port().Eval(scene_graph.GetMyContextFromRoot(context))
        positions = [query.GetPoseInWorld(frame) for frame in geometry.carrier_frames]
        carriers = CarrierStates.view(loop.GetOutputPort("carrier_state").Eval(inside))
        np.testing.assert_allclose([each.translation() for each in positions], carriers.positions)
        load = Pose.view(loop.GetOutputPort("load_state").Eval(inside))
        found = query.GetPoseInWorld(geometry.load_frame).translation()
        np.testing.assert_allclose(found, load.position)


SHAPES = """<visual name="deck"><pose>0.1 0.2 0.3 0.1 0.2 0.3</pose>
<geometry><box><size>1 0.5 0.1</size></box></geometry></visual>
<collision name="hull"><pose>0 0 -0.1 0 0 0.4</pose>
<geometry><cylinder><radius>0.3</radius><length>0.2</length></cylinder></geometry></collision>"""


def sdf(shapes=SHAPES):
    corners = [(0.7, 0.1, 0.2), (-0.6, 0.4, 0.2), (-0.2, -0.7, 0.1)]
    frames = "".join(
        f'<frame name="f{k}" attached_to="crate"><pose>{x} {y} {z} 0 0 0</pose></frame>'
        for k, (x, y, z) in enumerate(corners)
    )
    inertia = "<inertia><ixx>0.02</ixx><iyy>0.03</iyy><izz>0.04</izz></inertia>"
    return f"""<sdf version="1.7"><model name="load"><link name="crate">
    <inertial><mass>1.2</mass><pose>0.1 0 0.05 0 0 0</pose>{inertia}</inertial>{shapes}</link>
    <link name="mast"><pose>0 0 0.5 0.3 0 0</pose><inertial><mass>0.3</mass>{inertia}</inertial>
    {shapes.replace("<box><size>1 0.5 0.1</size></box>", "<sphere><radius>0.1</radius></sphere>")}
    </link><joint name="weld" type="fixed"><parent>crate</parent><child>mast</child></joint>
    {frames}</model></sdf>"""


def test_a_load_from_a_file_has_the_files_shapes_where_a_plant_has_them(tmp_path):
    path = tmp_path / "load.sdf"
    path.write_text(sdf())
    attachments = np.array(read_load(path, ["f0", "f1", "f2"])["attachments"])
    made = Loop(attachments, load_file=path)
    load, carriers = states(attachments)
    made.set(load, carriers)

    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    (model,) = Parser(plant).AddModels(str(path))
    plant.Finalize()
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    crate = plant.GetBodyByName("crate")
    X_WL = RigidTransform(RotationMatrix(rotation(load[:4])), load[4:7])
    inside = plant.GetMyMutableContextFromRoot(context)
    plant.SetFreeBodyPose(inside, crate, RigidTransform(X_WL.rotation()))
    p_BC_W = plant.CalcCenterOfMassPositionInWorld(inside, [model])
    plant.SetFreeBodyPose(inside, crate, RigidTransform(X_WL.rotation(), load[4:7] - p_BC_W))
    query = scene_graph.get_query_output_port().Eval(scene_graph.GetMyContextFromRoot(context))

    def found(query, inspector, frames, role):
        shapes = [
            (str(inspector.GetShape(each)), query.GetPoseInWorld(each).GetAsMatrix34().tolist())
            for frame in frames
            for each in inspector.GetGeometries(frame, role)
        ]
        return zip(*sorted(shapes), strict=True)

    frames = [plant.GetBodyFrameIdOrThrow(each) for each in plant.GetBodyIndices(model)]
    for role in (Role.kIllustration, Role.kPerception, Role.kProximity):
        kinds, poses = found(query, scene_graph.model_inspector(), frames, role)
        inspector = made.scene_graph.model_inspector()
        our_kinds, our_poses = found(made.query(), inspector, [made.geometry.load_frame], role)
        assert len(kinds) == 2
        assert our_kinds == kinds
        np.testing.assert_allclose(our_poses, poses, atol=1e-12)


def test_a_file_of_another_load_is_refused(tmp_path):
    path = tmp_path / "load.sdf"
    path.write_text(sdf())
    attachments = np.array(read_load(path, ["f0", "f1", "f2"])["attachments"])
    moved = attachments + 1e-4 * np.outer([0, 1, 0], [0, 0, 1])
    with pytest.raises(ScenarioError, match=r"^load_file = \S+: give the file .*attachment 2, "):
        Loop(moved, load_file=path)
    with pytest.raises(ScenarioError, match=r"^load_file = none\.sdf: "):
        Loop(attachments, load_file="none.sdf")
    path.write_text(sdf(shapes=""))
    with pytest.raises(ScenarioError, match=r"^load_file = \S+: give a file with <visual>"):
        Loop(attachments, load_file=path)


def _ports(**values):
    builder = DiagramBuilder()
    for name, value in values.items():
        source = builder.AddSystem(ConstantVectorSource(value))
        builder.ExportOutput(source.get_output_port(), name)
    diagram = builder.Build()
    diagram.set_name("ports")
    return diagram


def test_bad_input_is_told_in_a_sentence():
    scenario = described(irregular(4))
    carriers = np.zeros(24)
    builder = DiagramBuilder()
    scene_graph = builder.AddSystem(SceneGraph())
    loop = builder.AddSystem(_ports(load_state=UPRIGHT, carrier_state=carriers))

    def refused(words, *, loop=loop, scene_graph=scene_graph, scenario=scenario, **options):
        with pytest.raises(ScenarioError) as caught:
            AddGeometry(builder, loop, scene_graph, scenario, **options)
        assert words in str(caught.value)
        assert "\n" not in str(caught.value)

    elsewhere = _ports(load_state=UPRIGHT, carrier_state=carriers)
    refused("that builder.AddSystem was given before", loop=elsewhere)
    refused("scene_graph = ", scene_graph=SceneGraph())
    refused("give a SceneGraph", scene_graph=loop)
    other = builder.AddSystem(PassThrough(3))
    refused("loop.load_state = no such output port: give a loop with 13 values", loop=other)
    refused("loop.carrier_state = 24 values: ", scenario=described(irregular(3)))
    refused("scenario = {}: give a Scenario", scenario={})
    refused("load_file = [0. 0.]: give the path of an SDF", load_file=np.zeros(2))
    refused("system.attachments = ", scenario=described([[1.0, 2.0]] * 4))
    AddGeometry(builder, loop, scene_graph, scenario)
    refused("loop = ports: add the geometry of a loop once")
    builder.Build()
    refused("builder = built: call AddGeometry before builder.Build()")


def test_values_that_are_not_finite_are_not_shown():
    attachments = irregular(3)
    made = Loop(attachments)
    load, carriers = states(attachments)
    for broken in (np.nan, np.inf):
        made.set(load, [broken, *carriers[1:]])
        with pytest.raises(NotFiniteError, match="loop_geometry was given"):
            made.query().GetPoseInWorld(made.geometry.load_frame)
    made.set(np.zeros(13), carriers)
    with pytest.raises(NotFiniteError):
        made.query().GetPoseInWorld(made.geometry.load_frame)


def test_aircraft_have_the_attitude_that_their_scene_has():
    run = aircraft_run(0.1, wind=(3.0, -1.0, 0.5))
    instant, canvas = instant_of(run, 3), ListCanvas()
    Scene(run.scenario.system).show(canvas, instant)
    names = NonstopGeometry.reads
    builder = DiagramBuilder()
    loop = builder.AddSystem(_ports(**{name: run.signal(name)[3] for name in names}))
    scene_graph = builder.AddSystem(SceneGraph())
    geometry = AddGeometry(builder, loop, scene_graph, run.scenario)
    context = builder.Build().CreateDefaultContext()
    port = geometry.GetOutputPort("geometry_pose")
    poses = port.Eval(geometry.GetMyContextFromRoot(context))
    for i, frame in enumerate(geometry.carrier_frames):
        expected = canvas.poses[f"/carriers/{i}"][0]
        assert poses.value(frame).IsNearlyEqualTo(expected, 1e-12)
