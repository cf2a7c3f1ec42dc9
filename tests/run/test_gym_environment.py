"""The loop as an environment: Gymnasium's own check, the loop's own flight, divergence."""

import numpy as np
import pytest
from helpers import nightly_beyond

from drake_nonstop import ScenarioError, load_scenario, make_gym_env, make_gym_vec_env, simulate

pytest.importorskip("gymnasium")
BRIEF = ["simulation_duration=0.3"]


@pytest.mark.parametrize("action", nightly_beyond(1, "studies", ["parameters", "wrench"]))
def test_it_is_an_environment(action):
    from gymnasium.utils.env_checker import check_env

    env = make_gym_env(load_scenario("quintic", BRIEF), action=action)
    check_env(env, skip_render_check=True)


def test_constant_parameters_fly_as_the_loop_does():
    scenario = load_scenario("three_carriers", [*BRIEF, "optimization_layer=ConstantParameters"])
    env = make_gym_env(scenario, time_step=0.1)
    action = [scenario.optimization_layer.frequency, scenario.optimization_layer.amplitude]
    first, _ = env.reset()
    observations, ends = [first], []
    for _ in range(3):
        observation, reward, terminated, truncated, _ = env.step(np.array(action))
        observations.append(observation)
        ends.append((terminated, truncated))
        assert -0.01 < reward <= 0
    assert ends == [(False, False), (False, False), (False, True)]
    run = simulate(scenario)
    signals = [run.signal(name) for name in ("load_state", "reference", "carrier_state")]
    flown = np.hstack(signals)[[0, 10, 20, 30]]
    np.testing.assert_allclose(observations, flown, atol=1e-6)
    again, _ = env.reset()
    np.testing.assert_array_equal(again, first)


def test_a_divergence_ends_the_episode():
    env = make_gym_env(load_scenario("quintic"), action="wrench")
    env.reset()
    push = np.array([0.0, 0.0, 0.0, 9.8, 9.8, 0.0])
    for _ in range(50):
        observation, reward, terminated, truncated, info = env.step(push)
        if terminated:
            break
    assert (terminated, truncated) == (True, False)
    assert reward == -1000
    assert np.isfinite(observation).all()
    assert "not finite" in info["message"]
    observation, _ = env.reset()
    assert not env.step(np.array([0, 0, 0, 0, 0, 9.81]))[2]


@pytest.mark.parametrize("is_vector", [False, True])
def test_a_load_far_away_ends_the_episode_as_a_divergence(is_vector):
    push = "load_disturbance=!DisturbanceForce {force: [0, 0, 100000], start_time: 0.05}"
    scenario, action = load_scenario("quintic", [*BRIEF, push]), np.array([2.0, 1.2])
    make = (
        (lambda *given, **more: make_gym_vec_env(*given, 1, **more)) if is_vector else make_gym_env
    )
    env = make(scenario, time_step=0.01)
    env.reset()
    for _ in range(20):
        observation, reward, terminated, truncated, info = env.step(
            action[None] if is_vector else action
        )
        if terminated:
            break
    assert (terminated, truncated, reward) == (True, False, -1000)
    message = info["final_info"]["message"][0] if is_vector else info["message"]
    last = info["final_obs"][0] if is_vector else observation
    assert "farther than 100 cable lengths" in message
    assert 40 < np.linalg.norm(last[4:7]) < 80


STIFF = "system.load_inertia=[[0.0015,0,0],[0,0.0015,0],[0,0,0.0015]]"


@pytest.mark.parametrize("is_vector", [False, True])
def test_the_step_is_that_of_simulate_where_the_loop_needs_a_shorter_one(is_vector):
    scenario = load_scenario("quintic", [*BRIEF, STIFF])
    env = make_gym_vec_env(scenario, 1) if is_vector else make_gym_env(scenario)
    env.reset()
    action = np.array([[2.0, 1.2]]) if is_vector else np.array([2.0, 1.2])
    for _ in range(2):
        observation = env.step(action)[0]
    assert np.abs(observation.ravel()[4:7]).max() < 0.01


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


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"action": "thrust"}, "action = thrust"),
        ({"time_step": 0.0}, "make_gym_env.time_step = 0.0: give a finite number"),
        ({"reward": 3}, "reward = 3: give a function"),
    ],
)
def test_what_cannot_be_used_is_refused(arguments, said):
    with pytest.raises(ScenarioError, match=said):
        make_gym_env(load_scenario("quintic"), **arguments)


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
    alone = make_gym_env(varied)
    alone.reset(seed=1)
    np.testing.assert_array_equal(alone.step(alone.action_space.low)[0], first)


@pytest.mark.parametrize(
    "action",
    nightly_beyond(
        3, "adversary", [[np.nan, 1.0], [200.0, -50.0], [2.0], 2.0, "fast", None, [[2.0, 1.2]]]
    ),
)
def test_an_action_outside_of_the_space_is_no_physics(action):
    env = make_gym_env(load_scenario("quintic", BRIEF))
    before, _ = env.reset()
    with pytest.raises(ScenarioError, match=r"action = .*give numbers from"):
        env.step(action)
    np.testing.assert_array_equal(env.reset()[0], before)


def test_a_step_before_reset_and_a_reward_that_is_no_number_are_refused():
    env = make_gym_env(load_scenario("quintic", BRIEF), reward=lambda observation, action: np.nan)
    with pytest.raises(ScenarioError, match="call reset"):
        env.step(env.action_space.low)
    env.reset()
    with pytest.raises(ScenarioError, match="reward = nan: return a finite number"):
        env.step(env.action_space.low)
    with pytest.raises(ScenarioError, match="options"):
        env.reset(options={"a": 1})
