"""Blocks of the user's own, by import path."""

import sys
import textwrap

import pytest

from drake_nonstop import (
    ScenarioError,
    changed,
    compute_metrics,
    dump_scenario,
    load_scenario,
    make_nonstop,
    parse_scenario,
    simulate,
)
from drake_nonstop.cli.main import main

MODULE = """
    from dataclasses import dataclass

    import numpy as np
    from pydrake.systems.framework import LeafSystem

    from drake_nonstop.model.pattern import HamiltonianCycleConfig


    @dataclass(kw_only=True)
    class SteadyConfig:
        speed_bound: float = 0.5  # m/s
        frequency: float = 1.0  # rad/s
        amplitude: float = 1.0  # N


    class Steady(LeafSystem):
        def __init__(self, model, config):
            super().__init__()
            values = [config.frequency, config.amplitude]
            self.DeclareVectorOutputPort(
                "parameters", 2, lambda context, output: output.SetFromVector(values)
            )


    @dataclass
    class BoundlessConfig:
        gain: float = 1.0


    class Boundless(LeafSystem):
        pass


    @dataclass
    class NeedyConfig:
        speed_bound: float


    @dataclass(kw_only=True)
    class QuarterCycleConfig:
        turn: float = 0.5  # rad

        def make(self, attachments):
            phases = self.turn + np.pi / 2 * np.arange(len(attachments))
            return HamiltonianCycleConfig(phases=phases.tolist()).make(attachments)
"""
TRUST = (
    "optimization_layer = !own_test_blocks.Steady: this scenario runs code of its own, .*--trust"
)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The current folder, with a module and a scenario of the user's."""
    (tmp_path / "own_test_blocks.py").write_text(textwrap.dedent(MODULE))
    (tmp_path / "mine.yaml").write_text(
        "mine: {simulation_duration: 0.2, "
        "optimization_layer: !own_test_blocks.Steady {frequency: 1.5}}"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    yield tmp_path
    sys.modules.pop("own_test_blocks", None)


@pytest.mark.usefixtures("undrawn")
def test_a_block_of_its_own_flies_where_it_is_trusted_and_is_not_imported_elsewhere(folder, capsys):
    brief = ["--quiet", "--no-figures", "--no-replay", "--out", "out"]
    with pytest.raises(ScenarioError, match=TRUST):
        load_scenario("mine.yaml")
    assert main(["run", "mine.yaml", *brief]) == 2
    assert "--trust" in capsys.readouterr().err
    assert not (folder / "out").exists()
    assert "own_test_blocks" not in sys.modules
    scenario = load_scenario("mine.yaml", trust=True)
    run = simulate(scenario)
    assert run.signal("parameters")[-1].tolist() == [1.5, 1.0]
    assert compute_metrics(run)["carriers"]["speed_bound_m_s"] == 0.5
    assert type(run.diagram.GetSubsystemByName("optimization_layer")).__name__ == "Steady"
    assert main(["run", "mine.yaml", "--trust", *brief]) == 3  # ξ is too low for its bound
    again = load_scenario("out/scenario.yaml", trust=True)
    assert again.optimization_layer == scenario.optimization_layer


def test_what_is_trusted_reads_back_and_can_be_changed_and_swapped(folder):
    """Nothing else comes in with it; by its name a block takes over what was set."""
    scenario = load_scenario("mine.yaml", trust=True)
    text = dump_scenario(scenario)
    assert "!own_test_blocks.Steady" in text
    with pytest.raises(ScenarioError, match=TRUST):
        parse_scenario(text)
    assert dump_scenario(parse_scenario(text, trust=True)) == text
    louder = changed(scenario, ["optimization_layer.amplitude=2"])
    assert louder.optimization_layer.amplitude == 2
    for setting, message in (
        ("load_disturbance=other_test_blocks.Wind", "runs code of its own"),
        ("optimization_layer.gain=1", r"optimization_layer\.gain = 1: there is no gain"),
        ("optimization_layer.amplitude=high", "amplitude = high: give a number"),
    ):
        with pytest.raises(ScenarioError, match=message):
            changed(scenario, [setting])
    swaps = ["optimization_layer.amplitude=1.3", "optimization_layer=own_test_blocks.Steady"]
    layer = load_scenario("quintic", swaps, trust=True).optimization_layer
    assert (layer.speed_bound, layer.amplitude, layer.frequency) == (0.55, 1.3, 2.0)
    scenario = load_scenario("quintic", ["pattern=own_test_blocks.QuarterCycle"], trust=True)
    assert scenario.pattern.turn == 0.5
    make_nonstop(changed(scenario, ["optimization_layer=ConstantParameters"]))


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("no_such_module.Steady", "no_such_module cannot be had .*No module named"),
        ("own_test_blocks.Needyy", r"no NeedyyConfig; did you mean NeedyConfig\?"),
        ("own_test_blocks.Xyz", "there is no XyzConfig"),
        ("own_test_blocks.Boundless", "give BoundlessConfig a field speed_bound"),
        (
            "own_test_blocks.Needy",
            r"NeedyConfig .*cannot be had \(TypeError.*every field a default",
        ),
        ("broken_test_blocks.Steady", "cannot be had .ZeroDivisionError: division by zero"),
    ],
)
def test_what_cannot_be_had_is_told(folder, path, message):
    (folder / "broken_test_blocks.py").write_text("1 / 0")
    with pytest.raises(ScenarioError, match=message):
        load_scenario("quintic", [f"optimization_layer={path}"], trust=True)
