"""Designed formations: their margins, what breaks them, and why a request is refused."""

import dataclasses
import math
import re

import drawn_designs
import numpy as np
import pytest
from helpers import nightly_beyond

from drake_nonstop.analysis.aircraft_margins import aircraft_margins
from drake_nonstop.mechanics.aircraft import needed_force
from drake_nonstop.model.aircraft import CABLE_DENSITY
from drake_nonstop.planning.formation_program import FormationProgram, FormationVariables
from drake_nonstop.run.metrics import compute_metrics
from drake_nonstop.run.simulate import simulate
from drake_nonstop.scenario.loading import dump_scenario, load_scenario, parse_scenario
from drake_nonstop.scenario.overrides import as_override, changed
from drake_nonstop.studies import formation_search
from drake_nonstop.studies.design import Design, design_one
from drake_nonstop.studies.design_request import dump_request, read_request
from drake_nonstop.studies.formation_search import (
    DesignedFormation,
    Refusal,
    design_task,
    load_motions,
)
from drake_nonstop.validation import ScenarioError

WINDY = [
    *("carriers=[4]", "cable_length=[40, 80]", "wind=[0, 3, 0]", "starts=1"),
    "displacement=[12, 0, 0]",
]
RESTING = ["cable_length=[60, 60]", "starts=1", "speed=0"]


def found_for(changes, kind="co_rotating"):
    request = read_request(None, changes)
    (carriers,) = request.carriers
    items = design_one(request, carriers, kind)
    formations = tuple(item for item in items if isinstance(item, DesignedFormation))
    refusals = tuple(item for item in items if isinstance(item, Refusal))
    return Design(request=request, formations=formations, refusals=refusals)


@pytest.fixture(scope="module")
def windy():
    """Formations that are taken for flown."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(formation_search, "is_steady", lambda *_: True)
        patch.setattr(formation_search, "fault_in_flight", lambda *_: "")
        return found_for(WINDY)


@pytest.fixture
def unflown(monkeypatch):
    """Takes formations for flown."""
    monkeypatch.setattr(formation_search, "is_steady", lambda *_: True)
    monkeypatch.setattr(formation_search, "fault_in_flight", lambda *_: "")


def test_formations_keep_the_margins_of_the_request(windy):
    request = windy.request
    assert len(windy.formations) == 3
    for formation in windy.formations:
        found = formation.extremes
        assert found["lift"][1] <= request.lift_share + 2e-4
        assert np.max(np.abs(found["bank"])) <= request.bank
        assert np.max(np.abs(found["climb"])) <= math.sin(request.climb)
        thrust_left = min(found["thrust_above"][0], found["thrust_below"][0])
        assert thrust_left >= request.thrust_reserve - 1e-3
        assert formation.separation >= request.separation
        assert 40 <= formation.variables.cable_length <= 80
    powers = [formation.power for formation in windy.formations]
    reserves = [formation.reserve for formation in windy.formations]
    assert powers == sorted(powers, reverse=True)
    assert reserves == sorted(reserves, reverse=True)


def test_scenarios_read_back_and_need_at_rest_what_was_found(windy):
    """By `aircraft_margins`, which knows nothing of the program."""
    formation = windy.formations[0]
    assert parse_scenario(dump_scenario(formation.scenario)) == formation.scenario
    found = aircraft_margins(formation.scenario)
    assert found.is_flyable
    task = design_task(dataclasses.replace(windy.request, speed=0.0), 4)
    program = FormationProgram(task, formation.kind)
    resting = program.extremes(np.array(formation.variables))
    assert np.max(found.needs.lift) / found.max_lift == pytest.approx(resting["lift"][1], rel=1e-3)
    assert np.max(np.abs(found.needs.bank)) == pytest.approx(
        np.max(np.abs(resting["bank"])), rel=5e-3
    )
    assert np.max(found.needs.thrust) == pytest.approx(resting["thrust_N"][1], rel=1e-3)
    assert 4 * found.drawn_power == pytest.approx(formation.power, rel=1e-3)


def test_a_formation_is_flown_in_stronger_gusts():
    wind = {"_tag": "!GustyWind", "gust": 4.0, "load_gust": 4.0}
    changes = [as_override("wind", wind), "simulation_duration=2"]
    scenario = load_scenario("aircraft_rest", changes)
    start = "in gusts 1.25 times as strong, of seed 0, "
    assert formation_search.fault_in_flight(scenario).startswith(start)
    gentle = changed(scenario, ["wind.gust=0.3", "wind.load_gust=0.3"])
    assert formation_search.fault_in_flight(gentle) == ""


@pytest.mark.nightly("flights")
@pytest.mark.parametrize(
    ("kind", "changes"),
    [
        ("co_rotating", WINDY),
        ("co_rotating", [*WINDY, "gust=0.5"]),
        ("leaning", ["carriers=[4]", "cables=lumped", "cable_safety=5", "starts=1", "speed=3"]),
    ],
)
def test_it_flies_its_way_within_what_is_printed(kind, changes):
    """To 2 % of C_L and thrust, in seeds that the search has not seen."""
    found = found_for(changes, kind)
    assert found.formations
    for formation in found.formations:
        scenario = formation.scenario
        if found.request.gust:
            scenario = changed(scenario, ["wind.seed=7"])
        metrics = compute_metrics(simulate(scenario))
        assert metrics["outcome"] == "ok"
        if found.request.cables == "lumped":
            assert formation.cables.are_flown
            assert 5 <= formation.cables.safety < 5.8
        elif not found.request.gust:
            assert max(drawn_designs.beyond(formation, metrics).values()) < 0.02


def test_what_is_printed_and_drawn(windy):
    table = str(windy)
    assert len(re.findall("real cables bow by up to ", table)) == 3
    assert "cables are simulated as straight" not in table
    found = windy.dictionary
    assert found["is_feasible"] is True
    first = found["formations"][0]
    assert first["power_drawn_W"] == windy.formations[0].power
    energy = windy.formations[0].power / (3.6 * 10.0 * 1.25 / 2.1875)
    assert first["energy_Wh_per_kg_km"] == pytest.approx(energy)
    assert first["cables"] == aircraft_margins(windy.formations[0].scenario).cables.dictionary


def test_observers_have_the_largest_weight_at_which_a_flight_is_steady(monkeypatch):
    tried = []

    def is_steady(scenario, turn):
        tried.append(scenario.carrier_controller.observer)
        return tried[-1] < 0.8

    monkeypatch.setattr(formation_search, "is_steady", is_steady)
    monkeypatch.setattr(formation_search, "fault_in_flight", lambda *_: "")
    found = found_for(["carriers=[3]", *RESTING, "load_mass=5"])
    weights = [f.scenario.carrier_controller.observer for f in found.formations]
    assert weights == [0.7] * len(found.formations)
    assert tried == [1.0, 0.7]  # for the others it is known


def test_formations_that_do_not_fly_are_told_with_the_reason(monkeypatch):
    monkeypatch.setattr(formation_search, "is_steady", lambda *_: False)
    found = found_for(["carriers=[3]", *RESTING, "load_mass=5"])
    assert not found.formations
    assert "in a flight at rest the load's sway grows; give longer cables" in found.verdict
    assert "3 co_rotating, at " in str(found)


def test_a_load_that_is_too_heavy_is_refused(unflown):
    request = ["carriers=[3]", "cable_length=[40, 60]"]
    found = found_for([*request, "load_mass=80", "starts=1"])
    assert not found.formations
    assert re.search(r"thrust left to the largest|C_L / C_Lmax|airspeed", found.verdict)


def test_ways_and_accelerations_are_those_of_the_trajectory():
    """On a septic from rest to rest over 50 m, at its largest speed of 2 m/s."""
    request = read_request(None, ["displacement=[0, 50, 0]", "speed=2"])
    (_, fastest, rising, falling, *_), (still, *moving) = load_motions(request)
    time = 2.1875 * 50 / 2
    np.testing.assert_allclose(fastest.velocity, [0, 2, 0])
    np.testing.assert_allclose(fastest.acceleration, 0, atol=1e-12)
    way = np.polynomial.Polynomial([0, 0, 0, 0, 35, -84, 70, -20])
    largest = np.max(way.deriv(2)(np.linspace(0, 1, 10001))) * 50 / time**2
    np.testing.assert_allclose(rising.acceleration, [0, largest, 0], rtol=1e-6)
    np.testing.assert_allclose(rising.acceleration, -falling.acceleration, rtol=1e-9)
    assert not np.any(np.concatenate(still))
    for instant, motion in zip(np.linspace(0, 1, 23), moving, strict=True):
        expected = [way.deriv(k)(instant) * 50 / time**k for k in (1, 2, 3, 4)]
        found = [rate[1] for rate in motion]
        np.testing.assert_allclose(found, expected, atol=1e-9)
    assert [len(part) for part in load_motions(read_request(None, ["speed=0"]))] == [1, 1]


@pytest.mark.parametrize("kind", ["leaning", "co_rotating"])
def test_the_diameter_follows_from_the_largest_tension(kind):
    lumped = ["carriers=[4]", "cables=lumped", "cable_safety=5", "load_drag=5", "speed=3"]
    task = design_task(read_request(None, [*lumped, "wind=[0, 3, 0]"]), 4)
    x = FormationVariables(0.3, 0.15, 0.2, 0.1, 0.6, 150.0, 0.0)
    if kind == "co_rotating":
        x = x._replace(radial=0.0, tangential=0.0, vertical=0.0)
    aircraft, angles = task.flown_by(x), task.angles(kind, 90)
    orbits = [task.orbit(kind, x, angles, motion, task.wind) for motion in task.way]
    tension = max(np.linalg.norm(orbit.forces, axis=1).max() for orbit in orbits)
    area = math.pi / 4 * aircraft.cable_diameter**2
    assert 5 * tension <= 1.6e9 * area < 6 * tension
    borne = task.needed_force(aircraft, orbits[0])
    borne -= needed_force(aircraft, orbits[0].accelerations, orbits[0].forces)
    # Over a turn accelerations have no mean: that is the cable's weight.
    weight = CABLE_DENSITY * area * 150 * 9.81
    np.testing.assert_allclose(borne.mean(axis=0), [0, 0, weight], atol=1e-9)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ("carriers=[2]", "request.carriers = [2]: give numbers from 3 to 12"),
        ("carriers=[4, 4]", "request.carriers = [4, 4]: give numbers from 3 to 12, each once"),
        ("kinds=[flat]", "request.kinds = ['flat']: give some of leaning, co_rotating"),
        ("speed=1e-7", "request.speed = 1e-07: give 0.0014 to 50, for the length of the way"),
        ("separation=1e3", "request.separation = 1000.0: give at most 403"),
        ("cable_length=[90, 60]", "request.cable_length = [90.0, 60.0]: give the least and"),
        ("load_inertia=[[1, 0, 0], [0, 1, 0], [0, 0, -1]]", "positive definite"),
        ("load_mass=-1", "request.load_mass = -1.0: give 0.001 to 100000 kg"),
        ("wind=[0, 1e3, 0]", "request.wind = [0.0, 1000.0, 0.0]: give 0 to 100 m/s"),
        ("load_drag=.nan", "request.load_drag = .nan: give a finite number"),
        ("load_mass=heavy", "request.load_mass = heavy: give a number"),
        ("lift_share=0.95", "request.lift_share = 0.95: give a number above 0 and below 0.9"),
        ("first=speed", "request.first = speed: give margin or power"),
        ("weight=3", "request.weight = 3: there is no"),
        ("aircraft.wings=3", "request.aircraft.wings = 3: there is no"),
        ("aircraft.model=jumbo", "request.aircraft.model = jumbo: there is no jumbo"),
        ("name=a/b", "scenario = a/b: name it with letters"),
        ("wind", "--set = wind: give path=value"),
    ],
)
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
    file.write_text(dump_request(drawn_designs.draw(1)))
    assert read_request(file) == drawn_designs.draw(1)


@pytest.mark.parametrize(
    "changes", nightly_beyond(2, "studies", [*map(drawn_designs.draw_odd, range(60))])
)
@pytest.mark.usefixtures("unflown")
def test_odd_requests_have_formations_or_a_reason_for_none(changes):
    refusal = ""
    try:
        request = read_request(None, changes)
    except ScenarioError as error:
        refusal = str(error)
    if refusal:
        assert re.fullmatch(r"request(\.[a-z_.]+(\[\d\])?)?(: | = ).*", refusal)
    else:
        found = found_for(changes, *request.kinds)
        assert found.verdict
