"""The commands that report on a scenario: stability, robustness, the cost of a view."""

import json

import pytest
from PIL import Image

from drake_nonstop.cli.main import main
from drake_nonstop.studies import robustness, stability


def test_stability_finds_the_edges_and_draws_them(tmp_path, capsys, monkeypatch):
    axes = stability._axes

    def few(scenario):
        mass, _, _, delay, _ = axes(scenario)
        mass.values, delay.values = [0.2, 0.8], [0.0, 0.03, 0.04]
        return [mass, delay]

    monkeypatch.setattr(stability, "_axes", few)
    monkeypatch.setattr(stability, "_BISECTIONS", 1)
    settings = ["load_feedback=!NoisyFeedback {}"]
    arguments = ["stability", "quintic", "--out", str(tmp_path), "--set", *settings]
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
    assert delay["high"] == 0.03
    assert Image.open(tmp_path / "stability.png").width > 500


def test_robustness_runs_each_error(tmp_path, capsys, monkeypatch):
    errors = robustness._errors
    wanted = ("none", "load mass", "gusty wind")
    monkeypatch.setattr(
        robustness, "_errors", lambda *given: [e for e in errors(*given) if e[0] in wanted]
    )
    arguments = ["robustness", "quintic", "--out", str(tmp_path), "--set", "duration=1"]
    assert main(arguments) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len([line for line in lines if line.startswith(wanted)]) == 9
    cases = json.loads((tmp_path / "robustness.json").read_text())["cases"]
    assert [case["error"] for case in cases] == ["none"] + ["load mass"] * 4 + ["gusty wind"] * 4
    assert all(case["completed"] for case in cases)
    none, *others = (case["position_error_mean"] for case in cases)
    assert all(error > 1.5 * none for error in others)
    assert Image.open(tmp_path / "robustness.png").width > 300


def test_each_error_of_the_report_makes_a_scenario():
    from drake_nonstop.diagrams.nonstop import make_nonstop
    from drake_nonstop.scenario.loading import changed, load_scenario

    built = set()
    for name in ("quintic", "three_carriers"):
        scenario = load_scenario(name)
        for error, _, _, settings in robustness._errors(scenario, 0):
            changed_scenario = changed(scenario, settings)
            if (name, error) not in built:
                make_nonstop(changed_scenario)
            built.add((name, error))
    assert len(built) == 2 * 9


def test_the_cost_of_a_view_is_a_small_share(tmp_path, capsys):
    arguments = ["bench", "viewer", "quintic", "--out", str(tmp_path), "--set", "duration=0.3"]
    assert main(arguments) == 0
    assert "of real time" in capsys.readouterr().out
    report = json.loads((tmp_path / "viewer.json").read_text())
    assert report["simulated_s"] == 0.3
    assert len(report["cpu_s_with"]) == len(report["cpu_s_without"]) == 3


@pytest.mark.parametrize("seed", ["-1"])
def test_bad_seed(seed, tmp_path, capsys):
    arguments = ["robustness", "quintic", "--out", str(tmp_path), "--seed", seed]
    assert main(arguments) == 2
    assert "--seed = -1" in capsys.readouterr().err
