"""The compiled loop shows what its diagram shows, to rounding."""

import gc
import json
import weakref
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
import pytest
from helpers import nightly_beyond
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator
from pydrake.systems.framework import EventStatus, LeafSystem
from registries import LIVELY, LOOPS, VARIANTS

from drake_nonstop import (
    DisturbanceForceConfig,
    ScenarioError,
    load_scenario,
    make_nonstop,
    scenario_names,
    set_equilibrium,
    set_parameter,
    simulate,
)
from drake_nonstop.blocks.load_disturbance import DisturbanceForce
from drake_nonstop.loop.step import with_largest_step
from drake_nonstop.scenario.overrides import changed
from drake_nonstop.systems.compiled_loop import CompiledLoop, reason_against
from drake_nonstop.systems.native import compiler
from drake_nonstop.systems.tracing import NotFiniteError

PROGRAM = "optimization_layer=NlpLayer"
CONSTANT = "optimization_layer=ConstantParameters"
DURATION = 0.24  # s, a multiple of all control periods


def made(scenario):
    diagram = make_nonstop(scenario)
    return diagram, diagram.CreateDefaultContext()


def traced(scenario, **options):
    diagram, context = made(scenario)
    config = with_largest_step(scenario.simulator_config, diagram, context)
    shown = min(0.01, scenario.control_period)
    loop = CompiledLoop(diagram, config, scenario.control_period, signal_period=shown, **options)
    return loop, context


def assert_equal(scenario, loop, context):
    scenario = changed(scenario, [f"simulation_duration={DURATION}"])
    times, signals = loop.run(context, DURATION)
    run = simulate(scenario, engine="diagram")
    assert run.engine == "diagram"
    every = round(run.time[1] / times[1])
    np.testing.assert_allclose(times[::every], run.time, atol=1e-12)
    compared = 0
    for name, expected in run.signals.items():
        shown = signals[name.partition(".")[2]][::every]
        np.testing.assert_allclose(shown, expected, atol=1e-9 * (1 + np.abs(expected).max()))
        compared += 1
    assert compared >= 20


# A receding horizon, and aircraft in a wind; `tests/run` compares whole flights.
SHIPPED = dict.fromkeys(["quintic", "aircraft_transfer_gusty", *scenario_names()])


@pytest.mark.parametrize("name", nightly_beyond(2, "engines", SHIPPED))
def test_shipped_scenarios_are_the_same(name):
    scenario = load_scenario(name)
    assert_equal(scenario, *traced(scenario, compiles=False))


BY_DAY = ["phase-PaperPhase", "carrier_dynamics-LimitedCarriers"]


@pytest.mark.parametrize("name", nightly_beyond(2, "engines", dict.fromkeys([*BY_DAY, *VARIANTS])))
def test_each_variant_flies_the_same_or_is_named(name):
    box, kind = VARIANTS[name]
    scenario, others = LOOPS.get(kind.__name__, ("quintic", []))
    layer = [] if box == "optimization_layer" or others else [CONSTANT]
    fields = json.dumps(LIVELY.get(kind.__name__, {}))
    made = load_scenario(scenario, [*layer, *others, f"{box}=!{kind.__name__} {fields}"])
    diagram = make_nonstop(made)
    reason = reason_against(diagram, made.simulator_config, made.control_period)
    if reason:
        assert reason.startswith(f"{box} = {kind.__name__}: it has no equations")
    else:
        assert_equal(made, *traced(made, compiles=False))


class Drift(LeafSystem):
    """Has a state that no time alone tells."""

    def __init__(self, model):
        super().__init__()
        self.DeclareContinuousState(6)
        self.DeclareVectorOutputPort("disturbance_wrench", 6, self.calc, {self.all_state_ticket()})

    def calc(self, context, output):
        output.SetFromVector(context.get_continuous_state_vector().CopyToVector())

    def DoCalcTimeDerivatives(self, context, derivatives):  # noqa: N802
        derivatives.SetFromVector(np.full(6, 0.1))


@pytest.mark.parametrize(
    ("overrides", "others", "said"),
    [
        (["control_period=0"], {}, "control_period = 0: it goes from sample to sample"),
        (["load_feedback=!NoisyFeedback {delay: 0.015, period: 0.015}"], {}, "every 0.015 s, no"),
        (["simulator_config.use_error_control=true"], {}, "without error control"),
        ([], {"load_disturbance": Drift}, "load_disturbance = Drift: it has no equations"),
        ([], {"inputs": ["speed_bound_command"]}, "inputs = speed_bound_command"),
    ],
)
def test_what_cannot_be_compiled_is_named(overrides, others, said):
    scenario = load_scenario("quintic", [CONSTANT, *overrides])
    diagram = make_nonstop(scenario, **others)
    reason = reason_against(diagram, scenario.simulator_config, scenario.control_period)
    assert said in reason
    with pytest.raises(ScenarioError, match="simulate its diagram"):
        CompiledLoop(diagram, scenario.simulator_config, scenario.control_period)


def test_times_and_signals_that_do_not_fit_are_named_with_the_remedy():
    scenario = load_scenario("quintic", [CONSTANT])
    loop, context = traced(scenario, compiles=False)
    make = partial(CompiledLoop, loop.diagram, scenario.simulator_config)
    flight = loop.fly(context)
    flight.start()
    for call, told, remedy in (
        (lambda: loop.run(context, 0.015), "duration = 0.015", "a multiple of the control"),
        (lambda: loop.run(context, np.nan), "duration = nan", "a multiple of the control"),
        (lambda: make(0.01, signal_period=0.003), "signal_period = 0.003", "a whole part of the"),
        (lambda: make(0.01, signals=["load_stat"]), "signals = load_stat", "load_state"),
        (lambda: make(0.02), "every 0.01 s", "multiple of the control period"),
        (lambda: flight.advance(0), "samples = 0", "give 1 or more"),
    ):
        with pytest.raises(ScenarioError) as error:
            call()
        assert told in str(error.value)
        assert remedy in str(error.value).partition(told)[2]


def test_parameters_are_inputs_of_one_trace():
    """Values of a context count, as they do in the diagram, without another trace."""
    scenario = load_scenario("quintic", [CONSTANT])
    loop, context = traced(scenario, compiles=False)
    values = {
        "carrier_controller.position_gain": 800.0,
        "carrier_controller.velocity_gain": 8.0,
        "wrench_controller.position_gain": 6.0,
        "optimization_layer.amplitude": 1.1,
        "optimization_layer.frequency": 2.1,
    }
    for path, value in values.items():
        set_parameter(loop.diagram, context, path, value)
    set_equilibrium(loop.diagram, context)
    other = changed(scenario, [f"{path}={value}" for path, value in values.items()])
    assert_equal(other, loop, context)


OTHER_NUMBERS = [
    *("simulated.load_mass=1.07", "simulated.load_drag=0.2", "random_seed=3"),
    *("load_trajectory.start_time=0.05", "wind.gust=1", "wind.seed=4", "load_feedback.seed=2"),
    *("optimization_layer.frequency=2.2", "carrier_controller.velocity_gain=9"),
    "load_disturbance=!DisturbanceForce {gust_force: 1}",
]
OTHER_EQUATIONS = [
    "wind=!SteadyWind {velocity: [1, 0, 0]}",
    "load_feedback=!NoisyFeedback {delay: 0.02}",
    "simulated.attachments=[[0.4, 0, 0], [0, 0.5, 0], [-0.5, 0, 0], [0, -0.5, 0]]",
    "carrier_trajectory.hold=velocity",
    "carrier_controller.integral_gain=1",
    "pattern=Carousel",
    PROGRAM,
    "wrench_controller=PaperWrenchController",
]


def test_loops_of_equal_equations_share_their_functions():
    random = ["wind=GustyWind", "load_feedback=NoisyFeedback", "load_disturbance=DisturbanceForce"]
    scenario = load_scenario("quintic", [CONSTANT, *random])
    loop, other = (
        traced(changed(scenario, overrides), compiles=False)[0] for overrides in ([], OTHER_NUMBERS)
    )
    assert loop.functions is other.functions
    assert loop.sample is other.sample
    for override in OTHER_EQUATIONS:
        other, _ = traced(changed(scenario, [override]), compiles=False)
        assert loop.functions is not other.functions, override
        assert loop.equations.structure.key != other.equations.structure.key, override
    smaller = [*OTHER_NUMBERS, "simulator_config.max_step_size=0.0025"]
    other, _ = traced(changed(scenario, smaller), compiles=False)
    assert loop.sample is not other.sample


class FailingPush(DisturbanceForce):
    """Is no number after 0.1 s."""

    late = np.nan

    def precomputed_inputs(self, names, times):
        rows = super().precomputed_inputs(names, times)
        return [np.where(times[:, None] > 0.1 + 1e-9, self.late, own) for own in rows]


class HugePush(FailingPush):
    """Is larger than any number of a flight after 0.1 s."""

    late = 1e200


def loop_with(scenario, *, compiles=False, **replacements):
    diagram = make_nonstop(scenario, **replacements)
    return CompiledLoop(diagram, scenario.simulator_config, 0.01, compiles=compiles)


@pytest.mark.parametrize("block", [FailingPush, HugePush])
@pytest.mark.parametrize("compiles", [False, True])
def test_what_becomes_no_number_in_flight_ends_it(compiles, block):
    scenario, config = load_scenario("quintic", [CONSTANT]), DisturbanceForceConfig(gust_force=1.0)
    push = partial(block, config=config)
    loop = loop_with(scenario, compiles=compiles, load_disturbance=push)
    assert loop.is_compiled == (compiles and compiler() is not None)
    flight = loop.fly(loop.diagram.CreateDefaultContext())
    flight.start()
    while flight.samples < 10:
        flight.advance(100)
    state = flight.state
    with pytest.raises(NotFiniteError):
        flight.advance(100)
    assert flight.samples == 10
    np.testing.assert_array_equal(flight.state, state)


class EndingSource(DisturbanceForce):
    """Is known until 0.2 s."""

    def precomputed_inputs(self, names, times):
        if np.max(times) > 0.2 + 1e-9:
            raise ValueError("nothing is known after 0.2 s")
        return super().precomputed_inputs(names, times)


@pytest.mark.parametrize("layer", [CONSTANT, PROGRAM])
def test_a_source_is_read_no_longer_than_the_flight(layer):
    loop = loop_with(load_scenario("quintic", [layer]), load_disturbance=EndingSource)
    times, _ = loop.run(loop.diagram.CreateDefaultContext(), 0.2)
    assert len(times) == 21
    with pytest.raises(ValueError, match="nothing is known"):
        loop.run(loop.diagram.CreateDefaultContext(), 0.3)


def test_threads_fly_one_loop_at_once():
    loop, context = traced(load_scenario("quintic", [CONSTANT]), compiles=False)
    expected = loop.run(context, DURATION)[1]
    with ThreadPoolExecutor(4) as pool:
        runs = [*pool.map(lambda _: loop.run(context, DURATION)[1], range(8))]
    for signals in runs:
        for name, values in expected.items():
            np.testing.assert_array_equal(signals[name], values, err_msg=name)


def test_signals_of_steps_are_those_of_a_log_of_each_step():
    scenario = load_scenario("quintic", [CONSTANT, "simulator_config.max_step_size=0.004"])
    diagram, context = made(scenario)
    loop = CompiledLoop(
        diagram,
        scenario.simulator_config,
        0.01,
        signals=["parameters"],
        step_signals=["load_state", "carrier_state"],
        compiles=False,
    )
    np.testing.assert_allclose(loop.step_ends, [0.004, 0.008, 0.01])
    flight = loop.fly(context)
    flight.start()
    signals, steps = flight.advance(6)
    assert signals.shape == (6, 2)
    simulator = Simulator(diagram, context)
    ApplySimulatorConfig(scenario.simulator_config, simulator)
    shown = []

    def show(root):
        if root.get_time() > 0:
            shown.append(
                np.concatenate(
                    [diagram.GetOutputPort(name).Eval(root) for name in loop.step_signals]
                )
            )
        return EventStatus.Succeeded()

    simulator.set_monitor(show)
    simulator.AdvanceTo(0.06)
    np.testing.assert_allclose(steps, shown, rtol=1e-9, atol=1e-9)


def test_what_loops_share_keeps_no_diagram():
    scenario = load_scenario("quintic", [CONSTANT])
    loop = loop_with(scenario)
    loop.sensitivities(loop.diagram.CreateDefaultContext(), 0.02)
    loop.run(loop.diagram.CreateDefaultContext(), 0.02)
    diagram = weakref.ref(loop.diagram)
    del loop
    gc.collect()
    assert diagram() is None
