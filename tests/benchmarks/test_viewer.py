"""What a live view of a scenario costs."""

import json

from drake_nonstop.cli.main import main


def test_the_cost_of_a_view_is_a_small_share(tmp_path, capsys):
    arguments = [
        "bench",
        "viewer",
        "quintic",
        "--out",
        str(tmp_path),
        "--set",
        "simulation_duration=0.3",
    ]
    assert main(arguments) == 0
    assert "of real time" in capsys.readouterr().out
    report = json.loads((tmp_path / "viewer.json").read_text())
    assert report["simulated_s"] == 0.3
    assert len(report["cpu_s_with"]) == len(report["cpu_s_without"]) == 3
