"""Contracts of any block: of each variant of each box, and of blocks of a user's own."""

import functools
import itertools
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
from pydrake.autodiffutils import AutoDiffXd, ExtractValue
from pydrake.symbolic import Expression
from pydrake.systems.framework import PortDataType

from drake_nonstop import (
    Block,
    ScenarioError,
    load_scenario,
    make_nonstop,
    simulate,
)
from drake_nonstop.diagrams.nonstop import BOXES
from drake_nonstop.mechanics.rotation import norm
from drake_nonstop.mechanics.signal_layouts import Layout, Part
from drake_nonstop.mechanics.signals import HELD
from drake_nonstop.systems.block import set_state_values, state_values
from drake_nonstop.systems.equation_block import EquationBlock
from drake_nonstop.systems.equations import STATE, Equations

SCENARIOS = "quintic", "aircraft_transfer_gusty", "aircraft_rest_cables"
VARIANTS = {f"{box}-{kind.__name__}": kind for box in BOXES for kind in BOXES[box].variants}


@functools.cache
def loop_of(name):
    """The diagram of a scenario, its context at rest, and its signals there."""
    diagram = make_nonstop(load_scenario(name))
    context = diagram.CreateDefaultContext()
    ports = [diagram.get_output_port(k) for k in range(diagram.num_output_ports())]
    return diagram, context, {port.get_name(): port.Eval(context) for port in ports}


def block_of(kind):
    """A block of a class with its default config, by the first model that fits, and its loop."""
    for name, box in itertools.product(SCENARIOS, ("wrench_controller", "load_plant")):
        loop = loop_of(name)
        try:
            return kind(loop[0].GetSubsystemByName(box).model), loop
        except ScenarioError as error:
            reason = error
    raise reason


def context_of(block, loop, rng):
    """A context with inputs and a state near those of a loop at rest, or else near 1."""
    context, own = block.CreateDefaultContext(), block.equations_of_block
    diagram, root, signals = loop
    for k in range(block.num_input_ports()):
        port = block.get_input_port(k)
        if port.get_data_type() != PortDataType.kVectorValued:
            return None
        value = signals.get(port.get_name().removeprefix(HELD))
        known = value is not None and np.size(value) == port.size()
        moved = rng.uniform(0.005, 0.02, port.size())
        port.FixValue(context, value + moved if known else 0.5 + 10 * moved)
    context.SetTime(0.1)
    if len(own.state):
        state = own.state
        for other in diagram.GetSystems():
            if type(other) is type(block) and len(other.equations_of_block.state) == len(state):
                state = state_values(other.GetMyContextFromRoot(root))
        set_state_values(context, state + rng.uniform(0.005, 0.02, len(state)))
    return context


def results_of(block, context):
    """The vector outputs of a block, and the rates of its state, by name."""
    ports = [block.get_output_port(k) for k in range(block.num_output_ports())]
    vectors = [port for port in ports if port.get_data_type() == PortDataType.kVectorValued]
    found = {port.get_name(): port.Eval(context) for port in vectors}
    if context.num_continuous_states():
        rates = block.EvalTimeDerivatives(context).get_vector()
        found[STATE] = rates.CopyToVector()
    return found


def evaluated(other, block, context):
    """The results of a block of another scalar type in the context of one of floats."""
    own = other.CreateDefaultContext()
    own.SetTimeStateAndParametersFrom(context)
    other.FixInputPortsFrom(block, context, own)
    return results_of(other, own)


with_equations = pytest.mark.parametrize(
    "kind", [pytest.param(kind, id=name) for name, kind in VARIANTS.items()]
)


def made(kind, rng):
    """A block, if it is one of equations, and a context of it."""
    block, loop = block_of(kind)
    context = context_of(block, loop, rng) if isinstance(block, EquationBlock) else None
    if context is None:
        pytest.skip("it has no equations, or reads objects")
    return block, context


@with_equations
def test_all_scalar_types_show_the_same(kind, rng):
    block, context = made(kind, rng)
    expected = results_of(block, context)
    for other, scalar in ((block.ToAutoDiffXd(), AutoDiffXd), (block.ToSymbolic(), Expression)):
        for name, values in evaluated(other, block, context).items():
            if scalar is AutoDiffXd:
                numbers = ExtractValue(values).ravel()
            else:
                numbers = [value.Evaluate() for value in values]
            np.testing.assert_allclose(
                numbers, expected[name], rtol=1e-9, atol=1e-9, err_msg=f"{scalar} {name}"
            )


@with_equations
def test_what_feeds_through_is_what_the_trace_reads(kind, rng):
    block, context = made(kind, rng)
    own, shown = block.equations_of_block, results_of(block, context)
    moved = {} if own.motion is None else own.motion.makes

    def read_by(output):
        reads = own.group_of[output].reads
        inputs = {name for name in reads if name in own.inputs}
        return inputs.union(
            *(read_by(k) for k in reads if k in own.outputs and k not in own.arguments)
        )

    expected = {(k, output) for output in (*own.outputs, *moved) for k in read_by(output)}
    names = [name for name in shown if name != STATE]
    ports = {
        (name, output)
        for name, output in itertools.product(own.inputs, names)
        if block.HasDirectFeedthrough(
            block.GetInputPort(name).get_index(), block.GetOutputPort(output).get_index()
        )
    }
    assert ports == expected
    for name in own.inputs:
        other = context.Clone()
        block.GetInputPort(name).FixValue(other, 1.1 * block.GetInputPort(name).Eval(context))
        for output, values in results_of(block, other).items():
            if output != STATE and (name, output) not in expected:
                np.testing.assert_array_equal(values, shown[output])


@with_equations
def test_a_state_that_is_set_is_found_and_a_clone_keeps_it(kind, rng):
    block, context = made(kind, rng)
    own = block.equations_of_block
    if not len(own.state):
        pytest.skip("it has no state")
    read = block._reader(STATE)
    values = own.state + rng.uniform(0.01, 0.05, len(own.state))
    set_state_values(context, values)
    clone, start = context.Clone(), 0
    set_state_values(context, own.state)
    np.testing.assert_array_equal(read(clone), values)
    np.testing.assert_array_equal(read(context), own.state)
    np.testing.assert_array_equal(read(block.CreateDefaultContext()), own.state)
    for name, size in own.shown.items():
        shown = block.GetOutputPort(name).Eval(clone)
        np.testing.assert_array_equal(shown, values[start : start + size])
        start += size


# Bad input


@dataclass
class OwnConfig:
    """It has no parameters."""


class Own(Block):
    """Reads the load's state, and makes a signal of its own."""

    reads, makes = ("load_state",), ("shown",)
    signal_layouts: ClassVar = {"shown": Layout(Part("shown", "3", "m"))}
    calls: ClassVar = itertools.count()
    rng: ClassVar = np.random.default_rng(0)


def random(load_state):
    return load_state[4:7] + Own.rng.normal(size=3)


def random_choice(load_state):
    return load_state[4:7] if next(Own.calls) % 2 else np.zeros(3)


def counter(load_state):
    return load_state[4:7] * next(Own.calls)


def branch(load_state):
    return load_state[4:7] if load_state[6] > 0 else 0 * load_state[4:7]


def branch_of_arrays(load_state):
    return np.where(load_state[4:7] > 0, load_state[4:7], 0.0)


def numpy_norm(load_state):
    return np.linalg.norm(load_state[4:7]) * load_state[4:7]


def wrong_size(load_state):
    return load_state[4:8]


def two_results(load_state):
    return load_state[4:7], load_state[4:7]


def nothing(load_state):
    return None


def writes(load_state):
    shown = np.zeros(3)
    shown[:] = load_state[4:7]
    return shown


def one_number(load_state):
    return np.concatenate([(load_state[4] * load_state[5]) ** 0.5 * load_state[6:7], np.zeros(2)])


def wrong_arguments(load_state, wind):
    return load_state[4:7]


PURE, PLAIN = (
    "give it no random numbers, counters or clocks",
    r"without branches \(systems\.tracing\.where\)",
)
WRITTEN = r"make arrays by np\.concatenate"
ENTRY = r"x\[:1\] and not x\[0\]"
SIZES = r"return an array for each of shown \(3\)"
BAD = {
    **dict.fromkeys((random, random_choice, counter), PURE),
    **dict.fromkeys((branch, branch_of_arrays, numpy_norm, wrong_arguments), PLAIN),
    writes: WRITTEN,
    one_number: ENTRY,
    **dict.fromkeys((wrong_size, two_results, nothing), SIZES),
}


def own_block(function):
    return type("Shows", (Own,), {"equations": staticmethod(function), "__module__": __name__})


@pytest.mark.parametrize(
    ("function", "remedy"), BAD.items(), ids=lambda bad: getattr(bad, "__name__", "")
)
def test_equations_that_cannot_be_are_named_with_the_remedy(function, remedy):
    with pytest.raises(ScenarioError, match=rf"Shows\.equations = .*: .*{remedy}") as raised:
        simulate(load_scenario("quintic"), extra={"own": own_block(function)})
    assert "\n" not in str(raised.value)


def test_two_blocks_that_make_one_signal_are_both_named():
    good = own_block(lambda load_state: norm(load_state[4:7]) * load_state[4:7])
    with pytest.raises(ScenarioError, match=r"one.*other|other.*one"):
        make_nonstop(load_scenario("quintic"), extra={"one": good, "other": good})


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ({"optional": {"a": 1.0}}, {"optional": {"a": 2.0}}),
        ({"optional": {"a": 1.0}}, {"optional": {"b": 1.0}}),
        ({"shown": {"c": 1, "d": 1}}, {"shown": {"d": 1, "c": 1}}),
    ],
)
def test_equations_share_nothing_where_what_is_declared_beside_them_differs(one, other):
    own = {"inputs": {"a": 1, "b": 1}, "outputs": {"e": 1}, "state": [0, 0], "key": "of both"}
    keys = [Equations(len, **own, **each).key for each in (one, one, other)]
    assert keys[0] == keys[1] != keys[2]


def test_constants_that_cannot_be_pickled_are_taken_and_shared_with_none():
    class Takes(Own):
        @staticmethod
        def equations(load_state, *, own):
            return load_state[4:7]

        def constants(self, model, config):
            return {"own": [lambda values: values]}

    loop = make_nonstop(load_scenario("quintic"), extra={"own": Takes})
    assert loop.GetSubsystemByName("own").equations_of_block.key is None


def test_a_layer_may_show_its_state_alone():
    class Shows(Own):
        reads, is_sampled, state_ports = ("load_state",), True, ("shown",)

        def state(self, model):
            return np.zeros(3)

        def answer(self, context):
            return self.GetInputPort("load_state").Eval(context)[4:7]

        @staticmethod
        def equations(state, load_state):
            return ()

    scenario = load_scenario("quintic", ["simulation_duration=0.1"])
    runs = [simulate(scenario, engine=e, extra={"own": Shows}) for e in ("compiled", "diagram")]
    assert runs[0].engine.startswith("compiled")
    compiled, diagram = (run.signal("own.shown") for run in runs)
    assert np.any(diagram)
    np.testing.assert_allclose(compiled, diagram, atol=1e-9)


class Answers(Own):
    """A layer."""

    is_sampled, state_ports = True, ("shown",)

    def state(self, model):
        return np.zeros(3)

    def answer(self, context):
        return np.ones(3)

    @staticmethod
    def equations(state, load_state):
        return ()


@pytest.mark.parametrize(
    ("members", "said"),
    [
        ({"state": lambda self, model: None, "state_ports": ()}, r"Answers\.answer = that of no"),
        ({"step_period": lambda self, model, config: 0.0}, r"Answers\.answer = that of no"),
        ({"step_period": lambda self, model, config: -0.01}, r"Answers\.step_period = -0.01: give"),
        ({"step_period": lambda self, model, config: np.nan}, r"Answers\.step_period = nan: give"),
    ],
)
def test_layers_need_a_state_and_time_to_step(members, said):
    kind = type("Answers", (Answers,), {"__module__": __name__, **members})
    with pytest.raises(ScenarioError, match=said):
        make_nonstop(load_scenario("quintic"), extra={"own": kind})


@pytest.mark.parametrize("engine", ["compiled", "diagram"])
@pytest.mark.parametrize(
    ("answer", "error", "said"),
    [
        (np.ones(2), ScenarioError, r"own\.answer = 2 numbers: return the next state, 3 numbers"),
        (np.full(3, np.nan), ScenarioError, "start = own: it makes a value that is not finite"),
    ],
)
def test_an_answer_that_is_no_state_names_its_layer(answer, error, said, engine):
    kind = type(
        "Answers", (Answers,), {"__module__": __name__, "answer": lambda self, context: answer}
    )
    scenario = load_scenario("quintic", ["simulation_duration=0.1"])
    with pytest.raises(error, match=said):
        simulate(scenario, engine=engine, extra={"own": kind})
