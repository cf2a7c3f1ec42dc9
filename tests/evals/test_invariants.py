import dataclasses
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from helpers import nightly_beyond
from scipy.spatial.transform import Rotation

from drake_nonstop import load_scenario, simulate

CONSTANT = ["optimization_layer=!ConstantParameters {}"]

# Flights of the fleet, with steps of 4 to 10 ms, and by how much a law may be missed, as integrals
# by trapezoids are. Of momentum and angular momentum in units of the impulse of the cables, of
# energy in units of what the carriers exchange. In turbulent flights forces change the fastest.
TOLERANCES = {
    "paper_quintic": (5e-5, 5e-6, 5e-3),
    "three_on_a_circle": (5e-5, 5e-5, 5e-3),
    "five_tilted_loaded": (5e-5, 5e-5, 1e-3),
    "six_noisy": (3e-4, 5e-5, 1e-2),
    "seven_gusty": (5e-5, 5e-5, 2e-3),
    "that_stalls": (1e-5, 1e-5, 5e-4),
    "fine": (1e-5, 1e-5, 1e-4),  # the quintic, with its signals at every ms
}


@pytest.fixture(scope="module", params=nightly_beyond(6, "flights", TOLERANCES))
def name(request):
    return request.param


@pytest.fixture(scope="module")
def run(fleet, name):
    fine = ["simulation_duration=6", "simulator_config.max_step_size=0.001"]
    return fleet.run(load_scenario("quintic", fine) if name == "fine" else name)


def rotations_of(load):
    return Rotation.from_quat(load[:, [1, 2, 3, 0]]).as_matrix()


@pytest.fixture(scope="module")
def flight(run):
    """The plant, and at every step: time, states and directions, forces (k, n, 3) and wrenches."""
    steps, scenario = run.steps, run.scenario
    simulated = {name: v for name, v in vars(scenario.simulated).items() if v is not None}
    plant = SimpleNamespace(**vars(scenario.system) | simulated)
    load, carriers = steps["load_state"], steps["carrier_state"]
    rotations = rotations_of(load)
    p, v = (each.reshape(len(load), -1, 3) for each in np.split(carriers, 2, axis=1))
    levers = np.array(plant.attachments) @ rotations.swapaxes(1, 2)
    ways = p - load[:, None, 4:7] - levers
    lengths = np.linalg.norm(ways, axis=2)
    directions = ways / lengths[..., None]
    omega, velocity = load[:, 7:10], load[:, 10:13]
    ends = velocity[:, None] + np.cross(omega[:, None], levers)

    def at_steps(name):
        samples = run.signal(name)
        return np.stack([np.interp(steps["time"], run.time, values) for values in samples.T], 1)

    disturbance = at_steps("disturbance_wrench")
    inertia = rotations @ np.array(plant.load_inertia) @ rotations.swapaxes(1, 2)
    return SimpleNamespace(
        plant=plant,
        time=steps["time"],
        position=load[:, 4:7],
        velocity=velocity,
        omega=omega,
        angular_momentum=np.einsum("kij,kj->ki", inertia, omega),
        v=v,
        levers=levers,
        stretch=np.maximum(lengths - plant.cable_length, 0),
        stretch_rate=(directions * (v - ends)).sum(2),
        tensions=steps["tensions"],
        forces=steps["tensions"][..., None] * directions,
        # All but those of cables and gravity.
        force=disturbance[:, 3:] - plant.load_drag * (velocity - at_steps("load_wind")),
        torque=disturbance[:, :3] - plant.load_angular_drag * omega,
    )


def integral(time, values):
    steps = np.diff(time).reshape(-1, *[1] * (values.ndim - 1))
    pieces = steps * (values[1:] + values[:-1]) / 2
    return np.concatenate([0 * values[:1], np.cumsum(pieces, axis=0)])


def test_energy_is_what_the_carriers_put_in_less_what_drag_and_cables_take(flight, name):
    f = flight
    energy = (
        f.plant.load_mass * (f.velocity**2).sum(1) / 2
        + (f.omega * f.angular_momentum).sum(1) / 2
        + f.plant.load_mass * f.plant.gravity * f.position[:, 2]
        + (f.plant.cable_stiffness * f.stretch**2).sum(1) / 2
    )
    power = (f.forces * f.v).sum((1, 2))
    other = (f.force * f.velocity).sum(1) + (f.torque * f.omega).sum(1)
    damping = ((f.tensions - f.plant.cable_stiffness * f.stretch) * f.stretch_rate).sum(1)
    balance = energy - energy[0] - integral(f.time, power + other - damping)
    exchanged = integral(f.time, np.abs(power))[-1]
    assert np.abs(balance).max() < TOLERANCES[name][2] * exchanged


def test_momentum_is_the_impulse_of_all_forces(flight, name):
    f = flight
    pull, twists = f.forces.sum(1), np.cross(f.levers, f.forces)
    weight = np.array([0, 0, -f.plant.load_mass * f.plant.gravity])
    pulls, moments = np.linalg.norm(pull, axis=1), np.linalg.norm(twists, axis=2).sum(1)
    for momentum, force, scale, tolerance in (
        (f.plant.load_mass * f.velocity, pull + f.force + weight, pulls, TOLERANCES[name][0]),
        (f.angular_momentum, twists.sum(1) + f.torque, moments, TOLERANCES[name][1]),
    ):
        missed = momentum - momentum[0] - integral(f.time, force)
        assert np.abs(missed).max() < tolerance * integral(f.time, scale)[-1]


def test_tensions_are_those_of_springs_and_dampers_that_pull_only(flight):
    f = flight
    spring = f.plant.cable_stiffness * f.stretch
    tensions = np.clip(spring + f.plant.cable_damping * f.stretch_rate, 0, 2 * spring)
    np.testing.assert_allclose(f.tensions, tensions, rtol=0, atol=1e-11 * tensions.max())


def test_quaternion_keeps_its_norm(run, name):
    load = run.steps["load_state"]
    tolerance = 1e-9 if name == "fine" else 1e-7  # steps of 1 ms, and of up to 10 ms
    assert np.abs(np.linalg.norm(load[:, :4], axis=1) - 1).max() < tolerance


def test_internal_forces_have_no_net_wrench(run):
    # What is held since the last sample is what the forces were made from.
    held = run.signal("held_measured_load_state")
    forces = run.signal("desired_cable_forces").reshape(len(held), -1, 3)
    levers = np.array(run.scenario.system.attachments) @ rotations_of(held).swapaxes(1, 2)
    wrench = np.hstack([np.cross(levers, forces).sum(1), forces.sum(1)])
    assert np.abs(wrench - run.signal("wrench")).max() < 1e-12 * np.abs(forces).sum(1).max()
    assert np.ptp(forces, axis=0).max() > 0.5  # they do move


@pytest.mark.parametrize(
    ("overrides", "tolerance"), nightly_beyond(1, "flights", [([], 1e-6), (CONSTANT, 1e-9)])
)
def test_a_turned_and_moved_run_gives_the_turned_and_moved_result(overrides, tolerance):
    yaw, shift = 0.7, np.array([3.0, -2.0, 5.0])
    turn = Rotation.from_euler("z", yaw).as_matrix()
    early = ["simulation_duration=2", "load_trajectory.start_time=0.2", *overrides]
    scenario = load_scenario("quintic", early)
    trajectory = dataclasses.replace(
        scenario.load_trajectory,
        start_position=shift.tolist(),
        start_roll_pitch_yaw=[0.0, 0.0, yaw],
        displacement=(turn @ scenario.load_trajectory.displacement).tolist(),
    )
    turned = dataclasses.replace(scenario, load_trajectory=trajectory)
    before, after = (
        np.hstack([run.signal("load_state")[:, 4:7], run.signal("carrier_state")[:, :12]])
        for run in map(simulate, (scenario, turned))
    )
    expected = before.reshape(-1, 3) @ turn.T + shift
    np.testing.assert_allclose(after.reshape(-1, 3), expected, rtol=0, atol=tolerance)


@pytest.mark.parametrize(
    ("hold", "largest"),
    # m, m/s, load, carriers
    nightly_beyond(1, "flights", [("third_order", 1e-4), ("velocity", 2e-5)]),
)
def test_the_integrator_converges_in_its_nominal_order(hold, largest):
    """Third order, once steps are short for the fastest mode; and the default step's error."""
    results = []
    for step in (0.005, 0.0025, 0.00125, 0.000625, 0.0003125):
        overrides = ["simulation_duration=0.4", f"simulator_config.max_step_size={step}", *CONSTANT]
        overrides += ["load_trajectory.start_time=0", f"carrier_trajectory.hold={hold}"]
        run = simulate(load_scenario("quintic", overrides))
        states = [run.signal("load_state")[-1, :7], run.signal("carrier_state")[-1]]
        results.append(np.concatenate(states))
    changes = [np.abs(a - b).max() for a, b in pairwise(results)]
    orders = np.log2(np.array(changes[:-1]) / changes[1:])
    assert np.all(np.diff(np.abs(orders - 3)) < 0)
    assert abs(orders[-1] - 3) < 0.3, orders
    errors = np.abs(results[0] - results[-1])
    assert errors.max() < largest
    assert errors[:19].max() < 2e-6  # m, of all
    assert errors[4:7].max() < 1e-6  # m, of the load
