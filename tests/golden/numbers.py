"""The numbers of golden flights, and the tables that they are kept in.

A number's tolerance is 100 times its change where the load's mass moves by 2⁻⁵¹ of itself, the
larger one of both signs, and at least 1e-12, or that share of a number above 1: what rounding makes
of a flight on another machine, and no more.
"""

import copy
import csv
import functools
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from fleet import FLEET, Fleet, flown, scenario_of
from registries import METRICS

from drake_nonstop import Run, Scenario, compute_metrics, load_scenario

HERE = Path(__file__).parent
TABLE = HERE / "numbers.csv"
LEAST_TOLERANCE = 1e-12
FACTOR = 100.0
MOVED = 2.0**-51  # of the load's mass

# A number of a signal at an instant is the sum of its entries, each times a weight of its own.
OF_THE_WAY = ("load_state", "carrier_state", "tensions")  # at a third and two thirds, too
AT_THE_END = (
    *("parameters", "planned", "wrench", "wrench_rate", "desired_cable_forces", "diagnostics"),
    *("carrier_reference", "carrier_reference_acceleration", "carrier_forces", "aircraft_command"),
    *("aircraft_state", "measured_load_state", "wind", "disturbance_wrench", "reference"),
)
# Of drawn loops the metrics that say the most; of the fleet all of them.
FEW_METRICS = (
    *("load.position_error_max_m", "carriers.speed_min_m_s", "carriers.separation_min_m"),
    "cables.tension_min_N",
)
UNSTEADY = {metric.path for metric in METRICS if metric.is_wall_time}

Numbers = dict[str, float | str]  # by their quantities; the outcome is a word


class Golden(NamedTuple):
    """A number as it is kept, and how far one may be from it."""

    value: float | str
    tolerance: float = 0.0

    def holds(self, value: float | str) -> bool:
        """Whether a number, or an outcome, is the same."""
        if isinstance(value, str) or isinstance(self.value, str):
            return value == self.value
        return abs(value - self.value) <= self.tolerance or value == self.value


Table = dict[str, dict[str, Golden]]  # by flights and quantities


@functools.cache
def drawn_loops() -> dict[str, tuple[str, list[str]]]:
    """The drawn loops: names to a scenario and its overrides."""
    return yaml.safe_load((HERE / "drawn_loops.yaml").read_text(encoding="utf-8"))


def flights() -> list[str]:
    """The names of all golden flights."""
    return [*FLEET, *drawn_loops()]


def golden_scenario(name: str) -> Scenario:
    """The scenario of a golden flight."""
    return scenario_of(name) if name in FLEET else load_scenario(*drawn_loops()[name])


def numbers_of_flight(name: str, fleet: Fleet) -> Numbers:
    """The numbers of a golden flight, flown by the fastest engine."""
    return numbers_of(name, *fleet.evaluated(golden_scenario(name)))


def moved_numbers(name: str, share: float) -> Numbers:
    """The numbers of a golden flight with a share more of the load's mass."""
    scenario = copy.deepcopy(golden_scenario(name))
    for masses in (scenario.system, scenario.simulated):
        if masses.load_mass is not None:
            masses.load_mass *= 1.0 + share
    run = flown(scenario)
    return numbers_of(name, run, compute_metrics(run))


def numbers_of(name: str, run: Run, metrics: dict[str, Any]) -> Numbers:
    """The numbers of a run of a golden flight."""
    engine = run.engine.partition(":")[0]
    numbers: Numbers = {"outcome": str(metrics["outcome"]), "engine": engine}
    names = {signal.partition(".")[2] for signal in run.signals}
    for share, chosen in ((1 / 3, OF_THE_WAY), (2 / 3, OF_THE_WAY), (1, OF_THE_WAY + AT_THE_END)):
        row = round(share * (len(run.time) - 1))
        for signal in chosen:
            if signal in names:
                values = run.signal(signal)[row]
                numbers[f"{signal} at {run.time[row]:.2f} s"] = weighted_sum(values)
    for path, value in leaves(metrics):
        is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if is_number and path not in UNSTEADY and (name in FLEET or path in FEW_METRICS):
            numbers[path] = float(value)
    return numbers


def leaves(tree: dict[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """The paths and values of nested dicts."""
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from leaves(value, f"{before}{key}.")
        else:
            yield f"{before}{key}", value


def weighted_sum(values: np.ndarray) -> float:
    """Of the entries of a vector, by weights without a sign or a size in common."""
    return float(np.asarray(values) @ np.cos(np.arange(1, len(values) + 1) ** 2))


def tolerances(numbers: Numbers, moved: list[Numbers]) -> dict[str, Golden]:
    """Golden numbers, from the flights whose load is a little heavier or lighter.

    Raises:
        ValueError: the outcome, or whether there is a number, hangs on the last digit.
    """
    found = {}
    for quantity in {**numbers, **moved[0], **moved[1]}:
        values = [each.get(quantity) for each in (numbers, *moved)]
        value, is_word = values[0], isinstance(values[0], str)
        if None in values or (is_word and {*values} != {value}):
            raise ValueError(f"{quantity} = {value}: it hangs on the load's last digit")
        found[quantity] = Golden(value)
        if not is_word:
            least = LEAST_TOLERANCE * max(1.0, abs(value))
            change = max(abs(other - value) for other in values)
            found[quantity] = Golden(value, float(f"{max(FACTOR * change, least):.1e}"))
    return found


def differences(golden: Mapping[str, Golden], numbers: Numbers) -> dict[str, str]:
    """What differs from the golden numbers of a flight, a sentence for each quantity."""
    found = {}
    for quantity in {**golden, **numbers}:
        if quantity not in numbers:
            found[quantity] = f"{quantity}: there is none any more"
        elif quantity not in golden:
            found[quantity] = f"{quantity} = {numbers[quantity]}: it is new"
        elif not golden[quantity].holds(numbers[quantity]):
            value, tolerance = golden[quantity]
            by = "" if isinstance(value, str) else f" (tolerance {tolerance:.1e})"
            found[quantity] = f"{quantity} = {numbers[quantity]}: the golden one is {value}{by}"
    return found


def read_table(path: Path = TABLE) -> Table:
    """The golden numbers as they are kept."""
    table: Table = {}
    with path.open(encoding="utf-8", newline="") as file:
        for flight, quantity, value, tolerance in [*csv.reader(file)][1:]:
            number = Golden(float(value), float(tolerance)) if tolerance else Golden(value)
            table.setdefault(flight, {})[quantity] = number
    return table


def write_table(table: Table, path: Path = TABLE) -> None:
    """Keeps golden numbers, in the order of the flights."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["flight", "quantity", "value", "tolerance"])
        for flight in flights():
            for quantity, (value, tolerance) in table.get(flight, {}).items():
                is_word = isinstance(value, str)
                shown = (value, "") if is_word else (repr(value), f"{tolerance:.1e}")
                writer.writerow([flight, quantity, *shown])
