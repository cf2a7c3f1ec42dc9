"""Laws of mechanics that every run obeys, computed from its signals by independent formulas."""

import dataclasses
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drake_nonstop.blocks.optimization_layer import ConstantParametersConfig
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.simulation.simulate import simulate

CONSTANT = ["optimization_layer=!ConstantParameters {}"]


@pytest.fixture(scope="module")
def fine(shared_runs):
    """The quintic, slowly turning and moving, with its signals at every ms."""
    return shared_runs.run(
        load_scenario("quintic", ["simulation_duration=6", "simulator_config.max_step_size=0.001"])
    )


def parts(run):
    """Time, rotations (k, 3, 3) and the states of load, carriers and cables at every step."""
    steps = run.steps
    load, carriers = steps["load_state"], steps["carrier_state"]
    half = carriers.shape[1] // 2
    rotations = Rotation.from_quat(load[:, [1, 2, 3, 0]]).as_matrix()
    p, v = (each.reshape(len(load), -1, 3) for each in (carriers[:, :half], carriers[:, half:]))
    levers = np.array(run.scenario.system.attachments) @ rotations.swapaxes(1, 2)
    ways = p - load[:, None, 4:7] - levers
    lengths = np.linalg.norm(ways, axis=2)
    directions = ways / lengths[..., None]
    ends = load[:, None, 10:13] + np.cross(load[:, None, 7:10], levers)
    return steps["time"], rotations, load, v, levers, lengths, directions, ends, steps["tensions"]


def integral(time, values):
    return np.concatenate([[0], np.cumsum(np.diff(time) * (values[1:] + values[:-1]) / 2)])


def test_energy_is_what_the_carriers_put_in_less_what_drag_and_cables_take(fine):
    system = fine.scenario.system
    time, rotations, load, v, _, lengths, directions, ends, tensions = parts(fine)
    omega = np.einsum("kji,kj->ki", rotations, load[:, 7:10])
    stretch = np.maximum(lengths - system.cable_length, 0)
    energy = (
        system.load_mass * (load[:, 10:13] ** 2).sum(1) / 2
        + np.einsum("ki,ij,kj->k", omega, np.array(system.load_inertia), omega) / 2
        + system.load_mass * system.gravity * load[:, 6]
        + (system.cable_stiffness * stretch**2).sum(1) / 2
    )
    power = (tensions * (directions * v).sum(2)).sum(1)
    drag = system.load_drag * (load[:, 10:13] ** 2).sum(1)
    stretch_rate = (directions * (v - ends)).sum(2)
    damping = ((tensions - system.cable_stiffness * stretch) * stretch_rate).sum(1)
    balance = energy - energy[0] - integral(time, power - drag - damping)
    exchanged = integral(time, np.abs(power))[-1]
    assert np.abs(balance).max() < 1e-4 * exchanged


def test_momentum_is_the_impulse_of_all_forces(fine):
    system = fine.scenario.system
    time, rotations, load, _, levers, _, directions, _, tensions = parts(fine)
    forces = tensions[..., None] * directions
    total = forces.sum(1) - system.load_drag * load[:, 10:13]
    total[:, 2] -= system.load_mass * system.gravity
    torque = np.cross(levers, forces).sum(1)
    inertia = np.array(system.load_inertia)
    angular = np.einsum("kij,jl,kml,km->ki", rotations, inertia, rotations, load[:, 7:10])
    pull = np.linalg.norm(forces.sum(1), axis=1)
    twist = np.linalg.norm(np.cross(levers, forces), axis=2).sum(1)
    for momentum, force, scale in (
        (system.load_mass * load[:, 10:13], total, integral(time, pull)[-1]),
        (angular, torque, integral(time, twist)[-1]),
    ):
        impulse = np.stack([integral(time, force[:, i]) for i in range(3)], axis=1)
        assert np.abs(momentum - momentum[0] - impulse).max() < 1e-5 * scale


def test_quaternion_keeps_its_norm(fine):
    assert np.abs(np.linalg.norm(fine.steps["load_state"][:, :4], axis=1) - 1).max() < 1e-9


def test_internal_forces_have_no_net_wrench(fine):
    load = fine.signal("measured_load_state")
    rotations = Rotation.from_quat(load[:, [1, 2, 3, 0]]).as_matrix()
    forces = fine.signal("desired_cable_forces").reshape(len(load), -1, 3)
    # What is held since the last sample is what the forces were made from.
    held = fine.signal("held_measured_load_state")
    rotations = Rotation.from_quat(held[:, [1, 2, 3, 0]]).as_matrix()
    levers = np.array(fine.scenario.system.attachments) @ rotations.swapaxes(1, 2)
    wrench = np.hstack([np.cross(levers, forces).sum(1), forces.sum(1)])
    assert np.abs(wrench - fine.signal("wrench")).max() < 1e-12 * np.abs(forces).sum(1).max()
    assert np.ptp(forces, axis=0).max() > 1.0  # they do move


@pytest.mark.parametrize(("overrides", "tolerance"), [(CONSTANT, 1e-9), ([], 1e-6)])
def test_a_turned_and_moved_run_gives_the_turned_and_moved_result(overrides, tolerance):
    yaw, shift = 0.7, np.array([3.0, -2.0, 5.0])
    turn = Rotation.from_euler("z", yaw).as_matrix()
    scenario = load_scenario("quintic", ["simulation_duration=4", *overrides])
    trajectory = scenario.load_trajectory
    turned = dataclasses.replace(
        scenario,
        load_trajectory=dataclasses.replace(
            trajectory,
            start_position=shift.tolist(),
            start_roll_pitch_yaw=[0.0, 0.0, yaw],
            displacement=(turn @ trajectory.displacement).tolist(),
        ),
    )
    one, other = simulate(scenario), simulate(turned)
    load = one.signal("load_state")[:, 4:7] @ turn.T + shift
    np.testing.assert_allclose(other.signal("load_state")[:, 4:7], load, rtol=0, atol=tolerance)
    carriers = (run.signal("carrier_state")[:, :12].reshape(-1, 3) for run in (one, other))
    before, after = carriers
    np.testing.assert_allclose(after, before @ turn.T + shift, rtol=0, atol=tolerance)


def test_carriers_of_a_square_follow_each_other():
    """With phases a quarter of a turn apart each does what its neighbour did before."""
    scenario = load_scenario("quintic", ["simulation_duration=12.5", "pattern.phases=[]"])
    scenario.optimization_layer = ConstantParametersConfig(frequency=2 * np.pi / 3.2)
    scenario.load_trajectory = dataclasses.replace(
        scenario.load_trajectory, displacement=[0.0] * 3, roll_pitch_yaw=[0.0] * 3
    )
    run = simulate(scenario)
    positions = run.signal("carrier_state")[:, :12].reshape(-1, 4, 3)
    quarter = Rotation.from_euler("z", np.pi / 2).as_matrix()
    later = positions[880:1200]  # 0.8 s, a quarter of a turn, after the earlier ones
    earlier = positions[800:1120]
    for i in range(4):
        neighbour = earlier[:, (i + 1) % 4]
        errors = [np.abs(neighbour - moved[:, i] @ quarter.T).max() for moved in (later, earlier)]
        assert min(errors) < 1e-5
        assert max(errors) > 0.1


@pytest.mark.parametrize(
    ("hold", "largest"),
    [("velocity", 2e-5), ("second_order", 1e-4), ("third_order", 1e-4)],  # m, m/s, load, carriers
)
def test_the_integrator_converges_in_its_nominal_order(hold, largest):
    """Third order, once steps are short for the fastest mode; and the default step's error."""
    results = []
    steps = (0.005, 0.0025, 0.00125, 0.000625, 0.0003125)
    for step in steps:
        overrides = ["simulation_duration=2", f"simulator_config.max_step_size={step}", *CONSTANT]
        overrides += [f"carrier_trajectory.hold={hold}"]
        run = simulate(load_scenario("quintic", overrides))
        states = [run.signal("load_state")[-1, :7], run.signal("carrier_state")[-1]]
        results.append(np.concatenate(states))
    changes = [np.abs(a - b).max() for a, b in pairwise(results)]
    orders = np.log2(np.array(changes[:-1]) / changes[1:])
    assert np.all(np.diff(np.abs(orders - 3)) < 0)
    assert abs(orders[-1] - 3) < 0.3, orders
    assert np.abs(results[0] - results[-1]).max() < largest
    assert np.abs(results[0] - results[-1])[:19].max() < 2e-6  # m, of all
    assert np.abs(results[0][4:7] - results[-1][4:7]).max() < 1e-6  # m, of the load
