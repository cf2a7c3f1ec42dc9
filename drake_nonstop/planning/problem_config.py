"""The fields of the nonstop problem, and the checks of their values."""

import math
import typing
from dataclasses import dataclass, field, fields, replace
from typing import Any, TypeVar, cast

from drake_nonstop.mechanics.aircraft import Aircraft, stall_speed
from drake_nonstop.model.system import Model
from drake_nonstop.planning.limits import LIMITS, Of, limits_of
from drake_nonstop.planning.measured_margin import FIRST_SHARE, MEASURED
from drake_nonstop.systems.tracing import LARGEST
from drake_nonstop.validation import (
    StrictFields,
    checked,
    fulfilling,
    is_number,
    number_with,
    positive,
    require,
    require_array,
    require_non_negative,
    require_ranges,
)

LEAST_BOUND = 1e-3  # m/s, unless there is none at all: margins are relative to the bound
_Config = TypeVar("_Config")


if typing.TYPE_CHECKING:
    SpeedBound = float  # what it is in a sampled scenario, see `with_stated_bound`
else:
    SpeedBound = float | str


def check_speed_bound(field: str, speed_bound: Any) -> None:
    """Raises ScenarioError for what is no speed bound (m/s); a text is checked by its meaning."""
    is_bound = is_number(speed_bound) and speed_bound >= LEAST_BOUND
    remedy = f"give 0 (no bound) or at least {LEAST_BOUND:g} m/s"
    require(speed_bound == 0 or is_bound, field, speed_bound, remedy)


def points(default: int, most: int, one: str = "") -> Any:
    """A field of a number of points; `one` says what 1 stands for."""
    remedy = f"give 1{one} to {most}"
    return fulfilling(default, lambda n: isinstance(n, int) and 1 <= n <= most, remedy)


below_one = number_with(lambda share: share < 1, "give less than 1")
above_zero = number_with(lambda x: x > 0, "give a number greater than 0, or .inf for no limit")


@dataclass(kw_only=True)
class AircraftLimits(StrictFields):
    """Limits of lift, bank, climb and thrust of aircraft, see `planning.limits`."""

    max_lift_share: float = checked(math.inf, above_zero)  # of C_Lmax, what aircraft need at most
    max_bank: float = checked(math.inf, above_zero)  # rad, of aircraft, to either side
    max_climb: float = checked(math.inf, above_zero)  # rad, of aircraft, up or down
    # of the range of an aircraft's thrust, about its middle
    max_thrust_share: float = checked(math.inf, above_zero)


@dataclass(kw_only=True)
class _BoundAndLimits(StrictFields):
    speed_bound: SpeedBound = checked(0.2, check_speed_bound)  # m/s, ε; of aircraft also "1.4 V_s"
    tightening: float | str = 0.01  # the solver aims at (1 + tightening) ε
    frequency: float = positive(2.0)  # rad/s, ξ at the start
    amplitude: float = positive(1.2)  # N, A at the start
    frequency_bounds: list[float] = field(default_factory=lambda: [0.1, 20.0])  # rad/s
    amplitude_bounds: list[float] = field(default_factory=list)  # N; none: from the load's weight
    max_frequency_rate: float = checked(math.inf, above_zero)  # rad/s²
    max_amplitude_rate: float = checked(math.inf, above_zero)  # N/s
    max_speed: float = math.inf  # m/s, of a carrier
    min_tension: float = 0.0  # N; 0: any
    max_tension: float = math.inf  # N
    min_separation: float = 0.0  # m, of two carriers over a whole orbit; 0: any


@dataclass(kw_only=True)
class LimitsConfig(AircraftLimits, _BoundAndLimits):
    """The bound, the nominal ξ and A, and what limits them and the carriers' flight."""


def stated_speed_bound(field: str, value: Any, aircraft: Aircraft | None) -> Any:
    """Bound in m/s as it is stated: a text such as "1.4 V_s" is a multiple of the stall speed.

    What is no text is returned as it is.

    Args:
        field: its name in error messages.
        value: as stated.
        aircraft: whose stall speed counts, with its own weight; None: the carriers are none.

    Raises:
        ScenarioError: a text is no such multiple, or there are no aircraft.
    """
    if not isinstance(value, str):
        return value
    number, unit = value.split() if len(value.split()) == 2 else ("", "")
    try:
        share = float(number) if unit == "V_s" else math.nan
    except ValueError:
        share = math.nan
    remedy = 'give a number of m/s, without quotes, or a multiple of the stall speed, as "1.4 V_s"'
    require(0 < share < math.inf, field, value, remedy)
    remedy = "only aircraft have a stall speed, and system.aircraft is none; give a number of m/s"
    if aircraft is None:
        require(False, field, value, remedy)
    return float(share * stall_speed(typing.cast(Aircraft, aircraft)))


def with_stated_bound(box: str, config: _Config, model: Model) -> _Config:
    """The dataclass with its `speed_bound` in m/s, see `stated_speed_bound`."""
    own: Any = config
    if not isinstance(own.speed_bound, str):
        return config
    stated = stated_speed_bound(f"{box}.speed_bound", own.speed_bound, model.aircraft)
    return replace(own, speed_bound=stated)


def with_fields_of(kind: type[_Config], config: Any) -> _Config:
    """A config of the fields that another one has, too; its others are the defaults."""
    names = [field.name for field in fields(cast(Any, kind))]
    return kind(**{name: getattr(config, name) for name in names if hasattr(config, name)})


def amplitude_range(config: LimitsConfig, model: Model) -> list[float]:
    """The bounds on A (N): the config's, or those that follow from the load's weight."""
    if config.amplitude_bounds != []:
        return config.amplitude_bounds
    return range_for(model.load_mass * model.gravity / model.n, config.amplitude)


def range_for(share: float, amplitude: float) -> list[float]:
    """The bounds on A (N) for a cable's share of the load's weight and an initial A, both in N."""
    return [min(0.004 * share, amplitude / 2), max(3 * share, 2 * amplitude)]


def tightened_bound(config: LimitsConfig, speed_bound: float) -> float:
    """The speed (m/s) that the solver aims at for ε in m/s; 0 where there is no bound."""
    return (1 + limit_tightening(config)) * speed_bound


def limit_tightening(config: Any) -> float:
    """The share by which limits are tightened; where the bound's is measured, its first one."""
    return FIRST_SHARE if config.tightening == MEASURED else float(config.tightening)


def highest_speed_bound(config: LimitsConfig) -> float:
    """The speed bound (m/s) that limits of the speeds leave no room above."""
    most = min(limit.stated(config) for limit in limits_of(Of.SPEED))
    return most / _least_ratio(config)


def check_limits(box: str, config: LimitsConfig, model: Model, *, measures: bool = False) -> None:
    """Raises ScenarioError for the first limit, of the config's `box`, that cannot be used.

    `measures` is whether the margin above the bound may be measured.
    """
    tightening = config.tightening
    is_share = not isinstance(tightening, str) and is_number(tightening) and 0 <= tightening < 1
    remedy = f'give a number from 0 to below 1, or "{MEASURED}" to RecedingHorizonOptimizer'
    is_known = is_share or (tightening == MEASURED and measures)
    require(is_known, f"{box}.tightening", tightening, remedy)
    for limit in LIMITS:
        if limit.is_least:
            require_non_negative(f"{box}.{limit.field}", limit.stated(config))
    require_ranges(box, config)
    _check_ratios(box, config)
    check_flight_limits(box, config, model.aircraft)
    for name, start, bounds in (
        ("frequency", config.frequency, config.frequency_bounds),
        ("amplitude", config.amplitude, amplitude_range(config, model)),
    ):
        check_initial(box, name, start, bounds)


def require_samples(field: str, period: float, model: Model) -> None:
    """Raises ScenarioError for a period (s) that is not a whole number of control periods."""
    if model.control_period > 0:
        ratio = period / model.control_period
        remedy = (
            f"give a multiple of the control period {model.control_period}, such as "
            f"{max(round(ratio), 1) * model.control_period:.10g}"
        )
        is_whole = round(ratio) >= 1 and abs(ratio - round(ratio)) < 1e-6
        require(is_whole, field, period, remedy)


def check_initial(box: str, name: str, start: float, bounds: Any) -> None:
    """Raises ScenarioError for bounds, of a config's `box`, that do not hold an initial value."""
    low, high = require_array(f"{box}.{name}_bounds", bounds, [2], "lower, upper")
    require(
        0 < low <= start <= high,
        f"{box}.{name}_bounds",
        bounds,
        f"give bounds above zero that hold the initial {name} {start}",
    )


def _check_ratios(box: str, config: LimitsConfig) -> None:
    for name in (*(limit.field for limit in LIMITS), "speed_bound"):
        value = getattr(config, name)
        require(
            value <= LARGEST or value == math.inf,
            f"{box}.{name}",
            value,
            f"give at most {LARGEST:g}, in SI units",
        )
    for limit in LIMITS:
        if limit.is_least or limit.is_of_aircraft:
            continue
        lowest = [each.stated(config) for each in limits_of(limit.of) if each.is_least]
        lowest += [config.speed_bound] if limit.of is Of.SPEED else []
        least = _least_ratio(config) * max(lowest, default=0.0)
        value = limit.stated(config)
        remedy = f"give a number greater than {least:g}, or .inf for no limit"
        is_above = (is_number(value) and value > least) or value == math.inf
        require(is_above, f"{box}.{limit.field}", value, remedy)


def check_flight_limits(box: str, config: AircraftLimits, aircraft: Aircraft | None) -> None:
    """Raises ScenarioError for the first limit of aircraft that cannot be."""
    for limit in limits_of(Of.FLIGHT):
        value = getattr(config, limit.field)
        if value == math.inf:
            continue
        remedy = "it limits aircraft, and system.aircraft is none; give .inf for no limit"
        require(aircraft is not None, f"{box}.{limit.field}", value, remedy)
        remedy = f"give at most {limit.largest:.4g}, or .inf for no limit"
        require(value <= limit.largest, f"{box}.{limit.field}", value, remedy)


def check_pattern(box: str, model: Model, block: str) -> None:
    """Raises ScenarioError for a pattern that the block of a name cannot change."""
    require(
        not model.pattern.is_constant,
        box,
        block,
        "the pattern has no orbits that it could change; give !ConstantParameters with "
        "amplitude: 0, for aircraft !TurnRateOptimizer, or a pattern with orbits",
    )


def _least_ratio(config: LimitsConfig) -> float:
    """The least ratio of an upper to a lower bound on one quantity: both are tightened."""
    tightening = limit_tightening(config)
    return (1 + tightening) / (1 - tightening)
