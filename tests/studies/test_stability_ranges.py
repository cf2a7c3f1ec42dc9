"""The margins of the loop's stability, by the command."""

import functools
import json

import numpy as np
from PIL import Image

from drake_nonstop.analysis.stability import Stability
from drake_nonstop.cli import studies as command
from drake_nonstop.cli.ending import BAD_INPUT
from drake_nonstop.cli.main import main
from drake_nonstop.studies import stability_ranges
from drake_nonstop.validation import ScenarioError


def test_stability_finds_the_edges_and_draws_them(tmp_path, capsys, monkeypatch):
    axes = stability_ranges._axes

    def few(scenario):
        mass, _, _, delay, _ = axes(scenario)
        mass.values, delay.values = [-1.0, 0.2, 0.8], [0.02, 0.03, 1e9]
        return [mass, delay]

    monkeypatch.setattr(stability_ranges, "_axes", few)
    overrides = ["load_feedback=!NoisyFeedback {}"]
    arguments = ["stability", "quintic", "--out", str(tmp_path), "--set", *overrides]
    assert main(arguments) == 0
    shown = capsys.readouterr().out
    assert "stable" in shown.splitlines()[0]
    refusal = "is refused: simulated.carrier_mass = -1.0: "
    assert any(line.strip().startswith(f"-1 {refusal}") for line in shown.splitlines())
    assert "stable from 0 to 0.02, below that not tried" in shown
    report = json.loads((tmp_path / "stability.json").read_text())
    assert report["largest_multiplier"] < 1.0001
    mass, delay = report["margins"]
    assert [*mass["refused"]] == ["-1.0"]
    assert mass["refused"]["-1.0"].startswith("simulated.carrier_mass = -1.0: ")
    assert [*delay["refused"]] == ["1000000000.0"]
    assert mass["nominal"] == 0.1
    assert mass["low"] is None
    assert 0.2 <= mass["high"] < 0.8
    for value, largest in zip(mass["values"], mass["largest"], strict=True):
        assert (largest < 1.0001) == (value <= mass["high"])
    assert delay["high"] == 0.02
    with Image.open(tmp_path / "stability.png") as picture:
        assert picture.width > 500


def test_the_loop_as_it_is_comes_before_what_is_changed(tmp_path, capsys, monkeypatch):
    def interrupted(*given, **options):
        raise ScenarioError(f"first: {capsys.readouterr().out}")

    monkeypatch.setattr(command, "find_margins", interrupted)
    told = []
    monkeypatch.setattr(command, "linearize", functools.partial(_unstable, told))
    arguments = ["stability", "quintic", "--out", str(tmp_path / "out")]
    assert main(arguments) == BAD_INPUT
    shown = capsys.readouterr().err
    assert "first: largest multiplier     2 in a turn of 1 s (+0.693 1/s): unstable" in shown
    assert "least stable mode      cables 90%, phase 10%, 3 rad/s" in shown

    monkeypatch.setattr(command, "require_drawing", None)  # nothing is drawn or written
    assert main([*arguments[:-1], str(tmp_path / "quick"), "--quick"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 2
    assert told == [0.5] * 3
    assert not (tmp_path / "quick").exists()


def _unstable(told, scenario, progress):
    progress("linearizing", 0.5)
    told.append(0.5)
    return Stability(
        period=1.0, multipliers=np.array([2.0]), frequency=3.0, shares={"phase": 0.1, "cables": 0.9}
    )


def test_ranges_say_what_lies_beyond_them():
    tried = {"name": "mass", "unit": "kg", "nominal": 1.0, "largest": [], "rates": []}
    range_ = functools.partial(
        stability_ranges.Margin, **tried, values=[0.5, 1.0, 2.0], low=None, high=None
    )
    text = "stable from 0.5 to 2, below that not tried, above that refused"
    assert command._stable_range(range_(refused={4.0: "why"})) == text
    assert command._stable_range(range_(refused={1.0: "why"})) == "refused here"
