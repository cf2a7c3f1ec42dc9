"""The load from a file: mass, inertia and attachments from SDF or URDF."""

import logging
from pathlib import Path
from typing import Any

from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

from drake_nonstop.systems.drake_log import drake_log_level
from drake_nonstop.validation import ScenarioError, read_text, require


def read_load(path: str | Path, attachment_frames: list[str]) -> dict[str, Any]:
    """The fields of `SystemParameters` in a file: load_mass, load_inertia and attachments.

    The file holds one free body, or several welded together. The load's frame L has the axes
    of the first, and its origin at the centre of mass of all.

    Args:
        path: an SDF or URDF file.
        attachment_frames: the names of the frames (or links) with the cables at their origins,
            in the order of the carriers.

    Raises:
        ScenarioError: the file cannot be read, is not one rigid load, or lacks a frame.
    """
    remedy = "give an SDF or URDF file"
    require(str(path).endswith((".sdf", ".urdf")), "load_file", path, f"{remedy}: .sdf or .urdf")
    text = read_text(path, "load_file", remedy)
    # Drake ends the process on a file that includes itself.
    require("<include" not in text, "load_file", path, f"{remedy} without <include>")
    plant = MultibodyPlant(time_step=0.0)
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
    context = plant.CreateDefaultContext()
    bodies = plant.GetBodyIndices(models[0])
    base = plant.get_body(bodies[0]).body_frame()
    inertia = plant.CalcSpatialInertia(context, base, bodies)
    centre = inertia.get_com()
    about_centre = inertia.Shift(centre).CalcRotationalInertia().CopyToFullMatrix3()
    known = {plant.get_frame(k).name() for k in plant.GetFrameIndices(models[0])}
    points = []
    for name in attachment_frames:
        require(
            name in known,
            "attachment_frames",
            name,
            f"give frames that {path} has: {', '.join(sorted(known))}",
        )
        frame = plant.GetFrameByName(name, models[0])
        points.append((frame.CalcPose(context, base).translation() - centre).tolist())
    return {
        "load_mass": inertia.get_mass(),
        "load_inertia": about_centre.tolist(),
        "attachments": points,
    }
