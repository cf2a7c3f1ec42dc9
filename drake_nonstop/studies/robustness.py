"""How a run changes with errors that its controllers do not know of, one at a time."""

import dataclasses
import functools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from drake_nonstop.blocks.load_feedback import EstimatedFeedbackConfig, NoisyFeedbackConfig
from drake_nonstop.model.system import overridden
from drake_nonstop.run.metrics import METRICS, Metric, compute_metrics, metric_at
from drake_nonstop.run.outcome import RunOutcome
from drake_nonstop.scenario.loading import dump_scenario, parse_scenario
from drake_nonstop.scenario.overrides import changed
from drake_nonstop.scenario.schema import Scenario, sample
from drake_nonstop.studies.journal import open_journal, settings_of
from drake_nonstop.studies.processes import require_main
from drake_nonstop.studies.run_all import (
    COMPLETED,
    FAILED,
    UNBUILDABLE,
    Progress,
    attempts,
    no_progress,
    run_all,
)
from drake_nonstop.validation import ScenarioError, require_seed

_REASONS = "reasons"  # paths of metrics that are lists of sentences, kept with those that are not
_WARNINGS = "warnings"
_RESULT = {"ending": str, "message": str, "metrics": dict}

# Of a filter: its fields beyond those of what it filters.
_BELIEFS = [
    part.name
    for part in dataclasses.fields(EstimatedFeedbackConfig)
    if not hasattr(NoisyFeedbackConfig, part.name)
]
_MOST_SAID = 3  # sentences on a case in the table

# Which metrics the table and the figure show.
POSITION_ERROR_MEAN = metric_at("load.position_error_mean_m")
_SLOWEST_SPEED = metric_at("carriers.speed_min_m_s")
_SPEED_BOUND = metric_at("carriers.speed_bound_m_s")
_COLUMNS = (
    POSITION_ERROR_MEAN,
    metric_at("load.position_error_final_m"),
    metric_at("carriers.time_below_bound_s"),
    metric_at("cables.slack_time_s"),
)


@dataclass(kw_only=True)
class Case:
    """A run with one error.

    The metrics of a run that did not complete are those up to its end; there are none where it
    has no samples at all.
    """

    error: str  # what is wrong
    level: float  # by how much
    unit: str  # of the level
    overrides: list[str]  # "path=value"
    # Or "diverged", "failed": a block raised an error, or "unbuildable": with this error there is
    # no such loop.
    ending: str = COMPLETED
    message: str = ""  # why it did not complete
    # By path, no wall times among them. "warnings" has those of the step that was chosen, too.
    metrics: dict[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Such as "load mass -20 %"; "none" for the case without error."""
        return f"{self.error} {self.level:+g} {self.unit}" if self.unit else self.error

    @property
    def said(self) -> list[str]:
        """Why the outcome is not ok, and what else is not as it should be."""
        reasons = self.metrics.get(_REASONS, [self.message] if self.message else [])
        return [*reasons, *self.metrics.get(_WARNINGS, [])]

    @property
    def speed_margin(self) -> float:
        """The slowest carrier's speed minus ε, in m/s; NaN without metrics."""
        return self.shown(_SLOWEST_SPEED) - self.shown(_SPEED_BOUND)

    def shown(self, metric: Metric) -> float:
        """A metric in the unit that is shown; NaN where there is none."""
        value = metric.shown(self.metrics.get(metric.path))
        return math.nan if value is None else value


def robustness(
    scenario: Scenario,
    *,
    seed: int = 0,
    folder: str | Path | None = None,
    restart: bool = False,
    progress: Progress = no_progress,
) -> list[Case]:
    """Runs a scenario without error and with each error at some levels, in a process per core.

    The simulated mass, inertia, attachment points and cable length differ from the controllers'
    model; the load's state is measured with noise or delay; a constant or a gusty force pushes
    the load.

    The seed is that of the attachment points' directions, of the noise and of the gusts. A folder
    gets a journal of the cases as they come: interrupted, the same call continues from there unless
    it is to `restart`; complete, it begins again. The case without error is the first.

    Raises:
        ScenarioError: the scenario without error cannot be built, processes end as they start, or
            the folder cannot be written, or has unfinished runs of other settings.
        StudyInterrupted: Ctrl-C; the cases that are done stay in the folder.
    """
    require_main()
    require_seed("seed", seed)
    scenario, _ = sample(scenario)
    text = dump_scenario(scenario)  # which can be sent to a process
    cases = [
        Case(error=error, level=level, unit=unit, overrides=overrides)
        for error, level, unit, overrides in _errors(scenario, seed)
    ]
    settings = robustness_settings(scenario, seed)
    keys = range(len(cases))
    with open_journal(folder, settings, keys, _RESULT, restart=restart, what="cases") as journal:

        def so_far() -> str:
            ended = [(k, journal.result(k)["metrics"].get("outcome")) for k in keys if k in journal]
            missed = [cases[k].name for k, outcome in ended if outcome != RunOutcome.OK.value]
            last = f" ({missed[-1]})" if missed else ""
            return f"simulating, {len(missed)} of {len(ended)} not ok{last}"

        run_all(
            _measured,
            keys,
            lambda key: (text, cases[key].overrides),
            journal.record,
            lambda key, error: {"ending": FAILED, "message": error, "metrics": {}},
            done=journal,
            what=so_far,
            progress=progress,
            is_of_many=True,
        )
        journal.finish()
        return [dataclasses.replace(case, **journal.result(k)) for k, case in enumerate(cases)]


def robustness_settings(scenario: Scenario, seed: int) -> str:
    """A name of all that the results depend on; see `settings_of`."""
    return settings_of("robustness", dump_scenario(scenario), str(seed))


def robustness_table(cases: Sequence[Case]) -> str:
    """A line per case in aligned columns, for a terminal, and below it what is said of its run."""
    heading = f"e_p mean / final, {POSITION_ERROR_MEAN.quantity.unit}"
    lines = [f"{'error':42} {heading:>20}  slowest - bound    below    slack  outcome"]
    for case in cases:
        mean, final, below, slack = map(case.shown, _COLUMNS)
        errors = f"{mean:.3g} / {final:.3g}"
        lines.append(
            f"{case.name:42} {errors:>20} {case.speed_margin:+12.3f} m/s "
            f"{below:6.3g} s {slack:6.3g} s"
            f"  {case.metrics.get('outcome', '-')}"
            f"{'' if case.ending == COMPLETED else f'  {case.ending}'}"
        )
        said = case.said
        lines += [f"    {sentence}" for sentence in said[:_MOST_SAID]]
        if len(said) > _MOST_SAID:
            lines.append(f"    and {len(said) - _MOST_SAID} more")
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
        length = (np.array(system.cable_length) * (1 + percent / 100)).tolist()
        yield "cable length", percent, "%", [f"simulated.cable_length={length}"]
    period = scenario.control_period or 0.01
    measurement = f"load_feedback=!NoisyFeedback {{period: {period}, "
    if isinstance(scenario.load_feedback, EstimatedFeedbackConfig):  # the filter stays
        fields = "".join(f"{name}: {getattr(scenario.load_feedback, name)}, " for name in _BELIEFS)
        measurement = f"load_feedback=!EstimatedFeedback {{{fields}period: {period}, "
    for size in (0.0005, 0.001, 0.002, 0.005):
        noise = (
            f"position_noise: {size}, orientation_noise: {size}, velocity_noise: {5 * size}, "
            f"angular_velocity_noise: {5 * size}, seed: {seed}}}"
        )
        yield "noise", 1e3 * size, "mm, mrad (rates: x 5/s)", [measurement + noise]
    for periods in (1, 2, 3, 5):
        delay = periods * period
        yield "delay", 1e3 * delay, "ms", [f"{measurement}delay: {delay}}}"]
    push = "load_disturbance=!DisturbanceForce"
    weight = system.load_mass * system.gravity
    for percent in (1.0, 2.0, 5.0, 10.0):
        force = f"{push} {{force: [0, {percent / 100 * weight}, 0], start_time: 1.0}}"
        yield "constant force", percent, "% of weight", [force]
    for percent in (0.5, 1.0, 2.0, 5.0):
        force = f"{push} {{gust_force: {percent / 100 * weight}, seed: {seed}}}"
        yield "gusty force", percent, "% of weight (standard deviation)", [force]


def _measured(
    calls: Sequence[tuple[str, Sequence[str]]],
) -> Iterator[tuple[int, dict[str, Any]]]:
    """The numbers of cases, how their runs ended, and their metrics.

    Raises:
        ScenarioError: this process cannot read the scenario, or cannot build it without overrides.
    """
    # A copy of a scenario that was trusted when it was loaded; what it cannot be read for here,
    # such as a module that this process lacks, is no fault of a case.
    scenarios = [parse_scenario(text, trust=True) for text, _ in calls]
    runs: list[Any] = [
        (functools.partial(changed, scenario, overrides), {})
        for scenario, (_, overrides) in zip(scenarios, calls, strict=True)
    ]
    for k, tried in attempts(runs, is_recording=True):
        if tried.ending == UNBUILDABLE and not calls[k][1]:
            raise ScenarioError(tried.message) from tried.error
        values: dict[str, Any] = {}
        if tried.run is not None:
            metrics = compute_metrics(tried.run)
            kept = (
                metric
                for metric in METRICS
                if not metric.is_wall_time
                and (not metric.is_list or metric.path in (_REASONS, _WARNINGS))
            )
            values = {metric.path: metric.value(metrics) for metric in kept}
        values[_WARNINGS] = list(dict.fromkeys([*tried.told, *values.get(_WARNINGS, [])]))
        yield k, {"ending": tried.ending, "message": tried.message, "metrics": values}
