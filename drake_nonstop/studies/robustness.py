"""How a run changes with errors that its controllers do not know of, one at a time."""

import dataclasses
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from drake_nonstop.model.system import overridden
from drake_nonstop.scenario.loading import dump_scenario, parse_scenario
from drake_nonstop.scenario.overrides import changed
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.simulation.metrics import compute_metrics, flattened
from drake_nonstop.studies.run_all import (
    COMPLETED,
    FAILED,
    UNBUILDABLE,
    Progress,
    attempt,
    no_progress,
    run_all,
)
from drake_nonstop.validation import ScenarioError


@dataclass(kw_only=True)
class Case:
    """A run with one error.

    The figures of a run that did not complete are those up to its end, and NaN where it has no
    samples at all.
    """

    error: str  # what is wrong
    level: float  # by how much
    unit: str  # of the level
    overrides: list[str]  # "path=value"
    outcome: str = COMPLETED  # or "diverged", or "failed": a block raised an error
    message: str = ""  # why it did not complete
    position_error_mean: float = math.nan  # m
    position_error_final: float = math.nan  # m
    orientation_error_mean: float = math.nan  # rad
    speed_margin: float = math.nan  # m/s, the slowest carrier's speed minus ε
    time_below_bound: float = math.nan  # s
    slack_time: float = math.nan  # s

    def as_json(self) -> dict[str, Any]:
        """The fields, with None in place of NaN."""
        return {
            name: None if isinstance(value, float) and math.isnan(value) else value
            for name, value in dataclasses.asdict(self).items()
        }


def robustness(
    scenario: Scenario, *, seed: int = 0, progress: Progress = no_progress
) -> list[Case]:
    """Runs a scenario without error and with each error at some levels, in a process per core.

    The simulated mass, inertia, attachment points and cable length differ from the controllers'
    model; the load's state is measured with noise or delay; a constant or a gusty wind pushes
    the load.

    Args:
        scenario: what the errors are added to.
        seed: of the attachment points' directions, of the noise and of the gusts.
        progress: called with a description and the share that is done.

    Returns:
        The case without error first.

    Raises:
        ScenarioError: the scenario, or one with such an error, cannot be built.
    """
    cases = [
        Case(error=error, level=level, unit=unit, overrides=overrides)
        for error, level, unit, overrides in _errors(scenario, seed)
    ]
    text = dump_scenario(scenario)  # which can be sent to a process

    def failed(key: int, error: str) -> Case:
        return dataclasses.replace(cases[key], outcome=FAILED, message=error)

    run_all(
        _measured,
        range(len(cases)),
        lambda key: (text, cases[key]),
        cases.__setitem__,
        failed,
        progress=progress,
    )
    return cases


def robustness_table(cases: Sequence[Case]) -> str:
    """A line per case in aligned columns, for a terminal."""
    columns = "e_p mean / final, mm", "slowest - bound", "below", "slack"
    lines = ["{:42} {:>20} {:>16} {:>8} {:>8}".format("error", *columns)]
    for case in cases:
        name = f"{case.error} {case.level:+g} {case.unit}" if case.unit else "none"
        errors = f"{1e3 * case.position_error_mean:.3g} / {1e3 * case.position_error_final:.3g}"
        lines.append(
            f"{name:42} {errors:>20} {case.speed_margin:+12.3f} m/s {case.time_below_bound:6.3g} s "
            f"{case.slack_time:6.3g} s{'' if case.outcome == COMPLETED else f'  {case.outcome}'}"
        )
    return "\n".join(lines)


def _errors(scenario: Scenario, seed: int) -> Iterator[tuple[str, float, str, list[str]]]:
    """Name, level, unit and overrides of each error."""
    system = overridden(scenario.system, scenario.simulated)
    yield "none", 0.0, "", []
    for percent in (-20.0, -10.0, 10.0, 20.0):
        mass = system.load_mass * (1 + percent / 100)
        yield "load mass", percent, "%", [f"simulated.load_mass={mass}"]
    for percent in (-50.0, -20.0, 20.0, 50.0):
        inertia = (np.array(system.load_inertia) * (1 + percent / 100)).tolist()
        yield "load inertia", percent, "%", [f"simulated.load_inertia={inertia}"]
    attachments = np.array(system.attachments)
    radius = np.linalg.norm(attachments, axis=1).max()
    directions = np.random.default_rng(seed).standard_normal(attachments.shape)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for percent in (0.5, 1.0, 2.0, 5.0):
        points = (attachments + percent / 100 * radius * directions).tolist()
        yield "attachment points", percent, "% of radius", [f"simulated.attachments={points}"]
    for percent in (-1.0, -0.3, 0.3, 1.0):
        length = system.cable_length * (1 + percent / 100)
        yield "cable length", percent, "%", [f"simulated.cable_length={length}"]
    period = scenario.control_period or 0.01
    for size in (0.0005, 0.001, 0.002, 0.005):
        noise = (
            f"position_noise: {size}, orientation_noise: {size}, velocity_noise: {5 * size}, "
            f"angular_velocity_noise: {5 * size}, seed: {seed}"
        )
        block = f"load_feedback=!NoisyFeedback {{{noise}, period: {period}}}"
        yield "noise", 1e3 * size, "mm, mrad (rates: x 5/s)", [block]
    for periods in (1, 2, 3, 5):
        delay = periods * period
        block = f"load_feedback=!NoisyFeedback {{delay: {delay}, period: {period}}}"
        yield "delay", 1e3 * delay, "ms", [block]
    weight = system.load_mass * system.gravity
    for percent in (1.0, 2.0, 5.0, 10.0):
        force = percent / 100 * weight
        block = f"load_disturbance=!Wind {{force: [0, {force}, 0], start_time: 1.0}}"
        yield "constant wind", percent, "% of weight", [block]
    for percent in (0.5, 1.0, 2.0, 5.0):
        force = percent / 100 * weight
        block = f"load_disturbance=!Wind {{gust_force: {force}, seed: {seed}}}"
        yield "gusty wind", percent, "% of weight (standard deviation)", [block]


def _measured(text: str, case: Case) -> Case:
    """The case with its outcome and figures."""
    # A copy of a scenario that was trusted when it was loaded.
    tried = attempt(lambda: changed(parse_scenario(text, trust=True), case.overrides))
    if tried.outcome == UNBUILDABLE:
        raise ScenarioError(tried.message)
    ended = dataclasses.replace(case, outcome=tried.outcome, message=tried.message)
    if tried.run is None:
        return ended
    figures = flattened(compute_metrics(tried.run))
    return dataclasses.replace(
        ended,
        position_error_mean=figures["load.position_error_mean_m"],
        position_error_final=figures["load.position_error_final_m"],
        orientation_error_mean=figures["load.orientation_error_mean_rad"],
        speed_margin=figures["carriers.speed_min_m_s"] - figures["carriers.speed_bound_m_s"],
        time_below_bound=figures["carriers.time_below_bound_s"],
        slack_time=figures["cables.slack_time_s"],
    )
