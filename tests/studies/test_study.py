"""One study and its presets: factors, seeds, endings, statistics, and what is written."""

import functools
import itertools
import re

import numpy as np
import pandas
import pytest
import scipy.stats
from pydrake.systems.framework import LeafSystem

from drake_nonstop import DisturbanceForceConfig, load_scenario, study
from drake_nonstop.blocks.phase import AccumulatedPhase, PaperPhase, PaperPhaseConfig
from drake_nonstop.cli.main import main
from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.scenario.overrides import changed
from drake_nonstop.scenario.schema import check
from drake_nonstop.studies.attempts import COMPLETED, DIVERGED, FAILED, UNBUILDABLE
from drake_nonstop.studies.changes import identity, varied
from drake_nonstop.studies.presets import (
    ablate,
    grid_names,
    name_overrides,
    read_grid,
    robustness,
    sweep,
)
from drake_nonstop.studies.study import Setting, Study, settings_of_factors
from drake_nonstop.studies.summary import number
from drake_nonstop.studies.workers import SerialExecutor
from drake_nonstop.validation import ScenarioError

SHORT = ["simulation_duration=0.1", "optimization_layer=ConstantParameters"]
ERROR = "load.position_error_mean_m"
MASS = "system.load_mass"
serial = functools.partial(study, executor=SerialExecutor())


class Push(LeafSystem):
    """A disturbance of the user's own."""

    def __init__(self, model, force=0.2):
        super().__init__()
        self.DeclareVectorOutputPort(
            "disturbance_wrench", 6, lambda _, out: out.SetFromVector([0, 0, 0, 0, force, 0])
        )


def strong(model):
    return Push(model, 2.0)


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("line", SHORT)


@pytest.fixture(scope="module")
def noisy():
    return load_scenario("line", [*SHORT, "load_feedback=!NoisyFeedback {position_noise: 0.01}"])


def known(table):
    """A table without what a clock measured."""
    clocks = ("wall_s", "real_time_factor", "engine")
    return table.drop(columns=[c for c in table if c in clocks or "solve" in c or "overrun" in c])


def test_a_column_per_factor_a_row_per_run_and_files_that_have_them(noisy, tmp_path):
    factors = {"phase": ["AccumulatedPhase", "PaperPhase"], MASS: [0.9, 1.0]}
    done = serial(noisy, factors, seeds=2, folder=tmp_path)
    table = done.table
    assert [*table.columns[:3]] == ["phase", MASS, "seed"]
    assert table["phase"].tolist() == 4 * ["AccumulatedPhase"] + 4 * ["PaperPhase"]
    assert table[MASS].tolist() == 2 * [0.9, 0.9, 1.0, 1.0]
    assert table["seed"].tolist() == 4 * [0, 1]
    assert (table["ending"] == COMPLETED).all()
    assert table[ERROR].nunique() == 8  # noise differs with the seed, to which all react
    read = pandas.read_csv(tmp_path / "runs.csv", index_col="run")
    pandas.testing.assert_series_equal(read[ERROR], table[ERROR], rtol=1e-15)
    assert len(pandas.read_csv(tmp_path / "summary.csv", header=[0, 1], index_col=[0, 1])) == 4
    names = {path.name for path in tmp_path.iterdir()}
    figures = {"load_position_error_mean_m", "carriers_speed_min_m_s"}
    assert {f"{name}.{kind}" for name in figures for kind in ("png", "pdf")} < names
    assert {"journal.jsonl", "scenario.yaml", "summary.tex", "index.html"} < names
    assert load_scenario(tmp_path / "scenario.yaml") == noisy


def test_seeds_are_of_distributions_and_of_blocks(scenario):
    drawn = load_scenario("line", [*SHORT, "simulated.load_mass=!Uniform {min: 1.0, max: 1.2}"])
    table = serial(drawn, {}, seeds=[3, 4, 3]).table
    assert table["seed"].tolist() == [3, 4]
    drawn.random_seed = 4
    assert drawn.sampled().simulated.load_mass == table["simulated.load_mass"][1]
    assert "seed" not in serial(scenario, {MASS: [1.0]}).table


def test_levels_may_be_named_and_make_blocks(scenario):
    config = DisturbanceForceConfig(force=[0.1, 0.0, 0.0])
    levels = {"light": [f"{MASS}=0.5"], "far": [{"load_disturbance": strong}]}
    table = serial(scenario, {"what": levels}).table
    assert table["what"].tolist() == ["light", "far"]
    table = serial(scenario, {"load_disturbance": [config, Push, strong]}).table
    assert table["load_disturbance"].tolist()[1:] == [f"{__name__}.Push", f"{__name__}.strong"]
    assert (table["ending"] == COMPLETED).all()
    assert table[ERROR].nunique() == 3


def test_runs_have_endings_of_their_own(faulty_blocks):
    own = load_scenario(
        "line", [*SHORT, "load_disturbance=!faulty_blocks.FaultyWind {}"], trust=True
    )
    endings = {
        "none": COMPLETED,
        "raises": FAILED,
        "diverges": DIVERGED,
        "exits": FAILED,
        "constructor": UNBUILDABLE,
        "constructor exits": UNBUILDABLE,
    }
    done = serial(own, {"load_disturbance.fault": [*endings]})
    assert done.table["ending"].tolist() == [*endings.values()]
    assert (done.table["message"] == "").tolist() == [True, *5 * [False]]
    assert "the wind broke" in str(done)
    assert done.table[ERROR].notna().tolist() == 4 * [True] + 2 * [False]


def test_processes_make_the_table_of_one_which_goes_on_from_what_is_there(scenario, tmp_path):
    shares = []
    told = functools.partial(
        study, scenario, folder=tmp_path, progress=lambda _, share: shares.append(share)
    )
    first = told({MASS: [0.9, 1.0]})
    more = told({MASS: [0.9, 1.0, 1.1]}, executor=SerialExecutor())
    assert len(shares) == 2 + 1
    whole = serial(scenario, {MASS: [0.9, 1.0, 1.1]}).table
    pandas.testing.assert_frame_equal(known(first.table), known(whole.iloc[:2]))
    pandas.testing.assert_frame_equal(known(more.table), known(whole))
    told({MASS: [0.9, 1.0]}, restart=True, executor=SerialExecutor())
    assert len(shares) == 5
    with pytest.raises(ScenarioError, match="is of another scenario or other code"):
        serial(load_scenario("line"), {MASS: [1.0]}, folder=tmp_path)


def test_first_runs_leave_their_results_which_are_made_again(scenario, tmp_path, undrawn):
    shares = []
    given = {"replay": True, "progress": lambda _, share: shares.append(share)}
    for _ in range(2):
        serial(scenario, {MASS: [0.9, 1.0]}, 2, tmp_path, **given)
        replays = sorted(str(p.relative_to(tmp_path)) for p in tmp_path.rglob("replay.html"))
        assert replays == ["load_mass_0.9/replay.html", "load_mass_1.0/replay.html"]
        (tmp_path / "load_mass_1.0" / "metrics.json").unlink()
    assert "load_mass_0.9/replay.html" in (tmp_path / "index.html").read_text()
    assert shares[-1] == 1.0
    assert shares.count(1.0) == 2


FACTORS = [
    ([MASS], {}, ("factors", "give a mapping")),
    ({MASS: 1.0}, {}, ("factors", MASS, "give a list of values")),
    ({MASS: []}, {}, ("factors", MASS, "give a list of values")),
    ({MASS: [1, 1]}, {}, ("factors", MASS, "give each value once")),
    ({MASS: ["1.0"]}, {}, ("factors", MASS, "without quotes")),
    ({3: [1]}, {}, ("factors", "3", "give paths as texts")),
    ({"a": {"b": ["x"]}}, {}, ("a, b", "x", "give path=value")),
    ({"a": {}}, {}, ("factors.a", "give one level or more")),
    ({"phase": [lambda model: None]}, {}, ("phase", "processes cannot import it")),
    ({"system.load_mas": [1.0, 2.0]}, {}, ("system.load_mas", "did you mean load_mass")),
    ({MASS: [1.0]}, {"seeds": 0}, ("seeds", "0", "give")),
    ({MASS: [1.0]}, {"seeds": [-1]}, ("seeds", "-1", "give")),
    ({MASS: [1.0]}, {"seeds": "a"}, ("seeds", "a", "give")),
    ({MASS: [1.0]}, {"seeds": 10**6}, ("study", "1000000 runs", "give 1 to")),
    ({MASS: [1.0]}, {"folder": 3}, ("folder", "3", "give a path")),
    ({MASS: [1.0]}, {"progress": 3}, ("progress", "3", "give a function")),
]


@pytest.mark.parametrize(("factors", "options", "words"), FACTORS)
def test_what_cannot_be_used_is_one_sentence(scenario, factors, options, words):
    with pytest.raises(ScenarioError) as raised:
        serial(scenario, factors, **options)
    assert "\n" not in str(raised.value)
    assert all(word in str(raised.value) for word in words)


def test_changes_apply_in_their_order_and_differ_by_name_where_results_may(scenario):
    changes = [f"{MASS}=2", {"phase": PaperPhase}, "phase=AccumulatedPhase"]
    made, others = varied(scenario, changes, trust=False)
    assert made.system.load_mass == 2
    assert type(made.phase).__name__ == "AccumulatedPhaseConfig"
    assert others == {}
    changes = [{"load_disturbance": Push}, "load_disturbance=!DisturbanceForce {}"]
    with pytest.raises(ScenarioError, match="load_disturbance is made by"):
        varied(scenario, changes, trust=False)
    every = [
        *([], ["a=1"], [{"phase": PaperPhase}], [{"phase": AccumulatedPhase}]),
        [{"phase": PaperPhaseConfig()}],
        *([{"load_disturbance": functools.partial(Push, force=force)}] for force in (1.0, 2.0)),
    ]
    assert len({identity(changes) for changes in every}) == len(every)


def made(values, factors, **columns):
    """A study of made-up errors (settings, seeds) in m."""
    about = {"ending": COMPLETED, "message": "", "outcome": "ok"} | columns
    rows = [
        each | {"seed": k} | about | {ERROR: value}
        for each, row in zip(factors, np.asarray(values, dtype=float), strict=True)
        for k, value in enumerate(row)
    ]
    settings = [Setting(factors=each) for each in factors]
    return Study(title="made up", table=pandas.DataFrame(rows), settings=settings)


def test_statistics_over_seeds_and_paired_differences_are_those_of_scipy():
    values = np.array([[1.0, 2.0, 3.0], [1.5, 2.6, 3.4]])
    row = made(values, [{"a": 1}, {"a": 2}]).summary().loc[2]
    assert row["completed", ""] == row["ok", ""] == 3
    assert row[ERROR, "std"] == pytest.approx(np.std(values[1], ddof=1))
    for name, of in (("mean", values[1]), ("change", values[1] - values[0])):
        low, high = scipy.stats.ttest_1samp(of, 0).confidence_interval()
        prefix = "" if name == "mean" else "change "
        found = [row[ERROR, part] for part in (name, f"{prefix}low", f"{prefix}high")]
        assert found == pytest.approx([np.mean(of), low, high])


def test_what_did_not_complete_is_left_out_and_told():
    done = made([[1.0, 1.0, 1.0]], [{"a": 1}])
    done.table.loc[2, ["ending", "message", ERROR]] = [FAILED, "the wind broke", 9.0]
    assert done.summary()[ERROR, "mean"].tolist() == [1.0]
    assert "2 ok, 1 failed" in str(done)
    assert "a=1: the wind broke" in str(done)


def test_changes_are_marked_where_their_interval_leaves_no_doubt():
    page = made([[1, 2], [2, 3.1], [2, 1]], [{"a": k} for k in "xyz"])._repr_html_()
    assert (page.count("class=worse"), page.count("class=better")) == (1, 0)


def test_no_name_is_cut_in_tables():
    names = [f"variant & number {k} with quite a long name{'x' * k}" for k in range(40)]
    done = made(np.random.default_rng(0).random((40, 3)), [{"variant": name} for name in names])
    assert all(name in str(done) for name in names)
    assert all(name.replace("&", "&amp;") in done._repr_html_() for name in names)
    assert all(name.replace("&", r"\&") in done.latex() for name in names)
    assert done.latex().count(r"\\") == 41


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ((2.0,), "2.00"),
        ((0.123456, 0.0123), "0.123 ± 0.012"),
        ((1.0, 1e-12), "1.00"),
        ((1e-6,), "≈ 0"),
        ((float("nan"),), "–"),
        ((0.5, 0.1, "+"), "+0.50 ± 0.10"),
    ],
)
def test_numbers_have_the_digits_that_their_uncertainty_leaves(given, text):
    assert number(*given) == text


def test_lines_with_bands_over_a_factor_of_numbers():
    factors = [{"layer": a, "gain": b} for a in ("p", "q", "r") for b in (3.0, 1.0, 2.0)]
    values = np.arange(27).reshape(9, 3) + np.random.default_rng(0).random((9, 3))
    (axes,) = made(values, factors).figure().axes
    assert axes.get_xlabel() == "gain"
    assert [line.get_label() for line in axes.lines] == ["p", "q", "r"]
    assert axes.lines[0].get_xdata().tolist() == [1.0, 2.0, 3.0]
    assert len(axes.collections) == 3


def test_a_row_for_each_of_many_names_in_a_figure():
    factors = [{"variant": f"variant number {k} with a long name"} for k in range(46)]
    figure = made(np.random.default_rng(0).random((46, 2)), factors).figure()
    (axes,) = figure.axes
    figure.draw_without_rendering()
    labels = [label.get_window_extent() for label in axes.get_yticklabels()]
    assert len(labels) == 46
    assert min(label.x0 for label in labels) >= 0
    assert all(a.y0 >= b.y1 - 1 for a, b in itertools.pairwise(labels))
    with pytest.raises(ScenarioError, match="path = no: give the path of a metric"):
        made([[1.0]], [{"a": 1}]).figure("no")


SPEC = """
description: two masses
overrides: ["simulated.load_mass=!Uniform {min: 0.9, max: 1.1}"]
grid: {system.load_mass: [0.9, 1.0]}
seeds: 3
"""


@pytest.fixture
def written(tmp_path):
    def write(text):
        (tmp_path / "mine.yaml").write_text(text)
        return tmp_path / "mine.yaml"

    return write


def test_a_file_states_variants_or_values(written):
    text = "variants:\n  a: [x=1, 'y=!B {c: 2}']\n  b c: [phase=PaperPhase]"
    factors = read_grid(written(text)).factors
    assert factors == {"variant": {"a": ["x=1", "y=!B {c: 2}"], "b c": ["phase=PaperPhase"]}}
    text = """
    grid:
      phase: [!PaperPhase {}, AccumulatedPhase]
      pattern.phases: [[0.0, 0.5, 0.0, 0.5]]
      carrier_controller.velocity_gain: [1.5, 1e+1]
      load_feedback.seed: [3, 4]
    """
    grid = read_grid(written(text))
    assert grid.seeds == [3, 4]  # not a factor: what a figure's bands are over
    settings = settings_of_factors(grid.factors)
    gains = [setting.factors["carrier_controller.velocity_gain"] for setting in settings]
    phases = [setting.factors["phase"] for setting in settings]
    assert phases == 2 * ["PaperPhase"] + 2 * ["AccumulatedPhase"]
    assert gains == 2 * [1.5, 10.0]
    made = changed(load_scenario("line"), settings[0].changes)
    assert made.pattern.phases == [0.0, 0.5, 0.0, 0.5]
    assert type(made.phase).__name__ == "PaperPhaseConfig"


GRIDS = [
    ("", ("mine.yaml", "give variants or grid")),
    ("description: nothing more", ("mine.yaml", "give variants or grid")),
    ("variants: {a: [b=1]}\ngrid: {b: [1]}", ("mine.yaml", "variants and grid")),
    ("variant: {a: [b=1]}", ("mine.yaml.variant",)),
    ("variants: [a=1]", ("mine.yaml.variants", "give a mapping from names to lists")),
    ("variants: !Odd {a: [b=1]}", ("mine.yaml.variants", "give a mapping")),
    ("variants: {a: b=1}", ("mine.yaml.variants.a", "b=1", "give a list")),
    ("variants: {a: [b]}", ("mine.yaml.variants.a", "b", "give path=value")),
    ("variants: {a: [b=1], a: [b=2]}", ("mine.yaml", "given twice")),
    ("grid: [1]", ("mine.yaml.grid", "give a mapping from names to lists")),
    ("grid: {a: []}", ("mine.yaml.grid.a", "give a list")),
    ("grid: {a: [1", ("mine.yaml", "valid YAML")),
    ("overrides: a=1\nseeds: 2", ("mine.yaml.overrides", "a=1", "give a list")),
]


@pytest.mark.parametrize(("text", "words"), GRIDS)
def test_a_file_that_cannot_be_used_is_one_sentence(written, text, words):
    with pytest.raises(ScenarioError) as raised:
        read_grid(written(text))
    assert "\n" not in str(raised.value)
    assert all(word in str(raised.value) for word in words)


def test_there_is_no_such_grid_or_file(tmp_path):
    for name, words in (("papers", ", ".join(grid_names())), (tmp_path / "no.yaml", "can be read")):
        with pytest.raises(ScenarioError, match=words):
            read_grid(name)


@pytest.mark.parametrize("name", grid_names())
def test_grids_of_the_package_apply_to_their_scenarios(name):
    grid = read_grid(name)
    assert grid.description
    base = "aircraft_transfer" if name in ("airspeed", "cables") else "line"
    for overrides in grid.variants.values():
        variant = changed(load_scenario(base), overrides)
        check(variant)
        make_nonstop(variant, at_equilibrium=False)


def test_variants_by_their_overrides():
    names = name_overrides(["phase=my.Own", "carrier_controller=!CarrierPid {}"])
    assert names == "my.Own, CarrierPid"
    several = ["system.load_mass=1", "simulated.load_mass=2", "simulation_duration=3"]
    told = "system.load_mass=1, simulated.load_mass=2, simulation_duration=3"
    assert name_overrides(several) == told


def test_an_ablation_begins_with_the_scenario_as_it_is(scenario, tmp_path):
    variants = {"a": [f"{MASS}=0.9"], "b": [f"{MASS}=-1"]}
    given = {"seeds": 2, "replay": False, "executor": SerialExecutor()}
    table = ablate(scenario, variants, tmp_path, **given).table
    assert table["variant"].tolist() == 2 * ["as it is"] + 2 * ["a"] + 2 * ["b"]
    assert table["ending"].tolist() == 4 * [COMPLETED] + 2 * [UNBUILDABLE]
    assert "system.load_mass = -1.0: give" in table["message"][4]
    wrong = ({"a": "phase=PaperPhase"}, {"a": [3]}, {1: ["a=1"]}, ["phase=PaperPhase"], 3)
    for each in wrong:
        with pytest.raises(ScenarioError, match=r"variant.* = .*: give "):
            ablate(scenario, each, tmp_path)


def test_a_sweep_of_a_file(scenario, written):
    done = sweep(scenario, written(SPEC), executor=SerialExecutor())
    assert done.title == "two masses"
    masses = done.table["simulated.load_mass"].tolist()
    assert masses[:3] == masses[3:]  # each seed draws the same for all
    assert len({*masses}) == 3


@pytest.mark.parametrize("name", ["quintic", "aircraft_rest", "estimated_wind"])
def test_each_error_of_robustness_makes_a_scenario(name, monkeypatch):
    found = {}
    monkeypatch.setattr("drake_nonstop.studies.presets.study", lambda *a, **_: found.update(a[1]))
    feedback = "load_feedback=!FilteredFeedback {position_noise: 0.001}"
    own = name == "estimated_wind"
    base = load_scenario("quintic", [feedback]) if own else load_scenario(name)
    robustness(base)
    assert len(found["error"]) == 33
    for changes in found["error"].values():
        check(changed(base, changes))


@pytest.mark.nightly("studies")
def test_robustness(scenario, tmp_path):
    table = robustness(scenario, tmp_path).table
    assert (table["ending"] == COMPLETED).all()
    errors = table[ERROR]
    assert errors[table["error"] == "load mass +20 %"].iloc[0] > errors[0]


@pytest.mark.slow
def test_the_commands(written, tmp_path, capsys, undrawn):
    call = ["line", "--set", *SHORT, "--out", str(tmp_path / "out")]
    vary = ["--vary", MASS, "0.9", "-1.0", "--vary", "phase", "PaperPhase"]
    assert main(["study", *call, *vary]) == 1
    out = capsys.readouterr().out
    assert f"results: {tmp_path / 'out' / 'index.html'}" in out
    assert "system.load_mass = -1.0: give" in out
    swap = ["--swap", "phase=PaperPhase", f"{MASS}=1.1", "--no-replay", "--restart"]
    assert main(["ablate", *call, "--grid", "paper", *swap]) == 0
    out = capsys.readouterr().out
    assert "without optimization" in out
    assert "PaperPhase, load_mass=1.1" in out
    spec = ["sweep", "line", str(written(SPEC)), *call[1:]]
    assert main([*spec, "--restart"]) == 0
    lines = (tmp_path / "out" / "runs.csv").read_text().splitlines()
    assert lines[0].startswith("run,system.load_mass,seed,simulated.load_mass,ending")
    assert len(lines) == 1 + 6
    one = [*spec[:-1], str(tmp_path / "one"), "--run"]
    assert main([*one, "5"]) in (0, 3)
    drawn = re.search(r"load_mass: (.*)", (tmp_path / "one" / "scenario.yaml").read_text())
    assert drawn
    capsys.readouterr()
    swap = ["ablate", *call, "--swap", "phase"]
    for bad in (["study", *call], ["ablate", *call], swap, [*one, "6"]):
        assert main(bad) == 2
        assert re.match(r"drake-nonstop: --.* = .*: give ", capsys.readouterr().err)
