"""The signals of a run while it goes on: in memory, and in temporary files once they are many."""

import contextlib
import fcntl
import math
import mmap
import os
import shutil
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary, finalize

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import (
    Context,
    Diagram,
    DiagramBuilder,
    OutputPort,
    PortDataType,
    System,
    TriggerType,
    ValueProducer,
)
from pydrake.systems.primitives import LogVectorOutput, Multiplexer, VectorLog

from drake_nonstop.blocks.sample_and_hold import SampleAndHold
from drake_nonstop.diagrams.nonstop import BOXES, SIGNALS
from drake_nonstop.mechanics.signal_layouts import HELD, Entry, Layout, by_name, numbered_entries
from drake_nonstop.mechanics.signals import (
    LOAD_REFERENCE_SIZE,
    LOAD_STATE_SIZE,
    PARAMETERS_SIZE,
    SIGNAL_PERIOD,
)
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.simulation.monitor import AT_SAMPLE, other_instants
from drake_nonstop.simulation.run import WALL_TIME
from drake_nonstop.systems.block import LOOP, LeafBlock, title
from drake_nonstop.systems.wiring import (
    maker_of,
    nested,
    optional_inputs,
    require_open,
    require_signals,
)
from drake_nonstop.validation import ScenarioError, require

MEMORY_LIMIT = 32e6  # bytes of signals in memory; with more of them all go to files
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

AT_INSTANT = AT_SAMPLE * SIGNAL_PERIOD  # s, from a sample's time to what counts as its instant
_DOUBLE = 8  # bytes
_PREFIX = "drake-nonstop-run-"  # of the temporary folders' names
_LEAST_AGE = 60.0  # s, of an abandoned folder: a younger one may be about to be locked


class RecordingError(RuntimeError):
    """The temporary folder cannot take the signals of a run."""


class StoredSignals(Mapping[str, NDArray]):
    """The signals of a long run, by name, in temporary files.

    Each is mapped to memory when it is asked for, as an array that cannot be written to. The
    files are removed with the last such mapping of a run; an array stays valid without them.

    Args:
        folder: where the files are.
        files: file and shape of each signal.
        rest: what follows of each signal and could not be written.
    """

    def __init__(
        self,
        folder: "_TemporaryFolder",
        files: Mapping[str, tuple[Path, tuple[int, ...]]],
        rest: Mapping[str, NDArray],
    ):
        self._folder = folder
        self._files = files
        self._rest = rest
        # Each takes a file descriptor as long as it is used: one for a signal is enough.
        self._maps: WeakValueDictionary[str, mmap.mmap] = WeakValueDictionary()

    def __getitem__(self, name: str) -> NDArray:
        path, shape = self._files[name]
        mapped = self._maps.get(name)
        if mapped is None:
            with path.open("rb") as file:
                mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
            self._maps[name] = mapped
        stored = np.frombuffer(mapped, count=math.prod(shape)).reshape(shape)
        if not self._rest:
            return stored
        whole = np.concatenate([stored, self._rest[name]])
        whole.flags.writeable = False
        return whole

    def __iter__(self) -> Iterator[str]:
        return iter(self._files)

    def __len__(self) -> int:
        return len(self._files)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickles and deep copies are dictionaries of arrays in memory."""
        return dict, ({name: np.array(values) for name, values in self.items()},)


class LogSignals:
    """The logs of a loop's signals: all at 100 Hz, and a few at every step.

    Each context has logs of its own, as with Drake's `LogVectorOutput`: `Run.from_logs` makes a run
    of those of a context. The integrator's steps end at the instants of the samples. All signals
    are in memory, some 0.3 MB for a second of flight; a run of `simulate` may be in files instead.
    `AddToBuilder` makes them.

    Attributes:
        nonstop: the diagram whose signals they are.
        entries: what the columns of the signals are, by their names "block.port".
    """

    def __init__(self, builder: DiagramBuilder, nonstop: Diagram):
        sampled, stepped = _recorded_ports(nonstop)
        self.nonstop = nonstop
        self._steps = _Log(builder, stepped, TriggerType.kPerStep)
        sizes = {name: port.size() for name, port in sampled.items()}
        self._samples = builder.AddSystem(_SampledLog(sizes, control_period_of(nonstop)))
        builder.Connect(_multiplexed(builder, sampled), self._samples.get_input_port())
        self._signal_names = _signal_names(nonstop, sampled)
        self.entries = _entries(nonstop, sampled, self._signal_names)
        self._step_names = {STEP_TIME: _Log.TIMES} | {name: name for name in stepped}

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

    def collect(
        self, context: Context
    ) -> tuple[NDArray, Mapping[str, NDArray], Mapping[str, NDArray]]:
        """The fields `time`, `signals` and `steps` of a `Run`, since time was set back last.

        Args:
            context: of the whole diagram, such as a Simulator's.

        Raises:
            ScenarioError: there is nothing in the logs of the context, or it is another one's.
        """
        try:
            self._samples.GetMyContextFromRoot(context)
        except (RuntimeError, TypeError):
            raise ScenarioError(
                f"context = {type(context).__name__} of another diagram: give that of the whole "
                "diagram with the logs, such as simulator.get_context()"
            ) from None
        samples = _last_flight(self._samples.columns(context))
        steps = _last_flight(_columns(self._steps.sizes, self._steps.log_of(context)))
        times = samples[_Log.TIMES]
        remedy = "advance a Simulator with this context first"
        require(len(times) > 0, "logs", "no samples", remedy)
        instants = np.round(times / SIGNAL_PERIOD)
        is_instant = np.abs(times - SIGNAL_PERIOD * instants) < AT_INSTANT
        return (
            np.where(is_instant, SIGNAL_PERIOD * instants, times),
            {name: samples[port] for name, port in self._signal_names.items()},
            {name: steps[port] for name, port in self._step_names.items()},
        )


class _Rows:
    """Values of a port and their times, as a `VectorLog` has them."""

    def __init__(self) -> None:
        self._times: list[float] = []
        self._values: list[NDArray] = []

    def add(self, time: float, values: NDArray) -> None:
        self._times.append(time)
        self._values.append(values.copy())

    def num_samples(self) -> int:
        return len(self._times)

    def sample_times(self) -> NDArray:
        return np.array(self._times)

    def data(self) -> NDArray:
        """(size, samples)."""
        return np.array(self._values).T


class _SampledLog(LeafBlock):
    """A log of some ports at the start and at the signals' instants, which each context has.

    Those among them at which the controllers sample are theirs to the last bit, see
    `other_instants`.

    Args:
        sizes: of the ports, by their names.
        control_period: s, of the controllers; 0: they have no samples.
    """

    def __init__(self, sizes: Mapping[str, int], control_period: float):
        super().__init__()
        self._sizes = sizes
        self._values = self.DeclareVectorInputPort("values", sum(sizes.values()))
        self._rows = self.DeclareCacheEntry(
            description="rows",
            value_producer=ValueProducer(
                allocate=lambda: AbstractValue.Make(_Rows()), calc=ValueProducer.NoopCalc
            ),
            prerequisites_of_calc={self.nothing_ticket()},
        ).cache_index()
        self.DeclareInitializationPublishEvent(self._publish)
        period, offsets = other_instants(control_period)
        for offset in offsets:
            self.DeclarePeriodicPublishEvent(period, offset, self._publish)
        if (period, offsets) != (SIGNAL_PERIOD, [SIGNAL_PERIOD]):
            self.DeclarePeriodicPublishEvent(control_period, control_period, self._publish_instant)

    def _publish_instant(self, context: Context) -> None:
        """At a sample of the controllers, which may be none of the signals' instants."""
        samples = context.get_time() / SIGNAL_PERIOD
        if abs(samples - round(samples)) < AT_SAMPLE:
            self._publish(context)

    def _publish(self, context: Context) -> None:
        self._of(context).add(context.get_time(), self._values.Eval(context))

    def _of(self, context: Context) -> _Rows:
        entry = self.get_cache_entry(self._rows).get_mutable_cache_entry_value(context)
        rows: _Rows = entry.GetMutableValueOrThrow()
        return rows

    def columns(self, context: Context) -> dict[str, NDArray]:
        """The rows, by the ports' names, in a context of the whole diagram."""
        return _columns(self._sizes, self._of(self.GetMyContextFromRoot(context)))


def control_period_of(nonstop: Diagram) -> float:
    """That of the controllers in a loop, s; 0 where none is known."""
    holds = (s for s in nested(nonstop, RUN_SIGNALS)[-1].GetSystems() if type(s) is SampleAndHold)
    return next((hold.period for hold in holds), 0.0)


def _multiplexed(builder: DiagramBuilder, ports: Mapping[str, OutputPort]) -> OutputPort:
    """One port of all: a sink per signal would slow every step of the diagram down."""
    multiplexer = builder.AddSystem(Multiplexer([port.size() for port in ports.values()]))
    for i, port in enumerate(ports.values()):
        builder.Connect(port, multiplexer.get_input_port(i))
    return multiplexer.get_output_port()


def _columns(sizes: Mapping[str, int], log: "VectorLog | _Rows") -> dict[str, NDArray]:
    """The rows of a log in memory, by the ports' names."""
    rows = log.data().T if log.num_samples() > 0 else np.zeros((0, sum(sizes.values())))
    columns = {name: part.copy() for name, part in by_name(sizes, rows).items()}
    return {_Log.TIMES: log.sample_times().copy()} | columns


def _makers(nonstop: Diagram, sampled: Mapping[str, OutputPort]) -> dict[str, System]:
    """The blocks that make the signals of ports, by the ports' names."""
    *_, loop = nested(nonstop, RUN_SIGNALS) if all(s in sampled for s in RUN_SIGNALS) else [nonstop]
    return {port: maker_of(loop if loop.HasOutputPort(port) else nonstop, port) for port in sampled}


def _signal_names(nonstop: Diagram, sampled: Mapping[str, OutputPort]) -> dict[str, str]:
    """The ports of a diagram by their names "block.port", with the block that makes the signal."""
    names = {}
    for port, maker in _makers(nonstop, sampled).items():
        names[f"{title(maker).replace('.', '_')}.{port}"] = port
    return names


def _entries(
    nonstop: Diagram, sampled: Mapping[str, OutputPort], names: Mapping[str, str]
) -> dict[str, tuple[Entry, ...]]:
    """What the columns of the signals are, by the names "block.port".

    A block's own `signal_layouts` come first, then the layouts of the figure's signals.
    """
    makers = _makers(nonstop, sampled)
    found = {}
    for name, port in names.items():
        own = getattr(makers[port], "signal_layouts", {}).get(port)
        layout, size = own or SIGNALS.get(port.removeprefix(HELD)), sampled[port].size()
        entries = layout.entries(port, size) if isinstance(layout, Layout) else None
        found[name] = entries or numbered_entries(port, size)
    return found


def _last_flight(columns: dict[str, NDArray]) -> dict[str, NDArray]:
    """The rows since time was set back last; of those of one instant the last."""
    times = columns[_Log.TIMES]
    changes = np.diff(times)
    start = np.flatnonzero(changes < 0)[-1] + 1 if np.any(changes < 0) else 0
    kept = np.append(changes != 0, True)[: len(times)]
    kept[:start] = False
    return {name: values[kept] for name, values in columns.items()}


class Recording:
    """The logs of a long run, which go to files: of one context, sampled when that is asked for.

    Signals that are `recorded_where_read` are not among them where no block reads them.

    Args:
        builder: has the diagram already; the logs are added to it.
        nonstop: the diagram, as `make_nonstop` builds it.

    Attributes:
        sampled: the names of the diagram's ports that are recorded at 100 Hz.
        stepped: likewise, at every step.
    """

    def __init__(self, builder: DiagramBuilder, nonstop: Diagram):
        sampled, stepped = _recorded_ports(nonstop)
        self.nonstop = nonstop
        self.sampled, self.stepped = [*sampled], [*stepped]
        self._steps = _Log(builder, stepped, TriggerType.kPerStep)
        self._samples = _Log(builder, sampled, TriggerType.kForced)
        self._signal_names = _signal_names(nonstop, sampled)
        self.entries = _entries(nonstop, sampled, self._signal_names)
        self._step_names = {STEP_TIME: _Log.TIMES} | {name: name for name in stepped}
        self._folder: _TemporaryFolder | None = None
        self._is_full = False  # the folder

    def start(self, context: Context) -> None:
        """To be called before the run, with the context of what the builder built."""
        self._samples.start(context)
        self._steps.start(context)

    def take_sample(self) -> None:
        """Takes a sample of all signals.

        Raises:
            RecordingError: the temporary folder cannot take them.
        """
        self._samples.publish()
        self._store_many()

    def add(
        self,
        times: Sequence[float] | NDArray,
        samples: NDArray,
        step_times: Sequence[float] | NDArray,
        steps: NDArray,
    ) -> None:
        """Adds rows that no Simulator publishes: those of `sampled`, and those of `stepped`.

        Rows that are no sample, where the control period is shorter than the signals', are left
        out.

        Args:
            times: (k,), s, of the samples.
            samples: (k, size).
            step_times: (j,), s, of the steps.
            steps: (j, size).

        Raises:
            RecordingError: the temporary folder cannot take them.
        """
        kept: list[int] = []
        count = self._samples.rows
        for k, instant in enumerate(times):
            if instant > (count + len(kept) - AT_SAMPLE) * SIGNAL_PERIOD:
                kept.append(k)
        self._samples.add(np.asarray(times)[kept], samples[kept])
        self._steps.add(np.asarray(step_times), steps)
        self._store_many()

    @property
    def has_steps(self) -> bool:
        """Whether a step has been recorded."""
        return self._steps.rows > 0

    def drop_last_step(self) -> None:
        """Drops the last row of `stepped`, which a Simulator that goes on publishes again."""
        self._steps.drop_last()

    def _store_many(self) -> None:
        """Moves the signals to files where they are many."""
        if self._samples.memory + self._steps.memory > MEMORY_LIMIT:
            try:
                self._store()
            except OSError as error:
                raise RecordingError(
                    f"the temporary folder {tempfile.gettempdir()} cannot take the signals "
                    f"({error.strerror}): set TMPDIR to a folder with more room, or give a "
                    "shorter simulation_duration"
                ) from None

    def collect(
        self, context: Context | None = None
    ) -> tuple[NDArray, Mapping[str, NDArray], Mapping[str, NDArray]]:
        """The fields `time`, `signals` and `steps` of a `Run`, of the context it started with."""
        if self._folder is not None and not self._is_full:
            with contextlib.suppress(OSError):  # what it cannot take stays in memory
                self._store()
        # Of their number, without the rounding of the events' times.
        times = SIGNAL_PERIOD * np.arange(self._samples.rows)
        return (
            times,
            self._samples.signals(self._signal_names, self._folder),
            self._steps.signals(self._step_names, self._folder),
        )

    def _store(self) -> None:
        """Moves what is in memory to the files."""
        try:
            if self._folder is None:
                self._folder = _TemporaryFolder()
            self._samples.store(self._folder.path / "samples")
            self._steps.store(self._folder.path / "steps")
        except OSError:
            self._is_full = True
            raise


class _Log:
    """A log of some ports: the first rows may be in files, one for each port, the others not."""

    TIMES = ""  # no port has this name

    def __init__(self, builder: DiagramBuilder, ports: dict[str, OutputPort], trigger: TriggerType):
        self.sizes = {name: port.size() for name, port in ports.items()}
        self._row_size = _row_size(ports)
        self._sink = LogVectorOutput(
            _multiplexed(builder, ports), builder, {trigger}, publish_period=0.0
        )
        self._log: VectorLog
        self._context: Context
        self._added: list[tuple[NDArray, NDArray]] = []  # times and rows that no Simulator made
        self._added_rows = 0
        self._stored = 0  # rows in files
        self._files: dict[str, Path] = {}

    def start(self, context: Context) -> None:
        self._context = self._sink.GetMyContextFromRoot(context)
        self._log = self.log_of(context)

    def log_of(self, context: Context) -> VectorLog:
        """The log of the context of the whole diagram."""
        return self._sink.FindLog(context)

    def publish(self) -> None:
        self._sink.ForcedPublish(self._context)

    def add(self, times: NDArray, rows: NDArray) -> None:
        """Adds rows that come before those of a Simulator."""
        if len(times):
            self._added.append((times, rows))
            self._added_rows += len(times)

    def drop_last(self) -> None:
        """Drops the last of the rows that were added."""
        if not self._added:
            self._stored -= 1  # it is in the files, which are cut there
            return
        times, rows = self._added.pop()
        self._added_rows -= len(times)
        self.add(times[:-1], rows[:-1])

    @property
    def memory(self) -> int:
        """Bytes of signals in memory."""
        return self._rows_in_memory * self._row_size

    @property
    def _rows_in_memory(self) -> int:
        return self._added_rows + self._log.num_samples()

    @property
    def rows(self) -> int:
        return self._stored + self._rows_in_memory

    def _columns(self) -> dict[str, NDArray]:
        """The rows in memory, by the ports' names."""
        logged = _columns(self.sizes, self._log)
        if not self._added:
            return logged
        times, rows = (np.concatenate(parts) for parts in zip(*self._added, strict=True))
        added = {self.TIMES: times} | by_name(self.sizes, rows)
        return {name: np.concatenate([added[name], values]) for name, values in logged.items()}

    def store(self, folder: Path) -> None:
        """Appends the rows in memory to the files in a folder, or none of them at an error."""
        folder.mkdir(exist_ok=True)
        columns = self._columns()
        rows = len(columns[self.TIMES])
        for i, (name, values) in enumerate(columns.items()):
            self._files[name] = folder / str(i)
            with self._files[name].open("ab") as file:
                # An earlier try may have failed half-way.
                file.truncate(self._stored * _DOUBLE * math.prod(values.shape[1:]))
                file.write(values.data)
        self._stored += rows
        self._added, self._added_rows = [], 0
        self._log.Clear()

    def signals(
        self, names: Mapping[str, str], folder: "_TemporaryFolder | None"
    ) -> Mapping[str, NDArray]:
        """All rows, (rows, size) of each port and (rows,) of the times.

        Args:
            names: of the ports, by the names of the signals.
            folder: what `store` was given a folder in.
        """
        columns = self._columns()
        in_memory = {name: columns[port] for name, port in names.items()}
        if folder is None or self._stored == 0:
            return in_memory
        files = {
            name: (self._files[port], (self._stored, *columns[port].shape[1:]))
            for name, port in names.items()
        }
        return StoredSignals(folder, files, in_memory if self._rows_in_memory else {})


class _TemporaryFolder:
    """A folder that is removed with this object.

    The folder of a process that was killed is removed by a later one: a folder whose process
    lives is locked.
    """

    def __init__(self) -> None:
        _remove_abandoned()
        self.path = Path(tempfile.mkdtemp(prefix=_PREFIX))
        lock = os.open(self.path, os.O_RDONLY)
        with contextlib.suppress(OSError):  # not all file systems have locks
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        finalize(self, _remove, self.path, lock, os.getpid())


def _remove(folder: Path, lock: int, process: int) -> None:
    if os.getpid() == process:  # and not a fork of it
        shutil.rmtree(folder, ignore_errors=True)
        os.close(lock)


def _remove_abandoned() -> None:
    """Removes this user's folders of processes that are no more."""
    for folder in Path(tempfile.gettempdir()).glob(f"{_PREFIX}*"):
        with contextlib.suppress(OSError):  # it is another user's, or locked, or gone
            status = folder.lstat()
            if status.st_uid != os.getuid() or time.time() - status.st_mtime < _LEAST_AGE:
                continue
            lock = os.open(folder, os.O_RDONLY | os.O_NOFOLLOW)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(folder)
            finally:
                os.close(lock)


def expected_size(nonstop: Diagram, scenario: Scenario) -> float:
    """About how many bytes the signals of a run take.

    Error-controlled steps may be shorter, and their signals more.

    Args:
        nonstop: the scenario's diagram, as `make_nonstop` builds it.
        scenario: what is to be run.
    """
    step = scenario.simulator_config.max_step_size
    sampled, stepped = _recorded_ports(nonstop)
    return scenario.simulation_duration * (
        _row_size(sampled) / SIGNAL_PERIOD + _row_size(stepped) / min(step, SIGNAL_PERIOD)
    )


def least_size(scenario: Scenario) -> float:
    """Bytes that the results of a run take at least: about half its signals, as compressed.

    It is known before there is a diagram: what loops of the default blocks export is counted.
    """
    columns = 140 + 35 * len(scenario.system.attachments)
    return scenario.simulation_duration / SIGNAL_PERIOD * columns * _DOUBLE / 2


def require_room(nonstop: Diagram, scenario: Scenario) -> None:
    """Checks that the temporary folder has room for the signals of a run that needs it.

    Args:
        nonstop: the scenario's diagram, as `make_nonstop` builds it.
        scenario: what is to be run.

    Raises:
        ScenarioError: it does not.
    """
    size = expected_size(nonstop, scenario)
    room = shutil.disk_usage(tempfile.gettempdir()).free
    longest = (
        0.9 * max(room, MEMORY_LIMIT) / (size / scenario.simulation_duration)
    )  # s; 0.9: it is rounded
    require(
        size <= max(room, MEMORY_LIMIT),
        "simulation_duration",
        f"{scenario.simulation_duration:g}",
        f"give at most {longest:.2g} s, or set TMPDIR to a folder with more room: the signals take "
        f"{size / 1e9:.3g} GB, and {tempfile.gettempdir()} has {room / 1e9:.3g} GB left",
    )


def _recorded_ports(nonstop: Diagram) -> tuple[dict[str, OutputPort], dict[str, OutputPort]]:
    """The ports, by name, that are recorded at 100 Hz and at every step."""
    is_loop = all(map(nonstop.HasOutputPort, RUN_SIGNALS))
    loops = nested(nonstop, RUN_SIGNALS) if is_loop else [nonstop]
    optional = {block: optional_inputs(block) for loop in loops for block in loop.GetSystems()}
    read = {
        source.get_output_port(index).get_name()
        for loop in loops
        for (reader, at), (source, index) in loop.connection_map().items()
        if reader.get_input_port(at).get_name() not in optional[reader]
    }
    if_read = {name for box in BOXES.values() for name in box.recorded_where_read}
    if_read |= {f"{HELD}{name}" for name in if_read}
    outputs = [nonstop.get_output_port(i) for i in range(nonstop.num_output_ports())]
    ports = {
        port.get_name(): port
        for port in outputs
        if port.get_data_type() == PortDataType.kVectorValued
        and port.get_name() not in if_read - read
    }
    return (
        {name: port for name, port in ports.items() if name != WALL_TIME},
        {name: port for name, port in ports.items() if name in EVERY_STEP},
    )


def recorded_sizes(nonstop: Diagram) -> tuple[dict[str, int], dict[str, int]]:
    """The sizes of the signals of a run, by "block.port", and of its steps, by their ports."""
    sampled, stepped = _recorded_ports(nonstop)
    names = _signal_names(nonstop, sampled)
    return (
        {name: sampled[port].size() for name, port in names.items()},
        {name: port.size() for name, port in stepped.items()},
    )


def _row_size(ports: Mapping[str, OutputPort]) -> int:
    """Bytes of an instant's values, and of its time."""
    return _DOUBLE * (1 + sum(port.size() for port in ports.values()))
