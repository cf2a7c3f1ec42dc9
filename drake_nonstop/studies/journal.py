"""The journal of a study: what is done of it, written as it comes, so that it can be continued."""

import contextlib
import fcntl
import hashlib
import importlib.util
import json
import os
import re
import sys
import tempfile
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from io import FileIO
from pathlib import Path
from typing import Any, BinaryIO

from drake_nonstop.studies.files import as_path, open_regular, require_writable
from drake_nonstop.validation import ScenarioError, require
from drake_nonstop.version import __version__

JOURNAL = "journal.jsonl"

_MAX_HEAD = 1000  # bytes
_JSON_SEPARATORS = (",", ":")
_FINISHED = b'{"finished":true}'
_IMPORT_PATH = re.compile(r"(?<![\w.])([A-Za-z_]\w*)(?=\.[A-Za-z_])")


class StudyInterrupted(KeyboardInterrupt):
    """Ctrl-C ended a study; the message says how much of it is done."""

    found: Any = None  # what `design`, which has no folder, had found


class Journal:
    """The results of a study's runs by their keys, in a file; they are not held in memory."""

    def __init__(self, file: FileIO, reader: BinaryIO, folder: Path, settings: str):
        self._file = file
        self._reader = reader
        self._folder = folder
        self._settings = settings
        self._has_begun = False
        self._places: dict[int | str, int] = {}  # of the results, in the file

    def __contains__(self, key: object) -> bool:
        return key in self._places

    def __len__(self) -> int:
        return len(self._places)

    def result(self, key: int | str) -> dict[str, Any]:
        """The recorded entries."""
        self._reader.seek(self._places[key])
        result: dict[str, Any] = json.loads(self._reader.readline())
        del result["run"]
        return result

    def record(self, key: int | str, result: Mapping[str, Any]) -> None:
        """Writes the result of a run; the first one replaces what was not continued."""
        self._begin()
        place = self._file.seek(0, os.SEEK_END)
        self._write(json.dumps({"run": key, **result}, separators=_JSON_SEPARATORS).encode())
        self._places[key] = place

    def read(
        self, keys: Collection[int | str], fields: Mapping[str, type | tuple[type, ...]]
    ) -> None:
        """Finds the results that the file has, unless it is that of a complete study.

        Raises:
            ScenarioError: it has unfinished runs of other settings, or cannot be read.
        """
        head = self._reader.readline(_MAX_HEAD)
        if len(head) < _MAX_HEAD and not head.endswith(b"\n"):  # empty, or cut short as it began
            return
        found = self._parsed(head, {"settings": str})["settings"]
        end = self._file.seek(0, os.SEEK_END)
        self._reader.seek(max(0, end - len(_FINISHED) - 1))
        if self._reader.read().rstrip() == _FINISHED:
            return
        require(
            found == self._settings,
            "--out",
            self._folder,
            "it has the runs of another scenario or spec, of another study or of other code; give "
            "another folder, or --restart (restart=True) to drop them",
        )
        place = self._reader.seek(len(head))
        while line := self._reader.readline():
            if not line.endswith(b"\n"):  # cut short by an end of the process
                self._file.truncate(place)
                break
            key = self._parsed(line, {"run": (int, str), **fields})["run"]
            if isinstance(key, bool) or key not in keys:
                raise self._unreadable()
            self._places[key] = place
            place += len(line)
        self._has_begun = True

    def finish(self) -> None:
        """Notes that the study is complete: the next one in its folder starts again."""
        self._begin()
        self._write(_FINISHED)

    def _begin(self) -> None:
        if not self._has_begun:
            self._file.truncate(0)
            self._write(json.dumps({"settings": self._settings}).encode())
            self._has_begun = True

    def _parsed(self, line: bytes, fields: Mapping[str, Any]) -> dict[str, Any]:
        """A line, which must have these fields of these types."""
        try:
            content = json.loads(line)
        except (ValueError, RecursionError):
            raise self._unreadable() from None
        if not isinstance(content, dict) or not all(
            name in content and isinstance(content[name], kind) for name, kind in fields.items()
        ):
            raise self._unreadable()
        return content

    def _unreadable(self) -> ScenarioError:
        return ScenarioError(
            f"--out = {self._folder}: its {JOURNAL} cannot be read; give another folder, or "
            "--restart (restart=True) to drop it"
        )

    def _write(self, line: bytes) -> None:
        content = line + b"\n"
        while content:
            content = content[self._file.write(content) :]


def settings_of(study: str, *texts: str) -> str:
    """A name of the settings in these texts, which differs where results may differ.

    The package's version and the modules that the texts name are part of it, so that a study is
    not continued with other code.
    """
    return _hashed([study, __version__, *texts, *_own_code(texts)])


def own_code_of(text: str) -> str | None:
    """A name of the source of the user's own modules that a text names; None: it names none."""
    code = _own_code([text])
    return _hashed(code) if code else None


def _hashed(parts: Sequence[str]) -> str:
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


def _own_code(texts: Iterable[str]) -> list[str]:
    """The contents of the modules that the texts name."""
    names = {match for text in texts for match in _IMPORT_PATH.findall(text)}
    contents = []
    for file in sorted(file for name in names for file in _sources(name)):
        with contextlib.suppress(OSError):
            contents.append(file.read_text(encoding="utf-8", errors="replace"))
    return contents


def _sources(name: str) -> list[Path]:
    """The files of a module or package of the user's own, which is not imported for that."""
    if name in sys.stdlib_module_names:
        return []
    if name == "__main__":
        file = getattr(sys.modules[name], "__file__", None)
        return [Path(file)] if file else []
    try:
        spec = importlib.util.find_spec(name)
    except (ImportError, ValueError):
        return []
    if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
        return []
    origin = Path(spec.origin)
    if "site-packages" in origin.parts:
        return []
    return [*origin.parent.rglob("*.py")] if spec.submodule_search_locations else [origin]


def journalled_settings(folder: Path) -> str | None:
    """The settings of the study in a folder; "" where they cannot be read, None without one."""
    try:
        with open_regular(folder / JOURNAL) as file:
            return str(json.loads(file.readline(_MAX_HEAD))["settings"])
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError):
        return ""


@contextlib.contextmanager
def open_journal(
    folder: Path | str | None,
    settings: str,
    keys: Collection[int | str],
    fields: Mapping[str, type | tuple[type, ...]],
    *,
    contents: Iterable[str] = (),
    restart: bool = False,
    what: str = "runs",
) -> Iterator[Journal]:
    """The journal in a folder, with what is done of the study.

    A study that is complete is started again, whatever its settings, which are by `settings_of`; so
    is any with `restart`. The folder stays as it is until there is a first result; one that was
    made for nothing is removed. Without a folder nothing is kept. `keys` are those of the runs,
    `fields` those of each result with their types in JSON, `contents` the files in the folder that
    the study will write; the message of an interrupt calls runs `what`.

    Raises:
        ScenarioError: the folder has unfinished runs of other settings, another study is running
            in it, or it cannot be written or read.
        StudyInterrupted: Ctrl-C, in the `with` block.
    """
    if folder is None:
        with tempfile.TemporaryFile(buffering=0) as unnamed:
            yield Journal(unnamed, unnamed, Path(), settings)
        return
    folder = as_path(folder)
    is_new = not os.path.lexists(folder)
    require_writable(folder, contents)
    path = folder / JOURNAL
    with contextlib.ExitStack() as stack:
        try:
            is_file = path.is_file() or not os.path.lexists(path)
            require(is_file, "--out", folder, f"its {JOURNAL} is no file; remove it")
            file = stack.enter_context(path.open("a+b", buffering=0))
            reader = stack.enter_context(open_regular(path))
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ScenarioError(
                f"--out = {folder}: another sweep is running in it, or another study; wait for it "
                "or give another folder"
            ) from None
        except OSError as error:
            raise ScenarioError(
                f"--out = {folder}: its {JOURNAL} cannot be used ({error.strerror}); remove it, or "
                "give another folder"
            ) from None
        journal = Journal(file, reader, folder, settings)
        if not restart:
            journal.read(keys, fields)
        try:
            yield journal
        except BaseException as error:
            if path.stat().st_size == 0:
                path.unlink()
                if is_new:
                    with contextlib.suppress(OSError):
                        folder.rmdir()
            if type(error) is KeyboardInterrupt:
                done = f"{len(journal)} of {len(keys)} {what} are in {folder}"
                message = f"{done}; the same call continues from there" if len(journal) else ""
                raise StudyInterrupted(message) from None
            if isinstance(error, OSError) and not isinstance(error, ConnectionError):
                raise ScenarioError(
                    f"--out = {folder}: give a folder with room to write to ({error.strerror})"
                ) from None
            raise
