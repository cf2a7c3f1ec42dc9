"""How far single parameters may change before the loop becomes unstable."""

import math
from dataclasses import dataclass

import numpy as np

from drake_nonstop.blocks.load_feedback import NoisyFeedbackConfig
from drake_nonstop.model.system import overridden
from drake_nonstop.scenario.loading import dump_scenario, parse_scenario
from drake_nonstop.scenario.overrides import changed
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.studies.run_all import Progress, no_progress, run_all
from drake_nonstop.studies.stability import NEUTRAL, at_rest, linearize
from drake_nonstop.validation import ScenarioError

_BISECTIONS = 5


@dataclass(kw_only=True)
class Margin:
    """The largest multiplier over one parameter, and where the loop becomes unstable."""

    name: str
    unit: str
    nominal: float
    values: list[float]  # rising
    largest: list[float]  # magnitudes of the largest multiplier at these values
    rates: list[float]  # 1/s, of the growth of a small deviation there
    low: float | None  # the loop is stable from here on; None: at every value that was tried
    high: float | None  # and up to here; both are the nominal value where it is unstable there


def find_margins(scenario: Scenario, progress: Progress = no_progress) -> list[Margin]:
    """The margins of carrier mass, the carriers' gains, delay and control period.

    One of them at a time is changed, in a process per core.

    Args:
        scenario: what is changed.
        progress: called with a description and the share that is done.

    Raises:
        ScenarioError: the scenario cannot be built, or a process died.
    """
    axes = {axis.name: axis for axis in _axes(scenario)}
    resting = dump_scenario(at_rest(scenario))  # as text, which can be sent to a process
    found: dict[str, dict[float, tuple[float, float]]] = {name: {} for name in axes}
    edges: dict[tuple[str, int], float | None] = {}

    def record(key: tuple[str, float], result: tuple[float, float]) -> None:
        name, value = key
        found[name][value] = result

    def failed(key: tuple[str, float], error: str) -> tuple[float, float]:
        raise ScenarioError(f"stability, {key[0]} = {key[1]:g}: {error}")

    def failed_edge(key: tuple[str, int], error: str) -> float | None:
        raise ScenarioError(f"stability, {key[0]}: {error}")

    run_all(
        _measure,
        [
            (name, value)
            for name, axis in axes.items()
            for value in sorted({*axis.values, axis.nominal})
        ],
        lambda key: (resting, axes[key[0]], key[1]),
        record,
        failed,
        what="linearizing",
        progress=progress,
    )
    run_all(
        _edge,
        [(name, side) for name in axes for side in (-1, 1)],
        lambda key: (resting, axes[key[0]], found[key[0]], key[1]),
        edges.__setitem__,
        failed_edge,
        what="searching the boundaries",
        progress=progress,
    )
    return [
        Margin(
            name=name,
            unit=axis.unit,
            nominal=axis.nominal,
            values=sorted(found[name]),
            largest=[found[name][value][0] for value in sorted(found[name])],
            rates=[found[name][value][1] for value in sorted(found[name])],
            low=edges[name, -1],
            high=edges[name, 1],
        )
        for name, axis in axes.items()
    ]


@dataclass(kw_only=True)
class _Axis:
    """A parameter, and the values of it at which the loop is linearized."""

    name: str
    unit: str
    override: str  # a format of the value
    nominal: float
    values: list[float]
    is_continuous: bool = True


_CONTROLLER_PARAMETERS = (
    ("position_gain", "K_p", "N/m"),
    ("velocity_gain", "K_d", "N s/m"),
    ("frequency", "carrier frequency", "rad/s"),
    ("damping", "carrier damping", "of critical"),
)


def _axes(scenario: Scenario) -> list[_Axis]:
    sample = scenario.control_period or 0.01
    controller = scenario.carrier_controller
    factors = np.geomspace(1 / 8, 8, 13)
    axes = [
        _Axis(
            name=name,
            unit=unit,
            override=override,
            nominal=nominal,
            values=(nominal * factors).tolist(),
        )
        for name, unit, override, nominal in (
            (
                "carrier mass",
                "kg",
                "simulated.carrier_mass={}",
                overridden(scenario.system, scenario.simulated).carrier_mass,
            ),
            *(
                (name, unit, f"carrier_controller.{field}={{}}", getattr(controller, field))
                for field, name, unit in _CONTROLLER_PARAMETERS
                if hasattr(controller, field)
            ),
        )
        if nominal > 0
    ]
    feedback, delay_override = scenario.load_feedback, "load_feedback.delay={}"
    if not isinstance(feedback, NoisyFeedbackConfig):
        feedback = NoisyFeedbackConfig(period=sample)
        delay_override = f"load_feedback=!NoisyFeedback {{{{delay: {{}}, period: {sample}}}}}"
    return [
        *axes,
        _Axis(
            name="delay",
            unit="s",
            override=delay_override,
            nominal=feedback.delay,
            values=[k * sample for k in range(9)],
            is_continuous=False,
        ),
        _Axis(
            name="control period",
            unit="s",
            override="control_period={}",
            nominal=scenario.control_period,
            values=[0.0, 0.0025, 0.005, 0.01, 0.015, 0.02, 0.03, 0.04],
        ),
    ]


def _measure(resting: str, axis: _Axis, value: float) -> tuple[float, float]:
    """The largest multiplier's magnitude, and the rate (1/s), at a parameter's value."""
    # A copy of a scenario that was trusted when it was loaded.
    scenario = parse_scenario(resting, trust=True)
    found = linearize(changed(scenario, [axis.override.format(value)]))
    return found.largest, found.rate


def _edge(
    resting: str, axis: _Axis, found: dict[float, tuple[float, float]], side: int
) -> float | None:
    """The value at which the loop becomes unstable, below (-1) or above (1) the nominal one."""
    inside = axis.nominal
    if found[inside][0] >= NEUTRAL:
        return inside
    for value in sorted(found)[::side]:
        if side * (value - inside) <= 0:
            continue
        if found[value][0] < NEUTRAL:
            inside = value
            continue
        outside = value
        for _ in range(_BISECTIONS if axis.is_continuous and inside > 0 else 0):
            middle = math.sqrt(inside * outside)
            if _measure(resting, axis, middle)[0] < NEUTRAL:
                inside = middle
            else:
                outside = middle
        return inside
    return None
