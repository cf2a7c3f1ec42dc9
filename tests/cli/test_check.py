"""`drake-nonstop check`, as a user meets it."""

import json

import pytest
from PIL import Image

from drake_nonstop.cli.main import main
from drake_nonstop.scenario.loading import load_scenario

SHORT = "simulation_duration=0.2"  # the aircraft's margins are those of a load at rest
RASCAL = "system.aircraft.model=rascal_110"


@pytest.mark.nightly("flights")
def test_a_spread_carousel_is_refused_with_the_numbers(tmp_path, capsys):
    folder = tmp_path / "a"
    arguments = ["check", "real_scale_spread", "--out", str(folder), "--set", RASCAL, SHORT]
    assert main(arguments) == 1
    table = capsys.readouterr().out.splitlines()
    assert any(line.startswith("climb or descent") and "43.0 deg" in line for line in table)
    (verdict,) = (line for line in table if line.startswith("system.aircraft: "))
    assert "C_L / C_Lmax 2.198 (at most 0.9)" in verdict
    report = json.loads((folder / "check.json").read_text())
    assert not report["is_flyable"]
    assert report["ranges"]["thrust_N"] == pytest.approx([-44.5, 62.0], abs=0.1)
    least = min(report["margins"], key=lambda margin: margin["margin"])
    assert (least["name"], least["limit_is"]) == ("thrust", "lower")
    assert load_scenario(folder / "scenario.yaml").system.aircraft.model == "rascal_110"


def test_a_level_formation_flies_in_wind(tmp_path, capsys):
    overrides = ["wind.velocity=[3, -4, 0]", SHORT]
    arguments = ["check", "aircraft_co_rotating", "--out", str(tmp_path), "--set", *overrides]
    assert main(arguments) == 0
    shown = capsys.readouterr().out
    assert "within all limits" in shown
    report = json.loads((tmp_path / "check.json").read_text())
    assert report["wind_m_s"] == [3.0, -4.0, 0.0]
    ranges = report["ranges"]
    assert ranges["lift_share"][1] == pytest.approx(0.49, abs=0.01)
    assert 1.4 < ranges["airspeed_over_loaded_stall"][0] < 1.55
    assert 0.5 < ranges["thrust_share"][1] < 1
    assert ranges["cables"]["mass_kg"] == pytest.approx(0.046, abs=0.001)
    assert " of that with cable and bank" in shown
    for text in (shown, ranges["cables"]["warning"]):
        assert "cables are simulated as straight: " in text
    with Image.open(tmp_path / "check.png") as picture:
        assert picture.width > 1000


def test_the_flight_is_announced_at_once_and_the_outcome_is_told(tmp_path, capsys):
    arguments = ["check", "quintic", "--out", str(tmp_path), "--set", "simulation_duration=1"]
    assert main(arguments) == 0
    first, *_, verdict, feasible, place = capsys.readouterr().out.splitlines()
    assert first == "check quintic: a flight of 1 s"
    assert verdict == "ok: the flight keeps all limits"
    assert feasible.startswith("constant xi and A can keep the bound")
    assert str(tmp_path) in place
    report = json.loads((tmp_path / "check.json").read_text())
    assert report["is_ok"]
    with Image.open(tmp_path / "task.png") as picture:
        assert picture.width > 1000
    assert not (tmp_path / "check.png").exists()


def test_seeds_are_flown_and_a_failure_is_the_exit_code(tmp_path, capsys):
    noise = "load_feedback=!NoisyFeedback {position_noise: 0.005, velocity_noise: 0.02}"
    arguments = ["check", "quintic", "--seeds", "2", "--out", str(tmp_path)]
    assert main([*arguments, "--set", "simulation_duration=1", noise]) == 1
    shown = capsys.readouterr().out
    assert shown.startswith("check quintic: 2 flights of 1 s\n")
    assert "without the errors that the scenario states the flight is ok" in shown
