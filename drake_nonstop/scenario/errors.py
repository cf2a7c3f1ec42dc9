"""Errors that a scenario states: of the plant, of the measurements, and an untold wind.

`errors` is the name of a set, such as `light`, or a mapping of fields of `simulated`,
`load_feedback`, `wind` and `start_error` to their values, which may be distributions:

    errors: {simulated.load_mass: !Uniform {min: 0.9, max: 1.1}, wind: !SteadyWind {...}}

A set has a range for each of its errors, relative to what the scenario has, from which each flight
draws evenly. It draws when numbers are drawn for the scenario's distributions.
"""

import copy
import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from drake_nonstop.blocks.load_feedback import (
    DesiredAttitudeFeedbackConfig,
    FilteredFeedbackConfig,
    IdealFeedbackConfig,
    MeasurementConfig,
)
from drake_nonstop.blocks.wind import SteadyWindConfig, StillAirConfig
from drake_nonstop.blocks.wind_estimator import (
    KnownWindConfig,
    NoWindConfig,
    WindObserverConfig,
)
from drake_nonstop.diagrams.nonstop import BOXES
from drake_nonstop.loop.box import block_of
from drake_nonstop.model.system import overridden
from drake_nonstop.validation import require, require_known

if TYPE_CHECKING:
    from drake_nonstop.scenario.schema import Scenario

NONE = "none"
# Whose fields a mapping may have.
OWNERS = ("simulated", "load_feedback", "wind", "start_error")
_AXES = ("x", "y")
_JUDGED = ("cable_diameter", "cable_breaking_load")  # that a run is held against


@dataclass(frozen=True, kw_only=True)
class ErrorSet:
    """Sizes of errors; those with a sign are drawn evenly from within it, to either side."""

    load_mass: float = 0.05  # of the load's mass
    centre: float = 0.01  # of the load's width, of its centre of mass along each of two axes
    attachments: float = 0.005  # of the load's width, of each attachment along two axes
    cable_length: float = 0.002  # of each cable's length
    cable_drag: float = 0.1  # of C_D and C_f of the cables
    cable_stiffness: float = 0.1  # of the cables' stiffness
    # m/s, from any side; in the place of a KnownWind of still air aircraft have a WindObserver, and
    # others NoWind
    wind: float = 0.5
    position_noise: float = 0.0005  # m, of the measured load on each axis
    velocity_noise: float = 0.002  # m/s, likewise
    aircraft_position_noise: float = 0.02  # m, in place of these where the carriers are aircraft
    aircraft_delay: float = 0.04  # s, of the measured load, likewise


def _larger(errors: ErrorSet, factor: float, **others: float) -> ErrorSet:
    sizes = {name: factor * size for name, size in vars(errors).items()}
    return ErrorSet(**(sizes | others))


LIGHT = ErrorSet()
SETS: dict[str, ErrorSet] = {"light": LIGHT, "rough": _larger(LIGHT, 3.0, wind=1.0)}


def check_errors(field: str, errors: Any) -> None:
    """Raises ScenarioError for what is neither the name of a set nor a mapping."""
    if not isinstance(errors, dict):
        require_known(errors, (NONE, *SETS), field, errors)
        return
    for path, value in errors.items():
        is_text = isinstance(path, str) and path != "_tag"
        require(is_text, field, path, "give fields, such as simulated.load_mass")
        require_known(path.partition(".")[0], OWNERS, f"{field}.{path}", value)


def with_fields(
    scenario: "Scenario", read: Callable[[dict[str, Any], "Scenario"], None]
) -> "Scenario":
    """The scenario with the fields of the mapping that it states; `read` changes it by a tree."""
    check_errors("errors", scenario.errors)
    errors: Any = scenario.errors
    scenario = copy.deepcopy(scenario)
    scenario.errors = NONE
    for path, value in errors.items():
        tree = value
        for key in reversed(path.split(".")):
            tree = {key: tree}
        read(tree, scenario)
        if isinstance(tree.get("simulated"), dict):
            _require_used(tree["simulated"], scenario)
    return scenario


def _require_used(fields: dict[str, Any], scenario: "Scenario") -> None:
    """Raises ScenarioError for fields of `simulated` that no block of the plant goes by."""
    configs = [getattr(scenario, name) for name, box in BOXES.items() if box.is_simulated]
    blocks: list[Any] = [block_of(type(config)) for config in configs]
    if all(hasattr(block, "of_model") for block in blocks):  # none goes by the whole model
        names = [name for block in blocks for name in (*block.system, *block.of_model)]
        used = {name.partition(".")[0] for name in (*names, *_JUDGED)}
        plant = ", ".join(block.__name__ for block in blocks)
        for name, value in fields.items():
            remedy = f"none of {plant} goes by it; leave it out, or give a block that does"
            require(name in used, f"errors.simulated.{name}", value, remedy)


def with_set(
    scenario: "Scenario", draw: Callable[[], float]
) -> tuple["Scenario", dict[str, float]]:
    """The scenario with errors of the set that it states, and these errors by their names.

    `draw` makes numbers from -1 to 1; those of the scenario have been drawn.
    """
    check_errors("errors", scenario.errors)
    errors, scenario = SETS[str(scenario.errors)], copy.deepcopy(scenario)
    scenario.errors = NONE
    plant = overridden(scenario.system, scenario.simulated)
    places = np.array(plant.attachments, dtype=float)
    width = np.linalg.norm(places[:, None] - places, axis=-1).max()
    drawn: dict[str, float] = {}

    def number(name: str, size: float) -> float:
        drawn[f"errors.{name}"] = size * draw()
        return drawn[f"errors.{name}"]

    def factor(name: str) -> float:
        return 1 + number(name, getattr(errors, name))

    def each(values: Any, factors: Any) -> Any:
        return (np.asarray(values) * factors).tolist()

    scenario.simulated = dataclasses.replace(
        scenario.simulated, load_mass=factor("load_mass") * plant.load_mass
    )
    for k, axis in enumerate(_AXES):
        places[:, k] -= number(f"centre_{axis}", errors.centre * width)
        for i in range(len(places)):
            name = f"attachment_{i + 1}_{axis}"
            places[i, k] += number(name, errors.attachments * width)
    lengths = [1 + number(f"cable_length_{i + 1}", errors.cable_length) for i in range(len(places))]
    drag = factor("cable_drag")
    scenario.simulated = dataclasses.replace(
        scenario.simulated,
        attachments=places.tolist(),
        cable_length=each(plant.cable_length, lengths),
        cable_drag=each(plant.cable_drag, drag),
        cable_friction=each(plant.cable_friction, drag),
        cable_stiffness=each(plant.cable_stiffness, factor("cable_stiffness")),
    )
    _add_wind(scenario, errors.wind, number("wind_direction", math.pi))
    _add_noise(scenario, errors)
    return scenario, drawn


def _add_wind(scenario: "Scenario", speed: float, direction: float) -> None:
    untold = speed * np.array([math.cos(direction), math.sin(direction), 0.0])
    if scenario.wind == StillAirConfig():
        scenario.wind = SteadyWindConfig(velocity=untold.tolist())
        if scenario.wind_estimator == KnownWindConfig():
            flies = scenario.system.aircraft is not None
            scenario.wind_estimator = WindObserverConfig() if flies else NoWindConfig()
    elif hasattr(scenario.wind, "velocity"):
        velocity = (np.asarray(scenario.wind.velocity) + untold).tolist()
        scenario.wind = dataclasses.replace(scenario.wind, velocity=velocity)


def _add_noise(scenario: "Scenario", errors: ErrorSet) -> None:
    """A measurement with the noise and the delay, filtered where the scenario has none."""
    feedback: Any = scenario.load_feedback
    sizes: dict[str, Any]
    if scenario.system.aircraft is None:
        sizes = {"position_noise": errors.position_noise, "velocity_noise": errors.velocity_noise}
    else:
        sizes = {"position_noise": errors.aircraft_position_noise, "delay": errors.aircraft_delay}
    if isinstance(feedback, (IdealFeedbackConfig, DesiredAttitudeFeedbackConfig)):
        feedback = FilteredFeedbackConfig(
            period=scenario.control_period or MeasurementConfig.period,
            seed=scenario.random_seed,
            **{f"believed_{name}": size for name, size in sizes.items() if name != "delay"},
        )
    if isinstance(feedback, MeasurementConfig):
        periods = round(sizes.get("delay", 0.0) / feedback.period)
        sizes["delay"] = periods * feedback.period
        larger = {name: max(size, getattr(feedback, name)) for name, size in sizes.items()}
        scenario.load_feedback = dataclasses.replace(feedback, **larger)
