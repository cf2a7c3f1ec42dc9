import numpy as np
import pytest
from helpers import difference, model, output, rotation
from pydrake.math import RollPitchYaw

from drake_nonstop.blocks.load_trajectory import (
    ConstantVelocityMove,
    ConstantVelocityMoveConfig,
    RestToRest,
    RestToRestConfig,
)
from drake_nonstop.validation import ScenarioError

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


# config: (block, breaks between polynomials)
CASES = {
    "rest to rest": (RestToRest, REST_TO_REST, [1, 5]),
    "blend 0": (ConstantVelocityMove, move(0.0), [2.5, 8.5]),
    "blend 1": (ConstantVelocityMove, move(1.0), [2, 3, 8, 9]),
    "blend 4": (ConstantVelocityMove, move(4.0), [0.5, 4.5, 6.5, 10.5]),
    "no cruise": (ConstantVelocityMove, move(4.0, 4.0), [0.5, 4.5, 8.5]),
}


@pytest.fixture(params=CASES.values(), ids=CASES.keys())
def case(request):
    block, config, breaks = request.param
    return reference_of(block, config), breaks


def reference_of(block, config):
    """The function from time to `reference` (22,), through the port."""
    block = block(model(), config)
    context = block.CreateDefaultContext()

    def reference(time):
        context.SetTime(time)
        return output(block, context, "reference")

    return reference


def check_rates(reference, time):
    """The derivatives at a time around which the polynomials do not change."""
    now = reference(time)
    R = rotation(now[:4])
    S = difference(lambda t: rotation(reference(t)[:4]), time) @ R.T
    expected = {
        "ω": (now[7:10], [S[2, 1], S[0, 2], S[1, 0]]),
        "v": (now[10:13], difference(lambda t: reference(t)[4:7], time)),
        "ω̇": (now[13:16], difference(lambda t: reference(t)[7:10], time)),
        "a": (now[16:19], difference(lambda t: reference(t)[10:13], time)),
        "jerk": (now[19:22], difference(lambda t: reference(t)[16:19], time)),
    }
    for name, (value, rate) in expected.items():
        # Rounding of 10 m over a step of 1 ms, and h⁴ times the fifth derivative.
        np.testing.assert_allclose(value, rate, rtol=0, atol=1e-9, err_msg=f"{name} at {time}")


def test_each_rate_is_the_difference_of_what_it_is_the_rate_of(case):
    reference, breaks = case
    times = [t for t in np.linspace(0.05, 12, 120) if np.min(np.abs(t - np.array(breaks))) > 0.005]
    assert len(times) > 110
    for time in times:
        check_rates(reference, time)


def test_quaternion_has_unit_norm(case):
    reference, _ = case
    for time in np.linspace(0, 12, 25):
        assert np.linalg.norm(reference(time)[:4]) == pytest.approx(1, abs=1e-14)


def test_load_rests_before_and_after(case):
    reference, breaks = case
    first, last = reference(0.0), reference(100.0)
    np.testing.assert_allclose(first[4:7], START["start_position"], rtol=0, atol=1e-15)
    R = RollPitchYaw(START["start_roll_pitch_yaw"]).ToRotationMatrix().matrix()
    np.testing.assert_allclose(rotation(first[:4]), R, rtol=0, atol=1e-14)
    for time, pose in ((breaks[0] - 1e-6, first), (breaks[-1] + 1e-6, last)):
        np.testing.assert_allclose(reference(time)[:7], pose[:7], rtol=0, atol=1e-13)
        np.testing.assert_array_equal(reference(time)[7:], 0)


def test_rest_to_rest_reaches_its_end_halfway_at_half_time():
    reference = reference_of(RestToRest, REST_TO_REST)
    for time, share in ((1.0, 0.0), (3.0, 0.5), (5.0, 1.0)):
        now = reference(time)
        position = np.array(START["start_position"]) + share * np.array(REST_TO_REST.displacement)
        angles = np.array(START["start_roll_pitch_yaw"]) + share * np.array(
            REST_TO_REST.roll_pitch_yaw
        )
        R = RollPitchYaw(angles).ToRotationMatrix().matrix()
        np.testing.assert_allclose(now[4:7], position, rtol=0, atol=1e-13)
        np.testing.assert_allclose(rotation(now[:4]), R, rtol=0, atol=1e-13)
    # The quintic's largest velocity is 15/8 of the mean one.
    np.testing.assert_allclose(
        reference(3.0)[10:13], 15 / 8 * np.array([1.0, -2.0, 0.5]) / 4, rtol=1e-12
    )


def test_rest_to_rest_starts_and_ends_without_velocity_and_acceleration():
    reference = reference_of(RestToRest, REST_TO_REST)
    for time in (1.0, 5.0):
        np.testing.assert_allclose(reference(time)[7:19], 0, rtol=0, atol=1e-13)


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


@pytest.mark.parametrize("blend_time", [1.0, 4.0])
def test_blended_move_has_a_continuous_jerk(blend_time):
    _, config, breaks = CASES[f"blend {blend_time:.0f}"]
    reference = reference_of(ConstantVelocityMove, config)
    for time in breaks:
        jump = reference(time + 1e-7) - reference(time - 1e-7)
        # Over 2e-7 s the jerk changes by 60 v / blend³ times that, at most 9e-6.
        np.testing.assert_allclose(jump, 0, rtol=0, atol=1e-5)
    largest = max(np.max(np.abs(reference(t)[19:])) for t in np.linspace(0, 12, 241))
    assert largest > 0.01


def test_unblended_move_steps_in_velocity_and_nothing_else():
    reference = reference_of(ConstantVelocityMove, move(0.0))
    for time, step in ((2.5, 1.0), (8.5, -1.0)):
        jump = reference(time + 1e-9) - reference(time - 1e-9)
        np.testing.assert_allclose(jump[10:13], step * np.array([0.7, -0.2, 0.1]), atol=1e-12)
        jump[10:13] = 0
        np.testing.assert_allclose(jump, 0, rtol=0, atol=1e-8)


@pytest.mark.parametrize(
    ("config", "field"),
    [
        (RestToRestConfig(move_time=0.0), "move_time = 0.0"),
        (RestToRestConfig(move_time=np.nan), "move_time = nan"),
        (RestToRestConfig(start_time=-1.0), "start_time = -1.0"),
        (RestToRestConfig(displacement=[1.0, 2.0]), r"displacement = \[1.0, 2.0\]"),
        (RestToRestConfig(displacement=[1.0, 2.0, np.inf]), "displacement"),
        (RestToRestConfig(roll_pitch_yaw=[0.1]), r"roll_pitch_yaw = \[0.1\]"),
        (RestToRestConfig(start_position=[1.0]), r"start_position = \[1.0\]"),
        (RestToRestConfig(start_roll_pitch_yaw=[[1.0, 2, 3]]), "start_roll_pitch_yaw"),
        (ConstantVelocityMoveConfig(move_time=-2.0), "move_time = -2.0"),
        (ConstantVelocityMoveConfig(velocity=[1.0]), r"velocity = \[1.0\]"),
        (ConstantVelocityMoveConfig(blend_time=-0.1), "blend_time = -0.1"),
        (ConstantVelocityMoveConfig(start_time=0.4, blend_time=1.0), "blend_time = 1.0"),
        (ConstantVelocityMoveConfig(move_time=0.9, blend_time=1.0), "blend_time = 1.0"),
        (ConstantVelocityMoveConfig(start_time=np.inf), "start_time = inf"),
    ],
    ids=str,
)
def test_bad_parameter_is_named(config, field):
    block = RestToRest if isinstance(config, RestToRestConfig) else ConstantVelocityMove
    with pytest.raises(ScenarioError, match=f"load_trajectory.{field}.*: give"):
        block(model(), config)
