"""What the camera has in view, and when it follows the load's reference."""

import numpy as np
import pytest
from scenes import ListCanvas, snapshot, system

from drake_nonstop.view import canvas as camera
from drake_nonstop.view.meshcat_server import start_meshcat
from drake_nonstop.view.scene import Scene


@pytest.mark.parametrize("size", [1.0, 60.0])
def test_camera_sees_all(size):
    path = np.column_stack([np.linspace(0, size, 30), np.zeros((30, 2))])
    points = np.concatenate([path + size * direction for direction in np.eye(3)])
    eye, target, aspect = camera.fit_view(points, path=path)
    ahead = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(ahead, [0, 0, 1]) / np.linalg.norm(np.cross(ahead, [0, 0, 1]))
    up = np.cross(right, ahead)
    depth, side, height = ((points - eye) @ np.column_stack([ahead, right, up])).T
    slope = np.tan(np.radians(camera.VERTICAL_FIELD_OF_VIEW / 2))
    fill = np.max([np.abs(side) / camera.ASPECT_RATIO, np.abs(height)], axis=0) / depth / slope
    assert 0.7 < np.max(fill) < 1.0
    width = np.max(np.abs(side) / depth) / slope
    assert 1.1 < aspect / width < 1.2  # a window that is as narrow has all in view
    assert right[0] > 0.9  # the load moves along +x, to the right


def test_camera_follows_on_a_long_path_only():
    meshcat = start_meshcat()
    for length, follows in ((1.0, False), (10.0, True)):
        made, canvas = Scene(system()), ListCanvas()
        made.set_stage(meshcat, np.array([[0.0, 0, 0], [length, 0, 0]]))
        made.show(canvas, snapshot(0.5))
        assert bool(canvas.followed) == follows
        if follows:
            np.testing.assert_array_equal(canvas.followed[0], snapshot(0.5).reference_position)


def test_camera_disregards_carriers_far_from_the_load():
    meshcat = start_meshcat()
    path = np.zeros((2, 3))
    views = []
    for far in (1.0, 1e5):
        made = Scene(system())
        carriers = np.array([[[1.0, 0, 1], [-1, 0, 1]], [[1, 0, 1], [-1, 0, 1]]])
        extra = np.array([[[far, 0, 1]]] * 2) if far > 10 else carriers[:, :1]
        made.set_stage(meshcat, path, np.concatenate([carriers, extra], axis=1))
        views.append(meshcat._GetPackedProperty("/Cameras/default/rotated/<object>", "far"))
    assert views[0] == views[1]
