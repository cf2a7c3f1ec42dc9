"""A governor that slows the load's trajectory down where no ξ and A keep the limits with it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import System

from drake_nonstop.mechanics.reference_preview import ReferencePreview
from drake_nonstop.mechanics.signals import (
    LOAD_REFERENCE_SIZE,
    LOAD_STATE_SIZE,
    WIND_SIZE,
)
from drake_nonstop.model.block import Block, signal_sizes
from drake_nonstop.model.system import Model
from drake_nonstop.optimization.horizon_config import HorizonConfig
from drake_nonstop.optimization.limits import Of, limits_of
from drake_nonstop.optimization.problem_config import (
    LimitsConfig,
    with_fields_of,
    with_stated_bound,
)
from drake_nonstop.optimization.stretched_time import PathDelay, Winds, still_air, stretching
from drake_nonstop.systems.wiring import input_names, output_names
from drake_nonstop.validation import (
    ScenarioError,
    StrictFields,
    fulfilling,
    number_with,
    positive,
    require,
    require_ranges,
    warn_user,
)

_FIELD = "reference_governor"
_HIGHER_RATES, _PREVIEW = "reference_higher_rates", "reference_preview"
_WIND, _LOAD_STATE = "wind_estimate", "load_state"


@dataclass(kw_only=True)
class ReferenceGovernorConfig(StrictFields):
    """How far, and how smoothly, a `ReferenceGovernor` slows the load's trajectory down."""

    least_rate: float = fulfilling(  # of the trajectory's time by real time
        0.2, lambda rate: 0.01 <= rate <= 1, "give 0.01 to 1"
    )
    largest_rate: float = fulfilling(  # likewise, to catch up afterwards; 1: it stays late
        1.1, lambda rate: 1 <= rate <= 2, "give 1 to 2"
    )
    change_time: float = positive(  # s, in which the rate changes by 1 at the fastest
        2.0, number_with(lambda time: time >= 0.1, "give at least 0.1 s")
    )


class ReferenceGovernor(Block):
    """The load's trajectory p(s(t)), in a time of its own s = t − d(t) that passes at ṡ ≤ 1.

    It takes the place of the trajectory's block, in which a motion that needs no governor stays as
    it is, to the bit. The delay d is a spline of fourth degree, found
    before the run for the ε and the other limits of the optimization layer's config, see
    `optimization.stretched_time.stretching`; later changes of ε and of what is believed of load
    and cables do not change it. The rate falls where that is the only way to keep the limits, and
    rises above 1 afterwards, until s = t again. Velocities, accelerations and the jerk are exact,
    see `mechanics.reference_preview`. A reference governor in the sense of Garone, Di Cairano and
    Kolmanovsky, Automatica 75 (2017), by time scaling.

    Of aircraft the bound is on the airspeed, and the layer's limits of their lift, bank, climb and
    thrust count, too: what matters is the load's velocity less the wind that `wind_estimate` tells
    at the time and place of its reference. ξ and A are looked for within a factor of 1.5 of the
    nominal ones.

    `reference_higher_rates` is left out where the trajectory's preview does not tell it; its snap
    steps at the knots of d. `reference_preview` is a `ReferencePreview`.

    Args:
        preview: of the trajectory.
        delay: d.

    Raises:
        ScenarioError: the time of a context of AutoDiffXd has derivatives, or one of Expression
            has variables.
    """

    makes = ("reference", _HIGHER_RATES, _PREVIEW, "reference_delay")

    def __init__(self, preview: ReferencePreview, delay: PathDelay):
        own = preview.higher_rates
        higher_rates = None if own is None else partial(delay.stretched_higher_rates, preview)
        self._delay = delay
        self._stretched = ReferencePreview(
            lambda time: delay.stretched(preview, np.array([time]))[0],
            references=partial(delay.stretched, preview),
            higher_rates=higher_rates,
        )
        super().__init__(None)

    @staticmethod
    def equations(*signals: NDArray) -> tuple[NDArray, ...]:
        return signals

    def outputs(self, model: Model) -> tuple[str, ...]:
        is_known = self._stretched.higher_rates is not None
        return tuple(name for name in self.makes if name != _HIGHER_RATES or is_known)

    def fixed_outputs(self) -> Mapping[str, Any]:
        return {_PREVIEW: self._stretched}

    def quantities(self, model: Model) -> Mapping[str, int]:
        return signal_sizes(self, model, [k for k in self.outputs(model) if k != _PREVIEW])

    def precomputed_inputs(self, names: Sequence[str], times: NDArray) -> list[NDArray]:
        """Rows of the signals at times (k,), s."""
        return [self._rows(name, times) for name in names]

    def _rows(self, name: str, times: NDArray) -> NDArray:
        higher_rates = self._stretched.higher_rates
        if name == "reference_delay":
            return self._delay.at(times)[:, :1]
        if name == "reference" or higher_rates is None:
            return self._stretched.at(times)
        return np.array([higher_rates(time) for time in times.tolist()])

    def precomputed_input_rates(self, names: Sequence[str], times: NDArray) -> list[NDArray]:
        """Raises ScenarioError: they are not known."""
        raise ScenarioError(
            f"time of {self.box()} = a number with derivatives: the governor does not "
            f"differentiate its references by time; leave {_FIELD} out"
        )


def governed(
    model: Model,
    config: ReferenceGovernorConfig,
    trajectory: System,
    layer: Any,
    duration: float,
    wind: System | None = None,
    wind_signal: str = _WIND,
) -> System:
    """The `ReferenceGovernor` of a trajectory; the trajectory itself where none is needed.

    Args:
        model: what the controllers believe.
        config: of the governor.
        trajectory: the block for the box `load_trajectory`.
        layer: the optimization layer's config, with the margin that was computed for it.
        duration: s, how long the motion is looked at.
        wind: the block that `wind_estimate` comes from, which counts for aircraft; None: still air.
        wind_signal: its name there.

    Raises:
        ScenarioError: a parameter cannot be used, or the trajectory does not tell its motion, or
            the wind is not known beforehand.
    """
    _check(model, config)
    said = f"with load_trajectory = {type(trajectory).__name__}"
    is_known = _PREVIEW in output_names(trajectory) and trajectory.num_input_ports() == 0
    remedy = f"give this block, without inputs, an output {_PREVIEW} of a ReferencePreview"
    require(is_known, _FIELD, said, remedy)
    preview = trajectory.GetOutputPort(_PREVIEW).Eval(trajectory.CreateDefaultContext())
    is_known = isinstance(preview, ReferencePreview) and preview.end_time == np.inf
    remedy = f"give a {_PREVIEW} that is known for ever, of end_time inf"
    require(is_known, _FIELD, said, remedy)
    limits, can_plan = _limits(model, layer)
    counts_wind = model.aircraft is not None and getattr(layer, "wind", True) is not False
    found = stretching(
        model,
        limits,
        preview,
        duration,
        least_rate=config.least_rate,
        largest_rate=config.largest_rate,
        change_time=config.change_time,
        can_plan=can_plan,
        config=with_fields_of(HorizonConfig, layer),
        name=lambda: _FIELD,
        winds=_winds(wind, wind_signal) if wind is not None and counts_wind else still_air,
    )
    less = "give a lower speed_bound, or wider bounds of frequency and amplitude"
    if model.aircraft is not None:
        fields = ", ".join(limit.field for limit in limits_of(Of.FLIGHT))
        less += f", higher ones of {fields}, or less wind"
    if len(found.not_at_rest):
        warn_user(
            f"{_FIELD} = {type(config).__name__.removesuffix('Config')}: from "
            f"{found.not_at_rest[0]:.1f} s of the motion on even a load at rest leaves no ξ and A "
            f"that fulfil the limits at all phases, and the motion is not slowed there; {less}"
        )
    if len(found.too_fast):
        warn_user(
            f"{_FIELD}.least_rate = {config.least_rate:g}: at {found.too_fast[0]:.1f} s of the "
            "motion it is too fast for the limits to hold at all phases; give a lower one"
        )
    return trajectory if found.delay is None else ReferenceGovernor(preview, found.delay)


def _check(model: Model, config: ReferenceGovernorConfig) -> None:
    require_ranges(_FIELD, config)
    require(
        not model.pattern.is_constant,
        _FIELD,
        f"with pattern = {type(model.pattern_config).__name__.removesuffix('Config')}",
        "give a pattern with orbits, or leave reference_governor out: these carriers' speeds are "
        "those of the load's turn",
    )


def _winds(block: System, signal: str) -> Winds:
    """Value of a block's signal of the wind for a load that is on its reference."""
    context, port = block.CreateDefaultContext(), block.GetOutputPort(signal)
    reads_load = _LOAD_STATE in input_names(block)

    def winds(times: NDArray, references: NDArray) -> NDArray:
        found = np.empty((len(times), WIND_SIZE))
        for row, time, reference in zip(found, times, references, strict=True):
            context.SetTime(time)
            if reads_load:
                block.GetInputPort(_LOAD_STATE).FixValue(context, reference[:LOAD_STATE_SIZE])
            row[:] = port.Eval(context)
        return found

    remedy = (
        f"its {signal} is not known before the run; let it follow from time and {_LOAD_STATE} "
        f"alone, or leave {_FIELD} out"
    )
    said = f"with wind = {type(block).__name__}"
    require(context.is_stateless(), _FIELD, said, remedy)
    try:
        winds(np.zeros(1), np.eye(LOAD_REFERENCE_SIZE)[:1])
    except ScenarioError:
        raise
    except Exception as error:
        raise ScenarioError(f"{_FIELD} = {said}: {remedy}") from error
    return winds


def _limits(model: Model, layer: Any) -> tuple[LimitsConfig, bool]:
    """Limits of a layer's config, and whether it may change ξ and A."""
    own = with_fields_of(LimitsConfig, layer)
    limits = with_stated_bound("optimization_layer", own, model)
    can_plan = hasattr(layer, "frequency_bounds")
    if not can_plan and hasattr(layer, "frequency") and hasattr(layer, "amplitude"):
        limits.frequency_bounds = [layer.frequency] * 2
        limits.amplitude_bounds = [layer.amplitude] * 2
    return limits, can_plan
