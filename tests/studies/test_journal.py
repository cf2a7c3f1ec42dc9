"""The journal of a study, and where results go."""

import pytest

from drake_nonstop.studies.journal import (
    JOURNAL,
    StudyInterrupted,
    open_journal,
    settings_of,
)
from drake_nonstop.validation import ScenarioError


def write(folder, settings="s", keys="ab", **options):
    with open_journal(folder, settings, **options) as journal:
        for key in keys:
            journal.record(key, {"value": key * 3})


def rows(folder, settings="s", **options):
    with open_journal(folder, settings, **options) as journal:
        return journal.rows


def test_rows_stay_until_a_restart(tmp_path):
    write(tmp_path)
    assert rows(tmp_path) == {"a": {"value": "aaa"}, "b": {"value": "bbb"}}
    assert rows(tmp_path, restart=True) == {}
    assert not (tmp_path / JOURNAL).exists()


def test_a_last_line_that_was_cut_short_is_dropped(tmp_path):
    write(tmp_path)
    path = tmp_path / JOURNAL
    content = path.read_bytes()
    for length in range(len(content)):
        path.write_bytes(content[:length])
        found = rows(tmp_path)
        assert [*found] == ["a", "b"][: max(0, content[:length].count(b"\n") - 1)]
    path.write_bytes(content[:-3])
    write(tmp_path, keys="c")
    assert [*rows(tmp_path)] == ["a", "c"]


@pytest.mark.parametrize(
    "content", [b"x\n", b"[]\n", b'{"settings": "s"}\n3\n', b'{"settings": "s"}\n{}\n', b"\xff\n"]
)
def test_a_damaged_journal_is_refused_in_one_sentence(tmp_path, content):
    (tmp_path / JOURNAL).write_bytes(content)
    with pytest.raises(ScenarioError, match="cannot be read; give another folder, or --restart"):
        rows(tmp_path)
    assert (tmp_path / JOURNAL).read_bytes() == content
    write(tmp_path, restart=True)
    assert len(rows(tmp_path)) == 2


def test_a_journal_that_is_no_file_is_refused(tmp_path):
    (tmp_path / JOURNAL).mkdir()
    with pytest.raises(ScenarioError, match="in the way"):
        rows(tmp_path)


def test_rows_of_other_settings_are_refused(tmp_path):
    write(tmp_path)
    with pytest.raises(ScenarioError, match="of another scenario or other code"):
        rows(tmp_path, "t")
    assert len(rows(tmp_path)) == 2


def test_two_studies_do_not_run_in_one_folder(tmp_path):
    with open_journal(tmp_path, "s"), pytest.raises(ScenarioError, match="is running in it"):
        rows(tmp_path)


def ended_by(error, folder, keys=""):
    with open_journal(folder, "s", what="tasks") as journal:
        for key in keys:
            journal.record(key, {})
        raise error


def test_an_interrupt_tells_what_is_there_and_leaves_no_new_folder(tmp_path):
    new = tmp_path / "new"
    with pytest.raises(StudyInterrupted, match=r"^$"):
        ended_by(KeyboardInterrupt, new)
    assert not new.exists()
    with pytest.raises(StudyInterrupted, match=r"^2 tasks are in .*; the same call continues"):
        ended_by(KeyboardInterrupt, new, "ab")
    assert [*rows(new)] == ["a", "b"]


def test_a_full_disk_loses_nothing_that_was_recorded(tmp_path):
    with pytest.raises(ScenarioError, match="room to write to"):
        ended_by(OSError(28, "No space left on device"), tmp_path, "a")
    assert [*rows(tmp_path)] == ["a"]


def test_other_code_is_other_settings(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tmp_path))
    module = tmp_path / "my_block_of_settings.py"
    module.write_text("a = 1\n")
    text = "phase: !my_block_of_settings.Mine {}"
    before = settings_of("x", text)
    module.write_text("a = 2\n")
    assert settings_of("x", text) != before
