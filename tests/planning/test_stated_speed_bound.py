"""A speed bound that is stated as a multiple of the stall speed."""

import math

import pytest

from drake_nonstop import ScenarioError, load_scenario

STALL = math.sqrt(2 * 6.0 * 9.81 / (1.225 * 0.98 * 1.4))
PATH = "optimization_layer.speed_bound"


def test_a_scenario_has_it_in_metres_per_second_once_it_is_sampled():
    scenario = load_scenario("aircraft_rest", [f"{PATH}=1.4 V_s"])
    assert scenario.optimization_layer.speed_bound == "1.4 V_s"
    assert scenario.speed_bound == pytest.approx(1.4 * STALL)
    assert scenario.sampled().optimization_layer.speed_bound == pytest.approx(1.4 * STALL)
    heavier = load_scenario("aircraft_rest", [f"{PATH}=1.4 V_s", "system.aircraft.mass=24"])
    assert heavier.speed_bound == pytest.approx(2 * 1.4 * STALL)


@pytest.mark.parametrize("text", ["V_s", "1.4V_s", "1.4 Vs", "-1 V_s", "nan V_s", "a b c", '""'])
def test_other_texts_get_one_sentence(text):
    with pytest.raises(ScenarioError, match=r'speed_bound = .*as "1\.4 V_s"$'):
        load_scenario("aircraft_rest", [f"{PATH}={text}"]).sampled()
