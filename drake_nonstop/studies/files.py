"""Files of results: never half-written, and errors that name the folder."""

import contextlib
import json
import os
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, BinaryIO

from drake_nonstop.validation import ScenarioError, require


def require_writable(folder: Path) -> None:
    """Makes the folder where there is none.

    Raises:
        ScenarioError: no files can be written to it.
    """
    folder = as_path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise ScenarioError(
            f"--out = {folder}: give a folder that can be written ({error.strerror})"
        ) from None


def as_path(folder: Path | str) -> Path:
    """The folder as a Path; raises ScenarioError for what names none."""
    require(isinstance(folder, (str, os.PathLike)), "folder", folder, "give a path")
    return Path(folder)


@contextlib.contextmanager
def replacing_file(path: Path) -> Iterator[BinaryIO]:
    """A new file to write, which replaces `path` at the end; it is removed after an error."""
    with tempfile.NamedTemporaryFile(dir=path.parent, suffix=path.suffix, delete=False) as file:
        try:
            yield file  # type: ignore[misc]
        except BaseException:
            os.unlink(file.name)
            raise
    os.chmod(file.name, 0o644)
    os.replace(file.name, path)


@contextlib.contextmanager
def replacing_files(folder: Path, contents: Iterable[str]) -> Iterator[Path]:
    """A new folder to write files to, which replace those in `folder` at the end.

    Args:
        folder: for the files.
        contents: paths, relative to it, of all files that may be written: an old file that has
            no new one is removed, and so is a folder of such files that is left empty.

    Raises:
        ScenarioError: the folder cannot be written.
    """
    contents = list(contents)
    try:
        with tempfile.TemporaryDirectory(dir=folder, prefix=".new-") as name:
            new = Path(name)
            yield new
            for item in contents:
                if (new / item).exists():
                    (folder / item).parent.mkdir(parents=True, exist_ok=True)
                    os.replace(new / item, folder / item)
                else:
                    (folder / item).unlink(missing_ok=True)
            parents = {(folder / item).parent for item in contents} - {folder}
            for parent in sorted(parents, reverse=True):  # the inner ones first
                with contextlib.suppress(OSError):  # it has files
                    parent.rmdir()
    except OSError as error:
        raise ScenarioError(
            f"--out = {folder}: give a folder with room to write to ({error.strerror})"
        ) from None


def write_json(path: Path, data: Any) -> None:
    """Writes the data to a file, which replaces `path` once it is complete."""
    with replacing_file(path) as file:
        file.write((json.dumps(data, indent=2) + "\n").encode())
