"""One aircraft of JSBSim, held against the point mass's forces, and files that are no aircraft."""

import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from drake_nonstop import ScenarioError
from drake_nonstop.mechanics.aircraft import (
    air_force,
    air_frame,
    body_attitude,
    trimmed_states,
)
from drake_nonstop.model.aircraft import AircraftParameters, make_aircraft, values_of
from drake_nonstop.model.jsbsim_aircraft import (
    TABLE,
    WRITTEN,
    JsbsimAircraft,
    JsbsimFleet,
    aircraft_file,
)

pytest.importorskip("jsbsim")

STEP, FILE = 0.005, TABLE / "rascal_110.xml"
ZERO = np.zeros(3)
PARAMETERS = AircraftParameters(model="rascal_110")


def point_mass(**changes):
    parameters = AircraftParameters(model="rascal_110", **changes)
    return make_aircraft(parameters, cable_length=150.0, gravity=9.81)


def made(path=FILE, hook=(0.0, 0.0, -0.1), **changes):
    return JsbsimAircraft(
        path,
        point_mass(**changes),
        step=STEP,
        hook=np.array(hook),
        owner="carrier_dynamics",
        field="system",
    )


def started(position, velocity, acceleration, pull=ZERO, wind=ZERO, **options):
    """A fleet of one, its state, and its trimmed command (3,)."""
    aircraft = point_mass()
    carrier = np.concatenate([position, velocity])
    command = trimmed_states(aircraft, carrier, acceleration, pull, wind)[6:9]
    fleet = JsbsimFleet([made(**options)])
    parts = (position, velocity, acceleration, command, pull, wind)
    return fleet, fleet.start(*(part[None] for part in parts)), command


def test_the_file_has_the_numbers_of_the_table():
    root = ElementTree.parse(FILE).getroot()
    declared = {
        p.text.strip(): float(p.get("value")) for p in root.iter("property") if p.get("value")
    }
    values = values_of(PARAMETERS)
    for field, names in WRITTEN.items():
        if field in values:
            shown = [declared[f"carrier/{name}"] for name in names]
            np.testing.assert_array_equal(shown, np.ravel(values[field]), field)
    for path, name in (
        ("metrics/wingarea", "wing_area"),
        ("metrics/wingspan", "wing_span"),
        ("mass_balance/emptywt", "mass"),
    ):
        assert float(root.findtext(path)) == values[name]


@pytest.mark.parametrize("seed", range(3))
def test_it_starts_where_it_is_put_and_moves_by_the_forces_of_the_point_mass(seed):
    rng = np.random.default_rng(seed)
    position = rng.uniform([-150, -150, 50], [150, 150, 200])
    velocity = np.append(rng.uniform(9, 13, 2) * rng.choice([-1, 1], 2), rng.uniform(-2, 2))
    acceleration, pull = rng.uniform(-1.5, 1.5, 3), rng.uniform([-10, -10, 15], [10, 10, 30])
    wind = rng.uniform(-2, 2, 3)
    fleet, shown, command = started(position, velocity, acceleration, pull, wind)
    np.testing.assert_allclose(shown.positions[0], position, atol=1e-6)
    np.testing.assert_allclose(shown.velocities[0], velocity, atol=3e-5)  # the vertical leans
    np.testing.assert_allclose([shown.lift[0], shown.bank[0]], command[:2], atol=2e-3)
    assert shown.thrust[0] == pytest.approx(command[2], abs=0.01)
    before, moved = shown, shown.velocities[0] * 0
    for _ in range(20):
        after = fleet.advance(command[None], pull[None], wind[None])
        moved += (after.centre_velocities - before.centre_velocities)[0] / (20 * STEP)
        before = after
    told = [np.array([value[0]]) for value in (before.lift, before.bank, before.thrust)]
    believed = point_mass()
    force = air_force(believed, before.centre_velocities - wind, *told)[0] - pull
    expected = force / believed.mass - np.array([0, 0, believed.gravity])
    np.testing.assert_allclose(moved, expected, atol=0.2)
    np.testing.assert_allclose(
        before.airspeed, air_frame(before.centre_velocities - wind).airspeed[0], rtol=1e-5
    )


def test_it_flies_the_commands_of_a_level_turn():
    speed, radius = 16.0, 30.0
    start = np.array([radius, 0, 150.0]), np.array([0, speed, 0])
    fleet, _, command = started(*start, np.array([-(speed**2) / radius, 0, 0]))
    for _ in range(600):
        shown = fleet.advance(command[None], ZERO[None], ZERO[None])
    angle = 600 * STEP * speed / radius
    np.testing.assert_allclose(
        shown.positions[0], [radius * np.cos(angle), radius * np.sin(angle), 150], atol=0.5
    )
    assert shown.lift[0] == pytest.approx(command[0], abs=0.003)
    assert shown.bank[0] == pytest.approx(command[1], abs=0.01)
    assert shown.thrust[0] == pytest.approx(command[2], abs=0.1)


def test_a_pull_in_front_of_the_centre_of_gravity_turns_the_nose_down():
    arm, force, inertia = 0.3, 20.0, 2.101
    start = np.array([0, 0, 100.0]), np.array([15.0, 0, 0])
    fleet, _, command = started(*start, ZERO, hook=(arm, 0, 0))
    pull = np.array([[0, 0, force]])  # on the load: upwards
    for _ in range(3):  # the first moves by the forces before
        shown = fleet.advance(command[None], pull, ZERO[None])
    sweep = (shown.velocities - shown.centre_velocities)[0]
    rate = -sweep[2] / arm
    assert rate == pytest.approx(arm * force / inertia * 2.5 * STEP, rel=0.25)
    assert abs(sweep[1]) < 0.01 * abs(sweep[2])
    nose = body_attitude(start[1], 0.0, 0.0)[:, 0]
    np.testing.assert_allclose(nose, [1, 0, 0], atol=1e-9)


def test_mass_and_lift_are_the_models():
    def rate(**changes):
        fleet = JsbsimFleet([made(**changes)])
        command = np.array([[0.5, 0, 5.0]])
        start = (np.array([[0, 0, 100.0]]), np.array([[15.0, 0, 0]]), ZERO[None])
        first = fleet.start(*start, command, ZERO[None], ZERO[None])
        for _ in range(2):
            last = fleet.advance(command, ZERO[None], ZERO[None])
        return (last.centre_velocities - first.centre_velocities)[0, 2] / (2 * STEP)

    lift = 1.225 / 2 * 15**2 * 0.98 * 0.5
    assert rate() == pytest.approx(lift / 6 - 9.81, abs=0.1)
    assert rate(mass=7.0) == pytest.approx(lift / 7 - 9.81, abs=0.1)
    assert rate(air_density=1.0) == pytest.approx(lift / 1.225 / 6 - 9.81, abs=0.1)


TEXT = FILE.read_text(encoding="utf-8")


def test_a_file_that_is_no_xml_is_refused_whatever_is_beside_it(tmp_path):
    (tmp_path / "other.xml").write_text(TEXT, encoding="utf-8")
    path = tmp_path / "other.txt"
    path.write_text("nothing", encoding="utf-8")
    with pytest.raises(ScenarioError, match=r"aircraft_file = .*: give the path of an aircraft's"):
        aircraft_file(str(path), None, "carrier_dynamics", "system")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            "</aerodynamics>",
            "",
            "JSBSim does not load it (XML parse error: mismatched tag); correct",
        ),
        ("aero/betadot-rad_sec", "no/such", "property no/such does not exist); correct the file"),
        ('name="cable"', 'name="rope"', "it declares no external_reactions/cable/magnitude; add"),
        ('<htailarm unit="M"> 1.0 </htailarm>', "", "it has no htailarm above zero in <metrics>"),
        ('name="cable" frame="LOCAL"', 'name="cable" frame="BODY"', "has the frame BODY; give"),
        ("carrier/motion-waits", "carrier/moves", "it declares no carrier/motion-waits; add"),
    ],
)
def test_a_file_that_is_no_aircraft_is_refused(tmp_path, old, new, said):
    assert old in TEXT
    path = tmp_path / "other.xml"
    path.write_text(TEXT.replace(old, new), encoding="utf-8")
    with pytest.raises(ScenarioError) as caught:
        made(aircraft_file(str(path), None, "carrier_dynamics", "system"))
    assert str(caught.value).startswith(f"carrier_dynamics.aircraft_file = {path}: ")
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"hook": (-1.2, 0, 0)}, "carrier_dynamics.hook[0] = -1.2: it is behind the tail, 1 m"),
        ({"hook": (0, 1.5, 0)}, "carrier_dynamics.hook[1] = 1.5: it is beyond the tip of the wing"),
        ({"hook": (0, 0, -2)}, "carrier_dynamics.hook[2] = -2.0: it is below the aircraft"),
        ({"wing_area": 1.1}, "system.aircraft.wing_area = 1.1: rascal_110.xml has 0.98 m^2; give"),
    ],
)
def test_a_hook_or_an_aircraft_that_does_not_fit_is_refused(options, said):
    with pytest.raises(ScenarioError) as caught:
        made(**options)
    assert str(caught.value).startswith(said)


def test_an_aircraft_without_a_file_is_refused():
    with pytest.raises(ScenarioError, match=r"ultrastick_25e: the package has no JSBSim file of"):
        aircraft_file("", "ultrastick_25e", "carrier_dynamics", "system")


def test_jsbsim_prints_nothing(capfd):
    started(np.array([0, 0, 100.0]), np.array([15.0, 0, 0]), ZERO)
    assert capfd.readouterr() == ("", "")
