"""The verdict on a scenario by its flights."""

import dataclasses
import math

import numpy as np
import pytest
from helpers import nightly_beyond

from drake_nonstop import (
    RunOutcome,
    ScenarioError,
    changed,
    check_scenario,
    compute_metrics,
    load_scenario,
    simulate,
)
from drake_nonstop.analysis.feasible_parameters import set_over_time
from drake_nonstop.blocks.load_disturbance import NoDisturbanceConfig

SHORT, BRIEF = "simulation_duration=3", "simulation_duration=1"
WIND = "wind=!SteadyWind {velocity: [0.5, 0, 0]}"
OFF = "[[0.77,0.75,0],[-0.75,0.77,0],[-0.75,-0.75,0],[0.75,-0.75,0]]"
FEEDBACK = (
    "load_feedback=!NoisyFeedback {position_noise: 0.005, velocity_noise: 0.02, "
    "orientation_noise: 0.005, angular_velocity_noise: 0.02}"
)


def quintic(*overrides):
    return load_scenario("quintic", [SHORT, *overrides])


@pytest.fixture(scope="module")
def calm():
    """What is found of a scenario without errors, and how it was told."""
    told = []
    return check_scenario(quintic(), progress=lambda what, share: told.append(share)), told


def test_a_scenario_without_errors_is_flown_once_and_is_ok(calm):
    found, told = calm
    assert found.is_ok
    assert [flight.name for flight in found.flights] == ["as stated"]
    assert found.nominal is None
    assert found.remedies == ()
    assert found.verdicts[0] == "ok: the flight keeps all limits"
    names = [each.worst.name for each in found.margins]
    assert {"position error", "speed / bound", "tension", "carrier distance"} <= {*names}
    assert min(found.feasible.ratios) > 1
    assert found.dictionary["is_ok"]
    assert "speed / bound" in found.table
    assert told[-1] == 1.0
    # What constant ξ and A reach is a share of the bound.
    higher = check_scenario(quintic("optimization_layer.speed_bound=0.75"), tries_remedies=False)
    flown = found.flights[0].history.times, found.flights[0].history.parameters
    for told in (lambda one: one.feasible.ratios, lambda one: set_over_time(one.task, flown, 0)[2]):
        np.testing.assert_allclose(told(higher), told(found) * 0.55 / 0.75, rtol=0.02)


def test_margins_are_those_of_the_flight_with_their_places_and_times(calm):
    margins = {margin.name: margin for margin in calm[0].flights[0].margins}
    run = simulate(quintic())
    tensions = run.steps["tensions"]
    step, cable = np.unravel_index(np.argmin(tensions), tensions.shape)
    tension = margins["tension"]
    assert tension.value == pytest.approx(tensions.min(), rel=1e-9)
    assert (tension.where, tension.when) == (f"cable {cable + 1}", run.steps["time"][step])
    errors = np.linalg.norm(
        run.signal("load_state")[:, 4:7] - run.signal("reference")[:, 4:7], 2, 1
    )
    assert margins["position error"].value == pytest.approx(errors.max(), rel=1e-6)
    assert margins["position error"].when == pytest.approx(run.time[np.argmax(errors)])


def test_noise_is_flown_in_seeds_and_margins_are_the_worst_of_all_flights():
    found = check_scenario(quintic(FEEDBACK), seeds=2, tries_remedies=False)
    assert found.outcome is RunOutcome.BOUND_MISSED
    assert [flight.name for flight in found.flights] == ["as stated", "seed +1"]
    assert found.nominal is not None
    assert found.nominal.is_ok
    assert "in 2 of 2 flights" in found.verdicts[0]
    assert found.verdicts[1] == "without the errors that the scenario states the flight is ok"
    (speed,) = (each for each in found.margins if each.worst.name == "speed / bound")
    assert speed.worst.value < speed.most < 1
    for worst, most, deviation in found.margins:
        values = [m.value for f in found.flights for m in f.margins if m.name == worst.name]
        assert {worst.value, most} == {*values}
        assert (worst.value <= most) == worst.is_least or worst.value == most
        assert deviation == pytest.approx(np.std(values, ddof=1))


REMEDIED = [
    ("line_without_optimization", [BRIEF, "optimization_layer.speed_bound=1.2"]),
    ("quintic", [f"simulated.attachments={OFF}"]),
    ("aircraft_rest_cables", [WIND, "wind_estimator=NoWind"]),
]


@pytest.mark.nightly("flights")
@pytest.mark.parametrize(("name", "overrides"), REMEDIED)
def test_with_what_is_told_to_help_the_flights_are_ok(name, overrides):
    scenario = load_scenario(name, overrides)
    found = check_scenario(scenario)
    assert not found.is_ok
    assert found.remedies
    for remedy in found.remedies:
        helped = simulate(changed(scenario, remedy.overrides))
        assert compute_metrics(helped)["outcome"] == "ok"
        assert remedy.text in found.verdicts[-1]


GROWS = "about the load at rest a small deviation grows"
RATES, ATTITUDE = "correction_rates=[6.0, 6.0, 6.0, 6.0]", "load_feedback.measures_attitude=false"
RATES, DRAG = (f"carrier_trajectory.{rate}" for rate in (RATES, "drag_rate=20.0"))
UNSTABLE = [
    ("quintic", [BRIEF, RATES], RATES),
    ("paper_quintic", ["system.carrier_mass=0.3", "simulation_duration=6"], ""),
    ("real_scale_cycle", ["load_feedback=FilteredFeedback"], ATTITUDE),
    ("aircraft_rest_cables", [BRIEF, DRAG], DRAG),
]


@pytest.mark.parametrize(("name", "overrides", "field"), nightly_beyond(1, "studies", UNSTABLE))
def test_growth_about_a_load_at_rest_is_told_with_the_field_to_blame(name, overrides, field):
    found = check_scenario(load_scenario(name, overrides), tries_remedies=False)
    start = f"{field.replace('=', ' = ')}: {GROWS}, +" if field else GROWS
    assert sum(each.startswith(start) for each in found.verdicts) == 1
    assert found.stability.rate > 0
    assert not found.is_ok


def test_an_infeasible_bound_is_explained_by_the_xi_and_a_that_would_do():
    bounds = "optimization_layer.frequency_bounds=[0.5, 2.0]"
    changes = "optimization_layer.speed_bound=3", bounds
    found = check_scenario(quintic(*changes), tries_remedies=False)
    assert found.outcome is RunOutcome.BOUND_MISSED
    assert len(found.feasible.tight_times) > 0
    assert any(said.startswith("no constant xi and A keep the bound") for said in found.verdicts)


def test_narrow_margins_are_those_within_three_deviations_and_what_some_seeds_miss(calm):
    found, _ = calm
    (speed,) = (each for each in found.margins if each.worst.name == "speed / bound")
    for value, deviation, is_narrow in (
        (1.02, 0.01, True),
        (1.02, 0.005, False),
        (1.02, math.nan, False),
        (1.005, math.nan, True),
    ):
        own = speed._replace(worst=speed.worst._replace(value=value), deviation=deviation)
        assert own.is_narrow == is_narrow
    (flight,), outcomes = found.flights, (RunOutcome.OK, RunOutcome.BOUND_MISSED)
    for values, is_told in (((1.01, 0.99), True), ((1.01, 1.02), True), ((0.5, 0.5), False)):
        flown = dataclasses.replace(
            found,
            flights=tuple(flight._replace(outcome=outcomes[value < 1]) for value in values),
            margins=(
                speed._replace(
                    worst=speed.worst._replace(value=min(values)),
                    most=max(values),
                    deviation=float(np.std(values, ddof=1)),
                ),
            ),
        )
        assert [each.worst.name for each in flown.narrow] == ["speed / bound"] * is_told


def test_errors_are_taken_away_and_seeds_are_changed():
    short = ["simulation_duration=0.2", "optimization_layer=ConstantParameters"]
    delayed = ["load_feedback=!NoisyFeedback {delay: 0.02}", "simulated.load_mass=1.1"]
    delayed += [
        "load_disturbance=!DisturbanceForce {force: [0.1, 0, 0]}",
        "start_error=[0,0,0,0,0,1]",
    ]
    drawn = ["system.load_mass=!Uniform {min: 0.9, max: 1.1}"]
    gusty = load_scenario("aircraft_transfer_gusty", short)
    for scenario, seeds in (
        (gusty, [(gusty.wind.seed + k, k) for k in range(3)]),
        (load_scenario("quintic", [*short, *delayed]), [(0, 0)]),
        (load_scenario("quintic", [*short, *drawn]), [(0, k) for k in range(3)]),
    ):
        found = check_scenario(scenario, seeds=3, tries_remedies=False)
        flown = [each.scenario for each in found.flights]
        own = [(getattr(each.wind, "seed", 0), each.random_seed) for each in flown]
        assert own == seeds
        nominal = found.nominal.scenario
        assert getattr(nominal.wind, "gust", 0) == getattr(nominal.load_feedback, "delay", 0) == 0
        assert nominal.simulated.load_mass is None
        assert (nominal.load_disturbance, nominal.start_error) == (NoDisturbanceConfig(), [0.0] * 6)


@pytest.mark.parametrize("seeds", [0, -1, 1.5, 10**6])
def test_a_number_of_seeds_that_is_none_is_refused(seeds):
    with pytest.raises(ScenarioError, match="seeds = "):
        check_scenario(quintic(), seeds=seeds)
