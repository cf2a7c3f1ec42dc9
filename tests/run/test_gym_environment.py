"""Environments, alone and side by side: Gymnasium's own checks, the loop's own flights, ends."""

import numpy as np
import pytest
from helpers import nightly_beyond

from drake_nonstop import (
    ScenarioError,
    ScenarioWarning,
    load_scenario,
    make_gym_env,
    make_gym_vec_env,
    simulate,
)

pytest.importorskip("gymnasium")
BRIEF = ["simulation_duration=0.3"]
HOLD, PUSH = [0.0, 0.0, 0.0, 0.0, 0.0, 9.81], [0.0, 0.0, 0.0, 9.8, 9.8, 0.0]


@pytest.fixture(scope="module")
def three():
    return make_gym_vec_env(load_scenario("quintic", BRIEF), 3)


@pytest.mark.parametrize("action", ["parameters", "wrench"])
def test_it_is_an_environment(action):
    from gymnasium.utils.env_checker import check_env

    scenario = load_scenario("quintic", BRIEF)
    env = make_gym_env(scenario, action=action)
    check_env(env, skip_render_check=True)
    if action == "wrench":  # the load's weight, and its moment
        reach = np.max(np.linalg.norm(scenario.system.attachments, axis=1))
        most = scenario.system.load_mass * 9.81 * np.array([reach, reach, reach, 1, 1, 2])
        np.testing.assert_allclose(env.action_space.high, most)
        np.testing.assert_allclose(env.action_space.low, [*-most[:5], 0])


def test_it_is_a_vector_environment(three):
    from gymnasium import __version__
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
    # Before its version 1.4 Gymnasium leaves out the step that begins an episode by itself.
    later = 3 if int(__version__.split(".")[1]) >= 4 else 2
    assert lengths == [3, 3, 3, later, later, later]


STIFF = "system.load_inertia=[[0.0015,0,0],[0,0.0015,0],[0,0,0.0015]]"  # steps are shorter


@pytest.mark.parametrize(("name", "overrides"), [("three_carriers", []), ("quintic", [STIFF])])
def test_constant_parameters_fly_as_the_loop_does(name, overrides):
    layer = "optimization_layer=ConstantParameters"
    scenario = load_scenario(name, [*BRIEF, layer, *overrides])
    env = make_gym_env(scenario, time_step=0.1)
    action = [scenario.optimization_layer.frequency, scenario.optimization_layer.amplitude]
    first, _ = env.reset()
    steps = [env.step(np.array(action)) for _ in range(3)]
    assert [each[2:4] for each in steps] == [(False, False), (False, False), (False, True)]
    assert all(-0.01 < reward <= 0 for _, reward, *_ in steps)
    run = simulate(scenario)
    signals = [run.signal(name) for name in ("load_state", "reference", "carrier_state")]
    flown = np.hstack(signals)[[0, 10, 20, 30]]
    np.testing.assert_allclose([first, *(each[0] for each in steps)], flown, atol=1e-6)
    np.testing.assert_array_equal(env.reset()[0], first)


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
    space, ends = env.single_action_space, 0
    for _ in range(round(duration / step) + 2):  # into the next episode
        actions = space.low + rng.uniform(0.4, 0.6, (5, *space.shape)) * (space.high - space.low)
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


def test_a_loop_that_is_not_compiled_flies_by_its_diagram_as_the_other_is_compiled():
    scenario, compiled = (
        load_scenario("quintic", ["simulation_duration=0.2", *own])
        for own in (["load_plant=MultibodyLoadPlant"], [])
    )
    with pytest.warns(ScenarioWarning, match="load_plant = MultibodyLoadPlant.*; the 2 environm"):
        envs = make_gym_vec_env(scenario, 2)
    other = make_gym_env(compiled)
    envs.reset(), other.reset()
    for _ in range(2):
        _, *judged, infos = envs.step(np.tile([2.0, 1.3], (2, 1)))
        observation, *expected, _ = other.step(np.array([2.0, 1.3]))
        for values, own in zip(judged, expected, strict=True):
            np.testing.assert_allclose(values, [own, own], rtol=0, atol=1e-6)
    assert judged[2].all()
    np.testing.assert_allclose(np.stack(infos["final_obs"]), [observation] * 2, rtol=0, atol=1e-6)


def test_a_divergence_ends_its_own_episode_alone():
    env = make_gym_vec_env(load_scenario("quintic"), 3, action="wrench")
    single = make_gym_env(load_scenario("quintic"), action="wrench")
    first, _ = env.reset()
    observations, _ = first, single.reset()
    for _ in range(50):
        before = observations[1]
        observations, rewards, terminated, truncated, infos = env.step([HOLD, PUSH, HOLD])
        alone = single.step(np.array(PUSH))
        if terminated.any():
            break
    assert terminated.tolist() == [False, True, False]
    assert not truncated.any()
    assert rewards[1] == -1000
    assert min(rewards[0], rewards[2]) > -1
    np.testing.assert_array_equal(infos["final_obs"][1], before)
    assert "not finite" in infos["final_info"]["message"][1] == alone[4]["message"]
    np.testing.assert_allclose(alone[0], before, atol=1e-9)
    assert alone[1:4] == (-1000, True, False)
    np.testing.assert_array_equal(observations[1], first[1])
    assert not env.step([HOLD, HOLD, HOLD])[2].any()
    with pytest.raises(ScenarioError, match="call reset"):
        single.step(np.array(HOLD))
    push = "load_disturbance=!DisturbanceForce {force: [0, 0, 100000], start_time: 0.05}"
    env, is_over = make_gym_env(load_scenario("quintic", [*BRIEF, push]), time_step=0.01), False
    env.reset()
    while not is_over:
        _, reward, is_over, truncated, info = env.step(np.array([2.0, 1.2]))
    assert (truncated, reward) == (False, -1000)
    assert "farther than 100 cable lengths" in info["message"]


def test_slow_carriers_cost_reward_and_a_reward_may_be_given():
    slow = load_scenario("quintic", ["simulation_duration=0.6"])
    env = make_gym_env(slow)
    env.reset()
    low = env.action_space.low
    for _ in range(5):
        reward = env.step(low)[1]
    assert reward < -0.05
    env = make_gym_env(slow, reward=lambda observation, action: float(action[0]))
    env.reset()
    assert env.step(low)[1] == low[0]


def test_episodes_draw_their_numbers_by_the_seed():
    varied = load_scenario("quintic", [*BRIEF, "system.load_mass=!Uniform {min: 0.8, max: 1.2}"])
    env = make_gym_env(varied)

    def end(seed):
        env.reset(seed=seed)
        return env.step(env.action_space.low)[0]

    first, second, again = end(1), end(2), end(1)
    np.testing.assert_array_equal(first, again)
    assert np.max(np.abs(first - second)) > 1e-6
    assert np.max(np.abs(end(None) - first)) > 1e-6
    both = make_gym_vec_env(varied, 2)
    for seed in (None, 0):  # the scenario's is 0
        both.reset(seed=seed)
        np.testing.assert_allclose(both.step(both.action_space.low)[0][1], first, atol=1e-9)


# Of a call: what it is given, and the field, value and remedy of its message.
REFUSED = [
    ({"action": "thrust"}, "action = thrust: there is no thrust; there are parameters, wrench"),
    ({"time_step": 0.005}, "time_step = 0.005: give at least control_period = 0.01 s"),
]


def test_what_cannot_be_flown_is_refused(three):
    for given, said in REFUSED:
        with pytest.raises(ScenarioError, match=said):
            make_gym_vec_env(load_scenario("quintic"), **{"n": 2, **given})
    env = make_gym_env(load_scenario("quintic", BRIEF), reward=lambda observation, action: np.nan)
    with pytest.raises(ScenarioError, match="call reset"):
        env.step(env.action_space.low)
    before, _ = env.reset()
    for action in ([np.nan, 1.0], [200.0, -50.0], [2.0], 2.0, "fast", None, [[2.0, 1.2]]):
        with pytest.raises(ScenarioError, match=r"action = .*give numbers from"):
            env.step(action)
        np.testing.assert_array_equal(env.reset()[0], before)
    with pytest.raises(ScenarioError, match="reward = nan: return a finite number"):
        env.step(env.action_space.low)
    with pytest.raises(ScenarioError, match="options"):
        env.reset(options={"a": 1})
    before, _ = three.reset()
    low = three.action_space.low
    for actions in (low[0], None, low - [[0.0], [0.0], [1.0]], low * [[1.0], [np.nan], [1.0]]):
        with pytest.raises(ScenarioError, match=r"action = .*give numbers from .*, in 3 rows"):
            three.step(actions)
    for seed in ([1, 2], -1, [0, 1.5, 2], 0.5, "first"):
        with pytest.raises(ScenarioError, match=r"seed = .*: give a whole number from 0 to"):
            three.reset(seed=seed)
    np.testing.assert_array_equal(three.reset()[0], before)
