"""A trajectory that is slowed down where no ξ and A keep the speed bound with it."""

import numpy as np
import pytest
from helpers import difference, model, nightly_beyond, output
from pydrake.autodiffutils import AutoDiffXd
from pydrake.common.value import Value
from pydrake.systems.framework import LeafSystem

from drake_nonstop import (
    ReferencePreview,
    StepCheck,
    compute_metrics,
    dump_scenario,
    load_scenario,
    make_nonstop,
    parse_scenario,
    simulate,
)
from drake_nonstop.analysis.speed_check import check_speeds
from drake_nonstop.analysis.task import task_of
from drake_nonstop.blocks.load_trajectory import (
    ConstantVelocityMove,
    RestToRest,
    RestToRestConfig,
)
from drake_nonstop.blocks.reference_governor import ReferenceGovernor
from drake_nonstop.loop import assembly
from drake_nonstop.mechanics.signals import CarrierStates
from drake_nonstop.optimization.stretched_time import PathDelay
from drake_nonstop.systems.wiring import output_sizes
from drake_nonstop.validation import ScenarioError, ScenarioWarning

# A line with ξ and A that do not change, and a bound that their orbit keeps at rest only.
FAST_LINE = [
    "simulation_duration=6",
    "load_trajectory.start_time=1",
    "load_trajectory.move_time=2",
    "load_trajectory.velocity=[0.5, 0, 0]",
    "optimization_layer.speed_bound=0.25",
]
GOVERNED = "reference_governor={change_time: 0.5, largest_rate: 1.3}"


def governor():
    rates = np.zeros(20)
    rates[4:14] = 0.4
    block = RestToRest(model(), RestToRestConfig(displacement=[1, 2, 3], roll_pitch_yaw=[0, 0, 1]))
    preview = block.GetOutputPort("reference_preview").Eval(block.CreateDefaultContext())
    return ReferenceGovernor(preview, PathDelay(0.5, rates)), preview


@pytest.fixture(scope="module")
def flights():
    """Of the fast line, without a governor and with one."""
    scenarios = [
        load_scenario("line_without_optimization", [*FAST_LINE, *o]) for o in ([], [GOVERNED])
    ]
    return [simulate(scenario, check_step=StepCheck.NOTHING) for scenario in scenarios]


def test_its_signals_are_those_of_the_delayed_motion():
    block, preview = governor()
    assert output_sizes(block) == {
        "reference": 22,
        "reference_higher_rates": 6,
        "reference_preview": None,
        "reference_delay": 1,
    }
    context = block.CreateDefaultContext()
    ahead = block.GetOutputPort("reference_preview").Eval(context)
    clone = block.Clone()
    again = clone.GetOutputPort("reference_preview").Eval(clone.CreateDefaultContext())
    np.testing.assert_array_equal(again(3.3), ahead(3.3))
    times = [0.0, 2.0, 4.3, 30.0]
    for time in times:
        context.SetTime(time)
        reference, (delay,) = (output(block, context, n) for n in ("reference", "reference_delay"))
        np.testing.assert_array_equal(ahead(time), reference)
        np.testing.assert_array_equal(reference[:7], preview(time - delay)[:7])
    np.testing.assert_array_equal(ahead.at(times), [ahead(time) for time in times])
    assert delay == pytest.approx(0.5 * 10 * 0.4)


def test_its_higher_rates_are_differences_and_left_out_where_they_are_not_known():
    block, preview = governor()
    context = block.CreateDefaultContext()
    ahead = block.GetOutputPort("reference_preview").Eval(context)
    for time in (2.1, 4.3, 6.8, 30.0):  # between the knots of the delay
        context.SetTime(time)
        rates = difference(ahead, time, 1e-3)
        expected = np.concatenate([rates[13:16], rates[19:22]])
        found = output(block, context, "reference_higher_rates")
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5)
    unknown = ReferencePreview(preview.reference)
    assert not ReferenceGovernor(unknown, PathDelay(0.5, np.zeros(9))).HasOutputPort(
        "reference_higher_rates"
    )


def test_it_does_not_differentiate_by_time():
    block, _ = governor()
    converted = block.ToAutoDiffXd()
    context = converted.CreateDefaultContext()
    context.SetTime(AutoDiffXd(2.0))
    value = converted.GetOutputPort("reference").Eval(context)[4].value()
    own = block.CreateDefaultContext()
    own.SetTime(2.0)
    assert value == output(block, own, "reference")[4]
    context.SetTime(AutoDiffXd(2.0, [1.0]))
    with pytest.raises(
        ScenarioError, match=r"time of .* = a number with derivatives: the governor"
    ):
        converted.GetOutputPort("reference").Eval(context)


@pytest.mark.slow
def test_a_bound_that_is_missed_at_full_speed_is_kept_and_the_load_arrives_late(flights):
    without, governed = flights
    slowest = [
        np.min(np.linalg.norm(CarrierStates.view(run.steps["carrier_state"]).velocities, axis=-1))
        for run in flights
    ]
    assert slowest[0] < 0.9 * 0.25
    assert slowest[1] > 0.25
    figures = [compute_metrics(run) for run in flights]
    assert figures[0]["carriers"]["time_below_bound_s"] > 0.05
    assert figures[1]["carriers"]["time_below_bound_s"] == 0
    assert figures[0]["load"]["reference_delay_max_s"] is None
    delays = governed.signal("reference_delay")[:, 0]
    assert figures[1]["load"]["reference_delay_max_s"] == np.max(delays) > 0.5
    assert figures[1]["load"]["reference_delay_final_s"] == delays[-1] < np.max(delays)
    for run in flights:  # 1 m away
        assert run.signal("load_state")[-1, 4] == pytest.approx(1.0, abs=1e-3)
    middle = np.searchsorted(governed.time, 3.0)
    assert governed.signal("load_state")[middle, 4] < without.signal("load_state")[middle, 4] - 0.1
    largest = np.max(np.linalg.norm(governed.signal("tracking_error")[:, 3:6], axis=1))
    assert largest < 4e-5  # without the reference's higher rates 6e-5


@pytest.mark.nightly("flights")
@pytest.mark.slow
def test_check_looks_at_the_motion_that_the_governor_lets_pass():
    tasks = [
        task_of(load_scenario("line_without_optimization", [*FAST_LINE, *o]))
        for o in ([], [GOVERNED])
    ]
    assert [check_speeds(task).is_feasible for task in tasks] == [False, True]


@pytest.mark.nightly("flights")
@pytest.mark.slow
def test_it_slows_down_for_the_margin_that_is_computed(monkeypatch):
    margins = []

    def recorded(model, config, trajectory, layer, duration, *wind):
        margins.append(layer.speed_margin)
        return trajectory

    monkeypatch.setattr(assembly, "governed", recorded)
    scenario = load_scenario("three_carriers", [GOVERNED, "optimization_layer.tightening=auto"])
    make_nonstop(scenario, at_equilibrium=False)
    assert len(margins) == 1
    assert margins[0] > 0


def test_a_motion_that_needs_none_is_the_same_to_the_bit():
    overrides = ["simulation_duration=0.1", "optimization_layer=ConstantParameters"]
    runs = [simulate(load_scenario("quintic", [*overrides, *o])) for o in ([], [GOVERNED])]
    loop = make_nonstop(runs[1].scenario)
    assert type(loop.GetSubsystemByName("load_trajectory")) is RestToRest
    for name in runs[0].signals:
        np.testing.assert_array_equal(runs[0].signal(name), runs[1].signal(name))
    assert compute_metrics(runs[1])["load"]["reference_delay_max_s"] == 0


def test_a_scenario_has_none_unless_it_is_given_and_can_be_written():
    assert load_scenario("quintic").reference_governor is None
    assert "governor" not in dump_scenario(load_scenario("quintic"))
    scenario = load_scenario("quintic", ["reference_governor.least_rate=0.5"])
    assert scenario.reference_governor.largest_rate == 1.1
    assert parse_scenario(dump_scenario(scenario)) == scenario


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        (
            ["reference_governor.least_rate=0"],
            "reference_governor.least_rate = 0.0: give 0.01 to 1",
        ),
        (
            ["reference_governor.largest_rate=3"],
            "reference_governor.largest_rate = 3.0: give 1 to 2",
        ),
        (
            ["reference_governor.change_time=0.01"],
            "reference_governor.change_time = 0.01: give at least 0.1 s",
        ),
        (
            [
                "reference_governor={}",
                "pattern=ConstantSpread",
                "optimization_layer.amplitude=0",
                "load_trajectory=SteadyTurn",
            ],
            "reference_governor = with pattern = ConstantSpread: give a pattern with orbits, or",
        ),
    ],
)
def test_what_cannot_be_used_is_told(overrides, said):
    scenario = load_scenario("quintic", ["optimization_layer=ConstantParameters", *overrides])
    with pytest.raises(ScenarioError) as error:
        make_nonstop(scenario)
    assert str(error.value).startswith(said)


class OwnTrajectory(LeafSystem):
    """A load at rest, of which a preview is known until a time, or not at all."""

    def __init__(self, end_time):
        super().__init__()
        rest = np.eye(22)[0]
        self.DeclareVectorOutputPort("reference", 22, lambda c, output: output.SetFromVector(rest))
        preview = ReferencePreview(lambda time: rest, end_time=end_time or 0.0)
        if end_time is not None:
            self.DeclareAbstractOutputPort(
                "reference_preview", lambda: Value(preview), lambda c, o: o.set_value(preview)
            )


def test_the_motion_has_to_be_known_for_ever():
    scenario = load_scenario("quintic", ["optimization_layer=ConstantParameters", GOVERNED])
    for end_time, said in (
        (None, "give this block, without inputs, an output reference_preview of a Refer"),
        (9.0, "give a reference_preview that is known for ever, of end_time inf"),
    ):
        with pytest.raises(ScenarioError) as error:
            make_nonstop(scenario, load_trajectory=lambda model, end=end_time: OwnTrajectory(end))
        start = "reference_governor = with load_trajectory = OwnTrajectory: "
        assert str(error.value).startswith(start + said)
    with pytest.raises(ScenarioError, match=r"^load_trajectory = None: give a block for load_traj"):
        make_nonstop(scenario, load_trajectory=None)
    make_nonstop(
        scenario, load_trajectory=lambda model: OwnTrajectory(np.inf), at_equilibrium=False
    )


def test_a_bound_that_no_rate_keeps_is_told_and_the_motion_stays():
    overrides = [*FAST_LINE, "optimization_layer.speed_bound=3", GOVERNED]
    scenario = load_scenario("line_without_optimization", overrides)
    with pytest.warns(ScenarioWarning, match="from 0.0 s of the motion on even a load at rest"):
        loop = make_nonstop(scenario)
    assert type(loop.GetSubsystemByName("load_trajectory")) is ConstantVelocityMove


def test_a_least_rate_that_is_too_fast_is_told():
    overrides = [*FAST_LINE, GOVERNED, "reference_governor.least_rate=0.95"]
    with pytest.warns(ScenarioWarning, match=r"^reference_governor.least_rate = 0.95: at .* it is"):
        make_nonstop(load_scenario("line_without_optimization", overrides))


AIRCRAFT = [  # a transfer that is too fast in the wind, with ξ and A that do not change
    "simulation_duration=40",
    "load_trajectory.displacement=[20, 0, 0]",
    "load_trajectory.start_time=2",
    "load_trajectory.move_time=30",
    "optimization_layer.frequency=0.595",
    "optimization_layer.speed_bound=1.4 V_s",
    GOVERNED,
]


BELIEVED = [
    ("!SteadyWind {velocity: [-1, 0, 0]}", True, "KnownWind"),
    ("!SteadyWind {velocity: [-1, 0, 0]}", False, "NoWind"),
    ("!SteadyWind {velocity: [-1, 0, 0], start_time: 33}", False, "KnownWind"),
    # At the load, 50 m above the ground: 1 and 0.25 m/s.
    (
        "!WindProfile {velocity: [-0.25, 0, 0], exponent: 0.86, ground_height: -50}",
        True,
        "KnownWind",
    ),
    ("!WindProfile {velocity: [-0.25, 0, 0], exponent: 0, ground_height: -50}", False, "KnownWind"),
    ("!SteadyWind {velocity: [1, 0, 0]}", False, "KnownWind"),
]


@pytest.mark.parametrize(("wind", "is_slowed", "estimator"), nightly_beyond(4, "studies", BELIEVED))
def test_the_wind_that_is_believed_counts_for_aircraft(wind, is_slowed, estimator):
    settings = [*AIRCRAFT, f"wind={wind}", f"wind_estimator={estimator}"]
    scenario = load_scenario("aircraft_transfer", settings)
    loop = make_nonstop(scenario, at_equilibrium=False)
    trajectory = loop.GetSubsystemByName("load_trajectory")
    assert (type(trajectory) is ReferenceGovernor) == is_slowed


class OwnWind(LeafSystem):
    """Some wind, which a state or an input tells."""

    def __init__(self, source):
        super().__init__()
        if source == "state":
            self.DeclareDiscreteState(3)
        else:
            port = self.DeclareVectorInputPort("tensions", 4)
        for name, size in (("wind", 12), ("load_wind", 3), ("mean_wind", 3)):

            def calc(context, output, size=size):
                if source != "state":
                    port.Eval(context)
                output.SetFromVector(np.zeros(size))

            self.DeclareVectorOutputPort(name, size, calc)


@pytest.mark.parametrize("source", ["state", "input"])
def test_the_wind_has_to_be_known_before_the_run(source):
    scenario = load_scenario("aircraft_transfer", AIRCRAFT)
    with pytest.raises(ScenarioError) as error:
        make_nonstop(scenario, at_equilibrium=False, wind=lambda model: OwnWind(source))
    assert str(error.value) == (
        "reference_governor = with wind = OwnWind: its mean_wind is not known before the run; "
        "let it follow from time and load_state alone, or leave reference_governor out"
    )


def test_less_wind_is_a_remedy_of_aircraft_that_do_not_fly_at_rest():
    wind = "wind.velocity=[6, 0, 0]"
    scenario = load_scenario("aircraft_transfer", [*AIRCRAFT, "wind=SteadyWind", wind])
    said = r"even a load at rest .* higher ones of max_lift_share, .*, or less wind$"
    with pytest.warns(ScenarioWarning, match=said):
        make_nonstop(scenario, at_equilibrium=False)
