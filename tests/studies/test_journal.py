"""The journal of a study: what is continued, what is refused, and what stays."""

import json
import os
import random

import pytest

from drake_nonstop.scenario.loading import dump_scenario, load_scenario
from drake_nonstop.studies.journal import JOURNAL, StudyInterrupted, open_journal, settings_of
from drake_nonstop.studies.results_folder import default_folder
from drake_nonstop.validation import ScenarioError

FIELDS = {"ending": str, "metrics": dict}
KEYS = range(6)


def result(key):
    return {"ending": "completed", "metrics": {"a": key / 3}}


def write(folder, settings="s", keys=KEYS, is_finished=False, **options):
    with open_journal(folder, settings, KEYS, FIELDS, **options) as journal:
        for key in keys:
            journal.record(key, result(key))
        if is_finished:
            journal.finish()


def read(folder, settings="s", **options):
    with open_journal(folder, settings, KEYS, FIELDS, **options) as journal:
        return {key: journal.result(key) for key in KEYS if key in journal}


def damaged(content, random):
    """The content with some damage that a file may take, or that a person does to it."""
    lines = content.splitlines(keepends=True)
    at, place = random.randrange(len(lines)), random.randrange(len(content))
    junk = bytes(random.randrange(256) for _ in range(random.randrange(1, 40)))
    values = random.choice(
        [
            *(b"", b"0", b"[]", b"null", b"[" * 9999, b"\x00" * 20, b'{"settings":1}'),
            *(b'{"run":0}', b'{"run":99,"ending":"a","metrics":{}}'),
            *(b'{"run":true,"ending":"a","metrics":{}}', b'{"run":1,"ending":1,"metrics":{}}'),
            b'{"run":1e999,"ending":"a","metrics":{}}',
        ]
    )
    return random.choice(
        [
            content[:place],
            content[:place] + junk + content[place:],
            content[:place] + junk,
            junk,
            b"".join(lines[:at] + lines[at + 1 :]),
            b"".join([*lines[:at], values + b"\n", *lines[at:]]),
            b"".join([*lines[:at], values + b"\n", *lines[at + 1 :]]),
            b"".join(lines[at:]),
        ]
    )


def test_a_damaged_journal_is_continued_or_refused_in_one_sentence(tmp_path):
    write(tmp_path)
    content = (tmp_path / JOURNAL).read_bytes()
    endings = {"continued": 0, "refused": 0}
    for seed in range(400):
        (tmp_path / JOURNAL).write_bytes(damaged(content, random.Random(seed)))
        try:
            found = read(tmp_path)
        except ScenarioError as refused:
            sentence = str(refused)
            endings["refused"] += 1
        else:
            sentence = ""
        if sentence:
            assert sentence.startswith(f"--out = {tmp_path}: ")
            assert "\n" not in sentence
            continue
        for one in found.values():
            assert all(isinstance(one[name], kind) for name, kind in FIELDS.items())
        endings["continued"] += 1
        write(tmp_path, keys=[key for key in KEYS if key not in found])
        assert read(tmp_path).keys() == set(KEYS)
    assert min(endings.values()) > 50


@pytest.mark.parametrize("kind", ["folder", "pipe", "link to a device", "link to nowhere"])
def test_a_journal_that_is_no_file_is_refused_in_one_sentence(tmp_path, kind):
    path = tmp_path / JOURNAL
    if kind == "folder":
        path.mkdir()
    elif kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero" if "device" in kind else "/nowhere/at/all")
    with pytest.raises(ScenarioError) as raised:
        read(tmp_path)
    assert JOURNAL in str(raised.value)
    assert "\n" not in str(raised.value)


def test_unfinished_runs_of_other_settings_are_refused_and_finished_ones_replaced(tmp_path):
    write(tmp_path, "one", keys=[0, 1])
    with pytest.raises(ScenarioError, match="another scenario or spec"):
        read(tmp_path, "other")
    assert read(tmp_path, "one") == {key: result(key) for key in (0, 1)}
    write(tmp_path, "one", keys=[2], is_finished=True)
    assert read(tmp_path, "one") == {}
    write(tmp_path, "other", keys=[5])
    assert read(tmp_path, "other") == {5: result(5)}
    write(tmp_path, "one", keys=[3], restart=True)
    assert read(tmp_path, "one") == {3: result(3)}


def test_an_interrupt_before_the_first_result_changes_nothing(tmp_path):
    write(tmp_path, is_finished=True)
    before = (tmp_path / JOURNAL).read_bytes()
    for folder in (tmp_path, tmp_path / "new"):
        with pytest.raises(StudyInterrupted), open_journal(folder, "other", KEYS, FIELDS):
            raise KeyboardInterrupt
    assert (tmp_path / JOURNAL).read_bytes() == before
    assert not (tmp_path / "new").exists()


def test_other_code_is_other_settings(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    module = tmp_path / "my_journalled_blocks.py"
    text = "phase: !my_journalled_blocks.Mine {}"
    found = set()
    for source in ("a = 1", "a = 2"):
        module.write_text(source)
        found.add(settings_of("sweep", text))
        assert settings_of("sweep", text) in found
    assert len(found) == 2
    assert settings_of("sweep", "a", "b") != settings_of("sweep", "ab", "")


def test_default_folders_hold_one_kind_of_settings_each(tmp_path):
    """Any sequence of runs and studies: none is written over another's results."""
    scenarios = [load_scenario("line", [f"simulation_duration={k}"]) for k in (1, 2)]
    kinds = [*scenarios, "study a", "study b"]
    random_ = random.Random(0)
    places = {}
    for _ in range(30):
        k = random_.randrange(len(kinds))
        folder = default_folder(tmp_path / "out", kinds[k])
        assert places.setdefault(k, folder) == folder
        if isinstance(kinds[k], str):
            write(folder, kinds[k], is_finished=random_.random() < 0.5, keys=[])
            with open_journal(folder, kinds[k], KEYS, FIELDS) as journal:
                journal.record(0, result(0))
        else:
            folder.mkdir(exist_ok=True)
            (folder / "scenario.yaml").write_text(dump_scenario(kinds[k]))
    assert sorted(path.name for path in places.values()) == ["out", "out_2", "out_3", "out_4"]
    (tmp_path / "out_5" / JOURNAL).mkdir(parents=True)
    (tmp_path / "out_6").mkdir()
    (tmp_path / "out_6" / JOURNAL).write_text(json.dumps({"sweep": "of an earlier version"}))
    assert default_folder(tmp_path / "out", "study c").name == "out_7"


def run_folder(folder, scenario, **metrics):
    folder.mkdir()
    (folder / "scenario.yaml").write_text(dump_scenario(scenario))
    (folder / "metrics.json").write_text(
        json.dumps({"is_steered": False, "versions": {}} | metrics)
    )


def test_what_cannot_be_repeated_or_is_no_results_folder_is_left_alone(tmp_path):
    scenario = load_scenario("line")
    run_folder(tmp_path / "out", scenario, is_steered=True)
    run_folder(tmp_path / "out_2", scenario)
    (tmp_path / "out_2" / "scenario.yaml").unlink()
    (tmp_path / "out_3").write_text("a file")
    (tmp_path / "out_4").symlink_to("nowhere")
    run_folder(tmp_path / "out_5", scenario)
    (tmp_path / "out_5" / "metrics.json").write_text("{")
    assert default_folder(tmp_path / "out", scenario).name == "out_6"
    assert default_folder(tmp_path / "out", "study").name == "out_6"
    run_folder(tmp_path / "out_6", scenario)
    assert default_folder(tmp_path / "out", scenario).name == "out_6"
    assert default_folder(tmp_path / "out", "study").name == "out_7"
