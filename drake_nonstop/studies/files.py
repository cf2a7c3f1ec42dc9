"""Files of results: written to a temporary place, then renamed; errors name the folder."""

import contextlib
import errno
import json
import os
import shutil
import stat
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, BinaryIO

from drake_nonstop.validation import ScenarioError, finite, require

_NEW = ".new-"  # how the names of folders begin that are being written
_LARGEST_READ = 16_000_000  # bytes


def as_path(folder: Path | str) -> Path:
    """The folder as a Path; raises ScenarioError for what names none."""
    require(isinstance(folder, (str, os.PathLike)), "folder", folder, "give a path")
    return Path(folder)


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
        for item in map(Path, contents):
            for parent in [folder / part for part in item.parents][:-1]:
                is_file = os.path.lexists(parent) and not parent.is_dir()
                remedy = f"its file {parent.name} is in the way: move it, or give another folder"
                require(not is_file, "--out", folder, remedy)
            remedy = f"its {item} is no file, and in the way: move it, or give another folder"
            require(_is_replaceable(folder / item), "--out", folder, remedy)
        free = shutil.disk_usage(folder).free
    except (OSError, ValueError) as error:  # ValueError: a path with a null character
        if isinstance(error, ScenarioError):
            raise
        raise ScenarioError(
            f"--out = {folder}: give a folder that can be written ({_cause(error)})"
        ) from None
    needed = f"give a folder with room for {room / 1e6:.0f} MB, {free / 1e6:.0f} MB are free"
    require(free > room, "--out", folder, f"{needed}; or a shorter simulation_duration")


def require_writable_file(file: Path) -> None:
    """Makes the folder of a file where there is none.

    Raises:
        ScenarioError: the file cannot be written, or something that is no file is in its place.
    """
    remedy = "a folder or a device is in its place; give another file"
    require(file.name != "" and _is_replaceable(file), "--out", file, remedy)
    require_writable(file.parent)


def _is_replaceable(path: Path) -> bool:
    """Whether nothing is there, or what a file may replace: a regular file, or a link."""
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return True
    return stat.S_ISREG(mode) or stat.S_ISLNK(mode)


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
    try:
        with tempfile.TemporaryDirectory(
            prefix=_NEW, dir=folder, ignore_cleanup_errors=True
        ) as name:
            yield Path(name)
            parents = set()
            for item in contents:
                new, path = Path(name) / item, folder / item
                if new.exists():
                    path.parent.mkdir(parents=True, exist_ok=True)
                    os.replace(new, path)
                else:
                    path.unlink(missing_ok=True)
                    parents.add(path.parent)
        for parent in sorted(parents - {folder}, reverse=True):  # the inner ones first
            with contextlib.suppress(OSError):  # it has files
                parent.rmdir()
    except OSError as error:
        raise ScenarioError(
            f"--out = {folder}: give a folder with room to write to ({_cause(error)})"
        ) from None


def remove_unfinished(folder: Path) -> None:
    """Removes what processes that were killed were writing to a folder."""
    for left in folder.glob(f"{_NEW}*"):
        shutil.rmtree(left, ignore_errors=True)


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
