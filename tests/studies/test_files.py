"""Files of results: whole or not at all."""

import contextlib
import os

import numpy as np
import pytest

from drake_nonstop.studies.files import (
    as_path,
    free_folder,
    replacing_file,
    replacing_files,
    require_writable,
    require_writable_file,
    write_json,
)
from drake_nonstop.validation import ScenarioError


def test_files_replace_earlier_ones_together_and_none_on_an_error(tmp_path):
    (tmp_path / "old").mkdir()
    for name in ("a", "b", "old/c"):
        (tmp_path / name).write_text("before")
    items = ["a", "b", "old/c", "new/d"]
    with contextlib.suppress(ZeroDivisionError), replacing_files(tmp_path, items) as new:
        (new / "a").write_text("after")
        raise ZeroDivisionError
    assert (tmp_path / "a").read_text() == "before"
    with replacing_files(tmp_path, items) as new:
        (new / "new").mkdir()
        for name in ("a", "new/d"):
            (new / name).write_text("after")
    left = {str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*")}
    assert left == {"a", "new", "new/d"}


def test_what_is_in_the_way_is_said_before(tmp_path):
    (tmp_path / "signals.npz").mkdir()
    with pytest.raises(ScenarioError, match=r"its signals.npz is no file, and in the way"):
        require_writable(tmp_path, ["signals.npz"])
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", tmp_path / "signals.npz"):
        with pytest.raises(ScenarioError, match="give another file"):
            require_writable_file(path)
    (tmp_path / "figures").write_text("")
    with pytest.raises(ScenarioError, match="its file figures is in the way"):
        require_writable(tmp_path, ["figures/a.png"])


@pytest.mark.parametrize("name", ["a\0b", "x" * 300])
def test_a_name_that_is_none_is_one_sentence(tmp_path, name):
    with pytest.raises(ScenarioError, match="give a folder that can be written"):
        require_writable(tmp_path / name)


def test_a_full_disk_is_said_before(tmp_path):
    with pytest.raises(ScenarioError, match="with room for 1000000000000 MB"):
        require_writable(tmp_path, room=1e18)


def test_what_is_no_path_is_one_sentence():
    with pytest.raises(ScenarioError, match="folder = 3: give a path"):
        as_path(3)


def test_a_folder_that_is_gone_is_one_sentence(tmp_path):
    with pytest.raises(ScenarioError, match="--out = "), replacing_file(tmp_path / "no" / "a"):
        pass


def test_numbers_of_numpy_are_written_as_those_of_python(tmp_path):
    write_json(tmp_path / "a.json", {"a": np.float64(0.5), "b": np.nan, "c": [np.int64(3)]})
    assert (tmp_path / "a.json").read_text().split() == (
        ["{", '"a":', "0.5,", '"b":', "null,", '"c":', "[", "3", "]", "}"]
    )


def test_results_of_other_settings_have_folders_of_their_own(tmp_path):
    place = tmp_path / "quintic"
    assert free_folder(place, "scenario.yaml", "a") == place
    place.mkdir()
    (place / "scenario.yaml").write_text("a")
    assert free_folder(place, "scenario.yaml", "a") == place
    assert free_folder(place, "scenario.yaml", "b") == tmp_path / "quintic_2"
