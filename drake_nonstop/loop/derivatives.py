"""The exact derivatives of a loop from sample to sample, by its states and its parameters.

CasADi differentiates the traces of the updates and of the rates; the steps of the Runge-Kutta
method are differentiated by the chain rule, stage by stage (own derivation): of x' = f(x, p),

    dx' = (∂f/∂x) dx + (∂f/∂p) dp.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import casadi
import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context

from drake_nonstop.loop.compiled_flight import LoopFlight
from drake_nonstop.loop.functions import Evaluation, LoopFunction, Symbols, Traced
from drake_nonstop.loop.trace import LoopLayout, LoopTrace, Step, runge_kutta3
from drake_nonstop.systems.tracing import LARGEST
from drake_nonstop.validation import ScenarioError


class _DifferentiatedTrace:
    """A traced function of the state and the parameters, and its derivatives by both."""

    def __init__(self, traced: Traced):
        # Without the diagram's systems: the functions outlive it.
        traced = traced._replace(symbols=replace(traced.symbols, numbers={}))
        self._traced = traced
        self.values = LoopFunction(traced._replace(results=traced.results[:1]))

    @cached_property
    def by_state(self) -> LoopFunction:
        """Its Jacobian by the state, stacked column by column."""
        return self._derivative(0)

    @cached_property
    def by_parameters(self) -> LoopFunction:
        """Its Jacobian by the parameters, stacked column by column."""
        return self._derivative(1)

    def _derivative(self, argument: int) -> LoopFunction:
        slopes = casadi.jacobian(self._traced.results[0], self._traced.arguments[argument])
        traced = self._traced._replace(results=[casadi.vec(casadi.densify(slopes))])
        return LoopFunction(traced)


class DerivativeFunctions(NamedTuple):
    """Functions of the derivatives of loops of one content."""

    at_start: _DifferentiatedTrace
    update: _DifferentiatedTrace
    rates: _DifferentiatedTrace


def derivative_functions(layout: LoopLayout) -> DerivativeFunctions:
    """The traces of a loop's updates and rates, with their derivatives.

    Raises:
        ScenarioError: a block of the loop searches, or stands beside the trace.
    """
    for name, block in layout.updating.items():
        raise ScenarioError(
            f"{name} = {type(block).__name__}: its updates have no derivatives that are traced; "
            "give another block, such as ConstantParameters in place of a layer that searches"
        )
    trace = LoopTrace(layout)
    symbols = Symbols(layout.numbers)
    rates = trace.rates(trace.arguments[0], 0.0, symbols)
    return DerivativeFunctions(
        at_start=_DifferentiatedTrace(trace.updates(is_start=True)),
        update=_DifferentiatedTrace(trace.updates()),
        rates=_DifferentiatedTrace(Traced(rates, trace.arguments, symbols)),
    )


@dataclass(frozen=True, kw_only=True)
class Sensitivities:
    """The state at the end of a flight, and its derivatives by the start's and the parameters.

    Names are paths of systems in the diagram, or "box.field", with a number: all are in SI units.
    """

    state: NDArray  # (k,)
    by_state: NDArray  # (k, k)
    by_parameters: NDArray  # (k, p)
    state_names: list[str]  # k, of the rows, and of the columns of `by_state`
    parameter_names: list[str]  # p, of the columns of `by_parameters`


class DerivativeFlight(LoopFlight):
    """A flight of a loop with the derivatives of its state, from sample to sample.

    Args:
        layout: of the loop.
        functions: of the loop.
        period: of the samples, s.
        schedule: the steps of one.
        context: of the diagram, at t = 0, which stays as it is.
    """

    def __init__(
        self,
        layout: LoopLayout,
        functions: DerivativeFunctions,
        period: float,
        schedule: Sequence[Step],
        context: Context,
    ):
        super().__init__(layout, period, context, LARGEST)
        self._schedule, self._functions = schedule, functions
        self._evaluations: dict[LoopFunction, Evaluation] = {}  # with memory of its own

    def start(self, slopes: NDArray, changes: NDArray | None = None) -> NDArray:
        """Makes the initialization's updates; arguments and result as of `advance`."""
        state = np.column_stack([self._state, slopes])
        self._state, slopes = _parts(self._moved(self._functions.at_start, state, 0.0, changes))
        return slopes

    def advance(self, slopes: NDArray, changes: NDArray | None = None) -> NDArray:
        """Goes on to the next sample, before its updates.

        Args:
            slopes: (k, m), the derivatives of the state by m quantities; m may be 0.
            changes: (p, m), those of the parameters, which stay; None: zeros.

        Returns:
            The derivatives (k, m) of the state after the sample.

        Raises:
            NotFiniteError: a value is not finite, or is too large.
        """

        def rate(state: NDArray, offset: float) -> NDArray:
            return self._moved(self._functions.rates, state, offset, changes)

        state = np.column_stack([self._state, slopes])
        if self.samples > 0:
            state = self._moved(self._functions.update, state, 0.0, changes)
        for step in self._schedule:
            state = runge_kutta3(rate, state, step)
        self._state, slopes = _parts(state)
        self.samples += 1
        return slopes

    def _moved(
        self, function: _DifferentiatedTrace, state: NDArray, offset: float, changes: NDArray | None
    ) -> NDArray:
        """A function's values, and their derivatives: (k, 1 + m), as the state is."""
        values, slopes = _parts(state)
        moved = np.zeros(slopes.shape)
        if slopes.shape[1]:
            moved += self._matrix(function.by_state, values, offset) @ slopes
        if changes is not None:
            moved += self._matrix(function.by_parameters, values, offset) @ changes
        return np.column_stack([self._values(function.values, values, offset), moved])

    def _matrix(self, function: LoopFunction, state: NDArray, offset: float) -> NDArray:
        return self._values(function, state, offset).reshape(len(state), -1, order="F")

    def _values(self, function: LoopFunction, state: NDArray, offset: float) -> NDArray:
        if function not in self._evaluations:
            self._evaluations[function] = Evaluation(function, compiles=False)
        at = self._time_after(offset)
        read = [self._sources[r.system].value(r.output, at) for r in function.readings]
        inputs = [state, self._parameters, np.array([at]), *read]
        return self._evaluated(self._evaluations[function], *inputs)[0]


def _parts(state: NDArray) -> tuple[NDArray, NDArray]:
    """The values (k,) and the derivatives (k, m) of a state (k, 1 + m)."""
    return np.ascontiguousarray(state[:, 0]), np.ascontiguousarray(state[:, 1:])
