"""Where runs start whose load and carriers are blocks of the user's own."""

from functools import partial

import numpy as np
import pytest
from helpers import nightly_beyond
from pydrake.common.value import Value
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator
from pydrake.systems.framework import LeafSystem

from drake_nonstop import (
    ScenarioError,
    ScenarioWarning,
    load_scenario,
    make_nonstop,
    set_equilibrium,
    simulate,
)
from drake_nonstop.mechanics.carrier import double_integrator_rate
from drake_nonstop.mechanics.rigid_load import load_state_rate
from examples import articulated_load, own_physics

SIGNALS = ("load_state", "carrier_state", "tensions")


def short(duration, *overrides):
    layer = "optimization_layer=ConstantParameters"
    return load_scenario("quintic", [f"simulation_duration={duration}", layer, *overrides])


def distance(run, other):
    return {name: np.abs(run.signal(name) - other.signal(name)).max() for name in SIGNALS}


@pytest.mark.nightly("engines")
def test_discrete_multibody_plants_approach_our_blocks_with_the_first_order_of_their_step():
    scenario, apart = short(0.15, "simulated.load_drag=0.0"), []
    ours = simulate(scenario)
    for step in (2e-3, 1e-3):
        own = {
            "load_plant": partial(own_physics.load, time_step=step),
            "carrier_dynamics": partial(own_physics.carriers, time_step=step),
        }
        apart.append(distance(simulate(scenario, **own), ours))
    for name in SIGNALS:
        assert apart[1][name] < 5e-3
        assert apart[0][name] / apart[1][name] == pytest.approx(2, rel=0.2)


class MappedLoad(LeafSystem):
    """Our load in the state z = M (x - c), continuous, or stepped by Euler's method."""

    def __init__(self, model, seed, period=0.0):
        super().__init__()
        generator = np.random.default_rng(seed)
        self.map, self.shift = generator.normal(size=(13, 13)), generator.normal(size=13)
        self.model, self.period = model, period
        start = self.map @ (np.eye(13)[0] - self.shift)
        self.DeclareVectorInputPort("cable_forces", 3 * model.n)
        ticket = self.all_state_ticket()
        if period:
            self.DeclareDiscreteState(start)
            self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self.update)
        else:
            self.DeclareContinuousState(13)
        self.DeclareVectorOutputPort("load_state", 13, self.calc, {ticket})

    def state(self, context):
        vector = context.get_discrete_state_vector() if self.period else None
        vector = vector or context.get_continuous_state_vector()
        return np.linalg.solve(self.map, vector.CopyToVector()) + self.shift

    def rate(self, context):
        forces, model = self.GetInputPort("cable_forces").Eval(context), self.model
        return self.map @ load_state_rate(
            model.load, self.state(context), forces, np.zeros(6), attachments=model.attachments
        )

    def calc(self, context, output):
        output.SetFromVector(self.state(context))

    def DoCalcTimeDerivatives(self, context, derivatives):  # noqa: N802
        if not self.period:
            derivatives.get_mutable_vector().SetFromVector(self.rate(context))

    def update(self, context, discrete):
        state = context.get_discrete_state_vector().value()
        discrete.set_value(state + self.period * self.rate(context))


class MappedCarriers(LeafSystem):
    """Our carriers in a state z = M x."""

    def __init__(self, model, seed):
        super().__init__()
        size, self.mass = 6 * model.n, model.carrier_mass
        self.map = np.random.default_rng(seed).normal(size=(size, size))
        self.DeclareVectorInputPort("carrier_forces", 3 * model.n)
        self.DeclareContinuousState(size)
        self.DeclareVectorOutputPort("carrier_state", size, self.calc, {self.xc_ticket()})

    def state(self, context):
        return np.linalg.solve(self.map, context.get_continuous_state_vector().CopyToVector())

    def calc(self, context, output):
        output.SetFromVector(self.state(context))

    def DoCalcTimeDerivatives(self, context, derivatives):  # noqa: N802
        forces = self.GetInputPort("carrier_forces").Eval(context)
        rate = double_integrator_rate(self.state(context), forces, mass=self.mass)
        derivatives.get_mutable_vector().SetFromVector(self.map @ rate)


@pytest.mark.parametrize("seed", nightly_beyond(1, "engines", range(3)))
def test_drawn_maps_of_the_state_fly_as_our_blocks(seed):
    # Far away, where maps round more.
    start = f"{{start_position: [2e4, 0, 0], start_roll_pitch_yaw: [0.1, 0.2, {seed}]}}"
    scenario = short(0.05, f"load_trajectory={start}")
    own = {
        "load_plant": lambda model: MappedLoad(model, seed),
        "carrier_dynamics": lambda model: MappedCarriers(model, 10 + seed),
    }
    assert max(distance(simulate(scenario, **own), simulate(scenario)).values()) < 1e-7


class ClippedLoad(MappedLoad):
    """A load whose port cannot show what is set."""

    def state(self, context):
        return np.minimum(super().state(context), [*np.full(6, 9.0), -0.5, *np.full(6, 9.0)])


class ShiftedLoad(MappedLoad):
    """A load that sets its state 1 mm away from what it is told."""

    def SetLoadState(self, context, value):  # noqa: N802
        state = self.map @ (value + 0.001 * np.eye(13)[4] - self.shift)
        context.SetContinuousState(state)


class FrozenCarriers(LeafSystem):
    """Carriers that show another state than they have."""

    def __init__(self, model):
        super().__init__()
        self.DeclareDiscreteState(6 * model.n)
        self.DeclareVectorOutputPort("carrier_state", 6 * model.n, self.calc)

    def calc(self, context, output):
        output.SetFromVector(np.zeros(output.size()))


class MovedByTrim(MappedLoad):
    """A load that is elsewhere once it is trimmed."""

    def trim(self, context):
        context.SetContinuousState(self.map @ (np.eye(13)[0] + np.eye(13)[4] - self.shift))


REFUSED = [
    (ClippedLoad, r"load_plant\.load_state\[6\] = -0\.5: .*give ClippedLoad a method SetLoadState"),
    (
        ShiftedLoad,
        r"load_plant\.load_state\[4\] = 0\.001: .*ShiftedLoad a method .*, or correct it",
    ),
    (
        MovedByTrim,
        r"load_plant\.load_state\[4\] = 1: .*or correct it, or trim, which has to keep it",
    ),
    (
        FrozenCarriers,
        r"carrier_dynamics\.carrier_state\[\d+\] = 0: .*FrozenCarriers .* SetCarrierSt",
    ),
]


@pytest.mark.parametrize(("kind", "said"), REFUSED)
def test_a_state_that_the_port_does_not_show_is_refused_by_name(kind, said):
    own = {"load_plant": lambda model: kind(model, 3)}
    if kind is FrozenCarriers:
        own = {"carrier_dynamics": kind}
    with pytest.raises(ScenarioError, match=said):
        simulate(short(0.1), **own)
    with pytest.raises(ScenarioError, match=said):
        make_nonstop(short(0.1, "control_period=0.0"), **own)


class HiddenLoad(MappedLoad):
    """A load with an abstract state, which nobody can find."""

    def __init__(self, model):
        super().__init__(model, 4)
        self.kept = self.DeclareAbstractState(Value[object](np.eye(13)[0]))
        self.DeclarePeriodicUnrestrictedUpdateEvent(1e-3, 0.0, self.step)

    def state(self, context):
        return context.get_abstract_state(self.kept).get_value()

    def step(self, context, state):
        rate = np.linalg.solve(self.map, self.rate(context))
        stepped = self.state(context) + 1e-3 * rate
        state.get_mutable_abstract_state(self.kept).set_value(stepped)


class SettableLoad(HiddenLoad):
    """The same with what the error asks for."""

    def SetLoadState(self, context, value):  # noqa: N802
        context.SetAbstractState(self.kept, value)


def test_the_remedy_works():
    scenario = short(0.02)
    with pytest.raises(ScenarioError, match=r"give HiddenLoad a method SetLoadState"):
        simulate(scenario, load_plant=HiddenLoad)
    own, ours = simulate(scenario, load_plant=SettableLoad), simulate(scenario)
    apart = np.abs(own.signal("load_state") - ours.signal("load_state"))
    assert apart[0].max() < 1e-7
    assert apart.max() < 5e-4  # of a first-order scheme


def test_an_articulated_load_starts_where_the_whole_hangs_at_rest():
    diagram = make_nonstop(short(0.1), load_plant=articulated_load.load)
    context = diagram.CreateDefaultContext()
    Simulator(diagram, context).Initialize()
    block = diagram.GetSubsystemByName("load_plant")
    rates = block.EvalTimeDerivatives(diagram.GetSubsystemContext(block, context)).CopyToVector()
    assert np.abs(rates[8:]).max() < 1e-6  # accelerations of platform and pendulum
    tensions = diagram.GetOutputPort("cable_forces").Eval(context).reshape(-1, 3)
    np.testing.assert_allclose(tensions.sum(0), [0, 0, 9.81], rtol=0, atol=1e-6)  # of 1 kg


def test_a_block_whose_defaults_cannot_be_set_is_named_and_set_equilibrium_helps():
    """A discrete state is declared once."""
    scenario = short(0.1, "load_trajectory.start_roll_pitch_yaw=[0.1,0.2,0.3]")
    own = {"load_plant": lambda model: MappedLoad(model, 7, period=1e-3)}
    with pytest.warns(ScenarioWarning, match="load_plant = MappedLoad: new contexts"):
        diagram = make_nonstop(scenario, **own)
    simulator = Simulator(diagram)
    ApplySimulatorConfig(scenario.simulator_config, simulator)
    set_equilibrium(diagram, simulator.get_mutable_context())
    simulator.AdvanceTo(0.1)
    shown = diagram.GetOutputPort("load_state").Eval(simulator.get_context())
    expected = simulate(scenario, **own).signal("load_state")[-1]
    np.testing.assert_allclose(shown, expected, rtol=0, atol=1e-10)
