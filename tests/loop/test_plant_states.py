"""Where runs start whose load and carriers are blocks of the user's own."""

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
from examples import articulated_load

SIGNALS = ("load_state", "carrier_state", "tensions")


def short(duration, *overrides):
    layer = "optimization_layer=ConstantParameters"
    return load_scenario("quintic", [f"simulation_duration={duration}", layer, *overrides])


def distance(run, other):
    return {name: np.abs(run.signal(name) - other.signal(name)).max() for name in SIGNALS}


class Mapped(LeafSystem):
    """Shows x of a state z = M (x - c), continuous, or stepped by Euler's method."""

    def __init__(self, model, seed, reads, shows, start, period=0.0):
        super().__init__()
        generator, size = np.random.default_rng(seed), len(start)
        self.map, self.shift = generator.normal(size=(size, size)), generator.normal(size=size)
        self.model, self.period = model, period
        self._forces = self.DeclareVectorInputPort(reads, 3 * model.n)
        if period:
            self.DeclareDiscreteState(self.map @ (start - self.shift))
            self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self.update)
        else:
            self.DeclareContinuousState(size)
        self.DeclareVectorOutputPort(shows, size, self.calc, {self.all_state_ticket()})

    def state(self, context):
        vector = context.get_discrete_state_vector() if self.period else None
        vector = vector or context.get_continuous_state_vector()
        return np.linalg.solve(self.map, vector.CopyToVector()) + self.shift

    def rate(self, context):
        return self.map @ self.rate_of(self.state(context), self._forces.Eval(context))

    def calc(self, context, output):
        output.SetFromVector(self.state(context))

    def DoCalcTimeDerivatives(self, context, derivatives):  # noqa: N802
        if not self.period:
            derivatives.get_mutable_vector().SetFromVector(self.rate(context))

    def update(self, context, discrete):
        state = context.get_discrete_state_vector().value()
        discrete.set_value(state + self.period * self.rate(context))


class MappedLoad(Mapped):
    """Our load."""

    def __init__(self, model, seed, period=0.0):
        super().__init__(model, seed, "cable_forces", "load_state", np.eye(13)[0], period)

    def rate_of(self, state, forces):
        load, attachments = self.model.load, self.model.attachments
        return load_state_rate(load, state, forces, np.zeros(6), attachments=attachments)


class MappedCarriers(Mapped):
    """Our carriers."""

    def __init__(self, model, seed):
        super().__init__(model, seed, "carrier_forces", "carrier_state", np.zeros(6 * model.n))

    def rate_of(self, state, forces):
        return double_integrator_rate(state, forces, mass=self.model.carrier_mass)


@pytest.mark.parametrize("seed", nightly_beyond(1, "engines", range(3)))
def test_drawn_maps_of_the_state_fly_as_our_blocks(seed):
    # Far away, where positions round to 4e-12 m and slopes by differences of 2^-16 to some 1e-7.
    start = f"{{start_position: [2e4, 0, 0], start_roll_pitch_yaw: [0.1, 0.2, {seed}]}}"
    scenario = short(0.05, f"load_trajectory={start}")
    own = {
        "load_plant": lambda model: MappedLoad(model, seed),
        "carrier_dynamics": lambda model: MappedCarriers(model, 10 + seed),
    }
    assert max(distance(simulate(scenario, **own), simulate(scenario)).values()) < 1e-6


class ClippedLoad(MappedLoad):
    """A load whose port cannot show what is set."""

    def state(self, context):
        return np.minimum(super().state(context), [*np.full(6, 9.0), -0.5, *np.full(6, 9.0)])


class ShiftedLoad(MappedLoad):
    """A load that sets its state 1 mm away from what it is told."""

    def SetLoadState(self, context, value):  # noqa: N802
        state = self.map @ (value + 0.001 * np.eye(13)[4] - self.shift)
        context.SetContinuousState(state)


class FrozenCarriers(MappedCarriers):
    """Carriers that show another state than they have."""

    def state(self, context):
        return np.zeros(6 * self.model.n)


class MovedByTrim(MappedLoad):
    """A load that is elsewhere once it is trimmed."""

    def trim(self, context):
        context.SetContinuousState(self.map @ (np.eye(13)[0] + np.eye(13)[4] - self.shift))


REFUSED = [
    ("load_plant", ClippedLoad, r"[6\] = -0\.5: .*give ClippedLoad a method SetLoadState"),
    ("load_plant", ShiftedLoad, r"[4\] = 0\.001: .*ShiftedLoad a method .*, or correct it"),
    ("load_plant", MovedByTrim, r"[4\] = 1: .*or correct it, or trim, which has to keep it"),
    ("carrier_dynamics", FrozenCarriers, r"[\d+\] = 0: .*FrozenCarriers .* SetCarrierState"),
]


@pytest.mark.parametrize(("box", "kind", "said"), REFUSED)
def test_a_state_that_the_port_does_not_show_is_refused_by_name(box, kind, said):
    own = {box: lambda model: kind(model, 3)}
    for build, overrides in ((simulate, []), (make_nonstop, ["control_period=0"])):
        with pytest.raises(ScenarioError, match=rf"^{box}\.\w+_state\{said}"):
            build(short(0.1, *overrides), **own)


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
