"""Studies take classes, configs, functions and loops of the user's own."""

import functools

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from tables import read_rows

from drake_nonstop import (
    DisturbanceForceConfig,
    ScenarioError,
    SweepSpec,
    ablate,
    connect_by_name,
    load_scenario,
    make_blocks,
    simulate,
    sweep,
)
from drake_nonstop.blocks.phase import AccumulatedPhase, PaperPhase, PaperPhaseConfig
from drake_nonstop.model.pattern import CarouselConfig
from drake_nonstop.run.metrics import compute_metrics
from drake_nonstop.studies.run_all import SerialExecutor
from drake_nonstop.studies.variants import identity, label, varied


class Push(LeafSystem):
    """A constant force on the load."""

    def __init__(self, model, force=0.2):
        super().__init__()
        value = [0.0, 0.0, 0.0, 0.0, force, 0.0]
        self.DeclareVectorOutputPort("disturbance_wrench", 6, lambda c, o: o.SetFromVector(value))


def strong(model):
    return Push(model, force=0.5)


def renamed(scenario, **replacements):
    blocks = make_blocks(scenario, **replacements)
    builder = DiagramBuilder()
    connect_by_name(builder, {f"my_{name}": block for name, block in blocks.items()})
    return builder.Build()


@pytest.fixture(scope="module")
def scenario():
    short = ["optimization_layer=ConstantParameters", "simulation_duration=0.1", "engine=diagram"]
    return load_scenario("line", short)


def error_of(scenario, **replacements):
    return compute_metrics(simulate(scenario, **replacements))["load"]["position_error_mean_m"]


@pytest.mark.nightly("studies")
def test_ablation_of_classes_configs_functions_and_a_loop_of_ones_own(scenario, tmp_path):
    variants = {
        "class": {"load_disturbance": Push},
        "function": ["system.load_mass=1.1", {"load_disturbance": strong}],
        "extra": {"load_disturbance": None, "extra": {"push": Push}},
    }
    rows = ablate(scenario, variants, tmp_path, replay=False, make_loop=renamed)
    errors = {row.variant: row.metrics["load"]["position_error_mean_m"] for row in rows}
    heavy = load_scenario(
        "line",
        [
            "optimization_layer=ConstantParameters",
            "simulation_duration=0.1",
            "system.load_mass=1.1",
        ],
    )
    assert errors == {
        "as it is": error_of(scenario),
        "class": error_of(scenario, load_disturbance=Push),
        "function": error_of(heavy, load_disturbance=strong),
        "extra": errors["class"],
    }
    shown = {row.variant: row.overrides for row in rows}
    assert shown["class"] == [f"load_disturbance={__name__}.Push"]
    assert shown["function"] == ["system.load_mass=1.1", f"load_disturbance={__name__}.strong"]
    assert "my_load_plant" in (tmp_path / "class" / "diagram.svg").read_text()


def test_sweep_of_classes_configs_and_functions(scenario, tmp_path):
    weak = functools.partial(Push, force=0.1)
    pushes = [Push, strong, weak, DisturbanceForceConfig(force=[0.0, 0.2, 0.0]), "NoDisturbance"]
    spec = SweepSpec(grid={"load_disturbance": pushes, "phase": [PaperPhase]})
    result = sweep(scenario, spec, tmp_path, executor=SerialExecutor(), make_loop=renamed)
    assert result.endings == {"completed": 5}
    rows = read_rows(result.table)
    names = [f"{__name__}.Push", f"{__name__}.strong", f"{__name__}.Push(force=0.1)"]
    assert [row["load_disturbance"] for row in rows[:3]] == names
    assert {row["phase"] for row in rows} == {"PaperPhase"}
    errors = [row["load.position_error_mean_m"] for row in rows]
    for push, error in ((strong, errors[1]), (weak, errors[2])):
        assert error == error_of(scenario, load_disturbance=push, phase=PaperPhase)
    assert errors[0] == errors[3]  # the same force
    assert len(set(errors)) == 4


def test_draws_choose_among_classes():
    choice = {"phase": {"choice": [PaperPhase, AccumulatedPhase]}}
    spec = SweepSpec(draws=choice, runs=20)
    planned = [spec.run(number) for number in range(20)]
    assert {run.values["phase"] for run in planned} == {"PaperPhase", "AccumulatedPhase"}
    for run in planned:
        change, seed = run.overrides
        assert seed.startswith("random_seed=")
        assert change["phase"].__name__ == run.values["phase"]


def test_changes_apply_in_their_order(scenario):
    changes = [{"phase": PaperPhaseConfig()}, "phase=AccumulatedPhase", "system.load_mass=1.2"]
    changed, others = varied(scenario, changes, trust=False)
    assert type(changed.phase).__name__ == "AccumulatedPhaseConfig"
    assert changed.system.load_mass == 1.2
    assert others == {}
    changed, others = varied(scenario, [{"phase": strong}, {"phase": PaperPhase}], trust=False)
    assert type(changed.phase).__name__ == "PaperPhaseConfig"
    assert others == {}


IMPORT = "processes cannot import it; give a class, a config or a function of those at the top"


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"phase": lambda model: None}, rf"variant a, phase = .*<lambda>: {IMPORT}"),
        ({"extra": {"x": lambda model: None}}, rf"variant a, extra = .*<lambda>.*: {IMPORT}"),
        ({"phasse": PaperPhase}, "variant a = phasse: give one of load_trajectory"),
        (3, r"variant a = 3: give a list of path=value, and of replacements such as"),
        ([3], "variant a = 3: give path=value"),
        (
            ["load_disturbance=DisturbanceForce", {"load_disturbance": strong}],
            f"override = load_disturbance: leave it out: load_disturbance is made by {__name__}.s",
        ),
    ],
)
def test_variants_that_cannot_be_run_are_refused(changes, said, scenario, tmp_path):
    with pytest.raises(ScenarioError, match=f"^{said}"):
        ablate(scenario, {"a": changes}, tmp_path)


def test_a_loop_that_processes_cannot_import_is_refused(scenario, tmp_path):
    for study, spec in ((ablate, {}), (sweep, SweepSpec(grid={"system.load_mass": [1.0]}))):
        with pytest.raises(ScenarioError, match=rf"^make_loop = .*<lambda>: {IMPORT}"):
            study(scenario, spec, tmp_path, make_loop=lambda scenario: None)


@pytest.mark.parametrize(
    ("grid", "said"),
    [
        ({"phase": [lambda model: None]}, rf"spec\.grid, phase = .*<lambda>: {IMPORT}"),
        ({"phase": [PaperPhase, PaperPhase]}, r"spec\.grid\.phase = PaperPhase: give each value"),
        ({"phase": [PaperPhase, "PaperPhase"]}, r"spec\.grid\.phase = PaperPhase: give each value"),
        ({"pattern": [CarouselConfig()]}, r"spec\.grid\.pattern = <CarouselConfig>: give numbers"),
    ],
)
def test_sweeps_of_what_cannot_be_used_are_refused(grid, said):
    with pytest.raises(ScenarioError, match=f"^{said}"):
        SweepSpec(grid=grid)


def test_the_identity_of_changes_differs_where_results_may():
    weaker = [functools.partial(Push, force=force) for force in (0.1, 0.2)]
    entries = [
        Push,
        strong,
        *weaker,
        DisturbanceForceConfig(),
        DisturbanceForceConfig(force=[1.0, 0.0, 0.0]),
    ]
    texts = {identity([{"load_disturbance": entry}]) for entry in entries}
    assert len(texts) == len(entries)
    assert identity(["a=1"]) != identity(["a=1"], renamed)
    again = functools.partial(Push, force=0.1)
    assert identity([{"phase": again}]) == identity([{"phase": weaker[0]}])
    assert label(again) == f"{__name__}.Push(force=0.1)"
    assert np.all([__name__ in identity([{"phase": entry}]) for entry in entries[:4]])
