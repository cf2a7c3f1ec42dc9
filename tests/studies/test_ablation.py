"""Variants of a scenario, compared."""

import contextlib
import csv
import io
import json
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from helpers import nightly_beyond
from PIL import Image

from drake_nonstop.cli import ending
from drake_nonstop.cli.main import main
from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.run.metrics import flattened
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.scenario.overrides import changed
from drake_nonstop.scenario.schema import check
from drake_nonstop.studies import ablation
from drake_nonstop.studies.ablation import ablate, grid_names, name_overrides, read_grid
from drake_nonstop.studies.ablation_report import (
    BASE,
    PAGE,
    Row,
    as_csv,
    as_markdown,
    as_text,
    ordered,
    write_page,
)
from drake_nonstop.studies.journal import JOURNAL, StudyInterrupted
from drake_nonstop.studies.run_all import COMPLETED, DIVERGED, FAILED, UNBUILDABLE
from drake_nonstop.systems.block import LeafBlock
from drake_nonstop.validation import ScenarioError

PLOTS = {"position_error.png", "slowest_speed.png", "tension_min.png"}
RUN = {"scenario.yaml", "metrics.json", "signals.npz", "diagram.svg", "replay.html"}


def written(tmp_path, text):
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    return path


def contents(folder):
    return {path.name for path in folder.iterdir()}


class TestGrids:
    def test_variants_by_name(self, tmp_path):
        text = "description: two\nvariants:\n  a: [x=1, 'y=!B {c: 2}']\n  b c: [phase=PaperPhase]"
        grid = read_grid(written(tmp_path, text))
        assert grid.name == "mine"
        assert grid.description == "two"
        assert grid.variants == {"a": ["x=1", "y=!B {c: 2}"], "b c": ["phase=PaperPhase"]}

    def test_every_combination_is_named_by_its_values(self, tmp_path):
        text = """
        grid:
          phase: [!PaperPhase {}, AccumulatedPhase]
          carrier_controller.velocity_gain: [1.5, 1e+1]
        """
        assert read_grid(written(tmp_path, text)).variants == {
            "PaperPhase, velocity_gain=1.5": [
                "phase=!PaperPhase {}",
                "carrier_controller.velocity_gain=1.5",
            ],
            "PaperPhase, velocity_gain=10.0": [
                "phase=!PaperPhase {}",
                "carrier_controller.velocity_gain=10.0",
            ],
            "AccumulatedPhase, velocity_gain=1.5": [
                "phase=AccumulatedPhase",
                "carrier_controller.velocity_gain=1.5",
            ],
            "AccumulatedPhase, velocity_gain=10.0": [
                "phase=AccumulatedPhase",
                "carrier_controller.velocity_gain=10.0",
            ],
        }

    def test_values_that_are_no_scalars_reach_the_scenario(self, tmp_path):
        text = """
        grid:
          pattern.phases: [[0.0, 0.5, 0.0, 0.5]]
          optimization_layer: [!RecedingHorizonOptimizer {speed_bound: 0.3, max_speed: .inf}]
        """
        (overrides,) = read_grid(written(tmp_path, text)).variants.values()
        scenario = changed(load_scenario("line"), overrides)
        assert scenario.pattern.phases == [0.0, 0.5, 0.0, 0.5]
        assert scenario.speed_bound == 0.3

    def test_names(self):
        assert name_overrides(["phase=my.Own", "carrier_controller=!CarrierPid {}"]) == (
            "my.Own, CarrierPid"
        )
        assert name_overrides(
            ["system.load_mass=1", "simulated.load_mass=2", "simulation_duration=3"]
        ) == ("system.load_mass=1, simulated.load_mass=2, simulation_duration=3")

    @pytest.mark.parametrize(
        ("text", "words"),
        [
            ("", "give variants or grid"),
            ("[]", "give variants or grid"),
            ("description: nothing more", "give variants or grid"),
            ("variants: {a: [b=1]}\ngrid: {b: [1]}", "variants and grid"),
            ("variant: {a: [b=1]}", "mine.yaml.variant = "),
            ("description: [a]\nvariants: {a: [b=1]}", "give a text"),
            ("variants: [a=1]", "give a mapping from the variants' names"),
            ("variants: !Odd {a: [b=1]}", "give a mapping from the variants' names"),
            ("variants: {}", "give a mapping from the variants' names"),
            ("variants: {a: b=1}", "give a list of path=value"),
            ("variants: {a: []}", "give a list of path=value"),
            ("variants: {' ': [b=1]}", "name it"),
            ("variants: {a: [b]}", "give path=value"),
            ("variants: {a: [=1]}", "give path=value"),
            ("variants:\n  a:\n  - x=!B {c: 2}", "in quotes"),
            ("variants: {a: [b=1], a: [b=2]}", "given twice"),
            ("grid: [1]", "give a mapping from paths"),
            ("grid: {a: 1}", "give a list of values"),
            ("grid: {a: []}", "give a list of values"),
            ("grid: {a: [1, 1]}", "give each value once"),
            ("grid: {a: ['1']}", "without quotes"),
            ("grid: {a: [1", "valid YAML"),
        ],
    )
    def test_anything_else_is_one_clear_sentence(self, tmp_path, text, words):
        with pytest.raises(ScenarioError, match=re.escape(words)) as raised:
            read_grid(written(tmp_path, text))
        assert "mine.yaml" in str(raised.value)
        assert "\n" not in str(raised.value)

    def test_there_is_no_such_grid_or_file(self, tmp_path):
        with pytest.raises(
            ScenarioError, match="one of airspeed, cables, departures, foresight, paper"
        ):
            read_grid("papers")
        with pytest.raises(ScenarioError, match="a file that can be read"):
            read_grid(tmp_path / "none.yaml")

    @pytest.mark.parametrize(
        ("name", "is_built"),
        [
            *((name, False) for name in grid_names()),
            *nightly_beyond(0, "flights", [(name, True) for name in grid_names()]),
        ],
    )
    def test_what_comes_with_the_package_applies_to_its_scenario(self, name, is_built):
        grid = read_grid(name)
        assert grid.description
        of_aircraft = name in ("airspeed", "cables")
        scenario = load_scenario("aircraft_transfer" if of_aircraft else "line")
        for overrides in grid.variants.values():
            variant = changed(scenario, overrides)
            assert variant != scenario
            check(variant)
            if is_built:
                make_nonstop(variant, at_equilibrium=not of_aircraft)


def a_row(name, error=None, below=0.0, ending=COMPLETED, message=""):
    metrics = None
    if error is not None:
        metrics = {
            "outcome": "ok" if ending == COMPLETED else "stopped",
            "load": {"position_error_mean_m": error},
            "carriers": {"time_below_bound_s": below, "speed_min_m_s": 0.25},
        }
    return Row(
        variant=name,
        folder=name,
        overrides=["a=1"],
        ending=ending,
        message=message,
        metrics=metrics,
    )


ROWS = [
    a_row("base", 2e-3, 0.5),
    a_row("cannot", ending=UNBUILDABLE, message="no"),
    a_row("same", 2e-3, 0.5),
    a_row("worse", 3e-3, 0.7),
    a_row("much better", 1e-5, 0.25),
    a_row("a|b", 2.0001e-3, 1.5),
    a_row("crash", 1.0, 0.1, DIVERGED, "it diverged"),
]

CURVES = {
    "base": {
        "sample_times": [0.0, 1.0],
        "position_error": [1.0, 1.0],
        "step_times": [0.0, 1.0],
        "slowest_speed": [1.0, 1.0],
        "speed_bound": [1.0, 1.0],
        "least_tension": [1.0, 1.0],
    }
}


class TestTables:
    def test_the_largest_effect_comes_first_whatever_its_sign(self):
        names = [row.variant for row in ordered(ROWS)]
        assert names == ["base", "crash", "much better", "worse", "a|b", "same", "cannot"]

    def test_markdown(self):
        lines = as_markdown(ordered(ROWS)).splitlines()
        cells = {line.split(" | ")[0][2:]: line.split(" | ") for line in lines[2:9]}
        assert cells["base"][1:4] == ["ok", "2.00", "–"]
        assert cells["much better"][2:4] == ["0.010", "-1.99"]
        assert cells["worse"][7:9] == ["0.700", "+0.200"]
        assert cells["a\\|b"][3] == "≈ 0"
        assert cells["same"][3] == "0"
        assert cells["crash (diverged)"][1:4] == ["stopped", "1000", "–"]
        assert cells["cannot (unbuildable)"][1:4] == ["–", "–", "–"]
        order = [line.split(": ")[0] for line in lines if re.match(r"\d\. ", line)]
        assert order == ["1. a|b", "2. much better", "3. worse"]
        assert "No effect on the time below the bound: same." in lines
        assert lines[-2:] == ["- crash (diverged): it diverged", "- cannot (unbuildable): no"]

    def test_what_runs_are_warned_about_is_said(self):
        warned = a_row("warned", 2e-3)
        warned.metrics["warnings"] = ["too | fast", "too taut"]
        rows = [ROWS[0], warned, a_row("none", ending=UNBUILDABLE, message="no")]
        lines = [
            "none (unbuildable): no",
            "warned: warning: too | fast",
            "warned: warning: too taut",
        ]
        assert as_text(rows).splitlines()[-3:] == lines
        assert as_markdown(rows).splitlines()[-3:] == [f"- {line}" for line in lines]

    def test_text_is_aligned_and_keeps_the_ending_of_long_names(self):
        rows = [*ROWS, a_row("a name that is much too long for it", 1.0, 0.1, DIVERGED, "why")]
        lines = as_text(rows).splitlines()[: len(rows) + 2]
        assert {len(line) for line in lines} == {len(lines[0])}
        assert max(map(len, lines)) <= 110
        assert lines[-1].startswith("a name that is… (diverged) ")


@pytest.mark.nightly("studies")
def test_equal_names_and_folders_get_numbers(tmp_path):
    names = [BASE, "a b", "A_b", "a b", "table.csv", "ε"]
    variants = [(name, ["simulation_duration=0.04"]) for name in names[1:]]
    scenario = load_scenario(
        "line", ["simulation_duration=0.03", "optimization_layer=ConstantParameters"]
    )
    rows = ablate(
        scenario, [(BASE, ["simulation_duration=0.05"]), *variants], tmp_path, replay=False
    )
    assert {row.variant: row.folder for row in rows} == {
        "as it is": "as_it_is",
        "as it is (2)": "as_it_is_2",
        "a b": "a_b",
        "A_b": "A_b_2",
        "a b (2)": "a_b_2_2",
        "table.csv": "table.csv_2",
        "ε": "variant",
    }
    assert rows[0].variant == BASE
    assert {row.folder for row in rows} < contents(tmp_path)


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    """A comparison by the command: its folder, exit code and output."""
    folder = tmp_path_factory.mktemp("ablation") / "out"
    (folder / "as_it_is").mkdir(parents=True)
    (folder / "as_it_is" / "notes.txt").write_text("mine")
    arguments = ["ablate", "line", "--grid", "paper", "--swap", "phase=Nope"]
    arguments += ["--set", "simulation_duration=0.5", "--out", str(folder)]
    with contextlib.redirect_stdout(io.StringIO()) as shown:
        code = main(arguments)
    return folder, code, shown.getvalue()


def test_all_results_are_there_and_nothing_of_the_users_is_lost(compared):
    folder, _, _ = compared
    others = {"table.md", "table.csv", "index.html", "journal.jsonl", *PLOTS}
    assert contents(folder) == {"as_it_is", "without_optimization", *others}
    assert contents(folder / "as_it_is") == RUN | {"notes.txt"}
    assert contents(folder / "without_optimization") == RUN
    for name in PLOTS:
        with Image.open(folder / name) as picture:
            assert picture.width > 1000


def test_the_csv_holds_every_metric_to_the_last_digit(compared):
    folder, _, _ = compared
    with (folder / "table.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["variant"] for row in rows] == ["as it is", "without optimization", "Nope"]
    assert [row["ending"] for row in rows] == [COMPLETED, COMPLETED, UNBUILDABLE]
    assert rows[1]["overrides"] == "optimization_layer=ConstantParameters"
    for row in rows[:2]:
        metrics = json.loads((folder / row["folder"] / "metrics.json").read_text())
        assert float(row["load.position_error_mean_m"]) == metrics["load"]["position_error_mean_m"]
        flat = flattened(metrics)
        assert len(flat) > 30
        for path, value in flat.items():
            text = value if isinstance(value, str) else json.dumps(value)
            assert row[path] == ("" if value is None else text)
    assert rows[1]["optimizer.solve_time_ms.p99"] == ""
    assert rows[2]["load.position_error_mean_m"] == ""


def test_table_page_and_terminal_show_the_metrics_of_the_folders(compared):
    folder, _, shown = compared
    table = (folder / "table.md").read_text()
    page = (folder / "index.html").read_text()
    for name in ("as it is", "without optimization"):
        metrics = json.loads((folder / name.replace(" ", "_") / "metrics.json").read_text())
        line = next(line for line in table.splitlines() if line.startswith(f"| {name} "))
        cells = line.strip("| ").split(" | ")
        mean = 1e3 * metrics["load"]["position_error_mean_m"]
        assert mean < 1e-4  # a load that rests, at its equilibrium
        error = "≈ 0"
        speed = f"{metrics['carriers']['speed_min_m_s']:.3f}"
        assert (cells[1], cells[2], cells[6]) == (metrics["outcome"], error, speed)
        assert f"<td>{error}</td>" in page
        assert error in next(line for line in shown.splitlines() if line.startswith(f"{name} "))


def test_a_variant_that_cannot_be_built_is_reported_and_spoils_nothing(compared):
    folder, code, shown = compared
    assert code == ending.FAILED
    message = "Nope (unbuildable): phase = !Nope: there is no !Nope"
    assert message in shown
    assert message in (folder / "table.md").read_text()
    assert message in (folder / "index.html").read_text()


def test_the_page_refers_to_its_own_folder_only(compared):
    folder, _, _ = compared
    page = (folder / "index.html").read_text()
    targets = re.findall(r"""(?:src|href|data-page)="([^"]*)\"""", page)
    assert len(targets) > 8
    assert all((folder / target).exists() for target in targets)


def test_a_diverged_variant_is_a_result(tmp_path):
    unstable = {"bad": ["simulator_config.integration_scheme=explicit_euler"]}
    scenario = load_scenario("line", ["simulation_duration=0.6"])
    shares = []
    rows = ablate(
        scenario,
        unstable,
        tmp_path,
        replay=False,
        progress=lambda what, share: shares.append(share),
    )
    assert [row.ending for row in rows] == [COMPLETED, DIVERGED]
    assert shares == [0.5, 1.0]
    assert "diverged at t = " in rows[1].message
    metrics = json.loads((tmp_path / "bad" / "metrics.json").read_text())
    assert rows[1].metrics == metrics
    assert metrics["simulated_s"] < 0.6
    assert not (tmp_path / "bad" / "replay.html").exists()
    assert "bad,bad," in as_csv(rows)
    assert (tmp_path / "table.csv").read_text() == as_csv(rows)


class NanLater(LeafBlock):
    """Parameters that are NaN from an instant on."""

    def __init__(self, model):
        super().__init__()
        self.DeclareStateOutputPort("parameters", self.DeclareDiscreteState([2.0, 1.2]))
        self.DeclarePeriodicDiscreteUpdateEvent(0.01, 0.01, self._update)

    def _update(self, context, state):
        state.set_value([2.0 if context.get_time() < 0.05 else np.nan, 1.2])


def test_a_variant_that_makes_nan_is_a_result(tmp_path, serial_runs):
    scenario = load_scenario("quintic", ["simulation_duration=0.1"])
    _, row = ablate(scenario, {"nan": {"optimization_layer": NanLater}}, tmp_path, replay=False)
    assert row.ending == DIVERGED
    assert "optimization_layer made a value that is not finite" in row.message
    text = (tmp_path / "nan" / "metrics.json").read_text()
    assert json.loads(text, parse_constant=pytest.fail) == row.metrics
    with np.load(tmp_path / "nan" / "signals.npz") as signals:
        assert 0.05 <= signals["time"][-1] < 0.1


@pytest.mark.nightly("processes")
def test_a_variant_that_ends_its_process_has_failed(tmp_path, faulty_blocks):
    scenario = load_scenario(
        "line", ["simulation_duration=0.1", "optimization_layer=ConstantParameters"]
    )
    fatal = {"fatal": ["load_disturbance=!faulty_blocks.FaultyWind {fault: dies}"]}
    rows = ablate(scenario, fatal, tmp_path, replay=False, trust=True)
    assert [row.ending for row in rows] == [COMPLETED, FAILED]
    assert "its process died" in rows[1].message
    assert "fatal (failed): its process died" in (tmp_path / "table.md").read_text()


def test_changes_are_marked_as_better_or_worse(tmp_path):
    rows = ordered(ROWS)
    write_page(tmp_path, "title", load_scenario("line"), rows, CURVES, has_replays=False)
    page = (tmp_path / "index.html").read_text()
    cells = {
        row.variant: page.split(f">{row.variant}</a>", 1)[1].split("</tr>", 1)[0]
        for row in rows
        if row.variant in ("worse", "much better", "same")
    }
    assert cells["worse"].count("class=worse") == 2
    assert cells["much better"].count("class=better") == 2
    assert "class=" not in cells["same"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "--grid, --swap = none: give at least one"),
        (
            ["--grid", "none"],
            "--grid = none: give a .yaml file or one of airspeed, cables, departures, foresight, "
            "paper",
        ),
        (["--swap", "PaperPhase"], "--swap = PaperPhase: give BOX=BLOCK"),
        (["--swap", "phase=Nope"], "phase = !Nope: there is no !Nope"),
        (["--swap", "phase=my_blocks.Mine"], "--trust"),
        (["--swap", "phase=no_such_module_here.Mine", "--trust"], "cannot be imported"),
    ],
)
def test_bad_input_is_reported_and_leaves_no_folder(tmp_path, capsys, arguments, words):
    folder = tmp_path / "out"
    assert main(["ablate", "line", "--out", str(folder), *arguments]) == ending.BAD_INPUT
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
    assert not folder.exists()


@pytest.mark.nightly("processes")
def test_ctrl_c_ends_all_processes_and_leaves_the_earlier_results(tmp_path):
    (tmp_path / "table.md").write_text("earlier")
    arguments = ["ablate", "line", "--grid", "paper", "--out", str(tmp_path)]
    process = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "drake_nonstop.cli",
            *arguments,
            "--set",
            "simulation_duration=1000",
        ],
        stderr=subprocess.PIPE,
        text=True,
    )
    while process.poll() is None and len(contents(tmp_path)) == 1:
        time.sleep(0.05)
    time.sleep(4)  # the runs are on their way
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=60)
    assert process.returncode == ending.INTERRUPTED
    assert error.endswith("drake-nonstop: interrupted\n")
    assert "Traceback" not in error
    assert contents(tmp_path) == {"table.md"}
    assert (tmp_path / "table.md").read_text() == "earlier"


@pytest.mark.usefixtures("undrawn")
def test_an_interrupted_repetition_keeps_table_page_and_plots(tmp_path, monkeypatch):
    scenario = load_scenario(
        "line", ["simulation_duration=0.05", "optimization_layer=ConstantParameters"]
    )
    earlier = {*PLOTS, "table.md", "table.csv", PAGE}
    for name in earlier:
        (tmp_path / name).write_text("earlier")

    def first_only(run, keys, arguments, record, *others, **options):
        record(keys[0], dict(run([arguments(keys[0])]))[0])
        raise KeyboardInterrupt

    monkeypatch.setattr(ablation, "run_all", first_only)
    with pytest.raises(StudyInterrupted, match="1 of 2 variants"):
        ablate(scenario, {"a": ["system.load_mass=1.1"]}, tmp_path, replay=False)
    assert (tmp_path / JOURNAL).exists()
    assert {name for name in earlier if (tmp_path / name).exists()} == earlier


@pytest.mark.parametrize(
    "item", ["a", "as_it_is/metrics.json/x", "a/signals.npz/x", "index.html/x"]
)
def test_what_is_in_the_way_of_any_result_is_said_before_any_run(tmp_path, item):
    path = tmp_path / item
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("mine")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(ScenarioError, match=r"^--out = .*: its (file|folder) .* is in the way"):
        ablate(load_scenario("line"), {"a": ["system.load_mass=1.1"]}, tmp_path)
    assert sorted(tmp_path.rglob("*")) == before
