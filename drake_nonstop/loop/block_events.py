"""The events of blocks, held against the samples of a loop's controllers.

Of the events that a system declares, pydrake tells the timing of its discrete updates. All others
show when they come: the Simulator that steps a block counts them.
"""

from collections.abc import Callable, Collection, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import (
    Context,
    Diagram,
    LeafOutputPort,
    OutputPort,
    PortDataType,
    System,
)

from drake_nonstop.systems.block import is_of_package, title
from drake_nonstop.validation import ScenarioError

_INSTANTS = 1000  # of the samples, which a block's own are compared with
_DISCRETE = "a discrete update"


class NotCompilableError(ScenarioError):
    """A block does what it has not declared, or has events that a compiled loop does not fly."""

    def __init__(self, block: System, what: str):
        super().__init__(f"{title(block)} = {type(block).__name__}: {what}")


def sample_times(numbers: Any, period: float) -> Any:
    """The times of samples by their numbers, an array or one, s.

    To the bit as Drake has it of events that begin with a period.
    """
    return (period + (numbers - 1) * period) * (numbers > 0)


def timing_complaint(block: System, period: float, *, at_each: bool = False) -> str:
    """Reason why a block's discrete updates are not at samples, to the bit; empty: there is none.

    Two instants that differ by a rounding are two to Drake's Simulator, and either may be first.
    The period of the samples is in s; `at_each` asks for an update at each of them.
    """
    timing = block.GetUniquePeriodicDiscreteUpdateAttribute()
    if timing is None:
        return ""
    own, offset = timing.period_sec(), timing.offset_sec()
    samples = sample_times(np.arange(1, _INSTANTS + 1), period)
    updates = offset + own * np.arange(_INSTANTS)
    fits = np.isin(updates[updates <= samples[-1]], samples).all()
    if (own, offset) == (period, period) or (fits and not at_each):
        return ""
    return (
        f"it updates every {own:g} s from t = {offset:g} s on, to the last bit at other instants "
        f"than the controllers, every {period:g} s from t = {period:g} s on"
    )


class SteppedBlock:
    """A block that a Simulator of its own steps from sample to sample.

    Args:
        context: the block's own, with a value for each input.
        is_held: whether its outputs change at its updates only, as it declares. A user's own one is
            looked at for that; others are stepped for the sake of their events alone.
        may_update: whether it may have discrete updates, at samples and at the start.
    """

    def __init__(
        self, block: System, context: Context, *, is_held: bool = True, may_update: bool = True
    ):
        self._block = block
        self._simulator = Simulator(block, context)
        self._may_update = may_update
        self._watched: list[OutputPort] = []
        if is_held and not is_of_package(block):
            ports = map(block.get_output_port, range(block.num_output_ports()))
            self._watched = [p for p in ports if p.get_data_type() == PortDataType.kVectorValued]
        self._shown: list[NDArray] = []

    @property
    def context(self) -> Context:
        """That of the Simulator."""
        return self._simulator.get_mutable_context()

    def start(self) -> None:
        """Makes the updates of the initialization.

        Raises:
            NotCompilableError: there are other events, or an output depends on the time.
        """
        self.context.SetTime(0.0)  # of a flight that begins again
        self._do(self._simulator.Initialize, "at the start", may_update=True)
        self._do(self._simulator.AdvancePendingEvents, "at t = 0 or at each step")
        self._shown = self._outputs()
        for port in self._watched:
            if self._is_of_time(port):
                raise NotCompilableError(self._block, f"{port.get_name()} depends on the time")

    def require_declared(self, reads: Mapping[int, tuple[bool, Collection[int]]]) -> None:
        """Checks that a trace reads what its block's outputs are declared to depend on.

        Drake shows an old value where they depend on more. `reads` tells of an output, by its
        number, whether its trace reads the time, and the numbers of the inputs that it reads.

        Raises:
            NotCompilableError: it reads more.
        """
        for output, (of_time, inputs) in reads.items():
            port = self._block.get_output_port(output)
            fed = {k for k in inputs if self._block.HasDirectFeedthrough(k, output)}
            undeclared = [self._block.get_input_port(k).get_name() for k in {*inputs} - fed]
            undeclared += ["the time"] * (of_time and not self._is_of_time(port))
            if undeclared:
                what = f"{port.get_name()} is not declared to depend on {undeclared[0]}"
                raise NotCompilableError(self._block, what)

    def _is_of_time(self, port: OutputPort) -> bool:
        """Whether an output is declared to depend on the time."""
        ahead = self.context.Clone()
        port.Eval(ahead)
        ahead.SetTime(ahead.get_time() + 1.0)
        return _is_outdated(self._block, port, ahead)

    def advance_to(self, time: float) -> None:
        """Goes on to a sample, to before its updates.

        Raises:
            NotCompilableError: there are events on the way.
        """
        self._do(lambda: self._simulator.AdvanceTo(time), f"before the sample at t = {time:g} s")

    def watch_to(self, time: float) -> None:
        """Goes on over samples, with their updates, where it is not there yet.

        Raises:
            NotCompilableError: there are events of other kinds on the way.
        """
        if time > self.context.get_time():
            when = f"before t = {time:g} s"
            self._do(lambda: self._simulator.AdvanceTo(time), when, may_update=True)

    def update(self) -> None:
        """Makes the updates of a sample, with the inputs of that.

        Raises:
            NotCompilableError: an output has changed before them, or there are other events.
        """
        if self._watched:  # a value of the cache would hide what it depends on undeclared
            self.context.SetAllCacheEntriesOutOfDate()
        time = self.context.get_time()
        for port, before, now in zip(self._watched, self._shown, self._outputs(), strict=True):
            if not np.array_equal(before, now, equal_nan=True):
                what = f"{port.get_name()} changes without an update before t = {time:g} s"
                raise NotCompilableError(self._block, what)
        self._do(self._simulator.AdvancePendingEvents, f"at t = {time:g} s", may_update=True)
        self._shown = self._outputs()

    def _outputs(self) -> list[NDArray]:
        return [port.Eval(self.context).copy() for port in self._watched]

    def _do(self, step: Callable[[], Any], when: str, *, may_update: bool = False) -> None:
        before = self._counts()
        step()
        for kind, count in self._counts().items():
            is_flown = kind == _DISCRETE and may_update and self._may_update
            if count > before[kind] and not is_flown:
                what = f"it has {kind} {when}, which a compiled loop does not fly"
                raise NotCompilableError(self._block, what)

    def _counts(self) -> dict[str, int]:
        """How many events of each kind there were."""
        simulator = self._simulator
        return {
            _DISCRETE: simulator.get_num_discrete_updates(),
            "an unrestricted update": simulator.get_num_unrestricted_updates(),
            "a publish event": simulator.get_num_publishes(),
        }


def _is_outdated(system: System, port: OutputPort, context: Context) -> bool:
    """Whether a port's value in the cache is not what it shows."""
    while isinstance(system, Diagram):
        part, index = system.get_output_port_locator(port.get_index())
        context = system.GetSubsystemContext(part, context)
        system, port = part, part.get_output_port(index)
    return isinstance(port, LeafOutputPort) and port.cache_entry().is_out_of_date(context)
