"""What holds of every block: each variant of each box, of continuous and of sampled controllers."""

import dataclasses
import inspect
import itertools
import pydoc
import re

import numpy as np
import pytest
import yaml
from helpers import difference, fix, sizes_of_ports, vector_outputs
from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, ExtractValue
from pydrake.symbolic import Expression
from pydrake.systems.framework import LeafSystem, PortDataType
from registries import (
    BOXES,
    CASES,
    CONFIGS,
    VARIANTS,
    changed_model,
    loop_of,
    made,
    made_with,
    model_of,
    near_rest,
)

from drake_nonstop import ScenarioError
from drake_nonstop.mechanics.signals import HELD, SIGNALS
from drake_nonstop.systems.block import set_state_values, state_values
from drake_nonstop.systems.equation_block import EquationBlock
from drake_nonstop.systems.equations import STATE

LAYOUTS = SIGNALS | {name: kind for box in BOXES.values() for name, kind in box.signals.items()}
TIME = 5.5037  # s, at which references move, and nothing is sampled
every = pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.box}-{case.name}")


def input_sizes(block):
    return sizes_of_ports(block, "input")


def vector_inputs(block):
    return [name for name, size in input_sizes(block).items() if size is not None]


def plain(signal):
    """The signal that is held, or sampled, by another name."""
    return signal.removeprefix(HELD).removeprefix("sampled_")


def context_of(block, loop, rng):
    """A context with inputs and a state near those of a loop at rest, or else near 1."""
    diagram, root, signals = loop
    context = block.CreateDefaultContext()
    for name, size in input_sizes(block).items():
        value = signals.get(plain(name))
        if size is None:
            block.GetInputPort(name).FixValue(context, value)
        elif name == "sample_time":
            fix(block, context, sample_time=np.array([TIME - 0.004]))
        else:
            known = value is not None and np.size(value) == size
            fix(block, context, **{name: near_rest(value if known else np.full(size, 0.5), rng)})
    context.SetTime(TIME)
    state = state_values(context)
    for other in diagram.GetSystems():
        of_other = state_values(other.GetMyContextFromRoot(root))
        if type(other) is type(block) and len(of_other) == len(state):
            state = of_other
    set_state_values(context, near_rest(state, rng))
    return context


@pytest.fixture
def block_and_context(case, rng):
    block, name = made(case)
    return block, context_of(block, loop_of(name, case.is_sampled), rng)


def results_of(block, context):
    """The vector outputs of a block, and the rates of its state, by name."""
    found = {name: block.GetOutputPort(name).Eval(context) for name in vector_outputs(block)}
    if context.num_continuous_states():
        found[STATE] = block.EvalTimeDerivatives(context).CopyToVector()
    return found


def same(found, expected, **tolerances):
    assert found.keys() == expected.keys()
    for name, values in found.items():
        np.testing.assert_allclose(values, expected[name], err_msg=name, **tolerances)


def of_type(block, context, scalar, vary):
    """The results of a block of another scalar type, where `vary` makes its numbers."""
    other = block.ToAutoDiffXd() if scalar is AutoDiffXd else block.ToSymbolic()
    own = other.CreateDefaultContext()
    own.SetTimeStateAndParametersFrom(context)
    for name in input_sizes(block):
        value = block.GetInputPort(name).Eval(context)
        is_vector = block.GetInputPort(name).get_data_type() == PortDataType.kVectorValued
        other.GetInputPort(name).FixValue(own, vary(name, value) if is_vector else value)
    if scalar is AutoDiffXd:
        own.SetTime(vary("time", [context.get_time()])[0])
    if scalar is AutoDiffXd and context.num_continuous_states():
        own.SetContinuousState(vary(STATE, context.get_continuous_state_vector().CopyToVector()))
    return results_of(other, own)


@every
def test_all_four_scalar_types_show_the_same_and_one_derivative(block_and_context):
    """Floats by CasADi and by NumPy; those of AutoDiffXd with the slopes of the others."""
    block, context = block_and_context
    expected = results_of(block, context)

    def along(name, size):
        return np.random.default_rng([1, *name.encode()]).uniform(0.5, 1, size)

    def dual_of(name, values):
        pairs = np.transpose([values, along(name, len(values))])
        return np.array([AutoDiffXd(x, [d]) for x, d in pairs])

    dual = of_type(block, context, AutoDiffXd, dual_of)
    same({k: ExtractValue(v).ravel() for k, v in dual.items()}, expected, rtol=1e-9, atol=1e-9)
    if None not in input_sizes(block).values():  # of a preview, symbols of plans take minutes
        symbolic = of_type(block, context, Expression, lambda name, v: [Expression(x) for x in v])
        found = {name: [x.Evaluate() for x in values] for name, values in symbolic.items()}
        same(found, expected, rtol=1e-9, atol=1e-9)

    def moved(step):
        other = context.Clone()
        other.SetTime(TIME + step * along("time", 1)[0])
        for name in vector_inputs(block):
            value = block.GetInputPort(name).Eval(context)
            fix(block, other, **{name: value + step * along(name, len(value))})
        if count := context.num_continuous_states():
            state = context.get_continuous_state_vector().CopyToVector()
            other.SetContinuousState(state + step * along(STATE, count))
        return results_of(block, other)

    for name, values in dual.items():
        slope = difference(lambda step, name=name: moved(step)[name], 0.0, 1e-5)
        own = ExtractGradient(values)
        own = own[:, 0] if own.size else np.zeros(len(slope))
        scale = 1 + np.max(np.abs(slope), initial=0.0)
        np.testing.assert_allclose(own, slope, atol=2e-5 * scale, err_msg=name)
    if isinstance(block, EquationBlock):
        own = block.equations_of_block
        given = {name: block._reader(name)(context).copy() for name in own.arguments}
        by_numpy = own.compute(given) | (own.compute(given, starts=True) if own._start else {})
        by_casadi = {name: block.result(context, name).copy() for name in by_numpy}
        same(by_numpy, by_casadi, rtol=1e-9, atol=1e-9)


def read_by(own, output):
    """The inputs that the trace of an output reads."""
    reads = own.reads_of(output)
    inputs = {name for name in reads if name in own.inputs}
    inner = (k for k in reads if k in own.outputs and k not in own.arguments)
    return inputs.union(*(read_by(own, k) for k in inner))


@every
def test_what_feeds_through_is_what_the_trace_reads_and_nothing_else_counts(block_and_context):
    block, context = block_and_context
    shown = results_of(block, context)
    outputs = vector_outputs(block)
    through = {
        (source, target)
        for source, target in itertools.product(input_sizes(block), outputs)
        if block.HasDirectFeedthrough(
            block.GetInputPort(source).get_index(), block.GetOutputPort(target).get_index()
        )
    }
    if isinstance(block, EquationBlock):
        own = block.equations_of_block
        assert through == {(k, output) for output in outputs for k in read_by(own, output)}
    for source in vector_inputs(block):
        other = context.Clone()
        fix(block, other, **{source: 1.1 * block.GetInputPort(source).Eval(context) + 0.01})
        for target, values in results_of(block, other).items():
            if target != STATE and (source, target) not in through:
                np.testing.assert_array_equal(values, shown[target], err_msg=f"{source}, {target}")


def as_in(context, block, other=None):
    """A context of a block, or of its clone, with all that a context of the block has."""
    own = (other or block).CreateDefaultContext()
    own.SetTimeStateAndParametersFrom(context)
    (other or block).FixInputPortsFrom(block, context, own)
    return own


@every
def test_results_follow_each_change_to_the_bit_and_clones_of_context_and_block_keep_theirs(
    block_and_context, rng
):
    """As in a context of its own: nothing that was kept is stale."""
    block, context = block_and_context
    before, expected = state_values(context), results_of(block, context)
    other = block.Clone()
    clones = (block, context.Clone()), (other, as_in(context, block, other))

    def check(changed):
        fresh = results_of(block, as_in(context, block))
        for name, values in results_of(block, context).items():
            np.testing.assert_array_equal(values, fresh[name], err_msg=f"{changed}, {name}")

    check("nothing")
    for name in vector_inputs(block):
        fix(block, context, **{name: near_rest(block.GetInputPort(name).Eval(context), rng)})
        check(name)
    values = near_rest(before, rng)
    set_state_values(context, values)
    np.testing.assert_array_equal(state_values(context), values)
    check("state")
    if isinstance(block, EquationBlock) and len(block.equations_of_block.state):
        ports = block.equations_of_block.shown
        shown = [block.GetOutputPort(name).Eval(context) for name in ports]
        np.testing.assert_array_equal(np.concatenate([[], *shown]), values[: sum(ports.values())])
    context.SetTime(TIME + 0.75)
    check("time")
    for k in range(context.num_numeric_parameter_groups()):
        group = context.get_mutable_numeric_parameter(k)
        group.SetFromVector(1.01 * group.CopyToVector())
        check("parameters")
    for each, own in clones:
        np.testing.assert_array_equal(state_values(own), before)
        for name, values in results_of(each, own).items():
            np.testing.assert_array_equal(values, expected[name], err_msg=name)


# What counts, besides, where a block is built: gains that are "auto" follow the load, the axes of
# gusts the mean wind, and the first plan the frequency.
_LOAD = {"load_mass", "load_inertia", "gravity", "cable_length"}
ALSO_BUILT = {
    "CarrierTrajectory": {"cable_length", "gravity"},
    "BowedCarrierTrajectory": {"cable_length", "gravity"},
    "ObservedCarrierTrajectory": {"cable_length", "gravity"},
    "WrenchController": _LOAD,
    "PaperWrenchController": _LOAD,
    "GustyWind": {"velocity"},
    "RecedingHorizonOptimizer": {"frequency"},
}


SAMPLED = [case for case in CASES if case.is_sampled]


@pytest.mark.parametrize("case", SAMPLED, ids=lambda case: f"{case.box}-{case.name}")
def test_a_parameter_of_the_context_is_that_of_a_block_built_with_it(case, block_and_context):
    block, context = block_and_context
    if not isinstance(block, EquationBlock) or not len(block.equations_of_block.parameters):
        pytest.skip("it has no parameters")
    numbers, counted = block.parameters, 0
    defaults = context.get_numeric_parameter(0).CopyToVector()
    for name, value in numbers.defaults.items():
        if name in {"pattern_offset", *ALSO_BUILT.get(case.kind.__name__, ())}:
            continue
        new = 1.03 * value if np.any(value) else value + 0.05
        changes = {name: new.tolist()}
        system, config = (changes, {}) if name in numbers.of_system else ({}, changes)
        try:
            other = made_with(case, changed_model(model_of(case), **system), **config)
        except ScenarioError:
            continue  # a value out of its range, or one that has to fit another
        own = other.CreateDefaultContext()
        if input_sizes(other) != input_sizes(block) or len(state_values(own)) != len(
            state_values(context)
        ):
            continue  # a field that makes it another block
        own.SetTime(context.get_time())
        set_state_values(own, state_values(context))
        other.FixInputPortsFrom(block, context, own)
        vector = defaults.copy()
        vector[numbers.place(name)] = np.ravel(new)
        context.get_mutable_numeric_parameter(0).SetFromVector(vector)
        same(results_of(block, context), results_of(other, own), rtol=1e-11, atol=1e-11)
        counted += 1
    assert counted or case.kind.__name__ in ALSO_BUILT


@every
def test_rows_of_quantities_are_those_of_each_time_and_have_their_rates(case):
    block, _ = made(case)
    if not isinstance(block, EquationBlock) or not block.equations_of_block.quantities:
        pytest.skip("it has no quantities")
    times, h = 0.1137 + 0.2 * np.arange(27), 1e-6  # s, at which nothing is sampled
    for name in block.equations_of_block.quantities:
        rows, ahead, behind = (
            block.precomputed_inputs([name], times + step)[0] for step in (0, h, -h)
        )
        np.testing.assert_array_equal(rows, [block.quantity_at(name, time) for time in times])
        (rates,) = block.precomputed_input_rates([name], times)
        scale = max(1.0, np.abs(rates).max())
        np.testing.assert_allclose(rates, (ahead - behind) / (2 * h), atol=1e-5 * scale)


def is_there(case, name):
    """Whether a block may have a port, by what its class says of where it has it."""
    where = case.kind.where.get(name, "")
    fields = vars(CONFIGS[case.kind](**case.fields))
    words = re.findall(r"`(\w+)` is (true|false)", where)
    by_fields = all(str(fields[field]).lower() == value for field, value in words)
    return by_fields and (case.is_sampled or "control period" not in where)


@every
def test_ports_are_those_that_the_class_declares_in_the_sizes_of_their_layouts(case):
    block, own = made(case)[0], model_of(case)
    inputs, outputs = input_sizes(block), sizes_of_ports(block)
    known = LAYOUTS | dict(block.signal_layouts)
    for name, size in {**inputs, **outputs}.items():
        layout = known.get(name, known.get(plain(name)))
        expected = None if layout is None else layout.count(own.n, own.m)
        assert size == expected, name
    declared = [*case.kind.reads, *case.kind.makes]
    assert {*map(plain, (*inputs, *outputs))} <= {*map(plain, declared)}
    for name in declared:
        if not block.where.get(name):
            is_read = plain(name) in {*map(plain, (*inputs, *outputs))}
            is_measured = name.startswith((HELD, "measured_margin"))
            assert is_read or (is_measured and not case.is_sampled), name
    for name in (*inputs, *outputs):
        assert is_there(case, name), name
    assert {*block.optional_inputs} <= {*case.kind.reads}


@pytest.mark.parametrize("name", VARIANTS)
def test_the_docstring_of_a_block_tells_all_that_it_declares(name):
    _, block = VARIANTS[name]
    assert issubclass(block, LeafSystem) == (block.__name__ != "MultibodyLoadPlant")
    assert "`model` and a `config`" in inspect.getdoc(block.__init__)
    text = inspect.getdoc(block)
    section = re.search(r"\.\. pydrake_system::\n\n((?:    .*\n)+)", text)
    ports = yaml.safe_load(inspect.cleandoc(section[1]))
    assert ports["name"] == block.__name__
    for kind, names in (("input_ports", block.reads), ("output_ports", block.makes)):
        assert [port.partition(" ")[0] for port in ports.get(kind, [])] == list(names)
    known = LAYOUTS | dict(block.signal_layouts)
    for signal in (*block.reads, *block.makes):
        (line,) = {line for line in text.splitlines() if line.startswith(f"- `{signal}` (")}
        layout = known[signal.removeprefix(HELD)]
        size = "abstract" if layout is None else layout.size
        assert line.startswith((f"- `{signal}` ({size})", f"- `{signal}` ({size}, "))
    for field in dataclasses.fields(CONFIGS[block]):
        assert re.search(rf"(?m)^- `{field.name}`: \S", text), field.name
    shown = pydoc.render_doc(block, renderer=pydoc.plaintext).replace("\n |  ", "\n")
    assert block.__doc__ in shown
