"""The load from a file: mass, inertia, attachments and shapes from SDF or URDF."""

import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import GeometryInstance, SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex

from drake_nonstop.model.system import checked_inertia
from drake_nonstop.systems.drake_log import drake_log_level
from drake_nonstop.validation import ScenarioError, number_text, read_text, require

_SAME_POINT = 1e-6  # m, for a load of 1 m
_MOMENTS = ("ixx", "iyy", "izz")
_PRODUCTS = ("ixy", "ixz", "iyz")  # 0 where a file leaves them out
# Elements and attributes that hold numbers, of which Drake reads "2,5" as 2.
_NUMBERS = {*_MOMENTS, *_PRODUCTS, "mass", "pose", "xyz", "rpy", "size", "radius", "length"}


def read_load(path: str | Path, attachment_frames: list[str]) -> dict[str, Any]:
    """The fields of `SystemParameters` in a file: load_mass, load_inertia and attachments.

    The file holds one free body, or several welded together. The load's frame L has the axes
    of the first, and its origin at the centre of mass of all.

    `attachment_frames` are the names of the frames (or links) with the cables at their origins, in
    the order of the carriers.

    Raises:
        ScenarioError: the file cannot be read, is not one rigid load, or lacks a frame; a number in
            it is none, or a link has a mass or moments of inertia that no body has.
    """
    _, _, poses, inertia = _parsed(path)
    for name in attachment_frames:
        remedy = f"give frames that {path} has: {', '.join(sorted(poses))}"
        require(name in poses, "attachment_frames", name, remedy)
    return {
        "load_mass": inertia.get_mass(),
        "load_inertia": inertia.CalcRotationalInertia().CopyToFullMatrix3().tolist(),
        "attachments": [poses[name].translation().tolist() for name in attachment_frames],
    }


def read_load_shapes(path: str | Path, attachments: NDArray) -> list[GeometryInstance]:
    """The visual and collision shapes in a file, with the properties that Drake reads.

    They are at their poses in the load's frame L, as of `read_load`, each with a name of its own.
    The file has to have a frame at each of the attachments (n, 3), in L, m.

    Raises:
        ScenarioError: as `read_load`; or a point is at no frame, or there are no shapes.
    """
    scene_graph = SceneGraph()
    plant, bodies, poses, _ = _parsed(path, scene_graph)
    origins = np.array([pose.translation() for pose in poses.values()])
    distances = np.linalg.norm(attachments[:, None] - origins, axis=2).min(axis=1)
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
    for body in bodies:
        for geometry in inspector.GetGeometries(plant.GetBodyFrameIdOrThrow(body.index())):
            shape = inspector.CloneGeometryInstance(geometry)
            shape.set_pose(poses[body.name()] @ inspector.GetPoseInFrame(geometry))
            shape.set_name(f"shape{len(shapes)}")
            shapes.append(shape)
    require(shapes, "load_file", path, "give a file with <visual> or <collision> shapes")
    return shapes


def _parsed(path: str | Path, scene_graph: SceneGraph | None = None) -> tuple[Any, ...]:
    """The plant of a file's load, its bodies, poses of its frames in L by name, and its inertia."""
    plant = MultibodyPlant(time_step=0.0)
    if scene_graph is not None:
        plant.RegisterAsSourceForSceneGraph(scene_graph)
    model = _parse_into(plant, path)
    context, indices = plant.CreateDefaultContext(), plant.GetBodyIndices(model)
    bodies = [plant.get_body(index) for index in indices]
    base = bodies[0].body_frame()
    inertia = plant.CalcSpatialInertia(context, base, indices)
    centre = inertia.get_com()
    frames = [plant.get_frame(index) for index in plant.GetFrameIndices(model)]
    X_LB = RigidTransform(-centre)
    poses = {frame.name(): X_LB @ frame.CalcPose(context, base) for frame in frames}
    return plant, bodies, poses, inertia.Shift(centre)


def _parse_into(plant: MultibodyPlant, path: str | Path) -> ModelInstanceIndex:
    """Adds the file's load to the plant, which it finalizes, and returns the load's model."""
    remedy = "give an SDF or URDF file"
    require(str(path).endswith((".sdf", ".urdf")), "load_file", path, f"{remedy}: .sdf or .urdf")
    text = read_text(path, "load_file", remedy)
    # Drake ends the process on a file that includes itself.
    require("<include" not in text, "load_file", path, f"{remedy} without <include>")
    try:
        root = ElementTree.fromstring(text)
        elements = [(f"load_file {path}: {owner}", part) for owner, part in _named(root)]
        for owner, element in elements:
            _require_numbers(owner, element)
            if element.tag == "mesh":
                _require_faces(Path(path), element)
        with drake_log_level(logging.CRITICAL):
            models = Parser(plant).AddModels(str(path))
        require(
            len(models) == 1, "load_file", path, f"give a file with one model, not {len(models)}"
        )
        plant.Finalize()
    except ScenarioError:
        raise
    # Drake ends the process with a SystemExit where a mesh or a shape breaks what it relies on.
    except (RuntimeError, ValueError, OSError, SystemExit, ElementTree.ParseError) as error:
        cause = " ".join(str(error).split())[:300]
        raise ScenarioError(f"load_file = {path}: {remedy} ({cause})") from None
    freedom = plant.num_velocities()
    remedy = f"give one free rigid load; this one has {freedom} degrees of freedom"
    require(freedom == 6 and plant.num_positions() == 7, "load_file", path, remedy)
    for owner, element in elements:
        # In URDF a link without <inertial> has no mass; in SDF it would have 1 kg.
        if element.tag == "link" and (str(path).endswith(".sdf") or element.findall("inertial")):
            _require_inertia(owner, element)
    return models[0]


def _named(element: ElementTree.Element, owner: str = "") -> Iterator[tuple[str, Any]]:
    """An element and all in it, each after the innermost name that it has, such as "link c, "."""
    name = element.get("name")
    owner = owner if name is None else f"{element.tag} {name}, "
    yield owner, element
    for part in element:
        yield from _named(part, owner)


def _require_numbers(owner: str, element: ElementTree.Element) -> None:
    """Raises ScenarioError for a text of an element, or an attribute, in the place of numbers."""
    for key, text in [(element.tag, element.text or ""), *element.attrib.items()]:
        if key in _NUMBERS or (key == "value" and element.tag == "mass"):
            is_each = all(number_text(word) and "inf" not in word.lower() for word in text.split())
            remedy = "give finite numbers in plain digits, such as 2.5"
            require(is_each, f"{owner}<{element.tag}>", f"'{text}'", remedy)


def _require_faces(path: Path, mesh: ElementTree.Element) -> None:
    """Raises ScenarioError for a face of an OBJ file without its points, which ends the process."""
    file = path.parent / (mesh.get("filename") or mesh.findtext("uri") or "").strip()
    if file.suffix.lower() != ".obj" or not file.is_file():  # of others Drake tells by itself
        return
    lines = read_text(file, f"load_file {path}: mesh", "give an OBJ file").splitlines()
    kinds = [line.split(maxsplit=1)[0] for line in lines if line.strip()]
    counts = [kinds.count(kind) for kind in ("v", "vt", "vn")]
    for number, line in enumerate(lines, 1):
        corners = line.partition("#")[0].split()
        for corner in corners[1:] if corners[:1] == ["f"] else ():
            for index, count in zip(corner.split("/"), counts, strict=False):
                if not index or (index.lstrip("-").isdigit() and 1 <= abs(int(index)) <= count):
                    continue
                remedy = f"give points that line {number} of {file} may have, 1 to {count}"
                require(False, f"load_file {path}: face", line, remedy)


def _require_inertia(owner: str, link: ElementTree.Element) -> None:
    """Raises ScenarioError for a link whose mass or inertia Drake would replace by another one."""
    inertial = _only(owner, link, "inertial")
    if inertial.get("auto") in ("true", "1"):  # from the densities of its shapes
        return
    mass, inertia = (_only(owner, inertial, name) for name in ("mass", "inertia"))
    given = {"mass": mass.get("value", mass.text), **inertia.attrib}
    given |= {part.tag: part.text for part in inertia}
    for key in ("mass", *_MOMENTS):
        require((given.get(key) or "").strip(), f"{owner}<{key}>", "nothing", "give a number")
    kilograms, *numbers = (float(given.get(key) or 0) for key in ("mass", *_MOMENTS, *_PRODUCTS))
    remedy = "give a number above zero; in URDF a link without <inertial> has no mass"
    require(kilograms > 0, f"{owner}<mass>", f"{kilograms:g}", remedy)
    xx, yy, zz, xy, xz, yz = numbers
    checked_inertia(f"{owner}<inertia>", [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _only(owner: str, element: ElementTree.Element, name: str) -> ElementTree.Element:
    """The element of a name in another one; raises ScenarioError unless there is one."""
    found = element.findall(name)
    require(len(found) == 1, f"{owner}<{name}>", f"{len(found)} of them", "give one")
    return found[0]
