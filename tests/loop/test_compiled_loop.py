"""What a compiled loop refuses, shares, reads and keeps; `tests/run` compares its flights."""

from functools import partial

import numpy as np
import pytest

from drake_nonstop import (
    CompiledLoop,
    DisturbanceForceConfig,
    ScenarioError,
    changed,
    load_scenario,
    make_nonstop,
)
from drake_nonstop.blocks.load_disturbance import DisturbanceForce

PROGRAM = "optimization_layer=NlpLayer"
CONSTANT = "optimization_layer=ConstantParameters"


def loop_of(scenario, *, compiles=False, **replacements):
    diagram = make_nonstop(scenario, **replacements)
    config = scenario.simulator_config
    return CompiledLoop(diagram, config, scenario.control_period, compiles=compiles)


def test_times_and_signals_that_do_not_fit_are_named_with_the_remedy():
    scenario = load_scenario("quintic", [CONSTANT])
    loop = loop_of(scenario)
    context = loop.diagram.CreateDefaultContext()
    bound = "speed_bound_command"
    make = partial(CompiledLoop, loop.diagram, load_scenario("quintic").simulator_config)
    flight = loop.fly(context)
    flight.start()
    for call, told, remedy in (
        (lambda: loop.run(context, 0.015), "duration = 0.015", "a multiple of the control"),
        (lambda: loop.run(context, np.nan), "duration = nan", "a multiple of the control"),
        (lambda: make(0.01, signal_period=0.003), "signal_period = 0.003", "a whole part of the"),
        (lambda: make(0.01, signals=["load_stat"]), "signals = load_stat", "load_state"),
        (lambda: loop_of(scenario, inputs=[bound]), f"inputs = {bound}", "simulate its diagram"),
        (lambda: make(0.02), "every 0.01 s", "multiple of the control period"),
        (lambda: flight.advance(0), "samples = 0", "give 1 or more"),
    ):
        with pytest.raises(ScenarioError) as error:
            call()
        assert told in str(error.value)
        assert remedy in str(error.value).partition(told)[2]


OTHER_NUMBERS = [
    *("simulated.load_mass=1.07", "simulated.load_drag=0.2", "random_seed=3"),
    "simulated.attachments=[[0.4, 0, 0], [0, 0.5, 0], [-0.5, 0, 0], [0, -0.5, 0]]",
    *("load_trajectory.start_time=0.05", "wind.gust=1", "wind.seed=4", "load_feedback.seed=2"),
    *("optimization_layer.frequency=2.2", "carrier_controller.velocity_gain=9"),
    "load_disturbance=!DisturbanceForce {gust_force: 1}",
]
OTHER_EQUATIONS = [
    "wind=!SteadyWind {velocity: [1, 0, 0]}",
    "system.attachments=[[0.4, 0, 0], [0, 0.5, 0], [-0.5, 0, 0], [0, -0.5, 0]]",
    "carrier_trajectory.hold=velocity",
    "pattern=Carousel",
    PROGRAM,
    "wrench_controller=PaperWrenchController",
]


def test_loops_of_equal_equations_share_their_functions():
    random = ["wind=GustyWind", "load_feedback=NoisyFeedback", "load_disturbance=DisturbanceForce"]
    scenario = load_scenario("quintic", [CONSTANT, *random])
    loop, other = (loop_of(changed(scenario, overrides)) for overrides in ([], OTHER_NUMBERS))
    assert loop.functions is other.functions
    assert loop.sample is other.sample
    for override in OTHER_EQUATIONS:
        other = loop_of(changed(scenario, [override]))
        assert loop.functions is not other.functions, override
        assert loop.equations.structure.key != other.equations.structure.key, override
    smaller = [*OTHER_NUMBERS, "simulator_config.max_step_size=0.0025"]
    assert loop.sample is not loop_of(changed(scenario, smaller)).sample


class Push(DisturbanceForce):
    """Is no number after 0.1 s."""

    def precomputed_inputs(self, names, times):
        rows = super().precomputed_inputs(names, times)
        return [np.where(times[:, None] > 0.1 + 1e-9, np.nan, own) for own in rows]


class EndingPush(DisturbanceForce):
    """Is not known after 0.1 s."""

    def precomputed_inputs(self, names, times):
        if np.max(times) > 0.1 + 1e-9:
            raise ValueError("nothing is known after 0.1 s")
        return super().precomputed_inputs(names, times)


@pytest.mark.parametrize("compiles", [False, True])
def test_what_becomes_no_number_in_flight_ends_it(compiles):
    push = partial(Push, config=DisturbanceForceConfig(gust_force=1.0))
    scenario = load_scenario("quintic", [CONSTANT])
    loop = loop_of(scenario, compiles=compiles, load_disturbance=push)
    flight = loop.fly(loop.diagram.CreateDefaultContext())
    flight.start()
    while flight.samples < 10:
        flight.advance(100)
    state = flight.state
    with pytest.raises(ArithmeticError, match="not finite, or beyond"):
        flight.advance(100)
    assert flight.samples == 10
    np.testing.assert_array_equal(flight.state, state)


@pytest.mark.parametrize("layer", [CONSTANT, PROGRAM])
def test_a_source_is_read_no_longer_than_the_flight(layer):
    loop = loop_of(load_scenario("quintic", [layer]), load_disturbance=EndingPush)
    times, _ = loop.run(loop.diagram.CreateDefaultContext(), 0.1)
    assert len(times) == 11
    with pytest.raises(ValueError, match="nothing is known"):
        loop.run(loop.diagram.CreateDefaultContext(), 0.2)
