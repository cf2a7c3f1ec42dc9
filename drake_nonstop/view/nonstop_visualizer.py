"""A block that shows the loop in Meshcat while it runs."""

import math
import time
from collections.abc import Callable

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, EventStatus

from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.systems.block import LeafBlock
from drake_nonstop.view.bodies import Snapshot, signal_sizes
from drake_nonstop.view.canvas import LiveCanvas
from drake_nonstop.view.scene import Scene

FRAME_TIME = 1 / 30  # s of wall time


class NonstopVisualizer(LeafBlock):
    """Shows the load, its carriers, cables and reference in Meshcat while they move.

    A step of the simulator is shown if the next frame is due in wall time. So the visualizer adds
    no steps and does not fall behind them at any real-time rate, and the signals are the same to
    the bit with any number of visualizers. A forced publish shows the instant of the context at
    once. The camera follows the reference. An instant with a value that is not finite is not shown,
    and a diagram converted to AutoDiffXd or Expression shows nothing. See `Scene` for what is
    drawn.

    Args:
        scenario: of the loop. The marks have its ε where the port is not connected.
        meshcat: the Meshcat to show it in, in place of that of another visualizer.
        nodes: number of nodes in each cable, for a `cable_state`; 0: cables are straight.

    Raises:
        ScenarioError: a field of the scenario's `scene` is out of range.
    """

    reads = (
        *("load_state", "reference", "carrier_state", "tensions"),
        *("speed_bound", "aircraft_state", "wind", "cable_state"),
    )
    optional_inputs = reads[4:]

    def __init__(self, scenario: Scenario, meshcat: Meshcat, *, nodes: int = 0):
        super().__init__()
        self.scene = Scene(scenario, nodes)
        self._meshcat = meshcat
        self._default_speed_bound = scenario.speed_bound
        self._canvas = LiveCanvas(meshcat)
        self._last_time = math.inf  # s, of the instant shown
        self._next_frame = -math.inf  # s of wall time, when it is due
        sizes = signal_sizes(self.reads, n := len(scenario.system.attachments))
        sizes |= {"cable_state": 6 * nodes * n} if nodes else {}
        self._ports = {k: self.DeclareVectorInputPort(k, size) for k, size in sizes.items()}
        if self.scalar is float:
            self.DeclarePerStepPublishEvent(self._publish)
            self.DeclareForcedPublishEvent(self._show)

    @staticmethod
    def AddToBuilder(
        builder: DiagramBuilder, nonstop: Diagram, scenario: Scenario, meshcat: Meshcat
    ) -> "NonstopVisualizer":
        """Adds a visualizer beside the loop of a scenario, connected by the signals' names.

        Args:
            builder: has the loop's diagram already.
            nonstop: the diagram, as `make_nonstop` builds it. It exports the signals;
                those that may be left unconnected may be missing.
            scenario: what is shown.
            meshcat: the Meshcat to show it in.

        Raises:
            ScenarioError: as the class.
        """
        has_nodes = nonstop.HasOutputPort("cable_state")
        size = nonstop.GetOutputPort("cable_state").size() if has_nodes else 0
        nodes = size // (6 * len(scenario.system.attachments))
        visualizer = builder.AddSystem(NonstopVisualizer(scenario, meshcat, nodes=nodes))
        for name, port in visualizer._ports.items():
            if name not in visualizer.optional_inputs or nonstop.HasOutputPort(name):
                builder.Connect(nonstop.GetOutputPort(name), port)
        return visualizer

    def _publish(self, context: Context) -> EventStatus:
        if time.perf_counter() >= self._next_frame or context.get_time() < self._last_time:
            return self._show(context)
        return EventStatus.DidNothing()

    def _show(self, context: Context) -> EventStatus:
        given = {
            name: port.Eval(context)
            for name, port in self._ports.items()
            if name not in self.optional_inputs or port.HasValue(context)
        }
        given.setdefault("speed_bound", np.array([self._default_speed_bound]))
        snapshot = Snapshot.from_signals(context.get_time(), **given)
        if not snapshot.is_finite:  # the block at fault raises the error
            return EventStatus.DidNothing()
        if snapshot.time < self._last_time:  # a new run
            self.scene.draw(self._meshcat)
            self._canvas = LiveCanvas(self._meshcat)
            self.scene.set_stage(self._meshcat, snapshot.reference.position[None])
        self._last_time = snapshot.time
        # Counted from when this frame was due, so that a short delay does not lower the rate.
        now = time.perf_counter()
        is_late = now - self._next_frame > FRAME_TIME
        self._next_frame = (now if is_late else self._next_frame) + FRAME_TIME
        self._meshcat.SetSimulationTime(snapshot.time)
        self.scene.show(self._canvas, snapshot)
        return EventStatus.Succeeded()


def show_in(
    meshcat: Meshcat,
) -> Callable[[DiagramBuilder, Diagram, Scenario], NonstopVisualizer]:
    """A viewer for `simulate` that shows the run in a Meshcat; see `NonstopVisualizer`."""

    def add(builder: DiagramBuilder, nonstop: Diagram, scenario: Scenario) -> NonstopVisualizer:
        return NonstopVisualizer.AddToBuilder(builder, nonstop, scenario, meshcat)

    return add
