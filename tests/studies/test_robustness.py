"""Errors that the controllers do not know of, one at a time."""

import json

import pytest
from helpers import nightly_beyond
from PIL import Image

from drake_nonstop.cli.main import main
from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.scenario.overrides import changed
from drake_nonstop.studies import robustness

PLAIN = "optimization_layer=ConstantParameters"
CASES = ("none", 0.0), ("load mass", 20.0)


def test_progress_tells_the_cases_that_are_not_ok(tmp_path, monkeypatch):
    """Also of cases that an interrupted call has left in the folder."""
    said = []

    def run(function, keys, arguments, record, failed, *, what, **options):
        for outcome in ("ok", "collision"):
            key = len(said)
            record(key, {"ending": "completed", "message": "", "metrics": {"outcome": outcome}})
            said.append(what())
        raise KeyboardInterrupt

    monkeypatch.setattr(robustness, "run_all", run)
    scenario = load_scenario("quintic", [PLAIN])
    for kept in (2, 4):
        with pytest.raises(KeyboardInterrupt, match=f"^{kept} of 33 cases are in "):
            robustness.robustness(scenario, folder=tmp_path)
    assert said == [
        "simulating, 0 of 1 not ok",
        "simulating, 1 of 2 not ok (load mass -20 %)",
        "simulating, 1 of 3 not ok (load mass -20 %)",
        "simulating, 2 of 4 not ok (load mass +10 %)",
    ]


@pytest.mark.nightly("studies")
def test_robustness_runs_each_error(tmp_path, capsys, monkeypatch):
    errors = robustness._errors
    wanted = ("none", "load mass", "gusty force")
    monkeypatch.setattr(
        robustness, "_errors", lambda *given: [e for e in errors(*given) if e[0] in wanted]
    )
    arguments = [
        "robustness",
        "quintic",
        "--out",
        str(tmp_path),
        "--set",
        "simulation_duration=1",
        PLAIN,
    ]
    assert main(arguments) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len([line for line in lines if line.startswith(wanted)]) == 9
    cases = json.loads((tmp_path / "robustness.json").read_text())["cases"]
    assert [case["error"] for case in cases] == ["none"] + ["load mass"] * 4 + ["gusty force"] * 4
    assert all(case["ending"] == "completed" for case in cases)
    none, *others = (case["metrics"]["load.position_error_mean_m"] for case in cases)
    assert all(error > 1.5 * none for error in others)
    with Image.open(tmp_path / "robustness.png") as picture:
        assert picture.width > 300


@pytest.mark.nightly("studies")
def test_the_outcome_and_the_warnings_of_each_case_are_said_with_it(tmp_path, capfd, monkeypatch):
    errors = robustness._errors
    monkeypatch.setattr(
        robustness, "_errors", lambda *given: [e for e in errors(*given) if e[:2] in CASES]
    )
    arguments = [
        "robustness",
        "quintic",
        "--out",
        str(tmp_path),
        "--set",
        "simulation_duration=0.5",
        PLAIN,
    ]
    # The step is shortened in every case, and a load that is too heavy counts as lost.
    arguments += ["simulator_config.max_step_size=0.02", "limits.position_error=0.0002"]
    assert main(arguments) == 0
    lines = capfd.readouterr().out.splitlines()
    assert not [line for line in lines if line.startswith("warning")]
    cases = json.loads((tmp_path / "robustness.json").read_text())["cases"]
    assert [case["metrics"]["outcome"] for case in cases] == ["ok", "load_lost"]
    for case, error in zip(cases, CASES, strict=True):
        (number,) = [k for k, line in enumerate(lines) if line.startswith(error[0])][-1:]
        assert lines[number].endswith(f"  {case['metrics']['outcome']}")
        said = case["metrics"]["reasons"] + case["metrics"]["warnings"]
        assert any("0.02" in sentence for sentence in case["metrics"]["warnings"])
        assert lines[number + 1] == f"    {said[0]}"
    assert "the load was" in cases[1]["metrics"]["reasons"][0]


@pytest.mark.parametrize("name", nightly_beyond(1, "studies", ["quintic", "three_carriers"]))
def test_each_error_of_the_report_makes_a_scenario(name):
    scenario = load_scenario(name, [PLAIN])
    built = set()
    for error, _, _, overrides in robustness._errors(scenario, 0):
        changed_scenario = changed(scenario, overrides)
        if error not in built:
            make_nonstop(changed_scenario)
        built.add(error)
    assert len(built) == 9


@pytest.mark.parametrize(
    ("fault", "ending", "words"),
    [
        ("raises", "failed", "the wind broke"),
        ("diverges", "diverged", "diverged at t = 0.05"),
        ("dies", "failed", "its process died"),
    ],
)
def test_a_run_that_does_not_complete_says_how_it_ended(
    tmp_path, capsys, monkeypatch, faulty_blocks, fault, ending, words
):
    errors = robustness._errors
    monkeypatch.setattr(
        robustness,
        "_errors",
        lambda *given: [e for e in errors(*given) if e[0] in ("none", "constant force")],
    )
    arguments = ["robustness", "quintic", "--out", str(tmp_path), "--trust", "--set"]
    arguments += [
        "simulation_duration=0.1",
        PLAIN,
        f"load_disturbance=!faulty_blocks.FaultyWind {{fault: {fault}}}",
    ]
    assert main(arguments) == 0
    lines = capsys.readouterr().out.splitlines()
    none = next(line for line in lines if line.startswith("none"))
    pushed = [line for line in lines if line.startswith("constant force")]
    assert none.endswith(f"  {ending}")
    assert len(pushed) == 4
    assert not any(line.endswith(("failed", "diverged")) for line in pushed)
    first, *others = json.loads((tmp_path / "robustness.json").read_text())["cases"]
    assert first["ending"] == ending
    assert words in first["message"]
    assert ("load.position_error_mean_m" not in first["metrics"]) == (fault == "dies")
    assert {case["ending"] for case in others} == {"completed"}


@pytest.mark.nightly("studies")
def test_an_error_with_which_nothing_can_be_built_is_a_row_of_its_own(
    tmp_path, capsys, monkeypatch
):
    """With cables that are too long they are all slack; without error a loop has to be built."""
    errors = [
        ("none", 0.0, "", []),
        ("cable length", 5.0, "%", ["simulated.cable_length=1.2"]),
        ("load mass", 1.0, "%", ["simulated.load_mass=1.01"]),
    ]
    monkeypatch.setattr(robustness, "_errors", lambda *given: errors)
    arguments = ["robustness", "quintic", "--out", str(tmp_path)]
    arguments += ["--set", "simulation_duration=0.1", PLAIN]
    assert main(arguments) == 0
    lines = capsys.readouterr().out.splitlines()
    cases = json.loads((tmp_path / "robustness.json").read_text())["cases"]
    assert [case["ending"] for case in cases] == ["completed", "unbuildable", "completed"]
    (row,) = [k for k, line in enumerate(lines) if line.startswith("cable length +5 %")]
    assert lines[row].endswith("  unbuildable")
    assert lines[row + 1] == f"    {cases[1]['message']}"
    assert "all of them are slack" in cases[1]["message"]
    assert (tmp_path / "robustness.png").exists()
    assert main([*arguments, "simulated.cable_length=1.2"]) == 2
    assert "all of them are slack" in capsys.readouterr().err


@pytest.mark.parametrize("seed", ["-1"])
def test_bad_seed(seed, tmp_path, capsys):
    arguments = ["robustness", "quintic", "--out", str(tmp_path), "--seed", seed]
    assert main(arguments) == 2
    assert "--seed = -1" in capsys.readouterr().err


def test_a_filter_behind_the_measurement_stays_under_each_error():
    filtered = "load_feedback=!EstimatedFeedback {position_noise: 0.01, process_acceleration: 3}"
    scenario = load_scenario("quintic", [filtered])
    errors = [e for e in robustness._errors(scenario, 1) if e[0] in ("noise", "delay")]
    for name, _, _, overrides in errors:
        feedback = changed(scenario, overrides).load_feedback
        assert feedback.process_acceleration == 3
        assert (feedback.position_noise > 0, feedback.delay > 0) == (
            name == "noise",
            name == "delay",
        )
