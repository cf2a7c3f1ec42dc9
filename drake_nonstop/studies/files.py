"""Files of results: written to a temporary place, then renamed; errors name the folder."""

import contextlib
import itertools
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


def as_path(folder: Path | str) -> Path:
    """The folder as a Path; raises ScenarioError for what names none."""
    require(isinstance(folder, (str, os.PathLike)), "folder", folder, "give a path")
    return Path(folder)


def has_text(file: Path, text: str) -> bool:
    """Whether a file is there and has this text."""
    return file.is_file() and file.read_bytes() == text.encode()


def free_folder(folder: Path, name: str, text: str) -> Path:
    """Where results go unless the user names a folder: not over those of other settings.

    It is the folder itself, or the first of FOLDER_2, FOLDER_3, ... in which there is no file of
    that name, or one with this text.
    """
    numbered = (folder.with_name(f"{folder.name}_{k}") for k in itertools.count(2))
    return next(
        place
        for place in itertools.chain([folder], numbered)
        if not (place / name).exists() or has_text(place / name, text)
    )


def require_writable(
    folder: Path | str, contents: Iterable[str] = (), *, room: float = 0.0
) -> None:
    """Makes the folder where there is none, and removes what killed processes were writing to it.

    Raises ScenarioError where these files, whose paths are relative to it and which take `room` in
    bytes, cannot be written to it.
    """
    folder = as_path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for left in folder.glob(f"{_NEW}*"):
            shutil.rmtree(left, ignore_errors=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
        for item in map(Path, contents):
            for parent in [folder / part for part in item.parents][:-1]:
                remedy = f"its file {parent.name} is in the way: move it, or give another folder"
                require(parent.is_dir() or not parent.exists(), "--out", folder, remedy)
            remedy = f"its {item} is no file, and in the way: move it, or give another folder"
            require(_is_replaceable(folder / item), "--out", folder, remedy)
        free = shutil.disk_usage(folder).free
    except ScenarioError:
        raise
    except (OSError, ValueError) as error:  # ValueError: a path with a null character
        cause = getattr(error, "strerror", None) or error
        remedy = f"give a folder that can be written ({cause})"
        raise ScenarioError(f"--out = {folder}: {remedy}") from None
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
            for item in contents:
                new, path = Path(name) / item, folder / item
                if new.exists():
                    path.parent.mkdir(parents=True, exist_ok=True)
                    os.replace(new, path)
                    continue
                path.unlink(missing_ok=True)
                if path.parent != folder:
                    with contextlib.suppress(OSError):  # it has files, or is not there
                        path.parent.rmdir()
    except OSError as error:
        remedy = f"give a folder with room to write to ({error.strerror or error})"
        raise ScenarioError(f"--out = {folder}: {remedy}") from None


def write_json(path: Path, data: Any) -> None:
    """Writes the data to a file, which replaces `path` once it is complete.

    Numbers that are not finite, which JSON does not have, are null.
    """
    with replacing_file(path) as file:
        file.write((json.dumps(finite(data), indent=2, allow_nan=False) + "\n").encode())
