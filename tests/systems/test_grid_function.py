import numpy as np
import pytest
from helpers import difference
from systems.test_tracing import equations as of_two

from drake_nonstop.systems import grid_function
from drake_nonstop.systems.grid_function import GridFunction
from drake_nonstop.systems.native import LANES, CompilationError
from drake_nonstop.systems.tracing import NotFiniteError
from drake_nonstop.validation import ScenarioWarning

SIZE, CONSTANTS = 4, 2
COUNTS = [0, 1, LANES - 1, LANES, 3 * LANES + 1]


def equations(point, constants):
    """Of no result is the second entry of a point."""
    return of_two(point[[0, 2, 3]], constants)


def flat(point, constants):
    return np.concatenate([np.ravel(part) for part in equations(point, constants)])


@pytest.mark.parametrize("compiles", [True, False])
@pytest.mark.parametrize(("by", "entries"), [(SIZE, [0, 2, 3]), (2, [0])])
@pytest.mark.parametrize("count", COUNTS)
def test_values_and_derivatives_are_those_of_calls(compiles, by, entries, count):
    rng = np.random.default_rng(count)
    points, constants = rng.uniform(1, 2, (SIZE, count)), rng.uniform(1, 2, (CONSTANTS, 3))
    function = GridFunction(equations, SIZE, CONSTANTS, key=None, by=by, compiles=compiles)
    assert (function._library is not None) == compiles
    np.testing.assert_array_equal(function.by, entries)
    values, slopes = function(points, constants)
    function(points + 1, constants)  # an answer is its caller's
    assert (values.shape, slopes.shape) == ((11, 3, count), (11, len(entries), 3, count))
    for c, k in np.ndindex(3, count):
        point, own = points[:, k], constants[:, c]
        np.testing.assert_allclose(values[:, c, k], flat(point, own), rtol=1e-14)
        for g, entry in enumerate(function.by):
            step = np.eye(SIZE)[entry]
            expected = difference(lambda h: flat(point + h * step, own), 0.0)  # noqa: B023
            np.testing.assert_allclose(slopes[:, g, c, k], expected, atol=1e-10)
    # Values of points do not depend on those beside them.
    np.testing.assert_array_equal(function(points[:, 1:], constants)[0], values[..., 1:])


def test_a_function_that_no_c_compiles_is_told_once_and_evaluated(monkeypatch):
    def fails(*arguments, **options):
        raise CompilationError("there is no C compiler")

    monkeypatch.setattr(grid_function, "shared_library", fails)
    grid_function._tell_not_compiled.cache_clear()
    with pytest.warns(ScenarioWarning, match="no C compiler; .* virtual machine") as told:
        functions = [GridFunction(lambda x, _: 2 * x, 1, key=f"not compiled {k}") for k in range(2)]
    assert len(told) == 1
    assert functions[1](np.full((1, 2), 3.0))[0] == pytest.approx(np.full((1, 1, 2), 6.0))


@pytest.mark.parametrize("count", COUNTS)
def test_rows_are_those_of_calls(count):
    rows = np.random.default_rng(count).uniform(0.5, 2.0, (count, 3))
    function = GridFunction(lambda x, _: [x[:1] * x[1:], np.cos(x)], 3, key="rows")
    expected = np.hstack([rows[:, :1] * rows[:, 1:], np.cos(rows)])
    np.testing.assert_allclose(function.rows(rows, str), expected, rtol=1e-14)


@pytest.mark.parametrize("compiles", [True, False])
def test_rows_that_are_not_finite_are_told(compiles):
    quotient = GridFunction(lambda x, _: x[:1] / x[1:], 2, key="quotient", compiles=compiles)
    rows = np.ones((3, 2))
    for value, sentence in ((0.0, "made a value"), (np.nan, "was given a value")):
        rows[1, 1] = value
        with pytest.raises(NotFiniteError, match=f"a block {sentence}"):
            quotient.rows(rows, lambda: "a block")
