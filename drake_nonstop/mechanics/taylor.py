"""Truncated Taylor series in time: rates of a formula that is written for values alone.

A formula of NumPy's arithmetic that is given series returns a series: its value and as many of its
rates as all of them have. Coefficients are arrays of any scalar type.

    position = Taylor.of_rates(p, v, a)
    distance = np.sqrt((position * position).sum())
    distance.rates  # ‖p‖ and its first two rates
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin
from numpy.typing import NDArray

from drake_nonstop.mechanics.rotation import cross

Quantity = Any  # an array, or the series of one


class Taylor(NDArrayOperatorsMixin):
    """x(t) = Σ c_k tᵏ, with the coefficients c_k = x⁽ᵏ⁾/k! at the present, of one shape.

    Arrays and numbers in an operation with it are constants. Results have as many coefficients as
    the shortest operand.
    """

    def __init__(self, coefficients: Sequence[NDArray]):
        self.coefficients = tuple(coefficients)

    @classmethod
    def of_rates(cls, *rates: NDArray) -> "Taylor":
        """The series of a value and its rates, in order."""
        return cls([rate / math.factorial(k) if k > 1 else rate for k, rate in enumerate(rates)])

    @property
    def rates(self) -> tuple[NDArray, ...]:
        """The value at present and its rates, in order."""
        return tuple(math.factorial(k) * c if k > 1 else c for k, c in enumerate(self.coefficients))

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of the value."""
        return np.shape(self.coefficients[0])

    @property
    def T(self) -> "Taylor":  # noqa: N802
        """The series with its last two axes exchanged."""
        return self._each(lambda c: c.swapaxes(-1, -2))

    def truncated(self, order: int) -> "Taylor":
        """The series up to a rate of that order."""
        return Taylor(self.coefficients[: order + 1])

    def rate(self) -> "Taylor":
        """The series of the first rate, which has a coefficient less."""
        return Taylor([k * c if k > 1 else c for k, c in enumerate(self.coefficients[1:], 1)])

    def integral(self, start: NDArray) -> "Taylor":
        """The series with this rate that starts with a value, and has a coefficient more."""
        return Taylor([start, *(c / k if k > 1 else c for k, c in enumerate(self.coefficients, 1))])

    def at(self, time: Quantity) -> Quantity:
        """Values of the polynomial at times from the present on, s, that broadcast.

        Of a series of times: that of the values.
        """
        value = 0.0
        for coefficient in reversed(self.coefficients):
            value = value * time + coefficient
        return value if isinstance(value, Taylor) else np.asarray(value)

    def over(self, times: NDArray) -> NDArray:
        """Values (k, ...) at times (k,), s."""
        values: NDArray = self.at(times.reshape(-1, *np.ones(len(self.shape), int)))
        return values

    def sum(self, axis: int | None = None, *, keepdims: bool = False) -> "Taylor":
        """The sum over an axis."""
        return self._each(lambda c: c.sum(axis=axis, keepdims=keepdims))

    def reshape(self, *shape: int) -> "Taylor":
        """The series of another shape."""
        return self._each(lambda c: c.reshape(*shape))

    def __getitem__(self, index: Any) -> "Taylor":
        return self._each(lambda c: c[index])

    def _each(self, function: Callable[[NDArray], NDArray]) -> "Taylor":
        """A linear function of the series."""
        return Taylor([function(c) for c in self.coefficients])

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        rule = _RULES.get(ufunc)
        return NotImplemented if rule is None or method != "__call__" or options else rule(*inputs)

    def __array_function__(self, function: Any, types: Any, args: Any, options: Any) -> Any:
        if function not in (np.concatenate, np.stack):
            return NotImplemented
        rows = zip(*_aligned(*args[0]), strict=True)
        return Taylor([function(row, *args[1:], **options) for row in rows])


def turned(axes: NDArray, angular_velocity: Taylor) -> Taylor:
    """Axes (..., 3, 3), a vector in each row, that turn with ω (..., 3) in the rows' frame.

    ė = ω × e. Rows that are those of R_LW, with ω in W, are later ones of R_LW; rows of the
    identity, with ω in L, those of L in the axes that L has at present. The result has a
    coefficient more than ω.
    """
    found = [axes]
    for order in range(len(angular_velocity.coefficients)):
        terms = [
            cross(omega[..., None, :], row)
            for omega, row in zip(angular_velocity.coefficients, reversed(found), strict=False)
        ]
        rate = sum(terms[1:], terms[0])
        found.append(rate / (order + 1) if order else rate)
    return Taylor(found)


def _aligned(*operands: Any) -> list[list[NDArray]]:
    """The coefficients of series and constants, as many of each."""
    count = min(len(x.coefficients) for x in operands if isinstance(x, Taylor))
    return [
        list(x.coefficients[:count])
        if isinstance(x, Taylor)
        else [np.asarray(x)] + [np.zeros(np.shape(x))] * (count - 1)
        for x in operands
    ]


def _sum(a: Any, b: Any) -> Taylor:
    if not isinstance(a, Taylor):
        a, b = b, a
    if not isinstance(b, Taylor):
        return Taylor([a.coefficients[0] + b, *a.coefficients[1:]])
    return Taylor([x + y for x, y in zip(a.coefficients, b.coefficients, strict=False)])


def _difference(a: Any, b: Any) -> Taylor:
    return _sum(a, _negative(b) if isinstance(b, Taylor) else -np.asarray(b))


def _negative(a: Taylor) -> Taylor:
    return Taylor([-c for c in a.coefficients])


def _bilinear(product: Callable[[Any, Any], NDArray]) -> Callable[[Any, Any], Taylor]:
    """The rule of Leibniz for a product."""

    def rule(a: Any, b: Any) -> Taylor:
        if not isinstance(b, Taylor):
            return Taylor([product(c, b) for c in a.coefficients])
        if not isinstance(a, Taylor):
            return Taylor([product(a, c) for c in b.coefficients])
        x, y = _aligned(a, b)
        return Taylor([_convolved(product, x[: k + 1], y[: k + 1]) for k in range(len(x))])

    return rule


def _convolved(product: Callable, x: Sequence[NDArray], y: Sequence[NDArray]) -> NDArray:
    """Σ x_i y_{k−i} of sequences of the same length k + 1."""
    terms = [product(a, b) for a, b in zip(x, reversed(y), strict=True)]
    return sum(terms[1:], terms[0])


def _quotient(a: Any, b: Any) -> Taylor:
    if not isinstance(b, Taylor):
        return Taylor([c / b for c in a.coefficients])
    x, y = _aligned(a, b)
    found = [x[0] / y[0]]
    for k in range(1, len(x)):
        found.append((x[k] - _convolved(np.multiply, y[1 : k + 1], found)) / y[0])
    return Taylor(found)


def _square_root(a: Taylor) -> Taylor:
    found = [np.sqrt(a.coefficients[0])]
    for k, coefficient in enumerate(a.coefficients[1:], 1):
        inner = _convolved(np.multiply, found[1:], found[1:]) if k > 1 else 0.0
        found.append((coefficient - inner) / (2 * found[0]))
    return Taylor(found)


def _cosine_and_sine(a: Taylor) -> tuple[Taylor, Taylor]:
    cosines, sines = [np.cos(a.coefficients[0])], [np.sin(a.coefficients[0])]
    rates = a.rate().coefficients
    for k in range(1, len(a.coefficients)):
        speeds = rates[:k]
        cosine = _convolved(np.multiply, speeds, sines) / -k
        sines.append(_convolved(np.multiply, speeds, cosines) / k)
        cosines.append(cosine)
    return Taylor(cosines), Taylor(sines)


_RULES: dict[Any, Callable] = {
    np.add: _sum,
    np.subtract: _difference,
    np.negative: _negative,
    np.multiply: _bilinear(np.multiply),
    np.matmul: _bilinear(np.matmul),
    np.divide: _quotient,
    np.sqrt: _square_root,
    np.cos: lambda a: _cosine_and_sine(a)[0],
    np.sin: lambda a: _cosine_and_sine(a)[1],
}
