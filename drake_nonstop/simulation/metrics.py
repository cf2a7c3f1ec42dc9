"""The metrics that judge a run, as one table.

`METRICS` has a row per metric, and all that writes or prints metrics reads it: metrics.json,
the table of a run, the tables of an ablation and of a sweep, the quantities of the README's
claims.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np

from drake_nonstop.optimization.diagnostics import BOUND
from drake_nonstop.optimization.limits import LIMITS
from drake_nonstop.simulation.outcome import find_warnings, judge
from drake_nonstop.simulation.run import Run
from drake_nonstop.simulation.run_quantities import RunQuantities
from drake_nonstop.validation import finite
from drake_nonstop.version import __version__

_MOST_SENTENCES = 3  # of a list, in what is printed
_NAME_WIDTH = 24  # characters, of a line's name in the table of a run


def compute_metrics(run: Run) -> dict[str, Any]:
    """The metrics of a run as nested dictionaries, as written to metrics.json.

    Keys end in their units. Speeds, separations, tensions and loads on the aircraft are those
    of the simulated carriers and cables at every step from t = 0 on; errors are those of the
    load's true pose at 100 Hz. The slowest speed, the steepest climb and the least distances are
    also looked for between two steps. A time "below" or "slack" weighs each step's state with
    half of the two intervals beside it. The climb angle is that of the steepest climb or descent;
    it and the turn radius are not meaningful where a carrier nearly stops. Turns and accelerations
    are measured over 0.1 s of the path: over less a carrier follows the ripple of its sampled
    reference. What was not measured, such as the solve times of a layer that solves nothing or the
    delay of a reference without a governor, is None, and so is what is not finite, as of a run
    that a block's NaN ended. The group `aircraft` is that of the simulated
    aircraft, see `AircraftQuantities`, and is missing where there are none. `outcome` is a
    `RunOutcome`, `reasons` and `warnings` are sentences.
    """
    quantities = RunQuantities(run)
    values: dict[str, Any] = {"scenario": run.scenario.name, "is_steered": run.is_steered}
    for metric in METRICS:
        if metric.needs_aircraft and not quantities.has_aircraft:
            continue
        *groups, name = metric.path.split(".")
        group = values
        for key in groups:
            group = group.setdefault(key, {})
        group[name] = finite(metric.measure(quantities))
    if run.half_step is not None:
        values["half_step"] = run.half_step
    values["versions"] = {
        "drake_nonstop": __version__,
        "drake": _version("drake"),
        "numpy": _version("numpy"),
    }
    return values


def _version(package: str) -> str:
    """A package's version, which is not found where own code has changed sys.path."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"


def flattened(metrics: Mapping[str, Any]) -> dict[str, Any]:
    """The metrics that are one value, by their paths, such as "load.position_error_mean_m".

    Sentences, such as the reasons of an outcome, are one text.
    """
    flat: dict[str, Any] = {}
    for key, value in metrics.items():
        if isinstance(value, Mapping):
            flat |= {f"{key}.{path}": inner for path, inner in flattened(value).items()}
        elif not isinstance(value, list):
            flat[key] = value
        elif all(isinstance(item, str) for item in value):
            flat[key] = "; ".join(value)
    return flat


def value_at(metrics: Mapping[str, Any] | None, path: str) -> Any:
    """The metric of a path, such as "load.position_error_mean_m"; None where there is none."""
    value: Any = metrics
    for key in path.split("."):
        value = value.get(key) if isinstance(value, Mapping) else None
    return value


class Better(Enum):
    """Which values of a metric are better."""

    LOWER = -1
    HIGHER = 1
    NEITHER = 0


@dataclass(frozen=True, kw_only=True)
class RunText:
    """A metric's part of a line in the table of a run."""

    line: str  # the line's name
    text: str  # a format of the value as shown, and of the unit
    separator: str = ", "  # before it, unless it is the line's first
    decimals: int | None = None  # that the value is rounded to before
    hides_line_at_zero: bool = False


@dataclass(frozen=True, kw_only=True)
class TableColumn:
    """A metric's column in tables that compare runs.

    `heading` is what a terminal shows, in two lines: columns that share the upper one stand
    together.
    """

    heading: tuple[str, str]
    has_change: bool = False  # one more column has the change against the first run


@dataclass(frozen=True, kw_only=True)
class Metric:
    """How a metric is measured, stored, shown and judged.

    Adding one takes a row in `METRICS`: it is then in metrics.json, in the CSV of an ablation,
    in the table of a sweep and, by its heading, a quantity of claims; with `run_text` and
    `column` it is in the tables for a terminal, too.
    """

    path: str  # in metrics.json, with dots; the last part ends in the unit of the stored value
    measure: Callable[[RunQuantities], Any]
    label: str
    unit: str = ""  # as shown
    scale: float = 1.0  # from the stored value to the one shown
    better: Better = Better.NEITHER
    is_wall_time: bool = False  # measured with a clock: it differs from run to run
    is_list: bool = False  # of numbers or of sentences
    needs_aircraft: bool = False  # left out of metrics.json where the run has none
    run_text: RunText | None = None
    column: TableColumn | None = None

    @property
    def heading(self) -> str:
        """The label with the unit, such as "mean position error (mm)"."""
        return f"{self.label} ({self.unit})" if self.unit else self.label

    def value(self, metrics: Mapping[str, Any] | None) -> Any:
        """The stored value in the metrics of a run; None where there is none."""
        return value_at(metrics, self.path)

    def shown(self, value: Any) -> Any:
        """A stored value in the unit that is shown."""
        return value if self.scale == 1 or value is None else self.scale * value


def _missed(limit: str) -> Callable[[RunQuantities], float | None]:
    """How many updates miss the limit of that name; None: it is not counted."""
    return lambda run: run.missed_limits.get(limit)


METRICS = (
    Metric(
        path="outcome",
        measure=lambda run: judge(run).outcome.value,
        label="outcome",
        run_text=RunText(line="outcome", text="{}"),
        column=TableColumn(heading=("", "outcome")),
    ),
    Metric(
        path="reasons",
        measure=lambda run: list(judge(run).reasons),
        label="reasons",
        is_list=True,
        run_text=RunText(line="outcome", text="{}", separator=": "),
    ),
    Metric(
        path="warnings",
        measure=find_warnings,
        label="warnings",
        is_list=True,
    ),
    Metric(
        path="simulated_s",
        measure=lambda run: run.simulated_time,
        label="simulated time",
        unit="s",
        run_text=RunText(line="simulated", text="{:g} {unit}"),
    ),
    Metric(
        path="simulator.step_s",
        measure=lambda run: run.run.step or run.run.scenario.simulator_config.max_step_size,
        label="longest step",
        unit="ms",
        scale=1e3,
    ),
    Metric(
        path="wall_s",
        measure=lambda run: run.wall_time,
        label="wall time",
        unit="s",
        better=Better.LOWER,
        is_wall_time=True,
        run_text=RunText(line="simulated", text="{:.2f} {unit}", separator=" in "),
    ),
    Metric(
        path="real_time_factor",
        measure=lambda run: run.wall_time and run.simulated_time / run.wall_time,
        label="real-time factor",
        better=Better.HIGHER,
        is_wall_time=True,
        run_text=RunText(line="simulated", text="({:.1f} x real time)", separator=" "),
    ),
    Metric(
        path="load.position_error_mean_m",
        measure=lambda run: float(np.mean(run.position_error)),
        label="mean position error",
        unit="mm",
        scale=1e3,
        better=Better.LOWER,
        run_text=RunText(line="load position error", text="mean {:.3g} {unit}"),
        column=TableColumn(heading=("error (mm)", "mean"), has_change=True),
    ),
    Metric(
        path="load.position_error_max_m",
        measure=lambda run: run.largest_position_error,
        label="largest position error",
        unit="mm",
        scale=1e3,
        better=Better.LOWER,
        run_text=RunText(line="load position error", text="max {:.3g} {unit}"),
        column=TableColumn(heading=("error (mm)", "max")),
    ),
    Metric(
        path="load.position_error_final_m",
        measure=lambda run: float(run.position_error[-1]),
        label="final position error",
        unit="mm",
        scale=1e3,
        better=Better.LOWER,
    ),
    Metric(
        path="load.reference_delay_max_s",
        measure=lambda run: run.reference_delays and run.reference_delays[0],
        label="largest delay of the reference",
        unit="s",
        better=Better.LOWER,
        run_text=RunText(line="reference", text="late by up to {:.3g} {unit}"),
    ),
    Metric(
        path="load.reference_delay_final_s",
        measure=lambda run: run.reference_delays and run.reference_delays[1],
        label="final delay of the reference",
        unit="s",
        better=Better.LOWER,
        run_text=RunText(line="reference", text="{:.3g} {unit} at the end"),
    ),
    Metric(
        path="load.orientation_error_mean_rad",
        measure=lambda run: float(np.mean(run.orientation_error)),
        label="mean orientation error",
        unit="mrad",
        scale=1e3,
        better=Better.LOWER,
        run_text=RunText(line="load orientation error", text="mean {:.3g} {unit}"),
        column=TableColumn(heading=("tilt", "mrad")),
    ),
    Metric(
        path="load.orientation_error_max_rad",
        measure=lambda run: run.largest_orientation_error,
        label="largest orientation error",
        unit="mrad",
        scale=1e3,
        better=Better.LOWER,
        run_text=RunText(line="load orientation error", text="max {:.3g} {unit}"),
    ),
    Metric(
        path="carriers.n",
        measure=lambda run: run.speeds.shape[1],
        label="number of carriers",
    ),
    Metric(
        path="carriers.speed_min_m_s",
        measure=lambda run: run.slowest_speed,
        label="slowest speed",
        unit="m/s",
        better=Better.HIGHER,
        run_text=RunText(line="carrier speed", text="{:.3f}"),
        column=TableColumn(heading=("slow-", "est")),
    ),
    Metric(
        path="carriers.speed_max_m_s",
        measure=lambda run: run.peak_speed,
        label="peak speed",
        unit="m/s",
        run_text=RunText(line="carrier speed", text="{:.3f} {unit}", separator=" to "),
    ),
    Metric(
        path="carriers.speed_final_m_s",
        measure=lambda run: run.speeds[-1].tolist(),
        label="final speeds",
        unit="m/s",
        is_list=True,
    ),
    Metric(
        path="carriers.speed_bound_m_s",
        measure=lambda run: float(run.speed_bounds[-1]),
        label="bound on the speed",
        unit="m/s",
        run_text=RunText(line="carrier speed", text="bound {:g} {unit}"),
    ),
    Metric(
        path="carriers.time_below_bound_s",
        measure=lambda run: run.time_below_bound,
        label="time below the bound",
        unit="s",
        better=Better.LOWER,
        run_text=RunText(line="carrier speed", text="below it for {:.3g} {unit}"),
        column=TableColumn(heading=("below (s)", "time"), has_change=True),
    ),
    Metric(
        path="carriers.separation_min_m",
        measure=lambda run: run.carrier_separation,
        label="closest carriers",
        unit="m",
        better=Better.HIGHER,
        run_text=RunText(line="closest", text="carriers {:g} {unit}", decimals=3),
        column=TableColumn(heading=("apart (m)", "carr.")),
    ),
    Metric(
        path="carriers.normal_acceleration_max_m_s2",
        measure=lambda run: run.sharpest_turn[0],
        label="largest normal acceleration",
        unit="m/s²",
    ),
    Metric(
        path="carriers.acceleration_max_m_s2",
        measure=lambda run: run.largest_acceleration,
        label="largest acceleration",
        unit="m/s²",
    ),
    Metric(
        path="carriers.climb_angle_max_rad",
        measure=lambda run: run.steepest_angle,
        label="steepest climb or descent",
        unit="rad",
    ),
    Metric(
        path="carriers.turn_radius_min_m",
        measure=lambda run: run.sharpest_turn[1],
        label="smallest turn radius",
        unit="m",
    ),
    Metric(
        path="cables.tension_min_N",
        measure=lambda run: run.least_tension,
        label="least tension",
        unit="N",
        better=Better.HIGHER,
        run_text=RunText(line="tension", text="{:.3g}"),
        column=TableColumn(heading=("least", "N")),
    ),
    Metric(
        path="cables.tension_max_N",
        measure=lambda run: run.largest_tension,
        label="largest tension",
        unit="N",
        run_text=RunText(line="tension", text="{:.3g} {unit}", separator=" to "),
    ),
    Metric(
        path="cables.slack_time_s",
        measure=lambda run: run.slack_time,
        label="slack",
        unit="s",
        better=Better.LOWER,
        run_text=RunText(line="tension", text="slack for {:.3g} {unit}"),
        column=TableColumn(heading=("slack", "s")),
    ),
    Metric(
        path="cables.separation_min_m",
        measure=lambda run: float(np.min(run.cable_separations)),
        label="closest cables",
        unit="m",
        better=Better.HIGHER,
        run_text=RunText(line="closest", text="cables {:g} {unit}", decimals=3),
        column=TableColumn(heading=("apart (m)", "cables")),
    ),
    Metric(
        path="aircraft.lift_share_max",
        measure=lambda run: run.flight.largest_lift_share,
        label="largest share of the lift",
        better=Better.LOWER,
        needs_aircraft=True,
        run_text=RunText(line="aircraft", text="up to {:.3g} of the largest lift"),
    ),
    Metric(
        path="aircraft.airspeed_min_m_s",
        measure=lambda run: run.flight.least_airspeed,
        label="least airspeed",
        unit="m/s",
        better=Better.HIGHER,
        needs_aircraft=True,
        run_text=RunText(line="aircraft", text="airspeed from {:.3g} {unit}"),
    ),
    Metric(
        path="aircraft.airspeed_above_bound_min_m_s",
        measure=lambda run: run.least_speed_above_bound,
        label="least airspeed above the bound",
        unit="m/s",
        better=Better.HIGHER,
        needs_aircraft=True,
    ),
    Metric(
        path="aircraft.airspeed_over_stall_min",
        measure=lambda run: run.flight.least_airspeed_over_stall,
        label="least airspeed over the stall speed",
        better=Better.HIGHER,
        needs_aircraft=True,
        run_text=RunText(line="aircraft", text="({:.3g} x stall", separator=" "),
    ),
    Metric(
        path="aircraft.airspeed_over_loaded_stall_min",
        measure=lambda run: run.flight.least_airspeed_over_loaded_stall,
        label="least airspeed over the stall speed with cable and bank",
        better=Better.HIGHER,
        needs_aircraft=True,
        run_text=RunText(line="aircraft", text="{:.3g} x stall with cable and bank)"),
    ),
    Metric(
        path="aircraft.bank_max_rad",
        measure=lambda run: run.flight.largest_bank,
        label="largest bank",
        unit="deg",
        scale=math.degrees(1),
        better=Better.LOWER,
        needs_aircraft=True,
        run_text=RunText(line="aircraft", text="bank up to {:.3g} {unit}"),
    ),
    Metric(
        path="aircraft.thrust_min_N",
        measure=lambda run: run.flight.least_thrust,
        label="least thrust",
        unit="N",
        needs_aircraft=True,
        run_text=RunText(line="thrust", text="{:.3g}"),
    ),
    Metric(
        path="aircraft.thrust_max_N",
        measure=lambda run: run.flight.largest_thrust,
        label="largest thrust",
        unit="N",
        needs_aircraft=True,
        run_text=RunText(line="thrust", text="{:.3g} {unit}", separator=" to "),
    ),
    Metric(
        path="aircraft.thrust_share_min",
        measure=lambda run: run.flight.thrust_shares[0],
        label="least share of the thrust",
        unit="%",
        scale=100,
        needs_aircraft=True,
        run_text=RunText(line="thrust", text="{:.3g}", separator=" ("),
    ),
    Metric(
        path="aircraft.thrust_share_max",
        measure=lambda run: run.flight.thrust_shares[1],
        label="largest share of the thrust",
        unit="%",
        scale=100,
        better=Better.LOWER,
        needs_aircraft=True,
        run_text=RunText(line="thrust", text="{:.3g} {unit} of the largest)", separator=" to "),
    ),
    Metric(
        path="aircraft.saturated_share",
        measure=lambda run: run.saturated_share,
        label="commands saturated",
        unit="% of the time",
        scale=100,
        better=Better.LOWER,
        needs_aircraft=True,
        run_text=RunText(line="thrust", text="commands saturated for {:.3g} {unit}"),
    ),
    Metric(
        path="aircraft.power_mean_W",
        measure=lambda run: run.flight.mean_power,
        label="mean power of an aircraft",
        unit="W",
        better=Better.LOWER,
        needs_aircraft=True,
        run_text=RunText(line="power of an aircraft", text="{:.3g} {unit} of thrust"),
    ),
    Metric(
        path="aircraft.energy_Wh_per_kg_km",
        measure=lambda run: run.flight.energy_per_mass_and_distance,
        label="energy of the transport",
        unit="Wh/(kg km)",
        better=Better.LOWER,
        needs_aircraft=True,
        run_text=RunText(line="power of an aircraft", text="all took {:.3g} {unit}"),
    ),
    Metric(
        path="optimizer.updates",
        measure=lambda run: run.update_counts["updates"],
        label="updates",
        run_text=RunText(line="optimizer", text="{} updates", hides_line_at_zero=True),
    ),
    Metric(
        path="optimizer.kept",
        measure=lambda run: run.update_counts["kept"],
        label="updates kept",
        run_text=RunText(line="optimizer", text="{} kept xi and A", separator=": "),
    ),
    Metric(
        path="optimizer.solved",
        measure=lambda run: run.update_counts["solved"],
        label="updates solved",
        run_text=RunText(line="optimizer", text="{} solved"),
    ),
    Metric(
        path="optimizer.relaxed",
        measure=lambda run: run.update_counts["relaxed"],
        label="updates relaxed",
        better=Better.LOWER,
        run_text=RunText(line="optimizer", text="{} relaxed (not feasible)"),
        column=TableColumn(heading=("re-", "laxed")),
    ),
    Metric(
        path="optimizer.held",
        measure=lambda run: run.update_counts["held"],
        label="updates held",
        better=Better.LOWER,
        run_text=RunText(line="optimizer", text="{} held (no solution)"),
    ),
    *(
        Metric(
            path=f"{group}.missed_limits.{name}",
            measure=_missed(name),
            label=f"updates that miss the limit of the {name.replace('_', ' ')}",
            better=Better.LOWER,
            needs_aircraft=group == "aircraft",
        )
        for group, names in (
            ("optimizer", [limit.name for limit in LIMITS if not limit.is_of_aircraft]),
            ("aircraft", [BOUND, *(limit.name for limit in LIMITS if limit.is_of_aircraft)]),
        )
        for name in names
    ),
    Metric(
        path="optimizer.solve_time_ms.p50",
        measure=lambda run: run.solve_times["p50"],
        label="solve, median",
        unit="ms",
        better=Better.LOWER,
        is_wall_time=True,
    ),
    Metric(
        path="optimizer.solve_time_ms.p99",
        measure=lambda run: run.solve_times["p99"],
        label="solve, p99",
        unit="ms",
        better=Better.LOWER,
        is_wall_time=True,
        column=TableColumn(heading=("p99", "ms")),
    ),
    Metric(
        path="optimizer.solve_time_ms.max",
        measure=lambda run: run.solve_times["max"],
        label="solve, max",
        unit="ms",
        better=Better.LOWER,
        is_wall_time=True,
    ),
    Metric(
        path="optimizer.predicted_speed_margin_m_s",
        measure=lambda run: run.predicted_margin,
        label="computed margin of the speed",
        unit="mm/s",
        scale=1e3,
        better=Better.LOWER,
    ),
    Metric(
        path="optimizer.predicted_speed_margin_of_bound",
        measure=lambda run: run.share_of_bound(run.predicted_margin),
        label="computed margin over the bound",
        better=Better.LOWER,
    ),
    Metric(
        path="optimizer.measured_speed_margin_m_s",
        measure=lambda run: run.measured_margin,
        label="largest shortfall of a speed",
        unit="mm/s",
        scale=1e3,
        better=Better.LOWER,
    ),
    Metric(
        path="optimizer.measured_speed_margin_of_bound",
        measure=lambda run: run.share_of_bound(run.measured_margin),
        label="largest shortfall over the bound",
        better=Better.LOWER,
    ),
    Metric(
        path="optimizer.xi_final_rad_s",
        measure=lambda run: float(run.final_parameters.frequency[0]),
        label="final ξ",
        unit="rad/s",
    ),
    Metric(
        path="optimizer.A_final_N",
        measure=lambda run: float(run.final_parameters.amplitude[0]),
        label="final A",
        unit="N",
    ),
)


def metric_at(path: str) -> Metric:
    """The row of `METRICS` with that path."""
    return next(metric for metric in METRICS if metric.path == path)


def in_brief(sentences: Sequence[str]) -> str:
    """The first few of the sentences, and how many more are in metrics.json."""
    shown, rest = sentences[:_MOST_SENTENCES], sentences[_MOST_SENTENCES:]
    return "; ".join([*shown, *([f"{len(rest)} more in metrics.json"] if rest else [])])


def metrics_table(metrics: Mapping[str, Any]) -> str:
    """The metrics of a run that have a `run_text`, some in each line, for a terminal."""
    lines: dict[str, str] = {}
    hidden = set()
    for metric in METRICS:
        part, value = metric.run_text, metric.shown(metric.value(metrics))
        if part is None or value is None or value == []:
            continue
        if metric.is_list:
            value = in_brief(value)
        if part.hides_line_at_zero and not value:
            hidden.add(part.line)
        if part.decimals is not None:
            value = round(value, part.decimals)
        start = f"{lines[part.line]}{part.separator}" if part.line in lines else ""
        lines[part.line] = start + part.text.format(value, unit=metric.unit)
    shown = (item for item in lines.items() if item[0] not in hidden)
    return "\n".join(f"{name:{_NAME_WIDTH}}{text}" for name, text in shown)
