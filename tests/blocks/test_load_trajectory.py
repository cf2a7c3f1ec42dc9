import dataclasses
import itertools
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from helpers import difference, model, output, rotation
from pydrake.math import RollPitchYaw
from registries import LIVELY

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
from drake_nonstop.diagrams.nonstop import BOXES
from drake_nonstop.systems.documentation import own_config_class

START = {"start_position": [0.5, -1.0, 2.0], "start_roll_pitch_yaw": [0.2, -0.3, 0.4]}
REST_TO_REST = RestToRestConfig(
    **START,
    displacement=[1.0, -2.0, 0.5],
    roll_pitch_yaw=[0.3, 0.5, -0.4],
    start_time=1.0,
    move_time=4.0,
)


def move(blend_time, move_time=6.0):
    return ConstantVelocityMoveConfig(
        **START,
        velocity=[0.7, -0.2, 0.1],
        start_time=2.5,
        move_time=move_time,
        blend_time=blend_time,
    )


WAYPOINTS = WaypointsConfig(
    **START,
    positions=[[1.5, -1.0, 2.5], [1.5, 1.0, 2.5], [0.5, -1.0, 2.0]],
    roll_pitch_yaw=[[0.0, 0.0, 0.4], [0.1, -0.2, 1.4], [0.2, -0.3, 0.4]],
    move_times=[2.5, 4.0, 3.0],
    rest_times=[0.5, 0.0, 1.0],
)
STEADY_TURN = SteadyTurnConfig(
    **START, yaw_rate=-0.7, displacement=[1.0, -2.0, 0.5], start_time=1.0, move_time=9.0
)
SAMPLES = [  # the first pose is START
    [1.0, 0.5, -1.0, 2.0, 0.2, -0.3, 0.4],
    [2.5, 0.7, -0.8, 2.1, 0.2, -0.1, 0.5],
    [4.5, 0.9, -0.1, 2.3, 0.1, 0.1, 0.9],
    [6.0, 0.6, 0.3, 2.2, 0.0, 0.1, 1.3],
    [9.0, 0.5, 0.4, 2.0, 0.0, 0.0, 1.5],
]

SAMPLED = SampledTrajectoryConfig(samples=SAMPLES)
QUINTIC = {
    "rest to rest": (RestToRest, REST_TO_REST, [1, 5]),
    "blend 1": (ConstantVelocityMove, move(1.0), [2, 3, 8, 9]),
    "no cruise": (ConstantVelocityMove, move(4.0, 4.0), [0.5, 4.5, 8.5]),
    "waypoints": (Waypoints, WAYPOINTS, [0.5, 3, 7, 8, 11]),
    "steady turn": (SteadyTurn, STEADY_TURN, [1, 10]),
}
# All trajectories whose motion is known beforehand, with their own settings and with those above.
KNOWN = [
    (kind, own_config_class(kind)(**LIVELY.get(kind.__name__, {})))
    for kind in BOXES["load_trajectory"].variants
    if "planned" not in kind.reads
]
KNOWN += [(kind, config) for kind, config, _ in QUINTIC.values()] + [(SampledTrajectory, SAMPLED)]


def reference_of(block, config, name="reference"):
    """The function from time to `reference` (22,), or another signal, through the port."""
    block = block(model(), config)
    context = block.CreateDefaultContext()

    def reference(time):
        context.SetTime(time)
        return output(block, context, name)

    return reference


def check_rates(reference, time, higher_rates=None):
    """The derivatives at a time around which the polynomials do not change."""
    now = reference(time)
    R = rotation(now[:4])
    S = difference(lambda t: rotation(reference(t)[:4]), time) @ R.T
    rates = difference(reference, time)
    expected = {
        "ω": (now[7:10], [S[2, 1], S[0, 2], S[1, 0]]),
        "v": (now[10:13], rates[4:7]),
        "ω̇": (now[13:16], rates[7:10]),
        "a": (now[16:19], rates[10:13]),
        "jerk": (now[19:22], rates[16:19]),
    }
    if higher_rates is not None:
        expected["higher"] = higher_rates(time), np.concatenate([rates[13:16], rates[19:]])
    for name, (value, rate) in expected.items():
        # Rounding of 10 m over a step of 1 ms, and h⁴ times the fifth derivative.
        np.testing.assert_allclose(value, rate, rtol=0, atol=1e-8, err_msg=f"{name} at {time}")


@pytest.mark.parametrize(("block", "config"), KNOWN, ids=lambda each: type(each).__name__)
def test_a_motion_has_its_rates_as_differences_and_is_its_preview_to_the_bit(block, config):
    reference, made = reference_of(block, config), block(model(), config)
    higher = reference_of(block, config, "reference_higher_rates")
    times = 0.0611 + 0.15 * np.arange(80)  # s, in between all instants of the settings
    for time in times:
        check_rates(reference, time, higher)
    preview = made.GetOutputPort("reference_preview").Eval(made.CreateDefaultContext())
    times = np.sort([-1.0, 0.0, *times, 1e3])
    expected = np.array([reference(time) for time in times])
    np.testing.assert_array_equal(preview.at(times), expected)
    assert preview.end_time == np.inf
    with ThreadPoolExecutor(2) as threads:
        for result in threads.map(preview.at, [times, times[::-1]] * 10):
            assert np.array_equal(result, expected) or np.array_equal(result, expected[::-1])


SEPTIC = {
    name: (block, dataclasses.replace(config, blend="c4"), breaks)
    for name, (block, config, breaks) in QUINTIC.items()
}


@pytest.mark.parametrize(("block", "config", "breaks"), SEPTIC.values(), ids=SEPTIC.keys())
def test_with_c4_one_more_derivative_is_continuous_where_polynomials_meet(block, config, breaks):
    """The jerk, and its rate where velocities are blended, by one-sided limits."""
    smooth = reference_of(block, config)
    quintic = reference_of(block, dataclasses.replace(config, blend="c3"))
    step, is_velocity = 1e-5, block is ConstantVelocityMove

    def jump(reference, time):
        def rate(start):
            return (reference(start + step)[19:] - reference(start)[19:]) / step

        before, after = reference(time - 1e-7), reference(time + 1e-7)
        if not is_velocity:
            return np.max(np.abs(after - before))
        return np.max(np.abs(rate(time) - rate(time - step)))

    for time in breaks:
        assert jump(quintic, time) > 0.02, time
        assert jump(smooth, time) < 0.005, time
        if not is_velocity:
            np.testing.assert_allclose(smooth(time)[16:], 0, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", [name for name in QUINTIC if name != "steady turn"])
def test_load_rests_before_and_after(name):
    block, config, breaks = QUINTIC[name]
    reference = reference_of(block, config)
    first, last = reference(0.0), reference(100.0)
    np.testing.assert_allclose(first[4:7], START["start_position"], rtol=0, atol=1e-15)
    R = RollPitchYaw(START["start_roll_pitch_yaw"]).ToRotationMatrix().matrix()
    np.testing.assert_allclose(rotation(first[:4]), R, rtol=0, atol=1e-14)
    for time, pose in ((breaks[0] - 1e-6, first), (breaks[-1] + 1e-6, last)):
        np.testing.assert_allclose(reference(time)[:7], pose[:7], rtol=0, atol=1e-13)
        np.testing.assert_array_equal(reference(time)[7:], 0)


@pytest.mark.parametrize("blend_time", [0.0, 1.0, 4.0])
def test_move_covers_its_line_at_its_velocity(blend_time):
    reference = reference_of(ConstantVelocityMove, move(blend_time))
    velocity, start = np.array([0.7, -0.2, 0.1]), np.array(START["start_position"])
    np.testing.assert_allclose(reference(100.0)[4:7], start + 6 * velocity, rtol=0, atol=1e-12)
    for time in np.linspace(2.5 + blend_time / 2, 8.5 - blend_time / 2, 5)[1:-1]:
        now = reference(time)
        np.testing.assert_allclose(now[4:7], start + (time - 2.5) * velocity, rtol=0, atol=1e-12)
        np.testing.assert_allclose(now[10:13], velocity, rtol=0, atol=1e-12)
        np.testing.assert_allclose(now[13:], 0, rtol=0, atol=1e-12)


def check_pose(now, position, angles):
    R = RollPitchYaw(angles).ToRotationMatrix().matrix()
    np.testing.assert_allclose(now[4:7], position, rtol=0, atol=1e-12)
    np.testing.assert_allclose(rotation(now[:4]), R, rtol=0, atol=1e-12)


def test_waypoints_are_reached_and_rested_at():
    reference = reference_of(Waypoints, WAYPOINTS)
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
    reference = reference_of(SampledTrajectory, SampledTrajectoryConfig(samples=SAMPLES))
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
    resolved = config.resolved()
    assert resolved == SampledTrajectoryConfig(samples=rows)
    one, other = (reference_of(SampledTrajectory, c) for c in (config, resolved))
    for time in np.linspace(0, 10, 11):
        np.testing.assert_array_equal(one(time), other(time))


def test_steady_turn_is_the_rest_to_rest_move_of_a_load_that_turns_at_all_times():
    turning = reference_of(SteadyTurn, STEADY_TURN)
    plain = RestToRestConfig(
        **START, displacement=STEADY_TURN.displacement, start_time=1.0, move_time=9.0
    )
    moving = reference_of(RestToRest, plain)
    for time in (0.0, 0.5, 4.0, 11.0, 300.0):
        check_rates(turning, time)
        yaw = RollPitchYaw(0, 0, -0.7 * time).ToRotationMatrix().matrix()
        now, still = turning(time), moving(time)
        np.testing.assert_allclose(rotation(now[:4]), yaw @ rotation(still[:4]), rtol=0, atol=1e-13)
        np.testing.assert_allclose(now[7:10], [0, 0, -0.7], rtol=0, atol=1e-15)
        np.testing.assert_array_equal(now[13:16], 0)
        for part in (slice(4, 7), slice(10, 13), slice(16, 22)):
            np.testing.assert_array_equal(now[part], still[part])
