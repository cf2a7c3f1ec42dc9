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

from drake_nonstop.loop.block_events import sample_times
from drake_nonstop.loop.compiled_flight import sources_of
from drake_nonstop.loop.functions import Evaluation, LoopFunction, Symbols, Traced
from drake_nonstop.loop.layout import LoopLayout
from drake_nonstop.loop.trace import LoopTrace, Step
from drake_nonstop.systems.tracing import LARGEST, NotFiniteError
from drake_nonstop.validation import ScenarioError


class _Slopes:
    """A traced function of the state and the parameters, and its derivatives by both.

    Args:
        traced: the function.
    """

    def __init__(self, traced: Traced):
        # Without the diagram's systems: the functions outlive it.
        traced = traced._replace(symbols=replace(traced.symbols, numbers={}))
        self._traced = traced
        self.values = LoopFunction(traced._replace(results=traced.results[:1]))

    @cached_property
    def by_state(self) -> LoopFunction:
        """Column by column."""
        return self._derivative(0)

    @cached_property
    def by_parameters(self) -> LoopFunction:
        """Column by column."""
        return self._derivative(1)

    def _derivative(self, argument: int) -> LoopFunction:
        slopes = casadi.jacobian(self._traced.results[0], self._traced.arguments[argument])
        traced = self._traced._replace(results=[casadi.vec(casadi.densify(slopes))])
        return LoopFunction(traced)


class DerivativeFunctions(NamedTuple):
    """What the derivatives of loops of one content are traced to."""

    at_start: _Slopes
    update: _Slopes
    rates: _Slopes


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
        at_start=_Slopes(trace.updates(is_start=True)),
        update=_Slopes(trace.updates()),
        rates=_Slopes(Traced(rates, trace.arguments, symbols)),
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


class DerivativeFlight:
    """A flight of a loop with the derivatives of its state, from sample to sample.

    Args:
        layout: of the loop.
        functions: of the loop.
        period: of the samples, s.
        schedule: the steps of one.
        context: of the diagram, at t = 0, which stays as it is.

    Attributes:
        state: (k,), the states of all blocks, as of `CompiledFlight`.
        parameters: (p,), likewise.
        samples: the number of those that it has flown.
    """

    def __init__(
        self,
        layout: LoopLayout,
        functions: DerivativeFunctions,
        period: float,
        schedule: Sequence[Step],
        context: Context,
    ):
        self._period, self._schedule = period, schedule
        self._functions = functions
        self._evaluations: dict[LoopFunction, Evaluation] = {}  # with memory of its own
        self._sources = sources_of(layout, context)
        self.state, self.parameters = layout.state_of(context), layout.parameters_of(context)
        self.samples = 0

    def start(self, slopes: NDArray, changes: NDArray | None = None) -> NDArray:
        """Makes the initialization's updates; arguments and result as of `advance`."""
        self.state, slopes = self._moved(self._functions.at_start, self.state, 0.0, slopes, changes)
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
        _, update, rates = self._functions
        now, ahead = (sample_times(self.samples + k, self._period) for k in (0, 1))
        x, dx = self.state, slopes
        if self.samples > 0:
            x, dx = self._moved(update, x, now, dx, changes)

        def at(offset: float) -> float:
            return ahead if offset == self._period else now + offset

        for begin, h, _, _ in self._schedule:
            r1, d1 = self._moved(rates, x, at(begin), dx, changes)
            r2, d2 = self._moved(rates, x + h / 2 * r1, at(begin + h / 2), dx + h / 2 * d1, changes)
            third = x - h * r1 + 2 * h * r2, dx - h * d1 + 2 * h * d2
            r3, d3 = self._moved(rates, third[0], at(begin + h), third[1], changes)
            x = x + h / 6 * r1 + 2 * h / 3 * r2 + h / 6 * r3
            dx = dx + h / 6 * d1 + 2 * h / 3 * d2 + h / 6 * d3
        self.state = x
        self.samples += 1
        return dx

    def _moved(
        self,
        function: _Slopes,
        state: NDArray,
        time: float,
        slopes: NDArray,
        changes: NDArray | None,
    ) -> tuple[NDArray, NDArray]:
        """A function's values (k,), and their derivatives (k, m)."""
        moved = np.zeros((len(state), slopes.shape[1]))
        if slopes.shape[1]:
            by_state = self._evaluated(function.by_state, state, time)
            moved += by_state.reshape(len(state), -1, order="F") @ slopes
        if changes is not None:
            by_parameters = self._evaluated(function.by_parameters, state, time)
            moved += by_parameters.reshape(len(state), -1, order="F") @ changes
        return self._evaluated(function.values, state, time), moved

    def _evaluated(self, function: LoopFunction, state: NDArray, time: float) -> NDArray:
        if function not in self._evaluations:
            self._evaluations[function] = Evaluation(function, compiles=False)
        read = [self._sources[r.system].value(r.output, time) for r in function.readings]
        inputs = [state, self.parameters, np.array([time]), *read]
        result, norm = self._evaluations[function](inputs)
        if not norm[0] < LARGEST**2:
            raise NotFiniteError("the loop")
        return result
