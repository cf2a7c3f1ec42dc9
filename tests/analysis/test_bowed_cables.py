"""What is told of bowed cables beside flights of cables with nodes."""

import pytest
from golden.numbers import read_table
from helpers import nightly_beyond

from drake_nonstop import aircraft_margins, load_scenario


@pytest.mark.parametrize(
    "name",
    nightly_beyond(1, "flights", ["aircraft_rest_cables", "aircraft_co_rotating_cables"]),
)
def test_what_is_told_of_bowed_cables_is_what_is_flown(name):
    """Of flights of `LumpedCables`, whose load is up to 10 mm off its place."""
    found, flown = aircraft_margins(load_scenario(name)), read_table()[name]
    value = {margin.name: margin.value for margin in found.margins}
    for told, quantity, tolerance in (
        (value["bank"], "aircraft.bank_max_rad", 0.002),
        (value["C_L / C_Lmax"], "aircraft.lift_share_max", 0.004),
        (value["carriers apart"], "carriers.separation_min_m", 0.02),
        (found.ranges.airspeed[0], "aircraft.airspeed_min_m_s", 0.01),
        (found.ranges.thrust[1], "aircraft.thrust_max_N", 0.1),
        (found.ranges.thrust[0], "aircraft.thrust_min_N", 0.1),
        (found.propulsive_power, "aircraft.power_mean_W", 0.5),
        (found.cables.tension[0], "cables.tension_min_N", 0.3),
    ):
        assert told == pytest.approx(float(flown[quantity].value), abs=tolerance), quantity
    assert found.cables.are_flown
    assert "N at the carriers" in found.cables.text
    assert not found.cables.warning
