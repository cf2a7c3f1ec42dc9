"""One study: factors, seeds, endings, statistics, and what is written."""

import functools
import itertools
import json

import numpy as np
import pandas
import pytest
from pydrake.systems.framework import LeafSystem

from drake_nonstop import DisturbanceForceConfig, load_scenario, study
from drake_nonstop.blocks.phase import AccumulatedPhase, PaperPhase, PaperPhaseConfig
from drake_nonstop.cli.main import main
from drake_nonstop.studies.attempts import (
    COMPLETED,
    DIVERGED,
    FAILED,
    UNBUILDABLE,
    attempts,
)
from drake_nonstop.studies.changes import identity, label, varied
from drake_nonstop.studies.study import Setting, Study
from drake_nonstop.studies.summary import Summary, number
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


class TestRuns:
    def test_a_column_per_factor_and_a_row_per_run(self, noisy):
        factors = {"phase": ["AccumulatedPhase", "PaperPhase"], MASS: [0.9, 1.0]}
        done = serial(noisy, factors, seeds=2)
        table = done.table
        assert [*table.columns[:3]] == ["phase", MASS, "seed"]
        assert table["phase"].tolist() == 4 * ["AccumulatedPhase"] + 4 * ["PaperPhase"]
        assert table[MASS].tolist() == 2 * [0.9, 0.9, 1.0, 1.0]
        assert table["seed"].tolist() == 4 * [0, 1]
        assert (table["ending"] == COMPLETED).all()
        assert table[ERROR].nunique() == 8  # noise differs with the seed, to which all react
        assert done.folder is None

    def test_seeds_are_of_distributions_and_of_blocks(self, scenario):
        drawn = load_scenario("line", [*SHORT, "simulated.load_mass=!Uniform {min: 1.0, max: 1.2}"])
        table = serial(drawn, {}, seeds=[3, 4, 3]).table
        assert table["seed"].tolist() == [3, 4]
        assert table["simulated.load_mass"].between(1.0, 1.2).all()
        drawn.random_seed = 4
        assert drawn.sampled().simulated.load_mass == table["simulated.load_mass"][1]
        assert "seed" not in serial(scenario, {MASS: [1.0]}).table

    def test_levels_may_be_named_and_change_several_fields(self, scenario):
        levels = {"light": [f"{MASS}=0.5"], "far": [{"load_disturbance": strong}]}
        table = serial(scenario, {"what": levels}).table
        assert table["what"].tolist() == ["light", "far"]
        assert (table["ending"] == COMPLETED).all()

    def test_levels_may_be_classes_configs_and_functions(self, scenario):
        config = DisturbanceForceConfig(force=[0.1, 0.0, 0.0])
        table = serial(scenario, {"load_disturbance": [config, Push, strong]}).table
        names = table["load_disturbance"].tolist()
        assert names[1:] == [f"{__name__}.Push", f"{__name__}.strong"]
        assert (table["ending"] == COMPLETED).all()
        assert table[ERROR].nunique() == 3

    def test_runs_have_endings_of_their_own(self, faulty_blocks):
        block = "load_disturbance=!faulty_blocks.FaultyWind {}"
        own = load_scenario("line", [*SHORT, block], trust=True)
        faults = ["none", "raises", "diverges", "exits", "constructor"]
        done = serial(own, {"load_disturbance.fault": faults})
        endings = [COMPLETED, FAILED, DIVERGED, FAILED, UNBUILDABLE]
        assert done.table["ending"].tolist() == endings
        assert "the wind broke" in done.table["message"][1]
        assert "the wind broke" in str(done)
        assert done.table[ERROR].notna().tolist() == [True, True, True, True, False]

    def test_processes_make_the_table_of_one(self, scenario):
        factors = {MASS: [0.9, 1.0, 1.1]}
        whole, parts = serial(scenario, factors).table, study(scenario, factors).table
        pandas.testing.assert_frame_equal(known(whole), known(parts))

    def test_a_level_that_cannot_be_used_is_a_row_and_none_an_error(self, scenario):
        table = serial(scenario, {MASS: [1.0, -1.0]}).table
        assert table["ending"].tolist() == [COMPLETED, UNBUILDABLE]
        assert "system.load_mass = -1.0: give" in table["message"][1]
        with pytest.raises(ScenarioError, match="did you mean load_mass"):
            serial(scenario, {"system.load_mas": [1.0, 2.0]})

    @pytest.mark.parametrize(
        ("factors", "options", "words"),
        [
            ([MASS], {}, "factors = .*give a mapping"),
            ({MASS: 1.0}, {}, "give a list of values"),
            ({MASS: []}, {}, "give a list of values"),
            ({MASS: [1, 1]}, {}, "give each value once"),
            ({MASS: ["1.0"]}, {}, "without quotes"),
            ({3: [1]}, {}, "give paths as texts"),
            ({"a": {"b": ["x"]}}, {}, "a, b = x: give path=value"),
            ({"a": {}}, {}, "give one level or more"),
            ({"phase": [lambda model: None]}, {}, "processes cannot import it"),
            ({MASS: [1.0]}, {"seeds": 0}, "seeds = 0: give"),
            ({MASS: [1.0]}, {"seeds": [-1]}, "seeds = -1: give"),
            ({MASS: [1.0]}, {"seeds": "a"}, "seeds = a: give"),
            ({MASS: [1.0]}, {"seeds": 10**6}, "1000000 runs: give 1 to"),
            ({MASS: [1.0]}, {"folder": 3}, "folder = 3: give a path"),
            ({MASS: [1.0]}, {"progress": 3}, "progress = 3: give a function"),
        ],
    )
    def test_what_cannot_be_used_is_one_sentence(self, scenario, factors, options, words):
        with pytest.raises(ScenarioError, match=words) as raised:
            serial(scenario, factors, **options)
        assert "\n" not in str(raised.value)


def made(values, factors, outcome="ok", ending=COMPLETED):
    """A study of made-up errors (settings, seeds) in m."""
    values = np.asarray(values, dtype=float)
    settings = [Setting(factors=each) for each in factors]
    rows = [
        each | {"seed": k, "ending": ending, "message": "", "outcome": outcome, ERROR: value}
        for each, row in zip(factors, values, strict=True)
        for k, value in enumerate(row)
    ]
    return Study(title="made up", table=pandas.DataFrame(rows), settings=settings)


class TestSummary:
    def test_statistics_over_seeds_and_paired_differences(self):
        values = [[1.0, 2.0, 3.0], [1.5, 2.6, 3.4]]
        done = made(values, [{"a": 1}, {"a": 2}])
        row = done.summary().loc[2]
        assert row["completed", ""] == row["ok", ""] == 3
        assert row[ERROR, "mean"] == pytest.approx(2.5)
        assert row[ERROR, "std"] == pytest.approx(np.std(values[1], ddof=1))
        half = 4.302652729911275 * np.std(values[1], ddof=1) / np.sqrt(3)
        assert row[ERROR, "low"] == pytest.approx(2.5 - half)
        assert row[ERROR, "high"] == pytest.approx(2.5 + half)
        # The differences vary far less than the values.
        assert row[ERROR, "change"] == pytest.approx(0.5)
        assert row[ERROR, "change low"] == pytest.approx(0.5 - 4.302652729911275 * 0.1 / 3**0.5)

    @pytest.mark.parametrize(
        ("given", "text"),
        [
            ((1.23456,), "1.23"),
            ((0.0,), "0"),
            ((1e-7,), "≈ 0"),
            ((12.3456, 0.0342), "12.346 ± 0.034"),
            ((1234.5, 220.0), "1234 ± 220"),
            ((0.5, 0.1, "+"), "+0.50 ± 0.10"),
            ((float("nan"),), "–"),
        ],
    )
    def test_numbers(self, given, text):
        assert number(*given) == text

    def test_names_are_not_cut(self):
        name = "a name of a variant that is much longer than what tables have room for, by far"
        done = made([[1e-3, 2e-3], [2e-3, 3e-3]], [{"variant": "as it is"}, {"variant": name}])
        assert name in str(done)
        assert name in done.latex()
        assert name in done._repr_html_()

    def test_latex_has_no_character_that_ends_it(self):
        done = made([[1e-3], [2e-3]], [{"a_b": "50 %"}, {"a_b": "x & y_#"}])
        assert r"a\_b" in done.latex()
        assert r"50 \%" in done.latex()
        assert r"x \& y\_\#" in done.latex()

    def test_outcomes_are_counted_where_they_differ(self):
        done = made([[1.0, 1.0, 1.0]], [{"a": 1}])
        done.table.loc[2, "outcome"] = "bound_missed"
        assert Summary(done.table, done.settings).outcomes() == ["2 ok, 1 bound_missed"]

    def test_changes_are_marked_where_their_interval_leaves_no_doubt(self):
        done = made([[1, 2], [2, 3.1], [2, 1]], [{"a": k} for k in "xyz"])
        page = done._repr_html_()
        assert page.count("<span class=worse>") == 1
        assert page.count("<span class=better>") == 0


class TestFigures:
    def test_lines_with_bands_over_a_factor_of_numbers(self):
        factors = [{"layer": a, "gain": b} for a in ("p", "q", "r") for b in (3.0, 1.0, 2.0)]
        values = np.arange(27).reshape(9, 3) + np.random.default_rng(0).random((9, 3))
        (axes,) = made(values, factors).figure().axes
        assert axes.get_xlabel() == "gain"
        assert [line.get_label() for line in axes.lines] == ["p", "q", "r"]
        assert axes.lines[0].get_xdata().tolist() == [1.0, 2.0, 3.0]
        assert len(axes.collections) == 3

    def test_a_row_for_each_of_many_names(self):
        factors = [{"variant": f"variant number {k} with a long name"} for k in range(46)]
        figure = made(np.random.default_rng(0).random((46, 2)), factors).figure()
        (axes,) = figure.axes
        figure.draw_without_rendering()
        labels = [label.get_window_extent() for label in axes.get_yticklabels()]
        assert len(labels) == 46
        assert min(label.x0 for label in labels) >= 0
        assert all(a.y0 >= b.y1 - 1 for a, b in itertools.pairwise(labels))

    def test_there_is_no_such_metric(self):
        with pytest.raises(ScenarioError, match="path = no: give the path of a metric"):
            made([[1.0]], [{"a": 1}]).figure("no")


class TestFolder:
    def test_what_is_written(self, noisy, tmp_path):
        done = serial(noisy, {"phase": ["AccumulatedPhase", "PaperPhase"]}, 2, tmp_path)
        names = {path.name for path in tmp_path.iterdir()}
        figures = {"load_position_error_mean_m", "carriers_speed_min_m_s"}
        assert {f"{name}.{kind}" for name in figures for kind in ("png", "pdf")} < names
        assert {"journal.jsonl", "runs.csv", "summary.csv", "summary.tex", "index.html"} < names
        table = pandas.read_csv(tmp_path / "runs.csv", index_col="run")
        pandas.testing.assert_frame_equal(
            table[[ERROR]], done.table[[ERROR]], check_exact=False, rtol=1e-15
        )
        summary = pandas.read_csv(tmp_path / "summary.csv", header=[0, 1], index_col=0)
        assert len(summary) == 2
        assert "<details>" in (tmp_path / "index.html").read_text()

    def test_first_runs_leave_their_results(self, noisy, tmp_path, undrawn):
        serial(noisy, {MASS: [0.9, 1.0]}, 2, tmp_path, replay=True)
        replays = sorted(str(p.relative_to(tmp_path)) for p in tmp_path.rglob("replay.html"))
        assert replays == ["load_mass_0.9/replay.html", "load_mass_1.0/replay.html"]
        assert "load_mass_0.9/replay.html" in (tmp_path / "index.html").read_text()

    def test_it_goes_on_from_what_is_there(self, scenario, tmp_path):
        shares = []
        told = functools.partial(serial, progress=lambda what, share: shares.append(share))
        first = told(scenario, {MASS: [0.9, 1.0]}, folder=tmp_path)
        more = told(scenario, {MASS: [0.9, 1.0, 1.1]}, folder=tmp_path)
        assert len(shares) == 2 + 1
        pandas.testing.assert_frame_equal(known(first.table), known(more.table.iloc[:2]))
        told(scenario, {MASS: [0.9, 1.0]}, folder=tmp_path, restart=True)
        assert len(shares) == 5
        lines = (tmp_path / "journal.jsonl").read_text().splitlines()
        assert len(lines) == 1 + 2
        with pytest.raises(ScenarioError, match="is of another scenario or other code"):
            told(load_scenario("line"), {MASS: [1.0]}, folder=tmp_path)

    def test_results_that_are_gone_are_made_again(self, scenario, tmp_path, undrawn):
        serial(scenario, {MASS: [0.9, 1.0]}, folder=tmp_path, replay=True)
        (tmp_path / "load_mass_1.0" / "metrics.json").rename(tmp_path / "moved")
        shares = []
        given = {"replay": True, "progress": lambda what, share: shares.append(share)}
        serial(scenario, {MASS: [0.9, 1.0]}, folder=tmp_path, **given)
        assert len(shares) == 1
        assert (tmp_path / "load_mass_1.0" / "metrics.json").exists()


class TestChanges:
    def test_they_apply_in_their_order(self, scenario):
        changes = [f"{MASS}=2", {"phase": PaperPhase}, "phase=AccumulatedPhase"]
        made, others = varied(scenario, changes, trust=False)
        assert made.system.load_mass == 2
        assert type(made.phase).__name__ == "AccumulatedPhaseConfig"
        assert others == {}
        changes = [{"load_disturbance": Push}, "load_disturbance=!DisturbanceForce {}"]
        with pytest.raises(ScenarioError, match="load_disturbance is made by"):
            varied(scenario, changes, trust=False)

    def test_names(self):
        assert label(PaperPhase) == "PaperPhase"
        assert label(functools.partial(Push, force=1.0)) == f"{__name__}.Push(force=1.0)"

    def test_the_identity_differs_where_results_may(self):
        of = [
            [],
            ["a=1"],
            [{"phase": PaperPhase}],
            [{"phase": AccumulatedPhase}],
            [{"phase": PaperPhaseConfig()}],
            [{"load_disturbance": functools.partial(Push, force=1.0)}],
            [{"load_disturbance": functools.partial(Push, force=2.0)}],
        ]
        assert len({identity(changes) for changes in of}) == len(of)


def test_the_ending_of_an_attempt(faulty_blocks):
    endings = {}
    for fault in ("none", "raises", "diverges", "constructor", "exits", "constructor exits"):
        block = f"load_disturbance=!faulty_blocks.FaultyWind {{fault: {fault}}}"
        make = functools.partial(load_scenario, "line", [*SHORT, block], trust=True)
        _, tried = next(attempts([(make, {})]))
        endings[fault] = tried.ending
        assert (tried.run is None) == fault.startswith("constructor")
        assert (tried.message == "") == (tried.ending == COMPLETED)
    assert endings == {
        "none": COMPLETED,
        "raises": FAILED,
        "diverges": DIVERGED,
        "constructor": UNBUILDABLE,
        "exits": FAILED,
        "constructor exits": UNBUILDABLE,
    }


@pytest.mark.slow
def test_the_command(tmp_path, capsys):
    call = ["study", "line", "--set", *SHORT, "--out", str(tmp_path / "out")]
    assert main([*call, "--vary", MASS, "0.9", "1.0", "--vary", "phase", "PaperPhase"]) == 0
    out = capsys.readouterr().out
    assert f"results: {tmp_path / 'out' / 'index.html'}" in out
    rows = (tmp_path / "out" / "journal.jsonl").read_text().splitlines()[1:]
    assert all(json.loads(row)["ending"] == COMPLETED for row in rows)
    assert main([*call, "--vary", MASS, "1.0", "-1.0"]) == 1
    assert "give" in capsys.readouterr().out
    assert main(["study", "line"]) == 2
