"""`drake-nonstop design`, as a user meets it."""

import numpy as np
import pytest

from drake_nonstop.cli.ending import BAD_INPUT, FAILED
from drake_nonstop.cli.main import main
from drake_nonstop.planning.formation_program import FormationVariables
from drake_nonstop.studies import design
from drake_nonstop.studies.design import Design
from drake_nonstop.studies.formation_search import Refusal

SMALL = ["carriers=[3]", "kinds=[co_rotating]", "cable_length=[60, 60]", "starts=1"]


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
        variables=FormationVariables(*np.ones(6), reserve=-1.0),
        why="it banks",
    )

    def none(request, progress):
        return Design(request=request, formations=(), refusals=(missed,))

    monkeypatch.setattr(design, "design", none)
    assert main(["design", "--set", *SMALL]) == FAILED
    shown = capsys.readouterr().out
    assert shown.startswith("1 kinds and numbers of carriers, 1 at a time, up to a minute each")
    assert "3 leaning, is at -1 of them: it banks; give longer cables" in shown
    assert "results: out/design/formation_2" in shown
    assert (other / "request.yaml").read_text() == "load_mass: 1.0\n"
    assert not (tmp_path / "out" / "design" / "formation_2" / "pareto.png").exists()


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
