"""Errors that a scenario states, and the scenario without them or with other random numbers."""

import dataclasses

from drake_nonstop.blocks.load_disturbance import NoDisturbanceConfig
from drake_nonstop.blocks.wind import StillAirConfig
from drake_nonstop.blocks.wind_estimator import KnownWindConfig
from drake_nonstop.diagrams.nonstop import BOXES
from drake_nonstop.model.system import SystemOverrides
from drake_nonstop.scenario.errors import NONE
from drake_nonstop.scenario.schema import Scenario, has_distributions

_GUSTS = ("gust", "load_gust", "gust_force")  # fields of blocks, standard deviations
_NOISE, _BELIEVED = "noise", "believed_"  # how names of fields end, and how those of filters begin


def without_noise(scenario: Scenario) -> Scenario:
    """The scenario without noise and gusts; what a filter believes of them stays.

    These are the fields of its blocks whose names end in "noise", and those of gusts.
    """
    quiet = {}
    for name in BOXES:
        config = getattr(scenario, name)
        fields = dict.fromkeys(
            (
                field.name
                for field in dataclasses.fields(config)
                if field.name in _GUSTS
                or (field.name.endswith(_NOISE) and not field.name.startswith(_BELIEVED))
            ),
            0.0,
        )
        if fields:
            quiet[name] = dataclasses.replace(config, **fields)
    return dataclasses.replace(scenario, **quiet)


def without_errors(scenario: Scenario) -> Scenario:
    """The scenario as its controllers believe it to be.

    Besides noise and gusts it has no `errors`, no disturbance, no delay of the feedback, no
    `simulated` fields and no `start_error`, and the wind is known.
    """
    quiet = without_noise(scenario)
    feedback, has_wind = quiet.load_feedback, quiet.wind != StillAirConfig()
    if getattr(feedback, "delay", 0.0):
        feedback = dataclasses.replace(feedback, delay=0.0)
    return dataclasses.replace(
        quiet,
        errors=NONE,
        simulated=SystemOverrides(),
        start_error=[0.0] * 6,
        load_feedback=feedback,
        load_disturbance=NoDisturbanceConfig(),
        wind_estimator=KnownWindConfig() if has_wind else quiet.wind_estimator,
    )


def is_random(scenario: Scenario) -> bool:
    """Whether flights of other seeds differ."""
    return scenario != without_noise(scenario) or has_distributions(scenario)


def with_seed(scenario: Scenario, number: int) -> Scenario:
    """The scenario whose random numbers are those of the seeds `number` above its own."""
    seeded = {
        name: dataclasses.replace(config, seed=config.seed + number)
        for name in BOXES
        if isinstance(getattr(config := getattr(scenario, name), "seed", None), int)
    }
    return dataclasses.replace(scenario, random_seed=scenario.random_seed + number, **seeded)
