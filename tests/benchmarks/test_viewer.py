"""What a live view of a scenario costs."""

import json

import pytest
from helpers import nightly_beyond

from benchmarks import viewer
from benchmarks.__main__ import main


@pytest.mark.parametrize(
    ("duration", "repeats"), nightly_beyond(1, "benchmarks", [(0.04, 1), (0.3, 3)])
)
def test_the_cost_of_a_view_is_measured(duration, repeats, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(viewer, "REPEATS", repeats)
    settings = [f"simulation_duration={duration}", "optimization_layer=ConstantParameters"]
    assert main(["viewer", "quintic", "--out", str(tmp_path), "--set", *settings]) == 0
    assert "of real time" in capsys.readouterr().out
    report = json.loads((tmp_path / "viewer.json").read_text())
    assert report["simulated_s"] == duration
    for found in ("cpu_s_with", "cpu_s_without"):
        assert len(report[found]) == repeats
        assert min(report[found]) > 0
