"""The benchmark of a run, on short ones."""

import contextlib
import json
import math
import shutil
import subprocess
import textwrap
from pathlib import Path

import numpy as np
import pytest

import drake_nonstop
from drake_nonstop import load_scenario, simulate
from drake_nonstop.benchmarks import running, scaling
from drake_nonstop.benchmarks.block_timers import BlockTimers
from drake_nonstop.benchmarks.comparing import FreshRuns, Source, checked_out, compare
from drake_nonstop.benchmarks.figures import make_run_time_figure, make_scale_figure
from drake_nonstop.cli.main import BAD_INPUT, FAILED, main
from drake_nonstop.simulation.simulate import RunStopped
from drake_nonstop.systems.block import LeafBlock
from drake_nonstop.systems.traced_block import _Traced
from drake_nonstop.validation import ScenarioError

# The integrator's name is written out, since what is counted depends on it.
SHORT = ["duration=0.1", "simulator.integration_scheme=runge_kutta3"]
QUICK = Source("quintic", SHORT)
SWAPS = {
    "as it is": [],
    "a diagram in a box": ["load_plant=MultibodyLoadPlant"],
    "continuous control": ["control_period=0"],
    "one block calls its parent's": ["force_distribution=BoundedTensionDistribution"],
}
needs_git = pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")


def timed_run(scenario, **replacements):
    timers = BlockTimers()
    with timers.installed():
        run = simulate(scenario, after_step=timers.after_step, **replacements)
    return run, timers


def calls(timers, box, name):
    return sum(frame.calls.get(name, 0) for frame in timers.root.walk() if frame.box == box)


def seconds(timers, box):
    return sum(frame.seconds for frame in timers.root.walk() if frame.box == box)


@pytest.fixture(scope="module")
def timed():
    return timed_run(load_scenario("quintic", SHORT))


@pytest.mark.parametrize("settings", SWAPS.values(), ids=SWAPS)
def test_timed_runs_give_the_results_of_others_to_the_bit(settings):
    scenario = load_scenario("quintic", [*SHORT, *settings])
    run, timers = timed_run(scenario)
    plain = simulate(scenario)
    assert run.signals.keys() == plain.signals.keys()
    for name, values in plain.signals.items():
        np.testing.assert_array_equal(run.signals[name], values)
    for box in ("load_plant", "wrench_controller", "force_distribution"):
        assert seconds(timers, box) > 0


def test_blocks_are_as_they_were_after_a_timed_run(timed):
    kind = type(simulate(load_scenario("quintic", SHORT)).diagram.GetSubsystemByName("cables"))
    assert kind is drake_nonstop.Cables
    for function in (_Traced._calc, drake_nonstop.NonstopOptimizer._update):
        assert not hasattr(function, "__wrapped__")


def test_blocks_are_as_they_were_after_an_error(timed):
    found = []

    def fail():
        with BlockTimers().installed():
            found.append(hasattr(_Traced._calc, "__wrapped__"))
            raise RuntimeError("on purpose")

    with pytest.raises(RuntimeError, match="on purpose"):
        fail()
    assert found == [True]
    assert not hasattr(_Traced._calc, "__wrapped__")


def test_times_are_exclusive_and_complete(timed):
    run, timers = timed
    total = sum(frame.seconds for frame in timers.root.walk())
    assert total == pytest.approx(timers.seconds, rel=1e-9)
    assert 0 < timers.seconds <= run.wall_time
    assert all(frame.seconds >= 0 for frame in timers.root.walk())
    assert timers.root.total == pytest.approx(total)


def test_every_box_is_there(timed):
    run, timers = timed
    assert list(timers.blocks) == [system.get_name() for system in run.diagram.GetSystems()]
    assert timers.blocks["optimization_layer"] == "NonstopOptimizer"
    assert "sample_and_hold" in timers.blocks
    silent = {box for box in timers.blocks if seconds(timers, box) == 0}
    # Constant, and asked for before the first step; or made of Drake's own systems.
    expected = {"load_disturbance", "load_feedback", "carrier_controller", "carrier_dynamics"}
    if "DoCalcTimeDerivatives" in vars(LeafBlock):  # all LeafBlocks are asked for their rates
        expected.remove("load_disturbance")
    assert silent == expected


def test_calls_are_counted(timed):
    run, timers = timed
    assert timers.steps == len(run.steps["time"]) - 1
    assert calls(timers, "load_plant", "_calc") == 3 * timers.steps
    updates = round(run.scenario.duration / run.scenario.optimization_layer.period)
    assert abs(calls(timers, "optimization_layer", "_update_at_sample") - updates) <= 1
    evaluations = sum(f.evaluations for f in timers.root.walk() if f.box == "load_plant")
    assert evaluations == 3 * timers.steps


def test_time_upstream_is_not_a_blocks_own():
    from pydrake.systems.framework import LeafSystem

    class Busy(LeafSystem):
        """Zero forces, after some work; the lambda is what own blocks are written with."""

        def __init__(self, model):
            super().__init__()
            self.DeclareVectorInputPort("load_state", 13)
            self.DeclareVectorOutputPort(
                "disturbance_wrench",
                6,
                lambda context, output: output.SetFromVector(0.0 * _worked() * np.ones(6)),
            )

    _, timers = timed_run(load_scenario("quintic", SHORT), load_disturbance=Busy)
    assert timers.blocks["load_disturbance"] == "Busy"
    assert seconds(timers, "load_disturbance") > 0.5 * timers.seconds
    assert seconds(timers, "load_plant") < 0.1 * timers.seconds


def _worked():
    return float(np.linalg.norm(np.linalg.eigvals(np.ones((60, 60)))))


@pytest.fixture(scope="module")
def results():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(running, "STARTS", 1)
        return running.benchmark_run(QUICK, repeats=2)


def test_results_say_where_the_time_goes(results):
    assert json.loads(json.dumps(results, allow_nan=False)) == results
    shares = sum(block["share"] for block in results["blocks"]) + results["outside_share"]
    assert shares == pytest.approx(1)
    (layer,) = (b for b in results["blocks"] if b["name"] == "optimization_layer")
    assert results["optimization_layer_share"] == layer["share"]
    assert 0 < results["solving_share"] < 1
    factor = results["real_time_factor"]
    assert len(factor["runs"]) == 2
    assert factor["median"] == pytest.approx(np.median(factor["runs"]))
    assert results["wall_per_step_s"] * results["steps"] == pytest.approx(results["wall_s"])
    start_up = dict(results["start_up"])
    total = start_up.pop("total_s")
    assert sum(start_up.values()) == pytest.approx(total)
    assert min(start_up.values()) >= 0
    assert start_up["import_s"] > start_up["scenario_s"] > 0
    assert start_up["building_s"] > 0
    if results["peak_memory_MiB"] is not None:
        assert results["peak_memory_MiB"] > results["memory_of_imports_MiB"] > 10


def test_fresh_runs_have_own_blocks_and_memory_of_their_own(tmp_path, monkeypatch):
    (tmp_path / "own_running_blocks.py").write_text(
        textwrap.dedent("""
            from dataclasses import dataclass

            from drake_nonstop import NoDisturbance


            @dataclass(kw_only=True)
            class CalmConfig:
                pass


            class Calm(NoDisturbance):
                pass
        """)
    )
    monkeypatch.chdir(tmp_path)
    settings = [*SHORT, "load_disturbance=own_running_blocks.Calm"]
    ballast = np.ones(60_000_000)  # 458 MiB, of this process
    with contextlib.closing(FreshRuns(Source("quintic", settings, trust=True))) as runs:
        answer = runs.run()
    assert answer["simulated_s"] == pytest.approx(0.1)
    if Path("/proc/self/status").exists():
        assert answer["peak_memory_MiB"] < ballast.nbytes / 2**20


def test_chart_shows_all_of_the_time(results):
    upper, lower = make_run_time_figure(results).axes
    widths = [bar.get_width() for bar in lower.patches]
    assert sum(widths) == pytest.approx(100)
    first, *others = upper.patches
    assert first.get_width() == pytest.approx(100)
    below = sum(bar.get_width() for bar in others if bar.get_y() == 1)
    assert below == pytest.approx(100 * (1 - results["outside_share"]))


def test_comparison_names_what_cannot_run():
    with pytest.raises(ScenarioError, match="there is no nonsense"):
        compare(QUICK, ["nonsense=1"], repeats=1)


@pytest.fixture
def checkout(tmp_path):
    """A checkout of the package with two commits: `steps` has another default step."""
    package = tmp_path / "checkout" / "drake_nonstop"
    shutil.copytree(
        Path(drake_nonstop.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__")
    )

    def git(*arguments):
        identity = ["-c", "user.name=T", "-c", "user.email=t@example.org"]
        command = ["git", *identity, "-c", "core.hooksPath=/dev/null", *arguments]
        return subprocess.run(
            command, cwd=package.parent, check=True, capture_output=True, text=True
        ).stdout

    git("init", "--quiet")
    git("add", ".")
    git("commit", "--quiet", "-m", "as it is")
    quintic = package / "diagrams" / "scenarios" / "quintic.yaml"
    text = quintic.read_text()
    quintic.write_text(text.replace("[1.0, 1.0, 1.0]", "[1.0, 1.0, 2.0]"))
    assert quintic.read_text() != text
    git("commit", "--quiet", "-a", "-m", "higher")
    git("tag", "higher")
    return package.parent, git


@needs_git
def test_comparison_with_a_revision(checkout):
    folder, git = checkout
    found = compare(QUICK, revision="higher", repeats=1, checkout=folder)
    assert found["load_path_difference_m"] > 0
    assert found["against_revision"] == "higher"
    assert len(git("worktree", "list").splitlines()) == 1


@needs_git
@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_worktree_is_removed_after_errors(error, checkout):
    folder, git = checkout
    trees = []

    def fail():
        with checked_out("HEAD~1", folder) as tree:
            trees.append(tree)
            assert (tree / "drake_nonstop" / "__init__.py").is_file()
            assert len(git("worktree", "list").splitlines()) == 2
            raise error

    with pytest.raises(error):
        fail()
    assert not trees[0].parent.exists()
    assert len(git("worktree", "list").splitlines()) == 1


@needs_git
def test_revisions_that_cannot_be_had_are_named(checkout, tmp_path):
    folder, git = checkout
    with pytest.raises(ScenarioError, match="nonsense: there is no such revision"):
        compare(QUICK, revision="nonsense", checkout=folder)
    with pytest.raises(ScenarioError, match="there is no such revision"):
        compare(QUICK, revision="--all", checkout=folder)
    with pytest.raises(ScenarioError, match="is no git checkout of the package"):
        compare(QUICK, revision="HEAD", checkout=tmp_path)
    # What does not run there is told in the words of what did not.
    (folder / "drake_nonstop" / "__init__.py").write_text("raise ImportError('out of order')\n")
    git("commit", "--quiet", "-a", "-m", "broken")
    with (
        checked_out("HEAD", folder) as tree,
        contextlib.closing(FreshRuns(QUICK, tree)) as runs,
        pytest.raises(ScenarioError, match="ImportError: out of order"),
    ):
        runs.run()
    assert len(git("worktree", "list").splitlines()) == 1


@pytest.mark.parametrize("name", ["quintic", "three_carriers", "real_scale_spread"])
def test_scaled_carriers_keep_their_share(name):
    scenario = load_scenario(name)
    n = len(scenario.system.attachments)
    for count in (3, 8):
        one = scaling.scaled(scenario, count)
        system, before = one.system, scenario.system
        assert system.load_mass / count == pytest.approx(before.load_mass / n)
        np.testing.assert_allclose(
            np.array(system.load_inertia) / count, np.array(before.load_inertia) / n
        )
        radii = [math.hypot(*attachment[:2]) for attachment in system.attachments]
        assert len(radii) == count
        np.testing.assert_allclose(radii, math.hypot(*before.attachments[0][:2]))
        assert system.carrier_mass == before.carrier_mass
        assert one.optimization_layer == scenario.optimization_layer
    assert scenario.system == load_scenario(name).system


def test_scale_of_few_carriers():
    scenario = load_scenario("quintic", ["simulated.load_mass=1.1"])
    found = scaling.benchmark_scale(scenario, max_n=5, duration=0.1, repeats=1)
    assert [row["n"] for row in found["runs"]] == [3, 4]
    for row in found["runs"]:
        assert row["real_time_factor"] * row["wall_per_step_s"] * row["steps"] == pytest.approx(0.1)
    first, last = (row["wall_per_step_s"] for row in found["runs"])
    assert found["exponent"] == pytest.approx(math.log(last / first) / math.log(4 / 3))
    assert len(make_scale_figure(found).axes) == 2
    with pytest.raises(ScenarioError, match="--max-n = 3: give at least 4"):
        scaling.benchmark_scale(scenario, max_n=3)
    other = load_scenario("quintic", ["pattern=LinearPattern"])
    with pytest.raises(ScenarioError, match="pattern = LinearPattern: give one"):
        scaling.benchmark_scale(other)


def test_commands_print_tables_and_write_files(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(running, "STARTS", 1)
    out = ["--repeats", "1", "--out", str(tmp_path)]
    assert main(["bench", "run", "quintic", "--set", *SHORT, *out]) == 0
    text = capsys.readouterr().out
    found = json.loads((tmp_path / "run.json").read_text())
    assert f"{found['real_time_factor']['median']:.2f}" in text
    assert all(block["name"] in text for block in found["blocks"])
    arguments = ["bench", "run", "quintic", "--set", *SHORT, *out]
    arguments[arguments.index("--repeats") + 1] = "3"
    assert main([*arguments, "--against", "simulator.max_step_size=0.0005"]) == 0
    text = capsys.readouterr().out
    found = json.loads((tmp_path / "comparison.json").read_text())
    ratio, factors = found["speed_ratio"], found["real_time_factor"]
    assert len(ratio["pairs"]) == len(factors["a"]["runs"]) == len(factors["b"]["runs"]) == 3
    # At least some five times the steps.
    assert ratio["lowest"] <= ratio["of_medians"] < 0.7
    assert factors["b"]["median"] < factors["a"]["median"]
    assert 0 < found["load_path_difference_m"] < 1e-4
    assert f"it runs {ratio['of_medians']:.3f} times as fast" in text
    assert main(["bench", "scale", "--max-n", "4", "--duration", "0.1", *out]) == 0
    assert "n^" in capsys.readouterr().out
    assert {path.name for path in tmp_path.iterdir()} == {
        *("run.json", "run.png", "comparison.json", "scale.json", "scale.png")
    }


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "quintic", "--repeats", "0"], "--repeats = 0: give at least 1"),
        (["run", "quintc"], "scenario = quintc: give"),
        (["scale", "--duration", "0"], "--duration = 0.0: give more"),
        (["scale", "--max-n", "2"], "--max-n = 2: give at least 4"),
    ],
)
def test_bad_options_are_named(arguments, message, tmp_path, capsys):
    assert main(["bench", *arguments, "--out", str(tmp_path / "out")]) == BAD_INPUT
    assert message in capsys.readouterr().err


def test_a_run_that_diverges_is_one_sentence(tmp_path, capsys, monkeypatch):
    def diverge(*arguments, **options):
        raise RunStopped("the run diverged", None)

    monkeypatch.setattr(scaling, "simulate", diverge)
    assert main(["bench", "scale", "--out", str(tmp_path)]) == FAILED
    assert capsys.readouterr().err == "drake-nonstop: the run diverged\n"
