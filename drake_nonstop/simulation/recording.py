"""The signals of a run while it goes on: in memory, and in temporary files once they are many."""

import contextlib
import fcntl
import math
import mmap
import os
import shutil
import tempfile
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary, finalize

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import (
    Context,
    Diagram,
    DiagramBuilder,
    OutputPort,
    PortDataType,
    TriggerType,
)
from pydrake.systems.primitives import LogVectorOutput, Multiplexer, VectorLog

from drake_nonstop.blocks.fused_plant import FusedPlant
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.simulation.run import SIGNAL_PERIOD
from drake_nonstop.systems.wiring import output_names
from drake_nonstop.validation import require

MEMORY_LIMIT = 32e6  # bytes of signals in memory; with more of them all go to files
WALL_TIME = "solve_time"  # differs from run to run: kept out of the samples
STEP_TIME = "time"  # the name of the steps' times

# What the metrics judge by the step, and where the optimization layer's updates show.
_EVERY_STEP = (
    "load_state",
    "carrier_state",
    "tensions",
    "diagnostics",
    "speed_bound",
    WALL_TIME,
)

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


class Recording:
    """The logs of a diagram's signals: all at 100 Hz, and a few at every step.

    Args:
        builder: has the diagram already; the logs are added to it.
        nonstop: the diagram, as `make_nonstop` builds it.
    """

    def __init__(self, builder: DiagramBuilder, nonstop: Diagram):
        sampled, stepped = _recorded_ports(nonstop)
        self._steps = _Log(builder, stepped, TriggerType.kPerStep)
        self._samples = _Log(builder, sampled, TriggerType.kForced)
        self._signal_names = {
            f"{block.get_name()}.{name}": name
            for block in nonstop.GetSystems()
            for name in output_names(block)
            if name in sampled
        }
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
        if self._samples.memory + self._steps.memory > MEMORY_LIMIT:
            try:
                self._store()
            except OSError as error:
                raise RecordingError(
                    f"the temporary folder {tempfile.gettempdir()} cannot take the signals "
                    f"({error.strerror}): set TMPDIR to a folder with more room, or give a "
                    "shorter simulation_duration"
                ) from None

    def collect(self) -> tuple[NDArray, Mapping[str, NDArray], Mapping[str, NDArray]]:
        """The fields `time`, `signals` and `steps` of a `Run`."""
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
        self._sizes = {name: port.size() for name, port in ports.items()}
        self._row_size = _row_size(ports)
        # One port for all: a sink per signal would slow every step of the diagram down.
        multiplexer = builder.AddSystem(Multiplexer(list(self._sizes.values())))
        for i, port in enumerate(ports.values()):
            builder.Connect(port, multiplexer.get_input_port(i))
        self._sink = LogVectorOutput(
            multiplexer.get_output_port(), builder, {trigger}, publish_period=0.0
        )
        self._log: VectorLog
        self._context: Context
        self._stored = 0  # rows in files
        self._files: dict[str, Path] = {}

    def start(self, context: Context) -> None:
        self._context = self._sink.GetMyContextFromRoot(context)
        self._log = self._sink.FindLog(context)

    def publish(self) -> None:
        self._sink.ForcedPublish(self._context)

    @property
    def memory(self) -> int:
        """Bytes of signals in memory."""
        return self._log.num_samples() * self._row_size

    @property
    def rows(self) -> int:
        return self._stored + self._log.num_samples()

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
        return StoredSignals(folder, files, in_memory if self._log.num_samples() else {})

    def _columns(self) -> dict[str, NDArray]:
        """The rows in memory, by the ports' names."""
        ends = np.cumsum(list(self._sizes.values()))
        pieces = np.split(self._log.data(), ends[:-1])
        columns = {name: piece.T.copy() for name, piece in zip(self._sizes, pieces, strict=True)}
        return {self.TIMES: self._log.sample_times().copy()} | columns


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
    is_fused = any(isinstance(block, FusedPlant) for block in nonstop.GetSystems())
    step = scenario.control_period if is_fused else scenario.simulator_config.max_step_size
    sampled, stepped = _recorded_ports(nonstop)
    return scenario.simulation_duration * (
        _row_size(sampled) / SIGNAL_PERIOD + _row_size(stepped) / min(step, SIGNAL_PERIOD)
    )


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
    outputs = [nonstop.get_output_port(i) for i in range(nonstop.num_output_ports())]
    ports = {
        port.get_name(): port
        for port in outputs
        if port.get_data_type() == PortDataType.kVectorValued
    }
    return (
        {name: port for name, port in ports.items() if name != WALL_TIME},
        {name: port for name, port in ports.items() if name in _EVERY_STEP},
    )


def _row_size(ports: Mapping[str, OutputPort]) -> int:
    """Bytes of an instant's values, and of its time."""
    return _DOUBLE * (1 + sum(port.size() for port in ports.values()))
