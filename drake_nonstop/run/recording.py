"""Which signals of a run are recorded, and what records them while it goes on."""

import math
import os
import tempfile
from collections.abc import Mapping
from typing import IO, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import (
    Context,
    Diagram,
    DiagramBuilder,
    OutputPort,
    PortDataType,
    ValueProducer,
)
from pydrake.systems.primitives import Multiplexer

from drake_nonstop.blocks.sample_and_hold import SampleAndHold
from drake_nonstop.diagrams.nonstop import BOXES, SIGNALS
from drake_nonstop.mechanics.signal_layouts import Entry, Layout, by_name, numbered_entries
from drake_nonstop.mechanics.signals import (
    HELD,
    LOAD_REFERENCE_SIZE,
    LOAD_STATE_SIZE,
    PARAMETERS_SIZE,
    SAMPLED,
    SIGNAL_PERIOD,
)
from drake_nonstop.run.monitor import AT_INSTANT, SampleInstants, at_instant
from drake_nonstop.run.run import WALL_TIME
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.systems.block import LOOP, LeafBlock, title
from drake_nonstop.systems.wiring import (
    loop_in,
    optional_inputs,
    require_open,
    require_signals,
    source_of,
    systems_in,
)
from drake_nonstop.validation import ScenarioError, require

MEMORY_LIMIT = 32e6  # bytes of a table in memory; with more of them it goes to a file
_FIRST_ROWS = 16  # that there is room for
STEP_TIME = "time"  # the name of the steps' times

# What the metrics judge by the step, and where the optimization layer's updates show.
EVERY_STEP = (
    "load_state",
    "carrier_state",
    "aircraft_state",
    "tensions",
    "command_saturation",
    "diagnostics",
    "missed_limits",
    "speed_bound",
    WALL_TIME,
)

# What metrics and figures need of a run, with sizes; None: of any number of carriers.
RUN_SIGNALS = {
    "load_state": LOAD_STATE_SIZE,
    "reference": LOAD_REFERENCE_SIZE,
    "carrier_state": None,
    "tensions": None,
    "parameters": PARAMETERS_SIZE,
}

DOUBLE = 8  # bytes

Sizes = tuple[dict[str, int], dict[str, int]]  # of what is recorded: signals, and at every step


class RecordingError(RuntimeError):
    """The temporary folder cannot take the signals of a run."""


class Rows:
    """A table of times and values that grows, in memory, or beyond a limit in a file mapped to it.

    The file has no name: it is gone with the last array that is mapped to it, and with the process,
    however that ends.

    Args:
        sizes: of what the values are, by their names.
        limit: bytes in memory.
    """

    TIMES = ""  # no port has this name

    def __init__(self, sizes: Mapping[str, int], limit: float):
        self._sizes, self._limit = {self.TIMES: 1, **sizes}, limit
        self._clear()

    def _clear(self) -> None:
        self._table = np.zeros((_FIRST_ROWS, sum(self._sizes.values())))
        self._file: IO[bytes] | None = None
        self._count = 0

    @property
    def last_time(self) -> float:
        """Of the rows, s."""
        return float(self._table[self._count - 1, 0]) if self._count else -math.inf

    def add(self, times: NDArray, values: NDArray) -> None:
        """Adds times (k,), s, and their values (k, size).

        A row at the time of the last one replaces it; at one before that another flight begins.
        There is room for them.
        """
        if not len(times):
            return
        if times[0] < self.last_time:
            self._clear()
            self.make_room(len(times))
        first = self._count - int(times[0] == self.last_time)
        end = first + len(times)
        self._table[first:end, 0], self._table[first:end, 1:] = times, values
        self._count = end

    def make_room(self, count: int) -> None:
        """Makes room for so many rows more.

        Raises:
            RecordingError: the temporary folder has none.
        """
        if self._count + count <= len(self._table):
            return
        shape = max(self._count + count, 2 * len(self._table)), self._table.shape[1]
        size, flown = DOUBLE * math.prod(shape), self._table[: self._count]
        if self._file is None and size <= self._limit:
            self._table = np.zeros(shape)
            self._table[: self._count] = flown
            return
        try:
            file = self._file or tempfile.TemporaryFile()  # noqa: SIM115 - it stays open
            _reserve(file, size)  # no full disk comes between the next rows and the file
        except OSError as error:
            raise RecordingError(
                f"the temporary folder {tempfile.gettempdir()} cannot take the signals "
                f"({error.strerror}): set TMPDIR to a folder with more room, or give a "
                "shorter simulation_duration"
            ) from None
        self._table = np.memmap(file, float, "r+", shape=shape)
        if self._file is None:
            self._table[: self._count] = flown
        self._file = file

    def columns(self) -> dict[str, NDArray]:
        """The rows, (rows, size) by each name and (rows,) of the times: views to be read only."""
        rows = self._table[: self._count]
        rows = rows.copy() if self._file is None else np.asarray(rows)
        rows.flags.writeable = False
        parts = by_name(self._sizes, rows)
        return parts | {self.TIMES: parts[self.TIMES][:, 0]}


def _reserve(file: IO[bytes], size: int) -> None:
    """Has a file take so many bytes of the disk; raises OSError where it has no room."""
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(file.fileno(), 0, size)
    else:  # macOS
        file.seek(0, os.SEEK_END)
        file.write(bytes(size - file.tell()))
        file.flush()


class Logged(NamedTuple):
    """Log of a context: `samples` of all signals, and a few at all `steps`."""

    samples: Rows
    steps: Rows

    def add(self, times: NDArray, samples: NDArray, step_times: NDArray, steps: NDArray) -> None:
        """Adds samples (k, size) at times (k,), s, and steps (j, size) at theirs.

        Raises:
            RecordingError: the temporary folder has no room for them; none are added.
        """
        self.samples.make_room(len(times))
        self.steps.make_room(len(step_times))
        self.samples.add(times, samples)
        self.steps.add(step_times, steps)


class _Log(LeafBlock):
    """What is `Logged` of each context, with the start and the first step to each instant.

    Args:
        sizes: of the samples and of the steps.
        limit: as of `Rows`.
    """

    def __init__(self, sizes: Sizes, limit: float):
        super().__init__()
        self._samples, self._steps = (
            self.DeclareVectorInputPort(name, sum(part.values()))
            for name, part in zip(("samples", "steps"), sizes, strict=True)
        )
        self._rows = self.DeclareCacheEntry(
            description="rows",
            value_producer=ValueProducer(
                allocate=lambda: AbstractValue.Make(Logged(*(Rows(part, limit) for part in sizes))),
                calc=ValueProducer.NoopCalc,
            ),
            prerequisites_of_calc={self.nothing_ticket()},
        ).cache_index()
        self.DeclareInitializationPublishEvent(self._publish_start)
        self.DeclarePerStepPublishEvent(self._publish)

    def _publish_start(self, context: Context) -> None:
        time = np.array([context.get_time()])
        samples = self._in(context).samples
        samples.make_room(1)
        samples.add(time, self._samples.Eval(context))

    def _publish(self, context: Context) -> None:
        rows, time = self._in(context), context.get_time()
        is_sample = at_instant(time) and abs(time - rows.samples.last_time) >= AT_INSTANT
        times = np.array([time])
        samples = self._samples.Eval(context) if is_sample else times
        rows.add(times[: int(is_sample)], samples, times, self._steps.Eval(context))

    def rows(self, context: Context) -> Logged:
        """Values in a context of the whole diagram."""
        return self._in(self.GetMyContextFromRoot(context))

    def _in(self, context: Context) -> Logged:
        entry = self.get_cache_entry(self._rows).get_mutable_cache_entry_value(context)
        rows: Logged = entry.GetMutableValueOrThrow()
        return rows


class LogSignals:
    """The logs of a loop's signals: all at 100 Hz, and a few at every step of the integrator.

    Each context has logs of its own, as with Drake's `LogVectorOutput`: `Run.from_logs` makes a run
    of those of a context. The integrator's steps end at the instants of the samples. All signals
    are in memory, some 0.3 MB for a second of flight; a run of `simulate` may be in files instead.
    Signals that are `recorded_where_read` are not among them where no block reads them.
    `AddToBuilder` makes them.

    Attributes:
        nonstop: the diagram whose signals they are.
        entries: names, units and frames of the signals' columns, by "block.port".
        sampled: the names of the diagram's ports that are recorded at 100 Hz.
        stepped: the names of those that are recorded at every step.
        sizes: of the signals, by "block.port", and of the steps, by their ports.
    """

    def __init__(self, builder: DiagramBuilder, nonstop: Diagram, uses_files: bool = False):
        sampled, stepped = _recorded_ports(nonstop)
        self.nonstop = nonstop
        self.sampled, self.stepped = [*sampled], [*stepped]
        names, self.entries = _names_and_entries(nonstop, sampled)
        self.sizes = _sizes(names, sampled, stepped)
        log = _Log(self.sizes, MEMORY_LIMIT if uses_files else math.inf)
        self._log = builder.AddSystem(log)
        # One input for all of them, since one for each would slow every step down.
        for i, ports in enumerate((sampled.values(), stepped.values())):
            multiplexer = builder.AddSystem(Multiplexer([port.size() for port in ports]))
            for k, port in enumerate(ports):
                builder.Connect(port, multiplexer.get_input_port(k))
            builder.Connect(multiplexer.get_output_port(), self._log.get_input_port(i))
        builder.AddSystem(SampleInstants(control_period_of(nonstop)))

    @staticmethod
    def AddToBuilder(builder: DiagramBuilder, nonstop: Diagram) -> "LogSignals":  # noqa: N802
        """Adds the logs beside a loop, connected to the signals that it exports.

        Args:
            builder: has the loop's diagram already.
            nonstop: the diagram; it exports its signals, as one by `make_nonstop` or
                `connect_by_name` does, at least `load_state`, `reference`, `carrier_state`,
                `tensions` and `parameters`.

        Raises:
            ScenarioError: it does not export these, or is not in the builder, or that is built.
        """
        require_open(builder, "LogSignals.AddToBuilder")
        require(isinstance(nonstop, Diagram), "LogSignals", nonstop, "give a loop's diagram")
        require_signals(nonstop, RUN_SIGNALS, "LogSignals")
        remedy = "add it to the builder first, builder.AddSystem(...), and give what that returns"
        is_there = any(system is nonstop for system in builder.GetSystems())
        require(is_there, "LogSignals", nonstop.get_name() or "a diagram", remedy)
        if "@" in nonstop.get_name() and not builder.HasSubsystemNamed(LOOP):
            nonstop.set_name(LOOP)  # which errors look for, and not where it is in memory
        return LogSignals(builder, nonstop)

    def rows(self, context: Context) -> Logged:
        """Log of a context of the whole diagram."""
        return self._log.rows(context)

    def collect(self, context: Context) -> tuple[NDArray, dict[str, NDArray], dict[str, NDArray]]:
        """The fields `time`, `signals` and `steps` of a `Run`, since time was set back last.

        Args:
            context: of the whole diagram, such as a Simulator's.

        Raises:
            ScenarioError: it is the context of another diagram.
        """
        try:
            rows = self.rows(context)
        except (RuntimeError, TypeError):
            raise ScenarioError(
                f"context = {type(context).__name__} of another diagram: give that of the whole "
                "diagram with the logs, such as simulator.get_context()"
            ) from None
        samples, steps = rows.samples.columns(), rows.steps.columns()
        times = samples.pop(Rows.TIMES)
        # Without the rounding of the events' times.
        instants = SIGNAL_PERIOD * np.round(times / SIGNAL_PERIOD)
        times = np.where(at_instant(times), instants, times)
        return times, samples, {STEP_TIME: steps.pop(Rows.TIMES), **steps}


def control_period_of(nonstop: Diagram) -> float:
    """That of the controllers in a loop, s; 0 where none is known."""
    holds = (s for s in loop_in(nonstop, RUN_SIGNALS).GetSystems() if type(s) is SampleAndHold)
    return next((hold.sample_period for hold in holds), 0.0)


def _names_and_entries(
    nonstop: Diagram, sampled: Mapping[str, OutputPort]
) -> tuple[dict[str, str], dict[str, tuple[Entry, ...]]]:
    """Ports by their names "block.port", with the block that makes the signal, and their columns.

    A block's own `signal_layouts` come first, then the layouts of the figure's signals.
    """
    loop = loop_in(nonstop, RUN_SIGNALS)
    names, found = {}, {}
    for port, output in sampled.items():
        exporting = loop if loop.HasOutputPort(port) else nonstop
        maker = source_of(exporting.GetOutputPort(port)).get_system()
        name, size = f"{title(maker).replace('.', '_')}.{port}", output.size()
        own = getattr(maker, "signal_layouts", {}).get(port)
        layout = own or SIGNALS.get(port.removeprefix(HELD))
        entries = layout.entries(port, size) if isinstance(layout, Layout) else None
        names[name], found[name] = port, entries or numbered_entries(port, size)
    return names, found


def least_size(scenario: Scenario) -> float:
    """Bytes that the results of a run take at least: about half its signals, as compressed.

    It is known before there is a diagram: what loops of the default blocks export is counted.
    """
    columns = 140 + 35 * len(scenario.system.attachments)
    return scenario.simulation_duration / SIGNAL_PERIOD * columns * DOUBLE / 2


def _recorded_ports(nonstop: Diagram) -> tuple[dict[str, OutputPort], dict[str, OutputPort]]:
    """The ports, by name, that are recorded at 100 Hz and at every step."""
    loops = [system for system in systems_in(nonstop) if isinstance(system, Diagram)]
    optional = {block: optional_inputs(block) for loop in loops for block in loop.GetSystems()}
    read = {
        source.get_output_port(index).get_name()
        for loop in loops
        for (reader, at), (source, index) in loop.connection_map().items()
        if reader.get_input_port(at).get_name() not in optional[reader]
    }
    read = {name.removeprefix(SAMPLED) for name in read}
    if_read = {name for box in BOXES.values() for name in box.recorded_where_read}
    if_read |= {f"{HELD}{name}" for name in if_read}
    outputs = [nonstop.get_output_port(i) for i in range(nonstop.num_output_ports())]
    ports = {
        port.get_name(): port
        for port in outputs
        if port.get_data_type() == PortDataType.kVectorValued
        and port.get_name() not in if_read - read
        and not _is_of_samples(port.get_name())
    }
    return (
        {name: port for name, port in ports.items() if name != WALL_TIME},
        {name: port for name, port in ports.items() if name in EVERY_STEP},
    )


def _is_of_samples(name: str) -> bool:
    """Whether a signal is what sampled blocks read in place of another, which is recorded."""
    is_held = name.startswith(HELD) and name.removeprefix(HELD) not in SampleAndHold.reads
    return is_held or name.startswith(SAMPLED)


def _sizes(
    names: dict[str, str], sampled: dict[str, OutputPort], stepped: dict[str, OutputPort]
) -> Sizes:
    """Those of the signals of a run, by "block.port", and of its steps, by their ports."""
    return (
        {name: sampled[port].size() for name, port in names.items()},
        {name: port.size() for name, port in stepped.items()},
    )
