"""One study and its presets: factors, seeds, endings, statistics, and what is written."""

import functools
import itertools
import re
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pandas
import pytest
import scipy.stats
from helpers import nightly_beyond
from pydrake.systems.framework import LeafSystem

from drake_nonstop import (
    DisturbanceForceConfig,
    ScenarioError,
    SerialExecutor,
    ablate,
    make_nonstop,
    read_grid,
    robustness,
    study,
)
from drake_nonstop.blocks.phase import PaperPhase, PaperPhaseConfig
from drake_nonstop.cli.main import main
from drake_nonstop.scenario.loading import load_scenario

SHORT = ["simulation_duration=0.1", "optimization_layer=ConstantParameters"]
ERROR, SPEED = "load.position_error_mean_m", "carriers.speed_min_m_s"
MASS = "system.load_mass"
GRIDS = sorted((Path(__file__).parents[2] / "diagrams" / "grids").glob("*.yaml"))
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


class MadeUp(Executor):
    """Answers a study's calls with these values of a metric, in place of flights; NaN: it fails."""

    def __init__(self, values, path=ERROR):
        self._values, self._path = iter(np.ravel(values).tolist()), path

    def submit(self, fn, calls):
        future = Future()
        future.set_result([self._row(next(self._values)) for _ in calls])
        return future

    def _row(self, value):
        made = {"ending": "completed", "message": "", "drawn": {}}
        if np.isnan(value):
            return made | {"ending": "failed", "message": "the wind broke", "metrics": {}}
        return made | {"metrics": {"outcome": "ok", self._path: value}}


def made(values, factors, path=ERROR):
    """A study of "line" with made-up values (settings, seeds)."""
    executor = MadeUp(np.asarray(values, dtype=float), path)
    return study(load_scenario("line"), factors, len(values[0]), executor=executor)


def named(names):
    return {"variant": {name: [] for name in names}}


def test_a_column_per_factor_a_row_per_run_and_files_that_have_them(noisy, tmp_path):
    factors = {"phase": ["AccumulatedPhase", "PaperPhase"], MASS: [0.9, 1.0]}
    table = serial(noisy, factors, seeds=2, folder=tmp_path).table
    assert [*table.columns[:3]] == ["phase", MASS, "seed"]
    assert table["phase"].tolist() == 4 * ["AccumulatedPhase"] + 4 * ["PaperPhase"]
    assert table[MASS].tolist() == 2 * [0.9, 0.9, 1.0, 1.0]
    assert table["seed"].tolist() == 4 * [0, 1]
    assert (table["ending"] == "completed").all()
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


def test_levels_are_values_blocks_or_lists_of_changes_in_their_order(scenario):
    levels = {
        "light": [f"{MASS}=0.5"],
        "far": [{"load_disturbance": strong}],
        "less": [{"load_disturbance": functools.partial(Push, force=1.0)}],
        "paper": ["phase=AccumulatedPhase", {"phase": PaperPhase}],
        "default": [{"phase": PaperPhaseConfig()}, "phase=AccumulatedPhase"],
    }
    table = serial(scenario, {"what": levels}).table
    assert table["what"].tolist() == [*levels]
    assert table[ERROR].nunique() == 5
    config = DisturbanceForceConfig(force=[0.1, 0.0, 0.0])
    table = serial(scenario, {"load_disturbance": [config, Push, strong]}).table
    assert table["load_disturbance"].tolist()[1:] == [f"{__name__}.Push", f"{__name__}.strong"]
    assert (table["ending"] == "completed").all()
    assert table[ERROR].nunique() == 3


def test_runs_have_endings_of_their_own():
    endings = {
        "none": "completed",
        "flown raises": "failed",
        "flown diverges": "diverged",
        "flown exits": "failed",
        "built raises": "unbuildable",
        "built exits": "unbuildable",
    }
    block = "load_disturbance=!faulty_blocks.FaultyWind {}"
    done = serial(
        load_scenario("line", [*SHORT, block], trust=True), {"load_disturbance.fault": [*endings]}
    )
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
    more = told({MASS: [0.9, 1.0, 1.1]}, executor=ThreadPoolExecutor(2))
    assert len(shares) == 2 + 1
    whole = serial(scenario, {MASS: [0.9, 1.0, 1.1]}).table
    pandas.testing.assert_frame_equal(known(first.table), known(whole.iloc[:2]))
    pandas.testing.assert_frame_equal(known(more.table), known(whole))
    told({MASS: [0.9, 1.0]}, restart=True, executor=SerialExecutor())
    assert len(shares) == 5
    with pytest.raises(ScenarioError, match="is of another scenario or other code"):
        serial(load_scenario("line"), {MASS: [1.0]}, folder=tmp_path)


def test_other_code_of_the_users_own_is_another_study(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tmp_path))
    code = "import faulty_blocks\nclass MineConfig(faulty_blocks.FaultyWindConfig): pass\n"
    code += "class Mine(faulty_blocks.FaultyWind): pass\n"
    block = "load_disturbance=!blocks_of_mine.Mine {}"
    for more, refused in (("", False), ("", False), ("# changed\n", True)):
        (tmp_path / "blocks_of_mine.py").write_text(code + more)
        made = load_scenario("line", [*SHORT, block], trust=True)
        with pytest.raises(ScenarioError, match="other code") if refused else nullcontext():
            serial(made, {MASS: [1.0]}, folder=tmp_path / "out")


@pytest.mark.usefixtures("undrawn")
def test_first_runs_leave_their_results_which_are_made_again(scenario, tmp_path):
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


class Broken(Executor):
    """Its workers end before a call does."""

    def submit(self, fn, /, *args, **kwargs):
        future = Future()
        future.set_exception(BrokenExecutor("a worker has ended"))
        return future


CLOSED = ThreadPoolExecutor(1)
CLOSED.shutdown()
TAKEN = {"a": [{"load_disturbance": Push}, "load_disturbance=!DisturbanceForce {}"]}
REFUSED = [
    ({MASS: []}, {}, ("factors", MASS, "give a list of values")),
    ({MASS: [1, 1]}, {}, ("factors", MASS, "give each value once")),
    ({MASS: ["1.0"]}, {}, ("factors", MASS, "without quotes")),
    ({"a": {"b": ["x"]}}, {}, ("a, b", "x", "give path=value")),
    ({"a": {}}, {}, ("factors.a", "give one level or more")),
    ({"a": TAKEN}, {}, ("load_disturbance", "is made by", "leave it out")),
    ({"phase": [lambda model: None]}, {}, ("phase", "processes cannot import it")),
    ({"system.load_mas": [1.0, 2.0]}, {}, ("system.load_mas", "did you mean load_mass")),
    ({MASS: [1.0]}, {"seeds": 10**6}, ("study", "1000000 runs", "give 1 to")),
    *(
        ({MASS: [1.0, 1.1]}, {"executor": executor}, ("executor", "give "))
        for executor in ("x", ThreadPoolExecutor, CLOSED, Broken())
    ),
]


@pytest.mark.parametrize(("factors", "options", "words"), REFUSED)
def test_what_cannot_be_used_is_one_sentence(scenario, factors, options, words):
    with pytest.raises(ScenarioError) as raised:
        serial(scenario, factors, **options)
    assert "\n" not in str(raised.value)
    assert all(word in str(raised.value) for word in words)


def test_statistics_over_seeds_and_paired_differences_are_those_of_scipy():
    values = np.array([[1.0, 2.0, 3.0], [1.5, 2.6, 3.4]])
    row = made(values, {MASS: [1.0, 2.0]}).summary().loc[2]
    assert row["completed", ""] == row["ok", ""] == 3
    assert row[ERROR, "std"] == pytest.approx(np.std(values[1], ddof=1))
    for name, of in (("mean", values[1]), ("change", values[1] - values[0])):
        low, high = scipy.stats.ttest_1samp(of, 0).confidence_interval()
        prefix = "" if name == "mean" else "change "
        found = [row[ERROR, part] for part in (name, f"{prefix}low", f"{prefix}high")]
        assert found == pytest.approx([np.mean(of), low, high])


def test_what_did_not_complete_is_told_and_changes_are_marked_where_there_is_no_doubt():
    done = made([[1.0, 1.0, np.nan]], {MASS: [1.0]})
    assert done.summary()[ERROR, "mean"].tolist() == [1.0]
    assert "2 ok, 1 failed" in str(done)
    assert "load_mass=1.0: the wind broke" in str(done)
    page = made([[1, 2], [2, 3.1], [2, 1]], named("xyz"))._repr_html_()
    assert (page.count("class=worse"), page.count("class=better")) == (1, 0)


def test_no_name_is_cut_in_tables_and_each_has_a_row_in_a_figure():
    names = [f"variant & number {k} with quite a long name{'x' * k}" for k in range(12)]
    done = made(np.random.default_rng(0).random((12, 3)), named(names))
    figure = done.figure()
    figure.draw_without_rendering()
    (axes,) = figure.axes
    labels = [label.get_window_extent() for label in axes.get_yticklabels()]
    assert len(labels) == 12
    assert min(label.x0 for label in labels) >= 0
    assert all(a.y0 >= b.y1 - 1 for a, b in itertools.pairwise(labels))
    with pytest.raises(ScenarioError, match="path = no: give the path of a metric"):
        done.figure("no")
    assert all(name in str(done) for name in names)
    assert all(name.replace("&", "&amp;") in done._repr_html_() for name in names)
    assert all(name.replace("&", r"\&") in done.latex() for name in names)
    assert done.latex().count(r"\\") == 13


@pytest.mark.parametrize(
    ("mean", "half", "text"),
    [
        *((2.0, 0.0, "2.00"), (0.123456, 0.0123, "0.123 ± 0.012"), (1.0, 1e-12, "1.00")),
        *((1e-6, 0.0, "≈ 0"), (np.nan, 0.0, "–")),
    ],
)
def test_numbers_have_the_digits_that_their_uncertainty_leaves(mean, half, text):
    spread = half * np.sqrt(3) / scipy.stats.t.ppf(0.975, 2)  # over three seeds
    values = [[1.0, 2.0, 3.0], mean + np.array([-spread, 0, spread])]
    row = str(made(values, named(["a", "b"]), SPEED)).splitlines()
    (cells,) = (line for line in row if line.startswith("b "))
    assert re.search(rf"  {re.escape(text)}(  |$)", cells)


def test_lines_with_bands_over_a_factor_of_numbers():
    factors = {"layer": {name: [] for name in "pqr"}, MASS: [3.0, 1.0, 2.0]}
    values = np.arange(27).reshape(9, 3) + np.random.default_rng(0).random((9, 3))
    (axes,) = made(values, factors).figure().axes
    assert axes.get_xlabel() == MASS
    assert [line.get_label() for line in axes.lines] == ["p", "q", "r"]
    assert axes.lines[0].get_xdata().tolist() == [1.0, 2.0, 3.0]
    np.testing.assert_allclose(axes.lines[0].get_ydata()[1:], 1e3 * values[[2, 0]].mean(axis=1))
    assert len(axes.collections) == 3


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
    """
    grid = read_grid(written(text))
    done = study(load_scenario("line"), grid.factors, executor=MadeUp([1.0] * 4))
    assert done.table["phase"].tolist() == 2 * ["PaperPhase"] + 2 * ["AccumulatedPhase"]
    assert done.table["carrier_controller.velocity_gain"].tolist() == 2 * [1.5, 10.0]
    made = load_scenario("line", done.settings[0].changes)
    assert made.pattern.phases == [0.0, 0.5, 0.0, 0.5]
    assert type(made.phase).__name__ == "PaperPhaseConfig"


BAD_GRIDS = [
    ("", ("mine.yaml", "give variants or grid")),
    ("variants: {a: [b=1]}\ngrid: {b: [1]}", ("mine.yaml", "variants and grid")),
    ("variant: {a: [b=1]}", ("mine.yaml.variant",)),
    ("variants: [a=1]", ("mine.yaml.variants", "give a mapping from names to lists")),
    ("variants: {a: b=1}", ("mine.yaml.variants.a", "b=1", "give a list")),
    ("variants: {a: [b]}", ("mine.yaml.variants.a", "b", "give path=value")),
    ("grid: [1]", ("mine.yaml.grid", "give a mapping from names to lists")),
    ("grid: {a: []}", ("mine.yaml.grid.a", "give a list")),
    ("overrides: a=1\nseeds: 2", ("mine.yaml.overrides", "a=1", "give a list")),
    ("papers", ("papers", ", ".join(path.stem for path in GRIDS))),
]


@pytest.mark.parametrize(("given", "words"), BAD_GRIDS)
def test_a_file_that_cannot_be_used_is_one_sentence(written, given, words):
    is_text = isinstance(given, str) and given != "papers"
    with pytest.raises(ScenarioError) as raised:
        read_grid(written(given) if is_text else given)
    assert "\n" not in str(raised.value)
    assert all(word in str(raised.value) for word in words)


@pytest.mark.parametrize("name", nightly_beyond(2, "studies", [path.stem for path in GRIDS]))
def test_grids_of_the_package_apply_to_their_scenarios(name):
    grid = read_grid(name)
    assert grid.description
    base = "aircraft_transfer" if name in ("airspeed", "cables") else "line"
    for overrides in grid.variants.values():
        make_nonstop(load_scenario(base, overrides), at_equilibrium=False)


def test_an_ablation_begins_with_the_scenario_as_it_is(scenario, tmp_path):
    variants = {"a": [f"{MASS}=0.9"], "b": [f"{MASS}=-1"]}
    given = {"seeds": 2, "replay": False, "executor": SerialExecutor()}
    table = ablate(scenario, variants, tmp_path, **given).table
    assert table["variant"].tolist() == 2 * ["as it is"] + 2 * ["a"] + 2 * ["b"]
    assert table["ending"].tolist() == 4 * ["completed"] + 2 * ["unbuildable"]
    assert "system.load_mass = -1.0: give" in table["message"][4]


FILTERED = ["load_feedback=!FilteredFeedback {position_noise: 0.001}"]


@pytest.mark.parametrize(
    ("name", "changes"),
    nightly_beyond(1, "studies", [("quintic", FILTERED), ("aircraft_rest", []), ("quintic", [])]),
)
def test_each_error_of_robustness_makes_a_scenario_that_is_another(name, changes):
    base = load_scenario(name, changes)
    settings = robustness(base, executor=MadeUp(np.ones(33))).settings
    made = [load_scenario(name, [*changes, *setting.changes]) for setting in settings]
    assert made[0] == base
    assert all(a != b for a, b in itertools.combinations(made, 2))
    feedback = {type(each.load_feedback).__name__ for each in made}
    assert ("FilteredFeedbackConfig" in feedback) == bool(changes)


@pytest.mark.nightly("processes")
@pytest.mark.usefixtures("undrawn")
def test_the_commands(written, tmp_path, capsys):
    call = ["line", "--set", *SHORT, "--out", str(tmp_path / "out")]
    vary = ["--vary", MASS, "0.9", "-1.0", "--vary", "phase", "PaperPhase"]
    assert main(["study", *call, *vary]) == 1
    out = capsys.readouterr().out
    assert f"results: {tmp_path / 'out' / 'index.html'}" in out
    assert "system.load_mass = -1.0: give" in out
    swap = ["--swap", "phase=PaperPhase", f"{MASS}=1.1", "--no-replay", "--restart"]
    assert main(["ablate", *call, "--grid", "paper", *swap]) == 0
    assert f"phase=PaperPhase, {MASS}=1.1" in capsys.readouterr().out
    spec = ["sweep", "line", str(written(SPEC)), *call[1:]]
    assert main([*spec, "--restart"]) == 0
    table = pandas.read_csv(tmp_path / "out" / "runs.csv")
    assert [*table.columns[1:5]] == [MASS, "seed", "simulated.load_mass", "ending"]
    masses = table["simulated.load_mass"].tolist()
    assert masses[:3] == masses[3:]  # each seed draws the same for all
    assert len({*masses}) == 3
    assert "two masses" in (tmp_path / "out" / "index.html").read_text()
    one = [*spec[:-1], str(tmp_path / "one"), "--run"]
    assert main([*one, "5"]) in (0, 3)
    drawn = re.search(r"load_mass: (.*)", (tmp_path / "one" / "scenario.yaml").read_text())
    assert drawn


@pytest.mark.nightly("browsers")
def test_the_bar_of_the_page_drives_all_replays(watched, tmp_path):
    shown = "Math.max(...viewer.animator.actions.map((action) => action.time))"
    scenario = load_scenario("line", ["simulation_duration=1.0"])
    ablate(scenario, {"printed": ["phase=PaperPhase"]}, tmp_path)
    page = watched.page
    page.set_viewport_size({"width": 900, "height": 900})
    page.goto((tmp_path / "index.html").as_uri())
    page.locator("#cards").scroll_into_view_if_needed()
    replays = [frame for frame in page.frames if frame.url.endswith("#embedded")]
    assert len(replays) == 2
    for frame in replays:
        frame.wait_for_function("viewer.animator.actions.length > 0 && !viewer.animator.playing")
    page.locator("#time").fill("0.6")
    for frame in replays:
        frame.wait_for_function(f"Math.abs({shown} - 0.6) < 1e-6")
        assert not frame.locator("#play").is_visible()  # the page has the one for all
    page.locator("#restart").click()
    for frame in replays:
        frame.wait_for_function(f"{shown} > 0.9")  # to the end, where all wait
    assert page.locator("#clock").inner_text().startswith("1.00")
    assert watched.errors == []
    assert all(request.startswith(("file:", "data:", "blob:")) for request in watched.requests)
