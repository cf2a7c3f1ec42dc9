"""Signals over time, with the names, units and frames of their columns."""

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from numpy.typing import NDArray

from drake_nonstop.mechanics.signal_layouts import Entry, numbered_entries
from drake_nonstop.validation import ScenarioError, require_installed

if TYPE_CHECKING:
    import pandas
    import xarray


@dataclass(kw_only=True)
class SignalTable:
    """Samples (samples, size) of signals, by their names "block.port", at `time` (samples,) in s.

    `entries` tells the name, unit and frame of each column of the `signals`, by the same names.
    """

    time: NDArray
    signals: Mapping[str, NDArray]
    entries: Mapping[str, tuple[Entry, ...]] = field(default_factory=dict)

    def signal(self, port: str) -> NDArray:
        """The signal of that port name, or of "block.port": (samples, size).

        Raises:
            UnknownSignalError: there is none.
        """
        return self.signals[self.name_of(port)]

    def has(self, port: str) -> bool:
        """Whether there is a signal of that port name."""
        return any(name.partition(".")[2] == str(port) for name in self.signals)

    def name_of(self, port: str) -> str:
        """The name "block.port" of the signal of that port name, or of that name itself.

        Raises:
            UnknownSignalError: there is none.
        """
        for name in self.signals:
            if str(port) in (name, name.partition(".")[2]):
                return name
        raise UnknownSignalError(port, list(self.signals))

    def columns(self, signals: Sequence[str] = ()) -> dict[str, NDArray]:
        """The numbers (samples,) of signals, by names with their units: "tensions.1 [N]".

        The first is "time [s]". See `mechanics.signal_layouts` for the names.

        Args:
            signals: the ports' names, or "block.port", or the first parts of entries' names, such
                as "carrier_state.positions" and "load_state.velocity.x"; none: all.

        Raises:
            UnknownSignalError: there is no such signal.
        """
        chosen = self._selected(signals)
        return {"time [s]": self.time} | {entry.label: values for entry, values in chosen}

    def _selected(self, signals: Sequence[str]) -> list[tuple[Entry, NDArray]]:
        """What the columns of signals are, as of `columns`, with their values (samples,)."""
        names = [signals] if isinstance(signals, str) else signals or self.signals
        return [
            (entry, self.signals[name][:, column])
            for name, chosen in map(self._chosen, names)
            for column, entry in chosen
        ]

    def _chosen(self, signal: str) -> tuple[str, list[tuple[int, Entry]]]:
        """The name of a signal, and those of its columns that are asked for."""
        for name, values in self.signals.items():
            port = name.partition(".")[2]
            entries = self.entries.get(name) or numbered_entries(port, values.shape[1])
            every = list(enumerate(entries))
            if signal in (name, port):
                return name, every
            of_port = signal.removeprefix(f"{name.partition('.')[0]}.")
            part = [item for item in every if f"{item[1].name}.".startswith(f"{of_port}.")]
            if part:
                return name, part
        return self.name_of(signal), []

    def to_pandas(self, signals: Sequence[str] = ()) -> "pandas.DataFrame":
        """The signals as a data frame of pandas, with units in the columns' names.

        The index is the time in s. Its `attrs` have the "units" and "frames" of the columns.

        Args:
            signals: as of `columns`.

        Raises:
            UnknownSignalError: there is no such signal.
        """
        import pandas

        chosen = self._selected(signals)
        columns = {entry.label: values for entry, values in chosen}
        frame = pandas.DataFrame(columns, index=pandas.Index(self.time, name="time [s]"))
        frame.attrs["units"] = {entry.label: entry.unit for entry, _ in chosen}
        frame.attrs["frames"] = {entry.label: entry.frame for entry, _ in chosen}
        return frame

    def to_xarray(self, signals: Sequence[str] = ()) -> "xarray.Dataset":
        """The signals as a dataset of xarray: a variable of the time for each column.

        Each has the "units" and the "frame" among its attributes.

        Args:
            signals: as of `columns`.

        Raises:
            UnknownSignalError: there is no such signal.
            ScenarioError: xarray is not installed.
        """
        require_installed("to_xarray", xarray="drake-nonstop[xarray]")
        import xarray

        variables = {
            entry.name: ("time", values, {"units": entry.unit, "frame": entry.frame})
            for entry, values in self._selected(signals)
        }
        return xarray.Dataset(variables, {"time": ("time", self.time, {"units": "s"})})


class UnknownSignalError(ScenarioError, KeyError):
    """A run has no signal of that name; names that are close are looked for when it is told."""

    def __str__(self) -> str:
        port, names = self.args
        close = difflib.get_close_matches(str(port), names, n=3, cutoff=0.4)
        return f"signal = {port}: give a port of the run, such as {' or '.join(close or names[:3])}"
