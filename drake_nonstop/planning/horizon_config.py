"""The fields of a horizon, and the checks of their values."""

import math
from dataclasses import dataclass, replace
from typing import TypeVar

from drake_nonstop.model.system import Model
from drake_nonstop.planning.plan import DEGREE
from drake_nonstop.planning.problem_config import LimitsConfig, require_samples
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
)

_LEAST_INSTANTS = 16  # in a turn
_MOST_INSTANTS = 20000  # in a horizon
_MOST_INTERVALS = 200
_TURNS = 1.8  # in a plan
_MOST_SMOOTHING = 10.0  # intervals; its sixth power is in the cost
_WHOLE = 1e-6  # how far from a whole number a ratio of times may be
_Horizon = TypeVar("_Horizon", bound="HorizonConfig")


@dataclass(kw_only=True)
class HorizonConfig:
    """The horizon, its cost and its constraints; with those of a `LimitsConfig`.

    With `fixed_coefficients` 0 the problem is one of a plan that has no predecessor.
    """

    intervals: int = 0  # of a plan, between knots; 0: nearly two turns, 15 at least
    knot_spacing: float = non_negative(0.0)  # s, also between plans; 0: an eighth of a turn
    instants: int = 20  # between two knots, at which the carriers' flight is constrained
    smoothing: float = positive(  # τ, in intervals between knots
        0.4,
        number_with(
            lambda time: time <= _MOST_SMOOTHING,
            f"give at most {_MOST_SMOOTHING:g} intervals between knots",
        ),
    )
    solver: str = checked(  # of the quadratic programs: "daqp", "clarabel", "snopt" or "ipopt"
        DAQP, one_of(SOLVERS, f"give one of {', '.join(SOLVERS)}")
    )
    fixed_coefficients: int = 4  # first ones of ξ and A; 4: three rates are continuous


def timed(config: _Horizon, frequency: float, control_period: float) -> _Horizon:
    """The config with its knots, as they follow from the nominal ξ (rad/s) where they are 0.

    They then are whole control periods (s) apart; 0: there is none.
    """
    turn = 2 * math.pi / frequency
    spacing = config.knot_spacing
    if spacing == 0:
        spacing = turn / 8
        if control_period > 0:
            spacing = max(round(spacing / control_period), 1) * control_period
    intervals = config.intervals or max(15, math.ceil(_TURNS * turn / spacing))
    return replace(config, knot_spacing=spacing, intervals=intervals)


def check_horizon(box: str, config: HorizonConfig, limits: LimitsConfig, model: Model) -> None:
    """Raises ScenarioError for the first field, of the config's `box`, that cannot be used.

    Args:
        box: the name of the config's box.
        config: as it was given: its knots may be 0, see `timed`.
        limits: checked already, see `check_limits`.
        model: what the controllers believe.
    """
    require_ranges(box, config)
    turn = 2 * math.pi / limits.frequency
    times = timed(config, limits.frequency, model.control_period)
    spacing, intervals = times.knot_spacing, times.intervals
    name = f"{box}.knot_spacing"
    require_period(name, spacing)
    require_samples(name, spacing, model)
    least = math.ceil(1e4 * _TURNS * turn / _MOST_INTERVALS) / 1e4
    remedy = f"give at least {least:g} s, or 0 for an eighth of a turn"
    require(spacing >= least, name, spacing, remedy)
    turn_of_knots = math.ceil(turn / spacing - _WHOLE)
    require_whole(f"{box}.intervals", intervals, max(turn_of_knots, 4), _MOST_INTERVALS)
    few = max(math.ceil(_LEAST_INSTANTS * spacing / turn - _WHOLE), 2)
    most = max(_MOST_INSTANTS // intervals, few)
    require_whole(f"{box}.instants", config.instants, few, most)
    fixed = config.fixed_coefficients
    require_whole(f"{box}.fixed_coefficients", fixed, DEGREE, intervals + DEGREE - 1)
