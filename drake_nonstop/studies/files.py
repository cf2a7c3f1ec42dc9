"""Files of results: never half-written, and errors that name the folder."""

import contextlib
import fcntl
import json
import os
import shutil
import tempfile
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, BinaryIO

from drake_nonstop.validation import ScenarioError, require

_NEW = ".new-"  # how the names of files and folders begin that are being written
_YOUNGEST_STALE = 1.0  # s; a younger one may not be locked yet


def require_writable(
    folder: Path | str, contents: Iterable[str] = (), *, room: float = 0.0
) -> None:
    """Makes the folder where there is none.

    Args:
        folder: for results.
        contents: paths, relative to it, of the files that will be written.
        room: bytes that will be written.

    Raises:
        ScenarioError: no such files can be written to it.
    """
    folder = as_path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
        for item in contents:
            _require_replaceable(folder, Path(item))
        free = shutil.disk_usage(folder).free
    except ScenarioError:
        raise
    except (OSError, ValueError) as error:  # ValueError: a path with a null character
        remedy = f"give a folder that can be written ({_cause(error)})"
        require(False, "--out", folder, remedy)
    needed = f"give a folder with room for {room / 1e6:.0f} MB, {free / 1e6:.0f} MB are free"
    require(free > room, "--out", folder, f"{needed}; or a shorter simulation_duration")


def as_path(folder: Path | str) -> Path:
    """The folder as a Path; raises ScenarioError for what names none."""
    require(isinstance(folder, (str, os.PathLike)), "folder", folder, "give a path")
    return Path(folder)


def _require_replaceable(folder: Path, item: Path) -> None:
    """Raises ScenarioError where something is in the way of a file, OSError for too long a name."""
    with contextlib.suppress(FileNotFoundError):
        os.lstat(folder / f"{_NEW}12345678" / item)
    path = folder / item
    remedy = "is in the way: move it, or give another folder"
    for parent in [folder / part for part in item.parents][:-1]:
        if os.path.lexists(parent):
            require(parent.is_dir(), "--out", folder, f"its file {parent.name} {remedy}")
            with tempfile.TemporaryFile(dir=parent):
                pass
    is_folder = os.path.isdir(path) and not os.path.islink(path)
    require(not is_folder, "--out", folder, f"its folder {item} {remedy}")


@contextlib.contextmanager
def replacing_file(path: Path) -> Iterator[BinaryIO]:
    """A new file to write, which replaces `path` at the end; it is removed after an error."""
    _remove_stale(path.parent)
    with tempfile.NamedTemporaryFile(
        dir=path.parent, prefix=_NEW, suffix=path.suffix, delete=False
    ) as file:
        _try_to_lock(file.fileno())
        try:
            yield file  # type: ignore[misc]
            file.flush()
            os.chmod(file.name, 0o644)
            os.replace(file.name, path)
        except BaseException:
            os.unlink(file.name)
            raise


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
        _remove_stale(folder)
        with (
            tempfile.TemporaryDirectory(dir=folder, prefix=_NEW) as name,
            _opened(Path(name)) as descriptor,
        ):
            _try_to_lock(descriptor)
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
            f"--out = {folder}: give a folder with room to write to ({_cause(error)})"
        ) from None


def write_json(path: Path, data: Any) -> None:
    """Writes the data to a file, which replaces `path` once it is complete."""
    with replacing_file(path) as file:
        file.write((json.dumps(data, indent=2) + "\n").encode())


def _cause(error: OSError | ValueError) -> str:
    return (isinstance(error, OSError) and error.strerror) or str(error)


def _remove_stale(folder: Path) -> None:
    """Removes what processes were writing that were killed: nobody holds its lock."""
    for path in folder.glob(f"{_NEW}*"):
        with contextlib.suppress(OSError):  # it is somebody else's, or still being written
            if time.time() - path.stat().st_ctime < _YOUNGEST_STALE:
                continue
            with _opened(path) as descriptor:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if path.is_dir():
                    shutil.rmtree(path)
                else:
                    path.unlink()


def _try_to_lock(descriptor: int) -> None:
    """Locks what is being written; without locks in the file system nothing counts as stale."""
    with contextlib.suppress(OSError):
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[int]:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        yield descriptor
    finally:
        os.close(descriptor)
