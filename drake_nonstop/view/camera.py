"""The camera, light and background of a scene in Meshcat."""

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.math import RollPitchYaw

from drake_nonstop.view.bodies import rgb

BACKGROUND_COLOUR = "#f7f7fa"
VERTICAL_FIELD_OF_VIEW = 40.0  # degrees
ASPECT_RATIO = 1.5  # of a window that has everything in view
ELEVATION = 25.0  # degrees, of the camera above the horizon
YAW = 20.0  # degrees, from looking across the load's path towards looking along it
DISTANCE_MARGIN = 1.15  # of the least distance from which everything is in view

_SUN_INTENSITY, _AMBIENT_INTENSITY = 2.0, 1.2  # of three.js


def look(meshcat: Meshcat, eye: NDArray, target: NDArray) -> None:
    """Points Meshcat's camera and light from one point (3,) in m to another; no axes are shown."""
    for edge in ("top_color", "bottom_color"):
        meshcat.SetProperty("/Background/<object>", edge, list(rgb(BACKGROUND_COLOUR)))
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
