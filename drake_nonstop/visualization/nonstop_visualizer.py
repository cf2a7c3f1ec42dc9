"""A window on the figure: what happens, in Meshcat."""

import math
import time
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, EventStatus

from drake_nonstop.model.system import Model, SystemParameters, overridden
from drake_nonstop.systems.block import LeafBlock
from drake_nonstop.validation import is_number, require
from drake_nonstop.visualization.scene import LiveCanvas, Scene, SceneConfig, Snapshot

if TYPE_CHECKING:
    from drake_nonstop.scenario.loading import Scenario

FRAME_RATE = 30.0  # 1/s of wall time


class NonstopVisualizer(LeafBlock):
    """Shows the load, its carriers, cables and reference (see `Scene`) while they move.

    It looks at every step and shows one as often as `frame_rate` asks for, in wall time, so
    that it neither adds steps nor falls behind them, whatever the real-time rate: a run is
    the same to the bit with any number of these or none. All that it keeps is what Meshcat
    shows; nothing reads it back. A forced publish shows the context's instant at once.

    .. pydrake_system::

        name: NonstopVisualizer
        input_ports:
        - load_state
        - reference
        - carrier_state
        - tensions
        - speed_bound

    `load_state` (13), `reference` (22), `carrier_state` (6n), `tensions` (n, N), in W, and
    `speed_bound` (1, m/s), which may be left unconnected.

    Args:
        system: whose load, attachments and cables are shown.
        meshcat: where; what this shows there takes the place of what another one did.
        config: colours and sizes.
        path: (k, 3) in m, where the reference is going to be, for the camera; without it the
            camera is set to see the start.
        speed_bound: ε in m/s, where that port is not connected.
        frame_rate: frames per second of wall time, at most.

    Raises:
        ScenarioError: a field of the config, or the frame rate, is out of range.
    """

    def __init__(
        self,
        system: SystemParameters | Model,
        meshcat: Meshcat,
        config: SceneConfig | None = None,
        *,
        path: NDArray | None = None,
        speed_bound: float = 0.0,
        frame_rate: float = FRAME_RATE,
    ):
        super().__init__()
        require(
            is_number(frame_rate) and frame_rate > 0,
            "visualizer.frame_rate",
            frame_rate,
            "give a finite number greater than zero",
        )
        self.scene = Scene(system, config)
        self._meshcat = meshcat
        self._path = path
        self._default_speed_bound = speed_bound
        self._frame_time = 1 / frame_rate
        self._canvas = LiveCanvas(meshcat)
        self._last_time = math.inf  # s, of what is shown
        self._next_frame = -math.inf  # s of wall time, when one is due
        self._n = len(system.attachments)
        self._load_state = self.DeclareVectorInputPort("load_state", 13)
        self._reference = self.DeclareVectorInputPort("reference", 22)
        self._carrier_state = self.DeclareVectorInputPort("carrier_state", 6 * self._n)
        self._tensions = self.DeclareVectorInputPort("tensions", self._n)
        self._speed_bound = self.DeclareVectorInputPort("speed_bound", 1)
        self.DeclarePerStepPublishEvent(self._publish)
        self.DeclareForcedPublishEvent(self._show)

    @staticmethod
    def AddToBuilder(
        builder: DiagramBuilder,
        nonstop: Diagram,
        scenario: "Scenario",
        meshcat: Meshcat,
        *,
        frame_rate: float = FRAME_RATE,
    ) -> "NonstopVisualizer":
        """Adds one beside the closed loop of a scenario, and connects it by the signals' names.

        The loop has to be in the builder already, and to export the signals, as what
        `make_nonstop` returns does; `speed_bound` may be missing.
        """
        visualizer = builder.AddSystem(
            NonstopVisualizer(
                overridden(scenario.system, scenario.simulated),
                meshcat,
                scenario.scene,
                path=_path(nonstop, scenario.duration),
                speed_bound=scenario.speed_bound,
                frame_rate=frame_rate,
            )
        )
        for i in range(visualizer.num_input_ports()):
            port = visualizer.get_input_port(i)
            if port.get_name() != "speed_bound" or nonstop.HasOutputPort(port.get_name()):
                builder.Connect(nonstop.GetOutputPort(port.get_name()), port)
        return visualizer

    def _publish(self, context: Context) -> EventStatus:
        if time.perf_counter() >= self._next_frame or context.get_time() < self._last_time:
            return self._show(context)
        return EventStatus.DidNothing()

    def _show(self, context: Context) -> EventStatus:
        load, reference = (port.Eval(context)[:7] for port in (self._load_state, self._reference))
        carriers, velocities = self._carrier_state.Eval(context).reshape(2, self._n, 3)
        tensions = self._tensions.Eval(context)
        speed_bound = self._default_speed_bound
        if self._speed_bound.HasValue(context):
            speed_bound = float(self._speed_bound.Eval(context)[0])
        snapshot = Snapshot(
            time=context.get_time(),
            load=load,
            reference=reference,
            carriers=carriers,
            velocities=velocities,
            tensions=tensions,
            speed_bound=speed_bound,
        )
        if not snapshot.is_finite:  # whose fault that is, the blocks themselves can tell better
            return EventStatus.DidNothing()
        if snapshot.time < self._last_time:
            path = reference[None, 4:] if self._path is None else self._path
            self.scene.set_stage(self._meshcat, path)
            self.scene.draw(self._meshcat)
            self._canvas = LiveCanvas(self._meshcat)
        self._last_time = snapshot.time
        # Counted from when this one was due, so that late ones do not lower the rate.
        now = time.perf_counter()
        is_late = now - self._next_frame > self._frame_time
        self._next_frame = (now if is_late else self._next_frame) + self._frame_time
        self._meshcat.SetSimulationTime(snapshot.time)
        self.scene.show(self._canvas, snapshot)
        return EventStatus.Succeeded()


def _path(nonstop: Diagram, duration: float) -> NDArray | None:
    """Where the diagram's `load_trajectory` leads (k, 3), if it depends on time alone."""
    if not nonstop.HasSubsystemNamed("load_trajectory"):
        return None
    trajectory = nonstop.GetSubsystemByName("load_trajectory")
    if trajectory.num_input_ports() > 0:
        return None
    context = trajectory.CreateDefaultContext()
    positions = []
    for instant in np.linspace(0, duration, 100):
        context.SetTime(instant)
        positions.append(trajectory.GetOutputPort("reference").Eval(context)[4:7].copy())
    return np.array(positions)
