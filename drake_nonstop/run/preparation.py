"""Preparation of a flight: its loop, its step, and its warnings."""

from collections.abc import Callable
from typing import Any

from pydrake.systems.analysis import GetIntegrationSchemes
from pydrake.systems.framework import Diagram

from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.run.recording import RUN_SIGNALS
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.systems.block import LOOP
from drake_nonstop.systems.wiring import input_names, require_signals
from drake_nonstop.validation import called, require

# Makes the loop's diagram of a scenario, and of replacements as `make_nonstop` takes them.
LoopMaker = Callable[..., Diagram]


def loop_of(make_loop: LoopMaker, scenario: Scenario, replacements: dict[str, Any]) -> Diagram:
    """The loop's diagram, whose contexts need not start at the equilibrium.

    Raises:
        ScenarioError: it is none, does not export its signals, or has inputs that nothing makes.
    """
    if make_loop is make_nonstop:
        replacements = {"at_equilibrium": False, **replacements}
    remedy = "give a function that takes a scenario and replacements, as make_nonstop does"
    nonstop = called("make_loop", remedy, make_loop, scenario, **replacements)
    require(
        isinstance(nonstop, Diagram), "make_loop", nonstop, "return a Diagram from the function"
    )
    require_signals(nonstop, RUN_SIGNALS, "make_loop")
    missing = ", ".join(input_names(nonstop))
    remedy = "no block makes these signals; give one that does, in a box or as an extra one"
    require(not missing, "inputs", missing, remedy)
    if not nonstop.get_name():
        nonstop.set_name(LOOP)
    return nonstop


def check_simulation(scenario: Scenario) -> None:
    """Raises ScenarioError for what a loop is built without and no run is flown with."""
    schemes = GetIntegrationSchemes()
    require(
        scenario.simulator_config.integration_scheme in schemes,
        "simulator_config.integration_scheme",
        scenario.simulator_config.integration_scheme,
        f"give one of {', '.join(schemes)}",
    )
