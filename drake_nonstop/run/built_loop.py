"""A loop's diagram in one with its logs and viewers."""

from collections.abc import Callable, Sequence
from typing import Any

from pydrake.systems.framework import Diagram, DiagramBuilder, LeafSystem

from drake_nonstop.run.preparation import LoopMaker, loop_of
from drake_nonstop.run.recording import LogSignals
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.validation import called

# Adds a system beside the loop's diagram, which the builder has already, and returns it.
Viewer = Callable[[DiagramBuilder, Diagram, Scenario], LeafSystem]


class BuiltLoop:
    """A loop's diagram in one with its logs and viewers.

    Attributes:
        nonstop: the loop.
        diagram: that around it.
        logs: take its signals.
        visualizers: what the viewers have added.

    Raises:
        ScenarioError: it cannot be built.
    """

    def __init__(
        self,
        make_loop: LoopMaker,
        scenario: Scenario,
        replacements: dict[str, Any],
        viewers: Sequence[Viewer] = (),
    ):
        self.nonstop = loop_of(make_loop, scenario, replacements)
        builder = DiagramBuilder()
        builder.AddSystem(self.nonstop)
        self.logs = LogSignals(builder, self.nonstop, uses_files=True)
        remedy = "give functions that take the builder, the loop's diagram and the scenario"
        self.visualizers = [
            called("viewers", remedy, viewer, builder, self.nonstop, scenario) for viewer in viewers
        ]
        self.diagram = builder.Build()
