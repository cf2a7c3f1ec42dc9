"""What a run makes of errors that its controllers do not know of."""

from collections.abc import Callable, Iterator
from concurrent.futures import as_completed
from dataclasses import dataclass
from typing import Any

import numpy as np

from drake_nonstop.model.system import overridden
from drake_nonstop.scenario.loading import Scenario, changed, dump_scenario, parse_scenario
from drake_nonstop.simulation.metrics import compute_metrics
from drake_nonstop.simulation.simulate import RunStopped, simulate
from drake_nonstop.studies.workers import worker_processes


@dataclass(kw_only=True)
class Case:
    """A run with one error; figures of a run that diverged are those up to there.

    `speed_margin` is the slowest carrier's speed minus ε, both in m/s.
    """

    error: str  # what is wrong
    level: float  # by how much
    unit: str
    settings: list[str]
    completed: bool
    position_error_mean: float  # m
    position_error_final: float  # m
    orientation_error_mean: float  # rad
    speed_margin: float
    time_below_bound: float  # s
    slack_time: float  # s


def robustness(
    scenario: Scenario,
    *,
    seed: int = 0,
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> list[Case]:
    """Runs a scenario without and with each error at some levels, in a process per core.

    The simulated mass, inertia, attachment points and cable length differ from what the
    controllers believe; the load's state comes with noise or late; a constant or a gusty
    wind pushes the load. `seed` is that of the attachments' directions, the noise and the gust.

    Raises:
        ScenarioError: the scenario, or one with such an error, cannot be built.
    """
    errors = list(_errors(scenario, seed))
    text = dump_scenario(scenario)  # which can be sent to a process
    cases: dict[int, Case] = {}
    with worker_processes() as executor:
        futures = {executor.submit(_case, text, *error): k for k, error in enumerate(errors)}
        for done, future in enumerate(as_completed(futures)):
            cases[futures[future]] = future.result()
            progress("simulating", (done + 1) / len(errors))
    return [cases[k] for k in range(len(errors))]


def _errors(scenario: Scenario, seed: int) -> Iterator[tuple[str, float, str, list[str]]]:
    """Name, level, unit and settings of each error."""
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


def _case(text: str, error: str, level: float, unit: str, settings: list[str]) -> Case:
    # A copy of a scenario that was trusted when it was loaded.
    scenario = changed(parse_scenario(text, trust=True), settings)
    completed = True
    try:
        run = simulate(scenario)
    except RunStopped as stopped:
        run, completed = stopped.run, False
    figures: dict[str, Any] = compute_metrics(run)
    load, carriers = figures["load"], figures["carriers"]
    return Case(
        error=error,
        level=level,
        unit=unit,
        settings=settings,
        completed=completed,
        position_error_mean=load["position_error_mean_m"],
        position_error_final=load["position_error_final_m"],
        orientation_error_mean=load["orientation_error_mean_rad"],
        speed_margin=carriers["speed_min_m_s"] - carriers["speed_bound_m_s"],
        time_below_bound=carriers["time_below_bound_s"],
        slack_time=figures["cables"]["slack_time_s"],
    )
