"""The fields of a system's aircraft in files, overrides and dumps."""

import pickle

import pytest

from drake_nonstop import (
    ScenarioError,
    dump_scenario,
    load_scenario,
    make_nonstop,
    parse_scenario,
)
from drake_nonstop.model.aircraft import AircraftParameters
from drake_nonstop.scenario.describe import commented_scenario
from drake_nonstop.scenario.overrides import changed

FILE = "x: {system: {aircraft: {model: rascal_110, mass: 6.2}}}"


def test_a_dump_comes_back():
    scenario = parse_scenario(FILE)
    assert scenario.system.aircraft == AircraftParameters(model="rascal_110", mass=6.2)
    assert parse_scenario(dump_scenario(scenario)) == scenario
    assert parse_scenario(commented_scenario(scenario, "x")) == scenario
    assert pickle.loads(pickle.dumps(scenario)) == scenario
    assert "aircraft" not in dump_scenario(load_scenario("quintic"))


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        ("{wing: 2}", "system.aircraft.wing = 2: there is no wing; did you mean wing_span?"),
        ("{mass: '6'}", "system.aircraft.mass = '6': give the number without quotes"),
        ("rascal_110", "system.aircraft = rascal_110: give it as AircraftParameters"),
        ("{max_thrust: [1, 2, x]}", "system.aircraft.max_thrust[2] = x: give a number"),
    ],
)
def test_bad_fields_are_named(entry, said):
    with pytest.raises(ScenarioError) as error:
        parse_scenario(f"x: {{system: {{aircraft: {entry}}}}}")
    assert str(error.value).startswith(said)


def test_numbers_may_be_drawn():
    text = "x: {system: {aircraft: {model: rascal_110, mass: !Uniform {min: 5, max: 7}}}}"
    scenario = parse_scenario(text)
    assert parse_scenario(dump_scenario(scenario)) == scenario
    assert 5 < scenario.sampled().system.aircraft.mass < 7


@pytest.mark.parametrize("owner", ["system", "simulated"])
@pytest.mark.parametrize("value", ["", "rascal_110", 0, [], {}, {"model": "rascal_110"}, False])
def test_what_is_no_aircraft_is_not_dumped(owner, value):
    scenario = load_scenario("quintic")
    getattr(scenario, owner).aircraft = value
    said = rf"^{owner}\.aircraft = .*: give it as AircraftParameters, or in YAML"
    for function in (dump_scenario, make_nonstop):
        with pytest.raises(ScenarioError, match=said):
            function(scenario)


def test_overrides_set_single_fields_also_where_there_is_no_aircraft_yet():
    scenario = changed(parse_scenario(FILE), ["simulated.aircraft.mass=6.5"])
    assert scenario.system.aircraft.mass == 6.2
    assert scenario.simulated.aircraft == AircraftParameters(mass=6.5)
    given = load_scenario("quintic", ["system.aircraft.model=ultrastick_25e"])
    assert given.system.aircraft == AircraftParameters(model="ultrastick_25e")


def test_a_file_changes_single_fields_of_its_base_or_takes_another_model(tmp_path):
    (tmp_path / "x.yaml").write_text(FILE)
    for entry, expected in (
        ("{max_lift: 1.3}", AircraftParameters(model="rascal_110", mass=6.2, max_lift=1.3)),
        ("{model: ultrastick_25e}", AircraftParameters(model="ultrastick_25e")),
    ):
        path = tmp_path / "y.yaml"
        path.write_text(f"y: {{based_on: x.yaml, system: {{aircraft: {entry}}}}}")
        assert load_scenario(path).system.aircraft == expected
