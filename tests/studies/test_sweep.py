"""Many runs of one scenario in one table."""

import json
import math
import os
import re
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from pydrake.common import RandomGenerator
from tables import column_types, read_rows

import drake_nonstop
from drake_nonstop import SweepInterrupted, SweepSpec, load_scenario, read_sweep
from drake_nonstop.cli import run as run_command
from drake_nonstop.cli.ending import BAD_INPUT, FAILED, INTERRUPTED
from drake_nonstop.cli.main import main
from drake_nonstop.scenario.overrides import changed
from drake_nonstop.studies.journal import JOURNAL
from drake_nonstop.studies.run_all import COMPLETED, DIVERGED, UNBUILDABLE, SerialExecutor
from drake_nonstop.studies.run_all import FAILED as BLOCK_FAILED
from drake_nonstop.studies.sweep import TABLE, WALL_TIMES
from drake_nonstop.validation import ScenarioError

pytestmark = pytest.mark.usefixtures("faulty_blocks")

SHORT = ["simulation_duration=0.1", "optimization_layer=ConstantParameters"]


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("line", SHORT)


def faulty(*faults, **others):
    fields = {"draws": {"load_disturbance.force": {"uniform": [-0.1, 0.1]}}, "runs": 2, **others}
    return SweepSpec(
        seed=3,
        overrides=["load_disturbance=!faulty_blocks.FaultyWind {}"],
        grid={"load_disturbance.fault": list(faults)},
        **fields,
    )


SPEC = faulty("none", "raises", "diverges", "constructor")


def sweep(scenario, spec, folder, **options):
    return drake_nonstop.sweep(scenario, spec, folder, trust=True, **options)


@pytest.fixture(scope="module")
def serial(faulty_blocks, scenario, tmp_path_factory):
    """The folder of an uninterrupted sweep in this process."""
    folder = tmp_path_factory.mktemp("serial")
    sweep(scenario, SPEC, folder, executor=SerialExecutor())
    return folder


def rows(folder):
    return read_rows(folder / TABLE)


class TestSpec:
    def written(self, tmp_path, text):
        path = tmp_path / "mine.yaml"
        path.write_text(text)
        return path

    def test_a_file(self, tmp_path):
        text = """
        description: all there is
        seed: 7
        runs: 3
        overrides: ["phase=!PaperPhase {}", simulation_duration=2]
        grid: {a.b: [1, 2.5], phase: [!PaperPhase {}, AccumulatedPhase]}
        draws: {c: {normal: [0, 1e-1]}, d: {seed: true}}
        """
        spec = read_sweep(self.written(tmp_path, text))
        assert len(spec) == 12
        first, second, last = (spec.run(k) for k in (0, 1, 11))
        assert first.overrides == [
            *("phase=!PaperPhase {}", "simulation_duration=2", "a.b=1", "phase=!PaperPhase {}"),
            *(f"c={first.values['c']!r}", f"d={first.seed}"),
            f"random_seed={RandomGenerator(7)()}",
        ]
        assert second.values["a.b"] == 1
        assert second.values["c"] != first.values["c"]
        assert last.values["a.b"] == 2.5
        assert last.values["phase"] == "AccumulatedPhase"

    @pytest.mark.parametrize(
        ("text", "words"),
        [
            ("", "give grid, draws or runs"),
            ("seed: 1", "give grid, draws, or runs"),
            ("grids: {a: [1]}", "mine.yaml.grids = "),
            ("seed: -1\ngrid: {a: [1]}", "mine.yaml.seed = -1"),
            ("seed: 1.5\ngrid: {a: [1]}", "mine.yaml.seed = 1.5"),
            ("description: [a]\ngrid: {a: [1]}", "give a text"),
            ("overrides: a=1\ngrid: {a: [1]}", "give a list of path=value"),
            ("overrides: [a]\ngrid: {a: [1]}", "give path=value"),
            ("grid: [1]", "give a mapping from paths to lists"),
            ("grid: {a: 1}", "mine.yaml.grid.a = 1: give a list of values"),
            ("grid: {a: [1, 1]}", "give each value once"),
            ("grid: {a: [1]}\nruns: 0", "mine.yaml.runs = 0"),
            ("grid: {random_seed: [1]}\nruns: 3", "path = random_seed: leave it out"),
            ("overrides: [random_seed=1]\nruns: 3", "path = random_seed: leave it out"),
            ("draws: [1]\nruns: 1", "give a mapping from paths to distributions"),
            ("draws: {a: {uniform: [0, 1]}}", "mine.yaml.runs = None"),
            ("draws: {a: {uniform: [0, 1]}}\nruns: 0", "mine.yaml.runs = 0"),
            ("draws: {a: {uniform: [0, 1]}}\nruns: 1.5", "mine.yaml.runs = 1.5"),
            ("draws: {a: 1}\nruns: 1", "give one of {uniform"),
            ("draws: {a: {gamma: [0, 1]}}\nruns: 1", "give one of {uniform"),
            ("draws: {a: {uniform: [0, 1], seed: true}}\nruns: 1", "give one of {uniform"),
            ("draws: {a: {uniform: [0, 1, 2]}}\nruns: 1", "give two numbers"),
            ("draws: {a: {uniform: [0, .inf]}}\nruns: 1", "give two numbers"),
            ("draws: {a: {uniform: [1, 0]}}\nruns: 1", "give the lower bound first"),
            ("draws: {a: {log_uniform: [0, 1]}}\nruns: 1", "give bounds above 0"),
            ("draws: {a: {normal: [0, -1]}}\nruns: 1", "give a deviation"),
            ("draws: {a: {choice: []}}\nruns: 1", "give a list of values"),
            ("draws: {a: {seed: 3}}\nruns: 1", "give true"),
            ("grid: {a: [1]}\ndraws: {a: {seed: true}}\nruns: 1", "in one of the two"),
        ],
    )
    def test_anything_else_is_one_clear_sentence(self, tmp_path, text, words):
        with pytest.raises(ScenarioError, match=re.escape(words)) as raised:
            read_sweep(self.written(tmp_path, text))
        assert "mine.yaml" in str(raised.value)
        assert "\n" not in str(raised.value)

    def test_there_is_no_such_file_or_run(self, tmp_path):
        with pytest.raises(ScenarioError, match="a file that can be read"):
            read_sweep(tmp_path / "none.yaml")
        for number in (-1, 8):
            with pytest.raises(ScenarioError, match="give 0 to 7"):
                SPEC.run(number)


class TestDraws:
    def spec(self, seed=0, **draws):
        return SweepSpec(seed=seed, runs=400, draws=draws)

    def values(self, **distribution):
        spec = self.spec(a=distribution)
        return np.array([spec.run(k).values["a"] for k in range(len(spec))])

    def test_distributions(self):
        uniform = self.values(uniform=[2, 3])
        assert (uniform >= 2).all()
        assert (uniform <= 3).all()
        assert np.quantile(uniform, [0.25, 0.75]) == pytest.approx([2.25, 2.75], abs=0.08)
        normal = self.values(normal=[5, 2])
        assert np.mean(normal) == pytest.approx(5, abs=0.4)
        assert np.std(normal) == pytest.approx(2, abs=0.3)
        logarithmic = self.values(log_uniform=[1e-2, 1e2])
        assert (logarithmic >= 1e-2).all()
        assert (logarithmic <= 1e2).all()
        assert np.median(np.log10(logarithmic)) == pytest.approx(0, abs=0.4)
        counts = np.unique(self.values(choice=["a", "b", "c"]), return_counts=True)[1]
        assert counts == pytest.approx(np.full(3, 133), abs=45)
        assert len(set(self.values(seed=True))) == 400

    def test_a_draw_follows_from_the_seed_and_its_number_alone(self):
        draws = {"a": {"normal": [0, 1]}, "b": {"seed": True}, "c": {"choice": [1, 2, 3]}}
        spec, other = self.spec(**draws), self.spec(**draws)
        backwards = [spec.run(k) for k in reversed(range(len(spec)))]
        assert backwards[::-1] == [other.run(k) for k in range(len(other))]
        assert spec.run(5).values["b"] == spec.run(5).seed
        assert self.spec(1, **draws).run(5).values["a"] != spec.run(5).values["a"]

    def test_combinations_meet_the_same_draws(self):
        draws = {"a": {"uniform": [0, 1]}, "b": {"seed": True}}
        spec = SweepSpec(grid={"c": [1, 2]}, draws=draws, runs=10)
        for k in range(10):
            one, two = spec.run(k), spec.run(10 + k)
            assert (one.values["c"], two.values["c"]) == (1, 2)
            assert one.seed == two.seed
            assert one.values["a"] == two.values["a"]


class TestTable:
    def test_a_row_per_run_with_what_was_set_and_what_came_of_it(self, serial):
        table = rows(serial)
        assert [row["run"] for row in table] == list(range(8))
        for row in table:
            planned = SPEC.run(row["run"])
            assert row["seed"] == planned.seed
            assert {path: row[path] for path in planned.values} == planned.values
        endings = [COMPLETED, BLOCK_FAILED, DIVERGED, UNBUILDABLE]
        assert [row["ending"] for row in table] == [o for o in endings for _ in range(2)]
        errors = [row["error"] for row in table]
        assert errors[0] == ""
        assert "the wind broke" in errors[2]
        assert "diverged at t = 0.05" in errors[4]
        assert "no such wind" in errors[6]
        assert table[0]["simulated_s"] == 0.1
        assert table[2]["simulated_s"] == pytest.approx(0.05)
        assert table[6]["simulated_s"] is None
        assert table[0]["load.position_error_max_m"] != table[1]["load.position_error_max_m"]

    def test_columns_have_the_types_of_their_values(self, tmp_path, scenario):
        spec = SweepSpec(
            grid={
                "system.load_mass": [1, 1.5],
                "phase": ["PaperPhase"],
                "pattern.phases": [[0.0, 1.5, 0.0, 1.5]],
                "simulator_config.use_error_control": [False],
            },
            draws={"optimization_layer.frequency": {"choice": [2]}},
            runs=1,
            overrides=["engine=diagram"],
        )
        path = sweep(scenario, spec, tmp_path, executor=SerialExecutor()).table
        types = column_types(path)
        assert types["system.load_mass"] == "double"
        assert types["phase"] == "string"
        assert types["simulator_config.use_error_control"] == "bool"
        assert types["optimization_layer.frequency"] == "int64"
        assert rows(tmp_path)[0]["pattern.phases"] == "[0.0, 1.5, 0.0, 1.5]"
        assert rows(tmp_path)[0]["carriers.n"] == 4

    def test_distributions_of_the_scenario_are_drawn_for_each_run(self, scenario, tmp_path):
        block = "!DisturbanceForce {force: !UniformVector {min: [0, 0, 0], max: [1, 1, 0]}}"
        base = changed(scenario, ["simulated.load_mass=!Gaussian {mean: 1, stddev: 0}"])
        path = "simulated.load_mass.stddev"
        spec = SweepSpec(
            seed=4,
            runs=2,
            grid={path: [0.0, 0.1]},
            overrides=["engine=diagram", f"load_disturbance={block}"],
        )
        sweep(base, spec, tmp_path, executor=SerialExecutor())
        table = rows(tmp_path)
        generator = RandomGenerator(4)
        seeds = [generator() for _ in range(2)]
        assert [row["random_seed"] for row in table] == 2 * seeds
        for k, row in enumerate(table):
            alone = changed(base, spec.run(k).overrides).sampled()
            assert row["simulated.load_mass"] == alone.simulated.load_mass
            force = [row[f"load_disturbance.force[{i}]"] for i in range(3)]
            assert force == alone.load_disturbance.force
        masses = [row["simulated.load_mass"] for row in table]
        assert masses[:2] == [1, 1]
        assert 1 != masses[2] != masses[3]
        assert table[0]["load_disturbance.force[0]"] == table[2]["load_disturbance.force[0]"]

    def test_runs_without_anything_to_draw_are_refused(self, scenario, tmp_path):
        spec = SweepSpec(runs=3, grid={"system.load_mass": [1, 2]})
        with pytest.raises(ScenarioError, match=r"spec.runs = 3: all runs of a combination would"):
            sweep(scenario, spec, tmp_path / "out")
        assert not (tmp_path / "out").exists()

    def test_a_number_that_cannot_be_used_is_a_row(self, scenario, tmp_path):
        path = "simulated.load_mass"
        spec = SweepSpec(runs=1, overrides=[f"{path}=!Deterministic {{value: -1}}"])
        sweep(scenario, spec, tmp_path, executor=SerialExecutor())
        (row,) = rows(tmp_path)
        assert row["ending"] == UNBUILDABLE
        assert f"{path} = -1.0: give" in row["error"]
        assert row[path] == -1

    def test_wall_times_stand_apart(self, serial):
        names = [*column_types(serial / WALL_TIMES)]
        assert names[:3] == ["run", "wall_s", "real_time_factor"]
        assert not {*names} & {*column_types(serial / TABLE)} - {"run"}

    def test_processes_make_the_same_table_to_the_bit(self, serial, scenario, tmp_path):
        shares = []
        done = sweep(scenario, SPEC, tmp_path, progress=lambda what, share: shares.append(share))
        assert done.table.read_bytes() == (serial / TABLE).read_bytes()
        assert done.endings == dict.fromkeys([COMPLETED, BLOCK_FAILED, DIVERGED, UNBUILDABLE], 2)
        assert shares == [(k + 1) / 8 for k in range(8)]

    @pytest.mark.nightly("processes")
    def test_dask_makes_the_same_table_even_where_a_worker_is_killed(
        self, serial, scenario, tmp_path
    ):
        killed = []

        def kill_one(what, share):
            if not killed:
                killed.append(client.run(os.getpid).popitem()[1])
                os.kill(killed[0], signal.SIGKILL)

        distributed = pytest.importorskip("distributed")
        with (
            distributed.LocalCluster(
                n_workers=2,
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                dashboard_address=None,
            ) as cluster,
            cluster.get_client() as client,
        ):
            executor = client.get_executor()
            done = sweep(scenario, SPEC, tmp_path, executor=executor, progress=kill_one)
        assert killed
        assert done.table.read_bytes() == (serial / TABLE).read_bytes()

    def test_a_run_that_ends_its_process_has_failed(self, scenario, tmp_path):
        done = sweep(scenario, faulty("dies", "none", runs=1), tmp_path)
        assert [row["ending"] for row in rows(tmp_path)] == [BLOCK_FAILED, COMPLETED]
        assert "its process died" in rows(tmp_path)[0]["error"]
        assert done.endings == {BLOCK_FAILED: 1, COMPLETED: 1}


class Recording(SerialExecutor):
    """Notes the forces of what it runs, and is interrupted after some runs."""

    def __init__(self, most=math.inf):
        self.overrides, self.most = [], most

    def submit(self, fn, /, *args, **kwargs):
        if len(self.overrides) >= self.most:
            raise KeyboardInterrupt
        self.overrides += [overrides for _, overrides, *_ in args[1]]
        return super().submit(fn, *args, **kwargs)


class TestResume:
    def test_what_an_interrupt_left_is_not_run_again(self, serial, scenario, tmp_path):
        with pytest.raises(SweepInterrupted, match="3 of 8 runs"):
            sweep(scenario, SPEC, tmp_path, executor=Recording(3))
        assert not (tmp_path / TABLE).exists()
        with (tmp_path / JOURNAL).open("ab") as file:
            file.write(b'{"run":3,"ending":"comp')  # cut short by an end of the process
        rest, nothing = Recording(), Recording()
        sweep(scenario, SPEC, tmp_path, executor=rest)
        assert rest.overrides == [SPEC.run(k).overrides for k in range(3, 8)]
        assert (tmp_path / TABLE).read_bytes() == (serial / TABLE).read_bytes()
        sweep(scenario, SPEC, tmp_path, executor=nothing)
        assert nothing.overrides == []

    def test_the_order_in_which_runs_end_is_no_matter(self, serial, scenario, tmp_path):
        content = (serial / JOURNAL).read_text().splitlines(keepends=True)
        (tmp_path / JOURNAL).write_text("".join([content[0], *content[:3:-1]]))
        with ThreadPoolExecutor(1) as executor:
            sweep(scenario, SPEC, tmp_path, executor=executor)
        assert (tmp_path / TABLE).read_bytes() == (serial / TABLE).read_bytes()

    def test_the_folder_of_another_sweep_is_refused(self, serial, scenario):
        before = (serial / JOURNAL).read_bytes()
        other_scenario = load_scenario("line", [*SHORT, "system.load_mass=1.01"])
        other_spec = faulty("none", "raises", "diverges", "constructor", runs=3)
        for sweeps in ((other_scenario, SPEC), (scenario, other_spec)):
            with pytest.raises(ScenarioError, match="runs of another scenario or spec"):
                sweep(*sweeps, serial, executor=SerialExecutor())
        assert (serial / JOURNAL).read_bytes() == before

    def test_restart_drops_what_was_there(self, scenario, tmp_path):
        spec, other = faulty("none", runs=1), faulty("constructor", runs=1)
        sweep(scenario, spec, tmp_path, executor=SerialExecutor())
        sweep(scenario, other, tmp_path, executor=SerialExecutor(), restart=True)
        assert [row["ending"] for row in rows(tmp_path)] == [UNBUILDABLE]
        assert len((tmp_path / JOURNAL).read_text().splitlines()) == 2

    def test_a_journal_that_is_none_is_refused(self, scenario, tmp_path):
        (tmp_path / JOURNAL).write_text("notes\n")
        with pytest.raises(ScenarioError, match="cannot be read"):
            sweep(scenario, SPEC, tmp_path, executor=SerialExecutor())
        assert (tmp_path / JOURNAL).read_text() == "notes\n"

    def test_two_sweeps_do_not_share_a_folder(self, scenario, tmp_path):
        def again(what, share):
            with pytest.raises(ScenarioError, match="another sweep is running"):
                sweep(scenario, SPEC, tmp_path, executor=SerialExecutor())
            refused.append(share)

        refused = []
        spec = faulty("none", runs=1)
        sweep(scenario, spec, tmp_path, executor=SerialExecutor(), progress=again)
        assert refused == [1.0]


class TestCommand:
    def spec(self, tmp_path, text):
        path = tmp_path / "mine.yaml"
        path.write_text(text)
        return str(path)

    def test_a_failed_run_is_replayed_alone(self, serial, tmp_path, capsys, monkeypatch):
        monkeypatch.setattr(run_command, "write_pictures", lambda *run, **options: None)
        arguments = ["sweep", "line", str(serial / "spec.yaml"), "--set", *SHORT]
        arguments += ["--trust", "--run", "3", "--out", str(tmp_path / "out")]
        assert main(arguments) == FAILED
        row = rows(serial)[3]
        captured = capsys.readouterr()
        assert row["error"] in captured.err
        assert f"load_disturbance.force={row['load_disturbance.force']!r}" in captured.out
        metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
        assert metrics["load"]["position_error_max_m"] == row["load.position_error_max_m"]
        assert metrics["simulated_s"] == row["simulated_s"]

    def test_table_and_endings(self, tmp_path, capsys, monkeypatch):
        monkeypatch.chdir(tmp_path)
        spec = self.spec(tmp_path, "grid: {system.load_mass: [1.0, -1.0]}")
        assert main(["sweep", "line", spec, "--serial", "--set", *SHORT]) == FAILED
        assert "1 completed, 1 unbuildable\noutcomes: 1 ok\nresults: out/sweep/line_mine/" in (
            capsys.readouterr().out
        )
        assert len(rows(tmp_path / "out" / "sweep" / "line_mine")) == 2

    @pytest.mark.parametrize(
        ("text", "words"),
        [
            ("grid: {system.lode_mass: [1, 2]}", "there is no lode_mass"),
            ("grid: {phase: [my_own.Phase]}", "--trust"),
            ("grid: {}", "give grid, draws, or runs"),
        ],
    )
    def test_bad_input_is_reported_and_leaves_no_folder(self, tmp_path, capsys, text, words):
        folder = tmp_path / "out"
        assert main(["sweep", "line", self.spec(tmp_path, text), "--out", str(folder)]) == BAD_INPUT
        error = capsys.readouterr().err
        assert words in error
        assert error.count("\n") == 1
        assert not folder.exists()

    def test_pyarrow_is_asked_for_before_anything_is_run(self, tmp_path, capsys, monkeypatch):
        monkeypatch.setitem(sys.modules, "pyarrow", None)
        spec = self.spec(tmp_path, "grid: {simulation_duration: [1]}")
        assert main(["sweep", "line", spec, "--out", str(tmp_path / "out")]) == BAD_INPUT
        assert "sweep = no pyarrow: install it, `pip install pyarrow`" in capsys.readouterr().err

    @pytest.mark.nightly("processes")
    def test_ctrl_c_keeps_what_is_done(self, tmp_path):
        text = "draws: {system.load_mass: {uniform: [0.9, 1.1]}}\nruns: 500"
        arguments = ["sweep", "line", self.spec(tmp_path, text), "--set", *SHORT]
        process = subprocess.Popen(
            [sys.executable, "-m", "drake_nonstop.cli", *arguments, "--out", str(tmp_path)],
            stderr=subprocess.PIPE,
            text=True,
        )
        journal = tmp_path / JOURNAL
        while process.poll() is None and not (
            journal.exists() and journal.read_bytes().count(b"\n") > 3
        ):
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        _, error = process.communicate(timeout=60)
        assert process.returncode == INTERRUPTED
        assert "Traceback" not in error
        count = journal.read_bytes().count(b"\n") - 1
        assert 3 <= count < 500
        assert f"interrupted: {count} of 500 runs are in {tmp_path}" in error
        assert not (tmp_path / TABLE).exists()


@pytest.mark.parametrize("flag", ["restart", "trust"])
def test_a_text_is_no_flag_and_removes_nothing(tmp_path, flag):
    (tmp_path / JOURNAL).write_text("mine")
    scenario = load_scenario("line")
    spec = SweepSpec(grid={"simulation_duration": [0.01]})
    for study in (
        lambda: drake_nonstop.sweep(scenario, spec, tmp_path, **{flag: "no"}),
        lambda: drake_nonstop.ablate(scenario, {"a": []}, tmp_path, **{flag: "no"}),
    ):
        with pytest.raises(ScenarioError, match=rf"^{flag} = no: give true or false"):
            study()
    assert (tmp_path / JOURNAL).read_text() == "mine"


def test_where_a_file_cannot_be_written_the_others_stay(tmp_path):
    (tmp_path / "scenario.yaml").write_text("mine")
    (tmp_path / "spec.yaml").mkdir()
    (tmp_path / "spec.yaml" / "notes").write_text("mine")
    spec = SweepSpec(grid={"simulation_duration": [0.01]})
    with pytest.raises(ScenarioError, match="give a folder with room to write to"):
        drake_nonstop.sweep(load_scenario("line"), spec, tmp_path, executor=SerialExecutor())
    assert (tmp_path / "scenario.yaml").read_text() == "mine"
