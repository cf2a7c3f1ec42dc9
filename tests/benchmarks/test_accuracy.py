"""`accuracy` reports how far an integrator setting leaves a run from a converged one."""

import json

import numpy as np
import pytest

from benchmarks.__main__ import main
from benchmarks.accuracy import OVERRIDES, benchmark_accuracy, table
from drake_nonstop import load_scenario, simulate
from drake_nonstop.scenario.overrides import changed

BRIEF = ["simulation_duration=0.4", "optimization_layer=ConstantParameters"]
LONG = ("simulator_config.integration_scheme=runge_kutta2", "simulator_config.max_step_size=0.01")


@pytest.fixture(scope="module")
def results():
    overrides = [("engine=compiled",), ("simulator_config.max_step_size=0.001",), LONG]
    return benchmark_accuracy(load_scenario("line", BRIEF), overrides=overrides, repeats=1)


@pytest.mark.nightly("benchmarks")
def test_shorter_steps_are_nearer_to_the_truth(results):
    default, compiled, short, _ = results["runs"]
    for error in ("load_error_m", "speed_error"):
        assert default[error] > 20 * short[error] > 0
        assert short[error] > results["reference"][error] > 0
        assert compiled[error] == pytest.approx(default[error], rel=1e-3)
    assert [row.get("steps") for row in results["runs"][:3]] == [80, 80, 400]


@pytest.mark.nightly("benchmarks")
def test_errors_are_the_largest_of_any_sample_and_carrier(results):
    scenario = load_scenario("line", BRIEF)
    runs = [
        simulate(changed(scenario, [f"simulator_config.max_step_size={step}"]))
        for step in (5e-3, 5e-4)
    ]
    loads = [run.signal("load_state") for run in runs]
    far = max(np.linalg.norm(a[4:7] - b[4:7]) for a, b in zip(*loads, strict=True))
    speeds = [
        np.linalg.norm(run.signal("carrier_state")[:, 12:].reshape(-1, 4, 3), axis=2)
        for run in runs
    ]
    off = max(abs(a / b - 1) for a, b in zip(speeds[0].ravel(), speeds[1].ravel(), strict=True))
    default = results["runs"][0]
    assert default["load_error_m"] == pytest.approx(far, rel=1e-9)
    assert default["speed_error"] == pytest.approx(off, rel=1e-9)


@pytest.mark.nightly("benchmarks")
def test_a_run_that_diverges_is_reported(results):
    row = results["runs"][-1]
    assert "diverged" in row["stopped"]
    assert "load_error_m" not in row
    assert "diverged" in table(results).splitlines()[4]


@pytest.mark.nightly("benchmarks")
def test_command_prints_a_table_and_writes_json(tmp_path, capsys):
    arguments = ["accuracy", "line", "--repeats", "1", "--out", str(tmp_path)]
    assert main([*arguments, "--set", "simulation_duration=0.05", BRIEF[1]]) == 0
    assert "(as it is)" in capsys.readouterr().out
    runs = json.loads((tmp_path / "accuracy.json").read_text())["runs"]
    assert len(runs) == 1 + len(OVERRIDES)
