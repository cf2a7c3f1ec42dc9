"""Each lane gets the bits of CasADi's own evaluation, for all operations that have a form."""

import casadi
import numpy as np
import pytest

from drake_nonstop.loop.lane_functions import LaneFunction, LaneInputs, lanes_code
from drake_nonstop.systems.compilation import (
    CompilationError,
    c_text,
    compiled,
    compiled_for_processor,
    compiler,
)
from drake_nonstop.systems.tracing import for_each, object_array

needs_compiler = pytest.mark.skipif(compiler() is None, reason="there is no C compiler")
BINARY = [
    *("ADD", "SUB", "MUL", "DIV", "LT", "LE", "EQ", "NE", "AND", "OR", "IF_ELSE_ZERO"),
    *("ATAN2", "POW", "CONSTPOW", "FMIN", "FMAX", "FMOD", "REMAINDER", "HYPOT", "COPYSIGN"),
]
UNARY = [
    *("NEG", "SQ", "TWICE", "INV", "FABS", "NOT", "SIGN", "SQRT", "SIN", "COS", "TAN", "ASIN"),
    *("ACOS", "ATAN", "SINH", "COSH", "TANH", "ASINH", "ACOSH", "ATANH", "EXP", "LOG", "EXPM1"),
    *("LOG1P", "ERF", "FLOOR", "CEIL"),
]
SIZES = [2, 1, 1, 1]  # of the state, the parameters, the time and the blocks' own updates
LIMIT = 1e3


def whole_sample(after, shown, is_valid=1.0):
    """A function as of a loop's whole sample, of its `argument`."""
    argument = casadi.SX.sym("x", sum(SIZES) + 1)
    after, shown, is_valid = (f(argument) if callable(f) else f for f in (after, shown, is_valid))
    results = [after, shown, argument[3], argument[4], is_valid, casadi.sumsqr(after)]
    return casadi.Function("loop", [argument], results)


def lanes_of(function):
    library = compiled_for_processor(lambda: lanes_code(function, SIZES), builds=True)
    return LaneFunction(library, function)


def drawn(generator, samples, state=None):
    state = generator.normal(size=2) if state is None else state
    rows = np.arange(float(samples)), generator.normal(size=(samples, 1))
    return LaneInputs(LIMIT, state, generator.normal(size=1), *rows)


@needs_compiler
def test_all_operations_give_the_same_bits():
    def shown(x):
        unary = [casadi.SX.unary(getattr(casadi, f"OP_{name}"), x[0]) for name in UNARY]
        pairs = [(x[0], x[5]), (x[2], x[1])]
        binary = [
            casadi.SX.binary(getattr(casadi, f"OP_{name}"), *pair)
            for name in BINARY
            for pair in pairs
        ]
        return casadi.vertcat(*unary, *binary, -0.0 * x[0], 0.1 + x[1], casadi.inf * x[0])

    function = whole_sample(lambda x: x[[1, 0]] * 0.9, shown)
    codes = {function.instruction_id(k) for k in range(function.n_instructions())}
    assert {getattr(casadi, f"OP_{name}") for name in UNARY} <= codes
    generator = np.random.default_rng(3)
    special = [np.zeros(2), np.ones(2), np.array([-0.0, 0.5]), np.array([-0.7, 0.7])]
    inputs = [drawn(generator, 3, state) for state in special]
    inputs += [drawn(generator, count) for count in (1, 4, 2, 7, 5, 3)]
    flown, states, signals, steps = lanes_of(function).fly(inputs)
    assert flown == [len(each.times) for each in inputs]
    row = 0
    for each, state in zip(inputs, states, strict=True):
        now = each.state
        for time, outside in zip(each.times, each.outside, strict=True):
            argument = np.concatenate([now, each.parameters, [time], [0.0], outside])
            after, expected, *_ = (np.array(value).ravel() for value in function(argument))
            same = signals[row].view(np.int64) == expected.view(np.int64)
            assert (same | (np.isnan(signals[row]) & np.isnan(expected))).all()
            assert steps[row] == time
            now, row = after, row + 1
        np.testing.assert_array_equal(state, now)


@needs_compiler
def test_a_flight_stops_before_an_update_or_a_limit_and_others_take_its_lane():
    """The outside of a sample is added to the state; updates are right up to time 5."""
    function = whole_sample(lambda x: x[:2] + x[5], lambda x: x[0], lambda x: x[3] < 5)
    zeros, ones = np.zeros(2), np.ones((9, 1))
    times = np.arange(9.0)
    inputs = [LaneInputs(LIMIT, zeros, zeros[:1], times - k, ones) for k in range(9)]
    inputs[4] = inputs[4]._replace(largest=3.0)  # of the root of 2 s²
    inputs[6] = inputs[6]._replace(outside=np.where(times == 2, np.nan, 1.0)[:, None])
    flown, states, signals, _ = lanes_of(function).fly(inputs)
    assert flown == [5, 6, 7, 8, 2, 9, 2, 9, 9]
    np.testing.assert_array_equal(states, np.repeat(flown, 2).reshape(-1, 2))
    for k, count in enumerate(flown):
        np.testing.assert_array_equal(signals[9 * k : 9 * k + count, 0], np.arange(count))


@needs_compiler
def test_functions_that_call_others_give_the_same_bits():
    """As a loop of cables: steps in vectors call rates, which call a function for each cable."""

    def each(row, shared):
        return np.array([np.sin(row[0]) * shared[0], row[1] / row[0] + 0.1])

    own = casadi.SX.sym("own", 3)
    state, shared = np.split(object_array(own), [2])
    made = for_each(each, [np.stack([state, state[::-1]])], [shared])
    rates = casadi.Function("rates", [own], [casadi.vertcat(*made.sum(axis=0)), own[0]])
    argument = casadi.MX.sym("x", sum(SIZES) + 1)
    now, _, time, _, outside = casadi.vertsplit(argument, [0, *np.cumsum([*SIZES, 1]).tolist()])
    signals = []
    for length in (0.1, 0.2):
        rate, shown = rates(casadi.vertcat(now, outside))
        now = now - length * rate
        signals += [shown, casadi.MX([0.5, -2.0]) * now]
    steps, read = casadi.vertcat(now, time), casadi.MX(0, 1)
    results = [now, casadi.vertcat(*signals), steps, read, casadi.MX(0, 1), casadi.dot(now, now)]
    function = casadi.Function("loop", [argument], results)
    # The rates, the rows of both, what is made of a row: each one once.
    assert lanes_code(function, SIZES).count("static void called_") == 4
    each_input = drawn(np.random.default_rng(5), 4)
    flown, states, signals, steps = lanes_of(function).fly([each_input] * 3)
    assert flown == [4] * 3
    now = each_input.state
    for k in range(4):
        rows = [now, each_input.parameters, [each_input.times[k]], [0.0], each_input.outside[k]]
        now, expected, stepped, *_ = (np.array(v).ravel() for v in function(np.concatenate(rows)))
        for flight in range(3):
            np.testing.assert_array_equal(signals[4 * flight + k], expected)
            np.testing.assert_array_equal(steps[4 * flight + k], stepped)
    np.testing.assert_array_equal(states, [now] * 3)


@pytest.mark.parametrize("n", [1, 3, 4, 9])
def test_rows_are_made_side_by_side_in_c_to_the_bit(n):
    def of_row(row, shared):
        return np.array([np.sin(row[0]) * shared[0], row[1] / row[0], np.sqrt(row[2])])

    own = casadi.SX.sym("own", 3 * n + 2)
    entries = object_array(own)
    made = for_each(of_row, [entries[: 3 * n].reshape(n, 3)], [entries[3 * n :]])
    function = casadi.Function("loop", [own], [casadi.vertcat(*made.ravel()), own[0]])
    assert ("static void row_0" in c_text(function)) == (n > 1)
    in_c = compiled(function).function
    given = np.random.default_rng(n).uniform(0.5, 2.0, 3 * n + 2)
    np.testing.assert_array_equal(in_c(given)[0], function(given)[0])


def test_an_operation_without_a_form_is_told():
    function = whole_sample(lambda x: casadi.vertcat(casadi.erfinv(x[0]), x[1]), lambda x: x[0])
    with pytest.raises(CompilationError, match=f"operation {casadi.OP_ERFINV}"):
        lanes_code(function, SIZES)
