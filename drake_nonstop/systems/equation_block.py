"""Drake systems of a block's equations, of any scalar type."""

import functools
import weakref
from collections.abc import Callable, Sequence
from contextvars import ContextVar
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydrake.autodiffutils import AutoDiffXd
from pydrake.common.value import Value
from pydrake.systems.framework import (
    BasicVector_,
    Context,
    ContinuousState,
    EventStatus,
    InputPort,
    LeafSystem,
    LeafSystem_,
    PortDataType,
    State_,
    ValueProducer,
)

from drake_nonstop.systems.block import LeafBlock, is_of_package, number, state_values, weakly
from drake_nonstop.systems.equations import (
    NUMBERS,
    START,
    STATE,
    TIME,
    Equations,
    Group,
    evaluated,
)
from drake_nonstop.systems.parameters import declare_parameters
from drake_nonstop.systems.tracing import LARGEST, Evaluator, NotFiniteError
from drake_nonstop.validation import require

IS_SOUGHT = ContextVar("is_sought", default=False)  # whether a start is looked for
_OURS = __name__.partition(".")[0], "pydrake"

_LARGE = 600  # operations of a group whose results are kept in the cache


class EquationBlock(LeafBlock):
    """A LeafSystem that computes what its `Equations` say.

    A sampled state steps every `period`, at once with those of all other blocks: Drake makes
    unrestricted updates together, before the discrete ones, which are those of layers.

    A layer has a method `answer(context)`, which returns the next state (s,) of a context of the
    block in which its inputs can be evaluated, such as by a search; outputs are equations of that
    state. It is asked at the initialization, and every some samples, after all other states have
    stepped. Where its equations make the next state, too, that steps at each sample.

    Args:
        equations: of the block; its names of inputs and outputs are those of the ports.
        sample_period: s, between the events of a sampled state, a whole part of its period.
        order: of the output ports, their names; None: those that show the state are the first.

    Attributes:
        equations_of_block: as given.
        every: the number of events of which one is a step.
        declares_besides: whether it declares events besides those of its equations.
        tell_start: a method of a context that warns of a start from which no flight begins.
    """

    answer: ClassVar[Callable[..., NDArray] | None] = None
    tell_start: ClassVar[Callable[..., None] | None] = None
    equations_of_block: Equations
    every: int = 1

    def __init__(
        self,
        equations: Equations,
        *,
        sample_period: float = 0.0,
        order: Sequence[str] | None = None,
    ):
        super().__init__()
        self.equations_of_block = own = equations
        self.sample_period = sample_period or own.period
        if own.period:
            self.every = max(1, round(own.period / self.sample_period))
        if len(own.parameters):
            self.parameters = own.parameters
            declare_parameters(self, own.parameters)
        self._inputs: dict[str, InputPort] = {
            name: self.DeclareVectorInputPort(name, size) for name, size in own.inputs.items()
        }
        self._states: list[Any] = []  # indices of discrete groups
        shown = self._declare_state() if len(own.state) else {}
        self._evaluators: dict[str, Callable[[Context], NDArray]] = {}
        self._wholes: dict[str, Callable[[Context], Sequence[NDArray]]] = {}
        self._tickets: dict[str, set[Any]] = {}
        for group in own.groups:
            self._add(group)
        made = own.outputs | dict({} if own.motion is None else own.motion.makes)
        for name in order or (*shown, *made):
            if name in shown:
                self.DeclareStateOutputPort(name, shown[name])
            else:
                calc = _calc(weakref.ref(self), name)
                self.DeclareVectorOutputPort(name, made[name], calc, self._tickets[name])
        if self.tell_start is not None and self.scalar is float:
            tell: Any = weakly(self.tell_start)
            self.DeclareInitializationPublishEvent(lambda c: None if IS_SOUGHT.get() else tell(c))
        self.declares_besides = False

    def _declare_state(self) -> dict[str, Any]:
        """Declares the state, and the events of its steps and its start.

        Returns the indices of what ports show of it, by their names.
        """
        own, vector = self.equations_of_block, BasicVector_[self.scalar]
        if not own.period:
            index = self.DeclareContinuousState(vector(own.state))
            shown = dict.fromkeys(own.shown, index)
        else:
            ends = [*np.cumsum([*own.shown.values()]).tolist()]
            parts = np.split(own.state, ends)
            self._states = [self.DeclareDiscreteState(vector(part)) for part in parts if len(part)]
            shown = dict(zip(own.shown, self._states, strict=False))
            period, ask = self.sample_period, type(self).asked
            if own.answers:
                self.DeclareInitializationDiscreteUpdateEvent(self._event(ask))
                step = self._event(ask, waits=True)
                self.DeclarePeriodicDiscreteUpdateEvent(period, period, step)
            if STATE in own.results:
                step = functools.partial(type(self).result, name=STATE)
                step = self._event(step, waits=not own.answers)
                self.DeclarePeriodicUnrestrictedUpdateEvent(period, period, step)
        if START in own.results:
            begin = self._event(functools.partial(type(self).result, name=START))
            if own.starts_first or not own.period:
                self.DeclareInitializationUnrestrictedUpdateEvent(begin)
            else:
                self.DeclareInitializationDiscreteUpdateEvent(begin)
        return shown

    # Evaluation in a context

    def _add(self, group: Group) -> None:
        """Makes what evaluates the results of a group, each by itself or all in a cache entry.

        To look into the cache takes as long as some hundred operations.
        """
        me: Any = weakref.ref(self)
        readers = [self._reader(name) for name in group.reads]
        tickets = set().union(*map(self._tickets_of, group.reads)) or {self.nothing_ticket()}
        if self.scalar is float:
            evaluator, box = Evaluator(group.function, len(group.makes)), weakly(self.box)

            def evaluate(context: Context) -> Sequence[NDArray]:
                return evaluator([read(context) for read in readers], box)

        else:

            def evaluate(context: Context) -> Sequence[NDArray]:
                values, own = [read(context) for read in readers], me()
                return evaluated(own.equations_of_block, group, values, own.scalar, own.box)

        motion = self.equations_of_block.motion
        is_large = len(group.makes) > 1 and group.function.n_instructions() > _LARGE
        if is_large or (motion is not None and not {*motion.reads}.isdisjoint(group.makes)):
            names = ", ".join(group.makes)
            self._wholes[names] = evaluate
            producer = ValueProducer(Value(()).Clone, _calc_whole(me, names))
            entry = self.DeclareCacheEntry(names, producer, tickets)
            index, tickets = entry.cache_index(), {entry.ticket()}  # the entry would hold the block

            def evaluate(context: Context) -> Sequence[NDArray]:
                return me().get_cache_entry(index).Eval(context)

        for k, name in enumerate(group.makes):
            self._tickets[name] = tickets
            self._evaluators[name] = functools.partial(_entry_of, evaluate, k)

    def _tickets_of(self, name: str) -> set[Any]:
        """What an argument of the equations depends on."""
        own = self.equations_of_block
        if name in own.outputs and name not in own.arguments:  # of a motion between samples
            return self._tickets[name]
        if name == STATE:
            return {self.all_state_ticket()}
        if name == NUMBERS:
            return {self.all_parameters_ticket()}
        if name == TIME or name in own.quantities:
            return {self.time_ticket()}
        return {self.input_port_ticket(self._inputs[name].get_index())}

    def _reader(self, name: str) -> Callable[[Context], NDArray]:
        """Function of a context for an argument of the equations."""
        own = self.equations_of_block
        if name in own.outputs and name not in own.arguments:
            return self._evaluators[name]
        if name in own.optional:
            return functools.partial(_input_or, self._inputs[name], own.optional[name])
        if name in self._inputs:
            return self._inputs[name].Eval
        if name == STATE:
            if not own.period:
                return _continuous_state_of
            return _discrete_state_of if len(self._states) == 1 else state_values
        if name == NUMBERS:
            return _parameters_of
        if name == TIME:
            return _time_of
        quantity = weakly(self._quantity)
        return lambda context: quantity(context, name)

    def _quantity(self, context: Context, name: str) -> NDArray:
        """A quantity at the time of a context; of other scalar types, with its rate."""
        time = context.get_time()
        if self.scalar is float:
            return self.quantity_at(name, time)
        now = np.array([number(time)])
        (values,), rates = self.precomputed_inputs([name], now), np.zeros((1, 1))
        if isinstance(time, AutoDiffXd) and np.any(time.derivatives()):
            (rates,) = self.precomputed_input_rates([name], now)
        return values[0] + rates[0] * (time - now[0])

    def quantity_at(self, name: str, time: float) -> NDArray:
        """A quantity (size,) at a time, s."""
        return self.precomputed_inputs([name], np.array([time]))[0][0]

    def precomputed_inputs(self, names: Sequence[str], times: NDArray) -> list[NDArray]:
        """Rows (k, size) of quantities at times (k,), s."""
        raise NotImplementedError(f"{type(self).__name__} has quantities, and does not make them")

    def precomputed_input_rates(self, names: Sequence[str], times: NDArray) -> list[NDArray]:
        """The rates of these rows; zeros, as of what is held."""
        return [0 * rows for rows in self.precomputed_inputs(names, times)]

    def result(self, context: Context, name: str) -> NDArray:
        """A result of the equations, or an output that they make, in a context of the block."""
        return self._evaluators[name](context)

    def is_due(self, context: Context) -> bool:
        """Whether the sample at the time of a context is one at which the block steps."""
        if self.every == 1:
            return True
        return round(number(context.get_time()) / self.sample_period) % self.every == 0

    @functools.cached_property
    def is_told_by_equations(self) -> bool:
        """Whether the equations make all ports, states, rates and events; once it is whole."""
        own, context = self.equations_of_block, self.CreateDefaultContext()
        ports = map(self.get_output_port, range(self.num_output_ports()))
        vectors = [p for p in ports if p.get_data_type() == PortDataType.kVectorValued]
        moved = {} if own.motion is None else own.motion.makes
        rates = type(self).DoCalcTimeDerivatives  # Drake's, where the block has none
        return not (
            (self.declares_besides and not is_of_package(self))
            or len(vectors) != len({**own.outputs, **own.shown, **moved})
            or len(state_values(context)) != len(own.state)
            or rates.__module__.partition(".")[0] not in _OURS
        )

    # Events

    def asked(self, context: Context) -> NDArray:
        """The answer to an event, flat.

        Raises:
            ScenarioError: it is not as large as the state.
            NotFiniteError: it is not finite, or is too large.
        """
        assert self.answer is not None
        answer = np.ravel(np.asarray(self.answer(context), float))
        size = len(self.equations_of_block.state)
        field, remedy = f"{self.box()}.answer", f"return the next state, {size} numbers"
        require(len(answer) == size, field, f"{len(answer)} numbers", remedy)
        if not np.all(np.abs(answer) < LARGEST):
            raise NotFiniteError(self.box())
        return answer

    def _event(self, make: Callable[[Any, Context], NDArray], *, waits: bool = False) -> Callable:
        """Function of an event: the state becomes what is made of the block and its context.

        Where it `waits`, only at samples at which the block steps.
        """
        me: Any = weakref.ref(self)

        def update(context: Context, state: Any) -> EventStatus:
            block = me()
            if waits and not block.is_due(context):
                return EventStatus.DidNothing()
            block._take(state, make(block, context))
            return EventStatus.Succeeded()

        return update

    def _take(self, state: Any, values: NDArray) -> None:
        """Sets the state, in a State or in its discrete part alone, to a flat array."""
        discrete, start = state, 0
        if isinstance(state, State_[self.scalar]):
            if not self._states:
                state.get_mutable_continuous_state().SetFromVector(values)
            discrete = state.get_mutable_discrete_state()
        for index in self._states:
            vector = discrete.get_mutable_vector(index)
            vector.SetFromVector(values[start : start + vector.size()])
            start += vector.size()


def _noted(name: str) -> Callable:
    """A Declare function of LeafSystem's that a block notes."""

    def declare(self: Any, *arguments: Any, **named: Any) -> Any:
        self.declares_besides = True
        return getattr(LeafSystem_[self.scalar], name)(self, *arguments, **named)

    return declare


for _name in dir(LeafSystem):
    if _name.startswith("Declare") and _name.endswith("Event") and "Publish" not in _name:
        setattr(EquationBlock, _name, _noted(_name))


def rates_in(block: Any, context: Context, derivatives: ContinuousState) -> None:
    """`DoCalcTimeDerivatives` of blocks with a state: asking others would take Drake 2 µs each."""
    if derivatives.size() > 0:
        derivatives.SetFromVector(block.result(context, STATE))


# What Drake calls refers to the block weakly: it would keep the block, and its diagram, alive.


def _calc(block: Callable[[], Any], name: str) -> Callable[[Context, Any], None]:
    return lambda context, output: output.SetFromVector(block().result(context, name))


def _calc_whole(block: Callable[[], Any], names: str) -> Callable:
    def calc(context: Context, value: Any) -> None:
        made = block()._wholes[names](context)
        value.set_value([values.copy() for values in made])

    return calc


def _entry_of(evaluate: Callable[[Context], Any], k: int, context: Context) -> NDArray:
    made: NDArray = evaluate(context)[k]
    return made


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
