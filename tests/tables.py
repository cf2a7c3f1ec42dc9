"""Tables in Parquet. PyArrow takes 100 MB of memory: who reads one imports it."""

from pathlib import Path
from typing import Any


def read_rows(path: Path) -> list[dict[str, Any]]:
    """The rows of a table, by the names of its columns."""
    from pyarrow import parquet

    return parquet.read_table(path).to_pylist()


def column_types(path: Path) -> dict[str, str]:
    """The types of a table's columns, by their names."""
    from pyarrow import parquet

    return {field.name: str(field.type) for field in parquet.read_schema(path)}
