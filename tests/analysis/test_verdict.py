"""The verdict on a scenario by its flights."""

import math

import pytest
from helpers import nightly_beyond

from drake_nonstop.analysis.flights import CheckedFlight, SpreadMargin, fly, spread_margins
from drake_nonstop.analysis.stated_errors import (
    is_random,
    with_seed,
    without_errors,
    without_noise,
)
from drake_nonstop.analysis.verdict import ScenarioCheck, check_scenario, flights_of
from drake_nonstop.planning.margins import Margin
from drake_nonstop.run.outcome import RunOutcome
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.scenario.overrides import changed
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.validation import ScenarioError

SHORT = "simulation_duration=3"
WIND = "wind=!SteadyWind {velocity: [0.5, 0, 0]}"
OFF = "[[0.77,0.75,0],[-0.75,0.77,0],[-0.75,-0.75,0],[0.75,-0.75,0]]"
NOISE = (
    "position_noise: {0}, velocity_noise: {1}, orientation_noise: {0}, angular_velocity_noise: {1}"
)
FEEDBACK = "load_feedback=!NoisyFeedback {{" + NOISE + "}}"


def quintic(*overrides):
    return load_scenario("quintic", [SHORT, *overrides])


def test_a_scenario_without_errors_is_flown_once_and_is_ok():
    told = []
    found = check_scenario(quintic(), progress=lambda what, share: told.append(share))
    assert found.is_ok
    assert [flight.name for flight in found.flights] == ["as stated"]
    assert found.nominal is None
    assert found.remedies == ()
    assert found.verdicts[0] == "ok: the flight keeps all limits"
    names = [each.worst.name for each in found.margins]
    assert {"position error", "speed / bound", "tension", "carrier distance"} <= {*names}
    assert found.feasible is not None
    assert min(found.feasible.ratios) > 1
    assert found.dictionary["is_ok"]
    assert "speed / bound" in found.table
    assert told[-1] == 1.0


def test_noise_is_flown_in_seeds_and_a_filter_that_was_flown_is_told():
    found = check_scenario(quintic(FEEDBACK.format(0.005, 0.02)), seeds=2)
    assert found.outcome is RunOutcome.BOUND_MISSED
    assert [flight.name for flight in found.flights] == ["as stated", "seed +1"]
    assert found.nominal is not None
    assert found.nominal.is_ok
    assert "in 2 of 2 flights" in found.verdicts[0]
    assert found.verdicts[1] == "without the errors that the scenario states the flight is ok"
    (speed,) = (each for each in found.margins if each.worst.name == "speed / bound")
    assert speed.worst.value < speed.most < 1
    assert speed.deviation > 0


@pytest.mark.parametrize(
    ("name", "overrides"),
    nightly_beyond(
        2,
        "flights",
        [
            ("quintic", [f"simulated.attachments={OFF}"]),
            ("line_without_optimization", ["optimization_layer.speed_bound=1.2"]),
            ("aircraft_rest_cables", [WIND, "wind_estimator=NoWind"]),
        ],
    ),
)
def test_with_what_is_told_to_help_the_flights_are_ok(name, overrides):
    scenario = load_scenario(name, overrides)
    found = check_scenario(scenario)
    assert not found.is_ok
    assert found.remedies
    for remedy in found.remedies:
        assert fly([("", changed(scenario, remedy.overrides))])[0].is_ok
        assert remedy.text in found.verdicts[-1]


def test_a_lost_load_is_explained_by_the_growth_about_it():
    unstable = load_scenario("paper_quintic", ["system.carrier_mass=0.3", "simulation_duration=6"])
    found = check_scenario(unstable, tries_remedies=False)
    assert found.outcome in (RunOutcome.STOPPED, RunOutcome.LOAD_LOST)
    assert found.stability is not None
    assert found.stability.rate > 1
    assert any("the loop is unstable" in said for said in found.verdicts)


def test_an_infeasible_bound_is_explained_by_the_xi_and_a_that_would_do():
    bounds = "optimization_layer.frequency_bounds=[0.5, 2.0]"
    found = check_scenario(quintic("optimization_layer.speed_bound=3", bounds))
    assert found.outcome is RunOutcome.BOUND_MISSED
    assert found.feasible is not None
    assert len(found.feasible.tight_times) > 0
    assert any(said.startswith("no constant xi and A keep the bound") for said in found.verdicts)


def test_narrow_margins_are_those_within_three_deviations():
    margin = Margin("speed / bound", 1.02, 1.0, is_least=True)
    assert SpreadMargin(margin, 1.05, 0.01).is_narrow
    assert not SpreadMargin(margin, 1.05, 0.005).is_narrow
    assert not SpreadMargin(margin, 1.02, math.nan).is_narrow
    assert SpreadMargin(margin._replace(value=1.005), 1.0, math.nan).is_narrow


def test_limits_that_some_seeds_miss_are_told_as_narrow():
    outcomes = RunOutcome.OK, RunOutcome.BOUND_MISSED
    values = (1.01, 0.99), (1.01, 1.02), (0.5, 0.5)
    narrow = []
    for of_speed in values:
        flights = [
            CheckedFlight(
                "",
                Scenario(),
                outcomes[value < 1],
                ("slow",),
                (Margin("speed / bound", value, 1.0, is_least=True),),
            )
            for value in of_speed
        ]
        found = ScenarioCheck(
            scenario=Scenario(), flights=flights, nominal=None, margins=spread_margins(flights)
        )
        narrow.append([each.worst.name for each in found.narrow])
    assert narrow == [["speed / bound"], ["speed / bound"], []]


def test_margins_over_flights_are_the_worst_of_each():
    flights = fly([(str(mass), quintic(f"simulated.load_mass={mass}")) for mass in (1.0, 1.02)])
    by_name = {each.worst.name: each for each in spread_margins(flights)}
    least = [min(m.value for m in flight.margins if m.name == "tension") for flight in flights]
    tension = by_name["tension"]
    assert (tension.worst.value, tension.most) == (min(least), max(least))
    assert tension.worst.where.startswith("cable ")


def test_errors_are_taken_away_and_seeds_are_changed():
    gusty = load_scenario("aircraft_transfer_gusty")
    assert is_random(gusty)
    assert not is_random(without_noise(gusty))
    assert with_seed(gusty, 2).wind.seed == gusty.wind.seed + 2
    assert not is_random(load_scenario("quintic"))
    assert without_errors(load_scenario("quintic")) == load_scenario("quintic")
    delayed = quintic("load_feedback=!NoisyFeedback {delay: 0.02}", "simulated.load_mass=1.1")
    assert not is_random(delayed)
    nominal = without_errors(delayed)
    assert nominal.load_feedback.delay == 0
    assert nominal.simulated.load_mass is None
    assert len(flights_of(gusty, 3)) == 3
    drawn = quintic("system.load_mass=!Uniform {min: 0.9, max: 1.1}")
    assert [each.random_seed for _, each in flights_of(drawn, 2)] == [0, 1]


@pytest.mark.parametrize("seeds", [0, -1, 1.5, 10**6])
def test_a_number_of_seeds_that_is_none_is_refused(seeds):
    with pytest.raises(ScenarioError, match="seeds = "):
        check_scenario(quintic(), seeds=seeds)
