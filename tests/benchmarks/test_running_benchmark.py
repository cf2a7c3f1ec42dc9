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
from helpers import nightly_beyond

import drake_nonstop
from benchmarks import scaling
from benchmarks.__main__ import main as main_of_tests
from drake_nonstop import load_scenario, make_nonstop, simulate
from drake_nonstop.benchmarks import comparing, running
from drake_nonstop.benchmarks.block_timers import BlockTimers
from drake_nonstop.benchmarks.comparing import FreshRuns, Source, checked_out, compare
from drake_nonstop.benchmarks.figures import make_run_time_figure
from drake_nonstop.cli.ending import BAD_INPUT, FAILED
from drake_nonstop.cli.main import main
from drake_nonstop.run.run import RunStopped
from drake_nonstop.systems.tracing import Evaluator
from drake_nonstop.validation import ScenarioError

# The integrator's name is written out, since what is counted depends on it.
SHORT = ["simulation_duration=0.1", "simulator_config.integration_scheme=runge_kutta3"]
QUICK = Source("quintic", SHORT)
SWAPS = {
    "as it is": [],
    "a diagram in a box": ["load_plant=MultibodyLoadPlant"],
    "continuous control": ["control_period=0"],
}
needs_git = pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")


def timed_run(scenario, timers=None, **replacements):
    timers = timers or BlockTimers()
    with timers.installed():
        run = simulate(
            scenario,
            after_step=timers.after_step,
            **replacements,
        )
    return run, timers


def calls(timers, box, name):
    return sum(frame.calls.get(name, 0) for frame in timers.root.walk() if frame.box == box)


def seconds(timers, box):
    return sum(frame.seconds for frame in timers.root.walk() if frame.box == box)


@pytest.fixture(scope="module")
def timed():
    return timed_run(load_scenario("quintic", SHORT))


@pytest.mark.parametrize("swap", nightly_beyond(1, "benchmarks", SWAPS))
def test_timed_runs_give_the_results_of_others_to_the_bit(swap):
    scenario = load_scenario("quintic", [*SHORT, *SWAPS[swap]])
    run, timers = timed_run(scenario)
    plain = simulate(scenario, engine="diagram")
    assert run.signals.keys() == plain.signals.keys()
    for name, values in plain.signals.items():
        np.testing.assert_array_equal(run.signals[name], values)
    for box in ("load_plant", "wrench_controller", "force_distribution"):
        assert seconds(timers, box) > 0


def test_blocks_are_as_they_were_after_a_timed_run(timed):
    kind = type(make_nonstop(load_scenario("quintic")).GetSubsystemByName("cables"))
    assert kind is drake_nonstop.Cables
    for function in (Evaluator.__call__, drake_nonstop.RecedingHorizonOptimizer.answer):
        assert not hasattr(function, "__wrapped__")


def test_blocks_are_as_they_were_after_an_error(timed):
    found = []

    def fail():
        with BlockTimers().installed():
            found.append(hasattr(Evaluator.__call__, "__wrapped__"))
            raise RuntimeError("on purpose")

    with pytest.raises(RuntimeError, match="on purpose"):
        fail()
    assert found == [True]
    assert not hasattr(Evaluator.__call__, "__wrapped__")


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
    assert timers.blocks["optimization_layer"] == "RecedingHorizonOptimizer"
    assert "sample_and_hold" in timers.blocks
    calls = dict.fromkeys(timers.blocks, 0)
    for frame in timers.root.walk():
        if frame.box in calls:
            calls[frame.box] += sum(frame.calls.values())
    silent = {box for box, count in calls.items() if count <= 3}
    assert silent == {"load_disturbance", "wind", "wind_estimator"}  # constant


def test_calls_are_counted(timed):
    run, timers = timed
    assert timers.steps == len(run.steps["time"]) - 1
    assert calls(timers, "load_plant", "DoCalcTimeDerivatives") == 3 * timers.steps
    # The layer is asked for plans, and its measured margin steps, at each sample.
    updates = 2 * round(run.scenario.simulation_duration / run.scenario.control_period)
    assert abs(calls(timers, "optimization_layer", "update") - updates) <= 1
    evaluations = sum(f.evaluations for f in timers.root.walk() if f.box == "load_plant")
    assert evaluations == 3 * timers.steps


def test_time_upstream_is_not_a_blocks_own():
    from pydrake.systems.framework import LeafSystem

    now = 0.0

    def work():
        nonlocal now
        now += 1.0
        return np.zeros(6)

    class Busy(LeafSystem):
        """Zero forces, after 1 s by the clock; users write their blocks with such lambdas."""

        def __init__(self, model):
            super().__init__()
            self.DeclareVectorInputPort("load_state", 13)
            self.DeclareVectorOutputPort(
                "disturbance_wrench",
                6,
                lambda context, output: output.SetFromVector(work()),
            )

    # Nothing else takes time by this clock, and the load's plant asks for the forces.
    timers = BlockTimers(clock=lambda: now)
    timed_run(load_scenario("quintic", SHORT), timers, load_disturbance=Busy)
    assert timers.blocks["load_disturbance"] == "Busy"
    worked = sum(sum(f.calls.values()) for f in timers.root.walk() if f.box == "load_disturbance")
    assert worked >= timers.steps
    assert seconds(timers, "load_disturbance") == timers.seconds == worked
    assert seconds(timers, "load_plant") == 0
    assert any(f.box == "load_plant" and f.total > 0 for f in timers.root.walk())


class MadeUpStart:
    """Answers as a fresh interpreter would."""

    def __init__(self, source):
        pass

    def run(self):
        start_up = {"import_s": 1.0, "scenario_s": 0.1, "building_s": 0.3, "equilibrium_s": 0.05}
        start_up |= {"total_s": 1.6, "memory_of_imports_MiB": 90.0}
        return {"start_up": start_up, "peak_memory_MiB": 200.0}

    def close(self):
        pass


@pytest.fixture(
    scope="module", params=nightly_beyond(1, "benchmarks", ["made-up start", "fresh interpreter"])
)
def results(request):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(running, "STARTS", 1)
        if request.param == "made-up start":
            patch.setattr(running, "FreshRuns", MadeUpStart)
        return running.benchmark_run(QUICK, repeats=2)


@pytest.mark.nightly("benchmarks")
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
    assert start_up["import_s"] > 0
    assert start_up["scenario_s"] > 0
    assert start_up["building_s"] > 0
    assert start_up["equilibrium_s"] > 0
    if results["peak_memory_MiB"] is not None:
        assert results["peak_memory_MiB"] > results["memory_of_imports_MiB"] > 10


@pytest.mark.nightly("benchmarks")
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
    overrides = [*SHORT, "load_disturbance=own_running_blocks.Calm"]
    ballast = np.ones(60_000_000)  # 458 MiB, of this process
    with contextlib.closing(FreshRuns(Source("quintic", overrides, trust=True))) as runs:
        answer = runs.run()
    assert answer["simulated_s"] == pytest.approx(0.1)
    if Path("/proc/self/status").exists():
        assert answer["peak_memory_MiB"] < ballast.nbytes / 2**20


@pytest.mark.nightly("benchmarks")
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


@pytest.mark.parametrize(
    ("against", "revision", "words"),
    [
        (["a=1", "b=2"], None, "as fast as with a=1, b=2 ("),
        ([], "old", "as fast as revision old ("),
        (["a=1"], "old", "as fast as revision old with a=1 ("),
    ],
)
def test_comparison_divides_the_present_by_the_other(against, revision, words, monkeypatch):
    """The present takes 3, 1 and 2 s for 10 s; the other 10, 4 and 5 s."""

    class Runs:
        def __init__(self, source, parent=None):
            is_present = source is QUICK and parent is None
            # The first run is the start-up, and none of the repeats.
            self._walls = iter([9.0, 3.0, 1.0, 2.0] if is_present else [0.1, 10.0, 4.0, 5.0])

        def run(self):
            return {
                "real_time_factor": 10 / next(self._walls),
                "load_positions_m": [[0.0, 0.0, 1.0]],
                "start_up": {"total_s": 1.0},
                "peak_memory_MiB": 100.0,
            }

        def close(self):
            pass

    monkeypatch.setattr(comparing, "FreshRuns", Runs)
    monkeypatch.setattr(comparing, "checked_out", lambda *_: contextlib.nullcontext("tree"))
    monkeypatch.setattr(Source, "load", lambda self: load_scenario("quintic"))
    found = compare(QUICK, against, revision, repeats=3)
    assert found["real_time_factor"]["present"]["runs"] == pytest.approx([10 / 3, 10, 5])
    assert found["real_time_factor"]["other"]["median"] == pytest.approx(2)
    ratio = found["present_over_other"]
    assert ratio["of_medians"] == pytest.approx(2.5)
    assert ratio["pairs"] == pytest.approx([10 / 3, 4, 2.5])
    assert (ratio["lowest"], ratio["highest"]) == pytest.approx((2.5, 4))
    text = comparing.table(found)
    assert f"the present is 2.500 times {words}2.500 to 4.000 in 3 pairs of runs)" in text
    assert found["load_path_difference_m"] == 0


@pytest.mark.parametrize("module", ["simulate", "simulation.simulate"])
def test_revisions_of_any_layout_run(module, tmp_path):
    """A package of few lines, whose run asks once what to do after a step."""
    package = tmp_path / "drake_nonstop"
    path = package.joinpath(*module.split(".")).with_suffix(".py")
    path.parent.mkdir(parents=True)
    (package / "__init__.py").write_text(
        textwrap.dedent(f"""
            from drake_nonstop.build import make_nonstop, set_equilibrium
            from drake_nonstop.{module} import simulate


            def load_scenario(name, overrides):
                return name, overrides
        """)
    )
    (package / "build.py").write_text("make_nonstop = lambda: 1\nset_equilibrium = lambda: 2\n")
    path.write_text(
        textwrap.dedent("""
            from types import SimpleNamespace

            import numpy as np

            from drake_nonstop.build import make_nonstop
            from drake_nonstop.build import set_equilibrium as _settle


            def simulate(scenario, *, after_step=None):
                assert scenario == ("some", ["a=1"])
                make_nonstop()
                _settle()
                context = SimpleNamespace(get_time=lambda: 0.5)
                if after_step is not None:
                    simulator = SimpleNamespace(get_context=lambda: context)
                    assert after_step(simulator, None) is None
                return SimpleNamespace(
                    time=[0.0, 1.0], wall_time=0.25, signal=lambda name: np.zeros((2, 13))
                )
        """)
    )
    with contextlib.closing(FreshRuns(Source("some", ["a=1"]), tmp_path)) as runs:
        first, second = runs.run(), runs.run()
    assert first["real_time_factor"] == second["real_time_factor"] == 4
    assert first["start_up"].keys() >= {"building_s", "equilibrium_s", "total_s"}
    assert "start_up" not in second


@pytest.fixture
def checkout(tmp_path):
    """A checkout of the package with two commits: in the second the quintic rises higher."""
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


@pytest.mark.nightly("benchmarks")
@needs_git
def test_comparison_with_a_revision(checkout):
    folder, _ = checkout
    found = compare(QUICK, revision="higher", repeats=1, checkout=folder)
    assert found["load_path_difference_m"] > 0
    assert found["against_revision"] == "higher"


@pytest.mark.nightly("benchmarks")
@needs_git
def test_revisions_are_found_from_a_worktree(checkout, tmp_path):
    _, git = checkout
    tree = tmp_path / "tree"
    git("worktree", "add", "--quiet", "--detach", str(tree), "higher")
    with checked_out("HEAD~1", tree) as folder:
        text = (folder / "drake_nonstop" / "diagrams" / "scenarios" / "quintic.yaml").read_text()
        assert "[1.0, 1.0, 1.0]" in text


@pytest.mark.nightly("benchmarks")
@needs_git
@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_files_of_a_revision_are_removed_after_errors(error, checkout):
    folder, _ = checkout
    trees = []

    def fail():
        with checked_out("HEAD~1", folder) as tree:
            trees.append(tree)
            assert (tree / "drake_nonstop" / "__init__.py").is_file()
            raise error

    with pytest.raises(error):
        fail()
    assert not trees[0].parent.exists()


@needs_git
def test_revisions_that_cannot_be_had_are_named(checkout, tmp_path):
    folder, git = checkout
    with pytest.raises(ScenarioError, match="nonsense: there is no such revision"):
        compare(QUICK, revision="nonsense", checkout=folder)
    with pytest.raises(ScenarioError, match="there is no such revision"):
        compare(QUICK, revision="--all", checkout=folder)
    with pytest.raises(ScenarioError, match="is no git checkout of the package"):
        compare(QUICK, revision="HEAD", checkout=tmp_path)
    # What does not run there is reported in the words of what did not.
    (folder / "drake_nonstop" / "__init__.py").write_text("raise ImportError('out of order')\n")
    git("commit", "--quiet", "-a", "-m", "broken")
    with (
        checked_out("HEAD", folder) as tree,
        contextlib.closing(FreshRuns(QUICK, tree)) as runs,
        pytest.raises(ScenarioError, match="ImportError: out of order"),
    ):
        runs.run()


@pytest.mark.parametrize("name", ["quintic", "three_carriers"])
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


@pytest.mark.nightly("benchmarks")
def test_scale_of_few_carriers():
    scenario = load_scenario("quintic", ["simulated.load_mass=1.1"])
    found = scaling.benchmark_scale(scenario, max_n=5, duration=0.05, repeats=1)
    assert [row["n"] for row in found["runs"]] == [3, 4]
    for row in found["runs"]:
        assert row["real_time_factor"] * row["wall_per_step_s"] * row["steps"] == pytest.approx(
            0.05
        )
    first, last = (row["wall_per_step_s"] for row in found["runs"])
    assert found["exponent"] == pytest.approx(math.log(last / first) / math.log(4 / 3))
    assert len(scaling.make_scale_figure(found).axes) == 2
    with pytest.raises(ScenarioError, match="--max-n = 3: give at least 4"):
        scaling.benchmark_scale(scenario, max_n=3)
    other = load_scenario("quintic", ["pattern=LinearPattern"])
    with pytest.raises(ScenarioError, match="pattern = LinearPattern: give one"):
        scaling.benchmark_scale(other)


@pytest.mark.nightly("benchmarks")
def test_commands_print_tables_and_write_files(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(running, "STARTS", 1)
    out = ["--repeats", "1", "--out", str(tmp_path)]
    assert main(["bench", "run", "quintic", "--set", *SHORT, *out]) == 0
    text = capsys.readouterr().out
    found = json.loads((tmp_path / "run.json").read_text())
    assert f"{found['real_time_factor']['median']:.2f}" in text
    assert all(block["name"] in text for block in found["blocks"])
    arguments = ["bench", "run", "quintic", "--set", *SHORT, *out]
    assert main([*arguments, "--against", "simulator_config.max_step_size=0.0025"]) == 0
    text = capsys.readouterr().out
    found = json.loads((tmp_path / "comparison.json").read_text())
    ratio, factors = found["present_over_other"], found["real_time_factor"]
    medians = [factors[side]["median"] for side in ("present", "other")]
    assert ratio["pairs"] == [ratio["of_medians"]] == [medians[0] / medians[1]]
    assert 0 < found["load_path_difference_m"] < 1e-4
    assert f"the present is {ratio['of_medians']:.3f} times as fast as with simulator" in text
    assert main_of_tests(["scale", "--max-n", "4", "--duration", "0.1", *out]) == 0
    assert "n^" in capsys.readouterr().out
    assert {path.name for path in tmp_path.iterdir()} == {
        *("run.json", "run.png", "comparison.json", "scale.json", "scale.png")
    }


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["bench", "run", "quintic", "--repeats", "0"], "--repeats = 0: give at least 1"),
        (["bench", "run", "quintc"], "scenario = quintc: give"),
        (["scale", "--duration", "0"], "--duration = 0.0: give more"),
        (["scale", "--max-n", "2"], "--max-n = 2: give at least 4"),
    ],
)
def test_bad_options_are_named(arguments, message, tmp_path, capsys):
    command = main if arguments[0] == "bench" else main_of_tests
    assert command([*arguments, "--out", str(tmp_path / "out")]) == BAD_INPUT
    assert message in capsys.readouterr().err


def test_a_run_that_diverges_is_one_sentence(tmp_path, capsys, monkeypatch):
    def diverge(*arguments, **options):
        raise RunStopped("the run diverged", None)

    monkeypatch.setattr(scaling, "simulate", diverge)
    assert main_of_tests(["scale", "--out", str(tmp_path)]) == FAILED
    assert capsys.readouterr().err == "drake-nonstop: the run diverged\n"
