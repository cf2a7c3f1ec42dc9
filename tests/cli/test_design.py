"""`drake-nonstop design`, as a user meets it."""

import dataclasses
import json
import re
import shlex
import signal
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from drake_nonstop.cli.ending import BAD_INPUT, FAILED, INTERRUPTED
from drake_nonstop.cli.main import main
from drake_nonstop.planning.formation_program import FormationVariables
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.studies import design
from drake_nonstop.studies.design import Design
from drake_nonstop.studies.design_request import read_request
from drake_nonstop.studies.formation_search import Refusal

SMALL = ["carriers=[3]", "kinds=[co_rotating]", "cable_length=[60, 60]", "starts=1"]


@pytest.mark.nightly("examples")
def test_the_commands_of_the_page_make_scenarios_a_table_and_a_figure(
    tmp_path, capsys, monkeypatch
):
    page = (Path(__file__).parents[2] / "docs" / "howto_design.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```sh\n(.*?)```", page, re.DOTALL)
    (*printing, redirection, file), designing, *others = [
        shlex.split(line, comments=True)[1:] for block in blocks for line in block.splitlines()
    ]
    monkeypatch.chdir(tmp_path)
    assert (main(printing), redirection) == (0, ">")
    Path(file).write_text(capsys.readouterr().out)
    assert main([*designing, "--set", *SMALL]) == 0
    shown = capsys.readouterr().out
    assert "formation_1*" in shown
    assert "formation_1: breaks first at wind" in shown
    assert "formations keep the margins" in shown
    assert [command for command, _ in others] == ["check", "run"]
    for _, path in others:
        scenario = load_scenario(Path(path))
        assert (scenario.name, scenario.system.load_mass) == ("formation_1", 5.0)
        assert scenario.wind.velocity == [2.0, 0.0, 0.0]
    folder = Path(path).parent
    report = json.loads((folder / "design.json").read_text())
    assert report["is_feasible"]
    names = [formation["scenario"] for formation in report["formations"]]
    files = {"request.yaml", "design.json", "pareto.png", *(f"{name}.yaml" for name in names)}
    assert {path.name for path in folder.iterdir()} == files
    with Image.open(folder / "pareto.png") as picture:
        assert picture.width > 2000


def test_a_printed_request_has_units_and_reads_back(tmp_path, capsys):
    assert main(["design", "--print-request", "--set", "load_mass=3", "aircraft.mass=7"]) == 0
    text = capsys.readouterr().out
    assert re.search(r"\ncable_length: \[60.0, 200.0\] +# m, least and largest\n", text)
    file = tmp_path / "formation.yaml"
    file.write_text(text)
    assert read_request(file) == read_request(None, ["load_mass=3", "aircraft.mass=7"])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["formation.yaml"]


def test_what_cannot_be_is_said_and_another_request_has_a_folder_of_its_own(
    tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    other = tmp_path / "out" / "design" / "formation"
    other.mkdir(parents=True)
    (other / "request.yaml").write_text("load_mass: 1.0\n")
    missed = Refusal(
        kind="leaning",
        carriers=3,
        phase_turns=1,
        variables=FormationVariables(*np.ones(9), reserve=-1.0),
        why="it banks",
        remedy="less",
    )

    def none(request, progress):
        return Design(request=request, formations=(), refusals=(missed,))

    monkeypatch.setattr(design, "design", none)
    assert main(["design", "--set", *SMALL]) == FAILED
    shown = capsys.readouterr().out
    assert shown.startswith("1 kinds and numbers of carriers, 1 at a time, up to a minute each")
    assert "3 leaning, is at -1 of them: it banks; give less" in shown
    assert "results: out/design/formation_2" in shown
    assert (other / "request.yaml").read_text() == "load_mass: 1.0\n"
    assert not (tmp_path / "out" / "design" / "formation_2" / "pareto.png").exists()


def test_ctrl_c_while_files_are_written_keeps_them(tmp_path, capsys, monkeypatch):
    scenario = dataclasses.replace(load_scenario("aircraft_rest"), name="formation_1")

    class Found:
        formations = (SimpleNamespace(scenario=scenario),)
        verdict = ""

        @property
        def dictionary(self):
            return {"end": signal.raise_signal(signal.SIGINT)}

    monkeypatch.setattr(design, "design", lambda request, _: Found())
    assert main(["design", "--out", str(tmp_path), "--set", *SMALL]) == INTERRUPTED
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"request.yaml", "design.json", "formation_1.yaml"}


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["none.yaml"], "REQUEST = none.yaml: give a file that can be read"),
        (["--set", "speed=-1"], "request.speed = -1.0: give 0 to 1000 m/s"),
    ],
)
def test_bad_input_is_refused_before_anything_is_written(
    tmp_path, capsys, monkeypatch, arguments, sentence
):
    monkeypatch.chdir(tmp_path)
    assert main(["design", *arguments]) == BAD_INPUT
    error = capsys.readouterr().err
    assert error.startswith(f"drake-nonstop: {sentence}")
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()
