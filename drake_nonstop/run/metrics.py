"""The metrics that judge a run, as one table.

`METRICS` has a row per metric, and all that writes or prints metrics reads it: metrics.json,
the table of a run, the tables of an ablation and of a sweep, the quantities of the README's
claims.
"""

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from drake_nonstop.run.outcome import judge
from drake_nonstop.run.run import Run
from drake_nonstop.run.run_quantities import RunQuantities
from drake_nonstop.validation import finite
from drake_nonstop.version import __version__

_MOST_SENTENCES = 3  # of a list, in what is printed
_NAME_WIDTH = 24  # characters, of a line's name in the table of a run


@np.errstate(under="ignore")
def compute_metrics(run: Run) -> dict[str, Any]:
    """The metrics of a run as nested dictionaries, as written to metrics.json.

    Keys end in their units. Speeds, separations, tensions and loads on the aircraft are those
    of the simulated carriers and cables at every step from t = 0 on; errors are those of the
    load's true pose at 100 Hz. The slowest speed and the least distances are also looked for
    between two steps. For a time "below" or "slack" each step counts half of the two intervals
    beside it. Accelerations are measured over 0.1 s of the path: over less a carrier follows the
    ripple of its sampled reference. A metric is None if it was not measured, such as the solve
    times of a layer that solves nothing or the delay of a reference without a governor, or if it is
    not finite. The groups `aircraft`, of the simulated aircraft, `obstacles` and `bowed_cables`, of
    cables with nodes, are there if the run has these; other tensions are those at the load.
    `outcome` is a `RunOutcome`, `reasons` are sentences. A run that stopped before its first sample
    has these two only.
    """
    quantities = RunQuantities(run)
    values: dict[str, Any] = {"scenario": run.scenario.name, "is_steered": run.is_steered}
    is_there = {
        "aircraft": quantities.has_aircraft,
        "bowed_cables": quantities.has_nodes,
        "obstacles": run.scenario.obstacles,
    }
    absent = [group for group, has_any in is_there.items() if not has_any]
    for metric in METRICS:
        *groups, name = metric.path.split(".")
        if groups and groups[0] in absent:
            continue
        group = values
        for key in groups:
            group = group.setdefault(key, {})
        is_measured = len(run.time) > 0 or metric.is_of_nothing
        group[name] = finite(metric.measure(quantities)) if is_measured else None
    if run.half_step is not None:
        values["half_step"] = run.half_step
    values["versions"] = {
        "drake_nonstop": __version__,
        "drake": _drake_version(),
        "numpy": np.__version__,
    }
    return values


@functools.cache
def _drake_version() -> str:
    from importlib.metadata import version  # here: it takes a while to import

    return version("drake")


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


class Metric(NamedTuple):
    """How a metric is measured, stored, shown and judged.

    Adding one takes a row in `METRICS`: it is then in metrics.json, in the table of a study and, by
    its heading, a quantity of claims; with a `line`, in the table of a run, too.
    """

    path: str  # in metrics.json, with dots; the last part ends in the unit of the stored value
    label: str
    unit: str  # as shown
    measure: Callable[[RunQuantities], Any]
    line: str = ""  # of a run's table, which has its `text` after those of the rows above
    text: str = ""  # a format of the value as shown, and of the unit
    scale: float = 1.0  # from the stored value to the one shown
    better: int = NEITHER
    is_brief: bool = False  # whether tables of studies show it
    has_change: bool = False  # one more column has the change against the first run
    is_wall_time: bool = False  # or what it depends on: it differs from run to run

    @property
    def heading(self) -> str:
        """The label with the unit, such as "mean position error (mm)"."""
        return f"{self.label} ({self.unit})" if self.unit else self.label

    @property
    def is_of_nothing(self) -> bool:
        """Whether it is measured of a run without samples, too."""
        return self.path in ("outcome", "reasons", "simulator.step_s", "engine")

    def value(self, metrics: Mapping[str, Any] | None) -> Any:
        """The stored value in the metrics of a run; None where there is none."""
        return value_at(metrics, self.path)

    def shown(self, value: Any) -> Any:
        """A stored value in the unit that is shown."""
        return value if self.scale == 1 or value is None else self.scale * value


# Of each error of the load's pose: a name, as in "<name>_error" of a run's quantities and of its
# limits, the unit that is stored, the one that is shown, and its scale.
LOAD_ERRORS = (("position", "m", "mm", 1e3), ("orientation", "rad", "mrad", 1e3))


def _error_metrics(name: str, unit: str, shown: str, scale: float) -> tuple[Metric, ...]:
    """The mean and the largest value of an error of the load's pose."""
    of, line = attrgetter(f"{name}_error"), f"load {name} error"
    return (
        Metric(
            *(f"load.{name}_error_mean_{unit}", f"mean {name} error", shown),
            lambda run: np.mean(of(run)),
            *(line, "mean {:.3g} {unit}"),
            scale=scale,
            better=LOWER,
            is_brief=True,
            has_change=name == "position",
        ),
        Metric(
            *(f"load.{name}_error_max_{unit}", f"largest {name} error", shown),
            lambda run: np.max(of(run)),
            *(line, ", max {:.3g} {unit}"),
            scale=scale,
            better=LOWER,
            is_brief=name == "position",
        ),
    )


def _turn_metric(name: str) -> Metric:
    """The largest tilt or yaw beside the reference."""
    of = attrgetter(f"{name}_error")
    return Metric(
        *(f"load.{name}_error_max_rad", f"largest {name} error", "deg"),
        lambda run: np.max(of(run)),
        *("load orientation error", f", {name} {{:.2g}} {{unit}}"),
        scale=180 / math.pi,
        better=LOWER,
    )


def _update_metric(name: str, text: str, better: int = NEITHER) -> Metric:
    """How many updates of the optimization layer ended in a way."""
    return Metric(
        *(f"optimizer.{name}", "updates" if name == "updates" else f"updates {name}", ""),
        lambda run: run.update_counts[name],
        *("optimizer", text),
        better=better,
        is_brief=name == "relaxed",
    )


METRICS = (
    Metric(
        *("outcome", "outcome", "", lambda run: judge(run).outcome.value, "outcome", "{}"),
        is_brief=True,
    ),
    Metric("reasons", "reasons", "", lambda run: [*judge(run).reasons], "outcome", ": {}"),
    Metric(
        *("simulated_s", "simulated time", "s", lambda run: run.time[-1]),
        *("simulated", "{:g} {unit}"),
    ),
    Metric(
        *("simulator.step_s", "longest step", "ms"),
        lambda run: run.run.step or run.scenario.simulator_config.max_step_size,
        scale=1e3,
    ),
    Metric(
        *("wall_s", "wall time", "s", lambda run: run.run.wall_time),
        *("simulated", " in {:.2f} {unit}"),
        better=LOWER,
        is_wall_time=True,
    ),
    Metric(
        *("real_time_factor", "real-time factor", ""),
        lambda run: run.time[-1] / run.run.wall_time,
        *("simulated", " ({:.1f} x real time)"),
        better=HIGHER,
        is_wall_time=True,
    ),
    Metric(
        *("engine", "engine", "", lambda run: run.run.engine, "engine", "{}"),
        is_wall_time=True,
    ),
    *(metric for error in LOAD_ERRORS for metric in _error_metrics(*error)),
    _turn_metric("tilt"),
    _turn_metric("yaw"),
    Metric(
        *("load.position_error_final_m", "final position error", "mm"),
        lambda run: run.position_error[-1],
        scale=1e3,
        better=LOWER,
    ),
    Metric(
        *("load.reference_delay_max_s", "largest delay of the reference", "s"),
        lambda run: run.reference_delay,
        *("reference", "late by up to {:.3g} {unit}"),
        better=LOWER,
    ),
    Metric("carriers.n", "number of carriers", "", lambda run: run.speeds.shape[1]),
    Metric(
        *("carriers.speed_min_m_s", "slowest speed", "m/s", lambda run: run.slowest_speed),
        *("carrier speed", "{:.3f}"),
        better=HIGHER,
        is_brief=True,
    ),
    Metric(
        *("carriers.speed_max_m_s", "peak speed", "m/s", lambda run: np.max(run.speeds)),
        *("carrier speed", " to {:.3f} {unit}"),
    ),
    Metric(
        *("carriers.speed_final_m_s", "final speeds", "m/s", lambda run: run.speeds[-1].tolist())
    ),
    Metric(
        *("carriers.speed_bound_m_s", "bound on the speed", "m/s"),
        lambda run: run.speed_bounds[-1],
        *("carrier speed", ", bound {:g} {unit}"),
    ),
    Metric(
        *("carriers.time_below_bound_s", "time below the bound", "s"),
        lambda run: run.time_below_bound,
        *("carrier speed", ", below it for {:.3g} {unit}"),
        better=LOWER,
        is_brief=True,
        has_change=True,
    ),
    Metric(
        *("carriers.separation_min_m", "closest carriers", "m", lambda run: run.carrier_separation),
        *("closest", "carriers {:.3f} {unit}"),
        better=HIGHER,
        is_brief=True,
    ),
    Metric(
        *("carriers.acceleration_max_m_s2", "largest acceleration", "m/s²"),
        lambda run: run.largest_acceleration,
    ),
    Metric(
        *("cables.tension_min_N", "least tension", "N", lambda run: np.min(run.tensions)),
        *("tension", "{:.3g}"),
        better=HIGHER,
        is_brief=True,
    ),
    Metric(
        *("cables.tension_max_N", "largest tension", "N", lambda run: np.max(run.tensions)),
        *("tension", " to {:.3g} {unit}"),
    ),
    Metric(
        *("cables.slack_time_s", "slack", "s", lambda run: run.slack_time),
        *("tension", ", slack for {:.3g} {unit}"),
        better=LOWER,
        is_brief=True,
    ),
    Metric(
        *("bowed_cables.bow_max_m", "largest bow", "m", lambda run: np.max(run.bows)),
        *("bowed cables", "up to {:.3g} {unit} from the chord"),
    ),
    Metric(
        *("cables.separation_min_m", "closest cables", "m"),
        lambda run: np.min(run.cable_separations),
        *("closest", ", cables {:.3f} {unit}"),
        better=HIGHER,
        is_brief=True,
    ),
    Metric(
        *("obstacles.approaches", "nearest obstacles", ""),
        lambda run: [each.sentence for each in run.approaches],
        *("obstacles", "{}"),
    ),
    *(
        Metric(
            *(
                f"obstacles.{kind}_distance_min_m",
                f"least distance of obstacles from {bodies}",
                "m",
            ),
            functools.partial(RunQuantities.obstacle_distance, kind=kind),
            better=HIGHER,
        )
        for kind, bodies in (("load", "the load"), ("cable", "cables"), ("carrier", "carriers"))
    ),
    Metric(
        *("aircraft.lift_share_max", "largest share of the lift", ""),
        lambda run: run.ranges.lift_share[1],
        *("aircraft", "up to {:.3g} of the largest lift"),
        better=LOWER,
    ),
    Metric(
        *("aircraft.airspeed_min_m_s", "least airspeed", "m/s", lambda run: run.ranges.airspeed[0]),
        *("aircraft", ", airspeed from {:.3g} {unit}"),
        better=HIGHER,
    ),
    Metric(
        *("aircraft.airspeed_over_stall_min", "least airspeed over the stall speed", ""),
        lambda run: run.ranges.over_stall[0],
        *("aircraft", " ({:.3g} x stall"),
        better=HIGHER,
    ),
    Metric(
        "aircraft.airspeed_over_loaded_stall_min",
        "least airspeed over the stall speed with cable and bank",
        "",
        lambda run: run.ranges.over_loaded_stall[0],
        *("aircraft", ", {:.3g} x stall with cable and bank)"),
        better=HIGHER,
    ),
    Metric(
        *("aircraft.bank_max_rad", "largest bank", "deg"),
        lambda run: max(map(abs, run.ranges.bank)),
        *("aircraft", ", bank up to {:.3g} {unit}"),
        scale=math.degrees(1),
        better=LOWER,
    ),
    Metric(
        *("aircraft.thrust_min_N", "least thrust", "N", lambda run: run.ranges.thrust[0]),
        *("thrust", "{:.3g}"),
    ),
    Metric(
        *("aircraft.thrust_max_N", "largest thrust", "N", lambda run: run.ranges.thrust[1]),
        *("thrust", " to {:.3g} {unit}"),
    ),
    Metric(
        *("aircraft.thrust_share_max", "largest share of the thrust", "%"),
        lambda run: run.ranges.thrust_share[1],
        *("thrust", " ({:.3g} {unit} of the largest)"),
        scale=100,
        better=LOWER,
    ),
    Metric(
        *("aircraft.saturated_share", "commands saturated", "% of the time"),
        lambda run: run.saturated_share,
        *("thrust", ", commands saturated for {:.3g} {unit}"),
        scale=100,
        better=LOWER,
    ),
    Metric(
        *("aircraft.power_mean_W", "mean power of an aircraft", "W"),
        lambda run: np.mean(run.thrust_powers),
        *("power of an aircraft", "{:.3g} {unit} of thrust"),
        better=LOWER,
    ),
    Metric(
        *("aircraft.energy_Wh_per_kg_km", "energy of the transport", "Wh/(kg km)"),
        lambda run: run.energy_per_mass_and_distance,
        *("power of an aircraft", ", all took {:.3g} {unit}"),
        better=LOWER,
    ),
    _update_metric("updates", "{} updates"),
    _update_metric("kept", ": {} kept xi and A"),
    _update_metric("solved", ", {} solved"),
    _update_metric("relaxed", ", {} relaxed (not feasible)", LOWER),
    _update_metric("held", ", {} held (no solution)", LOWER),
    *(
        Metric(
            *(f"optimizer.solve_time_ms.{name}", f"solve, {label}", "ms"),
            functools.partial(RunQuantities.solve_time, share=share),
            better=LOWER,
            is_brief=name == "p99",
            is_wall_time=True,
        )
        for name, label, share in (("p50", "median", 0.5), ("p99", "p99", 0.99), ("max", "max", 1))
    ),
    Metric(
        *("optimizer.xi_final_rad_s", "final ξ", "rad/s"),
        lambda run: run.run.signal("parameters")[-1, 0],
    ),
    Metric(
        *("optimizer.A_final_N", "final A", "N", lambda run: run.run.signal("parameters")[-1, 1])
    ),
)


def in_brief(sentences: Sequence[str]) -> str:
    """The first few of the sentences, and how many more are in metrics.json."""
    shown, rest = sentences[:_MOST_SENTENCES], sentences[_MOST_SENTENCES:]
    return "; ".join([*shown, *([f"{len(rest)} more in metrics.json"] if rest else [])])


def metrics_table(metrics: Mapping[str, Any]) -> str:
    """The metrics of a run that have a line, some in each, for a terminal."""
    lines: dict[str, str] = {}
    for metric in METRICS:
        value = metric.shown(metric.value(metrics))
        if metric.line and value is not None and value != []:
            value = in_brief(value) if isinstance(value, list) else value
            text = metric.text.format(value, unit=metric.unit)
            lines[metric.line] = lines.get(metric.line, "") + text
    if not value_at(metrics, "optimizer.updates"):
        lines.pop("optimizer", None)
    return "\n".join(f"{name:{_NAME_WIDTH}}{text.lstrip(', ')}" for name, text in lines.items())
