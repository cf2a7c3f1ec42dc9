"""Steps that follow from stiffness, damping and motion, and what they do not resolve."""

import dataclasses
import warnings

import numpy as np
import pytest
from helpers import nightly_beyond

from drake_nonstop import (
    StepAction,
    StepCheck,
    compute_metrics,
    load_scenario,
    make_nonstop,
    simulate,
    verify_step,
)
from drake_nonstop.analysis.linearized_loop import LinearizedLoop
from drake_nonstop.loop.compiled_loop import CompiledLoop
from drake_nonstop.loop.equilibrium import on_reference
from drake_nonstop.mechanics.signal_layouts import by_name
from drake_nonstop.scenario.schema import ENGINES
from drake_nonstop.simulation.compiled_run import CompiledState
from drake_nonstop.simulation.metrics import METRICS
from drake_nonstop.simulation.moved_metrics import moved_metrics
from drake_nonstop.simulation.step_size import (
    SavedState,
    ShortFlights,
    difference,
    finer,
    with_step,
)
from drake_nonstop.validation import ScenarioError, ScenarioWarning

CONSTANT = "optimization_layer=ConstantParameters"
TURN = "load_trajectory.roll_pitch_yaw=[0, 0, 12.566]"
SLOW_SAMPLES = (
    *("control_period=0.1", "optimization_layer=NonstopOptimizer"),
    "optimization_layer.period=0.1",
)
IN_STEPS = "optimization_layer=NonstopOptimizer"  # ξ and A, and with them the references
IN_STEPS_TO_THE_CARRIERS = (
    *("phase=AccumulatedPhase", "carrier_trajectory.hold=velocity"),
    "carrier_controller=CarrierPid",
)


def at_start(*overrides):
    scenario = load_scenario("quintic", [CONSTANT, *overrides])
    nonstop = make_nonstop(scenario)
    return scenario, nonstop, nonstop.CreateDefaultContext()


def on_its_reference(*overrides):
    scenario, nonstop, context = at_start(*overrides)
    on_reference(nonstop, context)
    return scenario, nonstop, context


@pytest.mark.parametrize(
    ("exponent", "stiffness"),
    nightly_beyond(
        4,
        "studies",
        [
            *((2, 200), (4, 2000), (6, 200), (8.9, 2000), (2, 2000), (3.3, 200), (3.3, 2000)),
            *((4, 200), (5.2, 200), (5.2, 2000), (6, 2000), (7.5, 200), (7.5, 2000), (8.9, 200)),
        ],
    ),
)
def test_damping_makes_a_mode_fast(exponent, stiffness):
    """Of whatever strength: a tension ends at zero at ever smaller speeds."""
    damping = 10**exponent
    _, nonstop, context = on_its_reference(
        f"system.cable_damping={damping}", f"system.cable_stiffness={stiffness}"
    )
    mode = LinearizedLoop(nonstop, context, 0.01).fastest_mode
    # Along a cable the carrier's mass counts, and the load's inertia at its lever the most.
    if exponent < 7:
        assert mode == pytest.approx(182 * damping, rel=0.01)
    assert mode > 1e4


@pytest.mark.parametrize("damping", nightly_beyond(2, "studies", [1e4, 3e8, 1e5, 1e6]))
def test_steps_that_would_take_for_ever_are_refused(damping):
    with pytest.raises(ScenarioError, match=r"fastest mode = .* less stiffness, damping"):
        simulate(load_scenario("quintic", [CONSTANT, f"system.cable_damping={damping}"]))


def test_where_everything_is_resolved_the_step_stays_and_nothing_is_said(fleet):
    run, metrics = fleet.evaluated("quintic")
    assert run.step == 0.005
    assert run.unresolved == ()
    assert metrics["simulator"]["step_s"] == 0.005
    assert "half_step" not in metrics
    with warnings.catch_warnings():
        warnings.simplefilter("error", ScenarioWarning)
        simulate(load_scenario("quintic", ["simulation_duration=0.1"]))


def test_slow_samples_shorten_the_step():
    scenario = load_scenario("quintic", [*SLOW_SAMPLES, "simulation_duration=0.6"])
    said = "the commanded motion between the controllers' samples"
    with pytest.warns(ScenarioWarning, match=said) as warned:
        run = simulate(scenario)
    files = [warning.filename for warning in warned if warning.category is ScenarioWarning]
    assert files == [__file__]  # the user's line
    assert run.step <= 0.0025


@pytest.mark.nightly("flights")
def test_steps_of_slow_samples_move_no_metric_that_is_not_told():
    scenario = load_scenario("quintic", [*SLOW_SAMPLES, "simulation_duration=4"])
    with pytest.warns(ScenarioWarning, match="the commanded motion between"):
        run = simulate(scenario)
    finer = with_step(scenario.simulator_config, run.step / 5)
    fine = simulate(
        dataclasses.replace(scenario, simulator_config=finer), check_step=StepCheck.NOTHING
    )
    moves = moved_metrics(compute_metrics(run), compute_metrics(fine))
    assert not moves or run.unresolved


@pytest.mark.nightly("engines")
@pytest.mark.parametrize("engine", ENGINES)
def test_what_the_step_does_not_resolve_is_said(engine):
    overrides = [TURN, "simulation_duration=7", CONSTANT, f"engine={engine}"]
    run = simulate(
        load_scenario("quintic", [*overrides, *IN_STEPS_TO_THE_CARRIERS]),
        optimization_layer=load_scenario("quintic", [IN_STEPS]).optimization_layer,
    )
    assert run.unresolved[0].startswith("not resolved by steps of 5 ms: ")
    assert any("least tension" in line for line in run.unresolved)
    half_step = compute_metrics(run)["half_step"]
    assert half_step["step_s"] == pytest.approx(0.0025)
    value, finer = half_step["moved"]["cables.tension_min_N"]
    assert value == compute_metrics(run)["cables"]["tension_min_N"]
    assert abs(finer - value) > 0.02 * value


def test_growth_that_the_step_hides_is_said():
    """With steps of 2.5 ms this run diverges; with 5 ms it seems to fly."""
    overrides = [
        CONSTANT,
        "carrier_trajectory=MeasuredCarrierTrajectory",
        "carrier_controller=CarrierPid",
        "simulation_duration=0.5",
    ]
    (said,) = simulate(load_scenario("line", overrides)).unresolved
    assert said.startswith("at the start a small deviation grows by 11 1/s")


def slowly_turning():
    """Gains, a step, and growths in 1/s of the linearized loop; the carriers hardly orbit."""
    measured = ["carrier_trajectory=MeasuredCarrierTrajectory", "carrier_controller=CarrierPid"]
    gains = ["optimization_layer.frequency=0.01", *measured]
    step = "simulator_config.max_step_size=0.001"
    _, nonstop, context = at_start(*gains, step)
    loop = LinearizedLoop(nonstop, context, 0.01)
    (exact, stepped), (_, same) = map(loop.growths, (0.001, 1e-4))
    return gains, step, exact, stepped, same


def test_growth_of_the_linearized_loop_with_short_steps_is_the_exact_one():
    _, _, exact, stepped, same = slowly_turning()
    assert same == pytest.approx(exact, rel=1e-4)
    assert stepped == pytest.approx(exact, rel=0.05)
    assert exact > 1


@pytest.mark.nightly("flights")
def test_growth_of_the_linearized_loop_is_that_of_the_simulated_one():
    """The loop stays what it is linearized at."""
    gains, step, exact, _, _ = slowly_turning()
    scenario = load_scenario("quintic", [CONSTANT, *gains, step, "simulation_duration=2.4"])
    sizes = []
    for moved in (0.0, 1e-7):
        move = dataclasses.replace(
            scenario.load_trajectory, displacement=[moved, 0, 0], roll_pitch_yaw=[0, 0, moved]
        )
        run = simulate(
            dataclasses.replace(scenario, load_trajectory=move), check_step=StepCheck.NOTHING
        )
        sizes.append(run.signal("load_state")[:, 4:])
    apart = np.linalg.norm(sizes[1] - sizes[0], axis=1)
    late = np.maximum.accumulate(apart)
    assert np.log(late[-1] / late[-61]) / 0.6 == pytest.approx(exact, rel=0.15)


def test_a_live_run_in_doubt_is_said_to_be_without_a_second_flight():
    flown = []

    def after_step(simulator, nonstop):
        flown.append(simulator.get_context().get_time())
        return StepAction.CONTINUE

    soon = ["load_trajectory.start_time=0", "load_trajectory.move_time=4"]
    overrides = [TURN, *soon, "simulation_duration=2", IN_STEPS, *IN_STEPS_TO_THE_CARRIERS]
    scenario = load_scenario("quintic", overrides)
    run = simulate(scenario, after_step=after_step, check_step=StepCheck.PARTS)
    assert len(run.unresolved) == 1
    assert "flown again with half the step, differ" in run.unresolved[0]
    assert np.all(np.diff(flown) >= 0)
    assert run.half_step is None


def test_a_verified_run_says_what_it_was_compared_with():
    run = verify_step(simulate(load_scenario("quintic", [CONSTANT, "simulation_duration=0.1"])))
    assert run.half_step == {"step_s": 0.0025, "moved": {}}
    assert run.unresolved == ()


@pytest.mark.parametrize("scheme", ["explicit_euler", "runge_kutta2"])
def test_schemes_of_low_order_are_always_verified(scheme):
    overrides = [
        *(CONSTANT, "simulation_duration=0.05"),
        f"simulator_config.integration_scheme={scheme}",
        "simulator_config.max_step_size=0.001",
    ]
    assert simulate(load_scenario("quintic", overrides)).half_step is not None


@pytest.mark.parametrize(
    "overrides", [(IN_STEPS, "optimization_layer.speed_bound=0.9"), (CONSTANT, "control_period=0")]
)
def test_a_short_flight_repeats_its_part_of_the_run(overrides):
    scenario = load_scenario("quintic", ["simulation_duration=0.32", *overrides])
    states = []

    def after_step(simulator, nonstop):
        context = nonstop.GetMyContextFromRoot(simulator.get_context())
        if abs(context.get_time() - 0.2) < 1e-9 and not states:
            states.append(SavedState.of(context))
        return StepAction.CONTINUE

    run = simulate(scenario, after_step=after_step, check_step=StepCheck.NOTHING)
    context = run.diagram.CreateDefaultContext()
    flights = ShortFlights(run.diagram, context, scenario.simulator_config)
    for _ in range(2):  # one flight leaves nothing for the next
        flown = flights.fly(states[0], 0.1)
        np.testing.assert_allclose(flown.tensions, run.signal("tensions")[21:31], atol=1e-10)
    finer = flights.fly(states[0], 0.1, 2)
    assert 0 < difference(flown, finer) < 0.1


@pytest.mark.parametrize(
    ("name", "overrides", "samples"),
    [
        ("quintic", ("optimization_layer.speed_bound=0.9",), 20),
        ("quintic", (CONSTANT, "control_period=0.02"), 5),
        ("aircraft_transfer", (), 0),
    ],
)
def test_a_compiled_flight_with_half_the_step_is_that_of_the_diagram(name, overrides, samples):
    scenario = load_scenario(name, [*overrides])
    config, nonstop = with_step(scenario.simulator_config, 0.005), make_nonstop(scenario)
    loop = CompiledLoop(nonstop, config, scenario.control_period, signal_period=0.01, samples=0)
    context = nonstop.CreateDefaultContext()
    flight = loop.fly(context)
    flight.fly(samples)
    state = CompiledState(flight.time, flight.state, samples, flight, loop)
    expected = ShortFlights(nonstop, context, config).fly(state, 0.04, 2)
    for _ in range(2):  # one flight leaves nothing for the next
        half = state.fly(0.04, finer(config, 2))
        for own, others in zip(half, expected, strict=True):
            np.testing.assert_allclose(own, others, rtol=1e-9, atol=1e-9)
    whole = state.fly(0.04, config)
    assert difference(half, whole) > 1e-9
    flight.go_to(samples, state.state)
    signals = np.concatenate(
        [flight.advance()[0] for _ in range(len(whole.time) // loop.shown_per_sample)]
    )
    np.testing.assert_allclose(
        whole.tensions, by_name(loop.signals, signals)["tensions"], rtol=1e-12
    )


def test_what_counts_as_moved():
    metrics = compute_metrics(simulate(load_scenario("quintic", ["simulation_duration=0.1"])))

    def moved(path, change):
        *groups, name = path.split(".")
        other = {
            **metrics,
            groups[0]: {**metrics[groups[0]], name: metrics[groups[0]][name] + change},
        }
        return [move.metric.path for move in moved_metrics(metrics, other)]

    for path, small, large in (
        ("load.position_error_max_m", 0.9e-3, 1.1e-3),
        ("carriers.separation_min_m", 0.9e-3, 1.1e-3),
        ("carriers.speed_max_m_s", 0.01, 0.02),
        ("cables.tension_min_N", 0.04, 0.07),
        ("cables.slack_time_s", 0.019, 0.021),
        ("carriers.time_below_bound_s", 0.019, 0.021),
        ("load.orientation_error_max_rad", 0.9e-3, 1.1e-3),
        ("optimizer.solved", 2, 3),
        ("carriers.turn_radius_min_m", 1e-3, 0.02),
    ):
        assert moved(path, small) == []
        assert moved(path, large) == [path]
    assert moved_metrics(metrics, {**metrics, "wall_s": 1e3, "simulator": {"step_s": 1.0}}) == []
    for metric in METRICS:
        is_told = metric.value(metrics) is not None
        # A governor, a layer whose tightening is "auto", and limits that it is asked for.
        more = ("reference_delay", "predicted_speed_margin", "missed_limits")
        needs_more = metric.may_be_left_out or any(name in metric.path for name in more)
        assert is_told or needs_more or "solve" in metric.path
