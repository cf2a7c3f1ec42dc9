"""Designed formations: their margins, what breaks them, and why a request is refused."""

import dataclasses
import math
import re

import drawn_designs
import numpy as np
import pytest
from helpers import nightly_beyond

from drake_nonstop.analysis.aircraft_margins import aircraft_margins
from drake_nonstop.analysis.limit import RunOutcome
from drake_nonstop.cli.ending import FAILED
from drake_nonstop.cli.main import main
from drake_nonstop.mechanics.aircraft import stall_speed
from drake_nonstop.planning.formation_program import FormationProgram, FormationVariables
from drake_nonstop.planning.limits import Of, limits_of
from drake_nonstop.run.many import simulate_many
from drake_nonstop.run.outcome import judge
from drake_nonstop.run.run_quantities import RunQuantities
from drake_nonstop.scenario.loading import dump_scenario, load_scenario, parse_scenario
from drake_nonstop.scenario.overrides import as_override, changed
from drake_nonstop.studies import design as module
from drake_nonstop.studies import formation_search
from drake_nonstop.studies.design import Design, design_dictionary, design_one, design_table
from drake_nonstop.studies.design_figures import (
    KEPT,
    LOST,
    RegionFlight,
    make_pareto_figure,
    make_region_figure,
)
from drake_nonstop.studies.design_request import dump_request, read_request
from drake_nonstop.studies.designed_formation import (
    DesignedFormation,
    Refusal,
    breaking_points,
    design_task,
    flight_of,
    formation_needs,
    formation_scenario,
    load_motions,
    missed_limits,
    reserve_of,
    with_load,
)
from drake_nonstop.studies.formation_search import FeasibleRegion, FormationSearch
from drake_nonstop.validation import ScenarioError

WINDY = [
    *("carriers=[4]", "cable_length=[40, 80]", "wind=[0, 3, 0]", "starts=1"),
    "displacement=[12, 0, 0]",
]


def found_for(changes, kind="co_rotating"):
    request = read_request(None, changes)
    (carriers,) = request.carriers
    items = design_one(request, carriers, kind)
    formations = tuple(item for item in items if isinstance(item, DesignedFormation))
    refusals = tuple(item for item in items if isinstance(item, Refusal))
    return Design(request=request, formations=formations, refusals=refusals)


@pytest.fixture(scope="module")
def windy():
    """Formations that are taken for steady, without a flight of each."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(formation_search, "_is_steady", lambda *_: True)
        return found_for(WINDY)


@pytest.fixture
def unflown(monkeypatch):
    """Takes formations for steady, without a flight of each."""
    monkeypatch.setattr(formation_search, "_is_steady", lambda *_: True)


def test_formations_keep_the_margins_of_the_request(windy):
    request = windy.request
    assert len(windy.formations) == 3
    for formation in windy.formations:
        flight = formation.flight
        assert flight.ranges.lift_share[1] <= request.lift_share + 2e-4
        assert flight.bank <= request.bank
        assert flight.climb <= request.climb
        assert min(flight.thrust_above, flight.thrust_below) >= request.thrust_reserve - 1e-3
        assert formation.distances[0] >= request.separation
        assert 40 <= formation.variables.cable_length <= 80
    powers = [formation.power for formation in windy.formations]
    reserves = [formation.reserve for formation in windy.formations]
    assert powers == sorted(powers, reverse=True)
    assert reserves == sorted(reserves, reverse=True)
    assert all(windy.is_efficient(formation) for formation in windy.formations)


def test_scenarios_read_back_and_need_at_rest_what_was_found(windy):
    formation = windy.formations[0]
    text = dump_scenario(formation.scenario)
    assert parse_scenario(text) == formation.scenario
    found = aircraft_margins(formation.scenario)
    assert found.is_flyable
    task = design_task(windy.request, 4, 1).with_motions(1)
    flight = flight_of(task, formation.kind, formation.variables)
    assert np.max(found.needs.lift) / found.max_lift == pytest.approx(
        flight.ranges.lift_share[1], rel=1e-3
    )
    assert np.max(np.abs(found.needs.bank)) == pytest.approx(flight.bank, rel=5e-3)
    assert np.max(found.needs.thrust) == pytest.approx(flight.ranges.thrust[1], rel=1e-3)
    assert found.drawn_power == pytest.approx(flight.power, rel=1e-3)
    with_way = design_task(windy.request, 4, 24)
    assert flight_of(with_way, formation.kind, formation.variables).power == flight.power
    assert found.turn == pytest.approx(2 * math.pi / formation.variables.frequency, rel=1e-4)


def test_it_breaks_where_it_says(windy):
    """On the way, at other phases than those that were looked at; each thing grows alone."""
    formation = windy.formations[0]
    wind, load, speed = formation.breaks
    assert (wind.what, load.what, speed.what) == ("wind", "load", "speed")
    assert (wind.value > 3, load.value > 10, speed.value > 1.25) == (True, True, True)
    task = design_task(windy.request, 4, 24)
    for each, grown in (
        (wind, lambda value: formation.variables._replace(wind=value)),
        (load, lambda value: with_load(formation.variables, value)),
        (speed, lambda value: formation.variables._replace(speed=value)),
    ):
        for factor, flies in ((0.98, True), (1.02, False)):
            flight = flight_of(task, formation.kind, grown(factor * each.value), phases=97)
            missed = [limit.name for limit in missed_limits(task, flight)]
            assert missed == ([] if flies else [each.limit])


def test_a_resting_formation_breaks_where_the_margins_of_its_scenario_end(windy):
    """By `aircraft_margins`, which knows nothing of the program."""
    formation = windy.formations[0]
    shape = formation.kind, 4, formation.phase_turns
    resting = dataclasses.replace(windy.request, speed=0.0)
    task = design_task(resting, 4)
    x = formation.variables._replace(speed=0.0)
    wind, load = breaking_points(task, formation.kind, x, formation.phase_turns)
    for factor, flies in ((0.98, True), (1.02, False)):
        stronger = dataclasses.replace(resting, wind=(factor * wind.value * task.wind).tolist())
        flight = flight_of(task, formation.kind, x)
        scenario = formation_scenario(stronger, *shape, x, flight)
        assert aircraft_margins(scenario).is_flyable is flies
        mass = factor * load.value
        heavier = dataclasses.replace(resting, load_mass=mass)
        scenario = formation_scenario(heavier, *shape, with_load(x, mass), flight)
        assert aircraft_margins(scenario).is_flyable is flies


def test_without_wind_it_breaks_in_one_against_the_way(windy):
    """Which is less than one from behind."""
    formation = windy.formations[0]
    x = formation.variables._replace(wind=0.0, speed=2.5)
    against, behind = (
        next(
            breaking_points(dataclasses.replace(task, wind=sign * task.wind), formation.kind, x, 0)
        )
        for sign in (1, -1)
        for task in [design_task(dataclasses.replace(windy.request, wind=[0.0] * 3), 4, 24)]
    )
    assert against.what == "wind against the load's way"
    assert against.value < 0.9 * behind.value


def test_in_gusts_lift_and_airspeed_keep_the_aircrafts_own_limits(windy):
    """By the aircraft's inverse in still air, of the same forces at the airspeed that is left."""
    x, gust = windy.formations[0].variables, 0.4
    task = design_task(dataclasses.replace(windy.request, gust=gust), 4)
    flight = flight_of(task, "co_rotating", x)
    own, lifts, shares = task.limits.own, [], []
    for needs in formation_needs(task, "co_rotating", x):
        left = needs.airspeed - 3 * gust
        lifts.append(needs.lift * (needs.airspeed / left) ** 2)
        shares.append(left / stall_speed(task.aircraft))
    most_lift = own.lift_share * task.aircraft.max_lift
    assert flight.in_gusts[0] ** -2 == pytest.approx(np.max(lifts) / most_lift)
    assert flight.in_gusts[1] == pytest.approx(np.min(shares) / own.speed_share)
    program = FormationProgram(task, "co_rotating")
    rows = program.rows(np.array(x))[0]
    assert rows.min() == pytest.approx(reserve_of(task, flight), abs=0.02)
    # More gusts, and the row of lift is the first that is missed, there and here.
    strong = dataclasses.replace(task, gust=3 * 0.8)
    missed = missed_limits(strong, flight_of(strong, "co_rotating", x), 1.0)
    assert missed[0].name == FormationProgram(strong, "co_rotating").closest_row(np.array(x))


def test_a_formation_is_flown_in_stronger_gusts():
    wind = {"_tag": "!GustyWind", "gust": 4.0, "load_gust": 4.0}
    changes = [as_override("wind", wind), "simulation_duration=2"]
    scenario = load_scenario("aircraft_rest", changes)
    start = "in gusts 1.25 times as strong, of seed 0, "
    assert formation_search._fault_in_gusts(scenario).startswith(start)
    assert formation_search._fault_in_gusts(scenario, strength=0.1) == ""


@pytest.mark.nightly("flights")
def test_formations_fly_in_gusts_of_seeds_that_the_search_has_not_seen():
    """The one of the largest margin would lose its load in one of them, and is refused."""
    changes = ["carriers=[6]", "cable_length=[60, 60]", "starts=1", "speed=4", "gust=1"]
    found = found_for([*changes, "displacement=[100, 0, 0]"])
    assert found.formations
    seeds = [as_override("wind.seed", seed) for seed in range(5, 10)]
    runs = simulate_many(
        [changed(formation.scenario, [seed]) for formation in found.formations for seed in seeds]
    )
    assert {judge(RunQuantities(run)).outcome for run in runs} == {RunOutcome.OK}


def test_the_first_formation_has_the_largest_margin_or_the_least_power(windy):
    for first, best in (("margin", windy.formations[0]), ("power", windy.formations[-1])):
        request = read_request(None, [f"first={first}"])
        assert min(windy.formations[::-1], key=module.ORDERS[request.first]) is best
    with pytest.raises(ScenarioError, match=r"request.first = speed: give margin or power"):
        read_request(None, ["first=speed"])


@pytest.mark.nightly("flights")
def test_it_flies_its_way_within_what_is_printed(windy):
    """To 2 % of C_L, bank and thrust; the load stays within 5 cm."""
    flown = drawn_designs.flown_beside_printed(windy.formations[-1])
    assert flown["outcome"] == "ok"
    assert flown["saturated"] == 0
    assert flown["error"] < 0.05
    assert max(drawn_designs.beyond(flown).values()) < 0.02
    assert flown["apart"][0] > 0.95 * flown["apart"][1]


def test_what_is_printed_and_drawn(windy):
    table = design_table(windy)
    lines = table.splitlines()
    assert len(lines) == 10
    assert len(re.findall("breaks first at wind", table)) == 3
    assert len(re.findall("real cables bow by up to ", table)) == 3
    (first, *others), thick = windy.formations, windy.formations[0].cables._replace(difference=1.0)
    first = dataclasses.replace(first, cables=thick)
    warned = design_table(dataclasses.replace(windy, formations=(first, *others)))
    start = f"{first.scenario.name}: cables are simulated as straight: "
    assert next(line for line in warned.splitlines() if "straight" in line).startswith(start)
    found = design_dictionary(windy)
    for formation, told in zip(windy.formations, found["formations"], strict=True):
        at_rest = aircraft_margins(formation.scenario)
        resting = at_rest.ranges  # the way asks for more
        assert 1 < told["airspeed_over_loaded_stall_min"] <= resting.over_loaded_stall[0] + 1e-3
        assert resting.thrust_share[1] - 1e-3 <= told["thrust_share_max"] < 1
        assert told["thrust_share_min"] <= resting.thrust_share[0] + 1e-3
        assert told["cables"] == at_rest.cables.dictionary
    assert found["is_feasible"] is True
    assert found["formations"][0]["power_drawn_W"] == windy.formations[0].power
    energy = 4 * windy.formations[0].flight.power / (3.6 * 10.0 * 1.25 / 2.1875)
    assert found["formations"][0]["energy_Wh_per_kg_km"] == pytest.approx(energy)
    assert len(make_pareto_figure(windy).axes) == 2
    border = {"winds": np.array([5.0, 4.0]), "limits": ("lift", "lift"), "formations": (None, None)}
    region = FeasibleRegion(speed=1.0, masses=np.array([8.0, 10.0]), **border)
    flown = [RegionFlight("four", 0, 9.0, wind, how) for wind, how in ((1.0, KEPT), (9.0, LOST))]
    figure = make_region_figure({"four": [region]}, flown)
    assert len(figure.axes[0].lines) == 5  # the border, two flights, and both in the legend
    flown = [RegionFlight("four", k, 9.0, 1.0, KEPT) for k in range(2)]
    lines = make_region_figure({"four": [region, region]}, flown).axes[0].lines
    first, second = (line.get_xdata()[0] for line in lines[2:4])  # behind the borders
    assert 8.9 < first < 9.0 < second < 9.1


def test_observers_have_the_largest_weight_at_which_a_flight_is_steady(windy, monkeypatch):
    scenario = windy.formations[0].scenario
    assert scenario.carrier_controller.observer == 1
    tried = []

    def is_steady(scenario, turn):
        tried.append(scenario.carrier_controller.observer)
        return tried[-1] < 0.8

    monkeypatch.setattr(formation_search, "_is_steady", is_steady)
    search = FormationSearch(windy.request, 4, "co_rotating")
    for _ in range(2):  # the second time it is known
        assert search._steadied(scenario, 10.0).carrier_controller.observer == 0.7
    assert tried == [1.0, 0.7]
    monkeypatch.setattr(formation_search, "_is_steady", lambda *_: False)
    assert FormationSearch(windy.request, 4, "co_rotating")._steadied(scenario, 10.0) is None


def test_margins_that_are_missed_may_be_smaller(unflown):
    """With the margins of the remedy, in place of those that cannot be kept."""
    tight = ["carriers=[4]", "cable_length=[60, 60]", "lift_share=0.12", "starts=1", "speed=0"]
    found = found_for(tight)
    assert not found.formations
    assert "C_L / C_Lmax" in found.verdict
    changes = re.findall(r"request\.(\w+ = [\d.]+)", found.verdict.partition("give ")[2])
    assert changes
    eased = found_for([*tight, *(change.replace(" ", "") for change in changes)])
    assert eased.formations


@pytest.mark.nightly("studies")
def test_formations_that_do_not_fly_are_told_beside_those_that_do(unflown, monkeypatch):
    """Those of one of three levels sway; with all of them the request is refused for that."""
    fault = "in a flight at rest the load's sway grows"
    steady = iter([False, False, False, True, True])  # three weights of the first, the others
    monkeypatch.setattr(formation_search, "_is_steady", lambda *_: next(steady))
    changes = ["carriers=[3]", "cable_length=[60, 60]", "starts=1", "speed=0", "load_mass=5"]
    request = read_request(None, changes)
    items = design_one(request, 3, "co_rotating")
    assert [type(item) for item in items] == [Refusal, DesignedFormation, DesignedFormation]
    assert items[0].fault == fault
    assert items[0].sentence == f"not at {items[0].reserve:.3g} of the margins: {fault}"
    assert len({item.variables for item in items}) == len(items)
    verdict = Design(request=request, formations=(), refusals=(items[0],)).verdict
    assert f"the best, 3 co-rotating, keeps them, but {fault}; nothing that" in verdict
    found = Design(request=request, formations=tuple(items[1:]), refusals=(items[0],))
    assert f"3 co_rotating: not at {items[0].reserve:.3g} of the margins" in design_table(found)


def test_remedies_of_small_numbers_are_told_to_three_digits():
    assert [formation_search._down(value) for value in (0.008, -0.001, 12.345, 0.0)] == [
        *("0.00791", "-0.00098", "12.2", "0")
    ]


@pytest.mark.nightly("studies")
def test_a_load_that_is_too_heavy_is_refused_with_one_that_is_not(unflown):
    found = found_for(["carriers=[3]", "load_mass=80", "cable_length=[40, 60]", "starts=1"])
    assert not found.formations
    assert "no formation of rascal_110 keeps the margins" in found.verdict
    assert re.search(r"thrust left to the largest|C_L / C_Lmax|airspeed", found.verdict)
    (mass,) = re.findall(r"request.load_mass = ([\d.]+) or less", found.verdict)
    assert 20 < float(mass) < 80
    eased = found_for(["carriers=[3]", f"load_mass={mass}", "cable_length=[40, 60]", "starts=2"])
    assert eased.formations


def test_ways_and_accelerations_are_those_of_the_trajectory():
    """On a septic from rest to rest over 50 m, at its largest speed of 2 m/s."""
    request = read_request(None, ["displacement=[0, 50, 0]", "speed=2"])
    _, fastest, rising, falling, *_ = load_motions(request, 6)
    time = 2.1875 * 50 / 2
    np.testing.assert_allclose(2 * fastest.velocity, [0, 2, 0])
    np.testing.assert_allclose(fastest.acceleration, 0, atol=1e-12)
    way = np.polynomial.Polynomial([0, 0, 0, 0, 35, -84, 70, -20])
    largest = np.max(way.deriv(2)(np.linspace(0, 1, 10001))) * 50 / time**2
    np.testing.assert_allclose(4 * rising.acceleration, [0, largest, 0], rtol=1e-6)
    np.testing.assert_allclose(rising.acceleration, -falling.acceleration, rtol=1e-9)
    still, *moving = load_motions(request, 13)
    assert not np.any(np.concatenate(still))
    for instant, motion in zip(np.linspace(0, 1, 12), moving, strict=True):
        expected = [way.deriv(k)(instant) * 50 / time**k for k in (1, 2, 3, 4)]
        found = np.array(motion.at(2.0))
        np.testing.assert_allclose(found[:, 1], expected, atol=1e-9)
        assert not np.any(found[:, [0, 2]])
    assert len(load_motions(request, 13)) == 13
    assert len(load_motions(read_request(None, ["speed=0"]), 13)) == 1


def test_a_way_is_flown_beside_the_wind():
    """What is needed at a constant speed is what is needed at rest in the wind against it."""
    request = read_request(None, ["carriers=[4]", "wind=[0, 1, 0]", "speed=2"])
    x = FormationVariables(0.2, 0.1, 0.12, 0.1, 0.6, 150.0, 10.0, 1.0, 2.0, 0.0)
    task = design_task(request, 4)
    steady = task.motions[1]._replace(jerk=np.zeros(3))
    task = dataclasses.replace(task, motions=(steady,))
    (fastest,) = formation_needs(task, "leaning", x)
    against = design_task(read_request(None, ["wind=[-2, 1, 0]", "speed=0"]), 4)
    resting, *_ = formation_needs(against, "leaning", x._replace(wind=math.sqrt(5)))
    for one, other in zip(fastest, resting, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9)


def test_drawn_requests_are_within_their_ranges_and_read_back(tmp_path):
    file = tmp_path / "request.yaml"
    for seed in range(40):
        request = drawn_designs.draw(seed)
        file.write_text(dump_request(request))
        assert request == read_request(file)
        assert 2 <= request.load_mass <= 20
        assert 20 <= request.cable_length[0] <= request.cable_length[1] <= 300
        assert np.linalg.norm(request.wind) <= 6.001


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ("carriers=[2]", "request.carriers = [2]: give numbers from 3 to 12"),
        ("carriers=[4, 4]", "request.carriers = [4, 4]: give each of them once"),
        ("kinds=[leaning, leaning]", "give each of them once"),
        ("speed=1e6", "request.speed = 1000000.0: give 0.0014 to 50, for the length of the way"),
        ("speed=1e-7", "request.speed = 1e-07: give 0.0014 to 50"),
        ("separation=1e6", "request.separation = 1000000.0: give at most 403"),
        ("cable_length=[1e-9, 80]", "request.cable_length = [1e-09, 80.0]: give lengths from 1 to"),
        ("load_inertia=[[1, 0, 0], [0, 1, 0], [0, 0, -1]]", "positive definite"),
        ("carriers=[]", "request.carriers = []: give numbers of carriers, such as [3, 4]"),
        ("kinds=[flat]", "request.kinds"),
        ("load_mass=-1", "request.load_mass = -1.0: give 0.001 to 100000 kg"),
        ("load_radius=1e4", "request.load_radius = 10000.0: give 0.001 to 1000 m"),
        ("wind=[0, 1e3, 0]", "request.wind = [0.0, 1000.0, 0.0]: give 0 to 100 m/s"),
        ("load_drag=.nan", "request.load_drag = .nan: give a finite number"),
        ("load_mass=heavy", "request.load_mass = heavy: give a number"),
        ("cable_length=[90, 60]", "request.cable_length = [90.0, 60.0]: give the least and"),
        ("lift_share=0.95", "request.lift_share = 0.95: give a number above 0 and below 0.9"),
        ("speed_share=1.1", "request.speed_share = 1.1: give a number above 1.2"),
        ("displacement=[0, 0, 0]", "give a way other than none, or speed = 0"),
        ("weight=3", "request.weight = 3: there is no"),
        ("aircraft.wings=3", "request.aircraft.wings = 3: there is no"),
        ("aircraft.model=jumbo", "request.aircraft.model = jumbo: there is no jumbo"),
        ("name=a/b", "scenario = a/b: name it with letters"),
        ("load_inertia=[[1, 2], [3, 4]]", "request.load_inertia"),
        ("wind", "--set = wind: give path=value"),
    ],
)
def test_a_request_that_cannot_be_used_is_refused_in_a_sentence(change, sentence):
    with pytest.raises(ScenarioError, match=re.escape(sentence)):
        read_request(None, [change])


@pytest.mark.parametrize("kept", [False, True])
def test_a_limit_of_aircraft_that_is_asked_for_is_missed_beyond_it(windy, kept):
    formation = windy.formations[0]
    for limit in limits_of(Of.FLIGHT):
        free = design_task(windy.request, 4)
        at = dataclasses.replace(free, limits=free.limits._replace(asked=((limit, 1.0),)))
        (flown,) = flight_of(at, "co_rotating", formation.variables).asked
        value = flown * (1.001 if kept else 0.999)
        if value > limit.largest:
            continue
        request = dataclasses.replace(windy.request, **{limit.field: value})
        task = design_task(request, 4)
        flight = flight_of(task, "co_rotating", formation.variables)
        missed = [each.text for each in missed_limits(task, flight)]
        assert any(text.startswith(limit.words) for text in missed) == (not kept)


ODD = [
    ["carriers=[4]", "kinds=[co_rotating]", "starts=1", "cable_length=[5000, 5000]", "speed=0"],
    ["carriers=[4]", "kinds=[co_rotating]", "starts=1", "wind=[0, 0, 3]", "speed=0"],
    *map(drawn_designs.draw_odd, range(60)),
]


@pytest.mark.parametrize("changes", nightly_beyond(2, "studies", ODD))
@pytest.mark.usefixtures("unflown")
def test_odd_requests_have_formations_or_a_reason_for_none(changes):
    refusal = ""
    try:
        request = read_request(None, changes)
        module._require_buildable(request)
    except ScenarioError as error:
        refusal = str(error)
    if refusal:
        assert re.fullmatch(r"request(\.[a-z_.]+(\[\d\])?)?(: | = ).*", refusal)
    else:
        found = found_for(changes, *request.kinds)
        assert found.formations or found.refusals
        assert found.verdict


def test_what_cannot_be_judged_of_a_formation_is_its_refusal(unflown, monkeypatch):
    def refuse(*_, **__):
        raise ScenarioError("fastest mode = 894 rad/s: give softer cables")

    monkeypatch.setattr(formation_search, "find_formation", refuse)
    found = found_for(["carriers=[3]", "cable_length=[60, 60]", "starts=1", "speed=0"])
    assert {refusal.fault for refusal in found.refusals} == {
        "it cannot be judged: fastest mode = 894 rad/s: give softer cables"
    }


def test_what_was_found_before_ctrl_c_is_told_and_kept(windy, tmp_path, capsys, monkeypatch):
    """In a folder of its own where there is a whole result, and nothing where nothing was found."""
    said, parts = [], [windy.formations]

    def run(function, keys, arguments, record, failed, *, what, **options):
        said.append(what())
        for key, part in zip(keys, parts, strict=False):
            record(key, part)
        said.append(what())
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "run_all", run)
    folder, stopped = tmp_path / "it", tmp_path / "it_stopped"
    request = ["--set", *WINDY, "kinds=[leaning, co_rotating]"]
    first = windy.formations[0]
    best = f"the best has 4 co-rotating, reserve {first.reserve:.2f}, {first.power:.0f} W"
    for place in (folder, stopped):
        assert main(["design", "--out", str(folder), *request]) == FAILED
        shown = capsys.readouterr()
        searched = "1 of 2 kinds and numbers of carriers were searched; what they found is"
        assert shown.err.endswith(f": {searched} in {place}\n")
        assert "breaks first at wind" in shown.out
        assert (place / "design.json").exists()
        flown = load_scenario(place / f"{first.scenario.name}.yaml")
        assert len(flown.system.attachments) == 4
    assert said == ["designing: none yet keeps the margins", f"designing: {best}"] * 2
    parts.clear()
    assert main(["design", "--out", str(tmp_path / "other"), *request]) == FAILED
    assert "0 of 2 kinds" in capsys.readouterr().err
    assert not [*tmp_path.glob("other*/*")]


def test_a_request_is_read_from_a_file(tmp_path):
    file = tmp_path / "small.yaml"
    file.write_text("aircraft: {model: ultrastick_25e}\nload_mass: 2\ncarriers: [4]\n")
    request = read_request(file, ["speed=0.5"])
    assert (request.name, request.load_mass, request.speed) == ("small", 2, 0.5)
    assert request.aircraft.model == "ultrastick_25e"
    file.write_text("load_mass: 2\nload_mass: 3\n")
    with pytest.raises(ScenarioError, match="given twice"):
        read_request(file)
    file.write_text("aircraft: {mass: 5.0}\n")
    with pytest.raises(ScenarioError, match=r"request\.aircraft\.wing_area = not given"):
        read_request(file)
