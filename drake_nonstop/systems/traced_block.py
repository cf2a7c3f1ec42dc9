"""Blocks that are one traced function: of inputs, state, parameters and the time."""

import functools
import pickle
import weakref
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import casadi
import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.systems.framework import (
    BasicVector,
    BasicVector_,
    Context,
    ContinuousState,
    DiscreteValues,
    InputPort,
    State,
    ValueProducer,
)
from pydrake.systems.primitives import SelectorParams

from drake_nonstop.systems.block import LeafBlock, number, weakly
from drake_nonstop.systems.diagram_trace import At
from drake_nonstop.systems.parameters import NumericParameters, declare_parameters
from drake_nonstop.systems.tracing import ArrayFunction, LateFunction, Trace, object_array

# What the function takes besides the input ports, and the rate that it makes: no names of ports.
_STATE, _RATE, _NUMBERS, _TIME = "(state)", "(rate)", "(parameters)", "(time)"
_LARGE = 600  # operations of a part whose outputs are kept in the cache
_BEFORE = "(before)"  # the outputs that later ones follow from
_INNER = {_STATE, _NUMBERS, _TIME}


class LateOutputs(NamedTuple):
    """Outputs that are traced when one of them is evaluated for the first time.

    `function` takes the block's inputs whose names `reads` has, those of `optional`, and its
    parameters; every output feeds through all of these inputs. Those of `optional`, names and
    sizes, are inputs of the block besides, which may be left unconnected, and then are zero.
    `outputs` and `key` are as of the block.
    """

    function: Callable
    reads: Sequence[str]
    outputs: Mapping[str, int]
    optional: Mapping[str, int] = {}
    key: Any = None


class LaterOutputs(NamedTuple):
    """Outputs that follow from others of a block and the time: how these go on after a sample.

    `function` takes the outputs whose names `reads` has, as they are without it, those of `inputs`,
    further inputs of the block, and the time (1,). Its `outputs` take the place of those of the
    same name. `key` is as of the block.
    """

    function: Callable
    reads: Sequence[str]
    inputs: Mapping[str, int]
    outputs: Sequence[str]
    key: Any = None


class TracedBlock(LeafBlock):
    """A block whose outputs are a traced function of its inputs.

    What feeds through to an output are the inputs that its trace reads. Each output is made by a
    call of its own into Python, or, where the function is large, with those that read the same. On
    AutoDiffXd and Expression the function itself is evaluated, on object arrays.

    Args:
        function: takes one flat array per entry of `inputs`, and returns one per entry of
            `outputs`. It is traced, see `TracedFunction`.
        inputs: the names of the input ports and their sizes.
        outputs: the names of the output ports and their sizes.
        known: names and sizes of what `function` takes after the inputs: functions of the time
            alone, whose rows (k, size) at times (k,) in s the method `quantities_over(names,
            times)` makes, and `quantity_rates_over` their rates, for other scalar types.
        reads_time: `function` takes the time (1,) in s after all others.
        parameters: what `function` takes by name, as arrays, numbers as (1,), besides: a numeric
            parameter of the context.
        key: as of `TracedFunction`; the parameters' values are no part of it.
        is_joint: each output depends on what any of them reads, so that large ones are made by one
            call.
        late: makes further outputs, which most loops do not read.
        later: makes some outputs of others and the time.

    Raises:
        ValueError: there is nothing to take: neither an input nor a state nor the time.
    """

    def __init__(
        self,
        function: Callable,
        *,
        inputs: Mapping[str, int],
        outputs: Mapping[str, int] | None = None,
        known: Mapping[str, int] | None = None,
        reads_time: bool = False,
        parameters: NumericParameters | None = None,
        key: Any = None,
        is_joint: bool = False,
        late: LateOutputs | None = None,
        later: LaterOutputs | None = None,
        **former: Any,
    ):
        if unknown := ", ".join(former):
            is_state = former.keys() <= {"state", "state_port"}
            said = "give it to TracedDynamics, whose state is an array"
            raise TypeError(f"{unknown}: {said if is_state else 'no such argument'}")
        super().__init__()
        parameters = parameters or NumericParameters({})
        size = self._declare_state()
        state, rate = ({_STATE: size}, [_RATE]) if size else ({}, [])
        self._known = dict(known or {})
        read, made = state | dict(inputs) | self._known, [*rate, *(outputs or {})]
        if not read and not reads_time:
            raise ValueError("inputs = none: give some, a state, or reads_time")
        if len(parameters) > 0:
            function = parameters.as_argument(function, len(read))
            read |= {_NUMBERS: len(parameters)}
            self.parameters = parameters
            declare_parameters(self, parameters)
        if reads_time:
            read |= {_TIME: 1}
        trace = Trace(function, [*read.values()], key=key)
        dependence = trace.dependence
        if is_joint:
            dependence = [set().union(*dependence)] * len(dependence)
        others = {*_INNER, *self._known}
        inner = {i for i, name in enumerate(read) if name in others}
        groups = _groups(dependence, inner, has_state=size > 0)
        self._parts = [_part_of(trace, group, [*read], made) for group in groups]
        if late is not None:
            self._parts.append(_late_part(late, read, parameters))
            self.optional_inputs = tuple(late.optional)
        ports = read | dict(late.optional if late else {}) | dict(later.inputs if later else {})
        self._inputs: dict[str, InputPort] = {
            name: self.DeclareVectorInputPort(name, size)
            for name, size in ports.items()
            if name not in others
        }
        self._places: dict[str, tuple[int, slice]] = {}  # of the outputs: part, and where in it
        # What evaluates each output, and what gives that its arguments.
        self._evaluators: dict[str, tuple[Callable, list[Callable[[Context], NDArray]]]] = {}
        self._tickets: dict[str, set[Any]] = {}  # what each output depends on
        self._wholes: dict[int, tuple[Callable, list]] = {}  # as the evaluators, of whole parts
        for k in range(len(self._parts)):
            self._declare(k)
        if later is not None:
            self._add(later)
        for name in [*made, *(late.outputs if late else [])]:
            if name != _RATE:
                self._declare_output(name)
        self.own_outputs = self.num_output_ports()  # a subclass may declare more

    def _add(self, later: LaterOutputs) -> None:
        """The part of outputs that follow from others, which are one vector in the cache."""
        places = [self._places[name] for name in later.reads]
        ends = np.cumsum([place.stop - place.start for _, place in places]).tolist()

        def function(before: NDArray, *others: NDArray) -> Any:
            return later.function(*np.split(before, ends[:-1]), *others)

        self._before = places
        self._earlier = [self._evaluators[name] for name in later.reads]
        produced = ValueProducer(Value(np.zeros(0)).Clone, weakly(self._calc_before))
        tickets = set().union(*(self._tickets[name] for name in later.reads))
        entry = self.DeclareCacheEntry("before", produced, tickets)
        self._before_index, self._before_ticket = entry.cache_index(), entry.ticket()
        read = {_BEFORE: ends[-1]} | dict(later.inputs) | {_TIME: 1}
        trace = Trace(function, [*read.values()], key=later.key)
        for group in _groups(trace.dependence, {*range(len(read))}, has_state=False):
            self._parts.append(_part_of(trace, group, [*read], later.outputs))
            self._declare(len(self._parts) - 1)

    def _calc_before(self, context: Context, value: Any) -> None:
        made = ((evaluate, [read(context) for read in reads]) for evaluate, reads in self._earlier)
        value.set_value(np.concatenate([evaluate(values).copy() for evaluate, values in made]))

    def _declare_output(self, name: str) -> None:
        _, place = self._places[name]
        calc = _calc(weakref.ref(self), name)
        self.DeclareVectorOutputPort(name, place.stop - place.start, calc, self._tickets[name])

    def _declare_state(self) -> int:
        """Declares the state; its size."""
        return 0

    @property
    def _state(self) -> Callable[[Context], NDArray]:
        """What gives the state of a context."""
        raise NotImplementedError("there is no state")

    def _declare(self, k: int) -> None:
        """The outputs of a part: each a function of its own, or all one in a cache entry.

        To look into the cache takes as long as some hundred operations.
        """
        part = self._parts[k]
        readers = [self._reader(name, part.optional) for name in part.reads] or [_time_of]
        tickets = {self._ticket(name) for name in part.reads} or {self.nothing_ticket()}
        numbers, entry = range(len(part.outputs)), None
        is_shared = part.is_large or not self._known.keys().isdisjoint(part.reads)
        if is_shared and len(part.outputs) > 1:
            self._wholes[k] = part.make(self.scalar, weakly(self.box), numbers).of_vectors, readers
            produced = ValueProducer(Value(np.zeros(0)).Clone, _calc_whole(weakref.ref(self), k))
            declared = self.DeclareCacheEntry(f"part {k}", produced, tickets)
            entry, tickets = declared.cache_index(), {declared.ticket()}
        for i, (name, place) in zip(numbers, part.outputs.items(), strict=True):
            self._places[name], self._tickets[name] = (k, place), tickets
            if entry is None:
                function = part.make(self.scalar, weakly(self.box), [i])
                self._evaluators[name] = function.of_vectors, readers
            else:
                self._evaluators[name] = _at(place), [self._cached(entry)]

    def _cached(self, entry: Any) -> Callable[[Context], NDArray]:
        me: Any = weakref.ref(self)
        return lambda context: me().get_cache_entry(entry).Eval(context)

    def _ticket(self, name: str) -> Any:
        if name == _BEFORE:
            return self._before_ticket
        if name == _STATE:
            return self.all_state_ticket()
        if name == _NUMBERS:
            return self.all_parameters_ticket()
        if name == _TIME or name in self._known:
            return self.time_ticket()
        return self.input_port_ticket(self._inputs[name].get_index())

    def _evaluated(self, context: Context, name: str) -> NDArray:
        """An output as it is made, in a view of scratch memory."""
        evaluate, readers = self._evaluators[name]
        return evaluate([read(context) for read in readers])

    def _reader(self, name: str, optional: Mapping[str, int]) -> Callable[[Context], NDArray]:
        """What gives a value that a part takes, of a context."""
        if name in optional:
            return functools.partial(_input_or, self._inputs[name], np.zeros(optional[name]))
        if name in self._inputs:
            return self._inputs[name].Eval
        if name == _BEFORE:
            return self._cached(self._before_index)
        if name in self._known:
            quantity = weakly(self._quantity)
            return lambda context: quantity(context, name)
        return self._state if name == _STATE else {_NUMBERS: _parameters_of, _TIME: _time_of}[name]

    def _quantity(self, context: Context, name: str) -> NDArray:
        """What is known of the time; of other scalar types, with its rate."""
        if self.scalar is float:
            return self.quantity_at(name, context.get_time())
        now = np.array([number(context.get_time())])
        (values,) = self.quantities_over([name], now)
        (rates,) = self.quantity_rates_over([name], now)
        return values[0] + rates[0] * (context.get_time() - now[0])

    def quantity_at(self, name: str, time: float) -> NDArray:
        """A row of `quantities_over`."""
        return self.quantities_over([name], np.array([time]))[0][0]

    @property
    def trace_key(self) -> Any:
        """The functions of the parts."""
        keys = tuple(part.key for part in self._parts)
        return None if None in keys else keys

    def traced_output(self, port: str, at: At) -> NDArray:
        """As of `systems.diagram_trace`."""
        return self._traced_at(self._places[port], at)

    def _traced_at(self, where: tuple[int, slice], at: At) -> NDArray:
        """What a part makes at a place, in symbols."""
        k, place = where
        return at.once(k, lambda: self._traced(k, at))[place]

    def _traced(self, k: int, at: At, state: NDArray | None = None) -> NDArray:
        """What a part makes, in symbols; `state` is in place of the present one."""
        part = self._parts[k]
        read = [
            self._traced_value(name, at, part.optional)
            if state is None or name != _STATE
            else state
            for name in part.reads
        ]
        taken = casadi.SX(casadi.vertcat(*np.concatenate(read))) if read else 0
        results, _ = part.function()(taken)
        return object_array(results)

    def _traced_value(self, name: str, at: At, optional: Mapping[str, int]) -> NDArray:
        if name in optional:
            return at.input_or(name, np.zeros(optional[name]))
        if name == _BEFORE:
            return np.concatenate([self._traced_at(where, at) for where in self._before])
        if name == _NUMBERS:
            return at.parameters
        if name == _TIME:
            return at.time
        if name in self._known:
            return at.known(name, self._known[name])
        return self._traced_state(at) if name == _STATE else at.input(name)

    def _traced_state(self, at: At) -> NDArray:
        raise NotImplementedError("there is no state")


class TracedDynamics(TracedBlock):
    """A `TracedBlock` with a state.

    `function` takes it first, and returns its rate first. The other arguments are as there.

    Args:
        function: as there.
        state: (s,), the initial one; None: there is none after all.
        state_port: the name of the output port that shows the state, the last one; none: no port
            does.
        period: s, at every sample but the first of which the state changes by as much times its
            rate; 0: it is continuous.
        updates_first: whether a sampled state changes before the updates of all other blocks.
        start: makes the state at the start of a run of these inputs; None: it is the initial one.
        is_held: whether the outputs of a sampled state are held from sample to sample. They are
            made after the updates of blocks that update first, of the state before its own.
        others: as there.
    """

    def __init__(
        self,
        function: Callable,
        *,
        state: NDArray | None,
        state_port: str = "",
        period: float = 0.0,
        updates_first: bool = False,
        start: tuple[Callable[..., NDArray], Sequence[str]] | None = None,
        is_held: bool = False,
        **others: Any,
    ):
        self._initial, self._period = np.array([] if state is None else state, float), period
        self.updates_first, self._start = updates_first, start
        if len(self._initial) == 0 and (state_port or start):
            raise ValueError("state = none: give one, or neither state_port nor start")
        self._is_held = is_held and period > 0 and len(self._initial) > 0
        self._held: list[str] = []  # the outputs of the discrete groups behind the state
        super().__init__(function, **others)
        self._state_port = state_port
        if state_port:
            self.DeclareStateOutputPort(state_port, self._state_index)
            self.own_outputs = self.num_output_ports()
        if start is not None:
            self.DeclareInitializationUnrestrictedUpdateEvent(weakly(self._begin))
        if self._is_held:
            self.DeclareInitializationDiscreteUpdateEvent(weakly(self._hold))
        self.updates_at_start = start is not None or self._is_held
        self.starts_first = start is not None and not self._is_held

    @property
    def period(self) -> float:
        """Of the samples of the state, s; 0: it is continuous, or there is none."""
        return self._period if len(self._initial) else 0.0

    @property
    def trace_key(self) -> Any:
        """As of `TracedBlock`, and how the state goes on and starts."""
        key, start = super().trace_key, self._start
        how = self.period, self.updates_first, self._is_held, start and (start[0], tuple(start[1]))
        return None if key is None else (key, how)

    def _declare_state(self) -> int:
        if len(self._initial) == 0:
            return 0
        vector = BasicVector_[self.scalar](self._initial)
        if self._period == 0:
            self._state_index = self.DeclareContinuousState(vector)
        else:
            self._state_index = self.DeclareDiscreteState(vector)
            times = self._period, self._period
            if self.updates_first:  # Drake makes unrestricted updates before discrete ones
                self.DeclarePeriodicUnrestrictedUpdateEvent(*times, weakly(self._step_first))
            else:
                self.DeclarePeriodicDiscreteUpdateEvent(*times, weakly(self._step))
        return len(self._initial)

    def _declare_output(self, name: str) -> None:
        if not self._is_held:
            super()._declare_output(name)
            return
        _, place = self._places[name]
        vector = BasicVector_[self.scalar](np.zeros(place.stop - place.start))
        self.DeclareStateOutputPort(name, self.DeclareDiscreteState(vector))
        self._held.append(name)

    @property
    def _state(self) -> Callable[[Context], NDArray]:
        return _continuous_state_of if self._period == 0 else _discrete_state_of

    def _rate(self, context: Context) -> NDArray:
        return self._evaluated(context, _RATE)

    def DoCalcTimeDerivatives(  # noqa: N802
        self, context: Context, derivatives: ContinuousState
    ) -> None:
        """As LeafSystem's."""
        if self._period == 0 and len(self._initial):
            derivatives.SetFromVector(self._rate(context))

    def _step(self, context: Context, discrete_state: DiscreteValues) -> None:
        state = self._state(context) + self._period * self._rate(context)
        self._hold(context, discrete_state)
        discrete_state.set_value(0, state)

    def _hold(self, context: Context, discrete_state: DiscreteValues) -> None:
        for i, name in enumerate(self._held):
            discrete_state.set_value(1 + i, self._evaluated(context, name))

    def _begin(self, context: Context, state: State) -> None:
        assert self._start is not None
        make, names = self._start
        values = make(*(self._inputs[name].Eval(context) for name in names))
        if self._period == 0:
            state.get_mutable_continuous_state().SetFromVector(values)
        else:
            state.get_mutable_discrete_state().set_value(0, values)

    def _step_first(self, context: Context, state: State) -> None:
        self._step(context, state.get_mutable_discrete_state())

    def traced_output(self, port: str, at: At) -> NDArray:
        """As of `systems.diagram_trace`."""
        if port in self._held:
            return at.state(2 + self._held.index(port))
        return self._traced_state(at) if port == self._state_port else self._traced_result(port, at)

    def _traced_state(self, at: At) -> NDArray:
        return at.state(0 if self._period == 0 else 1)

    def traced_rates(self, at: At) -> NDArray:
        """As of `systems.diagram_trace`."""
        return self._traced_result(_RATE, at)

    @property
    def traced_update(self) -> Callable[[At], list[NDArray]]:
        """As of `systems.diagram_trace`; what is not sampled has none."""
        if self._period == 0 or len(self._initial) == 0:
            raise AttributeError("traced_update: the state is not sampled")
        return self._traced_update

    def _traced_update(self, at: At) -> list[NDArray]:
        state = self._traced_state(at) + self._period * self.traced_rates(at)
        return [state, *(self._traced_result(name, at) for name in self._held)]

    def _traced_result(self, name: str, at: At) -> NDArray:
        """What is made, and not what is held."""
        return self._traced_at(self._places[name], at)

    @property
    def traced_start(self) -> Callable[[At], list[NDArray]]:
        """As of `systems.diagram_trace`."""
        if self._start is None:
            raise AttributeError("traced_start: the state starts as it was declared")
        return self._traced_start

    def _traced_start(self, at: At) -> list[NDArray]:
        assert self._start is not None
        make, names = self._start
        state = make(*(at.input(name) for name in names))
        places = (self._places[name] for name in self._held)
        return [state, *(self._traced(k, at, state)[place] for k, place in places)]


class _Group(NamedTuple):
    """Outputs that depend on the same input ports, made together."""

    reads: list[int]  # the numbers of the inputs that any of them depends on
    makes: list[int]  # the outputs' numbers


def _groups(dependence: list[set[int]], inner: set[int], has_state: bool) -> list[_Group]:
    """The outputs in groups, in the order of their first ones.

    Args:
        dependence: as of `Trace`.
        inner: the numbers of the inputs that are no ports. An output is taken to depend on
            one of these where another one of its group does.
        has_state: the first output goes into the state: no port shows on which inputs it
            depends, and it is made with others that read these and more.
    """
    ports = [frozenset(depends - inner) for depends in dependence]
    if has_state:
        wider = [other for other in ports[1:] if other >= ports[0]]
        ports[0] = min(wider, key=len, default=ports[0])
    groups = []
    for own in dict.fromkeys(ports):
        makes = [i for i, other in enumerate(ports) if other == own]
        groups.append(_Group(sorted(set().union(*(dependence[i] for i in makes))), makes))
    return groups


class _Part(NamedTuple):
    """Outputs that are made together."""

    reads: list[str]  # what the function takes, stacked
    outputs: dict[str, slice]  # their places in what is made
    # Takes the scalar type, the name of the block and numbers of outputs, and returns what
    # evaluates these: a `TracedFunction` or what stands in for one.
    make: Callable[[type, Callable[[], str], Sequence[int]], Any]
    function: Callable[[], casadi.Function]  # of what is read, stacked
    key: Any  # equal for parts of one function; None: there is no other
    is_large: bool  # all outputs are made at once
    optional: Mapping[str, int] = {}  # inputs which may be left unconnected, and their sizes


def _consecutive(sizes: Mapping[str, int]) -> dict[str, slice]:
    ends = np.cumsum([0, *sizes.values()]).tolist()
    return {name: slice(a, b) for name, a, b in zip(sizes, ends, ends[1:], strict=False)}


def _part_of(trace: Trace, group: _Group, read: Sequence[str], made: Sequence[str]) -> _Part:
    """A group of the outputs of a trace, which takes and makes what has these names."""

    def make(scalar: type, name: Callable[[], str], numbers: Sequence[int]) -> Any:
        function = trace.compiled if scalar is float else trace.on_arrays
        return function(group.reads, [group.makes[i] for i in numbers], name=name)

    return _Part(
        [read[i] for i in group.reads],
        _consecutive({made[i]: trace.output_sizes[i] for i in group.makes}),
        make,
        lambda: trace.part(group.reads, group.makes),
        (trace.identity, *map(tuple, group)),
        trace.part(group.reads, group.makes).n_instructions() > _LARGE,
    )


def _late_part(
    late: LateOutputs, inputs: Mapping[str, int], parameters: NumericParameters
) -> _Part:
    """The part for late outputs of a block's inputs, whose names and sizes are given."""
    names, function = [*late.reads], late.function
    if len(parameters) > 0:
        function = parameters.as_argument(function, len(names))
        names.append(_NUMBERS)
    sizes = [*(inputs[name] for name in names), *late.optional.values()]
    names += late.optional
    all_names = range(len(names))

    @functools.cache
    def trace() -> Trace:
        return Trace(function, sizes, key=late.key)

    def make(scalar: type, name: Callable[[], str], numbers: Sequence[int]) -> Any:
        if scalar is not float:
            return ArrayFunction(function, sizes, all_names, numbers, name=name)
        return LateFunction(lambda: trace().compiled(all_names, numbers, name=name))

    def traced() -> casadi.Function:
        return trace().part(all_names, range(len(late.outputs)))

    key = None if late.key is None else pickle.dumps((late.key, sizes))
    return _Part(names, _consecutive(late.outputs), make, traced, key, True, dict(late.optional))


def _at(place: slice) -> Callable[[Sequence[NDArray]], NDArray]:
    """Takes a part of the only one of some vectors."""
    return lambda vectors: vectors[0][place]


def _input_or(port: InputPort, other: NDArray, context: Context) -> NDArray:
    return port.Eval(context) if port.HasValue(context) else other


def _parameters_of(context: Context) -> NDArray:
    return context.get_numeric_parameter(0).CopyToVector()


def _continuous_state_of(context: Context) -> NDArray:
    return context.get_continuous_state_vector().CopyToVector()


def _discrete_state_of(context: Context) -> NDArray:
    return context.get_discrete_state(0).CopyToVector()


def _time_of(context: Context) -> NDArray:
    return np.array([context.get_time()])


# What Drake calls refers to the block weakly: it would keep the block, and its diagram, alive.


def _calc_whole(block: Callable[[], Any], k: int) -> Callable[[Context, Any], None]:
    def calc(context: Context, value: Any) -> None:
        evaluate, readers = block()._wholes[k]
        value.set_value(evaluate([read(context) for read in readers]).copy())

    return calc


def _calc(block: Callable[[], Any], name: str) -> Callable[[Context, BasicVector], None]:
    return lambda context, output: output.SetFromVector(block()._evaluated(context, name))


def stacking(sizes: Mapping[str, int], output: str = "stacked") -> SelectorParams:
    """Of a Selector that makes one vector of inputs of these names and sizes.

    Unlike Drake's Multiplexer it does nothing while only the time changes.
    """
    places = [(i, k) for i, size in enumerate(sizes.values()) for k in range(size)]
    return SelectorParams(
        inputs=[
            SelectorParams.InputPortParams(name=name, size=size) for name, size in sizes.items()
        ],
        outputs=[
            SelectorParams.OutputPortParams(
                name=output,
                selections=[
                    SelectorParams.OutputSelection(input_port_index=i, input_offset=k)
                    for i, k in places
                ],
            )
        ],
    )
