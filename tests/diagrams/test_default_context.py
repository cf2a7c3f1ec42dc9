"""New contexts of a loop start at its equilibrium, and fly as `simulate` does."""

import numpy as np
import pytest
from helpers import nightly_beyond, output, vector_outputs
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator

from drake_nonstop import (
    ScenarioError,
    dump_scenario,
    load_scenario,
    make_nonstop,
    parse_scenario,
    scenario_names,
    set_equilibrium,
    simulate,
)
from drake_nonstop.mechanics.signals import LoadState

SIGNALS = ("load_state", "carrier_state", "tensions", "parameters", "phase")
CONSTANT = "optimization_layer=ConstantParameters"


FIRST = ("quintic", "aircraft_transfer_gusty", "three_carriers")
STARTS = [
    ("quintic", ["control_period=0", CONSTANT]),
    ("quintic", ["load_feedback=!NoisyFeedback {delay: 0.02}", CONSTANT]),
    ("quintic", ["carrier_dynamics=LimitedCarriers", CONSTANT]),
    ("quintic", ["load_trajectory.start_roll_pitch_yaw=[0.2,-0.1,2.5]", CONSTANT]),
    *((name, []) for name in dict.fromkeys([*FIRST, *scenario_names()])),
]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("name", "overrides"), nightly_beyond(7, "engines", STARTS))
def test_every_signal_is_finite_and_load_and_carriers_are_where_they_start(name, overrides):
    diagram = make_nonstop(load_scenario(name, overrides))
    default, settled = diagram.CreateDefaultContext(), diagram.CreateDefaultContext()
    for signal in vector_outputs(diagram):
        assert np.all(np.isfinite(output(diagram, default, signal))), signal
    set_equilibrium(diagram, settled)
    for signal in ("load_state", "carrier_state"):
        expected = output(diagram, settled, signal)
        np.testing.assert_array_equal(output(diagram, default, signal), expected)
    load = LoadState.view(output(diagram, default, "load_state"))
    reference = LoadState.view(output(diagram, default, "reference"))
    np.testing.assert_allclose(load.position, reference.position, rtol=0, atol=0.05)


COMPILED, BESIDE = "engine=compiled", "start_error=[0.02, 0.01, 0, 0, 0, 0.1]"
FLOWN = [[COMPILED, CONSTANT, BESIDE], ["control_period=0", CONSTANT], [], [COMPILED]]


@pytest.mark.parametrize("overrides", nightly_beyond(2, "engines", FLOWN))
def test_a_plain_simulator_flies_as_simulate_does_and_again_after_a_reset(overrides):
    scenario = load_scenario("quintic", ["simulation_duration=0.2", *overrides])
    run = simulate(scenario)
    assert run.step == scenario.simulator_config.max_step_size
    diagram = make_nonstop(scenario)
    for flown in (diagram, run.diagram):
        simulator = Simulator(flown)
        ApplySimulatorConfig(scenario.simulator_config, simulator)
        for _ in range(2):
            simulator.AdvanceTo(0.2)
            for signal in SIGNALS:
                shown = output(flown, simulator.get_context(), signal)
                expected = run.signal(signal)[-1]
                np.testing.assert_allclose(shown, expected, 0, 1e-10, err_msg=signal)
            simulator.reset_context(flown.CreateDefaultContext())


@pytest.mark.parametrize("name", nightly_beyond(1, "engines", ["quintic", "aircraft_rest_cables"]))
def test_a_start_error_moves_and_turns_the_load_alone(name):
    scenarios = [load_scenario(name, overrides) for overrides in ([CONSTANT], [CONSTANT, BESIDE])]
    assert parse_scenario(dump_scenario(scenarios[1])) == scenarios[1] != scenarios[0]
    made = [(diagram := make_nonstop(s), diagram.CreateDefaultContext()) for s in scenarios]
    change = np.diff([output(*loop, "load_state")[:7] for loop in made], axis=0)[0]
    np.testing.assert_allclose(change[1:], [0, 0, np.sin(0.05), 0.02, 0.01, 0], 0, 1e-6)
    np.testing.assert_array_equal(*(output(*loop, "carrier_state") for loop in made))


def test_a_loop_without_an_equilibrium_is_refused_unless_none_is_asked_for():
    scenario = load_scenario("quintic", [CONSTANT, "simulated.cable_length=3"])
    with pytest.raises(ScenarioError, match="the cables do not hold the load"):
        make_nonstop(scenario)
    diagram = make_nonstop(scenario, at_equilibrium=False)
    start = output(diagram, diagram.CreateDefaultContext(), "load_state")
    np.testing.assert_array_equal(start, np.eye(13)[0])
