"""The speed margin of a loop, against the linearized diagram and against runs."""

import dataclasses
import math
import warnings
from functools import cache, partial

import numpy as np
import pytest
from drawn_tasks import draw
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import LeafSystem

from drake_nonstop.analysis.task import task_at, task_of
from drake_nonstop.blocks.carrier_controller import CarrierPid
from drake_nonstop.diagrams.nonstop import make_blocks, make_nonstop
from drake_nonstop.loop.loop_response import loop_response, speed_margin_for
from drake_nonstop.loop.start import PlantStates
from drake_nonstop.loop.step import rates_jacobian
from drake_nonstop.mechanics.sampled_loop import noise_deviation, responses
from drake_nonstop.mechanics.signals import CarrierStates, LoadState
from drake_nonstop.mechanics.wind import MeanWind
from drake_nonstop.model.descriptions import CarrierControl, Estimator, Wind
from drake_nonstop.model.system import Model
from drake_nonstop.optimization.problem_config import (
    LimitsConfig,
    highest_speed_bound,
    tightened_bound,
)
from drake_nonstop.optimization.speed_margin import DEVIATIONS
from drake_nonstop.optimization.tethered_loop import (
    Carriers,
    Feedback,
    Inputs,
    Orbit,
    loops_at,
)
from drake_nonstop.scenario.loading import dump_scenario, load_scenario, parse_scenario
from drake_nonstop.scenario.overrides import changed
from drake_nonstop.simulation.metrics import compute_metrics
from drake_nonstop.simulation.run import StepCheck
from drake_nonstop.simulation.simulate import simulate
from drake_nonstop.validation import ScenarioError, ScenarioWarning

EXACT = [  # references that are exact within a sample
    "carrier_controller=FeedforwardCarrierPid",
    "carrier_trajectory.hold=second_order",
]
HORIZON = [
    *EXACT,
    "phase=ShapedPhase",
    "internal_force=PlannedInternalForce",
    "optimization_layer=RecedingHorizonOptimizer",
    "optimization_layer.tightening=auto",
]
RESTING = [
    *EXACT,
    "load_trajectory.start_time=100",
    "optimization_layer=ConstantParameters",
]
GROWING = ["wrench_controller.orientation_gain=20", "wrench_controller.angular_velocity_gain=0.1"]
OVERSTRONG = ["wrench_controller.orientation_gain=5", "wrench_controller.angular_velocity_gain=0.1"]
LIGHT_GUST = ["load_disturbance=!DisturbanceForce {gust_force: 0.1}"]
POSITION_NOISE, ORIENTATION_NOISE = 1e-4, 2e-4  # m and rad


@cache
def margin_with(*overrides, name="three_carriers", simulated_drag=None):
    """The margin of a scenario's loop with exact references, and what it leaves out."""
    scenario = load_scenario(name, [*EXACT, "load_trajectory.start_time=1", *overrides])
    model = plant = Model(scenario.system, scenario.pattern, scenario.control_period)
    if simulated_drag is not None:
        system = dataclasses.replace(scenario.system, load_drag=simulated_drag)
        plant = Model(system, scenario.pattern, scenario.control_period)
    blocks = make_blocks(changed(scenario, ["optimization_layer=ConstantParameters"]))
    return speed_margin_for(model, plant, scenario.optimization_layer, blocks, 4.0)


@pytest.fixture(scope="module")
def as_it_is():
    return margin_with().margin


def orbits(model, count, first=None, amplitude=1.2, frequency=2.0):
    """The first of so many phases of the orbits of ξ (rad/s) and A (N) above a load at rest."""
    weight = np.array([0, 0, 0, 0, 0, model.load_mass * model.gravity])
    for angle in (2 * np.pi * np.arange(count) / count)[:first]:
        waves = angle + model.pattern.phases
        forces = model.pseudo_inverse @ weight + model.pattern.basis @ (amplitude * np.cos(waves))
        rates = model.pattern.basis @ (-amplitude * frequency * np.sin(waves))
        f, r = forces.reshape(-1, 3), rates.reshape(-1, 3)
        tension = np.linalg.norm(f, axis=1, keepdims=True)
        across = r - f * (f * r).sum(axis=1, keepdims=True) / tension**2
        second_rates = model.pattern.basis @ (-amplitude * frequency**2 * np.cos(waves))
        third_rates = model.pattern.basis @ (amplitude * frequency**3 * np.sin(waves))
        higher = (part.reshape(-1, 3) for part in (second_rates, third_rates))
        yield Orbit(f, r, *higher, model.cable_length / tension * across)


def loops_of(model, gains, count, is_measured, estimator=None, **parameters):
    feedback = Feedback(
        gains=gains,
        deviations=np.zeros(12),
        is_measured=is_measured,
        delay=0,
        period=0.01,
        estimator=estimator,
    )
    carriers = Carriers(position_gain=1e4, velocity_gain=100.0)
    return loops_at(model, model, carriers, feedback, orbits(model, count, **parameters))


def test_without_feedback_the_modes_are_those_of_the_linearized_diagram():
    scenario = load_scenario("three_carriers", RESTING)
    scenario.optimization_layer.amplitude = 1.2
    loop = make_nonstop(scenario)
    modes = np.linalg.eigvals(rates_jacobian(loop, loop.CreateDefaultContext()))
    expected = modes[np.abs(modes) > 1e-6]  # the quaternion's norm has none
    assert len(expected) == 12 + 6 * 3
    model = Model(scenario.system, scenario.pattern, scenario.control_period)
    gains = make_blocks(scenario)["wrench_controller"].gains
    (own,) = loops_of(model, gains, 1, np.zeros(12))
    multipliers = np.linalg.eigvals(own.transition)
    for value in np.exp(0.01 * expected):
        assert np.min(np.abs(multipliers - value)) < 1e-5


def test_a_deviation_goes_on_as_in_a_run():
    orbit = ["optimization_layer.amplitude=3", "optimization_layer.frequency=2"]
    scenario = load_scenario("three_carriers", [*RESTING, *orbit, *OVERSTRONG])
    loop = make_nonstop(scenario)
    states, spin = [], 1e-5 * np.array([1.0, -0.5, 2.0])
    for by in (0.0, 1.0):
        context = loop.CreateDefaultContext()
        load = loop.GetOutputPort("load_state").Eval(context).copy()
        LoadState.view(load).angular_velocity[:] += by * spin
        PlantStates(loop).set_states(context, load_state=load)
        simulator = Simulator(loop, context)
        simulator.get_mutable_integrator().set_maximum_step_size(2e-4)
        states.append([])
        for sample in range(1, 31):
            simulator.AdvanceTo(0.01 * sample)
            states[-1].append(loop.GetOutputPort("load_state").Eval(context).copy())
    flown, deviating = (LoadState.view(np.array(part)) for part in states)
    model = Model(scenario.system, scenario.pattern, scenario.control_period)
    gains = make_blocks(scenario)["wrench_controller"].gains
    loops = loops_of(model, gains, 314, np.ones(12), first=30, amplitude=3.0, frequency=2.0)
    found = [np.zeros(len(loops[0].transition))]
    found[0][6:9] = spin
    for own in loops:
        found.append(own.transition @ found[-1])
    expected = deviating.angular_velocity - flown.angular_velocity
    difference = np.array(found)[1:, 6:9] - expected
    assert np.max(np.abs(difference)) < 0.025 * np.max(np.abs(expected))


# A fast filter, whose noise a short run shows.
FAST = "process_acceleration: 20, process_angular_acceleration: 40"


@pytest.mark.nightly("studies")
@pytest.mark.parametrize("block", ["NoisyFeedback", "EstimatedFeedback"])
def test_noise_spreads_speeds_as_in_a_run(block):
    noise = f"position_noise: {POSITION_NOISE}, orientation_noise: {ORIENTATION_NOISE}"
    noise += f", {FAST}" if block == "EstimatedFeedback" else ""
    scenario = load_scenario(
        "three_carriers",
        [*RESTING, f"load_feedback=!{block} {{{noise}}}", "simulation_duration=6.3"],
    )
    scenario.optimization_layer.amplitude = 1.2
    model = Model(scenario.system, scenario.pattern, scenario.control_period)
    blocks = make_blocks(scenario)
    feedback, estimator = blocks["load_feedback"], None
    if block == "EstimatedFeedback":
        gains = feedback.rotation_gain, feedback.translation_gain
        estimator = Estimator.of(*gains, feedback.period)
    loops = loops_of(model, blocks["wrench_controller"].gains, 8, np.ones(12), estimator)
    place = Inputs.of(3).measurement
    deviations = feedback.deviations
    predicted = [
        noise_deviation(g[..., place], deviations).max()
        for g in responses(loops, 39, range(8), 400)
    ]
    quiet = changed(scenario, ["load_feedback=IdealFeedback"])
    noisy, without = (simulate(s, check_step=StepCheck.NOTHING) for s in (scenario, quiet))
    speeds = [
        np.linalg.norm(CarrierStates.view(run.steps["carrier_state"]).velocities, axis=-1)
        for run in (noisy, without)
    ]
    measured = float(np.std((speeds[0] - speeds[1])[100:]))
    assert 0.5 * max(predicted) < measured < 1.05 * max(predicted)


def short_run(task, *overrides):
    """The margins of a run of a task's start, and those in units of the bound."""
    name = "quintic" if isinstance(task, int) else task
    drawn = draw(task) if isinstance(task, int) else []
    short = ["load_trajectory.start_time=1", "simulation_duration=3"]
    without = "optimization_layer.overshoot=0"  # what plans keep after jumps by themselves
    scenario = changed(load_scenario(name), [*drawn, *HORIZON, *short, without, *overrides])
    return scenario, compute_metrics(simulate(scenario, check_step=StepCheck.NOTHING))["optimizer"]


@pytest.mark.nightly("studies")
@pytest.mark.parametrize("task", ["three_carriers", "quintic", 1007])
def test_no_speed_falls_short_by_more_than_predicted(task):
    scenario, optimizer = short_run(task)
    predicted = optimizer["predicted_speed_margin_m_s"]
    assert optimizer["measured_speed_margin_m_s"] < predicted  # one jump, at one phase of a turn
    share = optimizer["predicted_speed_margin_of_bound"]
    assert share == pytest.approx(predicted / scenario.speed_bound)


@pytest.mark.nightly("studies")
@pytest.mark.parametrize("task", ["three_carriers", "quintic", 1007])
def test_gusts_slow_carriers_down_by_a_part_of_what_is_predicted(task):
    _, optimizer = short_run(task, "load_disturbance=!DisturbanceForce {gust_force: 0.1}")
    predicted = optimizer["predicted_speed_margin_m_s"]
    measured = optimizer["measured_speed_margin_m_s"]
    assert 0 < measured < predicted < 12 * measured  # 5 standard deviations, in a short run


# Loops whose bound their nominal orbits keep, and the shares of their margins in m/s.
SLOW = ["control_period=0.02", "optimization_layer.speed_bound=0.3"]
OF_LOOPS = {
    "as it is": ([], {"tracking": 0.000163415206, "jumps": 0.00221531017, "grid": 5.58903275e-05}),
    "estimated and windy": (
        [
            *SLOW,
            "load_feedback=!EstimatedFeedback {period: 0.02, position_noise: 1.0e-4, "
            "orientation_noise: 1.0e-4}",
            "wind=!GustyWind {velocity: [0.05, 0, 0], load_gust: 0.01, rise_time: 1}",
            "wind_estimator=NoWind",
            *("optimization_layer.tightening=auto", "optimization_layer.model_error=0.005"),
        ],
        {
            "tracking": 0.000610258403,
            "grid": 2.40765504e-06,
            "noise": 6.66627992e-06,
            "model": 0.00312958975,
            "disturbance": 0.0147126873,
            "speed_credit": -0.0198835966,
        },
    ),
    "late and pushed": (
        [
            *SLOW,
            *("carrier_controller=LoadedCarrierPid", "carrier_dynamics=LoadedCarrierDynamics"),
            "optimization_layer.speed_bound=0.02",
            "load_feedback=!NoisyFeedback {period: 0.02, orientation_noise: 1.0e-4, delay: 0.02}",
            "load_disturbance=!DisturbanceForce {force: [0.02, 0, 0], gust_force: 0.01}",
        ],
        {
            "tracking": 0.244395224,
            "grid": 2.40765504e-06,
            "noise": 0.0224734428,
            "delay": 0.00234362675,
            "disturbance": 0.0162820803,
            "speed_credit": -0.285496781,
        },
    ),
    "open loop": (
        [
            *SLOW,
            "load_feedback=DesiredAttitudeFeedback",
            "carrier_controller=!CarrierPid {integral_gain: 5}",
            *("carrier_trajectory.hold=velocity", "optimization_layer.instants=8"),
        ],
        {"tracking": 0.017989257, "grid": 1.5047844e-05, "speed_credit": -0.0180043049},
    ),
}


@pytest.mark.nightly("studies")
@pytest.mark.parametrize(("overrides", "shares"), OF_LOOPS.values(), ids=OF_LOOPS)
def test_shares_of_known_loops_are_these(overrides, shares):
    """Of four loops that have all shares between them; a share that is left out is 0."""
    found = margin_with(*overrides)
    assert not found.left_out
    for name, value in vars(found.margin).items():
        assert value == pytest.approx(shares.get(name, 0.0), rel=1e-6, abs=1e-12), name


def test_a_loop_that_is_turned_with_its_motion_and_its_gusts_has_the_same_margin():
    """The responses to a force are in the load's frame, gusts and motion in the world's."""
    found = []
    for yaw in (0.0, 1.1):
        along = np.array([np.cos(yaw), np.sin(yaw), 0.0])
        move = f"displacement: {(0.3 * along).tolist()}, move_time: 4"
        turned = [
            f"load_trajectory=!RestToRest {{{move}, start_roll_pitch_yaw: [0, 0, {yaw}]}}",
            f"load_disturbance=!DisturbanceForce {{force: {(0.05 * along).tolist()}}}",
        ]
        found.append(margin_with(*SLOW, *turned).margin)
    assert found[0].disturbance > 1e-4
    for name, value in vars(found[0]).items():
        assert getattr(found[1], name) == pytest.approx(value, rel=1e-5, abs=1e-9), name


@pytest.mark.nightly("studies")
def test_what_fast_carriers_lose_does_not_count():
    """By a cable of little tension its carrier is fast, and slowed down most."""
    needed = 0.0
    for bound in (0.2, 1.5, 3.0):
        orbits = ["optimization_layer.amplitude=3", f"optimization_layer.speed_bound={bound}"]
        margin = margin_with(*orbits, *LIGHT_GUST).margin
        assert margin.total >= needed
        needed = margin.total
        if bound == 0.2:
            assert margin.total == pytest.approx(0)
            assert -margin.speed_credit == pytest.approx(margin.disturbance, rel=0.1)
    assert needed > 0.05
    assert margin.speed_credit == 0


@pytest.mark.nightly("studies")
def test_where_no_margin_suffices_what_is_covered_is_used_and_that_is_said():
    gust = "load_disturbance=!DisturbanceForce {gust_force: 3}"
    found = margin_with("control_period=0.02", "optimization_layer.amplitude=3", gust)
    bound = load_scenario("three_carriers").speed_bound
    assert found.margin.total == pytest.approx(bound)
    assert found.margin.deficit < -bound
    assert "m/s above the bound needs faster orbits, and" in found.left_out[0]


def test_where_the_loop_grows_there_is_no_margin():
    found = margin_with("control_period=0.02", "optimization_layer.amplitude=3", *GROWING)
    assert found.margin is None
    assert "the linear loop grows by" in found.left_out[0]


def test_references_that_go_on_along_their_velocity_need_more(as_it_is):
    """What plans keep after jumps is left out: here all of it."""
    worse = margin_with("carrier_trajectory.hold=velocity", "optimization_layer.overshoot=5").margin
    assert worse.tracking > 20 * as_it_is.tracking
    assert worse.jumps == 0


def test_a_carrier_without_feedforward_needs_more(as_it_is):
    """The jerk of its septic reference does not jump."""
    worse = margin_with("carrier_controller=CarrierPid", "load_trajectory.blend=c4").margin
    assert worse.tracking > 2 * as_it_is.tracking
    assert worse.jumps == 0 < as_it_is.jumps


@pytest.mark.nightly("studies")
def test_what_plans_keep_after_jumps_is_left_out():
    shares = [margin_with(f"optimization_layer.overshoot={k}").margin.jumps for k in (0, 0.1, 5)]
    assert shares[0] > shares[1] > shares[2] == 0


@pytest.mark.nightly("studies")
def test_continuous_references_have_no_hold_to_follow():
    assert margin_with("control_period=0.0").margin.tracking == 0


@pytest.mark.nightly("studies")
def test_noise_counts_in_proportion_and_a_delay_at_all(as_it_is):
    shares = [
        margin_with(
            f"load_feedback=!NoisyFeedback {{orientation_noise: {noise}, delay: {delay}}}"
        ).margin
        for noise, delay in ((1e-5, 0.0), (2e-5, 0.0), (0.0, 0.01))
    ]
    assert shares[1].noise == pytest.approx(2 * shares[0].noise, rel=0.05)
    assert shares[2].delay > 0 == as_it_is.delay == as_it_is.noise


@pytest.mark.nightly("studies")
def test_a_filter_leaves_little_of_the_noise():
    noise = "position_noise: 1.0e-4, orientation_noise: 2.0e-4"
    raw = margin_with(f"load_feedback=!NoisyFeedback {{{noise}}}")
    filtered = margin_with(f"load_feedback=!EstimatedFeedback {{{noise}}}")
    assert 0 < filtered.margin.noise < 0.1 * raw.margin.noise
    assert not filtered.left_out


def test_the_lag_of_a_filter_that_believes_in_noise_of_rates_is_said():
    slow = "load_feedback=!EstimatedFeedback {believed_velocity_noise: 1.0e-4}"
    for given, count in (("load_feedback=EstimatedFeedback", 0), (slow, 1)):
        scenario = load_scenario("three_carriers", [*RESTING, given])
        model = Model(scenario.system, scenario.pattern, scenario.control_period)
        response = loop_response(model, make_blocks(scenario))
        assert response.feedback.estimator is not None
        said = response.left_out
        assert len([sentence for sentence in said if "lag" in sentence]) == count == len(said)


@pytest.mark.nightly("studies")
def test_a_heavier_load_slows_the_carriers_by_its_share(as_it_is):
    """A cable with 2 % more tension swings 2 % slower for the same internal force."""
    auto = "optimization_layer.tightening=auto"
    share = margin_with(auto, "optimization_layer.model_error=0.02").margin
    assert as_it_is.model == 0
    assert 0.01 * 0.55 < share.model < 0.05 * 2.0


def test_a_drag_that_the_controllers_do_not_know_adds_what_its_force_does():
    """0.7 N s/m is believed."""
    wind = "wind=!SteadyWind {velocity: [0.2, 0, 0]}"
    known, unknown = (margin_with(wind, simulated_drag=drag).margin for drag in (0.7, 1.0))
    force = margin_with("load_disturbance=!DisturbanceForce {force: [0.06, 0, 0]}").margin
    added = unknown.disturbance - known.disturbance
    assert added == pytest.approx(force.disturbance, rel=0.1)


@pytest.mark.nightly("studies")
def test_a_force_in_still_air_and_the_wind_that_makes_it_count_alike(as_it_is):
    """A wind that is not believed is a force of its drag, 0.7 N s/m by default."""
    wind = ["wind=!SteadyWind {velocity: [0.2, 0, 0]}", "wind_estimator=NoWind"]
    force = ["load_disturbance=!DisturbanceForce {force: [0.14, 0, 0]}"]
    shares = [margin_with(*given).margin.disturbance for given in (wind, force)]
    assert shares[0] == pytest.approx(shares[1], rel=1e-9)
    assert shares[0] > 0 == as_it_is.disturbance


@pytest.mark.nightly("studies")
def test_gusts_spread_speeds_as_in_a_run():
    gusts = "wind=!GustyWind {load_gust: 0.05, gust: 0, load_altitude: 3.1}"
    scenario = load_scenario("three_carriers", [*RESTING, gusts, "simulation_duration=12"])
    quiet = changed(scenario, ["wind=StillAir"])
    gusty, without = (simulate(s, check_step=StepCheck.NOTHING) for s in (scenario, quiet))
    speeds = [
        np.linalg.norm(CarrierStates.view(run.steps["carrier_state"]).velocities, axis=-1)
        for run in (gusty, without)
    ]
    measured = float(np.std((speeds[0] - speeds[1])[100:]))
    predicted = margin_with(gusts).margin.disturbance / DEVIATIONS
    assert 0.3 * predicted < measured < predicted


@pytest.mark.nightly("studies")
def test_the_grid_counts_as_the_square_of_its_spacing():
    coarse, fine = (
        margin_with(f"optimization_layer.instants={count}").margin.grid for count in (10, 20)
    )
    assert coarse == pytest.approx(4 * fine, rel=0.05)


def test_what_is_not_known_is_said_in_one_sentence():
    scenario = load_scenario("three_carriers", ["optimization_layer.tightening=auto"])

    class Unknown(CarrierPid):
        gains = None

    with pytest.warns(ScenarioWarning, match="carrier_controller = Unknown: its response") as said:
        make_nonstop(scenario, carrier_controller=lambda model: Unknown(model))
    assert len([w for w in said if "tightening" in str(w.message)]) == 1


class _OwnController(CarrierPid):
    """That of the package, of which nothing is known."""


class _DescribedController(CarrierPid):
    """As much, and it says what it does."""

    def describe_response(self):
        return CarrierControl(**self.gains)


class _OwnWind(LeafSystem):
    """A steady wind that describes itself."""

    def __init__(self, model):
        super().__init__()
        for name, size in (("wind", 3 * model.n), ("load_wind", 3), ("mean_wind", 3)):
            self.DeclareVectorOutputPort(name, size, partial(_blow, size), {self.nothing_ticket()})

    def describe_wind(self):
        return Wind(MeanWind(np.array([0.2, 0.0, 0.0])))


def _blow(size, context, output):
    output.SetFromVector(np.tile([0.2, 0.0, 0.0], size // 3))


def test_blocks_of_ones_own_that_describe_themselves_take_part():
    """The margin, and what a run says of its formation, are those of the same loop of ours."""
    layer = "optimization_layer.tightening=auto"
    wind = ["wind=!SteadyWind {velocity: [0.2, 0, 0]}", "wind_estimator=NoWind"]
    scenario = load_scenario("three_carriers", [layer, *wind, "carrier_controller=CarrierPid"])
    expected = make_nonstop(scenario, at_equilibrium=False)
    own = {"carrier_controller": lambda model: _DescribedController(model), "wind": _OwnWind}
    with warnings.catch_warnings():
        warnings.simplefilter("error", ScenarioWarning)
        loop = make_nonstop(scenario, at_equilibrium=False, **own)
    assert loop.speed_margin == expected.speed_margin
    context = loop.CreateDefaultContext()
    for given in (task_of(scenario, loop), task_at(scenario.sampled(), loop, context)):
        ours = task_of(scenario, expected).response.carriers
        assert vars(given.response.carriers) == vars(ours)
        np.testing.assert_array_equal(given.wind, [0.2, 0.0, 0.0])


def test_what_a_block_of_ones_own_inherits_is_not_taken_for_its_response():
    scenario = load_scenario("three_carriers")
    blocks = make_blocks(scenario, carrier_controller=lambda model: _OwnController(model))
    model = Model(scenario.system, scenario.pattern, scenario.control_period)
    assert loop_response(model, blocks).carriers is None


def test_the_orbits_of_the_margin_weigh_the_amplitude_as_their_layer_does():
    """Where a larger A costs much, faster orbits have a larger ξ, and larger errors by it."""
    layer = "optimization_layer=RecedingHorizonOptimizer"
    faster = ("phase=ShapedPhase", layer, "optimization_layer.speed_bound=0.8")
    as_of_default, light, same, heavy = (
        margin_with(*faster, *weight).margin
        for weight in (
            [],
            *([f"optimization_layer.amplitude_weight={w}"] for w in (0.01, 4.0, 400.0)),
        )
    )
    assert same == as_of_default
    assert light.total < same.total < heavy.total


@pytest.mark.nightly("studies")
def test_the_orbits_of_the_margin_keep_a_largest_speed():
    """Of 1.1 m/s on the nominal orbits: one that binds needs others, or there are none."""
    auto = "optimization_layer.tightening=auto"

    def margin(limit):
        scenario = load_scenario("quintic", [auto, f"optimization_layer.max_speed={limit}"])
        return make_nonstop(scenario, at_equilibrium=False).speed_margin.total

    assert margin("2.0") == margin(".inf")
    assert margin("1.15") > 1.5 * margin(".inf")
    with pytest.warns(ScenarioWarning, match="no constant xi and A within bounds and limits have"):
        margin("0.9")


def test_a_layer_in_a_loop_aims_above_its_bound_by_the_margin():
    scenario = load_scenario(
        "three_carriers",
        [*EXACT, "optimization_layer=NonstopOptimizer", "optimization_layer.tightening=auto"],
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        loop = make_nonstop(scenario)
    margin = loop.speed_margin.total
    solver = loop.GetSubsystemByName("optimization_layer").solver
    zeros = np.zeros(22)
    zeros[0] = 1
    data = solver.update_data(
        np.array([2.0, 1.8]), np.zeros(2), zeros[:13], zeros, *np.zeros((3, 6)), speed_bound=0.55
    )
    assert margin < 1e-3 * 0.55  # which is kept at least
    assert data.speed_bound[0] == pytest.approx(1.001 * 0.55)


def test_a_computed_margin_stays_below_the_bound_it_is_for_and_grows_above_it():
    config = LimitsConfig(speed_bound=0.5, tightening="auto", speed_margin=0.1, max_speed=2.0)
    target_speeds = [tightened_bound(config, bound) for bound in (0.0, 0.25, 0.5, 1.0)]
    assert target_speeds == pytest.approx([0.0, 0.35, 0.6, 1.2])
    for own in (0.5, 1.95):
        config = dataclasses.replace(config, speed_bound=own)
        highest = highest_speed_bound(config)
        assert tightened_bound(config, highest) == pytest.approx(0.98 * 2.0)
    free = dataclasses.replace(config, max_speed=math.inf)
    assert highest_speed_bound(free) == math.inf


def test_the_word_stands_in_files_and_no_other_does():
    scenario = load_scenario("quintic", ["optimization_layer.tightening=auto"])
    assert parse_scenario(dump_scenario(scenario)) == scenario
    drawn = load_scenario("quintic", ["optimization_layer.tightening=!Uniform {min: 0, max: 0.1}"])
    assert 0 < drawn.sampled().optimization_layer.tightening < 0.1
    for value, remedy in (("much", "give a number, without quotes"), ("true", "give a number")):
        with pytest.raises(ScenarioError, match=remedy):
            make_blocks(load_scenario("quintic", [f"optimization_layer.tightening={value}"]))
