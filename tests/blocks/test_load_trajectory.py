"""The load's trajectories: their rates as differences, and where each of them leads."""

import dataclasses
import itertools

import numpy as np
import pytest
from helpers import model, output, rates_by_differences, rotation
from pydrake.math import BsplineBasis, RollPitchYaw
from pydrake.trajectories import (
    BezierCurve,
    BsplineTrajectory,
    CompositeTrajectory,
    FunctionHandleTrajectory,
    PiecewisePolynomial,
)
from registries import CASES, made

from drake_nonstop import LoadTrajectory, ScenarioError
from drake_nonstop.blocks.load_trajectory import (
    ConstantVelocityMove,
    ConstantVelocityMoveConfig,
    RestToRest,
    RestToRestConfig,
    SampledTrajectory,
    SampledTrajectoryConfig,
    SteadyTurn,
    SteadyTurnConfig,
    Waypoints,
    WaypointsConfig,
)
from drake_nonstop.mechanics.signals import LoadReference

START = {"start_position": [0.5, -1.0, 2.0], "start_roll_pitch_yaw": [0.2, -0.3, 0.4]}
ON = START | {"displacement": [1.0, -2.0, 0.5], "start_time": 1.0}


def move(blend_time, move_time=6.0):
    own = {"velocity": [0.7, -0.2, 0.1], "start_time": 2.5, "blend_time": blend_time}
    return ConstantVelocityMoveConfig(**START, **own, move_time=move_time)


WAYPOINTS = WaypointsConfig(
    **START,
    positions=[[1.5, -1.0, 2.5], [1.5, 1.0, 2.5], [0.5, -1.0, 2.0]],
    roll_pitch_yaw=[[0.0, 0.0, 0.4], [0.1, -0.2, 1.4], [0.2, -0.3, 0.4]],
    move_times=[2.5, 4.0, 3.0],
    rest_times=[0.5, 0.0, 1.0],
)
TURN = SteadyTurnConfig(**ON, yaw_rate=-0.7, move_time=9.0)
SAMPLES = [  # the first pose is START
    [1.0, 0.5, -1.0, 2.0, 0.2, -0.3, 0.4],
    [2.5, 0.7, -0.8, 2.1, 0.2, -0.1, 0.5],
    [4.5, 0.9, -0.1, 2.3, 0.1, 0.1, 0.9],
    [6.0, 0.6, 0.3, 2.2, 0.0, 0.1, 1.3],
    [9.0, 0.5, 0.4, 2.0, 0.0, 0.0, 1.5],
]
SAMPLED = SampledTrajectoryConfig(samples=SAMPLES)
TURNED = RestToRestConfig(**ON, roll_pitch_yaw=[0.3, 0.5, -0.4], move_time=4.0)
QUINTIC = {  # and where polynomials meet
    "rest to rest": (RestToRest, TURNED, [1, 5]),
    "blend 1": (ConstantVelocityMove, move(1.0), [2, 3, 8, 9]),
    "no cruise": (ConstantVelocityMove, move(4.0, 4.0), [0.5, 4.5, 8.5]),
    "waypoints": (Waypoints, WAYPOINTS, [0.5, 3, 7, 8, 11]),
    "steady turn": (SteadyTurn, TURN, [1, 10]),
}
# All whose motion is known beforehand, and others with the settings above.
KNOWN = {
    case.name: made(case)[0]
    for case in CASES
    if case.box == "load_trajectory" and "planned" not in case.kind.reads
}
KNOWN |= {name: kind(model(), config) for name, (kind, config, _) in QUINTIC.items()}
KNOWN["samples"] = SampledTrajectory(model(), SAMPLED)


def reference_of(block, name="reference"):
    """The function from time to `reference` (22,), or another signal, through the port."""
    context = block.CreateDefaultContext()

    def reference(time):
        context.SetTime(time)
        return output(block, context, name)

    return reference


@pytest.mark.parametrize("name", KNOWN)
def test_a_motion_has_its_rates_as_differences_and_is_its_preview_to_the_bit(name):
    reference, higher = (reference_of(KNOWN[name], f"reference{e}") for e in ("", "_higher_rates"))
    times = 0.0611 + 0.15 * np.arange(80)  # s, in between all instants of the settings
    for time in times:
        found = [*reference(time)[7:], *higher(time)]
        # Rounding of 10 m over a step of 1 ms, and h⁴ times the fifth derivative.
        expected = rates_by_differences(reference, time)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8, err_msg=f"{time}")
    port = KNOWN[name].GetOutputPort("reference_preview")
    preview = port.Eval(KNOWN[name].CreateDefaultContext())
    times = np.sort([-1.0, 0.0, *times, 1e3])
    expected = np.array([reference(time) for time in times])
    np.testing.assert_array_equal(preview.at(times), expected)
    assert preview.end_time == np.inf


@pytest.mark.parametrize(("kind", "config", "breaks"), QUINTIC.values(), ids=QUINTIC)
def test_with_c4_one_more_derivative_is_continuous_where_polynomials_meet(kind, config, breaks):
    """The jerk, and its rate where velocities are blended, by one-sided limits."""
    smooth, quintic = (
        reference_of(kind(model(), dataclasses.replace(config, blend=blend)))
        for blend in ("c4", "c3")
    )
    step, is_velocity = 1e-5, kind is ConstantVelocityMove

    def jump(reference, time):
        def rate(start):
            return (reference(start + step)[19:] - reference(start)[19:]) / step

        before, after = reference(time - 1e-7)[19:], reference(time + 1e-7)[19:]
        change = rate(time) - rate(time - step) if is_velocity else after - before
        return np.max(np.abs(change))

    for time in breaks:
        assert jump(quintic, time) > 0.02, time
        assert jump(smooth, time) < 0.005, time
        if not is_velocity:
            np.testing.assert_allclose(smooth(time)[16:], 0, rtol=0, atol=1e-9)


def check_pose(now, position, angles):
    R = RollPitchYaw(angles).ToRotationMatrix().matrix()
    np.testing.assert_allclose(now[4:7], position, rtol=0, atol=1e-12)
    np.testing.assert_allclose(rotation(now[:4]), R, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", [name for name in QUINTIC if name != "steady turn"])
def test_load_rests_before_and_after(name):
    reference, breaks = reference_of(KNOWN[name]), QUINTIC[name][2]
    check_pose(reference(0.0), *START.values())
    for time, pose in ((breaks[0] - 1e-6, 0.0), (breaks[-1] + 1e-6, 100.0)):
        expected = np.append(reference(pose)[:7], np.zeros(15))
        np.testing.assert_allclose(reference(time), expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize("blend_time", [0.0, 1.0, 4.0])
def test_move_covers_its_line_at_its_velocity(blend_time):
    reference = reference_of(ConstantVelocityMove(model(), move(blend_time)))
    velocity, start = np.array([0.7, -0.2, 0.1]), np.array(START["start_position"])
    np.testing.assert_allclose(reference(100.0)[4:7], start + 6 * velocity, rtol=0, atol=1e-12)
    for time in np.linspace(2.5 + blend_time / 2, 8.5 - blend_time / 2, 5)[1:-1]:
        now, place = reference(time), start + (time - 2.5) * velocity
        expected = [*place, 0, 0, 0, *velocity, *np.zeros(9)]
        np.testing.assert_allclose(now[4:], expected, rtol=0, atol=1e-12)


def test_waypoints_are_reached_and_rested_at():
    reference = reference_of(KNOWN["waypoints"])
    at = [(0.0, 0.5), (3.0, 3.0), (7.0, 8.0), (11.0, 50.0)]  # from when to when
    positions = [START["start_position"], *WAYPOINTS.positions]
    angles = [START["start_roll_pitch_yaw"], *WAYPOINTS.roll_pitch_yaw]
    for (first, last), position, angle in zip(at, positions, angles, strict=True):
        for time in np.linspace(first, last, 5):
            check_pose(reference(time), position, angle)
            np.testing.assert_allclose(reference(time)[7:19], 0, rtol=0, atol=1e-11)
    for before, after in itertools.pairwise(range(4)):  # halfway at half time
        half = (at[before][1] + at[after][0]) / 2
        middle = (np.array(positions[before]) + positions[after]) / 2
        np.testing.assert_allclose(reference(half)[4:7], middle, rtol=0, atol=1e-12)
        assert np.linalg.norm(reference(half)[10:13]) > 0.5


def test_samples_are_passed_by_a_curve_that_begins_and_ends_without_velocity():
    reference = reference_of(KNOWN["samples"])
    for row in SAMPLES:
        check_pose(reference(row[0]), row[1:4], row[4:])
    for time in (1.0, 9.0):
        np.testing.assert_allclose(reference(time)[7:13], 0, rtol=0, atol=1e-13)
    for row in SAMPLES[1:-1]:
        jump = reference(row[0] + 1e-9) - reference(row[0] - 1e-9)
        np.testing.assert_allclose(jump[:19], 0, rtol=0, atol=1e-8)  # all but the jerk
        assert np.linalg.norm(jump[19:]) > 0.01
    for (before, *_), (after, *_) in itertools.pairwise(SAMPLES):  # cubic: a constant jerk
        quarter, half = (reference(before + share * (after - before)) for share in (0.25, 0.5))
        np.testing.assert_allclose(quarter[19:], half[19:], rtol=0, atol=1e-12)


@pytest.mark.parametrize("columns", [4, 7])
def test_samples_from_a_file_are_those_in_it(tmp_path, columns):
    names = ["t", "x", "y", "z", "roll", "pitch", "yaw"][:columns]
    rows = [row[:columns] for row in SAMPLES]
    lines = [", ".join(names), *[",".join(map(repr, row)) for row in rows]]
    path = tmp_path / "way.csv"
    path.write_text("\ufeff" + "\r\n".join([*lines[:3], "", *lines[3:], ""]), encoding="utf-8")
    config = SampledTrajectoryConfig(file=str(path))
    assert config.resolved() == SampledTrajectoryConfig(samples=rows)
    one, other = (SampledTrajectory(model(), c) for c in (config, config.resolved()))
    for time in np.linspace(0, 10, 11):
        np.testing.assert_array_equal(reference_of(one)(time), reference_of(other)(time))


def test_steady_turn_is_the_rest_to_rest_move_of_a_load_that_turns_at_all_times():
    turning = reference_of(KNOWN["steady turn"])
    moving = reference_of(RestToRest(model(), RestToRestConfig(**ON, move_time=9.0)))
    for time in (0.0, 0.5, 4.0, 11.0, 300.0):
        yaw = RollPitchYaw(0, 0, -0.7 * time).ToRotationMatrix().matrix()
        now, still = turning(time), moving(time)
        np.testing.assert_allclose(rotation(now[:4]), yaw @ rotation(still[:4]), rtol=0, atol=1e-13)
        expected = [*still[4:7], 0, 0, -0.7, *still[10:13], 0, 0, 0, *still[16:]]
        np.testing.assert_allclose(now[4:], expected, rtol=0, atol=1e-15)


POSES = np.random.default_rng(58).normal(size=(6, 8))
DRAKES = {
    "polynomial": PiecewisePolynomial.CubicShapePreserving(np.linspace(1, 4, 8), POSES, True),
    "spline": BsplineTrajectory(BsplineBasis(6, 8), [*POSES.T[..., None]]),
    "curves": CompositeTrajectory([BezierCurve(1, 4, POSES), BezierCurve(4, 5, POSES[:, -1:])]),
}


@pytest.mark.parametrize("curve", DRAKES.values(), ids=DRAKES)
def test_a_load_follows_any_trajectory_of_drakes_and_rests_beyond_its_ends(curve):
    block, span = LoadTrajectory(curve), (curve.start_time(), curve.end_time())
    for time in (span[0] - 1, *np.linspace(*span, 7)[1:-1], span[1] + 1):
        context = block.CreateDefaultContext()
        context.SetTime(time)
        shown = LoadReference.view(output(block, context, "reference"))
        at = np.clip(time, *span)
        pose = curve.value(at)[:, 0]
        np.testing.assert_allclose(shown.position, pose[3:], atol=1e-12)
        np.testing.assert_allclose(
            rotation(shown.quaternion),
            RollPitchYaw(pose[:3]).ToRotationMatrix().matrix(),
            atol=1e-12,
        )
        for order, rate in enumerate((shown.velocity, shown.acceleration, shown.jerk), 1):
            expected = curve.EvalDerivative(at, order)[3:, 0] * (at == time)
            np.testing.assert_allclose(rate, expected, atol=1e-9 * (1 + np.abs(expected).max()))


@pytest.mark.parametrize(
    "curve",
    [
        "a circle",
        PiecewisePolynomial(np.zeros((3, 1))),
        PiecewisePolynomial(np.zeros((6, 6))),
        FunctionHandleTrajectory(lambda time: np.zeros((6, 1)), 6, 1, 0, 1),
    ],
)
def test_what_is_no_trajectory_of_poses_is_refused_and_ends_no_process(curve):
    with pytest.raises(
        ScenarioError, match=r"^load_trajectory\.trajectory = .*: give a Trajectory"
    ):
        LoadTrajectory(curve)
