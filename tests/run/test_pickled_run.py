"""Runs that go from one process to another, and what is asked of them there."""

import pickle
from concurrent.futures import ProcessPoolExecutor

import pytest

from drake_nonstop import (
    Run,
    RunInterrupted,
    RunStopped,
    ScenarioWarning,
    ShapedPhase,
    compute_metrics,
    load_scenario,
    simulate,
)


class OwnPhase(ShapedPhase):
    """One of the user's own."""


def _short(*changes):
    return load_scenario("quintic", ["simulation_duration=0.05", *changes])


def test_processes_return_the_runs_of_this_one():
    scenarios = [_short(f"system.load_mass={mass}") for mass in (0.9, 1.1)]
    with ProcessPoolExecutor(1) as executor:
        runs = list(executor.map(simulate, scenarios))
    for run, scenario in zip(runs, scenarios, strict=True):
        here = simulate(scenario)
        assert run.scenario == scenario
        for name, values in here.signals.items():
            assert values.tobytes() == run.signals[name].tobytes(), name
        assert "diagram" not in vars(run)
        assert compute_metrics(run)["load"] == compute_metrics(here)["load"]
        assert run.diagram.GetSubsystemByName("load_plant").get_name() == "load_plant"
        assert run.diagram is run.diagram


def test_the_loop_of_replacements_is_built_again_with_them():
    run = pickle.loads(pickle.dumps(simulate(_short(), phase=OwnPhase)))
    assert type(run.diagram.GetSubsystemByName("phase")) is OwnPhase


def test_of_a_run_from_logs_the_diagram_is_said_to_be_another():
    run = simulate(_short())
    run.replacements = None
    copied = pickle.loads(pickle.dumps(run))
    with pytest.warns(ScenarioWarning, match="its diagram is that of the scenario"):
        assert copied.diagram is not run.diagram


@pytest.mark.parametrize("kind", [RunStopped, RunInterrupted])
def test_an_exception_brings_its_run(kind):
    run = simulate(_short())
    given = kind("it fell", run) if kind is RunStopped else kind(run)
    error = pickle.loads(pickle.dumps(given))
    assert (type(error), str(error)) == (kind, str(given))
    assert isinstance(error.run, Run)
