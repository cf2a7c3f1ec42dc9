"""Aircraft of JSBSim as a block: ports, start, repetition, and what it refuses."""

import importlib.metadata
import importlib.util

import numpy as np
import pytest
from helpers import ends_run, fix, model, output
from pydrake.systems.analysis import Simulator

from drake_nonstop import ScenarioError, StepCheck, load_scenario, make_nonstop, simulate
from drake_nonstop.blocks.jsbsim_carriers import JsbsimCarriers, JsbsimCarriersConfig
from drake_nonstop.mechanics.signals import AircraftState
from drake_nonstop.model.aircraft import AircraftParameters
from drake_nonstop.simulation import step_check
from drake_nonstop.systems.wiring import input_names, output_names

RASCAL = AircraftParameters(model="rascal_110")
SIGNALS = ("load_state", "carrier_state", "aircraft_state", "carrier_acceleration")


def test_without_the_extra_it_is_refused(monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *rest: None if name == "jsbsim" else find(name)
    )
    with pytest.raises(ScenarioError) as caught:
        JsbsimCarriers(model(aircraft=RASCAL, cable_length=150.0))
    assert str(caught.value) == (
        "carrier_dynamics = no jsbsim: install it, `pip install 'drake-nonstop[jsbsim]'`"
    )


def test_an_old_version_is_refused(monkeypatch):
    pytest.importorskip("jsbsim")
    monkeypatch.setattr(importlib.metadata, "version", lambda name: "1.2.10")
    with pytest.raises(ScenarioError, match=r"carrier_dynamics = jsbsim 1.2.10: it is too old"):
        JsbsimCarriers(model(aircraft=RASCAL, cable_length=150.0))


@pytest.fixture(scope="module")
def loop():
    pytest.importorskip("jsbsim")
    return make_nonstop(load_scenario("aircraft_rest", ["carrier_dynamics=JsbsimCarriers"]))


def flown(loop, duration, context=None):
    """A simulator after a flight from the equilibrium."""
    simulator = Simulator(loop, context or loop.CreateDefaultContext())
    simulator.get_mutable_integrator().set_maximum_step_size(0.02)
    simulator.AdvanceTo(duration)
    return simulator


def shown(loop, context):
    return {name: output(loop, context, name) for name in SIGNALS}


def block(n=3, config=None, speed=15.0, **inputs):
    """The block and a context in flight along x, with inputs."""
    pytest.importorskip("jsbsim")
    made = JsbsimCarriers(model(n, aircraft=RASCAL, cable_length=150.0), config)
    context = made.CreateDefaultContext()
    given = dict.fromkeys(JsbsimCarriers.reads, np.zeros(3 * n))
    fix(made, context, **given | inputs)
    state = np.concatenate([np.arange(3.0 * n), np.tile([speed, 0, 0], n)])
    made.SetCarrierState(context, state)
    made.trim(context, np.zeros(3 * n))
    return made, context


def test_ports_are_those_of_the_point_masses(loop):
    own = loop.GetSubsystemByName("carrier_dynamics")
    other = make_nonstop(load_scenario("aircraft_rest")).GetSubsystemByName("carrier_dynamics")
    assert input_names(own) == input_names(other)
    assert output_names(own) == output_names(other)
    through = {
        (i, o)
        for i in range(own.num_input_ports())
        for o in range(own.num_output_ports())
        if own.HasDirectFeedthrough(i, o)
    }
    assert {(input_names(own)[i], output_names(own)[o]) for i, o in through} == {
        ("wind", "aircraft_state")
    }


@pytest.mark.slow
def test_it_flies_as_the_point_masses_and_repeats_to_the_bit(loop):
    first, again = flown(loop, 1.0).get_context(), flown(loop, 1.0).get_context()
    values = shown(loop, first)
    points = make_nonstop(load_scenario("aircraft_rest"))
    other = shown(points, flown(points, 1.0).get_context())
    np.testing.assert_allclose(values["load_state"], other["load_state"], atol=0.03)
    positions = slice(0, 12)
    np.testing.assert_allclose(
        values["carrier_state"][positions], other["carrier_state"][positions], atol=0.05
    )
    of_jsbsim, of_points = (AircraftState.view(v["aircraft_state"]) for v in (values, other))
    np.testing.assert_allclose(of_jsbsim.lift, of_points.lift, rtol=0.04)
    np.testing.assert_allclose(of_jsbsim.bank, of_points.bank, atol=0.03)
    np.testing.assert_allclose(of_jsbsim.thrust, of_points.thrust, atol=0.6)
    assert np.any(of_jsbsim.lift != of_points.lift)
    for name, value in shown(loop, again).items():
        np.testing.assert_array_equal(value, values[name], name)


def test_a_run_goes_on_where_it_ended():
    def ended(*times):
        made, context = block(aircraft_command=np.repeat([0.7, 0.3, 12.0], 3))
        for time in times:  # a simulator for each
            Simulator(made, context).AdvanceTo(time)
        return output(made, context, "carrier_state")

    np.testing.assert_array_equal(ended(0.1, 0.1025, 0.2), ended(0.2))


def test_no_part_of_a_run_is_flown_again_and_none_is_in_doubt(monkeypatch):
    """Its aircraft cannot go back to the middle of a run, where its hardest part is."""
    monkeypatch.setattr(step_check, "_roughness", lambda run, flown: 1e-9 * np.eye(1, 151, 90)[0])
    changes = ["carrier_dynamics=JsbsimCarriers", "simulation_duration=1.5"]
    run = simulate(load_scenario("aircraft_rest", changes), check_step=StepCheck.PARTS)
    assert run.unresolved == ()
    assert run.half_step is None


def test_a_copied_context_does_not_go_on(loop):
    simulator = flown(loop, 0.1)
    copy = simulator.get_context().Clone()
    simulator.AdvanceTo(0.12)
    with pytest.raises(ScenarioError, match=r"this context was copied, and its aircraft have"):
        flown(loop, 0.2, copy)


@pytest.mark.parametrize("conversion", ["Clone", "ToAutoDiffXd", "ToSymbolic"])
def test_conversions_are_refused(loop, conversion):
    for system in (loop, loop.GetSubsystemByName("carrier_dynamics")):
        with pytest.raises(ScenarioError, match=r"no Clone and no conversion to AutoDiffXd or"):
            getattr(system, conversion)()


def test_between_steps_outputs_are_continuous_and_velocities_are_rates():
    made, context = block(aircraft_command=np.repeat([0.7, 0.3, 12.0], 3))
    simulator = Simulator(made, context)
    rate = []
    for time in (0.1, 0.1022, 0.1024, 0.1026, 0.105 - 1e-9, 0.105, 0.105 + 1e-9):
        simulator.AdvanceTo(time)
        rate.append(output(made, context, "carrier_state"))
    slopes = (rate[3][:9] - rate[1][:9]) / 0.0004
    np.testing.assert_allclose(slopes, rate[2][9:], atol=1e-5)
    np.testing.assert_allclose(rate[4], rate[6], atol=1e-6)


def test_a_start_between_steps_is_refused():
    made, context = block()
    context.SetTime(0.0012)
    with pytest.raises(ScenarioError, match=r"^time = 0.0012: start at a multiple of"):
        Simulator(made, context).Initialize()


def test_a_stall_ends_the_run():
    made, context = block(speed=9.0)
    assert not ends_run(made, context)
    slow, stalled = block(speed=8.0)
    assert ends_run(slow, stalled)
    other, still = block(config=JsbsimCarriersConfig(stops_at_stall=False), speed=8.0)
    assert not ends_run(other, still)


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"step": 0.1}, "carrier_dynamics.step = 0.1: give 0.001 to 0.01 s"),
        ({"hook": [0.0, 0.0]}, "carrier_dynamics.hook = [0.0, 0.0]: give 3 finite numbers"),
    ],
)
def test_bad_fields_are_refused(fields, said):
    with pytest.raises(ScenarioError) as caught:
        block(config=JsbsimCarriersConfig(**fields))
    assert str(caught.value).startswith(said)


def test_energies_are_those_of_the_motion():
    made, context = block()
    assert made.CalcKineticEnergy(context) == pytest.approx(3 * 0.5 * 6 * 15**2)
    heights = output(made, context, "carrier_state")[2:9:3]
    assert made.CalcPotentialEnergy(context) == pytest.approx(6 * 9.81 * heights.sum())
