"""`bench engines`, on short flights."""

import json

import numpy as np
import pytest

from drake_nonstop import ScenarioError, load_scenario
from drake_nonstop.benchmarks.comparing import Source
from drake_nonstop.benchmarks.engines import benchmark_engines, table
from drake_nonstop.benchmarks.running import benchmark_run
from drake_nonstop.cli.main import main

pytestmark = pytest.mark.filterwarnings("ignore:compiled loop")

BRIEF = ["simulation_duration=0.1", "optimization_layer=NlpLayer"]


@pytest.mark.nightly("benchmarks")
def test_the_ways_to_fly_are_measured_and_agree(monkeypatch):
    monkeypatch.setenv("CC", "/bin/false")  # to compile would take longer
    results = benchmark_engines(load_scenario("line", BRIEF), repeats=1)
    assert results["compiler"] is None
    assert 0 < results["difference"] < 1e-9
    assert results["ratios"]["diagram"] == 1
    assert [*results["wall_s"]] == ["diagram", "compiled", "stepped", "virtual machine"]
    factors = np.array([*results["real_time_factors"].values()])
    np.testing.assert_allclose(factors * [*results["wall_s"].values()], 0.1)
    text = table(results)
    assert "by the virtual machine alone" in text
    assert len(text.splitlines()) == 6


@pytest.mark.nightly("benchmarks")
def test_the_command_writes_them(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("CC", "/bin/false")
    settings = [text for override in BRIEF for text in ("--set", override)]
    assert main(["bench", "engines", *settings, "--repeats", "1", "--out", str(tmp_path)]) == 0
    assert "times the diagram" in capsys.readouterr().out
    assert json.loads((tmp_path / "engines.json").read_text())["repeats"] == 1


def test_what_cannot_be_compiled_is_bad_input():
    with pytest.raises(ScenarioError, match=r"^control_period = 0: "):
        benchmark_engines(load_scenario("line", [*BRIEF, "control_period=0"]), repeats=1)


def test_the_blocks_of_a_compiled_loop_are_not_timed():
    with pytest.raises(ScenarioError, match=r"^engine = compiled: give engine=diagram"):
        benchmark_run(Source("line", ("engine=compiled",)), repeats=1)
