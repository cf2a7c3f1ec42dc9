"""The loop's bodies as geometry of a SceneGraph: for cameras, proximity queries and viewers."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import AbstractValue
from pydrake.geometry import (
    CollisionFilterDeclaration,
    Cylinder,
    FrameId,
    FramePoseVector_,
    GeometryFrame,
    GeometryInstance,
    GeometrySet,
    MakePhongIllustrationProperties,
    PerceptionProperties,
    ProximityProperties,
    Rgba,
    Role,
    SceneGraph,
    SourceId,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, DiagramBuilder, System

from drake_nonstop.mechanics.aircraft import Aircraft
from drake_nonstop.mechanics.rotation import rotation_matrix
from drake_nonstop.mechanics.signals import CarrierStates, Pose
from drake_nonstop.model.load_file import read_load_shapes
from drake_nonstop.model.system import aircraft_in, overridden
from drake_nonstop.scenario.schema import Scenario, check
from drake_nonstop.systems.block import LeafBlock
from drake_nonstop.systems.tracing import NotFiniteError
from drake_nonstop.systems.wiring import output_sizes, require_open
from drake_nonstop.validation import require, require_array
from drake_nonstop.view.bodies import (
    LOAD_COLOUR,
    Part,
    Sizes,
    carrier_colour,
    carrier_parts,
    carrier_rotations,
    cylinder_poses,
    load_parts,
    rgb,
    signal_sizes,
    stack_poses,
)

_CABLE_COLOUR = "#5270a0"
_HALF_CABLE = 0.6  # of the unstretched length; the two halves of a cable overlap


class NonstopGeometry(LeafBlock):
    """The poses of a loop's bodies in a SceneGraph, of the states that the loop tells.

    `AddGeometry` registers the bodies and adds this block. Converted to AutoDiffXd or Expression it
    makes no poses: to ask for them raises ScenarioError. `geometry_pose` is a FramePoseVector, for
    the SceneGraph's pose port of `source`.

    Attributes:
        source: the SourceId of the geometry.
        load_frame: the FrameId of the load's frame L.
        carrier_frames: those of the n carriers, nose along x.
        cable_frames: those of the n cables' halves, in pairs: at the attachment and at the
            carrier, with z towards the other end.
    """

    reads = "load_state", "carrier_state", "aircraft_state", "wind"
    optional_inputs = reads[2:]
    makes = ("geometry_pose",)

    def __init__(
        self,
        attachments: NDArray,
        aircraft: Aircraft | None,
        source: SourceId,
        load_frame: FrameId,
        carrier_frames: list[FrameId],
        cable_frames: list[tuple[FrameId, FrameId]],
    ):
        super().__init__()
        self.source, self.load_frame = source, load_frame
        self.carrier_frames, self.cable_frames = carrier_frames, cable_frames
        self._attachments, self._aircraft = attachments, aircraft
        lower_halves, upper_halves = zip(*cable_frames, strict=True)
        self._frames = [load_frame, *carrier_frames, *lower_halves, *upper_halves]
        sizes = signal_sizes(self.reads, len(attachments))
        self._inputs = [self.DeclareVectorInputPort(name, size) for name, size in sizes.items()]
        make = FramePoseVector_[self.scalar]
        self.DeclareAbstractOutputPort(
            "geometry_pose",
            lambda: AbstractValue.Make(make()),
            self._calc_poses,
            {self.all_input_ports_ticket()},
        )

    def _calc_poses(self, context: Context, output: AbstractValue) -> None:
        self.require_floats("look at the scene in a context of the diagram that was converted")
        optional = self._inputs[2:] if self._aircraft is not None else []
        ports = [*self._inputs[:2], *(port for port in optional if port.HasValue(context))]
        given = {port.get_name(): port.Eval(context) for port in ports}
        load = Pose.view(given.pop("load_state"))
        carriers = CarrierStates.view(given.pop("carrier_state"))
        is_finite = all(np.isfinite(part).all() for part in (*load, *carriers, *given.values()))
        if not (is_finite and load.quaternion.any()):
            raise NotFiniteError(self.box(), was_given=True)
        X_WL = stack_poses(rotation_matrix(load.quaternion), load.position[None])
        p_WA = self._attachments @ X_WL[0, :3, :3].T + load.position
        p_WC = carriers.positions
        rotations = carrier_rotations(
            carriers.velocities, p_WC - p_WA, aircraft=self._aircraft, **given
        )
        starts, ends = np.vstack([p_WA, p_WC]), np.vstack([p_WC, p_WA])
        halves, _ = cylinder_poses(starts, ends)
        halves[:, :3, 3] = starts
        poses = [*X_WL, *stack_poses(rotations, p_WC), *halves]
        vector = output.get_mutable_value()
        for frame, pose in zip(self._frames, poses, strict=True):
            vector.set_value(frame, RigidTransform(pose))


def AddGeometry(  # noqa: N802
    builder: DiagramBuilder,
    loop: System,
    scene_graph: SceneGraph,
    scenario: Scenario,
    *,
    load_file: str | Path = "",
    collides: bool = True,
) -> NonstopGeometry:
    """Adds the bodies of a loop to a SceneGraph, where cameras, queries and viewers see them.

    Any number of loops may be in one SceneGraph, beside the user's own plants. Each body has the
    roles illustration, perception and proximity.

    - The load has the shapes of its file, or is a frame of bars around its attachments.
    - A carrier is an aircraft along its velocity (along x of W where it has none), with its top
      away from the cable. For proximity it is a sphere with the wing span as diameter. Where the
      system has aircraft, they fly along the air that they meet, with bank and angle of attack.
    - A cable is straight, slack or not. Geometry is rigid: two cylinders of 0.6 unstretched
      lengths, one from the attachment and one from the carrier, slide over each other. Where the
      ends are more than 1.2 lengths apart there is a gap between the two; where they are less
      than 0.6 apart, each goes beyond the other end.

    Cables do not collide with themselves, with the load, or with the carriers at their ends.

    Args:
        builder: has the loop and the SceneGraph already, and is not built yet.
        loop: a diagram, as `make_nonstop` builds it, or any system with the output ports
            `load_state` (13) and `carrier_state` (6n); of aircraft also `aircraft_state` (4n) and
            `wind` (3n). Its name is that of the geometry's source.
        scene_graph: the SceneGraph.
        scenario: has the system, and the fields that are simulated otherwise.
        load_file: an SDF or URDF file with the load's shapes, such as `system.load_file`; without
            it the load is drawn as bars.
        collides: whether the bodies have the role proximity. A MultibodyPlant in the SceneGraph
            refuses contact with bodies that are not its own.

    Returns:
        The system that makes the poses, with the frames of the bodies.

    Raises:
        ScenarioError: the loop or the SceneGraph is not in the builder, the builder is built, the
            loop has no such ports, the scenario cannot be used, the SceneGraph has a source of
            that name, or the file cannot be read, has no shapes or is of another load.
    """
    check(scenario)
    require_open(builder, "AddGeometry")
    for field, system, kind in (("loop", loop, System), ("scene_graph", scene_graph, SceneGraph)):
        is_there = any(system is present for present in builder.GetSystems())
        remedy = f"give a {kind.__name__} that builder.AddSystem was given before"
        require(isinstance(system, kind) and is_there, field, system, remedy)
    n, sizes = len(overridden(scenario.system, scenario.simulated).attachments), output_sizes(loop)
    optional = NonstopGeometry.optional_inputs
    ports = [port for port in NonstopGeometry.reads if port not in optional or port in sizes]
    for port, size in signal_sizes(ports, n).items():
        has = f"{sizes[port]} values" if port in sizes else "no such output port"
        remedy = f"give a loop with {size} values there, for the scenario's {n} attachments"
        require(sizes.get(port) == size, f"loop.{port}", has, remedy)
    name = loop.get_name()
    geometry = _registered(scene_graph, scenario, name, load_file)
    for frame in () if collides else scene_graph.model_inspector().FramesForSource(geometry.source):
        scene_graph.RemoveRole(geometry.source, frame, Role.kProximity)
    builder.AddNamedSystem(f"{name}_geometry", geometry)
    for port in ports:
        builder.Connect(loop.GetOutputPort(port), geometry.GetInputPort(port))
    builder.Connect(
        geometry.GetOutputPort("geometry_pose"), scene_graph.get_source_pose_port(geometry.source)
    )
    return geometry


def _registered(
    scene_graph: SceneGraph, scenario: Scenario, name: str, load_file: str | Path
) -> NonstopGeometry:
    """The block of geometry that is registered as that of a source of this name."""
    remedy = "give the path of an SDF or URDF file"
    require(isinstance(load_file, (str, Path)), "load_file", load_file, remedy)
    system = overridden(scenario.system, scenario.simulated)
    attachments = require_array(
        "system.attachments", system.attachments, [None, 3], "one position per cable"
    )
    sizes = Sizes.of(system, scenario.scene)
    load_shapes = read_load_shapes(load_file, attachments) if load_file else []
    inspector = scene_graph.model_inspector()
    sources = [inspector.GetName(source) for source in inspector.GetAllSourceIds()]
    remedy = "add the geometry of a loop once, and give each loop a name of its own"
    require(name not in sources, "loop", name, remedy)
    source = scene_graph.RegisterSource(name)

    def add(body: str, shapes: list[GeometryInstance]) -> FrameId:
        # Drake's MeshcatVisualizer does not tell frames of one name but two sources apart.
        frame = scene_graph.RegisterFrame(source, GeometryFrame(f"{name}::{body}"))
        for shape in shapes:
            scene_graph.RegisterGeometry(source, frame, shape)
        return frame

    bars = load_parts(attachments, sizes.bar)
    load = load_shapes or [_instance(bar, LOAD_COLOUR, is_solid=True) for bar in bars]
    load_frame = add("load", load)
    carrier_frames: list[FrameId] = []
    cable_frames: list[tuple[FrameId, FrameId]] = []
    length = _HALF_CABLE * float(np.max(system.cable_length))
    cylinder, centre = Cylinder(sizes.cable, length), RigidTransform([0, 0, length / 2])
    filters = CollisionFilterDeclaration()
    for i in range(len(attachments)):
        aircraft = [_instance(part, carrier_colour(i)) for part in carrier_parts(sizes.wing_span)]
        sphere = Part(name=f"carrier {i + 1}", shape=Sphere(sizes.wing_span / 2))
        half = Part(name=f"cable {i + 1}", shape=cylinder, pose=centre)
        carrier = add(f"carriers::{i}", [*aircraft, _instance(sphere, is_solid=True)])
        lower, upper = (
            add(f"cables::{i}::{end}", [_instance(half, _CABLE_COLOUR, is_solid=True)])
            for end in ("lower", "upper")
        )
        carrier_frames.append(carrier)
        cable_frames.append((lower, upper))
        cable = GeometrySet([lower, upper])
        filters.ExcludeWithin(cable)
        filters.ExcludeBetween(cable, GeometrySet([load_frame, carrier]))
    scene_graph.collision_filter_manager().Apply(filters)
    return NonstopGeometry(
        attachments, aircraft_in(system), source, load_frame, carrier_frames, cable_frames
    )


def _instance(part: Part, colour: str = "", *, is_solid: bool = False) -> GeometryInstance:
    """A part that is seen where it has a colour, and that collides where it is solid."""
    instance = GeometryInstance(part.pose, part.shape, part.name)
    if colour:
        perception = PerceptionProperties()
        perception.AddProperty("phong", "diffuse", Rgba(*rgb(colour)))
        instance.set_perception_properties(perception)
        instance.set_illustration_properties(MakePhongIllustrationProperties([*rgb(colour), 1.0]))
    if is_solid:
        instance.set_proximity_properties(ProximityProperties())
    return instance
