"""The journal of a study: a line for each run, appended as it comes, to continue from."""

import contextlib
import fcntl
import hashlib
import importlib.util
import json
import os
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from drake_nonstop.studies.files import (
    as_path,
    open_regular,
    read_regular,
    remove_unfinished,
    require_writable,
)
from drake_nonstop.validation import ScenarioError
from drake_nonstop.version import __version__

JOURNAL = "journal.jsonl"
_IMPORT_PATH = re.compile(r"(?<![\w.])([A-Za-z_]\w*)(?=\.[A-Za-z_])")

Row = dict[str, Any]


class StudyInterrupted(KeyboardInterrupt):
    """Ctrl-C ended a study; the message says how much of it is done."""

    found: Any = None  # what `design`, which has no folder, had found


class Journal:
    """The rows of a study by their keys, each of which is in the file once it is recorded."""

    def __init__(self, path: Path | None, settings: str):
        self.rows: dict[str, Row] = {}
        self._path = path
        self._settings = settings

    def record(self, key: str, row: Row) -> None:
        """Appends a row; the first one makes the file."""
        if self._path is not None:
            text = json.dumps({"key": key, **row}) + "\n"
            if not self._path.exists() or self._path.stat().st_size == 0:
                text = json.dumps({"settings": self._settings}) + "\n" + text
            with self._path.open("ab", buffering=0) as file:
                content = text.encode()
                while content:
                    content = content[file.write(content) :]
        self.rows[key] = row

    def read(self) -> None:
        """Takes the rows that the file has; drops a last line that was cut short.

        Raises:
            ScenarioError: it has those of other settings, or cannot be read.
        """
        assert self._path is not None
        remedy = "another folder, or --restart (restart=True) to drop it"
        where = f"--out = {self._path.parent}: its {JOURNAL}"
        with self._path.open("r+b") as file:
            content = file.read()
            whole = content[: content.rfind(b"\n") + 1]
            file.truncate(len(whole))
        if not whole:
            return
        try:
            head, *lines = map(json.loads, whole.splitlines())
            settings, self.rows = head["settings"], {line.pop("key"): line for line in lines}
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            raise ScenarioError(f"{where} cannot be read; give {remedy}") from None
        if settings != self._settings:
            raise ScenarioError(f"{where} is of another scenario or other code; give {remedy}")


@contextlib.contextmanager
def open_journal(
    folder: Path | str | None,
    settings: str,
    *,
    contents: Iterable[str] = (),
    restart: bool = False,
    what: str = "runs",
) -> Iterator[Journal]:
    """The journal in a folder, with the rows that it has unless it is to `restart`.

    Without a folder nothing is kept. `settings` are those of `settings_of`, `contents` the files
    that the study will write; the message of an interrupt calls its rows `what`.

    Raises:
        ScenarioError: the folder has rows of other settings, another study is running in it, or it
            cannot be written.
        StudyInterrupted: Ctrl-C, in the `with` block.
    """
    if folder is None:
        yield Journal(None, settings)
        return
    folder = as_path(folder)
    is_new = not os.path.lexists(folder)
    require_writable(folder, [JOURNAL, *contents])
    path = folder / JOURNAL
    journal = Journal(path, settings)
    with path.open("ab") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ScenarioError(
                f"--out = {folder}: another study is running in it; wait for it, or give another "
                "folder"
            ) from None
        for place in [folder, *filter(Path.is_dir, folder.glob("*"))]:
            remove_unfinished(place)
        try:
            if restart:
                lock.truncate(0)
            else:
                journal.read()
            yield journal
        except KeyboardInterrupt:
            done = f"{len(journal.rows)} {what} are in {folder}; the same call continues from there"
            raise StudyInterrupted(done if journal.rows else "") from None
        except OSError as error:
            if isinstance(error, ConnectionError):
                raise
            raise ScenarioError(
                f"--out = {folder}: give a folder with room to write to ({error.strerror})"
            ) from None
        finally:
            if path.exists() and path.stat().st_size == 0:
                path.unlink()
                if is_new:
                    with contextlib.suppress(OSError):
                        folder.rmdir()


def journalled_settings(folder: Path) -> str | None:
    """The settings of the study in a folder; "" where they cannot be read, None without one."""
    try:
        with open_regular(folder / JOURNAL) as file:
            return str(json.loads(file.readline(1000))["settings"])
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError):
        return ""


def settings_of(*texts: str) -> str:
    """A name of the settings in these texts, which differs where results may differ.

    The package's version and the modules that the texts name are part of it, so that a study is
    not continued with other code.
    """
    return _hashed([__version__, *texts, *_own_code(texts)])


def own_code_of(text: str) -> str | None:
    """A name of the source of the user's own modules that a text names; None: it names none."""
    code = _own_code([text])
    return _hashed(code) if code else None


def _hashed(parts: Iterable[str]) -> str:
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


def is_written(folder: Path, item: str, text: str) -> bool:
    """Whether a file in a folder has this text."""
    try:
        return read_regular(folder / item) == text.encode()
    except (OSError, ValueError):
        return False


def key_of(parts: Mapping[str, Any]) -> str:
    """A short name of a run by what it depends on."""
    return hashlib.sha256(json.dumps(parts, default=str).encode()).hexdigest()[:20]
