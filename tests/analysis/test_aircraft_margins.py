"""The margins of aircraft on the orbit above a resting load, and how drag bows their cables."""

import math
import warnings

import numpy as np
import pytest
from golden.numbers import read_table
from helpers import nightly_beyond
from pydrake.trajectories import PiecewisePolynomial

from drake_nonstop import (
    LoadTrajectory,
    ScenarioError,
    ScenarioWarning,
    aircraft_margins,
    load_scenario,
    simulate,
)
from drake_nonstop.mechanics.aircraft import drag_coefficient
from drake_nonstop.mechanics.signals import AircraftState
from drake_nonstop.model.system import aircraft_in

GRAVITY, AIR_DENSITY = 9.81, 1.225
MASS, LOAD_MASS, SHARE = 6.0, 10.0, 10.0 * GRAVITY / 4
# Without lift at no angle, and with an angle of attack of none: T acts along the path.
STRAIGHT = [
    *("system.aircraft.lift_at_zero_angle=0", "system.aircraft.lift_slope=1e9"),
    "system.cable_stiffness=1e7",
]
F60 = "!EllipticCarousel {spread: 11.5, radial: 3.6, tangential: 7.0, vertical: 9.1}"
F150 = "!EllipticCarousel {spread: 6.75, radial: 3.3, tangential: 4.5, vertical: 4.9}"
R60 = "!ConstantSpread {spread: 30.0}"
SPREAD = "!EllipticCarousel {spread: 24.525, radial: 9.81, tangential: 9.81}"


def scenario(pattern, length, frequency, *overrides, yaw_rate=None, wind=None, amplitude=1.0):
    """That of `aircraft_rest`, as changed; a load that turns by its constant internal force."""
    changes = [f"pattern={pattern}", f"system.cable_length={length}"]
    if wind is not None:
        changes.append(f"wind=!SteadyWind {{velocity: {list(map(float, wind))}}}")
    if yaw_rate is not None:
        changes.append(f"load_trajectory=!SteadyTurn {{yaw_rate: {yaw_rate}}}")
    if pattern == R60:
        amplitude = 0.0
    layer = f"optimization_layer=!ConstantParameters {{frequency: {frequency}, "
    changes.append(f"{layer}amplitude: {amplitude}}}")
    return load_scenario("aircraft_rest", [*changes, *overrides])


def margins(*arguments, **named):
    return aircraft_margins(scenario(*arguments, **named))


def found(result, name):
    return next(margin for margin in result.margins if margin.name == name)


# Of an independent prototype: length; frequency; yaw rate; speeds; largest C_L / C_Lmax; bank in
# deg; thrusts; distance; power of thrust. Each to the digits that it printed.
@pytest.mark.parametrize(
    ("pattern", "length", "rates", "speeds", "lift", "bank", "thrusts", "apart", "power"),
    [
        (F60, 60.0, (0.89, None), (10.9, 17.3), 0.86, 43, (0, 25), 16, 157),
        (F150, 150.0, (0.595, None), (13.6, 18.2), 0.56, 33, (4.5, 23), 20.7, 225),
        (R60, 60.0, (0.4, 0.4), (19.2, 19.2), 0.27, 11, (11.5, 11.5), 68, 223),
    ],
)
def test_designs_of_a_prototype(pattern, length, rates, speeds, lift, bank, thrusts, apart, power):
    result = margins(pattern, length, rates[0], yaw_rate=rates[1])
    assert result.is_flyable
    needs = result.needs
    assert [needs.airspeed.min(), needs.airspeed.max()] == pytest.approx(speeds, abs=0.1)
    assert found(result, "C_L / C_Lmax").value == pytest.approx(lift, abs=0.01)
    assert math.degrees(found(result, "bank").value) == pytest.approx(bank, abs=0.6)
    assert [needs.thrust.min(), needs.thrust.max()] == pytest.approx(thrusts, abs=0.4)
    assert found(result, "carriers apart").value == pytest.approx(apart, abs=0.2)
    assert result.propulsive_power == pytest.approx(power, rel=0.01)
    assert result.drawn_power == pytest.approx(result.propulsive_power / 0.65)
    used = needs.thrust / result.thrust_limits[1]
    assert result.ranges.dictionary["thrust_share"] == pytest.approx([used.min(), used.max()])


def test_a_spread_carousel_asks_for_more_than_the_aircraft_have():
    """C_L up to 2.2 C_Lmax, thrust from -45 to +63 N and a climb of 43 deg, by the prototype."""
    result = margins(SPREAD, 60.0, 0.62)
    missed = {margin.name for margin in result.missed}
    assert missed == {"C_L / C_Lmax", "airspeed / stall speed", "climb or descent", "thrust"}
    assert found(result, "C_L / C_Lmax").value == pytest.approx(2.2, abs=0.01)
    assert math.degrees(found(result, "climb or descent").value) == pytest.approx(43, abs=0.2)
    thrust = result.needs.thrust
    assert [thrust.min(), thrust.max()] == pytest.approx([-45, 63], abs=1.2)
    assert result.drawn_power == pytest.approx(result.propulsive_power / 0.65)  # none windmilling
    assert "C_L / C_Lmax 2.198 (at most 0.9)" in result.verdict
    assert result.possible_wind is None


def test_level_circles_with_the_load_are_those_of_the_closed_form():
    outward, rate = 30.0, 0.4
    turning = scenario(R60, 60.0, rate, *STRAIGHT, yaw_rate=rate)
    result, plane = aircraft_margins(turning), aircraft_in(turning.system)
    ratio, tangent = LOAD_MASS / (4 * MASS), outward / SHARE
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
    sizes = {"radial": math.cos(lean), "vertical": math.sin(lean), "tangential": 1.0}
    sizes["spread"] = SHARE * math.tan(lean)
    pattern = f"!EllipticCarousel {{{', '.join(f'{k}: {v}' for k, v in sizes.items())}}}"
    leaning = scenario(pattern, 60.0, frequency, *STRAIGHT, amplitude=amplitude)
    result, plane = aircraft_margins(leaning), aircraft_in(leaning.system)
    needs = result.needs
    speed = frequency * 60.0 * math.sin(half_cone)
    np.testing.assert_allclose(needs.airspeed, speed, rtol=1e-6)
    assert found(result, "climb or descent").value == pytest.approx(lean, rel=1e-6)
    pressure = AIR_DENSITY / 2 * speed**2 * plane.wing_area
    climbing = needs.thrust - pressure * drag_coefficient(plane, needs.lift)
    swing = MASS * GRAVITY * math.sin(lean)
    assert [climbing.min(), climbing.max()] == pytest.approx([-swing, swing], rel=1e-4)


def test_wind_beyond_what_the_formation_can_take_is_told_with_what_it_can():
    result = margins(F150, 150.0, 0.595, wind=(0, 4, 0))
    assert not result.is_flyable
    assert result.verdict.startswith("wind.velocity = [0.0, 4.0, 0.0]: ")
    possible = [float(part) for part in result.verdict.split("[")[-1].rstrip("]").split(",")]
    assert 2.0 < possible[1] < 3.0
    assert margins(F150, 150.0, 0.595, wind=possible).is_flyable
    assert not margins(F150, 150.0, 0.595, wind=np.add(possible, [0, 0.02, 0])).is_flyable


def test_wind_and_turning_with_the_load_shift_the_airspeed_by_both():
    speed = margins(R60, 60.0, 0.4, yaw_rate=0.4).needs.airspeed.mean()
    result = margins(R60, 60.0, 0.4, yaw_rate=0.4, wind=(5, 0, 0))
    needs = result.needs
    # The wind's drag on the load shifts the circles a little, too.
    assert [needs.airspeed.min(), needs.airspeed.max()] == pytest.approx(
        [speed - 5, speed + 5], abs=0.03
    )
    assert needs.lift.max() / 1.4 == pytest.approx(0.49, abs=0.005)
    assert [needs.thrust.min(), needs.thrust.max()] == pytest.approx([7, 17.5], abs=0.1)
    assert result.cables.difference > 0.01


def test_internal_force_and_load_that_turn_at_different_rates_repeat_after_some_turns():
    result = margins(F150, 150.0, 0.6, yaw_rate=0.2)
    assert result.turn == pytest.approx(3 * 2 * math.pi / 0.6)
    assert result.phases[-1] > 5.9 * math.pi


def test_distances_are_held_against_the_limits_of_a_run():
    limits = "limits.carrier_distance=0.2", "limits.cable_distance=0.9"
    result = margins(F150, 150.0, 0.595, *limits)
    assert [m.name for m in result.missed] == ["carriers apart"]
    assert result.missed[0].limit == pytest.approx(0.2 * 151.5)
    assert result.missed[0].where.count(" and ") == 1


def test_a_load_that_turns_about_a_horizontal_axis_has_no_resting_orbit():
    rolling = np.zeros((6, 2))
    rolling[0] = [0.0, 0.1]
    curve = PiecewisePolynomial.FirstOrderHold([0.0, 1.0], rolling)
    with pytest.raises(ScenarioError, match=r"^load_trajectory.*rests? at first"):
        aircraft_margins(
            load_scenario("aircraft_rest"), load_trajectory=lambda model: LoadTrajectory(curve)
        )


def test_what_straight_cables_leave_out_is_told():
    cables = margins(F150, 150.0, 0.595).cables
    assert 5.6 < cables.bow < 11  # 5.6 m at 15.3 m/s and 25 N
    assert cables.shortening[0] < 0.6 < cables.shortening[1]
    assert cables.load_width == pytest.approx(3.0)
    assert cables.mass == pytest.approx(0.11, abs=0.005)
    assert "m more than another, above a hundredth of the load's width (0.03 m)" in cables.warning
    assert not margins(F150, 150.0, 0.595, "system.cable_diameter=1e-4").cables.warning


@pytest.mark.parametrize("diameter", [0.7e-3, 2e-3])
def test_a_bowed_cable_is_that_of_its_differential_equation(diameter):
    """T y'' = -w_d (s/L)^2 with y = 0 at both ends; the arc is longer by the sum of y'^2/2."""
    change = f"system.cable_diameter={diameter}"
    result = margins(R60, 60.0, 0.4, change, yaw_rate=0.4)
    told, length = result.cables, 60.0
    drag = AIR_DENSITY / 2 * 1.1 * diameter * np.mean(result.needs.airspeed) ** 2
    tension = told.tension[0]
    assert tension == pytest.approx(math.hypot(30, SHARE), rel=1e-6)
    s = np.linspace(0, length, 20001)
    step = s[1]
    bent = -drag / tension * (s / length) ** 2
    slope = np.concatenate([[0], np.cumsum((bent[1:] + bent[:-1]) / 2)]) * step
    y = np.concatenate([[0], np.cumsum((slope[1:] + slope[:-1]) / 2)]) * step
    slope, y = slope - y[-1] / length, y - y[-1] * s / length
    assert told.bow == pytest.approx(y.max(), rel=1e-6)
    longer = np.sum((slope[1:] ** 2 + slope[:-1] ** 2) / 4) * step
    assert told.shortening == pytest.approx([longer, longer], rel=1e-6)
    assert not told.warning  # alike on level circles
    assert told.safety == pytest.approx(1600e6 * np.pi / 4 * diameter**2 / tension)
    assert f"break at {told.safety:.2g} times the largest tension" in told.text


CABLES = {
    "cable_length": [140.0, 150.0, 155.0, 160.0],
    "cable_diameter": [1e-3, 2e-3, 1.5e-3, 3e-3],
    "cable_stiffness": [100.0, 120.0, 200.0, 400.0],
}


@pytest.mark.parametrize(
    "reference",
    nightly_beyond(1, "engines", ["CarrierTrajectory", "!BowedCarrierTrajectory {nodes: 3}"]),
)
def test_the_needs_of_each_aircraft_are_those_of_many_cables_like_its_own(reference):
    def needs_with(values):
        changes = [f"system.{name}={value}" for name, value in values.items()]
        wind = "wind=!SteadyWind {velocity: [2, 1, 0]}"
        trajectory = f"carrier_trajectory={reference}"
        return aircraft_margins(load_scenario("aircraft_rest", [*changes, wind, trajectory]))

    together, alone = needs_with(CABLES), []
    for i in range(4):
        alone.append(needs_with({name: values[i] for name, values in CABLES.items()}))
        common = np.intersect1d(together.phases, alone[i].phases, return_indices=True)[1:]
        assert len(common[0]) >= 360
        for unlike, alike in zip(together.needs, alone[i].needs, strict=True):
            values = unlike[common[0], i], alike[common[1], i]
            np.testing.assert_allclose(*values, rtol=1e-9, atol=1e-9)
    told, others = together.cables, [each.cables for each in alone]
    assert told.bow <= max(one.bow for one in others)
    assert told.mass == pytest.approx(max(one.mass for one in others))
    assert told.safety >= min(one.safety for one in others)


# Of the plant only: at rest, in wind, beside a load that turns, and with other carriers.
OTHER_PLANTS = [
    ("aircraft_rest", ["simulated.load_mass=8"]),
    ("aircraft_rest", ["simulated.load_mass=8", "wind=!SteadyWind {velocity: [2, 0, 0]}"]),
    ("aircraft_rest", ["simulated.aircraft={mass: 6.6, zero_lift_drag: 0.04, max_lift: 1.3}"]),
    ("aircraft_rest", ["simulated={load_drag: 1.0, cable_stiffness: 80.0, cable_length: 150.3}"]),
    ("aircraft_co_rotating", ["simulated.load_mass=8"]),
]


@pytest.mark.parametrize(
    ("name", "overrides"), nightly_beyond(2, "flights", OTHER_PLANTS), ids=lambda value: str(value)
)
def test_the_needs_of_another_plant_are_those_that_are_flown(name, overrides):
    """In the second turn; C_L, airspeed and bank within 4 %, thrust within 3 % of its range."""
    made = load_scenario(name, overrides)
    expected = aircraft_margins(made)
    made.simulation_duration = 2 * expected.turn
    with warnings.catch_warnings():
        warnings.simplefilter("error", ScenarioWarning)  # all of them can be flown
        run = simulate(made, engine="compiled")
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


@pytest.mark.parametrize(
    "name",
    nightly_beyond(1, "flights", ["aircraft_rest_cables", "aircraft_co_rotating_cables"]),
)
def test_what_is_told_of_bowed_cables_is_what_is_flown(name):
    """Of flights of `LumpedCables`, up to 10 mm off, whose references answer what is observed."""
    result, flown = aircraft_margins(load_scenario(name)), read_table()[name]
    value = {margin.name: margin.value for margin in result.margins}
    for told, quantity, tolerance in (
        (value["bank"], "aircraft.bank_max_rad", 0.002),
        (value["C_L / C_Lmax"], "aircraft.lift_share_max", 0.004),
        (value["carriers apart"], "carriers.separation_min_m", 0.02),
        (result.ranges.airspeed[0], "aircraft.airspeed_min_m_s", 0.02),
        (result.ranges.thrust[1], "aircraft.thrust_max_N", 0.3),
        (result.ranges.thrust[0], "aircraft.thrust_min_N", 0.5),
        (result.propulsive_power, "aircraft.power_mean_W", 0.5),
        (result.cables.tension[0], "cables.tension_min_N", 0.3),
    ):
        assert told == pytest.approx(float(flown[quantity].value), abs=tolerance), quantity
    assert result.cables.are_flown
    assert "N at the carriers" in result.cables.text
    assert not result.cables.warning
