"""Canvases: what a scene moves and colours its objects on; its camera, light and background."""

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat, MeshcatAnimation
from pydrake.math import RigidTransform, RollPitchYaw

from drake_nonstop.view.bodies import Colour, stack_poses

ROOT = "/nonstop"  # of the objects' paths in Meshcat
VERTICAL_FIELD_OF_VIEW = 40.0  # degrees
ASPECT_RATIO = 1.5  # of a window that has everything in view
ELEVATION = 25.0  # degrees, of the camera above the horizon
YAW = 20.0  # degrees, from looking across the load's path towards looking along it
DISTANCE_MARGIN = 1.15  # of the least distance from which everything is in view

_SUN_INTENSITY, _AMBIENT_INTENSITY = 2.0, 1.2  # of three.js


@dataclass(kw_only=True)
class FollowingCamera:
    """The view of a camera that follows the reference, at the start; all in the world frame."""

    origin: NDArray  # (3,), m, the reference
    target: NDArray  # (3,), m, the point that the camera looks at
    floor: NDArray  # (3,), m, the grid


class LiveCanvas:
    """A Meshcat as a canvas: changes are seen at once."""

    def __init__(self, meshcat: Meshcat):
        self._meshcat = meshcat
        self._painted: dict[str, tuple[float, ...]] = {}

    def follow(self, position: NDArray, camera: FollowingCamera) -> None:
        """Moves the camera as the reference moved from the camera's origin to a position (3,)."""
        shift = position - camera.origin
        self._meshcat.SetTransform("/Cameras/default", RigidTransform(shift))
        self._meshcat.SetCameraTarget(camera.target + shift)

    def place(self, path: str, pose: NDArray, length: float = 1.0) -> None:
        """Puts an object at a pose (4, 4), scaled by `length` along its own z axis."""
        if length != 1.0:
            pose = pose.copy()
            pose[:3, 2] *= length
        self._meshcat.SetTransform(path, pose)

    def paint(self, path: str, colour: Colour, opacity: float, *, fades: bool = False) -> None:
        """Gives the object at a path a colour and an opacity from 0 to 1.

        With `fades`, the opacity of a recording may change gradually from the previous one. There
        is no command to Meshcat where nothing changes.
        """
        rgba = *colour, opacity
        if self._painted.get(path) != rgba:
            self._painted[path] = rgba
            self._meshcat.SetProperty(path, "color", list(rgba))


class RecordingCanvas:
    """A recording as a canvas; `frame` is the one that is being recorded.

    Meshcat interpolates between the frames that have a value. A value that does not change is
    left out, which keeps the recording small, and is repeated in the frame before it changes.
    """

    def __init__(self, animation: MeshcatAnimation):
        self.animation = animation
        self.frame = 0
        self._tracks: dict[tuple[str, str], tuple[int, Any]] = {}  # last frame and value of each

    def follow(self, position: NDArray, camera: FollowingCamera) -> None:
        """See `LiveCanvas`.

        A recording cannot move the point that its camera looks at: all objects are shifted the
        opposite way instead.
        """
        shift = position - camera.origin
        root, grid = stack_poses(np.eye(3), np.array([-shift, camera.floor - shift]))
        self._place(ROOT, root)
        self._place("/Grid", grid)

    def place(self, path: str, pose: NDArray, length: float = 1.0) -> None:
        """See `LiveCanvas`."""
        self._place(path, pose)
        # Rounded to three digits, which leaves out the small stretch of a taut cable.
        self._write(path, "scale", [1.0, 1.0, float(f"{length:.3g}")])

    def paint(self, path: str, colour: Colour, opacity: float, *, fades: bool = False) -> None:
        """See `LiveCanvas`; the path has to be that of a single object.

        Meshcat plays back colours of an object's material only, which is below its path.
        """
        path += "/<object>"
        self._write(path, "material.color", [*colour])
        self._write(path, "material.opacity", opacity, holds=not fades)

    def finish(self) -> None:
        """Ends all tracks at the present frame: shorter ones would start again early."""
        for (path, name), (frame, value) in list(self._tracks.items()):
            if frame < self.frame:
                self._record(self.frame, path, name, value)

    def _place(self, path: str, pose: NDArray) -> None:
        self._write(path, "transform", pose[:3].tobytes())

    def _write(self, path: str, name: str, value: Any, *, holds: bool = True) -> None:
        frame, previous = self._tracks.get((path, name), (self.frame, None))
        if previous == value:
            return
        if holds and frame < self.frame - 1:
            self._record(self.frame - 1, path, name, previous)
        self._record(self.frame, path, name, value)

    def _record(self, frame: int, path: str, name: str, value: Any) -> None:
        self._tracks[path, name] = frame, value
        if name == "transform":
            pose = RigidTransform.MakeUnchecked(np.frombuffer(value).reshape(3, 4))
            self.animation.SetTransform(frame, path, pose)
        else:
            self.animation.SetProperty(frame, path, name, value)


# What a scene moves its objects on: a Meshcat that is watched, or a recording.
Canvas: TypeAlias = LiveCanvas | RecordingCanvas


def look(meshcat: Meshcat, eye: NDArray, target: NDArray, background: Colour) -> None:
    """Points Meshcat's camera and light from one point (3,) in m to another; no axes are shown."""
    for edge in ("top_color", "bottom_color"):
        meshcat.SetProperty("/Background/<object>", edge, list(background))
    meshcat.SetProperty("/Axes", "visible", False)
    distance = np.linalg.norm(eye - target)
    camera = "/Cameras/default/rotated/<object>"
    meshcat.SetProperty(camera, "fov", VERTICAL_FIELD_OF_VIEW)
    meshcat.SetProperty(camera, "near", distance / 100)
    meshcat.SetProperty(camera, "far", distance * 100)
    meshcat.SetCameraPose(eye, target)
    # Most of Meshcat's lamps reach only a few metres; a directional light serves every size.
    for lamp in ("SpotLight", "PointLightNegativeX", "PointLightPositiveX"):
        meshcat.SetProperty(f"/Lights/{lamp}", "visible", False)
    sun = (eye - target) / distance + np.array([0.0, 0.0, 1.0])
    meshcat.SetProperty("/Lights/FillLight/<object>", "position", sun.tolist())
    meshcat.SetProperty("/Lights/FillLight/<object>", "intensity", _SUN_INTENSITY)
    meshcat.SetProperty("/Lights/AmbientLight/<object>", "intensity", _AMBIENT_INTENSITY)


def fit_view(points: NDArray, *, path: NDArray) -> tuple[NDArray, NDArray, float]:
    """Where a camera stands and what it looks at (3,) in m, with the points (k, 3) just in view.

    It looks across the path (k, 3) of the load, whose direction leads to the right. The third is
    the aspect ratio of the narrowest window that has the points in view.
    """
    displacements = path - path[0]
    displacement = displacements[np.argmax(np.linalg.norm(displacements, axis=1))]
    yaw = np.arctan2(displacement[1], displacement[0]) - np.radians(YAW)
    R_WC = RollPitchYaw(np.radians(-ELEVATION), 0.0, yaw).ToRotationMatrix().matrix()
    p_C = points @ R_WC  # camera axes: right, ahead, up
    middle = (p_C.min(axis=0) + p_C.max(axis=0)) / 2
    right, ahead, up = (p_C - middle).T
    slope = np.tan(np.radians(VERTICAL_FIELD_OF_VIEW) / 2)
    spread = np.maximum(np.abs(right) / ASPECT_RATIO, np.abs(up))
    distance = DISTANCE_MARGIN * np.max(spread / slope - ahead)
    aspect = DISTANCE_MARGIN * np.max(np.abs(right) / (distance + ahead)) / slope
    return R_WC @ (middle - [0.0, distance, 0.0]), R_WC @ middle, float(min(aspect, ASPECT_RATIO))
