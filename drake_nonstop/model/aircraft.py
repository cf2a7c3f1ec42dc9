"""Aircraft as data: a table of them, a user's own, and what makes one impossible."""

import dataclasses
import functools
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from drake_nonstop.mechanics.aircraft import Aircraft, stall_speed, thrust_limits
from drake_nonstop.validation import (
    StrictFields,
    fulfilling,
    non_negative,
    positive,
    require,
    require_array,
    require_known,
    require_ranges,
)

TABLE = Path(__file__).parent / "aircraft_table"
CABLE_DIAMETER, CABLE_DRAG = 0.001, 1.1  # m, and C_D of air across a braided line
CABLE_DENSITY = 970.0  # kg/m³, of Dyneema
_SHORTEST_LAG = 1e-3  # s, that steps of a run resolve
_KIND = "give an AircraftParameters, or in YAML a mapping of its fields"
_SPEEDS = 1000  # from a tenth of the stall speed to ten times, that a search tries


def _lag() -> Any:
    """A field of a time that steps of a run resolve."""
    remedy = f"give at least {_SHORTEST_LAG:g} s"
    return fulfilling(None, lambda lag: _SHORTEST_LAG <= lag < float("inf"), remedy)


@dataclass(kw_only=True)
class AircraftParameters(StrictFields):
    """Fixed-wing carriers, all alike: one of the table, single fields changed, or a user's own.

    A field that is None is that of the `model`. Without a model all fields but the last four, which
    have defaults, must be given. Coefficients refer to the wing area.
    """

    model: str | None = None  # of the table: rascal_110, ultrastick_25e
    mass: float | None = positive(None)  # kg, that of a carrier
    wing_area: float | None = positive(None)  # m²
    wing_span: float | None = positive(None)  # m
    lift_at_zero_angle: float | None = None  # C_L0, at the angle of attack 0
    lift_slope: float | None = positive(None)  # C_Lα, 1/rad
    max_lift: float | None = positive(None)  # C_Lmax, where it stalls
    zero_lift_drag: float | None = non_negative(None)  # C_D0
    induced_drag: float | None = non_negative(None)  # k, of C_L² in C_D
    max_thrust: list[float] | None = None  # [a, b, c]: a + b V + c V² N at V m/s
    min_thrust: list[float] | None = None  # likewise; negative: it brakes
    lift_lag: float | None = _lag()  # s, of C_L behind its command
    bank_lag: float | None = _lag()  # s, of the bank
    thrust_lag: float | None = _lag()  # s, of the thrust
    max_roll_rate: float | None = positive(None)  # rad/s
    efficiency: float | None = fulfilling(  # of propeller and motor, above 0, up to 1
        None, lambda share: 0 < share <= 1, "give a share, up to 1"
    )
    gust_time: float | None = _lag()  # s, until gusts are trimmed; default 0.4
    air_density: float | None = positive(None)  # kg/m³; default 1.225
    lift_gain: float | None = positive(None)  # C_L that is flown, over the commanded one; default 1
    thrust_gain: float | None = positive(None)  # likewise of the thrust; default 1


# Of the fields that an aircraft need not give.
_DEFAULTS = {
    "gust_time": 0.4,
    "air_density": 1.225,
    "lift_gain": 1.0,
    "thrust_gain": 1.0,
}
_FIELDS = tuple(f.name for f in dataclasses.fields(AircraftParameters) if f.name != "model")
# What the motion goes by.
FLIGHT_FIELDS = tuple(name for name in _FIELDS if name not in ("wing_span", "efficiency"))


def aircraft_names() -> list[str]:
    """The names of the aircraft in the table, sorted."""
    return sorted(path.stem for path in TABLE.glob("*.yaml"))


@functools.cache
def _of_table(name: str) -> dict[str, Any]:
    return yaml.safe_load((TABLE / f"{name}.yaml").read_text(encoding="utf-8"))


def merged(
    parameters: AircraftParameters | None, overrides: AircraftParameters | None
) -> AircraftParameters | None:
    """The parameters with the fields replaced that `overrides` gives; a model replaces all.

    Raises:
        ScenarioError: one is neither None nor an AircraftParameters.
    """
    for field, value in (("system.aircraft", parameters), ("simulated.aircraft", overrides)):
        is_aircraft = value is None or isinstance(value, AircraftParameters)
        require(is_aircraft, field, value, _KIND)
    if parameters is None or overrides is None or overrides.model is not None:
        return overrides or parameters
    given = {k: v for k, v in vars(overrides).items() if v is not None}
    return dataclasses.replace(parameters, **given)


def values_of(parameters: AircraftParameters, field: str = "system.aircraft") -> dict[str, Any]:
    """The values of all fields but `model`, by name: given, of the table, or defaults.

    Raises:
        ScenarioError: the table has no such aircraft, or a field is missing.
    """
    require(isinstance(parameters, AircraftParameters), field, parameters, _KIND)
    values = dict(_DEFAULTS)
    name = parameters.model
    if name is not None:
        require_known(name, aircraft_names(), f"{field}.model", name)
        values |= _of_table(name)
    values |= {k: v for k in _FIELDS if (v := getattr(parameters, k)) is not None}
    names = ", ".join(aircraft_names())
    for key in _FIELDS:
        remedy = f"give it, or {field}.model, one of {names}"
        require(key in values, f"{field}.{key}", "not given", remedy)
    return values


def make_aircraft(
    parameters: AircraftParameters,
    *,
    cable_length: float | NDArray,
    gravity: float,
    cable_diameter: float | NDArray = CABLE_DIAMETER,
    cable_drag: float | NDArray = CABLE_DRAG,
    field: str = "system.aircraft",
) -> Aircraft:
    """The aircraft of these parameters, checked; `field` is their name in error messages.

    Cable length, gravity and cable diameter are in m, m/s² and m; those of cables that differ are
    arrays (n,).

    Raises:
        ScenarioError: a field is missing or out of its range, or the aircraft cannot fly level
            by itself.
    """
    values = values_of(parameters, field)
    require_ranges(field, parameters, values)
    for key in ("max_thrust", "min_thrust"):
        name = f"{field}.{key}"
        meaning = "[a, b, c] of the thrust a + b V + c V² at the airspeed V"
        values[key] = require_array(name, values[key], [3], meaning)
    cable = {"diameter": cable_diameter, "drag": cable_drag, "length": cable_length}
    values |= {f"cable_{name}": value for name, value in cable.items()}
    aircraft = Aircraft(**values, gravity=gravity)
    _check_polar(field, aircraft)
    _check_level_flight(field, aircraft)
    return aircraft


def _check_polar(field: str, aircraft: Aircraft) -> None:
    least, most = float(aircraft.lift_at_zero_angle), float(aircraft.max_lift)
    remedy = f"give a number below max_lift, {most:g}, and above {-most:g}"
    require(abs(least) < most, f"{field}.lift_at_zero_angle", least, remedy)
    drag = float(aircraft.zero_lift_drag + aircraft.induced_drag)
    remedy = "give a number above zero, or induced_drag one: nothing flies without drag"
    require(drag > 0, f"{field}.zero_lift_drag", aircraft.zero_lift_drag, remedy)


def _check_level_flight(field: str, aircraft: Aircraft) -> None:
    """Raises ScenarioError for an aircraft that cannot fly level without a cable."""
    slowest = float(stall_speed(aircraft))
    speeds = np.geomspace(slowest / 10, 10 * slowest, _SPEEDS)
    least, most = thrust_limits(aircraft, speeds)
    dynamic = aircraft.air_density / 2 * speeds**2 * aircraft.wing_area
    weight = aircraft.mass * aircraft.gravity
    needed = dynamic * aircraft.zero_lift_drag + aircraft.induced_drag * weight**2 / dynamic
    flown = np.flatnonzero((speeds >= slowest) & (most > needed))
    remedy = (
        f"level flight without a cable needs {needed[speeds >= slowest].min():.3g} N at "
        f"least, above the stall at {slowest:.3g} m/s; give more thrust, wing_area or max_lift, "
        "or less drag or mass"
    )
    require(len(flown) > 0, f"{field}.max_thrust", np.asarray(aircraft.max_thrust).tolist(), remedy)
    remedy = "give less than max_thrust, at all speeds up to the highest that the aircraft can fly"
    is_below = np.all((least <= most)[: flown[-1] + 1])
    require(is_below, f"{field}.min_thrust", np.asarray(aircraft.min_thrust).tolist(), remedy)
