"""A loop that has been built with its logs, for one run or for several that differ in numbers."""

import warnings
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

from pydrake.systems.framework import Context, Diagram, DiagramBuilder, LeafSystem, System

from drake_nonstop.diagrams.nonstop import BOXES, make_nonstop
from drake_nonstop.loop.assembly import make_block, models_of
from drake_nonstop.loop.compiled_loop import CompiledLoop
from drake_nonstop.loop.numbers import LoopNumbers, take_numbers
from drake_nonstop.scenario.schema import Scenario, comparable
from drake_nonstop.simulation.preparation import LoopMaker, loop_of
from drake_nonstop.simulation.recording import LogSignals
from drake_nonstop.systems.block import is_of_package
from drake_nonstop.validation import ScenarioError, called

# Adds a system beside the loop's diagram, which the builder has already, and returns it.
Viewer = Callable[[DiagramBuilder, Diagram, Scenario], LeafSystem]

_MOST = 4  # loops that are kept at a time
_STRUCTURE = ("control_period", "pattern")  # fields that loops are built for
# Boxes whose blocks tell analyses at the start of a run what they do.
_DESCRIBED = (
    "load_feedback",
    "wrench_controller",
    "force_distribution",
    "carrier_trajectory",
    "carrier_controller",
    "carrier_dynamics",
    "wind",
    "wind_estimator",
)


class BuiltLoop:
    """A loop's diagram in one with its logs and viewers.

    Attributes:
        nonstop: the loop.
        diagram: that around it.
        logs: take its signals.
        visualizers: what the viewers have added.
        compiled: loops that were compiled of it, by what they take of the integrator's config.

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
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            self.nonstop = loop_of(make_loop, scenario, replacements)
        for warning in told:
            about = warning.filename, warning.lineno
            warnings.warn_explicit(warning.message, warning.category, *about)
        builder = DiagramBuilder()
        builder.AddSystem(self.nonstop)
        self.logs = LogSignals(builder, self.nonstop, uses_files=True)
        remedy = "give functions that take the builder, the loop's diagram and the scenario"
        self.visualizers = [
            called("viewers", remedy, viewer, builder, self.nonstop, scenario) for viewer in viewers
        ]
        self.diagram = builder.Build()
        self.compiled: dict[Any, CompiledLoop] = {}
        self._scenario, self._start = scenario, self.diagram.CreateDefaultContext()
        self.can_be_shared = (
            make_loop is make_nonstop
            and not (replacements or viewers or told)
            and goes_by_numbers(self.nonstop, scenario)
        )

    def context(self) -> Context:
        """A new context of the diagram, as it was built."""
        return self._start.Clone()

    def context_for(self, scenario: Scenario) -> tuple[Context, dict[str, System]] | None:
        """A new context with the numbers of another scenario, and the blocks that describe these.

        None: another loop has to be built for them.
        """
        if not self.can_be_shared:
            return None
        context = self.context()
        loop_context = self.nonstop.GetMyMutableContextFromRoot(context)
        numbers = take_scenario(self.nonstop, loop_context, self._scenario, scenario)
        return None if numbers is None else (context, _descriptions(*numbers))


def goes_by_numbers(nonstop: Diagram, scenario: Scenario) -> bool:
    """Whether a context of a scenario's loop has all that follows from the scenario's numbers."""
    return (
        scenario.reference_governor is None
        and getattr(nonstop, "speed_margin", None) is None
        and all(map(is_of_package, nonstop.GetSystems()))
    )


def take_scenario(
    nonstop: Diagram,
    context: Context,
    built: Scenario,
    scenario: Scenario,
    left_out: Collection[str] = (),
) -> tuple[LoopNumbers, LoopNumbers] | None:
    """Sets a new context of a loop, which `goes_by_numbers`, to those of another scenario.

    Returns the numbers that it was built with, and those set; None where another loop has to be
    built for it. Boxes that are left out do not count.
    """
    is_like = scenario.reference_governor is None and all(
        comparable(getattr(scenario, k)) == comparable(getattr(built, k)) for k in _STRUCTURE
    )
    try:
        numbers = _numbers_of(built, left_out), _numbers_of(scenario, left_out)
        return numbers if is_like and take_numbers(nonstop, context, *numbers) else None
    except ScenarioError:  # which is told as it is built
        return None


def _numbers_of(scenario: Scenario, left_out: Collection[str] = ()) -> LoopNumbers:
    believed, simulated = models_of(scenario)
    configs = {name: getattr(scenario, name) for name in BOXES if name not in left_out}
    return LoopNumbers({"system": believed, "simulated": simulated}, configs)


def _descriptions(built: LoopNumbers, taken: LoopNumbers) -> dict[str, System]:
    """Blocks of boxes that are described by other numbers than they were built with."""
    found = {}
    for name in _DESCRIBED:
        role, config = "simulated" if BOXES[name].is_simulated else "system", taken.configs[name]
        model, old = taken.models[role], built.models[role]
        if config is not None and (model.system, config) != (old.system, built.configs[name]):
            found[name] = make_block(BOXES, name, config, model)
    return found


class SharedLoops:
    """Loops that several runs share: none is built where one differs in numbers alone.

    The loops that have been used last are kept.
    """

    def __init__(self) -> None:
        self._loops: list[BuiltLoop] = []

    def find(
        self, make_loop: LoopMaker, scenario: Scenario, replacements: Mapping[str, Any]
    ) -> tuple[BuiltLoop, Context, dict[str, System]] | None:
        """A loop, as of `BuiltLoop.context_for`; None: there is none yet."""
        if make_loop is not make_nonstop or replacements:
            return None
        for built in self._loops:
            found = built.context_for(scenario)
            if found is not None:
                self._loops.remove(built)
                self._loops.append(built)
                return built, *found
        return None

    def add(self, built: BuiltLoop) -> None:
        """Takes a loop that was built."""
        if built.can_be_shared:
            self._loops = [*self._loops, built][-_MOST:]
