"""The benchmark of whole calls of the command, on a short run."""

import json

import pytest

from benchmarks.__main__ import main


@pytest.mark.nightly("benchmarks")
def test_calls_of_two_revisions_are_timed(tmp_path, capsys):
    options = ["--against-revision", "HEAD", "--repeats", "1", "--out", str(tmp_path)]
    assert main(["shell", "quintic", *options, "--set", "simulation_duration=0.1"]) == 0
    results = json.loads((tmp_path / "shell.json").read_text())
    for kind, ratio in results["present_of_other"].items():
        assert 0.2 < ratio < 5
        assert results["present"][kind]["median"] > 0.5
    assert "ratio" in capsys.readouterr().out
