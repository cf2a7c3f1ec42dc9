"""The margins of the loop's stability, by the command."""

import json

from PIL import Image

from drake_nonstop.cli.main import main
from drake_nonstop.studies import margins


def test_stability_finds_the_edges_and_draws_them(tmp_path, capsys, monkeypatch):
    axes = margins._axes

    def few(scenario):
        mass, _, _, delay, _ = axes(scenario)
        mass.values, delay.values = [0.2, 0.8], [0.02, 0.03]
        return [mass, delay]

    monkeypatch.setattr(margins, "_axes", few)
    overrides = ["load_feedback=!NoisyFeedback {}"]
    arguments = ["stability", "quintic", "--out", str(tmp_path), "--set", *overrides]
    assert main(arguments) == 0
    shown = capsys.readouterr().out
    assert "stable" in shown.splitlines()[0]
    report = json.loads((tmp_path / "stability.json").read_text())
    assert report["largest_multiplier"] < 1.0001
    mass, delay = report["margins"]
    assert mass["nominal"] == 0.1
    assert mass["low"] is None
    assert 0.2 <= mass["high"] < 0.8
    for value, largest in zip(mass["values"], mass["largest"], strict=True):
        assert (largest < 1.0001) == (value <= mass["high"])
    assert delay["high"] == 0.02
    with Image.open(tmp_path / "stability.png") as picture:
        assert picture.width > 500
