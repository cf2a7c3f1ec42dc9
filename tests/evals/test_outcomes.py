"""The outcome of each scenario that comes with the package."""

import pytest

from drake_nonstop import scenario_names

OUTCOMES = {
    "aircraft_co_rotating": "ok",
    "aircraft_co_rotating_gusty": "ok",
    "aircraft_co_rotating_rising_wind": "ok",
    "aircraft_rest": "ok",
    "aircraft_six": "ok",
    "aircraft_small": "ok",
    "aircraft_three": "ok",
    "aircraft_transfer": "ok",
    "aircraft_transfer_gusty": "ok",
    "aircraft_transfer_rising_wind": "ok",
    "line": "ok",
    "line_without_optimization": "bound_missed",
    "paper_line": "bound_missed",
    "paper_line_without_optimization": "bound_missed",
    "paper_quintic": "bound_missed",
    "quintic": "ok",
    "real_scale_carousel": "collision",
    "real_scale_cycle": "collision",
    "real_scale_spread": "ok",
    "static_hold_open_loop": "ok",
    "three_carriers": "ok",
}


@pytest.mark.parametrize("name", scenario_names())
def test_outcome_of_a_shipped_scenario(evaluated, name):
    _, metrics = evaluated(name)
    assert metrics["outcome"] == OUTCOMES[name], metrics["reasons"]
    assert metrics["warnings"] == []
