"""The metrics that judge a run, as one table.

`METRICS` has a row per metric, and all that writes or prints metrics reads it: metrics.json,
the table of a run, the tables of an ablation and of a sweep, the quantities of the README's
claims.
"""

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from drake_nonstop.planning.diagnostics import BOUND
from drake_nonstop.planning.limits import LIMITS
from drake_nonstop.run.outcome import find_warnings, judge
from drake_nonstop.run.run import Run
from drake_nonstop.run.run_quantities import RunQuantities
from drake_nonstop.run.versions import versions
from drake_nonstop.validation import finite

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
    aircraft, see `RunQuantities`, and is missing where there are none, as is the group `obstacles`,
    and `bowed_cables` where cables have no nodes; other tensions are those at the load.
    `outcome` is a `RunOutcome`, `reasons` and `warnings` are sentences. A run that stopped before
    its first sample has these, and no values.
    """
    quantities = RunQuantities(run)
    values: dict[str, Any] = {"scenario": run.scenario.name, "is_steered": run.is_steered}
    is_there = {
        "aircraft": quantities.has_aircraft,
        "bowed_cables": quantities.has_nodes,
        "obstacles": run.scenario.obstacles,
    }
    is_flown = len(run.time) > 0
    absent = [group for group, has_any in is_there.items() if not has_any]
    for metric in METRICS:
        *groups, name = metric.path.split(".")
        if groups and groups[0] in absent:
            continue
        group = values
        for key in groups:
            group = group.setdefault(key, {})
        if is_flown or metric.is_of_nothing:
            group[name] = finite(metric.measure(quantities))
        else:
            group[name] = [] if metric.is_list else None
    if run.half_step is not None:
        values["half_step"] = run.half_step
    # None is found where own code has changed sys.path.
    values["versions"] = {k: v or "unknown" for k, v in versions("drake", "numpy").items()}
    return values


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


# Which values of a metric are better.
LOWER, NEITHER, HIGHER = -1, 0, 1


class Quantity(NamedTuple):
    """How a metric is named, shown and compared."""

    label: str
    unit: str = ""  # as shown
    scale: float = 1.0  # from the stored value to the one shown
    better: int = NEITHER


class RunText(NamedTuple):
    """A metric's part of a line in the table of a run."""

    line: str  # the line's name
    text: str  # a format of the value as shown, and of the unit
    separator: str = ", "  # before it, unless it is the line's first
    decimals: int | None = None  # that the value is rounded to before
    hides_line_at_zero: bool = False


class TableColumn(NamedTuple):
    """A metric's column in tables that compare runs, with its heading of two lines.

    Columns that share the upper line stand together.
    """

    upper: str
    lower: str
    has_change: bool = False  # one more column has the change against the first run


class Metric(NamedTuple):
    """How a metric is measured, stored, shown and judged.

    Adding one takes a row in `_ROWS`: it is then in metrics.json, in the CSV of an ablation, in the
    table of a sweep and, by its heading, a quantity of claims; with `text` and `column` it is in
    the tables for a terminal, too.
    """

    measure: Callable[[RunQuantities], Any]
    quantity: Quantity
    text: RunText | None = None
    column: TableColumn | None = None
    is_wall_time: bool = False  # or what it depends on: it differs from run to run
    is_list: bool = False  # of numbers or of sentences
    path: str = ""  # in metrics.json, with dots

    @property
    def heading(self) -> str:
        """The label with the unit, such as "mean position error (mm)"."""
        label, unit, *_ = self.quantity
        return f"{label} ({unit})" if unit else label

    @property
    def is_of_nothing(self) -> bool:
        """Whether it is measured of a run without samples, too."""
        return self.path in ("outcome", "reasons", "simulator.step_s", "engine")

    def value(self, metrics: Mapping[str, Any] | None) -> Any:
        """The stored value in the metrics of a run; None where there is none."""
        return value_at(metrics, self.path)

    def shown(self, value: Any) -> Any:
        """A stored value in the unit that is shown."""
        scale = self.quantity.scale
        return value if scale == 1 or value is None else scale * value


def _missed_updates(run: RunQuantities, limit: str) -> float | None:
    """How many updates miss a limit; None: it is not counted."""
    return run.missed_limits.get(limit)


# By their paths in metrics.json, with dots; the last part ends in the unit of the stored value.
_ROWS: dict[str, Metric] = {
    "outcome": Metric(
        lambda run: judge(run).outcome.value,
        Quantity("outcome"),
        RunText("outcome", "{}"),
        TableColumn("", "outcome"),
    ),
    "reasons": Metric(
        lambda run: list(judge(run).reasons),
        Quantity("reasons"),
        RunText("outcome", "{}", ": "),
        is_list=True,
    ),
    "warnings": Metric(find_warnings, Quantity("warnings"), is_list=True),
    "simulated_s": Metric(
        lambda run: run.time[-1],
        Quantity("simulated time", "s"),
        RunText("simulated", "{:g} {unit}"),
    ),
    "simulator.step_s": Metric(
        lambda run: run.run.step or run.scenario.simulator_config.max_step_size,
        Quantity("longest step", "ms", 1e3),
    ),
    "wall_s": Metric(
        lambda run: run.run.wall_time,
        Quantity("wall time", "s", better=LOWER),
        RunText("simulated", "{:.2f} {unit}", " in "),
        is_wall_time=True,
    ),
    "real_time_factor": Metric(
        lambda run: run.time[-1] / run.run.wall_time,
        Quantity("real-time factor", better=HIGHER),
        RunText("simulated", "({:.1f} x real time)", " "),
        is_wall_time=True,
    ),
    "engine": Metric(
        lambda run: run.run.engine,
        Quantity("engine"),
        RunText("engine", "{}"),
        is_wall_time=True,
    ),
    "load.position_error_mean_m": Metric(
        lambda run: np.mean(run.position_error),
        Quantity("mean position error", "mm", 1e3, LOWER),
        RunText("load position error", "mean {:.3g} {unit}"),
        TableColumn("error (mm)", "mean", has_change=True),
    ),
    "load.position_error_max_m": Metric(
        lambda run: np.max(run.position_error),
        Quantity("largest position error", "mm", 1e3, LOWER),
        RunText("load position error", "max {:.3g} {unit}"),
        TableColumn("error (mm)", "max"),
    ),
    "load.position_error_final_m": Metric(
        lambda run: run.position_error[-1], Quantity("final position error", "mm", 1e3, LOWER)
    ),
    "load.reference_delay_max_s": Metric(
        lambda run: run.reference_delay,
        Quantity("largest delay of the reference", "s", better=LOWER),
        RunText("reference", "late by up to {:.3g} {unit}"),
    ),
    "load.orientation_error_mean_rad": Metric(
        lambda run: np.mean(run.orientation_error),
        Quantity("mean orientation error", "mrad", 1e3, LOWER),
        RunText("load orientation error", "mean {:.3g} {unit}"),
        TableColumn("tilt", "mrad"),
    ),
    "load.orientation_error_max_rad": Metric(
        lambda run: np.max(run.orientation_error),
        Quantity("largest orientation error", "mrad", 1e3, LOWER),
        RunText("load orientation error", "max {:.3g} {unit}"),
    ),
    "carriers.n": Metric(lambda run: run.speeds.shape[1], Quantity("number of carriers")),
    "carriers.speed_min_m_s": Metric(
        lambda run: run.slowest_speed,
        Quantity("slowest speed", "m/s", better=HIGHER),
        RunText("carrier speed", "{:.3f}"),
        TableColumn("slow-", "est"),
    ),
    "carriers.speed_max_m_s": Metric(
        lambda run: np.max(run.speeds),
        Quantity("peak speed", "m/s"),
        RunText("carrier speed", "{:.3f} {unit}", " to "),
    ),
    "carriers.speed_final_m_s": Metric(
        lambda run: run.speeds[-1].tolist(), Quantity("final speeds", "m/s"), is_list=True
    ),
    "carriers.speed_bound_m_s": Metric(
        lambda run: run.speed_bounds[-1],
        Quantity("bound on the speed", "m/s"),
        RunText("carrier speed", "bound {:g} {unit}"),
    ),
    "carriers.time_below_bound_s": Metric(
        lambda run: run.time_below_bound,
        Quantity("time below the bound", "s", better=LOWER),
        RunText("carrier speed", "below it for {:.3g} {unit}"),
        TableColumn("below (s)", "time", has_change=True),
    ),
    "carriers.separation_min_m": Metric(
        lambda run: run.carrier_separation,
        Quantity("closest carriers", "m", better=HIGHER),
        RunText("closest", "carriers {:g} {unit}", decimals=3),
        TableColumn("apart (m)", "carr."),
    ),
    "carriers.acceleration_max_m_s2": Metric(
        lambda run: run.largest_acceleration, Quantity("largest acceleration", "m/s²")
    ),
    "cables.tension_min_N": Metric(
        lambda run: np.min(run.tensions),
        Quantity("least tension", "N", better=HIGHER),
        RunText("tension", "{:.3g}"),
        TableColumn("least", "N"),
    ),
    "cables.tension_max_N": Metric(
        lambda run: np.max(run.tensions),
        Quantity("largest tension", "N"),
        RunText("tension", "{:.3g} {unit}", " to "),
    ),
    "cables.slack_time_s": Metric(
        lambda run: run.slack_time,
        Quantity("slack", "s", better=LOWER),
        RunText("tension", "slack for {:.3g} {unit}"),
        TableColumn("slack", "s"),
    ),
    "bowed_cables.bow_max_m": Metric(
        lambda run: np.max(run.bows),
        Quantity("largest bow", "m"),
        RunText("bowed cables", "up to {:.3g} {unit} from the chord"),
    ),
    "cables.separation_min_m": Metric(
        lambda run: np.min(run.cable_separations),
        Quantity("closest cables", "m", better=HIGHER),
        RunText("closest", "cables {:g} {unit}", decimals=3),
        TableColumn("apart (m)", "cables"),
    ),
    "obstacles.approaches": Metric(
        lambda run: [each.sentence.format(f"{each.distance:.3g} m") for each in run.approaches],
        Quantity("nearest obstacles"),
        RunText("obstacles", "{}"),
        is_list=True,
    ),
    **{
        f"obstacles.{kind}_distance_min_m": Metric(
            functools.partial(RunQuantities.obstacle_distance, kind=kind),
            Quantity(f"least distance of obstacles from {bodies}", "m", better=HIGHER),
        )
        for kind, bodies in (("load", "the load"), ("cable", "cables"), ("carrier", "carriers"))
    },
    "aircraft.lift_share_max": Metric(
        lambda run: run.ranges.lift_share[1],
        Quantity("largest share of the lift", better=LOWER),
        RunText("aircraft", "up to {:.3g} of the largest lift"),
    ),
    "aircraft.airspeed_min_m_s": Metric(
        lambda run: run.ranges.airspeed[0],
        Quantity("least airspeed", "m/s", better=HIGHER),
        RunText("aircraft", "airspeed from {:.3g} {unit}"),
    ),
    "aircraft.airspeed_over_stall_min": Metric(
        lambda run: run.ranges.over_stall[0],
        Quantity("least airspeed over the stall speed", better=HIGHER),
        RunText("aircraft", "({:.3g} x stall", " "),
    ),
    "aircraft.airspeed_over_loaded_stall_min": Metric(
        lambda run: run.ranges.over_loaded_stall[0],
        Quantity("least airspeed over the stall speed with cable and bank", better=HIGHER),
        RunText("aircraft", "{:.3g} x stall with cable and bank)"),
    ),
    "aircraft.bank_max_rad": Metric(
        lambda run: max(map(abs, run.ranges.bank)),
        Quantity("largest bank", "deg", math.degrees(1), LOWER),
        RunText("aircraft", "bank up to {:.3g} {unit}"),
    ),
    "aircraft.thrust_min_N": Metric(
        lambda run: run.ranges.thrust[0],
        Quantity("least thrust", "N"),
        RunText("thrust", "{:.3g}"),
    ),
    "aircraft.thrust_max_N": Metric(
        lambda run: run.ranges.thrust[1],
        Quantity("largest thrust", "N"),
        RunText("thrust", "{:.3g} {unit}", " to "),
    ),
    "aircraft.thrust_share_min": Metric(
        lambda run: run.ranges.thrust_share[0],
        Quantity("least share of the thrust", "%", 100),
        RunText("thrust", "{:.3g}", " ("),
    ),
    "aircraft.thrust_share_max": Metric(
        lambda run: run.ranges.thrust_share[1],
        Quantity("largest share of the thrust", "%", 100, LOWER),
        RunText("thrust", "{:.3g} {unit} of the largest)", " to "),
    ),
    "aircraft.saturated_share": Metric(
        lambda run: run.saturated_share,
        Quantity("commands saturated", "% of the time", 100, LOWER),
        RunText("thrust", "commands saturated for {:.3g} {unit}"),
    ),
    "aircraft.power_mean_W": Metric(
        lambda run: np.mean(run.thrust_powers),
        Quantity("mean power of an aircraft", "W", better=LOWER),
        RunText("power of an aircraft", "{:.3g} {unit} of thrust"),
    ),
    "aircraft.energy_Wh_per_kg_km": Metric(
        lambda run: run.energy_per_mass_and_distance,
        Quantity("energy of the transport", "Wh/(kg km)", better=LOWER),
        RunText("power of an aircraft", "all took {:.3g} {unit}"),
    ),
    "optimizer.updates": Metric(
        lambda run: run.update_counts["updates"],
        Quantity("updates"),
        RunText("optimizer", "{} updates", hides_line_at_zero=True),
    ),
    "optimizer.kept": Metric(
        lambda run: run.update_counts["kept"],
        Quantity("updates kept"),
        RunText("optimizer", "{} kept xi and A", ": "),
    ),
    "optimizer.solved": Metric(
        lambda run: run.update_counts["solved"],
        Quantity("updates solved"),
        RunText("optimizer", "{} solved"),
    ),
    "optimizer.relaxed": Metric(
        lambda run: run.update_counts["relaxed"],
        Quantity("updates relaxed", better=LOWER),
        RunText("optimizer", "{} relaxed (not feasible)"),
        TableColumn("re-", "laxed"),
    ),
    "optimizer.held": Metric(
        lambda run: run.update_counts["held"],
        Quantity("updates held", better=LOWER),
        RunText("optimizer", "{} held (no solution)"),
    ),
    **{
        f"{group}.missed_limits.{name}": Metric(
            functools.partial(_missed_updates, limit=name),
            Quantity(f"updates that miss the limit of the {name.replace('_', ' ')}", better=LOWER),
        )
        for group, names in (
            ("optimizer", [limit.name for limit in LIMITS if not limit.is_of_aircraft]),
            ("aircraft", [BOUND, *(limit.name for limit in LIMITS if limit.is_of_aircraft)]),
        )
        for name in names
    },
    "optimizer.solve_time_ms.p50": Metric(
        lambda run: run.solve_time(0.5),
        Quantity("solve, median", "ms", better=LOWER),
        is_wall_time=True,
    ),
    "optimizer.solve_time_ms.p99": Metric(
        lambda run: run.solve_time(0.99),
        Quantity("solve, p99", "ms", better=LOWER),
        column=TableColumn("p99", "ms"),
        is_wall_time=True,
    ),
    "optimizer.solve_time_ms.max": Metric(
        lambda run: run.solve_time(1.0),
        Quantity("solve, max", "ms", better=LOWER),
        is_wall_time=True,
    ),
    "optimizer.xi_final_rad_s": Metric(
        lambda run: run.run.signal("parameters")[-1, 0], Quantity("final ξ", "rad/s")
    ),
    "optimizer.A_final_N": Metric(
        lambda run: run.run.signal("parameters")[-1, 1], Quantity("final A", "N")
    ),
}
METRICS = tuple(metric._replace(path=path) for path, metric in _ROWS.items())


def in_brief(sentences: Sequence[str]) -> str:
    """The first few of the sentences, and how many more are in metrics.json."""
    shown, rest = sentences[:_MOST_SENTENCES], sentences[_MOST_SENTENCES:]
    return "; ".join([*shown, *([f"{len(rest)} more in metrics.json"] if rest else [])])


def metrics_table(metrics: Mapping[str, Any]) -> str:
    """The metrics of a run that have a `text`, some in each line, for a terminal."""
    lines: dict[str, str] = {}
    hidden = set()
    for metric in METRICS:
        part, value = metric.text, metric.shown(metric.value(metrics))
        if part is None or value is None or value == []:
            continue
        if metric.is_list:
            value = in_brief(value)
        if part.hides_line_at_zero and not value:
            hidden.add(part.line)
        if part.decimals is not None:
            value = round(value, part.decimals)
        start = f"{lines[part.line]}{part.separator}" if part.line in lines else ""
        lines[part.line] = start + part.text.format(value, unit=metric.quantity.unit)
    shown = (item for item in lines.items() if item[0] not in hidden)
    return "\n".join(f"{name:{_NAME_WIDTH}}{text}" for name, text in shown)
