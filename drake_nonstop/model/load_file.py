"""The load from a file: mass, inertia, attachments and shapes from SDF or URDF."""

import logging
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import GeometryInstance, SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex

from drake_nonstop.systems.drake_log import drake_log_level
from drake_nonstop.validation import ScenarioError, read_text, require

_SAME_POINT = 1e-6  # m, for a load of 1 m


def read_load(path: str | Path, attachment_frames: list[str]) -> dict[str, Any]:
    """The fields of `SystemParameters` in a file: load_mass, load_inertia and attachments.

    The file holds one free body, or several welded together. The load's frame L has the axes
    of the first, and its origin at the centre of mass of all.

    `attachment_frames` are the names of the frames (or links) with the cables at their origins, in
    the order of the carriers.

    Raises:
        ScenarioError: the file cannot be read, is not one rigid load, or lacks a frame.
    """
    plant = MultibodyPlant(time_step=0.0)
    model = _parse_into(plant, path)
    context = plant.CreateDefaultContext()
    bodies = plant.GetBodyIndices(model)
    base = plant.get_body(bodies[0]).body_frame()
    inertia = plant.CalcSpatialInertia(context, base, bodies)
    centre = inertia.get_com()
    about_centre = inertia.Shift(centre).CalcRotationalInertia().CopyToFullMatrix3()
    known = {plant.get_frame(k).name() for k in plant.GetFrameIndices(model)}
    points = []
    for name in attachment_frames:
        require(
            name in known,
            "attachment_frames",
            name,
            f"give frames that {path} has: {', '.join(sorted(known))}",
        )
        frame = plant.GetFrameByName(name, model)
        points.append((frame.CalcPose(context, base).translation() - centre).tolist())
    return {
        "load_mass": inertia.get_mass(),
        "load_inertia": about_centre.tolist(),
        "attachments": points,
    }


def read_load_shapes(path: str | Path, attachments: NDArray) -> list[GeometryInstance]:
    """The visual and collision shapes in a file, with the properties that Drake reads.

    They are at their poses in the load's frame L, as of `read_load`, each with a name of its own.
    The file has to have a frame at each of the attachments (n, 3), in L, m.

    Raises:
        ScenarioError: as `read_load`; or a point is at no frame, or there are no shapes.
    """
    plant, scene_graph = MultibodyPlant(time_step=0.0), SceneGraph()
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    model = _parse_into(plant, path)
    context = plant.CreateDefaultContext()
    bodies = plant.GetBodyIndices(model)
    base = plant.get_body(bodies[0]).body_frame()
    centre = plant.CalcSpatialInertia(context, base, bodies).get_com()
    frames = [plant.get_frame(k) for k in plant.GetFrameIndices(model)]
    origins = [frame.CalcPose(context, base).translation() - centre for frame in frames]
    distances = np.linalg.norm(attachments[:, None] - np.array(origins), axis=2).min(axis=1)
    farthest = int(np.argmax(distances))
    require(
        distances[farthest] <= _SAME_POINT * (1 + np.abs(attachments).max()),
        "load_file",
        path,
        f"give the file that the attachments were read from: this one has no frame at attachment "
        f"{farthest + 1}, {np.round(attachments[farthest], 6).tolist()} from the centre of mass",
    )
    inspector = scene_graph.model_inspector()
    shapes: list[GeometryInstance] = []
    for index in bodies:
        X_LB = RigidTransform(-centre) @ plant.get_body(index).body_frame().CalcPose(context, base)
        for geometry in inspector.GetGeometries(plant.GetBodyFrameIdOrThrow(index)):
            shape = inspector.CloneGeometryInstance(geometry)
            shape.set_pose(X_LB @ inspector.GetPoseInFrame(geometry))
            shape.set_name(f"shape{len(shapes)}")
            shapes.append(shape)
    require(shapes, "load_file", path, "give a file with <visual> or <collision> shapes")
    return shapes


def _parse_into(plant: MultibodyPlant, path: str | Path) -> ModelInstanceIndex:
    """Adds the file's load to the plant, which it finalizes, and returns the load's model."""
    remedy = "give an SDF or URDF file"
    require(str(path).endswith((".sdf", ".urdf")), "load_file", path, f"{remedy}: .sdf or .urdf")
    text = read_text(path, "load_file", remedy)
    # Drake ends the process on a file that includes itself.
    require("<include" not in text, "load_file", path, f"{remedy} without <include>")
    try:
        with drake_log_level(logging.ERROR):
            models = Parser(plant).AddModels(str(path))
        require(
            len(models) == 1, "load_file", path, f"give a file with one model, not {len(models)}"
        )
        plant.Finalize()
    except (RuntimeError, ValueError, OSError) as error:
        cause = " ".join(str(error).split())[:300]
        raise ScenarioError(f"load_file = {path}: {remedy} ({cause})") from None
    require(
        plant.num_velocities() == 6 and plant.num_positions() == 7,
        "load_file",
        path,
        f"give one free rigid load; this one has {plant.num_velocities()} degrees of freedom",
    )
    return models[0]
