"""Preparation of a flight: its loop, its step, and its warnings."""

import contextlib
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from pydrake.systems.analysis import GetIntegrationSchemes
from pydrake.systems.framework import Context, Diagram, System

from drake_nonstop.analysis.aircraft_margins import aircraft_margins_for
from drake_nonstop.analysis.formation import growth_complaint
from drake_nonstop.analysis.task import is_known, task_at
from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.loop.equilibrium import block_named
from drake_nonstop.loop.traced_start import TracedStart
from drake_nonstop.scenario.proportions import out_of_proportion
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.simulation.recording import RUN_SIGNALS
from drake_nonstop.simulation.step_size import ChosenStep, chosen_step
from drake_nonstop.systems.block import LOOP
from drake_nonstop.systems.wiring import innermost, input_names, nested, require_signals
from drake_nonstop.validation import ScenarioError, called, require, require_ranges, warn_user

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
    require_ranges("scene", scenario.scene)


def with_chosen_step(
    scenario: Scenario, nonstop: Diagram, context: Context, traced: TracedStart | None = None
) -> ChosenStep:
    """The scenario's `simulator_config`, or one with a shorter step, which a warning tells."""
    try:
        with block_named(nonstop, context):
            chosen = chosen_step(
                scenario.simulator_config,
                nonstop,
                context,
                control_period=scenario.control_period,
                duration=scenario.simulation_duration,
                length=scenario.system.cable_length,
                traced=traced,
            )
    except ScenarioError as error:
        raise ScenarioError("; ".join([str(error), *out_of_proportion(scenario)])) from None
    if chosen.reasons:
        warn_user(
            f"simulator_config.max_step_size = {scenario.simulator_config.max_step_size:g}: "
            f"steps of {chosen.config.max_step_size:.3g} s are taken instead, for the sake of "
            f"{' and '.join(chosen.reasons)}"
        )
    return chosen


def warn_of_margins(
    scenario: Scenario, nonstop: Diagram, context: Context, described: Mapping[str, System]
) -> None:
    """Warns where aircraft cannot fly the orbit above the resting load within their limits.

    The blocks `described` are as of `warn_of_growth`.
    """
    if not nonstop.HasOutputPort("aircraft_state"):
        return
    with contextlib.suppress(ScenarioError):  # there is no such orbit
        loop, context = innermost(nonstop, context, RUN_SIGNALS)
        found = aircraft_margins_for(scenario, loop, context, described)
        if not found.is_flyable:
            message = f"{found.verdict}; drake-nonstop check shows all margins"
            warn_user(message)


def _growth_complaint(
    scenario: Scenario,
    nonstop: Diagram,
    context: Context,
    time: float,
    described: Mapping[str, System],
    *,
    in_samples: bool = False,
) -> str:
    """A sentence on a formation that is unstable at the start, in a flight of a time in s."""
    with contextlib.suppress(ScenarioError):  # what is no formation
        loop, context = innermost(nonstop, context, RUN_SIGNALS)
        if is_known(loop):
            task = task_at(scenario, loop, context, described)
            return growth_complaint(task, time, in_samples=in_samples)
    return ""


def warn_of_growth(
    scenario: Scenario, nonstop: Diagram, context: Context, described: Mapping[str, System]
) -> None:
    """Warns where a small deviation of the load grows from the start on.

    The blocks `described` tell what they do in place of those of their boxes in the loop.
    """
    duration = scenario.simulation_duration
    complaint = _growth_complaint(scenario, nonstop, context, duration, described)
    if complaint:
        warn_user(complaint)


_FOUR_DIGITS: Any = {"float_kind": "{:.4g}".format}


def cause_of_divergence(scenario: Scenario, nonstop: Diagram, time: float) -> str:
    """Why a run may have diverged at a time in s, and the gains with which it did."""
    cause = "; ".join(out_of_proportion(scenario))
    if not cause:
        context = nonstop.CreateDefaultContext()
        cause = _growth_complaint(scenario, nonstop, context, time, {}, in_samples=True)
    cause = cause or "the loop may be unstable, or simulator_config.max_step_size too large"
    gains = [
        f"{block.get_name()}.{name} = {np.array2string(np.asarray(value), formatter=_FOUR_DIGITS)}"
        for block in nested(nonstop, RUN_SIGNALS)[-1].GetSystems()
        for name, value in getattr(block, "gains", {}).items()
    ]
    return f"{cause}; gains in use: {', '.join(gains)}" if gains else cause


def warn_of_other_bound(nonstop: Diagram, context: Context, stated: float) -> None:
    """Warns where a replacement brings a speed bound of its own, by which a run is judged."""
    if nonstop.HasOutputPort("speed_bound") and not nonstop.HasOutputPort("speed_bound_command"):
        (own,) = nonstop.GetOutputPort("speed_bound").Eval(context)
        if own != stated:
            message = (
                f"optimization_layer: the run is judged by the {own:g} m/s of the replacement, "
                f"not by the scenario's speed bound of {stated:g} m/s"
            )
            warn_user(message)
