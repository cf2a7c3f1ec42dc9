"""How far single parameters may change before the loop becomes unstable."""

import functools
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from drake_nonstop.analysis.stability import NEUTRAL, Stability, at_rest, linearize
from drake_nonstop.blocks.load_feedback import MeasurementConfig, NoisyFeedbackConfig
from drake_nonstop.model.aircraft import values_of
from drake_nonstop.model.system import overridden
from drake_nonstop.scenario.loading import dump_scenario, parse_scenario
from drake_nonstop.scenario.overrides import changed
from drake_nonstop.scenario.schema import Scenario, sample
from drake_nonstop.studies.journal import open_journal, settings_of
from drake_nonstop.studies.processes import require_main
from drake_nonstop.studies.run_all import Progress, no_progress, run_all
from drake_nonstop.systems.tracing import NotFiniteError
from drake_nonstop.validation import ScenarioError, message_of

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
    refused: dict[float, str]  # values with which there is no such loop, and why


def find_margins(
    scenario: Scenario,
    progress: Progress = no_progress,
    *,
    folder: str | Path | None = None,
    restart: bool = False,
) -> list[Margin]:
    """The margins of carrier mass, the carriers' gains, delay and control period.

    One of them at a time is changed, in a process per core. A value with which the loop cannot be
    built is refused, and the others are tried.

    Args:
        scenario: what is changed.
        progress: called with a description and the share that is done.
        folder: for a journal of what is found: interrupted, the same call continues from there;
            complete, it begins again. None: for no journal.
        restart: whether to drop what the folder has of an interrupted call.

    Raises:
        ScenarioError: the scenario cannot be built, a process died, processes end as they start,
            or the folder cannot be written, or has unfinished runs of other settings.
        StudyInterrupted: Ctrl-C; what is found stays in the folder.
    """
    require_main()
    scenario, _ = sample(scenario)
    axes = {axis.name: axis for axis in _axes(scenario)}
    resting = dump_scenario(at_rest(scenario))  # as text, which can be sent to a process
    measured = {
        f"{name} = {value!r}": (name, value)
        for name, axis in axes.items()
        for value in sorted({*axis.values, axis.nominal})
    }
    edges = {
        f"{name}, {'upper' if side > 0 else 'lower'} boundary": (name, side)
        for name in axes
        for side in (-1, 1)
    }
    keys = [*measured, *edges]
    settings = margins_settings(scenario)
    with open_journal(
        folder, settings, keys, {"found": list}, restart=restart, what="linearizations"
    ) as journal:

        def failed(key: str, error: str) -> list[Any]:
            raise ScenarioError(f"stability, {key}: {error}")

        run = functools.partial(
            run_all,
            record=lambda key, result: journal.record(key, {"found": result}),
            failed=failed,
            done=journal,
            progress=progress,
        )

        def measure_arguments(key: str) -> tuple:
            name, value = measured[key]
            return resting, axes[name].override, value

        def edge_arguments(key: str) -> tuple:
            name, side = edges[key]
            return resting, axes[name], found[name], side

        run(_measure, [*measured], measure_arguments, what="linearizing")
        found: dict[str, dict[float, list[float]]] = {name: {} for name in axes}
        refused: dict[str, dict[float, str]] = {name: {} for name in axes}
        for key, (name, value) in measured.items():
            *numbers, why = journal.result(key)["found"]
            if numbers:
                found[name][value] = numbers
            else:
                refused[name][value] = why
        run(_edge, [*edges], edge_arguments, what="searching the boundaries")
        ends = {edges[key]: journal.result(key)["found"][0] for key in edges}
        journal.finish()
    return [
        Margin(
            name=name,
            unit=axis.unit,
            nominal=axis.nominal,
            values=sorted(found[name]),
            largest=[found[name][value][0] for value in sorted(found[name])],
            rates=[found[name][value][1] for value in sorted(found[name])],
            low=ends[name, -1],
            high=ends[name, 1],
            refused=refused[name],
        )
        for name, axis in axes.items()
    ]


def margins_settings(scenario: Scenario) -> str:
    """A name of all that the margins depend on; see `settings_of`."""
    return settings_of("stability", dump_scenario(scenario))


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


def _mass(scenario: Scenario) -> tuple[str, float]:
    """The override that gives the carriers another mass, and the mass, kg."""
    system = overridden(scenario.system, scenario.simulated)
    if system.aircraft is None:
        return "simulated.carrier_mass={}", system.carrier_mass
    return "simulated.aircraft.mass={}", values_of(system.aircraft)["mass"]


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
                *_mass(scenario),
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
    if not isinstance(feedback, MeasurementConfig):
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


def _measure(resting: str, override: str, value: float) -> list[Any]:
    """The largest multiplier's magnitude, the rate (1/s), and None; or why the value is refused."""
    found = _linearized_at(resting, override, value)
    return [found] if isinstance(found, str) else [found.largest, found.rate, None]


def _linearized_at(resting: str, override: str, value: float) -> Stability | str:
    """Result at a parameter's value, or why there is no such loop."""
    # A copy of a scenario that was trusted when it was loaded.
    scenario = parse_scenario(resting, trust=True)
    try:
        return linearize(changed(scenario, [override.format(value)]))
    except (ScenarioError, NotFiniteError) as error:
        return message_of(error)


def _edge(
    resting: str, axis: _Axis, found: dict[float, list[float]], side: int
) -> list[float | None]:
    """The value at which the loop becomes unstable, below (-1) or above (1) the nominal one."""
    inside = axis.nominal
    if inside not in found or found[inside][0] >= NEUTRAL:
        return [inside]
    for value in sorted(found)[::side]:
        if side * (value - inside) <= 0:
            continue
        if found[value][0] < NEUTRAL:
            inside = value
            continue
        outside = value
        for _ in range(_BISECTIONS if axis.is_continuous and inside > 0 else 0):
            middle = math.sqrt(inside * outside)
            there = _linearized_at(resting, axis.override, middle)
            if isinstance(there, Stability) and there.largest < NEUTRAL:
                inside = middle
            else:
                outside = middle
        return [inside]
    return [None]
