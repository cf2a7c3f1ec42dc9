"""Canvases: what a scene moves and colours its objects on."""

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat, MeshcatAnimation
from pydrake.math import RigidTransform

from drake_nonstop.view.bodies import Colour


class LiveCanvas:
    """A Meshcat as a canvas: changes are seen at once."""

    def __init__(self, meshcat: Meshcat):
        self._meshcat = meshcat
        self._painted: dict[str, tuple[float, ...]] = {}

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

    def place(self, path: str, pose: NDArray, length: float | None = None) -> None:
        """See `LiveCanvas`."""
        self._write(path, "transform", pose[:3].tobytes())
        if length is not None:
            # Rounded to three digits, which leaves out the small stretch of a taut cable.
            self._write(path, "scale", [1.0, 1.0, float(f"{length:.3g}")])

    def paint(self, path: str, colour: Colour, opacity: float, *, fades: bool = False) -> None:
        """See `LiveCanvas`; the path has to be that of a single object.

        Meshcat plays back colours of an object's material only, which is below its path, and takes
        them for linear ones.
        """
        path += "/<object>"
        self._write(path, "material.color", [_linear(value) for value in colour])
        self._write(path, "material.opacity", opacity, holds=not fades)

    def finish(self) -> None:
        """Ends all tracks at the present frame: shorter ones would start again early."""
        for (path, name), (frame, value) in list(self._tracks.items()):
            if frame < self.frame:
                self._record(self.frame, path, name, value)

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


def _linear(value: float) -> float:
    """The linear value of a channel of sRGB."""
    return value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4


# What a scene moves its objects on: a Meshcat that is watched, or a recording.
Canvas: TypeAlias = LiveCanvas | RecordingCanvas
