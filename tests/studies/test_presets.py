"""Ablations, sweeps, robustness and ranges of stability: studies with settings of their own."""

import re

import pytest

from drake_nonstop.cli.main import main
from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.scenario.overrides import changed
from drake_nonstop.scenario.schema import check
from drake_nonstop.studies import presets
from drake_nonstop.studies.attempts import COMPLETED, UNBUILDABLE
from drake_nonstop.studies.presets import (
    ablate,
    grid_names,
    name_overrides,
    read_grid,
    robustness,
    sweep,
)
from drake_nonstop.studies.study import settings_of_factors
from drake_nonstop.studies.workers import SerialExecutor
from drake_nonstop.validation import ScenarioError

SHORT = ["simulation_duration=0.1", "optimization_layer=ConstantParameters"]
SPEC = """
description: two masses
overrides: ["simulated.load_mass=!Uniform {min: 0.9, max: 1.1}"]
grid: {system.load_mass: [0.9, 1.0]}
seeds: 3
"""


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("line", SHORT)


@pytest.fixture
def written(tmp_path):
    def write(text):
        path = tmp_path / "mine.yaml"
        path.write_text(text)
        return path

    return write


class TestGrids:
    def test_variants_by_name(self, written):
        text = "description: two\nvariants:\n  a: [x=1, 'y=!B {c: 2}']\n  b c: [phase=PaperPhase]"
        grid = read_grid(written(text))
        assert (grid.name, grid.description) == ("mine", "two")
        assert grid.variants == {"a": ["x=1", "y=!B {c: 2}"], "b c": ["phase=PaperPhase"]}

    def test_every_combination_is_named_by_its_values(self, written):
        text = """
        grid:
          phase: [!PaperPhase {}, AccumulatedPhase]
          carrier_controller.velocity_gain: [1.5, 1e+1]
          load_feedback.seed: [3, 4]
        """
        grid = read_grid(written(text))
        assert [setting.name for setting in settings_of_factors(grid.factors)] == [
            "PaperPhase, velocity_gain=1.5",
            "PaperPhase, velocity_gain=10.0",
            "AccumulatedPhase, velocity_gain=1.5",
            "AccumulatedPhase, velocity_gain=10.0",
        ]
        assert grid.seeds == [3, 4]  # not a factor: what a figure's bands are over

    def test_values_that_are_no_scalars_reach_the_scenario(self, written):
        text = """
        grid:
          pattern.phases: [[0.0, 0.5, 0.0, 0.5]]
          optimization_layer: [!RecedingHorizonOptimizer {speed_bound: 0.3}]
        """
        (setting,) = settings_of_factors(read_grid(written(text)).factors)
        made = changed(load_scenario("line"), setting.changes)
        assert made.pattern.phases == [0.0, 0.5, 0.0, 0.5]
        assert made.speed_bound == 0.3

    def test_names(self):
        names = name_overrides(["phase=my.Own", "carrier_controller=!CarrierPid {}"])
        assert names == "my.Own, CarrierPid"
        several = ["system.load_mass=1", "simulated.load_mass=2", "simulation_duration=3"]
        told = "system.load_mass=1, simulated.load_mass=2, simulation_duration=3"
        assert name_overrides(several) == told

    @pytest.mark.parametrize(
        ("text", "words"),
        [
            ("", "give variants or grid"),
            ("description: nothing more", "give variants or grid"),
            ("variants: {a: [b=1]}\ngrid: {b: [1]}", "variants and grid"),
            ("variant: {a: [b=1]}", "mine.yaml.variant = "),
            ("variants: [a=1]", "give a mapping from names to lists"),
            ("variants: !Odd {a: [b=1]}", "give a mapping from names to lists"),
            ("variants: {a: b=1}", "give a list"),
            ("variants: {a: [b]}", "give path=value"),
            ("variants: {a: [b=1], a: [b=2]}", "given twice"),
            ("grid: [1]", "give a mapping from names to lists"),
            ("grid: {a: []}", "give a list"),
            ("grid: {a: [1", "valid YAML"),
            ("overrides: a=1\nseeds: 2", "mine.yaml.overrides = a=1: give a list"),
        ],
    )
    def test_anything_else_is_one_clear_sentence(self, written, text, words):
        with pytest.raises(ScenarioError, match=re.escape(words)) as raised:
            read_grid(written(text))
        assert "\n" not in str(raised.value)

    def test_there_is_no_such_grid_or_file(self, tmp_path):
        with pytest.raises(ScenarioError, match=", ".join(grid_names())):
            read_grid("papers")
        with pytest.raises(ScenarioError, match="a file that can be read"):
            read_grid(tmp_path / "none.yaml")

    @pytest.mark.parametrize("name", grid_names())
    def test_what_comes_with_the_package_applies_to_its_scenario(self, name):
        grid = read_grid(name)
        assert grid.description
        base = "aircraft_transfer" if name in ("airspeed", "cables") else "line"
        for overrides in grid.variants.values():
            variant = changed(load_scenario(base), overrides)
            check(variant)
            make_nonstop(variant, at_equilibrium=False)


class TestAblation:
    def test_the_scenario_as_it_is_comes_first(self, scenario, tmp_path, undrawn):
        variants = {"a": ["system.load_mass=0.9"], "b": ["system.load_mass=-1"]}
        table = ablate(scenario, variants, tmp_path, seeds=2, replay=False).table
        assert table["variant"].tolist() == 2 * ["as it is"] + 2 * ["a"] + 2 * ["b"]
        assert table["ending"].tolist() == 4 * [COMPLETED] + 2 * [UNBUILDABLE]
        assert not (tmp_path / "as_it_is").exists()

    @pytest.mark.parametrize(
        ("variants", "words"),
        [
            ({"a": "phase=PaperPhase"}, "give a list of path=value"),
            ({"a": [3]}, "variant, a = 3: give path=value"),
            ({1: ["a=1"]}, "give a mapping from names"),
            (["phase=PaperPhase"], "give a mapping from names"),
            (3, "give a mapping from names"),
        ],
    )
    def test_what_cannot_be_used_is_one_sentence(self, scenario, tmp_path, variants, words):
        with pytest.raises(ScenarioError, match=words):
            ablate(scenario, variants, tmp_path)

    @pytest.mark.slow
    def test_the_command(self, tmp_path, capsys, undrawn):
        call = ["ablate", "line", "--set", *SHORT, "--out", str(tmp_path), "--no-replay"]
        swap = ["--swap", "phase=PaperPhase", "system.load_mass=1.1"]
        assert main([*call, "--grid", "paper", *swap]) == 0
        out = capsys.readouterr().out
        assert "without optimization" in out
        assert "PaperPhase, load_mass=1.1" in out
        assert main(call) == 2
        assert main([*call, "--swap", "phase"]) == 2


class TestSweep:
    def test_the_command_flies_what_the_file_says_and_one_run_of_it(
        self, written, tmp_path, capsys, undrawn
    ):
        call = ["sweep", "line", str(written(SPEC)), "--set", *SHORT, "--out"]
        assert main([*call, str(tmp_path / "out")]) == 0
        lines = (tmp_path / "out" / "runs.csv").read_text().splitlines()
        assert lines[0].startswith("run,system.load_mass,seed,simulated.load_mass,ending")
        assert len(lines) == 1 + 6
        assert main([*call, str(tmp_path / "one"), "--run", "5"]) in (0, 3)
        drawn = re.search(r"load_mass: (.*)", (tmp_path / "one" / "scenario.yaml").read_text())
        assert drawn
        assert main([*call, str(tmp_path / "one"), "--run", "6"]) == 2
        assert "--run = 6: give 0 to 5" in capsys.readouterr().err

    def test_in_python(self, scenario, written):
        done = sweep(scenario, written(SPEC), executor=SerialExecutor())
        assert done.title == "two masses"
        masses = done.table["simulated.load_mass"].tolist()
        assert masses[:3] == masses[3:]  # each seed draws the same for all
        assert len({*masses}) == 3


@pytest.mark.nightly("studies")
def test_robustness(scenario, monkeypatch, tmp_path):
    table = robustness(scenario, tmp_path).table
    assert len(table) == 33
    assert (table["ending"] == COMPLETED).all()
    assert table["error"][0] == "none"
    errors = table["load.position_error_mean_m"]
    assert errors[table["error"] == "load mass +20 %"].iloc[0] > errors[0]


@pytest.mark.parametrize("name", ["quintic", "aircraft_rest", "estimated_wind"])
def test_each_error_of_robustness_makes_a_scenario(name):
    if name == "estimated_wind":
        feedback = "load_feedback=!FilteredFeedback {position_noise: 0.001}"
        base = load_scenario("quintic", [feedback])
    else:
        base = load_scenario(name)
    errors = dict(presets._errors(base))
    assert len(errors) == 33
    for changes in errors.values():
        check(changed(base, changes))
