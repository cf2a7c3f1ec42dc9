"""Blocks that are one traced function: of inputs, state, parameters and the time."""

import functools
import weakref
from collections.abc import Callable, Collection, Mapping, Sequence
from itertools import pairwise
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
    LeafSystem,
    LeafSystem_,
    State,
    ValueProducer,
)

from drake_nonstop.mechanics.signal_layouts import SAMPLE_TIME
from drake_nonstop.systems.block import LeafBlock, number, weakly
from drake_nonstop.systems.diagram_trace import TraceContext
from drake_nonstop.systems.parameters import NumericParameters, declare_parameters
from drake_nonstop.systems.tracing import OutputGroup, Trace, grouped_outputs, object_array

# What the function takes besides the input ports, and the rate that it makes: no names of ports.
_STATE, _RATE, _NUMBERS, _TIME = "(state)", "(rate)", "(parameters)", "(time)"
_LARGE = 600  # operations of a part whose outputs are kept in the cache
_AT_SAMPLE = "(at the sample)"  # the outputs that move from there


class BetweenSamples(NamedTuple):
    """How outputs that are computed at a sample move until the next one.

    `function` takes the outputs of these names as they are at the sample, and the time (1,) in s
    since then. What it returns takes the place of the outputs whose names `makes` has.
    """

    function: Callable
    reads: Sequence[str]
    makes: Sequence[str]
    key: Any = None  # as of the block


class Start(NamedTuple):
    """Function for the state at the start of a run, of these inputs."""

    function: Callable[..., NDArray]
    reads: Sequence[str]


class TracedBlock(LeafBlock):
    """A block whose outputs, and the rate of whose state, are a traced function of its inputs.

    What feeds through to an output are the inputs that its trace reads. Each output is made by a
    call of its own into Python, or, where the function is large, with those that read the same. On
    AutoDiffXd and Expression the function itself is evaluated, on object arrays.

    Args:
        function: takes the state, if there is one, and one flat array per entry of `inputs`, and
            returns the state's rate, if there is one, and one array per entry of `outputs`. It is
            traced, see `TracedFunction`.
        inputs: the names of the input ports and their sizes.
        outputs: the names of the output ports and their sizes.
        optional: the names of inputs that may be left unconnected, and then are zero.
        known: names and sizes of what `function` takes after the inputs: functions of the time
            alone, whose rows (k, size) at times (k,) in s the method `precomputed_inputs(names,
            times)` makes, and `precomputed_input_rates` their rates, for other scalar types.
        reads_time: `function` takes the time (1,) in s after all others.
        parameters: what `function` takes by name, as arrays, numbers as (1,), besides: a numeric
            parameter of the context.
        key: as of `TracedFunction`; the parameters' values are no part of it.
        is_joint: each output depends on what any of them reads, so that large ones are made by one
            call.
        between: how some outputs go on between samples; the block then reads `sample_time`.
        state: (s,), the initial one; None: there is none.
        state_port: the name of the output port that shows the state; it is among the `outputs`, and
            `function` does not make it. None: no port does.
        period: s, at every sample but the first of which the state changes by as much times its
            rate; 0: it is continuous.
        updates_first: whether a sampled state changes before the updates of all other blocks.
        start: makes the state at the start of a run; None: it is the initial one.
        is_held: whether the outputs of a sampled state are held from sample to sample. They are
            made after the updates of blocks that update first, of the state before its own.
    """

    has_rates = False
    _declarations = 0  # of states and events
    sample_period: float  # s, of the samples of the state; 0: it is continuous, or there is none

    def __init__(
        self,
        function: Callable,
        *,
        inputs: Mapping[str, int],
        outputs: Mapping[str, int] | None = None,
        optional: Collection[str] = (),
        known: Mapping[str, int] | None = None,
        reads_time: bool = False,
        parameters: NumericParameters | None = None,
        key: Any = None,
        is_joint: bool = False,
        between: BetweenSamples | None = None,
        state: NDArray | None = None,
        state_port: str | None = None,
        period: float = 0.0,
        updates_first: bool = False,
        start: Start | None = None,
        is_held: bool = False,
    ):
        super().__init__()
        self._initial = np.array([] if state is None else state, float)
        self.updates_first, self._start, self._state_port = updates_first, start, state_port
        size = len(self._initial)
        self.sample_period = period if size > 0 else 0.0
        if size > 0 and not self.has_rates:
            raise TypeError("state: give it to TracedDynamics, which has rates")
        if size == 0 and (state_port or start):
            raise ValueError("state = none: give one, or neither state_port nor start")
        if state_port and (outputs or {}).get(state_port) != size:
            raise ValueError(f"state_port = {state_port}: put it among the outputs, of size {size}")
        self._is_held = is_held and self.sample_period > 0
        self._held: list[str] = []  # the outputs of the discrete groups behind the state
        self.updates_at_start = start is not None or self._is_held
        self.starts_first = start is not None and not self._is_held
        if size > 0:
            self._declare_state()
        self._known = dict(known or {})
        read = ({_STATE: size} if size else {}) | dict(inputs) | self._known
        made = [*([_RATE] if size else []), *(n for n in outputs or () if n != state_port)]
        if parameters is not None and len(parameters) > 0:
            function = parameters.as_argument(function, len(read))
            read |= {_NUMBERS: len(parameters)}
            self.parameters = parameters
            declare_parameters(self, parameters)
            if key is not None:
                key = key, tuple((k, v.shape) for k, v in parameters.defaults.items())
        if reads_time:
            read |= {_TIME: 1}
        self._optional = {name: np.zeros(read[name]) for name in optional}
        if optional:
            self.optional_inputs = (*optional,)
        trace = Trace(function, [*read.values()], key=key)
        every = [*range(len(read))], [*range(len(made))]
        # In a trace of a diagram: what the function calls is called once, for all outputs.
        self._at_once = _Part(trace, every, [*read], made) if trace.calls and not between else None
        ports = dict(inputs) | ({SAMPLE_TIME: 1} if between else {})
        self._inputs: dict[str, InputPort] = {
            name: self.DeclareVectorInputPort(name, size) for name, size in ports.items()
        }
        self._parts: list[_Part] = []
        self._entries: list[Any] = []  # of the parts in the cache: their index and ticket
        self._places: dict[str, tuple[int, slice]] = {}  # of the outputs: part, and where in it
        # What evaluates each output, and some parts by their numbers, and what gives it arguments.
        self._evaluators: dict[str | int, tuple[Callable, list[Callable]]] = {}
        self._tickets: dict[str, set[Any]] = {}  # what each output depends on
        dependence = trace.dependence
        if is_joint:
            dependence = [set().union(*dependence)] * len(dependence)
        apart: list[int] = []
        if between is not None:
            apart = [made.index(name) for name in between.reads]
            reads = sorted(set().union(*(dependence[i] for i in apart)))
            self._add(trace, (reads, apart), [*read], made, is_shared=True)
        inner = {i for i, name in enumerate(read) if name not in inputs}
        others = [i for i in range(len(made)) if i not in apart]
        for group in grouped_outputs(dependence, others, inner, has_state=size > 0):
            self._add(trace, group, [*read], made)
        if between is not None:
            self._add_moved(between)
        for name, output_size in (outputs or {}).items():
            self._declare_output(name, output_size)
        if start is not None:
            self.DeclareInitializationUnrestrictedUpdateEvent(weakly(self._begin))
        if self._is_held:
            self.DeclareInitializationDiscreteUpdateEvent(weakly(self._hold))
        # A subclass may declare more.
        self._of_function = self.num_output_ports(), self._declarations

    @property
    def is_one_function(self) -> bool:
        """Whether its outputs, states and events are those of the function alone."""
        return self._of_function == (self.num_output_ports(), self._declarations)

    @property
    def trace_key(self) -> Any:
        """The functions of the parts, and how the state goes on and starts."""
        keys = tuple(part.key for part in self._parts)
        start = self._start and (self._start.function, tuple(self._start.reads))
        return keys, self.sample_period, self.updates_first, self._is_held, start

    def _add_moved(self, between: BetweenSamples) -> None:
        """The part of the outputs that move, from the first part, on to a time."""
        sizes = [place.stop - place.start for place in self._parts[0].outputs.values()]
        ends = np.cumsum(sizes).tolist()

        def function(at_sample: NDArray, sample_time: NDArray, time: NDArray) -> Any:
            return between.function(*np.split(at_sample, ends[:-1]), time - sample_time)

        read = {_AT_SAMPLE: ends[-1], SAMPLE_TIME: 1, _TIME: 1}
        trace = Trace(function, [*read.values()], key=between.key)
        for group in grouped_outputs(trace.dependence, range(len(between.makes)), {*range(3)}):
            self._add(trace, group, [*read], between.makes)

    def _add(
        self,
        trace: Trace,
        group: OutputGroup,
        read: Sequence[str],
        made: Sequence[str],
        *,
        is_shared: bool = False,
    ) -> None:
        """A part: its outputs are each a function of its own, or all one in a cache entry.

        To look into the cache takes as long as some hundred operations.
        """
        k, part = len(self._parts), _Part(trace, group, read, made)
        self._parts.append(part)
        readers = [self._reader(name) for name in part.reads] or [_time_of]
        tickets = {self._ticket(name) for name in part.reads} or {self.nothing_ticket()}
        entry, name_of_block = None, weakly(self.box)
        if is_shared or (len(part.outputs) > 1 and self._is_costly(part)):
            self._evaluators[k] = part.evaluator(self.scalar, name_of_block), readers
            produced = ValueProducer(Value(np.zeros(0)).Clone, _calc_whole(weakref.ref(self), k))
            entry = self.DeclareCacheEntry(f"part {k}", produced, tickets)
            self._entries.append((entry.cache_index(), entry.ticket()))
            tickets = {entry.ticket()}
        for i, (name, place) in enumerate(part.outputs.items()):
            self._places[name], self._tickets[name] = (k, place), tickets
            if entry is None:
                self._evaluators[name] = part.evaluator(self.scalar, name_of_block, i), readers
            else:
                self._evaluators[name] = _at(place), [self._cached(self._entries[-1][0])]

    def _is_costly(self, part: "_Part") -> bool:
        knows = not self._known.keys().isdisjoint(part.reads)
        return knows or part.function.n_instructions() > _LARGE

    def _cached(self, entry: Any) -> Callable[[Context], NDArray]:
        me: Any = weakref.ref(self)
        return lambda context: me().get_cache_entry(entry).Eval(context)

    def _ticket(self, name: str) -> Any:
        if name == _AT_SAMPLE:
            return self._entries[0][1]
        if name == _STATE:
            return self.all_state_ticket()
        if name == _NUMBERS:
            return self.all_parameters_ticket()
        if name == _TIME or name in self._known:
            return self.time_ticket()
        return self.input_port_ticket(self._inputs[name].get_index())

    def _reader(self, name: str) -> Callable[[Context], NDArray]:
        """Function of a context for a value that a part takes."""
        if name in self._optional:
            return functools.partial(_input_or, self._inputs[name], self._optional[name])
        if name in self._inputs:
            return self._inputs[name].Eval
        if name == _AT_SAMPLE:
            return self._cached(self._entries[0][0])
        if name in self._known:
            quantity = weakly(self._quantity)
            return lambda context: quantity(context, name)
        if name == _STATE:
            return _continuous_state_of if self.sample_period == 0 else _discrete_state_of
        return {_NUMBERS: _parameters_of, _TIME: _time_of}[name]

    def _evaluated(self, context: Context, name: str | int) -> NDArray:
        """An output as it is made, or a part, in a view of scratch memory."""
        evaluate, readers = self._evaluators[name]
        return evaluate([read(context) for read in readers])

    def _quantity(self, context: Context, name: str) -> NDArray:
        """The time; of other scalar types, with its rate."""
        if self.scalar is float:
            return self.quantity_at(name, context.get_time())
        now = np.array([number(context.get_time())])
        (values,) = self.precomputed_inputs([name], now)
        (rates,) = self.precomputed_input_rates([name], now)
        return values[0] + rates[0] * (context.get_time() - now[0])

    def quantity_at(self, name: str, time: float) -> NDArray:
        """A row of `precomputed_inputs`."""
        return self.precomputed_inputs([name], np.array([time]))[0][0]

    def _declare_state(self) -> None:
        vector = BasicVector_[self.scalar](self._initial)
        if self.sample_period == 0:
            self._state_index = self.DeclareContinuousState(vector)
            return
        self._state_index = self.DeclareDiscreteState(vector)
        # Drake makes unrestricted updates before discrete ones.
        declare: Any = self.DeclarePeriodicDiscreteUpdateEvent
        if self.updates_first:
            declare = self.DeclarePeriodicUnrestrictedUpdateEvent
        declare(self.sample_period, self.sample_period, weakly(self._step))

    def _declare_output(self, name: str, size: int) -> None:
        if name == self._state_port:
            self.DeclareStateOutputPort(name, self._state_index)
        elif self._is_held:
            vector = BasicVector_[self.scalar](np.zeros(size))
            self.DeclareStateOutputPort(name, self.DeclareDiscreteState(vector))
            self._held.append(name)
        else:
            calc = _calc(weakref.ref(self), name)
            self.DeclareVectorOutputPort(name, size, calc, self._tickets[name])

    def _step(self, context: Context, after: DiscreteValues | State) -> None:
        discrete_state = after.get_mutable_discrete_state() if self.updates_first else after
        rate = self._evaluated(context, _RATE)
        state = _discrete_state_of(context) + self.sample_period * rate
        self._hold(context, discrete_state)
        discrete_state.set_value(0, state)

    def _hold(self, context: Context, discrete_state: DiscreteValues) -> None:
        for i, name in enumerate(self._held):
            discrete_state.set_value(1 + i, self._evaluated(context, name))

    def _begin(self, context: Context, state: State) -> None:
        assert self._start is not None
        make, names = self._start
        values = make(*(self._inputs[name].Eval(context) for name in names))
        if self.sample_period == 0:
            state.get_mutable_continuous_state().SetFromVector(values)
        else:
            state.get_mutable_discrete_state().set_value(0, values)

    # As of `systems.diagram_trace`.

    def traced_output(self, port: str, at: TraceContext) -> NDArray:
        """Value of a port."""
        if port in self._held:
            return at.state(2 + self._held.index(port))
        return self._traced_state(at) if port == self._state_port else self._traced_result(port, at)

    def traced_rates(self, at: TraceContext) -> NDArray:
        """The rate of the state."""
        return self._traced_result(_RATE, at)

    @property
    def traced_update(self) -> Callable[[TraceContext], list[NDArray]]:
        """The state and what is held, after a sample; what is not sampled has none."""
        if self.sample_period == 0:
            raise AttributeError("traced_update: the state is not sampled")
        return self._traced_update

    def _traced_update(self, at: TraceContext) -> list[NDArray]:
        state = self._traced_state(at) + self.sample_period * self.traced_rates(at)
        return [state, *(self._traced_result(name, at) for name in self._held)]

    @property
    def traced_start(self) -> Callable[[TraceContext], list[NDArray]]:
        """The state and what is held at the start of a run; none where that is as declared."""
        if self._start is None and not self._is_held:
            raise AttributeError("traced_start: the state starts as it was declared")
        return self._traced_start

    def _traced_start(self, at: TraceContext) -> list[NDArray]:
        state = self._traced_state(at)
        if self._start is not None:
            make, names = self._start
            state = make(*(at.input(name) for name in names))
        places = (self._places[name] for name in self._held)
        return [state, *(self._traced(self._parts[k], at, state)[place] for k, place in places)]

    def _traced_state(self, at: TraceContext) -> NDArray:
        return at.state(0 if self.sample_period == 0 else 1)

    def _traced_result(self, name: str, at: TraceContext) -> NDArray:
        """Outputs as they are made, and not as they are held."""
        part = self._at_once or self._parts[self._places[name][0]]
        return at.once(part.key, lambda: self._traced(part, at))[part.outputs[name]]

    def _traced(self, part: "_Part", at: TraceContext, state: NDArray | None = None) -> NDArray:
        """Outputs of a part, in symbols; `state` is in place of the present one."""
        read = [
            state if name == _STATE and state is not None else self._traced_value(name, at)
            for name in part.reads
        ]
        taken = casadi.SX(casadi.vertcat(*np.concatenate(read)) if read else 0)
        results, _ = part.function(taken)
        return object_array(results)

    def _traced_value(self, name: str, at: TraceContext) -> NDArray:
        if name in self._optional:
            return at.input_or(name, self._optional[name])
        if name == _AT_SAMPLE:
            first = self._parts[0]
            return at.once(first.key, lambda: self._traced(first, at))
        if name == _NUMBERS:
            return at.parameters
        if name == _TIME:
            return at.time
        if name in self._known:
            return at.known(name, self._known[name])
        return self._traced_state(at) if name == _STATE else at.input(name)


def _noted(name: str) -> Callable:
    """A Declare function of LeafSystem's that a block notes."""

    def declare(self: Any, *arguments: Any, **named: Any) -> Any:
        self._declarations += 1
        return getattr(LeafSystem_[self.scalar], name)(self, *arguments, **named)

    return declare


for _name in dir(LeafSystem):
    if _name.startswith("Declare") and _name.endswith(("Event", "State")):
        setattr(TracedBlock, _name, _noted(_name))


class TracedDynamics(TracedBlock):
    """A `TracedBlock` with a state: Drake asks no other one for rates, which would take 2 µs."""

    has_rates = True

    def DoCalcTimeDerivatives(  # noqa: N802
        self, context: Context, derivatives: ContinuousState
    ) -> None:
        """Overrides LeafSystem's."""
        if self.sample_period == 0 and len(self._initial) > 0:
            derivatives.SetFromVector(self._evaluated(context, _RATE))


class _Part:
    """Outputs of a trace that are made together, of inputs and outputs with these names."""

    def __init__(self, trace: Trace, group: OutputGroup, read: Sequence[str], made: Sequence[str]):
        self._trace, (self._taken, self._makes) = trace, group
        self.reads = [read[i] for i in self._taken]  # what it takes, stacked
        ends = np.cumsum([0, *(trace.output_sizes[i] for i in self._makes)]).tolist()
        places = zip(self._makes, pairwise(ends), strict=True)
        self.outputs = {made[i]: slice(*pair) for i, pair in places}  # in what is made
        self.key = (trace.identity, *map(tuple, group))  # equal for parts of one function

    @property
    def function(self) -> casadi.Function:
        """The function of what is read, stacked."""
        return self._trace.part(self._taken, self._makes)

    def evaluator(
        self, scalar: type, name: Callable[[], str], number: int | None = None
    ) -> Callable[[Sequence[NDArray]], NDArray]:
        """Evaluates the output of that number, or all of them, stacked."""
        makes = self._makes if number is None else [self._makes[number]]
        return self._trace.evaluator(self._taken, makes, scalar, name)


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
    made = TracedBlock._evaluated  # and not what a class below makes of outputs
    return lambda context, value: value.set_value(made(block(), context, k).copy())


def _calc(block: Callable[[], Any], name: str) -> Callable[[Context, BasicVector], None]:
    return lambda context, output: output.SetFromVector(block()._evaluated(context, name))
