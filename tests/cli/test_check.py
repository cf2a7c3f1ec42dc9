"""`drake-nonstop check`, as a user meets it."""

import contextlib
import json
import re

import pytest
from matplotlib.figure import Figure
from PIL import Image

from drake_nonstop.cli import check
from drake_nonstop.cli.ending import BAD_INPUT, FAILED
from drake_nonstop.cli.main import main
from drake_nonstop.scenario.loading import dump_scenario, load_scenario

# Refused by what the loop is built from, and by what a run is flown with.
REFUSED = [
    "optimization_layer.max_speed=0.5",
    "simulator_config.integration_scheme=euler",
]
SHORT = "simulation_duration=0.2"  # the aircraft's margins are those of a load at rest
RASCAL = "system.aircraft.model=rascal_110"


@pytest.fixture
def plain_figures(monkeypatch):
    """Empty figures, in less time."""
    for name in ("make_check_figure", "make_aircraft_margins_figure"):
        monkeypatch.setattr(check, name, lambda found: Figure(figsize=(12, 8)))


@pytest.mark.parametrize("override", REFUSED)
def test_what_a_run_refuses_the_check_refuses_in_the_same_words(override, tmp_path, capsys):
    told = []
    for command in ("run", "check"):
        arguments = [command, "quintic", "--out", str(tmp_path / command), "--set", SHORT, override]
        assert main(arguments) == BAD_INPUT
        told.append(capsys.readouterr().err.strip().splitlines()[-1])
    assert told[0] == told[1]


@pytest.mark.nightly("flights")
def test_a_spread_carousel_is_refused_with_the_numbers(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(check, "make_check_figure", lambda found: Figure())
    folder = tmp_path / "a"
    arguments = ["check", "real_scale_spread", "--out", str(folder), "--set", RASCAL, SHORT]
    assert main(arguments) == FAILED
    *table, verdict, place = capsys.readouterr().out.splitlines()
    assert any(line.startswith("climb or descent") and "43.0 deg" in line for line in table)
    assert verdict.startswith("system.aircraft: ")
    assert "C_L / C_Lmax 2.20 (at most 0.90)" in verdict
    assert str(folder) in place
    report = json.loads((folder / "check.json").read_text())
    assert not report["is_flyable"]
    assert report["ranges"]["thrust_N"] == pytest.approx([-44.5, 62.0], abs=0.1)
    least = min(report["margins"], key=lambda margin: margin["margin"])
    assert (least["name"], least["limit_is"]) == ("thrust", "lower")
    with Image.open(folder / "check.png") as picture:
        assert picture.width > 1000
    assert load_scenario(folder / "scenario.yaml").system.aircraft.model == "rascal_110"


@pytest.mark.usefixtures("plain_figures")
def test_a_level_formation_flies_in_wind(tmp_path, capsys):
    overrides = ["wind.velocity=[3, -4, 0]", SHORT]
    arguments = ["check", "aircraft_co_rotating", "--out", str(tmp_path), "--set", *overrides]
    assert main(arguments) == 0
    shown = capsys.readouterr().out
    assert "within all limits" in shown
    report = json.loads((tmp_path / "check.json").read_text())
    assert report["wind_m_s"] == [3.0, -4.0, 0.0]
    assert report["ranges"]["lift_share"][1] == pytest.approx(0.49, abs=0.01)
    # Over a turn, and over the fifth of a second that is the way.
    for ranges in (report["ranges"], report["flight"]["ranges"]):
        assert 1.4 < ranges["airspeed_over_loaded_stall"][0] < 1.55
        assert 0.5 < ranges["thrust_share"][1] < 1
        assert ranges["cables"]["mass_kg"] == pytest.approx(0.046, abs=0.001)
    for name in ("airspeed", "thrust", "real cables"):
        assert len(re.findall(rf"^{name}(?:, on the way)? +.*\d", shown, re.MULTILINE)) >= 2
    assert " of that with cable and bank" in shown
    assert "cables are simulated as straight: " in shown
    assert "cables are simulated as straight: " in report["ranges"]["cables"]["warning"]


def test_a_task_without_aircraft_is_told_of_its_bound_and_its_formation(
    tmp_path, capsys, monkeypatch
):
    told = {}
    show = told.__setitem__
    monkeypatch.setattr(check, "TaskProgress", lambda: contextlib.nullcontext(show))
    arguments = ["check", "quintic", "--out", str(tmp_path), "--set", "simulation_duration=1"]
    assert main(arguments) == 0
    shown = capsys.readouterr().out
    assert "the speed bound can be kept" in shown
    assert "the formation is stable" in shown
    report = json.loads((tmp_path / "check.json").read_text())
    assert report["is_sound"]
    assert report["speed_bound"]["least_ratio"] > 1
    assert len(report["formation"]["instants"]) > 3
    with Image.open(tmp_path / "task.png") as picture:
        assert picture.width > 1000
    assert not (tmp_path / "check.png").exists()
    shares = [*told.values()]
    assert shares[0] == 0.0
    assert shares == sorted(set(shares))


@pytest.mark.usefixtures("plain_figures")
def test_the_scenario_of_a_run_of_other_settings_is_kept(tmp_path, capsys):
    (tmp_path / "metrics.json").write_text("{}")
    (tmp_path / "scenario.yaml").write_text("line: {}")
    arguments = ["check", "aircraft_co_rotating", "--out", str(tmp_path), "--set", SHORT]
    assert main(arguments) == BAD_INPUT
    assert "a run of other settings has its scenario.yaml there" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["metrics.json", "scenario.yaml"]
    text = dump_scenario(load_scenario("aircraft_co_rotating", [SHORT]))
    (tmp_path / "scenario.yaml").write_text(text)
    assert main(arguments) == 0


@pytest.mark.usefixtures("plain_figures")
def test_gusts_are_told_to_be_left_out(tmp_path, capsys):
    assert main(["check", "aircraft_transfer_gusty", "--out", str(tmp_path), "--set", SHORT]) == 0
    assert "[0.0, 0.0, 0.0] m/s, without gusts" in capsys.readouterr().out
