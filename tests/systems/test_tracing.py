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
    return (
        a[:, None] * b[None, :],
        np.concatenate([np.sin(a), 0 * a[:1] + 7.0]),
        (a * a).sum(keepdims=True) / b[:1],
    )


A, B = np.array([0.3, -1.2, 2.0]), np.array([0.7, -0.4])


def compiled(**arguments):
    return TracedFunction(equations, [3, 2], name=lambda: "some_block", **arguments)


@pytest.mark.parametrize("index", [0, 1])
def test_results_are_flat_and_the_jacobian_stands_last_and_the_next_call_overwrites_them(index):
    function = compiled(jacobian_of=index)
    *outputs, jacobian = found = function(A, B)
    for output, array in zip(outputs, equations(A, B), strict=True):
        np.testing.assert_allclose(output, array.ravel(), rtol=1e-15)
    for output, array in zip(compiled()(A, B), outputs, strict=True):
        np.testing.assert_array_equal(output, array)
    inputs = [A, B]
    inputs[index] = InitializeAutoDiff(inputs[index])[:, 0]
    stacked = np.concatenate([np.asarray(output).ravel() for output in equations(*inputs)])
    # Entries that do not depend on the input are floats; 0 · x makes them AutoDiffXd.
    expected = ExtractGradient(stacked + 0 * inputs[index][0])
    assert jacobian.shape == (11, len(inputs[index]))
    np.testing.assert_allclose(jacobian, expected, rtol=0, atol=1e-14)
    before = [output.copy() for output in found]
    for old, new, kept in zip(found, function(3 * A, B / 2), before, strict=True):
        assert np.shares_memory(old, new)
        assert not np.array_equal(new, kept)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 2e9, -2e9, 1e300])
@pytest.mark.parametrize("entry", [0, 2])
def test_value_beyond_reason_names_the_block(bad, entry):
    function = TracedFunction(lambda a: (a[:1], a[1:]), [3], name=lambda: "some_block")
    values = A.copy()
    values[entry] = bad
    with pytest.raises(NotFiniteError, match="some_block"):
        function(values)
    np.testing.assert_array_equal(function(A)[1], A[1:])


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
