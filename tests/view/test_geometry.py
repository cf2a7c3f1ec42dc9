"""The loop's bodies in a SceneGraph, as Drake's own queries, cameras and viewers find them."""

import functools

import numpy as np
import pytest
from aircraft_runs import aircraft_run
from helpers import circling_run, irregular, rotation
from pydrake.geometry import Role, SceneGraph
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, PassThrough
from scenes import instant, shown

from drake_nonstop import AddGeometry, Scenario, ScenarioError, SystemParameters
from drake_nonstop.mechanics.signals import CarrierStates
from drake_nonstop.scenario.loading import load_scenario

CABLE = 0.8  # m
UPRIGHT = np.array([1.0, *np.zeros(12)])


def described(attachments):
    points = np.asarray(attachments).tolist()
    return Scenario(system=SystemParameters(attachments=points, cable_length=CABLE))


def ports(**values):
    """A system with output ports of these names and values."""
    builder = DiagramBuilder()
    for name, value in values.items():
        source = builder.AddSystem(ConstantVectorSource(value))
        builder.ExportOutput(source.get_output_port(), name)
    diagram = builder.Build()
    diagram.set_name("loop")
    return diagram


class Shown:
    """The geometry of a scenario whose loop has these signals."""

    def __init__(self, scenario, signals, **options):
        builder = DiagramBuilder()
        self.scene_graph = builder.AddSystem(SceneGraph())
        loop = builder.AddSystem(ports(**signals))
        self.geometry = AddGeometry(builder, loop, self.scene_graph, scenario, **options)
        self.diagram = builder.Build()
        context = self.diagram.CreateDefaultContext()
        own = self.scene_graph.GetMyContextFromRoot(context)
        self.query = self.scene_graph.get_query_output_port().Eval(own)

    def pose(self, frame):
        return self.query.GetPoseInWorld(frame)

    def pairs(self):
        """The names of the frames that collide, and how deep, in m."""
        inspector = self.scene_graph.model_inspector()
        return [
            (
                *(inspector.GetName(inspector.GetFrameId(k)) for k in (pair.id_A, pair.id_B)),
                pair.depth,
            )
            for pair in self.query.ComputePointPairPenetration()
        ]


def states(attachments, seed=0):
    """Random states of a load and of carriers at a cable's length from it."""
    rng = np.random.default_rng(seed)
    load = rng.normal(size=13)
    away = rng.normal(size=attachments.shape)
    away *= CABLE / np.linalg.norm(away, axis=1, keepdims=True)
    positions = attachments @ rotation(load[:4]).T + load[4:7] + away
    carriers = CarrierStates(positions, rng.normal(size=away.shape)).flat()
    return {"load_state": load, "carrier_state": carriers}


@pytest.mark.parametrize(
    "make_run",
    [
        functools.partial(circling_run, 3),
        functools.partial(circling_run, 7),
        functools.partial(aircraft_run, 0.1, wind=(3.0, -1.0, 0.5)),
    ],
)
def test_bodies_have_the_poses_that_their_scene_has(make_run):
    run = make_run()
    values = instant(run, 3)
    names = {"load_state", "carrier_state", "aircraft_state", "wind"} & values.keys()
    made = Shown(run.scenario, {name: values[name] for name in names})
    screen = shown(run.scenario, values)
    carriers = {f"carriers/{i}": each for i, each in enumerate(made.geometry.carrier_frames)}
    for name, frame in ({"load": made.geometry.load_frame} | carriers).items():
        expected = screen.matrices[f"/nonstop/{name}"]
        np.testing.assert_allclose(made.pose(frame).GetAsMatrix4(), expected, atol=1e-12)
    for i, halves in enumerate(made.geometry.cable_frames):
        start, end = screen.ends(f"/nonstop/cables/{i}")
        for half, (near, far) in zip(halves, ((start, end), (end, start)), strict=True):
            along = made.pose(half).rotation().matrix()[:, 2] * np.linalg.norm(far - near)
            np.testing.assert_allclose(made.pose(half).translation(), near, atol=1e-12)
            np.testing.assert_allclose(along, far - near, atol=1e-12)


def test_poses_are_of_floats_only():
    attachments = irregular(3)
    made = Shown(described(attachments), states(attachments))
    for converted in (made.diagram.ToAutoDiffXd(), made.diagram.ToSymbolic()):
        own = converted.GetSubsystemByName(made.geometry.get_name())
        context = own.GetMyContextFromRoot(converted.CreateDefaultContext())
        with pytest.raises(ScenarioError, match=r"^scalar type of loop_geometry = .*: it comp"):
            own.GetOutputPort("geometry_pose").Eval(context)


def test_only_bodies_that_meet_collide():
    attachments = 0.4 * irregular(4)
    above = attachments + np.array([0, 0, CABLE])

    def pairs():
        state = np.concatenate([above.ravel(), np.ones(12)])
        signals = {"load_state": UPRIGHT, "carrier_state": state}
        return Shown(described(attachments), signals).pairs()

    assert pairs() == []
    above[[0, 1]] = above[[1, 0]]  # cables 0 and 1 cross
    found = pairs()
    assert found
    assert all("cables::0" in a + b and "cables::1" in a + b for a, b, _ in found)
    above[1] = above[0] + [0.05, 0, 0]  # and carriers 0 and 1 meet
    (depth,) = (depth for a, b, depth in pairs() if "carriers" in a and "carriers" in b)
    radius = 0.1 * (CABLE + np.linalg.norm(attachments, axis=1).max())
    assert depth == pytest.approx(2 * radius - 0.05, abs=1e-12)


FRAMES = "".join(
    f'<frame name="f{k}" attached_to="crate"><pose>{point} 0 0 0</pose></frame>'
    for k, point in enumerate(["0.7 0.1 0.2", "-0.6 0.4 0.2", "-0.2 -0.7 0.1"])
)
SDF = f"""<sdf version="1.7"><model name="load"><link name="crate"><inertial><mass>1.2</mass>
<pose>0.1 0 0.05 0 0 0</pose>
<inertia><ixx>0.02</ixx><iyy>0.03</iyy><izz>0.04</izz></inertia></inertial>
<visual name="deck"><pose>0.1 0.2 0.3 0.1 0.2 0.3</pose>
<geometry><box><size>1 0.5 0.1</size></box></geometry></visual>
<collision name="hull"><pose>0 0 -0.1 0 0 0.4</pose>
<geometry><cylinder><radius>0.3</radius><length>0.2</length></cylinder></geometry></collision>
</link>{FRAMES}</model></sdf>"""


def shapes(query, scene_graph, frame, role):
    """The shapes of a frame, and their poses in W."""
    inspector = scene_graph.model_inspector()
    found = inspector.GetGeometries(frame, role)
    poses = [query.GetPoseInWorld(each).GetAsMatrix34() for each in found]
    return [str(inspector.GetShape(each)) for each in found], poses


def test_a_load_from_a_file_has_the_files_shapes_where_a_plant_has_them(tmp_path):
    path = tmp_path / "load.sdf"
    path.write_text(SDF)
    file = [f"system.load_file={path}", "system.attachment_frames=[f0, f1, f2]"]
    attachments = np.array(load_scenario("three_carriers", file).system.attachments)
    signals = states(attachments)
    made, load = Shown(described(attachments), signals, load_file=path), signals["load_state"]
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    Parser(plant).AddModels(str(path))
    plant.Finalize()
    context = builder.Build().CreateDefaultContext()
    crate, R_WL = plant.GetBodyByName("crate"), RotationMatrix(rotation(load[:4]))
    pose = RigidTransform(R_WL, load[4:7] - R_WL @ crate.default_com())
    plant.SetFreeBodyPose(plant.GetMyMutableContextFromRoot(context), crate, pose)
    query = scene_graph.get_query_output_port().Eval(scene_graph.GetMyContextFromRoot(context))
    frame = plant.GetBodyFrameIdOrThrow(crate.index())
    for role in (Role.kIllustration, Role.kPerception, Role.kProximity):
        kinds, poses = shapes(query, scene_graph, frame, role)
        own = shapes(made.query, made.scene_graph, made.geometry.load_frame, role)
        assert own[0] == kinds
        np.testing.assert_allclose(own[1], poses, atol=1e-12)
    other = attachments + 1e-4 * np.outer([0, 1, 0], [0, 0, 1])
    with pytest.raises(ScenarioError, match=r"^load_file = \S+: give the file .*attachment 2, "):
        Shown(described(other), signals, load_file=path)


def test_bad_input_is_told_in_a_sentence():
    scenario, signals = described(irregular(4)), {"load_state": UPRIGHT}
    signals["carrier_state"] = np.zeros(24)
    builder = DiagramBuilder()
    scene_graph = builder.AddSystem(SceneGraph())
    loop, other = builder.AddSystem(ports(**signals)), builder.AddSystem(PassThrough(3))

    def refused(field, value, remedy, **changed):
        given = {"loop": loop, "scene_graph": scene_graph, "scenario": scenario} | changed
        with pytest.raises(ScenarioError) as caught:
            AddGeometry(builder, **given)
        sentence = str(caught.value)
        assert sentence.startswith(f"{field} = {value}")
        assert remedy in sentence
        assert "\n" not in sentence

    refused("loop", "", "AddSystem", loop=ports(**signals))
    refused("scene_graph", "", "AddSystem", scene_graph=SceneGraph())
    refused("scene_graph", "", "give a SceneGraph", scene_graph=loop)
    refused("loop.load_state", "no such output port", "13 values", loop=other)
    refused("loop.carrier_state", "24 values", "18 values", scenario=described(irregular(3)))
    refused("system.attachments", "", "position", scenario=described([[1.0, 2.0]] * 4))
    AddGeometry(builder, loop, scene_graph, scenario)
    refused("loop", "loop", "name of its own")
    builder.Build()
    refused("builder", "built", "before builder.Build()")


@pytest.mark.parametrize(
    ("name", "value"), [("carrier_state", np.nan), ("carrier_state", np.inf), ("load_state", 0.0)]
)
def test_values_that_are_not_finite_are_not_shown(name, value):
    attachments = irregular(3)
    signals = states(attachments)
    signals[name] = np.full_like(signals[name], value)
    made = Shown(described(attachments), signals)
    with pytest.raises(ArithmeticError, match="loop_geometry was given"):
        made.pose(made.geometry.load_frame)
