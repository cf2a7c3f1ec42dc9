"""The margins of aircraft on the orbit above a resting load."""

import dataclasses
import math
import warnings

import numpy as np
import pytest
from helpers import nightly_beyond, regular

from drake_nonstop.analysis import aircraft_margins
from drake_nonstop.analysis.aircraft_margins import (
    margins_at_rest,
    margins_dictionary,
    margins_table,
)
from drake_nonstop.analysis.flight_envelope import FlightEnvelope
from drake_nonstop.mechanics.aircraft import drag_coefficient, stall_speed
from drake_nonstop.mechanics.signals import LOAD_REFERENCE_SIZE, AircraftState, LoadReference
from drake_nonstop.model.aircraft import AircraftParameters
from drake_nonstop.model.pattern import ConstantSpreadConfig, EllipticCarouselConfig
from drake_nonstop.model.system import Model, SystemParameters
from drake_nonstop.run.simulate import simulate
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.validation import ScenarioError, ScenarioWarning

GRAVITY, AIR_DENSITY = 9.81, 1.225
MASS, LOAD_MASS, SHARE = 6.0, 10.0, 10.0 * GRAVITY / 4
RASCAL = AircraftParameters(model="rascal_110")
# Without lift at no angle, and with an angle of attack of none: T acts along the path.
STRAIGHT = {"lift_at_zero_angle": 0.0, "lift_slope": 1e9}


def model(pattern, length, aircraft=RASCAL, **system):
    inertia = np.diag([5.625, 5.625, 11.25]).tolist()
    return Model(
        SystemParameters(
            load_mass=LOAD_MASS,
            load_inertia=inertia,
            load_drag=0.6,
            attachments=regular(4, 1.5).tolist(),
            cable_length=length,
            aircraft=aircraft,
            **{"cable_stiffness": 120.0, "carrier_mass": MASS} | system,
        ),
        pattern,
    )


def margins(made, frequency, *, yaw_rate=0.0, wind=(0.0, 0.0, 0.0), amplitude=1.0, **others):
    reference = np.zeros(LOAD_REFERENCE_SIZE)
    reference[0] = 1.0
    LoadReference.view(reference).angular_velocity[2] = yaw_rate
    parameters = np.array([frequency, amplitude])
    return margins_at_rest(made, reference, parameters, wind=np.array(wind), **others)


def found(result, name):
    return [margin for margin in result.margins if margin.name == name]


F60 = EllipticCarouselConfig(spread=11.5, radial=3.6, tangential=7.0, vertical=9.1)
F150 = EllipticCarouselConfig(spread=6.75, radial=3.3, tangential=4.5, vertical=4.9)
R60 = ConstantSpreadConfig(spread=30.0)
SPREAD = EllipticCarouselConfig(spread=24.525, radial=9.81, tangential=9.81)


# Of an independent prototype: length; frequency; yaw rate; speeds; largest C_L / C_Lmax; bank in
# deg; thrusts; distance; power of thrust. Each to the digits that it printed.
@pytest.mark.parametrize(
    ("pattern", "length", "rates", "speeds", "lift", "bank", "thrusts", "apart", "power"),
    [
        (F60, 60.0, (0.89, 0.0), (10.9, 17.3), 0.86, 43, (0, 25), 16, 157),
        (F150, 150.0, (0.595, 0.0), (13.6, 18.2), 0.56, 33, (4.5, 23), 20.7, 225),
        (R60, 60.0, (0.4, 0.4), (19.2, 19.2), 0.27, 11, (11.5, 11.5), 68, 223),
    ],
)
def test_designs_of_a_prototype(pattern, length, rates, speeds, lift, bank, thrusts, apart, power):
    result = margins(model(pattern, length), rates[0], yaw_rate=rates[1])
    assert result.is_flyable
    needs = result.needs
    assert [needs.airspeed.min(), needs.airspeed.max()] == pytest.approx(speeds, abs=0.1)
    assert found(result, "C_L / C_Lmax")[0].value == pytest.approx(lift, abs=0.01)
    assert math.degrees(found(result, "bank")[0].value) == pytest.approx(bank, abs=0.6)
    assert [needs.thrust.min(), needs.thrust.max()] == pytest.approx(thrusts, abs=0.4)
    assert found(result, "carriers apart")[0].value == pytest.approx(apart, abs=0.2)
    assert result.propulsive_power == pytest.approx(power, rel=0.01)
    assert result.drawn_power == pytest.approx(result.propulsive_power / 0.65)


def test_a_spread_carousel_asks_for_more_than_the_aircraft_have():
    """C_L up to 2.2 C_Lmax, thrust from -45 to +63 N and a climb of 43 deg, by the prototype."""
    result = margins(model(SPREAD, 60.0), 0.62)
    missed = {margin.name for margin in result.missed}
    assert missed == {"C_L / C_Lmax", "airspeed / stall speed", "climb or descent", "thrust"}
    assert found(result, "C_L / C_Lmax")[0].value == pytest.approx(2.2, abs=0.01)
    assert math.degrees(found(result, "climb or descent")[0].value) == pytest.approx(43, abs=0.2)
    thrust = result.needs.thrust
    assert [thrust.min(), thrust.max()] == pytest.approx([-45, 63], abs=1.2)
    assert result.drawn_power == pytest.approx(result.propulsive_power / 0.65)  # none windmilling
    assert "C_L / C_Lmax 2.198 (at most 0.9)" in result.verdict
    assert result.possible_wind is None


def test_level_circles_with_the_load_are_those_of_the_closed_form():
    outward, rate = 30.0, 0.4
    aircraft = dataclasses.replace(RASCAL, **STRAIGHT)
    made = model(ConstantSpreadConfig(spread=outward), 60.0, aircraft, cable_stiffness=math.inf)
    result = margins(made, rate, yaw_rate=rate)
    plane, ratio = made.aircraft, LOAD_MASS / (4 * MASS)
    tangent = outward / SHARE
    radius = 1.5 + 60.0 * math.sin(math.atan(tangent))
    speed = rate * radius
    bank = math.atan((speed**2 / (GRAVITY * radius) - ratio * tangent) / (1 + ratio))
    pressure = AIR_DENSITY / 2 * speed**2 * plane.wing_area
    lift = (MASS * GRAVITY + SHARE) / (pressure * math.cos(bank))
    parasitic = plane.zero_lift_drag + 1.1 * 0.001 * 60.0 / (4 * plane.wing_area)
    thrust = pressure * parasitic + plane.induced_drag * pressure * lift**2
    needs = result.needs
    for values, value in (
        (needs.airspeed, speed),
        (np.abs(needs.bank), abs(bank)),
        (needs.lift, lift),
        (needs.thrust, thrust),
        (result.carrier_distance, 2 * radius * math.sin(math.pi / 4)),
    ):
        np.testing.assert_allclose(values, value, rtol=1e-6)
    np.testing.assert_allclose(needs.climb, 0, atol=1e-9)
    assert result.turn == pytest.approx(2 * math.pi / rate)
    assert result.propulsive_power == pytest.approx(thrust * speed)


def test_leaning_circles_are_those_of_the_closed_form():
    """A cone of the half-angle theta about an axis that leans by psi, at a constant speed."""
    lean, half_cone, frequency = 0.3, 0.2, 0.9
    amplitude = SHARE * math.tan(half_cone) / math.cos(lean)
    pattern = EllipticCarouselConfig(
        spread=SHARE * math.tan(lean), radial=math.cos(lean), vertical=math.sin(lean)
    )
    aircraft = dataclasses.replace(RASCAL, **STRAIGHT)
    made = model(pattern, 60.0, aircraft, cable_stiffness=math.inf)
    result = margins(made, frequency, amplitude=amplitude)
    needs, plane = result.needs, made.aircraft
    speed = frequency * 60.0 * math.sin(half_cone)
    np.testing.assert_allclose(needs.airspeed, speed, rtol=1e-9)
    assert found(result, "climb or descent")[0].value == pytest.approx(lean, rel=1e-6)
    pressure = AIR_DENSITY / 2 * speed**2 * plane.wing_area
    climbing = needs.thrust - pressure * drag_coefficient(plane, needs.lift)
    swing = MASS * GRAVITY * math.sin(lean)
    assert [climbing.min(), climbing.max()] == pytest.approx([-swing, swing], rel=1e-4)


def test_wind_beyond_what_the_formation_can_take_is_told_with_what_it_can():
    made = model(F150, 150.0)
    result = margins(made, 0.595, wind=(0.0, 4.0, 0.0))
    assert not result.is_flyable
    assert result.verdict.startswith("wind.velocity = [0.0, 4.0, 0.0]: ")
    possible = [float(part) for part in result.verdict.split("[")[-1].rstrip("]").split(",")]
    assert 2.0 < possible[1] < 3.0
    assert margins(made, 0.595, wind=possible).is_flyable
    assert not margins(made, 0.595, wind=np.add(possible, [0, 0.02, 0])).is_flyable


def test_wind_and_turning_with_the_load_shift_the_airspeed_by_both():
    speed = margins(model(R60, 60.0), 0.4, yaw_rate=0.4).needs.airspeed.mean()
    needs = margins(model(R60, 60.0), 0.4, yaw_rate=0.4, wind=(5.0, 0.0, 0.0)).needs
    # The wind's drag on the load shifts the circles a little, too.
    assert [needs.airspeed.min(), needs.airspeed.max()] == pytest.approx(
        [speed - 5, speed + 5], abs=0.03
    )
    assert needs.lift.max() / 1.4 == pytest.approx(0.49, abs=0.005)
    assert [needs.thrust.min(), needs.thrust.max()] == pytest.approx([7, 17.5], abs=0.1)


def test_internal_force_and_load_that_turn_at_different_rates_repeat_after_some_turns():
    result = margins(model(F150, 150.0), 0.6, yaw_rate=0.2)
    assert result.turn == pytest.approx(3 * 2 * math.pi / 0.6)
    assert result.phases[-1] > 5.9 * math.pi


def test_distances_are_held_against_the_limits_of_a_run():
    limits = FlightEnvelope(carrier_distance=0.2, cable_distance=0.9)
    result = margins(model(F150, 150.0), 0.595, limits=limits)
    assert [m.name for m in result.missed] == ["carriers apart"]
    assert result.missed[0].limit == pytest.approx(0.2 * 151.5)
    assert result.missed[0].where.count(" and ") == 1


def test_a_load_that_turns_about_a_horizontal_axis_has_no_resting_orbit():
    reference = np.eye(LOAD_REFERENCE_SIZE)[0]
    LoadReference.view(reference).angular_velocity[0] = 0.1
    with pytest.raises(ScenarioError, match=r"^load_trajectory.*rests? at first"):
        margins_at_rest(model(F150, 150.0), reference, np.array([0.6, 1.0]))


def test_the_table_has_a_line_for_each_margin():
    result = margins(model(F150, 150.0), 0.595)
    lines = margins_table(result).splitlines()
    assert all(any(m.name in line for line in lines) for m in result.margins)
    assert stall_speed(model(F150, 150.0).aircraft) == result.stall_speed
    told = margins_dictionary(result)
    assert told["is_flyable"]
    table, ranges = "\n".join(lines), told["ranges"]
    # C_L / C_Lmax is 0.56; some of the force across the flight is the thrust's.
    assert "1.62 of the stall speed, and 1.33 of that with cable and bank" in table
    assert ranges["airspeed_over_loaded_stall"][0] == pytest.approx(1 / math.sqrt(0.56), rel=0.01)
    used = result.needs.thrust / result.thrust_limits[1]
    assert ranges["thrust_share"] == pytest.approx([used.min(), used.max()])
    assert "13 to 70 % of the largest" in table


def test_what_straight_cables_leave_out_is_told():
    cables = margins(model(F150, 150.0), 0.595).cables
    assert 5.6 < cables.bow < 11  # 5.6 m at 15.3 m/s and 25 N
    assert cables.shortening[0] < 0.6 < cables.shortening[1]
    assert cables.load_width == pytest.approx(3.0)
    assert cables.mass == pytest.approx(0.11, abs=0.005)
    assert "differently, more than a hundredth of the load's width (0.03 m)" in cables.warning
    thin = model(F150, 150.0, cable_diameter=1e-4)
    assert not margins(thin, 0.595).cables.warning
    alike = margins(model(R60, 60.0), 0.4, yaw_rate=0.4).cables  # on level circles
    assert alike.shortening[1] > 0.03 > 1e-3 > alike.difference
    assert not alike.warning
    in_wind = margins(model(R60, 60.0), 0.4, yaw_rate=0.4, wind=(5.0, 0.0, 0.0)).cables
    assert in_wind.difference > 0.01


# Of the plant only: at rest, in wind, beside a load that turns, and with other carriers.
OTHER_PLANTS = [
    ("aircraft_rest", ["simulated.load_mass=8"]),
    ("aircraft_rest", ["simulated.load_mass=14"]),
    ("aircraft_rest", ["simulated.load_mass=8", "wind=!SteadyWind {velocity: [2, 0, 0]}"]),
    ("aircraft_rest", ["simulated.aircraft={mass: 6.6, zero_lift_drag: 0.04, max_lift: 1.3}"]),
    ("aircraft_rest", ["simulated={load_drag: 1.0, cable_stiffness: 80.0, cable_length: 150.3}"]),
    ("aircraft_three", ["simulated.load_mass=8"]),
    ("aircraft_co_rotating", ["simulated.load_mass=8"]),
]


@pytest.mark.parametrize(
    ("name", "overrides"), nightly_beyond(2, "flights", OTHER_PLANTS), ids=lambda value: str(value)
)
def test_the_needs_of_another_plant_are_those_that_are_flown(name, overrides):
    """In the second turn; C_L, airspeed and bank within 4 %, thrust within 3 % of its range."""
    scenario = load_scenario(name, overrides)
    expected = aircraft_margins.aircraft_margins(scenario)
    scenario.simulation_duration = 2 * expected.turn
    with warnings.catch_warnings():
        warnings.simplefilter("error", ScenarioWarning)  # all of them can be flown
        run = simulate(scenario, engine="compiled")
    state = AircraftState.view(run.signal("aircraft_state")[run.time > expected.turn])
    needs = expected.needs
    for told, flown, share in (
        (needs.lift, state.lift, 0.04),
        (needs.airspeed, state.airspeed, 0.04),
        (np.abs(needs.bank), np.abs(state.bank), 0.04),
        (needs.thrust, state.thrust, 0.03),
    ):
        size = np.max(expected.thrust_limits[1]) if told is needs.thrust else np.max(told)
        for end in (np.min, np.max):
            assert end(told) == pytest.approx(end(flown), abs=share * size)
