"""Derivatives of a compiled loop's flight by its start and by parameters."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import (
    Context,
)

from drake_nonstop.mechanics.signal_layouts import by_name
from drake_nonstop.systems.tracing import NotFiniteError

if TYPE_CHECKING:
    from drake_nonstop.systems.compiled_loop import CompiledLoop


@dataclass(frozen=True, kw_only=True)
class Sensitivities:
    """The state at the end of a flight, and its derivatives by that at its start and parameters.

    A state's name is its block's and its number there, "block[0]"; a parameter's is "box.field",
    and for arrays an index. All values are in SI units. With the signals' derivatives the gradient
    of any metric of a flight follows by the chain rule.
    """

    state: NDArray  # (k,)
    by_state: NDArray  # (k, k)
    by_parameters: NDArray  # (k, p)
    signals: dict[str, NDArray]  # (samples, size), by name, at the samples' ends
    signals_by_state: dict[str, NDArray]  # (samples, size, k)
    signals_by_parameters: dict[str, NDArray]  # (samples, size, p)
    state_names: list[str]  # k, of the rows, and of the columns of `by_state`
    parameter_names: list[str]  # p, of the columns of `by_parameters`


def sensitivities_of(loop: "CompiledLoop", context: Context, samples: int) -> Sensitivities:
    """As of `CompiledLoop.sensitivities`, for a number of samples."""
    flight, functions = loop.fly(context), loop.functions
    states, parameters = len(flight._state), len(flight._parameters)
    slopes = np.eye(states, states + parameters)
    by_p = np.eye(parameters, states + parameters, k=states)
    for first in (True, False):
        now = functions.now("start", first=first)
        if now is not None:
            given = loop.arguments(now, flight._state, 0.0, flight._parameters)
            by = functions.derivative(now.function).call(given)
            slopes = by[0].full() @ slopes + by[1].full() @ by_p
            flight._state = now.function.call(given)[0].full().ravel()
    derivative, shown, changes = functions.derivative(loop.sample.function), [], []
    while flight.samples < samples:
        times, rows = flight.ahead(1)
        given = [flight._state, times, flight._parameters, rows[0]]
        by = [each.full() for each in derivative.call(given)]
        changes.append(by[2] @ slopes + by[3] @ by_p)
        slopes = by[0] @ slopes + by[1] @ by_p
        shown.append(flight.advance()[0])
    if not all(np.all(np.isfinite(each)) for each in (slopes, *changes)):
        raise NotFiniteError("the loop's derivatives, such as those of a norm at zero,")
    size = sum(loop.signals.values())
    instants = samples * loop.shown_per_sample
    rows = np.concatenate([np.zeros((0, size)), *shown])
    by_all = np.reshape(changes, (instants, size, states + parameters))
    by_name_of = {
        name: part.swapaxes(1, 2)
        for name, part in by_name(loop.signals, by_all.swapaxes(1, 2)).items()
    }
    return Sensitivities(
        state=flight.state,
        by_state=slopes[:, :states],
        by_parameters=slopes[:, states:],
        signals=by_name(loop.signals, rows),
        signals_by_state={name: part[..., :states] for name, part in by_name_of.items()},
        signals_by_parameters={name: part[..., states:] for name, part in by_name_of.items()},
        state_names=loop.state_names,
        parameter_names=loop.parameter_names,
    )
