"""What a Meshcat, or the page of a replay, is told to show, for the tests of the visualization."""

import base64
import gzip
import re
from collections.abc import Iterable, Iterator
from typing import Any

import msgpack
import numpy as np
from numpy.typing import NDArray

from drake_nonstop import NonstopVisualizer, Run, Scenario


class Screen:
    """A Meshcat that keeps what it is told, by path."""

    def __init__(self) -> None:
        self.matrices: dict[str, NDArray] = {}  # (4, 4), the z axis of cylinders as long as they
        self.colours: dict[str, NDArray] = {}  # red, green, blue, opacity
        self.paint_calls = 0

    def SetTransform(self, path: str, pose: Any) -> None:  # noqa: N802
        self.matrices[path] = np.array(getattr(pose, "GetAsMatrix4", lambda: pose)())

    def SetProperty(self, path: str, name: str, value: Any) -> None:  # noqa: N802
        if name == "color":
            self.colours[path], self.paint_calls = np.array(value), self.paint_calls + 1

    def __getattr__(self, name: str) -> Any:  # whatever else it is told
        return lambda *_: None

    def ends(self, path: str) -> NDArray:
        """The ends (2, 3) of a cylinder, m."""
        centre, along = self.matrices[path][:3, 3], self.matrices[path][:3, 2]
        return np.array([centre - along / 2, centre + along / 2])


def instant(run: Run, row: int = 0, **changes: Any) -> dict[str, Any]:
    """A sample of a run: its time and the signals that a visualizer reads, some of them changed."""
    ports = {name.partition(".")[2] for name in run.signals}
    read = [name for name in NonstopVisualizer.reads if name in ports]
    return {"time": run.time[row]} | {name: run.signal(name)[row] for name in read} | changes


def watch(
    scenario: Scenario, instants: Iterable[dict[str, Any]], screen: Any, nodes: int = 0
) -> Iterator[Any]:
    """The screen after each of the instants that a visualizer shows on it."""
    visualizer = NonstopVisualizer(scenario, screen, nodes=nodes)
    context = visualizer.CreateDefaultContext()
    for each in instants:
        context.SetTime(each["time"])
        for name in each.keys() - {"time"}:
            visualizer.GetInputPort(name).FixValue(context, each[name])
        visualizer.ForcedPublish(context)
        yield screen


def shown(scenario: Scenario, *instants: dict[str, Any], nodes: int = 0) -> Screen:
    """The screen after the last of the instants."""
    return [*watch(scenario, instants, Screen(), nodes)][-1]


class Recording:
    """What the page of a replay tells Meshcat's viewer, decoded by msgpack."""

    def __init__(self, page: str):
        kinds = {"gzip": gzip.decompress, "octet-binary": bytes}
        form = r'application/(gzip|octet-binary);base64,([\w+/=]+)"\)\s*\.then\(res\b'
        texts = re.findall(form, page)
        contents = [kinds[kind](base64.b64decode(text)) for kind, text in texts]
        self.commands = [msgpack.unpackb(each) for each in contents]
        animations = [each["animations"] for each in self.of_type("set_animation")]
        self.tracks = {
            f"{each['path']}{track['name']}": (
                [key["time"] for key in track["keys"]],  # frames
                np.array([key["value"] for key in track["keys"]], dtype=float),
            )
            for each in (animations[0] if animations else ())
            for track in each["clip"]["tracks"]
        }

    def of_type(self, kind: str) -> list[dict[str, Any]]:
        return [each for each in self.commands if each["type"] == kind]

    def objects(self) -> dict[str, Any]:
        """The objects by their paths."""
        return {each["path"]: each["object"] for each in self.of_type("set_object")}

    def value(self, path: str, name: str) -> Any:
        """The value of a property."""
        (found,) = (
            each["value"]
            for each in self.of_type("set_property")
            if (each["path"], each["property"]) == (path, name)
        )
        return found

    def at(self, frame: float, track: str) -> NDArray:
        """The value of a track as the viewer has it, interpolated linearly."""
        frames, values = self.tracks[track]
        columns = values.reshape(len(frames), -1).T
        return np.array([np.interp(frame, frames, column) for column in columns])
