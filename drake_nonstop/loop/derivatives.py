"""The exact derivatives of a loop's state from sample to sample, by states and parameters.

CasADi differentiates the traces of the updates and of the states' rates; the steps of the
Runge-Kutta method are differentiated by the chain rule, stage by stage (own derivation): of the
state x with x' = f(x, p) and parameters p,

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
    """A traced function (k,) of the state (k,) and the parameters (p,), and its Jacobians."""

    def __init__(self, traced: Traced):
        # The functions outlive the diagram: they hold none of its systems.
        traced = traced._replace(symbols=replace(traced.symbols, numbers={}))
        self._traced = traced
        self.values = LoopFunction(traced._replace(results=traced.results[:1]))

    @cached_property
    def by_state(self) -> LoopFunction:
        """The Jacobian by the state (k * k,), stacked column by column."""
        return self._derivative(0)

    @cached_property
    def by_parameters(self) -> LoopFunction:
        """The Jacobian by the parameters (k * p,), stacked column by column."""
        return self._derivative(1)

    def _derivative(self, argument: int) -> LoopFunction:
        slopes = casadi.jacobian(self._traced.results[0], self._traced.arguments[argument])
        traced = self._traced._replace(results=[casadi.vec(casadi.densify(slopes))])
        return LoopFunction(traced)


class DerivativeFunctions(NamedTuple):
    """Traced functions of loops with equal traces, and their derivatives."""

    at_start: _DifferentiatedTrace  # the state after the initialization's updates
    update: _DifferentiatedTrace  # the state after the updates of any other sample
    rates: _DifferentiatedTrace  # the time derivative of the state


def derivative_functions(layout: LoopLayout) -> DerivativeFunctions:
    """Returns the traces of a loop's updates and rates, with their derivatives.

    Raises:
        ScenarioError: a block of the loop searches for its updates, or is outside of the trace.
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
    """The state at the end of a flight, and its derivatives by that at its start and parameters.

    A state's name is its system's path in the diagram and its number there, "path[0]"; a
    parameter's is "box.field", and for arrays an index. All values are in SI units.
    """

    state: NDArray  # (k,)
    by_state: NDArray  # (k, k)
    by_parameters: NDArray  # (k, p)
    state_names: list[str]  # k, of the rows, and of the columns of `by_state`
    parameter_names: list[str]  # p, of the columns of `by_parameters`


class DerivativeFlight(LoopFlight):
    """A flight of a loop with the derivatives of its state, from sample to sample.

    Args:
        layout: the loop's blocks, and the order of its states and parameters.
        functions: those of the loop.
        period: time from sample to sample, s.
        schedule: the integrator's steps in a period.
        context: that of the diagram, at t = 0; it stays as it is.
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
        self._evaluations: dict[LoopFunction, Evaluation] = {}  # each has memory of its own

    def start(self, slopes: NDArray, changes: NDArray | None = None) -> NDArray:
        """Makes the initialization's updates; takes and returns derivatives as `advance` does."""
        state = np.column_stack([self._state, slopes])
        self._state, slopes = _parts(self._applied(self._functions.at_start, state, 0.0, changes))
        return slopes

    def advance(self, slopes: NDArray, changes: NDArray | None = None) -> NDArray:
        """Advances the state to the next sample, before the updates at that sample.

        Args:
            slopes: (k, m), the derivatives of the state by m quantities; m may be 0.
            changes: (p, m), the derivatives of the parameters by them, constant; None: zeros.

        Returns:
            The derivatives (k, m) of the state at the next sample.

        Raises:
            NotFiniteError: a value is not finite, or is too large.
        """

        def rate(state: NDArray, offset: float) -> NDArray:
            return self._applied(self._functions.rates, state, offset, changes)

        state = np.column_stack([self._state, slopes])
        if self.samples > 0:
            state = self._applied(self._functions.update, state, 0.0, changes)
        for step in self._schedule:
            state = runge_kutta3(rate, state, step)
        self._state, slopes = _parts(state)
        self.samples += 1
        return slopes

    def _applied(
        self, function: _DifferentiatedTrace, state: NDArray, offset: float, changes: NDArray | None
    ) -> NDArray:
        """[values, derivatives] (k, 1 + m) of a function, `offset` s after the sample."""
        values, slopes = _parts(state)
        new_slopes = np.zeros(slopes.shape)
        if slopes.shape[1]:
            new_slopes += self._jacobian(function.by_state, values, offset) @ slopes
        if changes is not None:
            new_slopes += self._jacobian(function.by_parameters, values, offset) @ changes
        return np.column_stack([self._values(function.values, values, offset), new_slopes])

    def _jacobian(self, function: LoopFunction, state: NDArray, offset: float) -> NDArray:
        return self._values(function, state, offset).reshape(len(state), -1, order="F")

    def _values(self, function: LoopFunction, state: NDArray, offset: float) -> NDArray:
        if function not in self._evaluations:
            self._evaluations[function] = Evaluation(function, compiles=False)
        at = self._time_after(offset)
        read = [self._sources[r.system].value(r.output, at) for r in function.readings]
        inputs = [state, self._parameters, np.array([at]), *read]
        return self.evaluated(self._evaluations[function], *inputs)[0]


def _parts(state: NDArray) -> tuple[NDArray, NDArray]:
    """The values (k,) and the derivatives (k, m) of a state with derivatives (k, 1 + m)."""
    return np.ascontiguousarray(state[:, 0]), np.ascontiguousarray(state[:, 1:])
