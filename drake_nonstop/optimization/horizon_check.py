"""The checks of a horizon's values."""

import math

from drake_nonstop.model.system import Model
from drake_nonstop.optimization.horizon_problem import HorizonConfig, timed
from drake_nonstop.optimization.plan import DEGREE
from drake_nonstop.optimization.problem_config import LimitsConfig
from drake_nonstop.validation import require, require_period, require_ranges

_LEAST_INSTANTS = 16  # in a turn
_MOST_INSTANTS = 20000  # in a horizon
_MOST_INTERVALS = 200
_MOST_SMOOTHING = 10.0  # intervals; its sixth power is in the cost
_LEAST_PHASES, _MOST_PHASES = 8, 360
_MOST_AMPLITUDES = 1000
_WHOLE = 1e-6  # how far from a whole number a ratio of times may be


def check_horizon(box: str, config: HorizonConfig, limits: LimitsConfig, model: Model) -> None:
    """Raises ScenarioError for the first field, of the config's `box`, that cannot be used.

    Args:
        box: the name of the config's box.
        config: as it was given: its times may be 0, see `timed`.
        limits: checked already, see `check_limits`.
        model: what the controllers believe.
    """
    require_ranges(box, config)
    is_smooth = config.smoothing <= _MOST_SMOOTHING
    remedy = f"give at most {_MOST_SMOOTHING:g} intervals between knots"
    require(is_smooth, f"{box}.smoothing", config.smoothing, remedy)
    times = timed(config, limits.frequency, model.control_period)
    turn = 2 * math.pi / limits.frequency
    _check_spacing(box, times.knot_spacing, model.control_period)
    _check_horizon(box, config.horizon, times, turn)
    intervals = round(times.horizon / times.knot_spacing)
    least = math.ceil(_LEAST_INSTANTS * times.knot_spacing / turn - _WHOLE)
    _check_whole(box, config, "instants", least, max(_MOST_INSTANTS // intervals, least))
    _check_whole(box, config, "terminal_knots", 1, intervals)
    _check_whole(box, config, "terminal_instants", 1, config.instants)
    _check_whole(box, config, "terminal_phases", _LEAST_PHASES, _MOST_PHASES)
    _check_whole(box, config, "terminal_amplitudes", 2, _MOST_AMPLITUDES)
    _check_whole(box, config, "fixed_coefficients", DEGREE, intervals + DEGREE - 1)


def _check_spacing(box: str, spacing: float, control_period: float) -> None:
    require_period(f"{box}.knot_spacing", spacing)
    if control_period > 0:
        ratio = spacing / control_period
        require(
            round(ratio) >= 1 and abs(ratio - round(ratio)) < _WHOLE,
            f"{box}.knot_spacing",
            spacing,
            f"give a multiple of the control period {control_period}, such as "
            f"{_multiple(control_period, max(round(ratio), 1))}, or 0 for an eighth of a turn",
        )


def _check_horizon(box: str, given: float, config: HorizonConfig, turn: float) -> None:
    """Checks the horizon, 0 is given for what follows from a turn."""
    spacing = config.knot_spacing
    ratio, least = config.horizon / spacing, math.ceil(turn / spacing - _WHOLE)
    require(
        config.horizon >= turn * (1 - _WHOLE),
        f"{box}.horizon",
        given,
        f"it is shorter than a turn of the carriers; give at least {_multiple(spacing, least)} s",
    )
    longest = _MOST_INTERVALS * spacing
    fewer = f"at most {_MOST_INTERVALS} of them, {longest:.10g} s, or knots further apart"
    if longest < turn:
        apart = math.ceil(1e4 * config.horizon / _MOST_INTERVALS) / 1e4
        fewer = f"{box}.knot_spacing of at least {apart:g} s"
    require(
        ratio < _MOST_INTERVALS + 0.5,
        f"{box}.horizon",
        given,
        f"it has {ratio:.0f} intervals between knots; give {fewer}",
    )
    require(
        abs(ratio - round(ratio)) < _WHOLE,
        f"{box}.horizon",
        given,
        f"give a multiple of the {spacing:.10g} s between knots, such as "
        f"{_multiple(spacing, math.ceil(ratio))}",
    )


def _multiple(spacing: float, count: int) -> str:
    return f"{count * spacing:.10g}"


def _check_whole(box: str, config: HorizonConfig, name: str, least: int, most: int) -> None:
    value = getattr(config, name)
    require(
        isinstance(value, int) and not isinstance(value, bool) and least <= value <= most,
        f"{box}.{name}",
        value,
        f"give {least}" if least == most else f"give a whole number from {least} to {most}",
    )
