"""No run that ended before its time replaces the results of a whole one, nor their pictures."""

import dataclasses
import json
import random

import pytest
from helpers import nightly_beyond

from drake_nonstop.cli import run as run_command
from drake_nonstop.cli.main import main
from drake_nonstop.run.run import RunInterrupted, RunStopped
from drake_nonstop.run.simulate import simulate
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.studies import results_folder

SHORT = ["simulation_duration=0.05", "optimization_layer=ConstantParameters"]


@pytest.fixture(scope="module")
def whole():
    return simulate(load_scenario("line", SHORT))


@pytest.fixture
def end(monkeypatch, whole):
    """Lets the command end as told; returns its exit code."""

    def ended(how, *arguments, change=()):
        def flown(scenario, **options):
            run = dataclasses.replace(whole, scenario=scenario)
            if how == "whole":
                return run
            run.stopped = f"it {how}"
            raise {"interrupted": RunInterrupted, "stopped": _stopped}[how](run)

        monkeypatch.setattr(run_command, "simulate", flown)
        if "--no-replay" in arguments:
            monkeypatch.setattr(results_folder, "draw_diagram", lambda diagram: "<svg/>")
        return main(["run", "line", *arguments, "--set", *SHORT, *change])

    return ended


def _stopped(run):
    return RunStopped("the run stopped", run)


def contents(folder):
    return {p.relative_to(folder): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def outcome(folder):
    return json.loads((folder / "metrics.json").read_text())["outcome"]


@pytest.mark.parametrize(
    ("options", "seed"),
    nightly_beyond(
        3,
        "studies",
        [(place, k) for k in range(2) for place in ([], ["--out", "mine"], ["--out", "."])],
    ),
)
def test_in_any_order_what_is_whole_stays(tmp_path, monkeypatch, capsys, end, options, seed):
    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    folder = work / (options[1] if options else "out/line")
    stopped = folder.resolve().with_name(f"{folder.resolve().name}_stopped")
    order = random.Random(seed)
    kept = None
    for how in ["interrupted", "whole", *order.choices(["interrupted", "stopped", "whole"], k=5)]:
        code = end(how, "--no-figures", "--no-replay", *options)
        said = capsys.readouterr().err
        assert (how == "whole") == (code == 0)
        if how == "whole":
            kept = contents(folder)
        elif kept is None:
            assert outcome(folder) == "stopped"
        else:
            assert contents(folder) == kept
            assert outcome(stopped) == "stopped"
            assert f"{stopped.name}; those of an earlier run stay in " in said
