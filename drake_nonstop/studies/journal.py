"""The journal of a study: a line for each run, appended as it ends, to continue from."""

import contextlib
import fcntl
import hashlib
import importlib.util
import json
import os
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from drake_nonstop.studies.files import as_path, require_writable
from drake_nonstop.validation import ScenarioError
from drake_nonstop.version import __version__

JOURNAL = "journal.jsonl"
_IMPORT_PATH = re.compile(r"(?<![\w.])([A-Za-z_]\w*)(?=\.[A-Za-z_])")

Row = dict[str, Any]


class StudyInterrupted(KeyboardInterrupt):
    """Ctrl-C ended a study; the message says how much of it is done."""


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
            with self._path.open("ab") as file:
                file.write(text.encode())
        self.rows[key] = row

    def read(self) -> None:
        """Takes the rows that the file has; drops a last line that was cut short.

        Raises:
            ScenarioError: it has those of other settings, or cannot be read.
        """
        assert self._path is not None
        remedy = "another folder, or --restart (restart=True) to drop it"
        where = f"--out = {self._path.parent}: its {JOURNAL}"
        content = self._path.read_bytes()
        whole = content[: content.rfind(b"\n") + 1]
        os.truncate(self._path, len(whole))
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
) -> Iterator[Journal]:
    """The journal in a folder, with the rows that it has unless it is to `restart`.

    Without a folder nothing is kept. `settings` are those of `settings_of`, `contents` the files
    that the study will write.

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
        except OSError:
            raise ScenarioError(
                f"--out = {folder}: another study is running in it; wait for it, or give another "
                "folder"
            ) from None
        try:
            if restart:
                lock.truncate(0)
            else:
                journal.read()
            yield journal
        except KeyboardInterrupt:
            done = f"{len(journal.rows)} runs are in {folder}; the same call continues from there"
            raise StudyInterrupted(done if journal.rows else "") from None
        except ConnectionError:
            raise
        except OSError as error:
            remedy = f"give a folder with room to write to ({error.strerror})"
            raise ScenarioError(f"--out = {folder}: {remedy}") from None
        finally:
            if path.exists() and path.stat().st_size == 0:
                path.unlink()
                if is_new:
                    with contextlib.suppress(OSError):
                        folder.rmdir()


def settings_of(*texts: str) -> str:
    """A name of the settings in these texts, which differs where results may differ.

    The package's version and the files of the user's own modules that the texts name are part of
    it, so that a study is not continued with other code.
    """
    parts = [__version__, *texts]
    for name in sorted({match for text in texts for match in _IMPORT_PATH.findall(text)}):
        with contextlib.suppress(ImportError, ValueError, OSError, AttributeError, TypeError):
            origin = importlib.util.find_spec(name).origin  # type: ignore[union-attr]
            if "site-packages" not in origin:  # type: ignore[operator]
                parts.append(Path(origin).read_text(errors="replace"))  # type: ignore[arg-type]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()
