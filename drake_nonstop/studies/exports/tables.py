"""A run's signals as a table: CSV for any tool, Parquet with types, units and frames."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from drake_nonstop.simulation.signal_table import SignalTable
from drake_nonstop.studies.files import replacing_file
from drake_nonstop.validation import require_installed


def write_csv(table: SignalTable, path: Path, signals: Sequence[str] = ()) -> None:
    """Writes a row per sample; the first line has the columns' names with their units.

    Args:
        table: what to write, such as a Run.
        path: of the file.
        signals: as of `SignalTable.columns`.

    Raises:
        ScenarioError: there is no such signal, or the file cannot be written.
    """
    columns = table.columns(signals)
    rows = np.column_stack(list(columns.values()))
    header = ",".join(columns)
    with replacing_file(path) as file:
        file.write(f"{header}\n".encode())
        np.savetxt(file, rows, fmt="%.17g", delimiter=",")


def write_parquet(table: SignalTable, path: Path, signals: Sequence[str] = ()) -> None:
    """Writes a row per sample; each column's metadata has its `unit` and `frame`.

    Args:
        table: what to write, such as a Run.
        path: of the file.
        signals: as of `SignalTable.columns`.

    Raises:
        ScenarioError: there is no such signal, PyArrow is not installed, or the file cannot be
            written.
    """
    require_installed("export", pyarrow="drake-nonstop[export]")
    import pyarrow
    from pyarrow import parquet

    columns = table.columns(signals)
    about = {entry.label: entry for entries in table.entries.values() for entry in entries}
    fields = []
    for label in columns:
        entry = about.get(label)
        unit, frame = ("s", "") if entry is None else (entry.unit, entry.frame)
        about_it = {"unit": unit, "frame": frame}
        fields.append(pyarrow.field(label, pyarrow.float64(), metadata=about_it))
    columns_of = pyarrow.table(list(columns.values()), schema=pyarrow.schema(fields))
    with replacing_file(path) as file:
        parquet.write_table(columns_of, file)
