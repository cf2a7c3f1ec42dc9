"""What canvases write to Meshcat and to a recording."""

from collections import defaultdict

import numpy as np

from drake_nonstop.view.canvas import ROOT, FollowingCamera, LiveCanvas, RecordingCanvas


class KeyFrames:
    """An animation that keeps what is written to it."""

    def __init__(self):
        self.keys = defaultdict(dict)

    def SetTransform(self, frame, path, pose):  # noqa: N802
        self.keys[path, "transform"][frame] = pose.translation().tolist()

    def SetProperty(self, frame, path, name, value):  # noqa: N802
        self.keys[path, name][frame] = value


def recorded(writes, last):
    """The key frames of a recording after the writes: (frame, function of the canvas)."""
    animation = KeyFrames()
    canvas = RecordingCanvas(animation)
    for frame, write in writes:
        canvas.frame = frame
        write(canvas)
    canvas.frame = last
    canvas.finish()
    return animation.keys


def test_a_recording_holds_a_value_until_it_changes():
    grey = np.full(3, 0.5)

    def painted(opacity, **fading):
        return lambda canvas: canvas.paint("/a", grey, opacity, **fading)

    writes = [(0, painted(1.0)), (1, painted(1.0)), (5, painted(0.25)), (6, painted(0.25))]
    keys = recorded(writes, 9)
    assert keys["/a/<object>", "material.opacity"] == {0: 1.0, 4: 1.0, 5: 0.25, 9: 0.25}
    assert keys["/a/<object>", "material.color"] == {0: [0.5] * 3, 9: [0.5] * 3}
    fading = recorded([(0, painted(1.0)), (5, painted(0.25, fades=True))], 9)
    assert fading["/a/<object>", "material.opacity"] == {0: 1.0, 5: 0.25, 9: 0.25}


def test_a_recording_follows_by_shifting_the_objects():
    camera = FollowingCamera(
        origin=np.array([1.0, 0, 0]), target=np.ones(3), floor=np.array([0, 0, -1])
    )
    keys = recorded([(0, lambda canvas: canvas.follow(np.array([4.0, 0, 0]), camera))], 0)
    assert keys[ROOT, "transform"][0] == [-3, 0, 0]
    assert keys["/Grid", "transform"][0] == [-3, 0, -1]


def test_a_live_canvas_paints_changes_only():
    class Counter:
        calls = 0

        def SetProperty(self, *arguments):  # noqa: N802
            self.calls += 1

    counter = Counter()
    canvas = LiveCanvas(counter)
    for opacity in (1.0, 1.0, 0.5, 0.5, 1.0):
        canvas.paint("/a", np.ones(3), opacity)
    assert counter.calls == 3
