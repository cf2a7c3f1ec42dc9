"""The traces of a loop: its updates at a sample, and its motion to the next one.

At a sample, Drake's Simulator first makes the unrestricted updates, all at once, then the discrete
ones, and integrates to the next sample. So do the traces: `updates` makes both kinds of updates,
`steps` takes the steps of the third-order Runge-Kutta method and shows all signals at the end of
them, before the next updates.
"""

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import casadi
import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import System

from drake_nonstop.loop.functions import LoopFunction, Symbols, Traced
from drake_nonstop.loop.layout import LoopLayout
from drake_nonstop.systems.diagram_trace import At, Instant, rates
from drake_nonstop.systems.tracing import object_array

_Part = Callable[[casadi.SX, float, Symbols], list[casadi.SX]]  # of a state and an offset in s


class Step(NamedTuple):
    """A step of the integrator; times in s after a sample."""

    begin: float
    length: float
    end: float  # where what stands outside is read, to the bit as at the next sample
    is_shown: bool  # whether all signals are shown at its end


def runge_kutta3(rate: Callable[[Any, float], Any], state: Any, step: Step) -> Any:
    """The state after a step of the third-order Runge-Kutta method, of symbols or numbers.

    `rate` is that of a state at an offset in s.
    """
    begin, length, *_ = step
    first = rate(state, begin)
    second = rate(state + length / 2 * first, begin + length / 2)
    third = rate(state - length * first + 2 * length * second, begin + length)
    return state + length / 6 * first + 2 * length / 3 * second + length / 6 * third


class LoopTrace:
    """What a loop is traced to.

    Attributes:
        arguments: symbols of its stacked state and parameters, and of the sample's time, s.
    """

    def __init__(self, layout: LoopLayout):
        self._layout = layout
        sizes = layout.parameter_sizes
        state = casadi.SX.sym("x", sum(map(sum, layout.state_sizes.values())))
        parameters = casadi.SX.sym("p", sum(sizes))
        self.arguments = [state, parameters, casadi.SX.sym("t", 1)]
        values = np.split(object_array(parameters), np.cumsum(sizes)[:-1])
        self._parameters = dict(zip(layout.with_parameters, values, strict=False))

    def _instant(self, states: Mapping[System, list[NDArray]], outside: Any) -> Instant:
        return Instant(
            self._layout.wires,
            dict(states),
            self._parameters,
            object_array(self.arguments[2]),
            outside,
            self._layout.is_outside,
        )

    def updates(self, *, is_start: bool = False) -> Traced:
        """The state after a sample's updates, and what blocks that may make some themselves read.

        Then whether what is made in their place is right. `is_start` has those of the
        initialization.
        """
        symbols = Symbols(self._layout.numbers)
        before = self._layout.states(object_array(self.arguments[0]))
        updating = [leaf for leaf in self._layout.leaves if hasattr(leaf, "traced_update")]
        early: tuple[str, ...] = ("updates_first",)
        if is_start:
            updating = [leaf for leaf in updating if getattr(leaf, "updates_at_start", False)]
            early = ("updates_first", "starts_first")
        first = [leaf for leaf in updating if any(getattr(leaf, name, False) for name in early)]
        late = [leaf for leaf in updating if leaf not in first]
        instant = self._instant(before, symbols.at(0.0))
        after = before | {leaf: _updated(leaf, instant, before, is_start) for leaf in first}
        instant = self._instant(after, symbols.at(0.0))
        last = after | {leaf: _updated(leaf, instant, after, is_start) for leaf in late}
        is_valid = []
        for leaf in self._layout.self_updating if not is_start else ():
            made = leaf.traced_fast_update(At(instant, leaf))
            last[leaf] = [last[leaf][0], *made.states]
            is_valid.append(made.is_valid)
        inputs = (instant.input(*place) for place in self._layout.read)
        read = [values for values in inputs if values is not None]
        results = [_stacked(last), _joined(read), _joined([np.array(is_valid)])]
        return Traced(results, self.arguments, symbols)

    def steps(
        self, schedule: Sequence[Step], shown: _Part, updates: Traced | None = None
    ) -> Traced:
        """The state after a sample's steps, and all signals that are shown on the way.

        `updates` are the sample's, whose first result is the state; None: it is the argument.
        """
        symbols = Symbols(self._layout.numbers) if updates is None else updates.symbols

        def rate(state: casadi.SX, offset: float) -> casadi.SX:
            return self.rates(state, offset, symbols)[0]

        now = self.arguments[0] if updates is None else updates.results[0]
        signals, step_signals = [], []
        for step in schedule:
            now = runge_kutta3(rate, now, step)
            own_signals, own_step_signals = shown(now, step.end, symbols)
            step_signals.append(own_step_signals)
            signals += [own_signals] if step.is_shown else []
        results = [now, casadi.vertcat(*signals), casadi.vertcat(*step_signals)]
        return Traced(results, self.arguments, symbols)

    def whole(self, schedule: Sequence[Step], shown: _Part) -> LoopFunction:
        """The state and all signals at the next sample, and what its updates tell besides.

        A further argument has which blocks have made updates themselves, and their states after
        these.
        """
        updates = self.updates()
        answers = casadi.SX.sym("a", self._layout.answers_size)
        after, read, is_valid = updates.results
        start = len(self._layout.self_updating)
        for k, leaf in enumerate(self._layout.self_updating):
            place = self._layout.places[leaf]
            end = start + place.stop - place.start
            after[place] = casadi.if_else(answers[k], answers[start:end], after[place])
            start = end
        moved = self.steps(schedule, shown, updates._replace(results=[after]))
        results = [*moved.results, read, is_valid]
        traced = Traced(results, [*self.arguments, answers], moved.symbols)
        return LoopFunction(traced, is_whole=True)

    def shown(self, *signals: Iterable[str]) -> _Part:
        """Some lists of signals, by the names of the diagram's ports."""
        return self._part(lambda at: [_joined(self._at(at, names)) for names in signals])

    @cached_property
    def rates(self) -> _Part:
        """The rates of the loop's state, 0 of all that is discrete."""
        return self._part(self._rates_at)

    def _rates_at(self, instant: Instant) -> list[casadi.SX]:
        found = []
        for leaf, (continuous, *discrete) in self._layout.state_sizes.items():
            found += [rates(leaf, instant)] if continuous else []
            found.append(np.zeros(sum(discrete)))
        return [_joined(found)]

    def _part(self, make: Callable[[Instant], list[casadi.SX]]) -> _Part:
        """What is made of an instant, traced once, of any state, offset (s) and `Symbols`."""
        state, parameters, time = self.arguments
        own = Symbols(self._layout.numbers)
        states = self._layout.states(object_array(state))
        results = make(self._instant(states, own.at(0.0)))
        stacked = casadi.vertcat(state, parameters, time, *own.symbols.values())
        function = casadi.Function("part", [stacked], results)

        def part(now: casadi.SX, offset: float, symbols: Symbols) -> list[casadi.SX]:
            read = own.symbols.items()
            outside = [symbols.of(r._replace(offset=offset), s.numel()) for r, s in read]
            inputs = casadi.vertcat(now, parameters, time + offset, *itertools.chain(*outside))
            return function.call([inputs])

        return part

    def _at(self, instant: Instant, signals: Iterable[str]) -> list[NDArray]:
        """What signals show at an instant."""
        found = []
        for name in signals:
            port = self._layout.diagram.GetOutputPort(name).get_index()
            system, index = self._layout.diagram.get_output_port_locator(port)
            found.append(instant.output(system, int(index)))
        return found


def _updated(
    leaf: Any, instant: Instant, states: Mapping[System, list[NDArray]], is_start: bool
) -> list[NDArray]:
    """A leaf's states after its update of the discrete ones."""
    start = getattr(leaf, "traced_start", leaf.traced_update) if is_start else leaf.traced_update
    return [states[leaf][0], *start(At(instant, leaf))]


def _joined(arrays: list[NDArray]) -> casadi.SX:
    entries = [entry for array in arrays for entry in array]
    return casadi.densify(casadi.vertcat(*entries)) if entries else casadi.SX(0, 1)


def _stacked(states: Mapping[System, list[NDArray]]) -> casadi.SX:
    return _joined([group for groups in states.values() for group in groups])
