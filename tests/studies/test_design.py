"""Designed formations: their margins, what breaks them, and why a request is refused."""

import math
import re

import drawn_designs
import numpy as np
import pytest
from helpers import nightly_beyond

from drake_nonstop import (
    ScenarioError,
    SerialExecutor,
    aircraft_margins,
    changed,
    compute_metrics,
    design,
    read_request,
    simulate,
)
from drake_nonstop.scenario.loading import dump_scenario, load_scenario, parse_scenario
from drake_nonstop.studies import formation_search

CIRCLE, WINDY = "kinds=[co_rotating]", "wind=[0, 3, 0]"
ON_A_WAY = ["carriers=[4]", CIRCLE, "cable_length=[40, 80]", WINDY, "starts=1"]
SLOW, RISING = ["displacement=[12, 0, 0]"], ["displacement=[0, 0, 8]", "speed=1"]
LUMPED = ["cables=lumped", "cable_safety=5"]
RESTING = ["carriers=[3]", CIRCLE, "cable_length=[60, 60]", "starts=1", "speed=0", "load_mass=5"]


def found_for(changes):
    return design(read_request(None, changes), executor=SerialExecutor())


@pytest.fixture
def unflown(monkeypatch):
    """Takes formations for flown."""
    monkeypatch.setattr(formation_search, "is_steady", lambda *_: True)
    monkeypatch.setattr(formation_search, "fault_in_flight", lambda *_: "")


@pytest.mark.usefixtures("unflown")
def test_formations_keep_the_margins_of_the_request_and_are_told():
    found = found_for([*ON_A_WAY, *SLOW])
    request = found.request
    assert len(found.formations) == 3
    for formation in found.formations:
        extremes = formation.extremes
        assert extremes["lift"][1] <= request.lift_share + 2e-4
        assert np.max(np.abs(extremes["bank"])) <= request.bank
        assert np.max(np.abs(extremes["climb"])) <= math.sin(request.climb)
        thrust_left = min(extremes["thrust_above"][0], extremes["thrust_below"][0])
        assert thrust_left >= request.thrust_reserve - 1e-3
        assert formation.separation >= request.separation
        assert 40 <= formation.variables.cable_length <= 80
    for name in ("power", "reserve"):
        values = [getattr(formation, name) for formation in found.formations]
        assert values == sorted(values, reverse=True)
    assert len(re.findall("real cables bow by up to ", str(found))) == 3
    first, told = found.formations[0], found.dictionary
    assert told["is_feasible"] is True
    assert told["formations"][0]["power_drawn_W"] == first.power
    energy = first.power / (3.6 * 10.0 * 1.25 / 2.1875)
    assert told["formations"][0]["energy_Wh_per_kg_km"] == pytest.approx(energy)
    assert told["formations"][0]["cables"] == aircraft_margins(first.scenario).cables.dictionary


@pytest.mark.parametrize("changes", nightly_beyond(1, "studies", [[WINDY], LUMPED]))
@pytest.mark.usefixtures("unflown")
def test_scenarios_read_back_and_need_at_rest_what_was_found(changes):
    """By `aircraft_margins`, which knows nothing of the program."""
    formation = found_for([*RESTING, *changes]).formations[0]
    assert parse_scenario(dump_scenario(formation.scenario)) == formation.scenario
    found, extremes = aircraft_margins(formation.scenario), formation.extremes
    assert found.is_flyable
    bow = 4 if changes == LUMPED else 1  # of cables, which the program does not know
    assert changes != LUMPED or 4.9 < formation.cables.safety < 5.3
    lift, bank = np.max(found.needs.lift) / found.max_lift, np.max(np.abs(found.needs.bank))
    assert lift == pytest.approx(extremes["lift"][1], rel=bow * 1e-3)
    assert bank == pytest.approx(np.max(np.abs(extremes["bank"])), rel=bow * 5e-3)
    assert np.max(found.needs.thrust) == pytest.approx(extremes["thrust_N"][1], rel=bow * 1e-3)
    assert 3 * found.drawn_power == pytest.approx(formation.power, rel=bow * 1e-3)


@pytest.mark.nightly("flights")
def test_a_formation_flies_its_way_within_what_is_printed(unflown):
    """The load's largest acceleration on it is a fiftieth of gravity."""
    formation = found_for([*ON_A_WAY, *RISING, "wind=[0, 0, 0]", "load_mass=5"]).formations[0]
    metrics = compute_metrics(simulate(formation.scenario))
    assert metrics["outcome"] == "ok"
    assert max(np.abs([*drawn_designs.beyond(formation, metrics).values()])) < 0.005


@pytest.mark.nightly("flights")
@pytest.mark.parametrize(
    "changes", [[*ON_A_WAY, *SLOW], [*ON_A_WAY, *SLOW, "gust=0.5"], [*RESTING, *LUMPED]]
)
def test_what_is_returned_has_been_flown(changes):
    """In seeds that the search has not seen."""
    found = found_for(changes)
    assert found.formations
    for formation in found.formations:
        gusts = ["wind.seed=7"] if found.request.gust else []
        metrics = compute_metrics(simulate(changed(formation.scenario, gusts)))
        assert metrics["outcome"] == "ok"
        if found.request.cables == "lumped":
            assert formation.cables.are_flown
            assert 4.9 < formation.cables.safety < 5.8
        elif not gusts:
            assert max(drawn_designs.beyond(formation, metrics).values()) < 0.02


@pytest.mark.nightly("studies")
def test_formations_that_do_not_fly_are_told_with_the_reason(monkeypatch):
    tried = []

    def is_steady(scenario, turn):
        tried.append(scenario.carrier_controller.observer)
        return tried[-1] < 0.8

    monkeypatch.setattr(formation_search, "is_steady", is_steady)
    found = found_for(RESTING)
    assert tried == [1.0, 0.7]  # the largest weight at which it is steady; then it is known
    assert {each.scenario.carrier_controller.observer for each in found.formations} == {0.7}
    monkeypatch.setattr(formation_search, "is_steady", lambda *_: False)
    found = found_for(RESTING)
    assert not found.formations
    assert "in a flight at rest the load's sway grows; give longer cables" in found.verdict
    assert "3 co_rotating, at " in str(found)


@pytest.mark.nightly("flights")
def test_a_formation_is_flown_in_stronger_gusts(monkeypatch):
    flown = []

    def noted(scenario):
        flown.append(scenario.wind.gust)
        return simulate(scenario)

    monkeypatch.setattr(formation_search, "simulate", noted)
    wind = "wind=!GustyWind {gust: 4.0, load_gust: 4.0}"
    scenario = load_scenario("aircraft_rest", [wind, "simulation_duration=2"])
    start = "in gusts 1.25 times as strong, of seed 0, "
    assert formation_search.fault_in_flight(scenario).startswith(start)
    gentle = changed(scenario, ["wind.gust=0.3", "wind.load_gust=0.3"])
    assert formation_search.fault_in_flight(gentle) == ""
    assert (flown[0], flown[-1]) == (1.25 * 4.0, 1.25 * 0.3)


# A change, and the field, the value and the remedy of the sentence.
REFUSED = [
    ("carriers=[2]", "request.carriers = [2]: give numbers from 3 to 12"),
    ("kinds=[flat]", "request.kinds = ['flat']: give some of leaning, co_rotating"),
    ("speed=1e-7", "request.speed = 1e-07: give 0.0014 to 50"),
    ("separation=1e3", "request.separation = 1000.0: give at most 403"),
    ("cable_length=[90, 60]", "request.cable_length = [90.0, 60.0]: give the least and"),
    ("load_inertia=[[1, 0, 0], [0, 1, 0], [0, 0, -1]]", "positive definite"),
    ("load_mass=-1", "request.load_mass = -1.0: give 0.001 to 100000 kg"),
    ("wind=[0, 1e3, 0]", "request.wind = [0.0, 1000.0, 0.0]: give 0 to 100 m/s"),
    ("lift_share=0.95", "request.lift_share = 0.95: give a number above 0 and below 0.9"),
    ("weight=3", "request.weight = 3: there is no"),
    ("aircraft.model=jumbo", "request.aircraft.model = jumbo: there is no jumbo"),
    ("name=a/b", "scenario = a/b: name it with letters"),
]


@pytest.mark.parametrize(("change", "sentence"), REFUSED)
def test_a_request_that_cannot_be_used_is_refused_in_a_sentence(change, sentence):
    with pytest.raises(ScenarioError, match=re.escape(sentence)):
        read_request(None, [change])


def test_a_request_is_read_from_a_file(tmp_path):
    file = tmp_path / "small.yaml"
    file.write_text("aircraft: {model: ultrastick_25e}\nload_mass: 2\ncarriers: [4]\n")
    request = read_request(file, ["speed=0.5"])
    assert (request.name, request.load_mass, request.speed) == ("small", 2, 0.5)
    assert request.aircraft.model == "ultrastick_25e"
    file.write_text("aircraft: {model: null, mass: 5.0}\n")
    with pytest.raises(ScenarioError, match=r"request\.aircraft\.wing_area = not given"):
        read_request(file)


@pytest.mark.parametrize(
    "changes", nightly_beyond(0, "studies", [*map(drawn_designs.draw_odd, range(60))])
)
@pytest.mark.usefixtures("unflown")
def test_odd_requests_have_formations_or_a_reason_for_none(changes):
    refusal = ""
    try:
        assert found_for(changes).verdict
    except ScenarioError as error:
        refusal = str(error)
    assert re.fullmatch(r"(request(\.[a-z_.]+(\[\d\])?)?(: | = ).*)?", refusal)
