"""Which signals of a run are recorded, and what records them while it goes on."""

import contextlib
import shutil
import tempfile
from collections.abc import Mapping

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
from drake_nonstop.mechanics.signal_layouts import HELD, Entry, Layout, numbered_entries
from drake_nonstop.mechanics.signals import (
    LOAD_REFERENCE_SIZE,
    LOAD_STATE_SIZE,
    PARAMETERS_SIZE,
    SIGNAL_PERIOD,
)
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.simulation.monitor import AT_SAMPLE, SampleInstants
from drake_nonstop.simulation.run import WALL_TIME
from drake_nonstop.simulation.signal_rows import DOUBLE, SignalRows
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


class RecordingError(RuntimeError):
    """The temporary folder cannot take the signals of a run."""


class _Log(LeafBlock):
    """The rows of some ports, which each context has; `publish` adds one.

    Args:
        sizes: of the ports, by their names.
    """

    def __init__(self, sizes: Mapping[str, int]):
        super().__init__()
        self._values = self.DeclareVectorInputPort("values", sum(sizes.values()))
        self._rows = self.DeclareCacheEntry(
            description="rows",
            value_producer=ValueProducer(
                allocate=lambda: AbstractValue.Make(SignalRows(sizes)), calc=ValueProducer.NoopCalc
            ),
            prerequisites_of_calc={self.nothing_ticket()},
        ).cache_index()

    def publish(self, context: Context) -> None:
        """Adds the values of now."""
        self._in(context).add(np.array([context.get_time()]), self._values.Eval(context))

    def rows(self, context: Context) -> SignalRows:
        """Those of a context of the whole diagram."""
        return self._in(self.GetMyContextFromRoot(context))

    def _in(self, context: Context) -> SignalRows:
        entry = self.get_cache_entry(self._rows).get_mutable_cache_entry_value(context)
        rows: SignalRows = entry.GetMutableValueOrThrow()
        return rows


class _LogOfInstants(_Log):
    """A log with a row for the start, and for the first step to each of the signals' instants."""

    def __init__(self, sizes: Mapping[str, int]):
        super().__init__(sizes)
        self.DeclareInitializationPublishEvent(self.publish)
        self.DeclarePerStepPublishEvent(self._publish_instant)

    def _publish_instant(self, context: Context) -> None:
        times, time_ = self._in(context).times, context.get_time()
        is_instant = abs(time_ / SIGNAL_PERIOD - round(time_ / SIGNAL_PERIOD)) < AT_SAMPLE
        if is_instant and not (times and abs(time_ - times[-1]) < AT_INSTANT):
            self.publish(context)


class LogSignals:
    """The logs of a loop's signals: all at 100 Hz, and a few at every step.

    Each context has logs of its own, as with Drake's `LogVectorOutput`: `Run.from_logs` makes a run
    of those of a context. The integrator's steps end at the instants of the samples. All signals
    are in memory, some 0.3 MB for a second of flight; a run of `simulate` may be in files instead.
    `AddToBuilder` makes them.

    Attributes:
        nonstop: the diagram whose signals they are.
        entries: what the columns of the signals are, by their names "block.port".
        sampled: the names of the diagram's ports that are recorded at 100 Hz.
        stepped: the names of those that are recorded at every step.
    """

    _sampling: type[_Log] = _LogOfInstants

    def __init__(self, builder: DiagramBuilder, nonstop: Diagram):
        sampled, stepped = _recorded_ports(nonstop)
        self.nonstop = nonstop
        self.sampled, self.stepped = [*sampled], [*stepped]
        self._steps = _add_log(builder, stepped, _Log)
        self._steps.DeclarePerStepPublishEvent(self._steps.publish)
        self._samples = _add_log(builder, sampled, self._sampling)
        builder.AddSystem(SampleInstants(control_period_of(nonstop)))
        self._signal_names, self.entries = _names_and_entries(nonstop, sampled)
        self._step_names = {STEP_TIME: SignalRows.TIMES} | {name: name for name in stepped}

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

    def collect(self, context: Context) -> tuple[NDArray, dict[str, NDArray], dict[str, NDArray]]:
        """The fields `time`, `signals` and `steps` of a `Run`, since time was set back last.

        Args:
            context: of the whole diagram, such as a Simulator's.

        Raises:
            ScenarioError: there is nothing in the logs of the context, or it is another one's.
        """
        try:
            samples, steps = (log.rows(context).columns() for log in (self._samples, self._steps))
        except (RuntimeError, TypeError):
            raise ScenarioError(
                f"context = {type(context).__name__} of another diagram: give that of the whole "
                "diagram with the logs, such as simulator.get_context()"
            ) from None
        times = samples[SignalRows.TIMES]
        remedy = "advance a Simulator with this context first"
        require(len(times) > 0, "logs", "no samples", remedy)
        instants = np.round(times / SIGNAL_PERIOD)
        is_instant = np.abs(times - SIGNAL_PERIOD * instants) < AT_INSTANT
        samples[SignalRows.TIMES] = np.where(is_instant, SIGNAL_PERIOD * instants, times)
        samples, steps = _last_flight(samples), _last_flight(steps)
        return samples[SignalRows.TIMES], *self._named(samples, steps)

    def _named(
        self, samples: dict[str, NDArray], steps: dict[str, NDArray]
    ) -> tuple[dict[str, NDArray], dict[str, NDArray]]:
        """The columns of ports by the names of a `Run`."""
        return (
            {name: samples[port] for name, port in self._signal_names.items()},
            {name: steps[port] for name, port in self._step_names.items()},
        )


def _add_log(builder: DiagramBuilder, ports: Mapping[str, OutputPort], kind: type[_Log]) -> _Log:
    """Adds a log of ports: one sink, since one for each would slow every step down."""
    sizes = {name: port.size() for name, port in ports.items()}
    multiplexer, log = builder.AddSystem(Multiplexer([*sizes.values()])), kind(sizes)
    for i, port in enumerate(ports.values()):
        builder.Connect(port, multiplexer.get_input_port(i))
    builder.Connect(multiplexer.get_output_port(), builder.AddSystem(log).get_input_port())
    return log


def control_period_of(nonstop: Diagram) -> float:
    """That of the controllers in a loop, s; 0 where none is known."""
    holds = (s for s in nested(nonstop, RUN_SIGNALS)[-1].GetSystems() if type(s) is SampleAndHold)
    return next((hold.sample_period for hold in holds), 0.0)


def _names_and_entries(
    nonstop: Diagram, sampled: Mapping[str, OutputPort]
) -> tuple[dict[str, str], dict[str, tuple[Entry, ...]]]:
    """Ports by their names "block.port", with the block that makes the signal, and their columns.

    A block's own `signal_layouts` come first, then the layouts of the figure's signals.
    """
    *_, loop = nested(nonstop, RUN_SIGNALS) if all(s in sampled for s in RUN_SIGNALS) else [nonstop]
    names, found = {}, {}
    for port, output in sampled.items():
        maker = maker_of(loop if loop.HasOutputPort(port) else nonstop, port)
        name, size = f"{title(maker).replace('.', '_')}.{port}", output.size()
        own = getattr(maker, "signal_layouts", {}).get(port)
        layout = own or SIGNALS.get(port.removeprefix(HELD))
        entries = layout.entries(port, size) if isinstance(layout, Layout) else None
        names[name], found[name] = port, entries or numbered_entries(port, size)
    return names, found


def _last_flight(columns: dict[str, NDArray]) -> dict[str, NDArray]:
    """The rows since time was set back last; of those of one instant the last."""
    times = columns[SignalRows.TIMES]
    changes = np.diff(times)
    start = np.flatnonzero(changes < 0)[-1] + 1 if np.any(changes < 0) else 0
    kept = np.append(changes != 0, True)[: len(times)]
    kept[:start] = False
    return {name: values[kept] for name, values in columns.items()}


class Recording(LogSignals):
    """The logs of a long run, which go to files: of one context, sampled when that is asked for.

    Signals that are `recorded_where_read` are not among them where no block reads them.

    Args:
        builder: has the diagram already; the logs are added to it.
        nonstop: the diagram, as `make_nonstop` builds it.
    """

    _sampling = _Log

    def start(self, context: Context) -> None:
        """To be called before the run, with the context of what the builder built."""
        self._context = self._samples.GetMyContextFromRoot(context)
        self._taken = self._samples.rows(context), self._steps.rows(context)
        self._is_stored = False

    def take_sample(self) -> None:
        """Takes a sample of all signals.

        Raises:
            RecordingError: the temporary folder cannot take them.
        """
        self._samples.publish(self._context)
        self._store_many()

    def add(self, times: NDArray, samples: NDArray, step_times: NDArray, steps: NDArray) -> None:
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
        instants = np.floor(times / SIGNAL_PERIOD + AT_SAMPLE)
        kept = np.diff(instants, prepend=len(self._taken[0]) - 1) > 0
        self._taken[0].add(times[kept], samples[kept])
        self._taken[1].add(step_times, steps)
        self._store_many()

    @property
    def has_steps(self) -> bool:
        """Whether a step has been recorded."""
        return len(self._taken[1]) > 0

    def drop_last_step(self) -> None:
        """Drops the last row of `stepped`, which a Simulator that goes on publishes again."""
        self._taken[1].drop_last()

    def _store_many(self) -> None:
        """Moves the signals to files where they are many."""
        if sum(rows.memory for rows in self._taken) > MEMORY_LIMIT:
            self._is_stored = True
            try:
                for rows in self._taken:
                    rows.store()
            except OSError as error:
                raise RecordingError(
                    f"the temporary folder {tempfile.gettempdir()} cannot take the signals "
                    f"({error.strerror}): set TMPDIR to a folder with more room, or give a "
                    "shorter simulation_duration"
                ) from None

    def collect(
        self, context: Context | None = None
    ) -> tuple[NDArray, dict[str, NDArray], dict[str, NDArray]]:
        """The fields `time`, `signals` and `steps` of a `Run`, of the context it started with."""
        for rows in self._taken if self._is_stored else ():
            with contextlib.suppress(OSError):  # what the file cannot take stays in memory
                rows.store()
        # Of their number, without the rounding of the events' times.
        times = SIGNAL_PERIOD * np.arange(len(self._taken[0]))
        samples, steps = (rows.columns() for rows in self._taken)
        return times, *self._named(samples, steps)


def expected_size(nonstop: Diagram, scenario: Scenario) -> float:
    """About how many bytes the signals of a run take, where no step has to be shorter."""
    step = scenario.simulator_config.max_step_size
    samples, steps = (
        DOUBLE * (1 + sum(port.size() for port in ports.values()))
        for ports in _recorded_ports(nonstop)
    )
    return scenario.simulation_duration * (
        samples / SIGNAL_PERIOD + steps / min(step, SIGNAL_PERIOD)
    )


def least_size(scenario: Scenario) -> float:
    """Bytes that the results of a run take at least: about half its signals, as compressed.

    It is known before there is a diagram: what loops of the default blocks export is counted.
    """
    columns = 140 + 35 * len(scenario.system.attachments)
    return scenario.simulation_duration / SIGNAL_PERIOD * columns * DOUBLE / 2


def require_room(nonstop: Diagram, scenario: Scenario) -> None:
    """Raises ScenarioError where the temporary folder has no room for a run that needs it."""
    size = expected_size(nonstop, scenario)
    room = shutil.disk_usage(tempfile.gettempdir()).free
    most = max(room, MEMORY_LIMIT)
    longest = 0.9 * most / size * scenario.simulation_duration  # s; 0.9: it is rounded
    require(
        size <= most,
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
    names, _ = _names_and_entries(nonstop, sampled)
    return (
        {name: sampled[port].size() for name, port in names.items()},
        {name: port.size() for name, port in stepped.items()},
    )
