"""The camera of a scene, its light, its background and the grid below."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform, RollPitchYaw

from drake_nonstop.visualization.bodies import Colour

VERTICAL_FIELD_OF_VIEW = 40.0  # degrees
ASPECT_RATIO = 1.5  # of the narrowest window that has everything in view
ELEVATION = 25.0  # degrees, of the camera above the horizon
YAW = 20.0  # degrees, from looking across the load's path towards looking along it
DISTANCE_MARGIN = 1.15  # of the least distance from which everything is in view

_FOLLOWING_EXTENT = 1.5  # reaches; along a longer path the camera follows the reference
_FARTHEST_CARRIER = 3.0  # reaches from the reference; one farther away may be out of view
_GROUND_CLEARANCE = 0.3  # reaches, from the lowest point to the grid
_GRID_OPACITY = 0.2
_SUN_INTENSITY, _AMBIENT_INTENSITY = 2.0, 1.2  # of three.js
_SIX_DIRECTIONS = np.vstack([np.eye(3), -np.eye(3)])


@dataclass(kw_only=True)
class FollowingCamera:
    """The view of a camera that follows the reference, at the start; all in the world frame."""

    origin: NDArray  # (3,), m, the reference
    target: NDArray  # (3,), m, the point that the camera looks at
    floor: NDArray  # (3,), m, the grid


def set_stage(
    meshcat: Meshcat,
    path: NDArray,
    carriers: NDArray | None,
    *,
    reach: float,
    load_radius: float,
    carrier_radius: float,
    background: Colour,
    may_follow: bool = True,
) -> FollowingCamera | None:
    """Sets a plain background, a camera that sees everything, its light and a grid below.

    Args:
        meshcat: the Meshcat to set.
        path: (k, 3), m, positions of the load's reference.
        carriers: (k, n, 3), m, at the same instants, or None where they are not known. Those
            far from the load may be out of view.
        reach: m, of a carrier from the load.
        load_radius: m, about the load's centre of mass.
        carrier_radius: m, about a carrier.
        background: its colour.
        may_follow: whether the camera may move.

    Returns:
        What the camera follows the reference with; None where it stands still, as it does where
        the path is short.
    """
    if carriers is None:
        carriers = path[:, None] + reach * _SIX_DIRECTIONS[:5]  # all but straight below
    follows = may_follow and np.ptp(path, axis=0).max() > _FOLLOWING_EXTENT * reach
    shifts = path - path[0] if follows else np.zeros((len(path), 3))  # of the camera
    is_near = np.linalg.norm(carriers - path[:, None], axis=2) < _FARTHEST_CARRIER * reach
    load_points = (path[:, None] + load_radius * _SIX_DIRECTIONS).reshape(-1, 3)
    carrier_points = carriers[is_near][:, None] + carrier_radius * _SIX_DIRECTIONS
    points = np.concatenate([carrier_points.reshape(-1, 3), load_points])
    points_per_instant = 6 * is_near.sum(axis=1)
    shifts = np.concatenate(
        [np.repeat(shifts, points_per_instant, axis=0), np.repeat(shifts, 6, axis=0)]
    )
    eye, target = fit_view(points - shifts, path=path)
    middle = (path.min(axis=0) + path.max(axis=0)) / 2
    floor = np.array([*middle[:2], points[:, 2].min() - _GROUND_CLEARANCE * reach])
    _set_background(meshcat, background)
    _set_camera(meshcat, eye, target)
    _set_light(meshcat, (eye - target) / np.linalg.norm(eye - target))
    _set_grid(meshcat, floor, reach)
    return FollowingCamera(origin=path[0], target=target, floor=floor) if follows else None


def fit_view(points: NDArray, *, path: NDArray) -> tuple[NDArray, NDArray]:
    """Where a camera stands and what it looks at (3,) in m, with the points (k, 3) just in view.

    It looks across the path (k, 3) of the load, whose direction leads to the right.
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
    return R_WC @ (middle - [0.0, distance, 0.0]), R_WC @ middle


def _set_background(meshcat: Meshcat, colour: Colour) -> None:
    for edge in ("top_color", "bottom_color"):
        meshcat.SetProperty("/Background/<object>", edge, list(colour))
    meshcat.SetProperty("/Axes", "visible", False)


def _set_camera(meshcat: Meshcat, eye: NDArray, target: NDArray) -> None:
    distance = np.linalg.norm(eye - target)
    camera = "/Cameras/default/rotated/<object>"
    meshcat.SetProperty(camera, "fov", VERTICAL_FIELD_OF_VIEW)
    meshcat.SetProperty(camera, "near", distance / 100)
    meshcat.SetProperty(camera, "far", distance * 100)
    meshcat.SetCameraPose(eye, target)


def _set_light(meshcat: Meshcat, towards_camera: NDArray) -> None:
    # Most of Meshcat's lamps reach only a few metres; a directional light serves every size.
    for lamp in ("SpotLight", "PointLightNegativeX", "PointLightPositiveX"):
        meshcat.SetProperty(f"/Lights/{lamp}", "visible", False)
    sun = towards_camera + np.array([0.0, 0.0, 1.0])
    meshcat.SetProperty("/Lights/FillLight/<object>", "position", sun.tolist())
    meshcat.SetProperty("/Lights/FillLight/<object>", "intensity", _SUN_INTENSITY)
    meshcat.SetProperty("/Lights/AmbientLight/<object>", "intensity", _AMBIENT_INTENSITY)


def _set_grid(meshcat: Meshcat, floor: NDArray, reach: float) -> None:
    scale = 10.0 ** np.round(np.log10(reach / 2))  # 1: squares of 0.5 m
    meshcat.SetTransform("/Grid", RigidTransform(floor))
    meshcat.SetProperty("/Grid/<object>", "scale", [scale, scale, scale])
    meshcat.SetProperty("/Grid/<object>", "opacity", _GRID_OPACITY)
