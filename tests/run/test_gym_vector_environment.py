"""Environments side by side: each as it is alone, by the rules of Gymnasium's vector API."""

import numpy as np
import pytest
from helpers import nightly_beyond

from drake_nonstop import (
    ScenarioError,
    ScenarioWarning,
    load_scenario,
    make_gym_env,
    make_gym_vec_env,
)

pytest.importorskip("gymnasium")
BRIEF = ["simulation_duration=0.3"]
HOLD, PUSH = [0.0, 0.0, 0.0, 0.0, 0.0, 9.81], [0.0, 0.0, 0.0, 9.8, 9.8, 0.0]


@pytest.fixture(scope="module")
def three():
    return make_gym_vec_env(load_scenario("quintic", BRIEF), 3)


def drawn_actions(env, n, rng):
    space = env.single_action_space
    share = rng.uniform(0.4, 0.6, (n, *space.shape))
    return space.low + share * (space.high - space.low)


@pytest.mark.parametrize(
    ("scenario", "action", "step", "duration"),
    nightly_beyond(
        2,
        "engines",
        [
            ("quintic", "parameters", 0.1, 0.3),
            ("quintic", "parameters", 0.025, 0.1),
            ("three_carriers", "wrench", 0.1, 0.3),
            ("aircraft_transfer", "parameters", 0.2, 1.0),
            ("aircraft_rest_cables", "parameters", 0.1, 0.3),
            ("quintic", "parameters", 0.01, 0.05),
        ],
    ),
)
def test_episodes_are_those_of_single_environments(scenario, action, step, duration, rng):
    flown = load_scenario(scenario, [f"simulation_duration={duration}"])
    env, alone = (make_gym_vec_env(flown, n, action=action, time_step=step) for n in (5, 1))
    single = make_gym_env(flown, action=action, time_step=step)
    (first, _), (same, _), (begin, _) = env.reset(), alone.reset(), single.reset()
    np.testing.assert_allclose(first, np.tile(begin, (5, 1)), rtol=0, atol=1e-9)
    np.testing.assert_array_equal(first[3:4], same)
    ends = 0
    for _ in range(round(duration / step) + 2):  # into the next episode
        actions = drawn_actions(env, 5, rng)
        shown = env.step(actions)
        by_itself = alone.step(actions[3:4])
        expected, *judged, _ = single.step(actions[3])
        for values, own in zip(shown[:4], by_itself[:4], strict=True):
            np.testing.assert_array_equal(values[3:4], own)
        np.testing.assert_allclose([values[3] for values in shown[1:4]], judged, rtol=0, atol=1e-9)
        last = shown[0][3]
        if judged[2]:
            ends += 1
            last = shown[4]["final_obs"][3]
            np.testing.assert_array_equal(shown[0], first)
            single.reset()
        np.testing.assert_allclose(last, expected, rtol=0, atol=1e-9)
    assert ends == 1


def test_a_divergence_ends_its_own_episode_alone():
    env = make_gym_vec_env(load_scenario("quintic"), 3, action="wrench")
    first, _ = env.reset()
    observations = first
    quiet = make_gym_vec_env(load_scenario("quintic"), 1, action="wrench")
    quiet.reset()
    for _ in range(50):
        before = observations[1]
        observations, rewards, terminated, truncated, infos = env.step([HOLD, PUSH, HOLD])
        np.testing.assert_array_equal(observations[[0, 2]], np.tile(quiet.step([HOLD])[0], (2, 1)))
        if terminated.any():
            break
    assert terminated.tolist() == [False, True, False]
    assert not truncated.any()
    assert rewards[1] == -1000
    assert min(rewards[0], rewards[2]) > -1
    np.testing.assert_array_equal(infos["final_obs"][1], before)
    assert infos["_final_obs"].tolist() == [False, True, False]
    assert "not finite" in infos["final_info"]["message"][1]
    np.testing.assert_array_equal(observations[1], first[1])
    assert not env.step([HOLD, HOLD, HOLD])[2].any()


def test_it_is_a_vector_environment(three):
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.wrappers.vector import RecordEpisodeStatistics

    assert isinstance(three, VectorEnv)
    assert three.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    counted = RecordEpisodeStatistics(three)
    observations, infos = counted.reset(seed=1)
    assert infos == {}
    lengths = []
    for _ in range(7):
        assert three.observation_space.contains(observations)
        actions = three.action_space.sample().astype(np.float32)
        observations, *judged, infos = counted.step(actions)
        assert [values.dtype for values in judged] == [float, bool, bool]
        assert {values.shape for values in judged} == {(3,)}
        lengths += infos["episode"]["l"].tolist() if "episode" in infos else []
    assert lengths == [3] * 6
    three.close()
    three.close()


def test_an_episode_may_begin_anew_in_the_next_step():
    from gymnasium.wrappers.vector import NormalizeObservation

    scenario = load_scenario("quintic", BRIEF)
    env = make_gym_vec_env(scenario, 3, autoreset_mode="NextStep")
    first, _ = env.reset()
    NormalizeObservation(env)  # which asks for it
    low, ends = env.action_space.low, []
    for _ in range(5):
        observations, rewards, terminated, truncated, infos = env.step(low)
        assert infos == {}
        assert not terminated.any()
        ends.append(truncated.tolist())
        if len(ends) == 4:
            np.testing.assert_array_equal(observations, first)
            np.testing.assert_array_equal(rewards, 0.0)
        else:
            assert np.any(observations != first)
            assert (rewards < 0).all()
    assert ends == [[False] * 3] * 2 + [[True] * 3] + [[False] * 3] * 2


@pytest.mark.parametrize(
    ("n", "arguments", "said"),
    [
        (0, {}, "n = 0: give a whole number"),
        (2, {"action": "thrust"}, "action = thrust"),
        (2, {"autoreset_mode": "Disabled"}, "autoreset_mode = Disabled"),
        (2, {"time_step": 0.005}, "time_step = 0.005: give at least control_period = 0.01 s"),
    ],
)
def test_what_cannot_be_used_is_refused(n, arguments, said):
    with pytest.raises(ScenarioError, match=said):
        make_gym_vec_env(load_scenario("quintic"), n, **arguments)


def test_a_loop_that_is_not_compiled_flies_by_its_diagram_as_the_other_is_compiled():
    scenario, compiled = (
        load_scenario("quintic", ["simulation_duration=0.2", *own])
        for own in (["load_plant=MultibodyLoadPlant"], [])
    )
    with pytest.warns(ScenarioWarning, match="load_plant = MultibodyLoadPlant.*; the 2 environm"):
        envs = make_gym_vec_env(scenario, 2)
    single, other = make_gym_env(scenario), make_gym_env(compiled)
    action = np.array([2.0, 1.3])
    for each in (single, envs, other):
        each.reset(seed=3)
    for _ in range(2):
        observation, *judged, _ = single.step(action)
        _, rewards, _, truncated, infos = envs.step(np.stack([action, action]))
        expected = other.step(action)[:4]
        np.testing.assert_allclose(observation, expected[0], rtol=0, atol=1e-6)
        np.testing.assert_allclose(judged, expected[1:], rtol=0, atol=1e-6)
        np.testing.assert_allclose(rewards, judged[0], rtol=0, atol=1e-12)
    assert truncated.all()
    np.testing.assert_array_equal(np.stack(infos["final_obs"]), np.stack([observation] * 2))


def test_what_cannot_be_flown_is_refused_in_a_sentence(three):
    before, _ = three.reset()
    low = three.action_space.low
    for actions in (low[0], None, low - [[0.0], [0.0], [1.0]], low * [[1.0], [np.nan], [1.0]]):
        with pytest.raises(ScenarioError, match=r"action = .*give numbers from .*, in 3 rows"):
            three.step(actions)
    for seed in ([1, 2], -1, [0, 1.5, 2], 0.5, "first"):
        with pytest.raises(ScenarioError, match=r"seed = .*: give a whole number from 0 to"):
            three.reset(seed=seed)
    with pytest.raises(ScenarioError, match="options"):
        three.reset(options={"a": 1})
    np.testing.assert_array_equal(three.reset()[0], before)
