"""The fields of a horizon, and the checks of their values."""

import math
from dataclasses import dataclass, replace
from typing import TypeVar

from drake_nonstop.model.system import Model
from drake_nonstop.planning.plan import DEGREE
from drake_nonstop.planning.problem_config import LimitsConfig
from drake_nonstop.planning.step_program import DAQP, SOLVERS
from drake_nonstop.validation import (
    checked,
    non_negative,
    number_with,
    one_of,
    positive,
    require,
    require_period,
    require_ranges,
    require_whole,
    whole,
)

_LEAST_INSTANTS = 16  # in a turn
_MOST_INSTANTS = 20000  # in a horizon
_MOST_INTERVALS = 200
_MOST_SMOOTHING = 10.0  # intervals; its sixth power is in the cost
_WHOLE = 1e-6  # how far from a whole number a ratio of times may be
_Horizon = TypeVar("_Horizon", bound="HorizonConfig")


@dataclass(kw_only=True)
class HorizonConfig:
    """The horizon, its cost and its constraints; with those of a `LimitsConfig`.

    With `fixed_coefficients` 0 the problem is one of a plan that has no predecessor.
    """

    horizon: float = non_negative(0.0)  # s; 0: nearly two turns, 15 intervals of knots at least
    knot_spacing: float = non_negative(0.0)  # s, and between two plans; 0: an eighth of a turn
    instants: int = 20  # between two knots, at which the carriers' flight is constrained
    terminal_knots: int = 4  # of the last part, in which all phases of the orbit are constrained
    terminal_instants: int = 2  # of it, between two knots
    terminal_phases: int = whole(24, 8, 360)  # of the orbit
    amplitude_weight: float = positive(4.0)  # w_A
    smoothing: float = positive(  # τ, in intervals between knots
        0.4,
        number_with(
            lambda time: time <= _MOST_SMOOTHING,
            f"give at most {_MOST_SMOOTHING:g} intervals between knots",
        ),
    )
    slack_weight: float = positive(100.0)  # ρ
    solver: str = checked(  # of the quadratic programs: "daqp", "clarabel", "snopt" or "ipopt"
        DAQP, one_of(SOLVERS, f"give one of {', '.join(SOLVERS)}")
    )
    fixed_coefficients: int = 4  # the first of ξ and A: 4 for three continuous rates
    orbit_tightening: float = non_negative(0.005)  # of the nominal orbits' speed, the least margin


def timed(config: _Horizon, frequency: float, control_period: float) -> _Horizon:
    """The config with its times, as they follow from the nominal ξ (rad/s) where they are 0.

    The knots then are whole control periods (s) apart; 0: there is none.
    """
    turn = 2 * math.pi / frequency
    spacing = config.knot_spacing
    if spacing == 0:
        spacing = turn / 8
        if control_period > 0:
            spacing = max(round(spacing / control_period), 1) * control_period
    return replace(
        config, knot_spacing=spacing, horizon=config.horizon or _knots(turn, spacing) * spacing
    )


def _knots(turn: float, spacing: float) -> int:
    """The intervals between knots in nearly two turns: 15 of an eighth of one."""
    return max(15, math.ceil(1.8 * turn / spacing))


def check_horizon(box: str, config: HorizonConfig, limits: LimitsConfig, model: Model) -> None:
    """Raises ScenarioError for the first field, of the config's `box`, that cannot be used.

    Args:
        box: the name of the config's box.
        config: as it was given: its times may be 0, see `timed`.
        limits: checked already, see `check_limits`.
        model: what the controllers believe.
    """
    require_ranges(box, config)
    times = timed(config, limits.frequency, model.control_period)
    turn = 2 * math.pi / limits.frequency
    _check_spacing(box, times.knot_spacing, model.control_period)
    _check_horizon(box, config.horizon, times, turn)
    intervals = round(times.horizon / times.knot_spacing)
    least = math.ceil(_LEAST_INSTANTS * times.knot_spacing / turn - _WHOLE)
    for name, low, high in (
        ("instants", least, max(_MOST_INSTANTS // intervals, least)),
        ("terminal_knots", 1, intervals),
        ("terminal_instants", 1, config.instants),
        ("fixed_coefficients", DEGREE, intervals + DEGREE - 1),
    ):
        require_whole(f"{box}.{name}", getattr(config, name), low, high)


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
