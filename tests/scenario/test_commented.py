"""The scenario file to start from."""

import functools
import itertools

import pytest
import yaml
from helpers import nightly_beyond

from drake_nonstop.cli.main import main
from drake_nonstop.scenario.describe import commented_scenario
from drake_nonstop.scenario.loading import (
    dump_scenario,
    load_scenario,
    parse_scenario,
    scenario_names,
)

# One with a plan, one of aircraft in a wind that changes, one without control, and the others.
TELLING = ["quintic", "aircraft_transfer_gusty", "static_hold_open_loop"]
NAMES = nightly_beyond(len(TELLING), "examples", dict.fromkeys([*TELLING, *scenario_names()]))


@functools.cache
def commented(name):
    return commented_scenario(load_scenario(name), "mine")


@pytest.mark.parametrize("name", NAMES)
def test_the_file_is_the_scenario_that_it_copies(name):
    scenario = load_scenario(name)
    text = commented(name)
    read = parse_scenario(text)
    assert read.name == "mine"
    read.name = name
    assert dump_scenario(read) == dump_scenario(scenario)
    comments = [line for line in text.splitlines() if line.lstrip().startswith("#")]
    assert max(map(len, comments)) <= 100


def test_each_number_of_a_box_has_a_unit_or_meaning():
    text = commented("quintic")
    assert "cable_length: 0.8                         # m, unstretched" in text
    assert "# or AccumulatedPhase, PaperPhase\n  phase: !ShapedPhase\n" in text
    lines = text.splitlines()
    boxes = lines[lines.index("  pattern: !HamiltonianCycle") - 1 : lines.index("  scene:")]
    for before, line in itertools.pairwise(boxes):
        if line.startswith("    ") and not line.strip().startswith("#"):
            assert "#" in line or before.strip().startswith("#"), line


def test_a_comment_on_several_fields_stands_in_lines_of_its_own():
    text = commented("quintic")
    limits = " ".join(text.split("  limits:\n")[1].split("\n\n  # ")[0].replace("#", "").split())
    assert limits.startswith("Beyond one of these the outcome is not ok. The reach is the distance")
    assert "deg) from its reference. carrier_distance: 0.05 of the reach; two" in limits
    assert (
        "    # Beyond one of these the model is not plausible, which is warned about.\n\n" in text
    )
    assert "    speed: 100.0                              # m/s, of a carrier\n" in text


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_new_writes_a_file_that_runs_and_replaces_none(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["new", "mine", "--from", "three_carriers"]) == 0
    (name,) = yaml.compose((tmp_path / "mine.yaml").read_text()).value[0][:1]
    assert name.value == "mine"
    brief = ["--quiet", "--no-figures", "--no-replay", "--set", "simulation_duration=0.05"]
    brief += ["optimization_layer=ConstantParameters"]
    assert main(["run", "mine.yaml", *brief]) == 0
    before = (tmp_path / "mine.yaml").read_bytes()
    assert main(["new", "mine"]) == 2
    assert "it exists; give another name" in capsys.readouterr().err
    assert (tmp_path / "mine.yaml").read_bytes() == before


BAD_NAMES = ["mine.txt", "no_folder/mine.yaml", "a b.yaml", ".yaml"]


@pytest.mark.parametrize("name", nightly_beyond(2, "adversary", BAD_NAMES))
def test_a_name_that_cannot_be_used_is_refused_and_nothing_written(
    tmp_path, monkeypatch, capsys, name
):
    monkeypatch.chdir(tmp_path)
    assert main(["new", name]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert not list(tmp_path.iterdir())
