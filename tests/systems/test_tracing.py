import gc
import operator
from collections import OrderedDict
from copy import copy

import numpy as np
import pytest
from pydrake.autodiffutils import ExtractGradient, InitializeAutoDiff

from drake_nonstop.systems import tracing
from drake_nonstop.systems.tracing import NotFiniteError, TracedFunction, for_each, recent


def equations(a, b):
    """A matrix, a vector with a constant entry, and one number, of (3,) and (2,)."""
    matrix = a[:, None] * b[None, :]
    return (
        matrix,
        np.concatenate([np.sin(a), 0 * a[:1] + 7.0]),
        (a * a).sum(keepdims=True) / b[:1],
    )


A, B = np.array([0.3, -1.2, 2.0]), np.array([0.7, -0.4])


def compiled(**arguments):
    return TracedFunction(equations, [3, 2], name=lambda: "some_block", **arguments)


def test_outputs_are_flat_and_equal_to_the_functions():
    outputs = compiled()(A, B)
    expected = equations(A, B)
    assert [output.shape for output in outputs] == [(6,), (4,), (1,)]
    for output, array in zip(outputs, expected, strict=True):
        np.testing.assert_allclose(output, array.ravel(), rtol=1e-15)


@pytest.mark.parametrize("index", [0, 1])
def test_jacobian_stands_last_and_is_that_of_autodiff(index):
    *outputs, jacobian = compiled(jacobian_of=index)(A, B)
    inputs = [A, B]
    inputs[index] = InitializeAutoDiff(inputs[index])[:, 0]
    stacked = np.concatenate([np.asarray(output).ravel() for output in equations(*inputs)])
    # Entries that do not depend on the input are floats; 0 · x makes them AutoDiffXd.
    expected = ExtractGradient(stacked + 0 * inputs[index][0])
    assert jacobian.shape == (11, len(inputs[index]))
    np.testing.assert_allclose(jacobian, expected, rtol=0, atol=1e-14)
    np.testing.assert_allclose(np.concatenate(outputs)[:6], np.outer(A, B).ravel(), rtol=1e-15)


def test_jacobian_is_the_difference_of_the_values():
    function = compiled(jacobian_of=0)
    jacobian = function(A, B)[-1].copy()
    h = 1e-6
    for column, step in enumerate(h * np.eye(3)):
        above = np.concatenate(function(A + step, B)[:-1])
        below = np.concatenate(function(A - step, B)[:-1])
        np.testing.assert_allclose(jacobian[:, column], (above - below) / (2 * h), atol=1e-8)


def test_single_array_needs_no_tuple():
    outputs = TracedFunction(lambda a: 2 * a, [3], name=str)(A)
    assert len(outputs) == 1
    np.testing.assert_array_equal(outputs[0], 2 * A)


def test_results_are_views_that_the_next_call_overwrites():
    function = compiled(jacobian_of=1)
    first = function(A, B)
    before = [output.copy() for output in first]
    second = function(3 * A, B / 2)
    for old, new, kept in zip(first, second, before, strict=True):
        assert np.shares_memory(old, new)
        assert not np.array_equal(new, kept)


def test_same_inputs_give_the_same_bits_whatever_came_between():
    function = compiled(jacobian_of=0)
    first = [output.copy() for output in function(A, B)]
    function(B[[0, 1, 0]], A[:2])
    for output, expected in zip(function(A, B), first, strict=True):
        np.testing.assert_array_equal(output, expected)


def test_inputs_are_left_alone():
    a, b = A.copy(), B.copy()
    compiled()(a, b)
    np.testing.assert_array_equal(a, A)
    np.testing.assert_array_equal(b, B)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 2e9, -2e9, 1e300])
@pytest.mark.parametrize("entry", [0, 2])
def test_value_beyond_reason_names_the_block(bad, entry):
    function = TracedFunction(lambda a: (a[:1], a[1:]), [3], name=lambda: "some_block")
    values = A.copy()
    values[entry] = bad
    with pytest.raises(NotFiniteError, match="some_block"):
        function(values)
    np.testing.assert_array_equal(function(A)[1], A[1:])


def test_division_by_zero_names_the_block():
    with pytest.raises(NotFiniteError, match="some_block"):
        compiled()(A, np.array([0.0, 1.0]))


def test_large_values_within_reason_pass():
    values = np.array([5e5, -5e5, 0.0])
    (result,) = TracedFunction(lambda a: a * 1.0, [3], name=str)(values)
    np.testing.assert_array_equal(result, values)


def test_name_is_the_one_at_the_time_of_the_error():
    names = ["before"]
    function = TracedFunction(lambda a: a * 1.0, [1], name=lambda: names[0])
    names[0] = "after"
    with pytest.raises(NotFiniteError, match="after"):
        function(np.array([np.nan]))


@pytest.mark.parametrize("inputs", [(A,), (A, A), (A, B, B), (A[:2], B), (A, B[None, :])])
def test_wrong_sizes_of_inputs_raise(inputs):
    with pytest.raises(ValueError, match=r"dimension|shape"):
        compiled()(*inputs)


def test_many_instances_survive_garbage_collection():
    gc.freeze()  # only what is made here is collected, which is quicker
    functions = []
    for k in range(6):
        functions.append(
            TracedFunction(
                lambda a, b, k=k: (a * (k + 1), b.sum(keepdims=True)),
                [3, 2],
                name=str,
                jacobian_of=0,
            )
        )
        if k % 3 == 0:
            del functions[len(functions) // 2]
            gc.collect()
    gc.unfreeze()
    for function in functions:
        scaled, total, jacobian = function(A, B)
        k = round(scaled[0] / A[0])
        np.testing.assert_allclose(scaled, k * A, rtol=1e-15)
        np.testing.assert_allclose(total, [0.3], rtol=1e-15)
        np.testing.assert_array_equal(jacobian, np.vstack([k * np.eye(3), np.zeros((1, 3))]))


@pytest.mark.nightly("engines")
def test_results_outlive_the_function():
    scaled, *_ = TracedFunction(lambda a: 3 * a, [3], name=str)(A)
    gc.collect()
    clutter = [np.full(3, 9.0) for _ in range(1000)]
    np.testing.assert_array_equal(scaled, 3 * A)
    assert len(clutter) == 1000


@pytest.mark.parametrize("name", ["add", "sub", "mul", "truediv", "pow"])
@pytest.mark.parametrize("number", [3, 0.7, np.float64(0.7), np.array([0.7, 2.0, 3.0])])
def test_operators_take_numbers_and_arrays_on_either_side(name, number, rng):
    operate, in_place = getattr(operator, name), getattr(operator, f"i{name}")

    def results(x, y):
        pairs = (x, y), (x, number), (number, x), (x[0], number), (number, x[0]), (y, -x[0])
        made = [operate(a, b) for a, b in pairs] + [in_place(copy(a), b) for a, b in pairs[:2]]
        made.append(in_place(x[0], y[0]))
        return tuple(m if isinstance(m, np.ndarray) else np.fromiter([m], object) for m in made)

    x, y = rng.uniform(0.5, 2.0, (2, 3))
    traced = TracedFunction(results, [3, 3], name=str)(x, y)
    for value, expected in zip(traced, results(x, y), strict=True):
        np.testing.assert_allclose(value, expected.astype(float), rtol=1e-15)


def test_a_function_for_each_is_traced_once_and_has_the_values_and_derivatives_of_calls(rng):
    calls = []

    def scaled(matrix, vector, shared):
        calls.append(0)
        return matrix @ vector * np.sin(shared) + vector[:2]

    def each(matrices, vectors, shared):
        return for_each(scaled, [matrices.reshape(4, 2, 3), vectors.reshape(4, 3)], [shared])

    inputs = [rng.normal(size=size) for size in (24, 12, 2)]
    traced = TracedFunction(each, [24, 12, 2], name=lambda: "some_block", jacobian_of=2)
    assert len(calls) == 1
    values, slopes = traced(*inputs)
    matrices, vectors = inputs[0].reshape(4, 2, 3), inputs[1].reshape(4, 3)
    expected = (matrices @ vectors[..., None])[..., 0] * np.sin(inputs[2]) + vectors[:, :2]
    assert values == pytest.approx(expected.ravel(), rel=1e-14)
    assert slopes[0, 0] == pytest.approx((expected[0, 0] - inputs[1][0]) / np.tan(inputs[2][0]))
    assert each(*inputs).ravel() == pytest.approx(values, rel=1e-14)


def test_what_is_made_for_an_equal_key_is_made_once_and_what_was_not_used_longest_goes(monkeypatch):
    monkeypatch.setattr(tracing, "_MOST_TRACES", 2)
    monkeypatch.setattr(tracing, "_recent", OrderedDict())
    made = []

    def value_of(*key):
        return recent(lambda: made.append(key) or len(made), *key)

    assert [value_of(name, [1]) for name in "abaca"] == [1, 2, 1, 3, 1]
    assert value_of("b", [1]) == 4
    assert [value_of("a", None), value_of("a", None)] == [5, 6]
