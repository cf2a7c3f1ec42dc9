"""The equations of a diagram of blocks, composed along its wires as functions of CasADi.

A sample is the function

    x_next, shown, steps = loop(x, t, p, rows)

of the state x of all blocks after the updates at a sample, the times t (2,) of this sample and the
next one, the parameters p of all blocks, and the `rows`, which depend on the time alone: values of
the blocks' quantities. x_next is the state after the next sample's updates, `shown` are signals at
instants of the sample, the last one just before these updates, which is what Drake's Simulator
shows, and `steps` are signals at the end of each step of the integrator. The continuous state takes
the steps of Drake's runge_kutta3; the sampled states of all blocks then step at once.
"""

import functools
import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import casadi
import numpy as np

from drake_nonstop.systems.equations import NUMBERS, START, STATE, TIME, Equations

_CSE = {"cse": True}

Result = tuple[int, str]  # the number of a block, and the name of a result of its equations
Symbols = Mapping[int, casadi.SX]  # of blocks, by their numbers


class Step(NamedTuple):
    """A step of the integrator, in s after the sample; `is_shown`: signals are shown at its end."""

    begin: float
    size: float
    end: float
    is_shown: bool


class Reading(NamedTuple):
    """A quantity of a block, by its number, at an instant in s after the sample."""

    block: int
    quantity: str
    offset: float


class Structure(NamedTuple):
    """Blocks and wires of a loop.

    Attributes:
        blocks: the equations of the blocks, in the diagram's order.
        every: of each block the number of samples between its steps; 0 of a layer whose state
            changes by its answers alone.
        sources: of each input, by block and name, the output that it is connected to.
    """

    blocks: Sequence[Equations]
    every: Sequence[int]
    sources: Mapping[Result, Result]

    @property
    def key(self) -> Any:
        """What loops of equal equations share; None: it is not known of a block."""
        keys = tuple(own.key for own in self.blocks)
        if None in keys:
            return None
        return keys, tuple(self.every), tuple(sorted(self.sources.items()))


class Instant:
    """Results of all blocks at an instant, in symbols: each is made once, when it is asked for."""

    def __init__(
        self,
        loop: "LoopEquations",
        states: Symbols,
        time: casadi.SX,
        known: Mapping[Result, casadi.SX],
        row: Callable[[int, str], casadi.SX] | None = None,
    ):
        self._loop, self._states, self._time = loop, states, time
        self._made, self._row = dict(known), row

    def result(self, block: int, name: str) -> casadi.SX:
        """A result of a block's equations, or an output that shows a part of its state."""
        if (block, name) not in self._made:
            own = self._loop.structure.blocks[block]
            if name in own.shown:
                place = self._loop.shown_places[block][name]
                self._made[block, name] = self._states[block][place]
            else:
                group = own.group_of[name]
                given = [self._argument(block, own, read) for read in group.reads]
                for made, value in zip(group.makes, group.function.call(given), strict=True):
                    self._made[block, made] = casadi.SX(value)
        return self._made[block, name]

    def _argument(self, block: int, own: Equations, name: str) -> casadi.SX:
        if name == STATE:
            return self._states[block]
        if name == NUMBERS:
            return self._loop.numbers[block]
        if name == TIME:
            return self._time
        if name in own.quantities:
            assert self._row is not None, "a quantity changes between samples"
            return self._row(block, name)
        return self.read(block, name)

    def read(self, block: int, name: str) -> casadi.SX:
        """The signal that an input of a block reads; its own value where it is not connected."""
        source = self._loop.source_of(block, name)
        if source is None:
            return casadi.SX(casadi.DM(self._loop.structure.blocks[block].optional[name]))
        return self.result(*source)


class _Rows:
    """Symbols of quantities that a function reads."""

    def __init__(self, loop: "LoopEquations"):
        self._loop = loop
        self.symbols: dict[Result, casadi.SX] = {}

    def __call__(self, block: int, name: str) -> casadi.SX:
        size = self._loop.structure.blocks[block].quantities[name]
        return self.symbols.setdefault((block, name), casadi.SX.sym(name, size))

    @property
    def stacked(self) -> casadi.SX:
        return casadi.vertcat(*self.symbols.values())


class Sample(NamedTuple):
    """The function of a sample, and what its rows are."""

    function: casadi.Function
    readings: tuple[Reading, ...]


class Now(NamedTuple):
    """A function of (x, t, p, rows) at one instant, and the quantities that its rows are."""

    function: casadi.Function
    quantities: tuple[Result, ...]


class LoopEquations:
    """The equations of a loop.

    Attributes:
        structure: its blocks and wires.
        moving, sampled: numbers of the blocks with a continuous or a sampled state.
        places: of each block's state in x, the continuous ones first.
        parameter_places: of each block's parameters in p.
        state_size, moving_size, parameter_size: of x, of its continuous part, and of p.
    """

    def __init__(self, structure: Structure):
        self.structure = structure
        blocks = [*enumerate(structure.blocks)]
        self.moving = [k for k, own in blocks if len(own.state) and not own.period]
        self.sampled = [k for k, own in blocks if len(own.state) and own.period]
        sizes = {k: len(structure.blocks[k].state) for k in (*self.moving, *self.sampled)}
        self.places, self.state_size = _places(sizes)
        self.moving_size = sum(sizes[k] for k in self.moving)
        numbers = {k: len(own.parameters) for k, own in blocks if len(own.parameters)}
        self.parameter_places, self.parameter_size = _places(numbers)
        self.shown_places = {k: _places(own.shown)[0] for k, own in blocks}
        self._x = casadi.SX.sym("x", self.state_size)
        self._t, self._p = casadi.SX.sym("t"), casadi.SX.sym("p", self.parameter_size)
        self.numbers = {k: self._p[place] for k, place in self.parameter_places.items()}
        self._own_states = {k: self._x[place] for k, place in self.places.items()}
        self._still: dict[Result, bool] = {}

    def source_of(self, block: int, name: str) -> Result | None:
        """The output that an argument of a block comes from; None: it is not connected."""
        own = self.structure.blocks[block]
        if name in own.outputs and name not in own.inputs:  # of its motion between samples
            return block, name
        return self.structure.sources.get((block, name))

    def stands_still(self, block: int, name: str) -> bool:
        """Whether a result changes at samples alone."""
        key = block, name
        if key not in self._still:
            own = self.structure.blocks[block]
            self._still[key] = all(self._is_still(block, own, r) for r in own.reads_of(name))
        return self._still[key]

    def _is_still(self, block: int, own: Equations, argument: str) -> bool:
        if argument == STATE:
            return bool(own.period)
        if argument == NUMBERS:
            return True
        if argument == TIME or argument in own.quantities:
            return False
        source = self.source_of(block, argument)
        return source is None or self.stands_still(*source)

    def _now(self, results: Callable[[Instant], Sequence[casadi.SX]], name: str) -> Now:
        """A function of an instant for some results, stacked."""
        rows = _Rows(self)
        made = results(Instant(self, self._own_states, self._t, {}, rows))
        given = [self._x, self._t, self._p, rows.stacked]
        function = casadi.Function(name, given, [casadi.vertcat(*made)], _CSE)
        return Now(function, tuple(rows.symbols))

    def shown(self, signals: Iterable[Result]) -> Now:
        """Signals, stacked, at an instant."""
        return self._now(lambda now: [now.result(*each) for each in signals], "shown")

    def read(self, block: int) -> Now:
        """All that a layer reads, stacked in the order of its inputs."""
        names = [*self.structure.blocks[block].inputs]
        return self._now(lambda now: [now.read(block, name) for name in names], "read")

    @functools.cached_property
    def held(self) -> tuple[dict[Result, casadi.SX], dict[Result, casadi.SX], casadi.Function]:
        """What stands still over a sample: symbols of what changes, what never does, its function.

        That is a function of x and p, stacked in the order of the symbols.
        """
        still = Instant(self, self._own_states, self._t, {})
        made: dict[Result, casadi.SX] = {}
        for k, own in enumerate(self.structure.blocks):
            for name in (*own.outputs, *own.shown, *(own.motion.makes if own.motion else ())):
                if self.stands_still(k, name):
                    made[k, name] = still.result(k, name)
        known = {key: value for key, value in made.items() if value.is_constant()}
        changing = {key: value for key, value in made.items() if key not in known}
        symbols = {key: casadi.SX.sym(key[1], value.numel()) for key, value in changing.items()}
        stacked = casadi.vertcat(*changing.values())
        return symbols, known, casadi.Function("still", [self._x, self._p], [stacked], _CSE)

    def _between(self, results: Callable[[Instant], Sequence[casadi.SX]], name: str) -> Now:
        """A function between samples: of the continuous and other states, t, p, `held`, rows."""
        symbols, known, _ = self.held
        rows = _Rows(self)
        now = Instant(self, self._own_states, self._t, known | symbols, rows)
        made = casadi.SX(casadi.densify(casadi.vertcat(*results(now))))
        states = casadi.vertsplit(self._x, [0, self.moving_size, self.state_size])
        stacked = casadi.vertcat(*symbols.values())
        given = [*states, self._t, self._p, stacked, rows.stacked]
        return Now(casadi.Function(name, given, [made], _CSE), tuple(rows.symbols))

    @functools.cached_property
    def rates(self) -> Now:
        """The rates of the continuous states, between samples."""
        return self._between(lambda now: [now.result(k, STATE) for k in self.moving], "rates")

    def start(self, *, first: bool) -> Now | None:
        """The state after the first states have started, continuous ones too, or all others."""

        def starts(k: int) -> bool:
            own = self.structure.blocks[k]
            is_first = own.starts_first or not own.period  # as Drake's events are declared
            return START in own.results and is_first == first

        if not any(map(starts, self.places)):
            return None
        return self._now(
            lambda now: [
                now.result(k, START) if starts(k) else self._own_states[k] for k in self.places
            ],
            "start",
        )

    def updates(self, period: float) -> Now:
        """The state after the updates at a sample of a period, s."""
        return self._now(
            lambda now: [
                *(self._own_states[k] for k in self.moving),
                *(self._after(now, k, period) for k in self.sampled),
            ],
            "updates",
        )

    def sample(
        self,
        schedule: Sequence[Step],
        period: float,
        signals: Sequence[Result],
        step_signals: Sequence[Result],
    ) -> Sample:
        """The function of a sample of a period, s, with the integrator's steps in it.

        What stands still over a sample is made once, and rates are one function.
        """
        rates = self.rates
        shown, of_step = (
            self._between(functools.partial(_results, own), name)
            for own, name in ((signals, "shown"), (step_signals, "steps"))
        )
        after = self._between(
            lambda now: [self._after(now, k, period) for k in self.sampled], "after"
        )
        x, t = casadi.MX.sym("x", self.state_size), casadi.MX.sym("t", 2)
        p = casadi.MX.sym("p", self.parameter_size)
        readings = self._readings(schedule, period, rates, shown, of_step, after)
        sizes = {r: self.structure.blocks[r.block].quantities[r.quantity] for r in readings}
        rows = casadi.MX.sym("rows", sum(sizes.values()))
        row = {reading: rows[place] for reading, place in _places(sizes)[0].items()}
        standing = self.held[2](x, p)
        state, others = casadi.vertsplit(x, [0, self.moving_size, self.state_size])

        def at(now: Now, state: casadi.MX, offset: float) -> casadi.MX:
            time = t[1] if offset == period else t[0] + offset if offset else t[0]
            own = [row[Reading(*each, offset)] for each in now.quantities]
            return now.function(state, others, time, p, standing, casadi.vertcat(*own))

        rows_shown, rows_of_steps = [], []
        for step in schedule:
            if self.moving_size:
                state = runge_kutta3(functools.partial(at, rates), state, step)
            if step.is_shown:
                rows_shown.append(at(shown, state, step.end))
            if step_signals:
                rows_of_steps.append(at(of_step, state, step.end))
        results = [
            casadi.vertcat(state, at(after, state, period)),
            casadi.vertcat(*rows_shown),
            casadi.vertcat(*rows_of_steps),
        ]
        function = casadi.Function("loop", [x, t, p, rows], [casadi.densify(r) for r in results])
        return Sample(function, readings)

    def _after(self, now: Instant, block: int, period: float) -> casadi.SX:
        """The state of a block after the updates at the next sample."""
        state, every = self._own_states[block], self.structure.every[block]
        if every == 0:
            return state
        after = now.result(block, STATE)
        if every == 1:
            return after
        count = casadi.floor(self._t / period + 0.5)
        return casadi.if_else(casadi.fmod(count, every) == 0, after, state)

    def _readings(
        self,
        schedule: Sequence[Step],
        period: float,
        rates: Now,
        shown: Now,
        of_step: Now,
        after: Now,
    ) -> tuple[Reading, ...]:
        """All that a sample reads of quantities, each once."""
        found: dict[Reading, None] = {}

        def add(now: Now, *offsets: float) -> None:
            found.update((Reading(*each, o), None) for each in now.quantities for o in offsets)

        for step in schedule:
            add(rates, step.begin, step.begin + step.size / 2, step.end)
            add(of_step, step.end)
            if step.is_shown:
                add(shown, step.end)
        add(after, period)
        return tuple(found)


def runge_kutta3(rate: Callable[[Any, float], Any], state: Any, step: Step) -> Any:
    """The state after a step, as Drake's integrator takes it; the rate is one of state and time."""
    h = step.size
    first = rate(state, step.begin)
    second = rate(state + h / 2 * first, step.begin + h / 2)
    third = rate(state - h * first + 2 * h * second, step.end)
    return state + h / 6 * first + 2 * h / 3 * second + h / 6 * third


def _places(sizes: Mapping[Any, int]) -> tuple[dict[Any, slice], int]:
    """Places of parts of these sizes, one after the other, and the size of the whole."""
    ends = np.cumsum([0, *sizes.values()]).tolist()
    return dict(zip(sizes, itertools.starmap(slice, itertools.pairwise(ends)), strict=True)), ends[
        -1
    ]


def _results(names: Sequence[Result], now: Instant) -> list[casadi.SX]:
    return [now.result(*each) for each in names]
