"""What a block refuses, or tells: one sentence with the field, the value and the remedy."""

import warnings

import numpy as np
import pytest
from helpers import model
from registries import CASES, LOOPS, made_with, model_of

from drake_nonstop import ScenarioError, ScenarioWarning, load_scenario, make_nonstop
from drake_nonstop.blocks.load_trajectory import SampledTrajectory, SampledTrajectoryConfig

NOT_NEGATIVE, POSITIVE = "number that is not negative", "number greater than zero"
THREE, SEED, SOLVERS = "give 3 finite numbers", "a whole number from 0", "snopt, ipopt"
HOLD = "above zero that hold the initial"

# Fields of a block's config, values that they cannot have, and what is in the remedy.
FIELDS = {
    ("ConstantParameters", "frequency"): ([0.0, np.nan], POSITIVE),
    ("ConstantParameters", "amplitude"): ([-1.0, np.inf], POSITIVE),
    ("ConstantParameters", "speed_bound"): ([-0.1], NOT_NEGATIVE),
    ("NoisyFeedback", "delay"): ([0.015], "a multiple of the period 0.01 s"),
    ("NoisyFeedback", "position_noise"): ([-1.0], NOT_NEGATIVE),
    ("NoisyFeedback", "period"): ([0.0], POSITIVE),
    ("NoisyFeedback", "seed"): ([-1, 0.5], SEED),
    ("FilteredFeedback", "believed_position_noise"): ([-1.0], NOT_NEGATIVE),
    ("DisturbanceForce", "force"): ([[1.0]], THREE),
    ("DisturbanceForce", "gust_time"): ([0.0], POSITIVE),
    ("SteadyWind", "velocity"): ([[80.0, 80.0, 0.0]], "at most 100 m/s"),
    ("SteadyWind", "rise_time"): ([-1.0], NOT_NEGATIVE),
    ("GustyWind", "load_gust"): ([200.0], "at most 100 m/s"),
    ("GustyWind", "altitude"): ([310.0, 0.0], "3.05 to 304.8 m"),
    ("WindObserver", "time_constant"): ([0.0], POSITIVE),
    ("LimitedCarriers", "lag"): ([0.0], POSITIVE),
    ("CarrierPid", "position_gain"): ([-1.0, np.nan, None, False], NOT_NEGATIVE),
    ("TunedFeedforwardCarrierPid", "frequency"): ([0.0], POSITIVE),
    ("WrenchController", "feedforward"): ([-1.0, True], NOT_NEGATIVE),
    ("WrenchController", "velocity_gain"): (["Auto", ""], 'without quotes, or "auto"'),
    ("TunedWrenchController", "position_frequency"): ([0.0], POSITIVE),
    ("ShapedPhase", "bandwidth"): ([0.0, np.inf], POSITIVE),
    ("CarrierTrajectory", "hold"): (["second_order"], "third_order or velocity"),
    ("ObservedCarrierTrajectory", "length_rate"): ([-1.0], NOT_NEGATIVE),
    ("ObservedCarrierTrajectory", "share_rate"): ([200.0], "less than one per control period"),
    ("RestToRest", "move_time"): ([0.0, np.nan], POSITIVE),
    ("RestToRest", "start_time"): ([-1.0, np.inf], NOT_NEGATIVE),
    ("RestToRest", "displacement"): ([[1.0, 2.0], [1.0, 2.0, np.inf]], THREE),
    ("RestToRest", "blend"): (["c5"], "c3 or c4"),
    ("ConstantVelocityMove", "blend_time"): ([-0.1], NOT_NEGATIVE),
    ("Waypoints", "positions"): ([[[1.0, 2.0]], []], "n x 3 finite numbers"),
    ("Waypoints", "move_times"): ([[0.0]], "times greater than zero"),
    ("Waypoints", "rest_times"): ([[-1.0]], "times that are not negative"),
    ("Waypoints", "roll_pitch_yaw"): ([[[0, 0, 0], [0, 0, 1]]], "1 x 3 finite numbers"),
    ("SampledTrajectory", "samples"): ([[], [0.0, 1.0], [[0.0] * 4]], "2 to 20000 rows"),
    ("SteadyTurn", "yaw_rate"): ([0.0, "fast", 1000.0], "1e-6 to 100 rad/s"),
    ("PaperLayer", "speed_bound"): ([-0.1], "at least 0.001 m/s"),
    ("PaperLayer", "tightening"): ([1.0], "less than 1"),
    ("PaperLayer", "solver"): (["nlopt"], SOLVERS),
    ("PaperLayer", "period"): ([0.015], "a multiple of the control period 0.01"),
    ("PaperLayer", "frequency_bounds"): ([[3.0, 20.0], [0.0, 20.0]], HOLD),
    ("PaperLayer", "amplitude_bounds"): ([[1.0]], "2 finite numbers"),
    ("NlpLayer", "solver"): (["gurobi"], SOLVERS),
    ("RecedingHorizonOptimizer", "frequency_bounds"): ([[2.5, 3.0]], HOLD),
    ("RecedingHorizonOptimizer", "max_speed"): ([0.208], "greater than 0.208163"),
    ("RecedingHorizonOptimizer", "knot_spacing"): ([0.405], "such as 0.4"),
    ("RecedingHorizonOptimizer", "max_iterations"): ([0], "1 to 100"),
    ("TurnRateOptimizer", "orbit_points"): ([0], "1 to 64"),
    ("TurnRateOptimizer", "max_bank"): ([-1.0], "greater than 0, or .inf"),
    ("TurnRateOptimizer", "max_lift_share"): ([1.2], "at most 1"),
    ("LumpedCables", "nodes"): ([0], "from 1 to 50"),
    ("FixedWingController", "lift_share"): ([1.01], "at most 1"),
    ("FixedWingController", "max_bank"): ([1.6], "less than pi/2"),
}


@pytest.mark.parametrize(
    ("block", "field", "value", "remedy"),
    [
        pytest.param(block, field, value, remedy, id=f"{block}.{field}={value}")
        for (block, field), (values, remedy) in FIELDS.items()
        for value in values
    ],
)
def test_a_field_that_a_block_cannot_have_is_named(block, field, value, remedy):
    case = next(c for c in CASES if c.kind.__name__ == block and c.is_sampled and not c.fields)
    with pytest.raises(ScenarioError) as error:
        made_with(case, model_of(case), **{field: value})
    told, _, asked = str(error.value).partition(": ")
    assert told == f"{case.box}.{field} = {value}"
    assert remedy in asked
    assert "\n" not in asked


AIRCRAFT, CO_ROTATING = "aircraft_rest", "aircraft_co_rotating"
LUMPED = "cables=LumpedCables"
TURNING = "optimization_layer=!TurnRateOptimizer {speed_bound: 1.8 V_s}"
PLANNED, SHAPED = "load_trajectory=!PlannedTurn {}", "phase=!ShapedPhase {bandwidth: 4.0}"
CONSTANT = "optimization_layer=!ConstantParameters {amplitude: 0}"
ORBITAL = "optimization_layer=!PaperLayer {amplitude: 1.2, period: 0.04}"

# Scenarios, overrides, and the field, the value and the remedy that are told of them.
REFUSED = [
    (AIRCRAFT, ["simulated.carrier_mass=0.1"], "simulated.carrier_mass = 0.1", "leave it out"),
    (AIRCRAFT, [LUMPED, "simulated.cable_diameter=0"], "simulated.cable_diameter = 0.0", "above"),
    (AIRCRAFT, [LUMPED, "simulated.cable_diameter=1e-4"], "cable_diameter = 0.0001", "a thicker"),
    (AIRCRAFT, [LUMPED, "simulated.cable_breaking_load=25"], "breaks at 25 N", "a thicker one"),
    (AIRCRAFT, [LUMPED, "simulated.cable_diameter=0.006"], "weighs 40.4 N", "thinner or shorter"),
    ("quintic", [LUMPED, "system.cable_diameter=[1e-3, 0.05, 1e-3, 1e-3]"], "cable 2", "thinner"),
    ("quintic", ["system.cable_length=[0.8, 0.9]"], "cable_length = [0.8, 0.9]", "a list of 4"),
    ("quintic", ["system.cable_length=[0.8, 0.9, 0.0, 1]"], "cable_length[2] = 0.0", POSITIVE),
    ("quintic", ["simulated.cable_damping=[1, 2, 3]"], "damping = [1.0, 2.0, 3.0]", "a list of 4"),
    ("quintic", ["carrier_dynamics=FixedWingDynamics"], "aircraft = none", "model: rascal_110"),
    (AIRCRAFT, ["carrier_controller=CarrierPid"], "aircraft_command", "FixedWingController, or"),
    (
        "quintic",
        ["carrier_trajectory=MeasuredCarrierTrajectory"],
        "carrier_controller = FeedforwardCarrierPid: it reads carrier_reference_acceleration",
        "or carrier_controller=CarrierPid",
    ),
    ("quintic", ["reference_governor.least_rate=0"], "least_rate = 0.0", "0.01 to 1"),
    ("quintic", ["reference_governor.change_time=0.01"], "change_time = 0.01", "at least 0.1 s"),
    (
        "quintic",
        ["reference_governor={}", "pattern=ConstantSpread", CONSTANT, "load_trajectory=SteadyTurn"],
        "reference_governor = with this pattern",
        "give one with orbits",
    ),
    (AIRCRAFT, ["reference_governor={}"], "reference_governor = with system.aircraft", "leave it"),
    (
        CO_ROTATING,
        ["optimization_layer=RecedingHorizonOptimizer"],
        "RecedingHorizonOptimizer: the pattern has no orbits",
        "!TurnRateOptimizer and load_trajectory: !PlannedTurn",
    ),
    (AIRCRAFT, [TURNING, PLANNED, SHAPED], "the pattern has orbits", "pattern: !ConstantSpread"),
    (CO_ROTATING, [TURNING, PLANNED, "phase=PaperPhase"], "phase = PaperPhase", "!ShapedPhase"),
    (CO_ROTATING, [TURNING, SHAPED], "load_trajectory = SteadyTurn", "!PlannedTurn, and phase"),
    ("quintic", ["carrier_trajectory.correction_rates=[0,0,-1,0]"], "rates[2] = -1", NOT_NEGATIVE),
    (CO_ROTATING, [CONSTANT, "load_trajectory=RestToRest"], "pattern = ConstantSpread", "SteadyT"),
    (CO_ROTATING, ["optimization_layer.amplitude=1.2"], "amplitude = 1.2", "give 0"),
    (CO_ROTATING, [ORBITAL], "PaperLayer", "no orbits"),
    (CO_ROTATING, [CONSTANT, "pattern=SpreadCarousel"], "amplitude = 0.0", "greater than zero"),
]


@pytest.mark.parametrize(("name", "overrides", "told", "remedy"), REFUSED)
def test_what_does_not_go_together_is_refused(name, overrides, told, remedy):
    if not any("optimization_layer" in o for o in overrides):
        overrides = ["optimization_layer=ConstantParameters", *overrides]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ScenarioWarning)
        with pytest.raises(ScenarioError) as error:
            make_nonstop(load_scenario(name, overrides), at_equilibrium=False)
    assert told in str(error.value)
    assert remedy in str(error.value).partition(told)[2]
    assert "\n" not in str(error.value)


BOWED, POINTS = LOOPS["BowedCarrierTrajectory"][0], "real_scale_spread"
STRAIGHT = ["optimization_layer=!NlpLayer {speed_bound: 10, period: 0.04}"]
STRAIGHT += ["pattern=!SpreadCarousel {spread: 6.75}"]


def yaws(*angles):
    """Samples of a load that turns by these angles, rad."""
    rows = [[float(t), 0.0, 0.0, 0.0, 0.0, 0.0, float(yaw)] for t, yaw in enumerate(angles)]
    samples = f"load_trajectory=!SampledTrajectory {{samples: {rows}}}"
    return ["optimization_layer=ConstantParameters", samples]


TOLD = [
    (POINTS, ["system.aircraft.model=rascal_110"], "CarrierDynamics", "FixedWingDynamics and"),
    (BOWED, STRAIGHT, "optimization_layer = NlpLayer", "RecedingHorizonOptimizer"),
    ("quintic", ["wrench_controller.position_integral_gain=0.9"], "rates = auto", "to 0"),
    ("quintic", ["phase=AccumulatedPhase"], "phase = AccumulatedPhase", "phase=ShapedPhase"),
    ("quintic", yaws(3.0, 3.1, -3.08, -2.98), "6.18 rad from row 2 to row 3", "unwrap"),
    ("quintic", yaws(0, 170, 190), "170 rad from row 1 to row 2", "in rad"),
    ("quintic", yaws(*range(0, 12, 2)), "10 rad", "degrees"),
    ("quintic", yaws(0.0, -7.0), "7 rad from row 1 to row 2", ""),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "overrides", "told", "remedy"), TOLD)
def test_what_a_user_may_not_expect_is_told_once(name, overrides, told, remedy):
    with pytest.warns(ScenarioWarning) as warned:
        make_nonstop(load_scenario(name, overrides), at_equilibrium=False)
    (sentence,) = (str(each.message) for each in warned)
    assert told in sentence
    assert remedy in sentence.partition(told)[2]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("overrides", [yaws(0.0, 3.0, 6.0, 3.0), yaws(-3.0, 0.0, 3.0)])
def test_a_turn_that_is_meant_is_not_told(overrides):
    make_nonstop(load_scenario("quintic", overrides), at_equilibrium=False)


FILES = [
    (None, "can be read"),
    (b"t,x,y,z\n0,0,0,\xff\n", "can be read"),
    (b"t,x,y\n0,0,0\n1,0,0\n", "named in its first line"),
    (b"secret:x:0:0\n", "named in its first line"),
    (b"t,x,y,z\nsecret:x:0:0\n", "2 to 20000 rows"),
    (b"t,x,y,z\n0,0,0,0\n1,secret,0,0\n", "unlike in row 2"),
    (b"t,x,y,z\n0,0,0,0\n1,0,0\n", "4 numbers in each row"),
    (b"t,x,y,z\n0,0,0,0\n1,0,nan,0\n", "finite numbers up to 1e6, unlike in row 2"),
    (b"t,x,y,z\n0,0,0,0\n2,0,0,0\n2,1,0,0\n", "by 1e-6 s or more, unlike in row 3"),
]


@pytest.mark.parametrize(("text", "remedy"), FILES)
def test_a_bad_file_is_told_without_what_is_in_it(tmp_path, text, remedy):
    path = tmp_path / "way.csv"
    if text is not None:
        path.write_bytes(text)
    with pytest.raises(ScenarioError) as caught:
        SampledTrajectory(model(), SampledTrajectoryConfig(file=str(path)))
    assert str(caught.value).startswith(f"load_trajectory.file = {path}: give ")
    assert remedy in str(caught.value)
    assert "secret" not in str(caught.value)
