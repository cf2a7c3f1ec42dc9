"""The carrier trajectories, on the desired and on the measured pose."""

import itertools

import numpy as np
import pytest
from helpers import INERTIA, Motion, difference, fix, model, output
from pydrake.polynomial import Polynomial
from pydrake.trajectories import PiecewisePolynomial
from scipy.spatial.transform import Rotation

from drake_nonstop import (
    CompiledLoop,
    ConstantParametersConfig,
    LoadTrajectory,
    Scenario,
    SystemParameters,
    load_scenario,
    make_nonstop,
    simulate,
)
from drake_nonstop.blocks.carrier_trajectory import CarrierTrajectory, CarrierTrajectoryConfig
from drake_nonstop.blocks.load_feedback import DesiredStateFeedback
from drake_nonstop.blocks.load_trajectory import (
    ConstantVelocityMoveConfig,
    RestToRestConfig,
    SteadyTurnConfig,
)
from drake_nonstop.model.pattern import ConstantSpreadConfig, EllipticCarouselConfig

RATES = np.array([0.1, 0.3, 0.2, 0.4])  # of level position, height, tilt and yaw


def carried(rates, pose, forces, state=()):
    """What a block with these rates makes, with the state's rate."""
    block = CarrierTrajectory(model(), CarrierTrajectoryConfig(correction_rates=list(rates)))
    context = block.CreateDefaultContext()
    if len(state):
        context.SetContinuousState(state)
    rates_of_forces = {"desired_cable_force_rates": np.zeros(12)}
    fix(block, context, **pose, desired_cable_forces=forces.ravel(), **rates_of_forces)
    rate = block.EvalTimeDerivatives(context).CopyToVector() if len(state) else None
    return output(block, context, "carrier_reference"), rate


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.3), (0.2, -0.1, 0.0)], ids=["yaw", "tilt"])
def test_references_are_moved_and_turned_against_the_measured_error(turn):
    """As if the load's reference were moved and turned, or its cables' ends tilted."""
    shift, seen = np.array([0.02, 0.0, -0.04]), Motion(3).state(0.3)
    reference = Motion(4).reference(0.3)
    reference[7:10], forces = 0.0, np.tile([0.3, -0.2, 2.5], (4, 1))
    forces[:, :2] += np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
    still = np.concatenate([reference[:4], reference[4:7], reference[7:13]])  # no error
    pose = {"measured_load_state": still, "reference": reference}
    half = np.array([1.0, *np.divide(turn, 2)])  # the rotation vector is that of Rodrigues
    turned = Rotation.from_quat(half[[1, 2, 3, 0]])
    found, _ = carried(RATES, pose, forces, [*np.zeros(6), *turn, *shift])
    moved, expected_forces = reference.copy(), forces
    moved[4:7] += shift
    if turn[2]:
        attitude = turned * Rotation.from_quat(reference[[1, 2, 3, 0]])
        moved[:4] = attitude.as_quat()[[3, 0, 1, 2]]
        expected_forces = turned.apply(forces)
        expected_forces += (forces - expected_forces).mean(axis=0)
    expected, _ = carried(np.zeros(4), {"reference": moved}, expected_forces)
    tilted = np.zeros((4, 3))
    if not turn[2]:
        levers = model().attachments
        tilted = Rotation.from_quat(reference[[1, 2, 3, 0]]).apply(turned.apply(levers) - levers)
    np.testing.assert_allclose(found[:12], expected[:12] + tilted.ravel(), rtol=1e-12, atol=1e-12)
    state = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, *np.zeros(6)]
    _, rate = carried(RATES, pose | {"measured_load_state": seen}, forces, state)
    own, desired = (Rotation.from_quat(each[[1, 2, 3, 0]]) for each in (seen, reference))
    turned = (desired.inv() * own).as_rotvec()
    angle = np.linalg.norm(turned)
    error = np.concatenate([np.sin(angle) * turned / angle, seen[4:7] - reference[4:7]])
    np.testing.assert_allclose(
        rate[:6], (error - state[:6]) / CarrierTrajectoryConfig.correction_time
    )
    np.testing.assert_allclose(rate[6:], -RATES[[2, 2, 3, 0, 0, 1]] * state[:6])


DERIVATIVES = ("carrier_reference_acceleration", "carrier_reference_jerk")


def loop_on_its_reference(**boxes):
    """The carriers' reference and its derivatives at a time, at ξ = 2 rad/s, on its reference."""
    fields = {name: boxes.pop(name) for name in ("pattern", "system") if name in boxes}
    scenario = Scenario(control_period=0.0, **fields)
    amplitude = 0.0 if isinstance(scenario.pattern, ConstantSpreadConfig) else 1.2
    layer = ConstantParametersConfig(frequency=2.0, amplitude=amplitude)
    ends = {"load_feedback": DesiredStateFeedback, "optimization_layer": layer}
    diagram = make_nonstop(scenario, **ends, **boxes)
    context = diagram.CreateDefaultContext()
    phase = diagram.GetSubsystemByName("phase").GetMyMutableContextFromRoot(context)

    def at(time):
        """Positions, velocities, accelerations and jerks (3n,) each."""
        context.SetTime(time)
        phase.SetContinuousState([2.0 * time, *np.zeros(7)])  # ξ and A have not started to change
        motion, *others = (output(diagram, context, n) for n in ("carrier_reference", *DERIVATIVES))
        return [*np.split(motion, 2), *others]

    return at


def path_of(rows):
    """A block of the motion whose coordinates are these polynomials from t = 0 on."""
    polynomials = np.array([[Polynomial(row)] for row in np.array(rows, dtype=float)])
    path = PiecewisePolynomial([polynomials], [0.0, 3.0])
    return lambda model: LoadTrajectory(path)


SIZES = {"radial": 0.6, "tangential": 0.9, "vertical": 0.7}
ELLIPSES = EllipticCarouselConfig(spread=1.5, phase_turns=2, **SIZES)
TURN = SteadyTurnConfig(yaw_rate=1.3, start_roll_pitch_yaw=[0.2, -0.1, 0.4])
STEADY_JERK = path_of([[0, 0, 0, 0]] * 3 + [[0, 0, 0, jerk / 6] for jerk in (0.3, -0.5, 0.2)])
SEPTIC = RestToRestConfig(displacement=[1.0, -1.0, 0.5], move_time=4.0, blend="c4")


@pytest.mark.parametrize(
    ("boxes", "count", "times"),
    [
        ({"pattern": ELLIPSES, "load_trajectory": STEADY_JERK}, 3, (0.3, 1.1)),
        ({"pattern": ELLIPSES, "load_trajectory": TURN}, 3, (0.3, 1.1)),
        ({"pattern": ConstantSpreadConfig(spread=2.0), "load_trajectory": TURN}, 3, (0.3, 1.1)),
        # Accelerations have the snap of the reference in them, jerks do not.
        ({"load_trajectory": ConstantVelocityMoveConfig(start_time=1.0)}, 2, (0.8, 1.2, 5.0)),
        ({"load_trajectory": SEPTIC}, 2, (0.8, 1.2, 5.0)),
    ],
    ids=["ellipses", "ellipses on a turning load", "turning load", "line", "septic"],
)
def test_derivatives_are_differences_of_those_below(boxes, count, times):
    system = SystemParameters(load_inertia=INERTIA.tolist(), load_angular_drag=0.1)
    at = loop_on_its_reference(system=system, **boxes)
    for time in times:
        expected = difference(lambda t: at(t)[:count], time)
        np.testing.assert_allclose(at(time)[1 : count + 1], expected, rtol=0, atol=1e-8)


def test_between_samples_accelerations_are_the_rates_of_velocities():
    changes = ["optimization_layer=ConstantParameters", "control_period=0.05"]
    run = simulate(load_scenario("quintic", [*changes, "simulation_duration=0.2"]))
    velocity = np.split(run.signal("carrier_reference"), 2, axis=1)[1]
    for k in (2, 3, 7, 8, 12, 13):  # exact, at a constant jerk
        mean = (velocity[k + 1] - velocity[k - 1]) / 0.02
        acceleration = run.signal("carrier_reference_acceleration")[k]
        np.testing.assert_allclose(acceleration, mean, atol=1e-9)


# With a constant angular jerk, about the vertical, and a constant snap.
FASTER = [[0.0] * 5] * 2 + [
    [0.3, 0.25, 0.1, 0.06, 0.0],
    [0.0, 0.2, -0.1, 0.05, 0.02],
    [0.1, -0.1, 0.05, 0.04, -0.015],
    [1.0, 0.1, 0.02, -0.03, 0.01],
]


@pytest.mark.slow
@pytest.mark.parametrize("changes", [[], ["optimization_layer=ConstantParameters"]])
def test_flown_references_have_the_differences_of_those_below_as_rates(changes):
    """Of sixth order, before the first replan; on a load that turns faster and faster."""
    scenario = load_scenario("quintic", ["load_feedback=DesiredStateFeedback", *changes])
    diagram = make_nonstop(scenario, load_trajectory=path_of(FASTER))
    loop = CompiledLoop(diagram, scenario.simulator_config, 0.01, compiles=False)
    _, rows = loop.run(diagram.CreateDefaultContext(), 0.35)
    motion = rows["sampled_carrier_reference"][1:]
    found = *np.split(motion, 2, axis=1), rows["sampled_carrier_reference_acceleration"][1:]
    weights = np.array([-1.0, 9, -45, 0, 45, -9, 1]) / 60
    for below, rate in itertools.pairwise((*found, rows["carrier_reference_jerk"][1:])):
        windows = np.lib.stride_tricks.sliding_window_view(below, 7, axis=0)
        expected = windows @ weights / 0.01
        np.testing.assert_allclose(rate[3:-3], expected, rtol=0, atol=1e-6 * np.max(np.abs(rate)))
