"""A traced block has the ports that it is given, and is evaluated when they change, not before."""

import numpy as np
import pytest
from helpers import fix, output
from pydrake.autodiffutils import AutoDiffXd
from pydrake.symbolic import Expression
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ZeroOrderHold

from drake_nonstop import load_scenario, make_nonstop, simulate
from drake_nonstop.loop.compiled_loop import reason_against
from drake_nonstop.simulation.run import RunStopped
from drake_nonstop.systems.block import number
from drake_nonstop.systems.diagram_trace import is_traceable
from drake_nonstop.systems.traced_block import TracedBlock, TracedDynamics
from drake_nonstop.systems.tracing import NotFiniteError, TracedFunction


def spring(**more):
    """A force and its power, of a mass on a spring."""

    def function(state, push, gain):
        rate = np.concatenate([state[1:], push - gain * state[:1]])
        return rate, push * state[1:], gain * state[:1]

    return TracedDynamics(
        function,
        inputs={"push": 1, "gain": 1},
        outputs={"power": 1, "force": 1} | ({"motion": 2} if "state_port" in more else {}),
        state=np.array([2.0, 3.0]),
        **more,
    )


def test_ports_are_named_and_sized():
    block = spring(state_port="motion")
    assert [block.get_input_port(i).get_name() for i in range(2)] == ["push", "gain"]
    names = [block.get_output_port(i).get_name() for i in range(block.num_output_ports())]
    assert names == ["power", "force", "motion"]
    assert not spring().HasOutputPort("motion")


@pytest.mark.parametrize("outputs", [{"y": 1}, {"y": 1, "x": 3}])
def test_a_port_of_the_state_is_among_the_outputs_and_of_its_size(outputs):
    with pytest.raises(ValueError, match="state_port = x: put it among the outputs, of size 2"):
        TracedDynamics(
            lambda x: (x, x[:1]), inputs={}, outputs=outputs, state=np.zeros(2), state_port="x"
        )


def test_outputs_and_rates_are_the_functions():
    block = spring(state_port="motion")
    context = block.CreateDefaultContext()
    fix(block, context, push=[5.0], gain=[7.0])
    assert output(block, context, "power") == [15.0]
    assert output(block, context, "force") == [14.0]
    np.testing.assert_array_equal(output(block, context, "motion"), [2.0, 3.0])
    np.testing.assert_array_equal(block.EvalTimeDerivatives(context).CopyToVector(), [3.0, -9.0])


def test_time_is_read_last():
    block = TracedBlock(
        lambda value, time: value * time,
        inputs={"value": 2},
        outputs={"result": 2},
        reads_time=True,
    )
    context = block.CreateDefaultContext()
    fix(block, context, value=[1.0, 2.0])
    context.SetTime(3.0)
    np.testing.assert_array_equal(output(block, context, "result"), [3.0, 6.0])


@pytest.mark.parametrize(("reads_time", "count"), [(False, 2), (True, 4)])
def test_a_held_input_is_not_evaluated_again(monkeypatch, reads_time, count):
    calls = []
    evaluate = TracedFunction.of_vectors

    def counted(self, values):
        calls.append(1)
        return evaluate(self, values)

    monkeypatch.setattr(TracedFunction, "of_vectors", counted)
    builder = DiagramBuilder()
    holds = [builder.AddSystem(ZeroOrderHold(1.0, 1)) for _ in range(2)]
    block = builder.AddSystem(
        TracedBlock(
            lambda a, b, *time: (a + b + sum(time), a - b),
            inputs={"a": 1, "b": 1},
            outputs={"sum": 1, "difference": 1},
            reads_time=reads_time,
        )
    )
    for hold, name in zip(holds, "ab", strict=True):
        builder.Connect(hold.get_output_port(), block.GetInputPort(name))
    for name in ("sum", "difference"):
        builder.ExportOutput(block.GetOutputPort(name), name)
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    for time in (0.1, 0.2):
        context.SetTime(time)
        for name in ("sum", "difference"):
            diagram.GetOutputPort(name).Eval(context)
    assert len(calls) == count


def test_an_output_feeds_through_what_its_trace_reads_and_nothing_else():
    """The state's rate is made with an output that reads what it reads; a constant reads none."""

    def function(state, a, b, unread, time):
        return a * state, a * b + state, b * time, 0 * a + 7.0, state * time

    block = TracedDynamics(
        function,
        inputs={"a": 1, "b": 1, "unread": 2},
        outputs={"both": 1, "second": 1, "constant": 1, "own": 1, "state": 1},
        state=np.array([2.0]),
        state_port="state",
        reads_time=True,
    )
    outputs = ["both", "second", "constant", "own", "state"]
    found = {
        (source, target)
        for i, source in enumerate(("a", "b", "unread"))
        for k, target in enumerate(outputs)
        if block.HasDirectFeedthrough(i, k)
    }
    assert found == {("a", "both"), ("b", "both"), ("b", "second")}
    converted = {AutoDiffXd: block.ToAutoDiffXd(), Expression: block.ToSymbolic()}
    for scalar, own in {float: block, **converted}.items():
        context = own.CreateDefaultContext()
        context.SetTime(3.0)
        for name, value in (("a", [5.0]), ("b", [11.0]), ("unread", [np.nan, 0.0])):
            if (scalar, name) != (Expression, "unread"):
                own.GetInputPort(name).FixValue(context, np.array([scalar(v) for v in value]))
        values = [number(own.GetOutputPort(name).Eval(context)[0]) for name in outputs]
        assert values == [57.0, 33.0, 7.0, 6.0, 2.0]
        assert [number(rate) for rate in own.EvalTimeDerivatives(context).CopyToVector()] == [10.0]


def test_a_value_of_autodiff_that_is_not_finite_names_the_block():
    builder = DiagramBuilder()
    builder.AddNamedSystem("spring", spring())
    diagram = builder.Build()
    diagram.set_name("nonstop")
    block = diagram.ToAutoDiffXd().GetSubsystemByName("spring")
    context = block.CreateDefaultContext()
    fix(block, context, push=np.array([AutoDiffXd(np.nan)]), gain=np.array([AutoDiffXd(1.0)]))
    with pytest.raises(NotFiniteError, match="spring was given"):
        output(block, context, "power")


def test_a_value_that_is_not_finite_names_the_block():
    block = spring()
    block.set_name("spring")
    context = block.CreateDefaultContext()
    fix(block, context, push=[np.nan], gain=[1.0])
    with pytest.raises(NotFiniteError, match="spring was given"):
        output(block, context, "power")


@pytest.mark.parametrize("updates_first", [False, True])
def test_a_sampled_state_changes_at_every_sample_but_the_first(updates_first):
    block = TracedDynamics(
        lambda state, rate: (rate, state),
        inputs={"rate": 2},
        outputs={"integral": 2},
        state=np.zeros(2),
        period=0.5,
        updates_first=updates_first,
    )
    simulator = Simulator(block)
    context = simulator.get_mutable_context()
    fix(block, context, rate=[2.0, 4.0])
    simulator.Initialize()
    np.testing.assert_array_equal(output(block, context, "integral"), [0.0, 0.0])
    simulator.AdvanceTo(1.2)
    np.testing.assert_array_equal(output(block, context, "integral"), [2.0, 4.0])


def test_what_is_known_of_the_time_has_its_rate_in_other_scalar_types():
    class Ramp(TracedBlock):
        def precomputed_inputs(self, names, times):
            return [times[:, None] ** 2 for _ in names]

        def precomputed_input_rates(self, names, times):
            return [2 * times[:, None] for _ in names]

    block = Ramp(lambda height: 3 * height, inputs={}, known={"height": 1}, outputs={"ramp": 1})
    context = block.CreateDefaultContext()
    context.SetTime(2.0)
    assert output(block, context, "ramp") == [12.0]
    other = block.ToAutoDiffXd()
    context = other.CreateDefaultContext()
    context.SetTime(AutoDiffXd(2.0, [1.0]))
    (ramp,) = other.GetOutputPort("ramp").Eval(context)
    assert (ramp.value(), ramp.derivatives()) == (12.0, [12.0])


def test_a_block_of_the_time_alone():
    block = TracedBlock(lambda time: 2 * time, inputs={}, outputs={"ramp": 1}, reads_time=True)
    context = block.CreateDefaultContext()
    for time in (1.0, 3.0):
        context.SetTime(time)
        assert output(block, context, "ramp") == [2 * time]


def test_a_block_of_nothing_shows_constants():
    block = TracedBlock(lambda: np.ones(2), inputs={}, outputs={"ones": 2})
    for own in (block, block.ToAutoDiffXd(), block.ToSymbolic()):
        values = own.GetOutputPort("ones").Eval(own.CreateDefaultContext())
        assert [number(value) for value in values] == [1.0, 1.0]


def integral(**settings):
    """The integral of a rate of 1."""
    return TracedDynamics(
        lambda state: (np.ones(1) + 0 * state, state),
        inputs={},
        outputs={"integral": 1},
        state=np.zeros(1),
        key="integral",
        **settings,
    )


def test_what_a_trace_has_of_the_samples_is_in_its_key():
    settings = [{}, {"period": 0.1}, {"period": 0.2}, {"period": 0.1, "updates_first": True}]
    keys = [integral(**each).trace_key for each in settings]
    assert len({*keys}) == len(keys)
    assert integral(period=0.1).trace_key == keys[1]


class Rated(TracedDynamics):
    def DoCalcTimeDerivatives(self, context, derivatives):  # noqa: N802
        derivatives.SetFromVector(np.full(1, 2.0))


class Below(Rated):
    pass


class WithPower(TracedDynamics):
    def __init__(self, function, **others):
        super().__init__(function, **others)
        self.DeclareVectorOutputPort("power", 1, lambda context, output: None)


@pytest.mark.parametrize("kind", [TracedDynamics, Rated, Below, WithPower])
def test_a_class_below_that_computes_more_is_not_traced(kind):
    block = kind(lambda x, u: (u, x), inputs={"u": 1}, outputs={"y": 1}, state=np.zeros(1))
    assert is_traceable(block) == (kind is TracedDynamics)


def started(model):
    return TracedDynamics(
        lambda x, tensions: (0 * x, x),
        inputs={"tensions": model.n},
        outputs={"first_tension": 1},
        state=np.zeros(1),
        start=(lambda tensions: tensions[:1], ["tensions"]),
    )


@pytest.mark.parametrize(
    ("period", "said"), [(0.0, "phase = "), (0.01, "its continuous state starts of its inputs")]
)
def test_continuous_states_that_no_trace_starts_are_named(period, said):
    overrides = [f"control_period={period}", "optimization_layer=ConstantParameters"]
    scenario = load_scenario("line", overrides)
    loop = make_nonstop(scenario, at_equilibrium=False, extra={"own": started})
    assert said in reason_against(loop, scenario.simulator_config, 0.01)


def test_samples_of_another_period_are_named():
    loop = make_nonstop(
        load_scenario("quintic"),
        at_equilibrium=False,
        extra={"own": lambda model: integral(period=0.02, updates_first=True)},
    )
    reason = reason_against(loop, load_scenario("quintic").simulator_config, 0.01)
    assert "it samples every 0.02 s" in reason


@pytest.mark.parametrize("settings", [{"state_port": "x"}, {"start": (np.copy, ["u"])}])
def test_what_needs_a_state_is_refused_without_one(settings):
    with pytest.raises(ValueError, match="state = none: give one"):
        TracedDynamics(lambda u: u, inputs={"u": 1}, outputs={"y": 1}, state=None, **settings)


def test_a_state_is_one_of_another_class():
    with pytest.raises(TypeError, match="state: give it to TracedDynamics"):
        TracedBlock(lambda x, u: (u, x), inputs={"u": 1}, outputs={"y": 1}, state=np.zeros(1))


def test_an_error_names_the_block_however_deep_inside_it():
    block = "force_distribution=!BoundedTensionDistribution {max_tension: 1.2}"
    with pytest.raises(RunStopped, match=r": force_distribution \(force_distribution.py"):
        simulate(load_scenario("line", ["simulation_duration=0.1", block]))
