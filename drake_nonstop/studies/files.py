"""Files of results: never half-written, and errors that name the folder."""

import atexit
import contextlib
import errno
import fcntl
import json
import os
import shutil
import stat
import tempfile
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO

from drake_nonstop.run.interruption import before_end
from drake_nonstop.validation import ScenarioError, finite, require

_NEW = ".new-"  # how the names of files and folders begin that are being written
_YOUNGEST_STALE = 1.0  # s; a younger one may not be locked yet
_ENDING_TIME = 0.5  # s, in which a process that was killed ends
_LARGEST_READ = 16_000_000  # bytes

# What this process is writing, and the process: a fork has no part in it.
_unfinished: dict[str, int] = {}
_shared: list[Path] = []  # folders that processes of this one write to
_changing = threading.RLock()  # held while something is begun, or put in its place


def require_writable(
    folder: Path | str, contents: Iterable[str] = (), *, room: float = 0.0
) -> None:
    """Makes the folder where there is none.

    Raises ScenarioError where these files, whose paths are relative to it and which take `room` in
    bytes, cannot be written to it.
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


def require_writable_file(file: Path) -> None:
    """Makes the folder of a file where there is none.

    Raises:
        ScenarioError: the file cannot be written, or something that is no file is in its place.
    """
    remedy = "a folder or a device is in its place; give another file"
    require(file.name != "" and not _is_kept(file), "--out", file, remedy)
    require_writable(file.parent, [file.name])


def _is_kept(path: Path) -> bool:
    """Whether something is there that no file may replace: neither a regular file nor a link."""
    with contextlib.suppress(OSError, ValueError):
        mode = path.lstat().st_mode
        return not (stat.S_ISREG(mode) or stat.S_ISLNK(mode))
    return False


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
    kind = "folder" if os.path.isdir(path) else "device or pipe"
    require(not _is_kept(path), "--out", folder, f"its {kind} {item} {remedy}")


@contextlib.contextmanager
def replacing_file(path: Path) -> Iterator[BinaryIO]:
    """A new file to write, which replaces `path` at the end, as `replacing_files` does."""
    with replacing_files(path.parent, [path.name]) as new, (new / path.name).open("wb") as file:
        yield file


@contextlib.contextmanager
def replacing_files(folder: Path, contents: Iterable[str]) -> Iterator[Path]:
    """A new folder to write files to, which replace those in `folder` at the end; none on an error.

    Of the files that may be written, whose paths are relative to it, old ones that have no new one
    are removed, and so is a folder that is left empty by that.

    Raises:
        ScenarioError: the folder cannot be written.
    """
    contents = list(contents)
    name = ""
    try:
        for path in folder.glob(f"{_NEW}*"):  # what processes were writing that were killed
            _is_removed(path, _YOUNGEST_STALE)
        with _changing:
            name = tempfile.mkdtemp(prefix=_NEW, dir=folder)
            _unfinished[name] = os.getpid()
        with _opened(name) as descriptor:
            with contextlib.suppress(OSError):  # without locks nothing counts as stale
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            yield Path(name)
            with _changing:
                _replace(Path(name), folder, contents)
    except OSError as error:
        raise ScenarioError(
            f"--out = {folder}: give a folder with room to write to ({_cause(error)})"
        ) from None
    finally:
        if name:
            shutil.rmtree(name, ignore_errors=True)
            _unfinished.pop(name, None)


def _replace(new: Path, folder: Path, contents: Sequence[str]) -> None:
    """Puts the new files in the places of the old ones."""
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


@contextlib.contextmanager
def shared(folders: Iterable[Path]) -> Iterator[None]:
    """Within it processes of this one write to these folders, and others do not.

    At the end, also where the process is ended before, what those that were killed have begun is
    removed.
    """
    before = [*_shared]
    _shared.extend(folders)
    try:
        yield
    finally:
        _remove_left(_shared[len(before) :])
        _shared[:] = before


def _remove_left(folders: Iterable[Path]) -> None:
    """Removes what other processes have begun in these folders that end now."""
    end = time.monotonic() + _ENDING_TIME
    left = [path for folder in folders for path in folder.glob(f"{_NEW}*")]
    while left and time.monotonic() < end:
        left = [path for path in left if not _is_removed(path)]
        time.sleep(0.01 if left else 0.0)


@atexit.register
def remove_unfinished() -> None:
    """Removes what this process, or one that it has killed, is writing. It has to end after it."""
    if not _changing.acquire(timeout=_ENDING_TIME):  # for good: nothing more is begun
        return
    for name, process in [*_unfinished.items()]:
        if process == os.getpid():
            shutil.rmtree(name, ignore_errors=True)
    _remove_left([*_shared])


before_end.append(remove_unfinished)


def open_regular(path: Path) -> BinaryIO:
    """Opens a file; raises OSError for others, such as a pipe, which would have the reader wait."""
    file = os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb")
    if stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        return file
    file.close()
    raise OSError(errno.EINVAL, "no regular file", str(path))


def read_regular(path: Path) -> bytes:
    """The content of a file; raises OSError for what is none, or larger than 16 MB."""
    with open_regular(path) as file:
        content = file.read(_LARGEST_READ + 1)
    if len(content) > _LARGEST_READ:
        raise OSError(errno.EFBIG, "larger than 16 MB", str(path))
    return content


def write_json(path: Path, data: Any) -> None:
    """Writes the data to a file, which replaces `path` once it is complete.

    Numbers that are not finite, which JSON does not have, are null.
    """
    with replacing_file(path) as file:
        file.write((json.dumps(finite(data), indent=2, allow_nan=False) + "\n").encode())


def _cause(error: OSError | ValueError) -> str:
    return (isinstance(error, OSError) and error.strerror) or str(error)


def _is_removed(path: Path, least_age: float = 0.0) -> bool:
    """Whether it is there no more: unless somebody is writing it, or it is too young, s, it is."""
    with contextlib.suppress(OSError):  # it is somebody else's, or still being written
        if time.time() - path.stat().st_ctime >= least_age:
            with _opened(path) as descriptor:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(path) if path.is_dir() else path.unlink()
    return not os.path.lexists(path)


@contextlib.contextmanager
def _opened(path: Path | str) -> Iterator[int]:
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    try:
        yield descriptor
    finally:
        os.close(descriptor)
