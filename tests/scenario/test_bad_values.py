"""Whatever is given, a scenario is made of it, or one sentence has the field, value and remedy."""

import math

import pytest
from pydrake.common.schema import Uniform

from drake_nonstop import (
    Scenario,
    ScenarioError,
    ScenarioWarning,
    dump_scenario,
    load_scenario,
    make_nonstop,
    parse_scenario,
    read_grid,
    simulate,
)
from drake_nonstop.cli.main import main

FIVE = "[1, 0, 0], [0.3, 1, 0], [-0.8, 0.6, 0], [-0.8, -0.6, 0], [0.3, -1, 0]"
NEGATIVE = "!NoisyFeedback {position_noise: !Uniform {min: -1, max: 9}}"
FORCE = "load_disturbance=!DisturbanceForce"

# Changes of `quintic`, and the words of field, value and remedy.
CHANGES = (
    ("system.load_mass=-1", "system.load_mass", "-1", "greater than zero"),
    ("system.load_mass=.nan", "system.load_mass", "nan", "finite"),
    ("system.load_mass='1'", "system.load_mass", "'1'", "without quotes"),
    ("system.load_mass=1e400", "system.load_mass", "1e400", "1e308"),
    ("system.load_mass=!Foo {}", "system.load_mass", "!Foo", "!Uniform"),
    ("sytem.load_mass=1", "sytem", "1", "did you mean system"),
    ("load_mass=2", "--set", "load_mass", "system.load_mass"),
    ("system=!Foo {}", "system", "!Foo", "there is no"),
    ("system.attachments=[[1,0,0],[0,1]]", "system.attachments", "[0", "n x 3"),
    (f"simulated.attachments=[{FIVE}]", "simulated.attachments", "[0.3", "4"),
    ("system.cable_stiffness=.inf", "simulated.cable_stiffness", "inf", "finite"),
    ("system.cable_stiffness=inf", "system.cable_stiffness", "inf", ".inf"),
    ("system.aircraft=rascal_110", "system.aircraft", "rascal_110", "mapping"),
    ("system.aircraft={max_thrust: [1, x]}", "system.aircraft.max_thrust[1]", "x", "number"),
    ("pattern.phases=[0,0,1,2]", "pattern.phases", "[0", "swings in a plane"),
    ("phase=!Phase {}", "phase", "!Phase", "!PaperPhase"),
    ("wind.velocity=[2, 0, 0]", "wind.velocity", "[2, 0, 0]", "SteadyWind"),
    ("optimization_layer.wind=yes", "optimization_layer.wind", "yes", "true or false"),
    ("optimization_layer.speed_bound=-0.1", "speed_bound", "-0.1", "0 (no bound)"),
    ("optimization_layer.intervals=-1", "intervals", "-1", "from 9 to 200"),
    ("optimization_layer.knot_spacing=0.02", "knot_spacing", "0.02", "at least 0.0283 s"),
    ("optimization_layer.smoothing=1e9", "smoothing", "1000000000.0", "at most 10 intervals"),
    ("optimization_layer.instants=1", "instants", "1", "from 2 to 1333"),
    ("optimization_layer.instants=2.5", "instants", "2.5", "whole number"),
    ("optimization_layer.fixed_coefficients=3", "fixed_coefficients", "3", "from 4 to 18"),
    ("optimization_layer.knot_spacing=0.004", "knot_spacing", "0.004", "control period"),
    ("engine=fast", "engine", "fast", "diagram"),
    ("description=5", "description", "5", "in quotes"),
    ("simulation_duration=1:30", "simulation_duration", "1:30", "plain digits"),
    ("simulation_duration=1e8", "simulation_duration", "1", "at most"),
    ("simulator_config.start_time=5", "simulator_config.start_time", "5", "give 0"),
    ("random_seed=4294967296", "random_seed", "4294967296", "4294967295"),
    ("obstacles=!Box {}", "obstacles", "", "[ ]"),
    ("obstacles=[!Ground {}, !Ground {}]", "obstacles[1].name", "ground", "of its own"),
    ("system.load_mass=!Uniform {min: 2, max: 1}", "load_mass.min", "2", "at most max"),
    ("system.load_mass=!Gaussian {mean: 1, stddev: -0.1}", "load_mass.stddev", "-0.1", "from 0"),
    (f"{FORCE} {{force: !Uniform {{min: 0, max: 1}}}}", "force", "!Uniform", "list in [ ]"),
    (f"{FORCE} {{seed: !Gaussian {{mean: 1, stddev: 1}}}}", "seed", "!Gaussian", "whole numbers"),
    ("engine=!Uniform {min: 0, max: 1}", "engine", "!Uniform", "a number only"),
    ("errors=medium", "errors", "medium", "light"),
    ("errors={system.load_mass: 1}", "errors.system.load_mass", "1", "simulated"),
    ("errors={simulated.load_mass: -1}", "simulated.load_mass", "-1", "greater than zero"),
    ("errors={simulated.load_mass: [1, 2]}", "simulated.load_mass", "[1, 2]", "a number"),
    ("errors={simulated.load_mass: !Uniform {min: -1, max: 3}}", "load_mass", "-1", "greater"),
    ("errors={load_feedback.position_noise: 0.1}", "load_feedback", "0.1", "NoisyFeedback"),
    (f"errors={{load_feedback: {NEGATIVE}}}", "load_feedback.position_noise", "-1", "not negative"),
    ("errors={load_feedback: !FilteredFeedback {delay: 20}}", "delay", "20", "at most 1000"),
    ("errors={simulated.load_weight: 1}", "simulated.load_weight", "1", "did you mean"),
    ("errors={simulated.cable_drag: 2}", "simulated.cable_drag", "2", "leave it out"),
    ("start_error=[0, 0, 1]", "start_error", "[0", "6 finite numbers"),
    ("errors={1: 2}", "errors.1", "2", "simulated"),
    ("errors=!Foo {}", "errors", "_tag", "simulated.load_mass"),
    ("random_seed=!Uniform {min: 0, max: 1}", "random_seed", "distribution", "whole number"),
    ("simulator_config.accuracy=!Uniform {min: 0, max: 1}", "accuracy", "Uniform", "float"),
)
# Files, likewise.
FILES = (
    ("a: {system: {load_mass: 1, load_mass: 2}}", "a.system.load_mass", "twice", "once"),
    ("a: {}\nb: {}", "scenario", "", "one key"),
    ("a: [1", "scenario", "line 2", "valid YAML"),
    ("a: &x {system: *x}", "anchor", "x", "write the value out"),
    ("../evil: {}", "scenario", "../evil", "letters"),
    ("a: {based_on: quintik}", "based_on", "quintik", "did you mean quintic"),
    ("a: {based_on: gone.yaml}", "based_on", "gone.yaml", "can be read"),
    ("a: {based_on: line, duraton: 3}", "duraton", "3", "there is no"),
    ("a: {phase: !no_such_module.Phase {}}", "phase", "!no_such_module.Phase", "--trust"),
)


def assert_told(error, *words):
    assert "\n" not in str(error)
    for word in words:
        assert word in str(error)


@pytest.mark.parametrize(("setting", "field", "value", "remedy"), CHANGES)
def test_a_change_that_cannot_be_used(setting, field, value, remedy):
    with pytest.raises(ScenarioError) as error:
        make_nonstop(load_scenario("quintic", [setting]))
    assert_told(error.value, field, value, remedy)


@pytest.mark.parametrize(("text", "field", "value", "remedy"), FILES)
def test_a_file_that_cannot_be_used(text, field, value, remedy):
    with pytest.raises(ScenarioError) as error:
        parse_scenario(text)
    assert_told(error.value, field, value, remedy)


@pytest.mark.parametrize(
    "content",
    [
        b"\xff\xfea\x00:\x00",  # UTF-16
        b"a: \xe9\n",
        b"---\n---\n",
        b"quintic: !Foo {}\n",
        b"a: " + b"[" * 100_000,
        b"\n".join(b" " * k + b"a:" for k in range(2000)),
        b"a: {description: " + b"x" * 17_000_000 + b"}",
        b"a: {based_on: a.yaml}\n",
        b"a: {based_on: /dev/zero}\n",
    ],
    ids=lambda content: repr(content[:30]),
)
def test_bytes_that_are_no_scenario(content, tmp_path):
    path = tmp_path / "a.yaml"
    path.write_bytes(content)
    for read in (load_scenario, read_grid):
        with pytest.raises(ScenarioError):
            read(path)


@pytest.mark.parametrize(
    ("owner", "name", "value"),
    [
        *(("", "simulation_duration", v) for v in (math.nan, -1, None, "5", [5], 10**400, True)),
        ("system", "load_mass", Uniform(min=0, max=math.nan)),
        ("system", "load_file", "load.sdf"),
        *(("system", "aircraft", v) for v in ("", 0, [], {"model": "rascal_110"}, False)),
        ("simulated", "aircraft", {"model": "rascal_110"}),
        ("pattern", "phases", [math.nan]),
        ("", "phase", "PaperPhase"),
        ("", "phase", Scenario().cables),
    ],
)
def test_what_python_assigns_is_checked_before_a_run(owner, name, value):
    scenario = load_scenario("quintic")
    setattr(getattr(scenario, owner) if owner else scenario, name, value)
    field = f"{owner}.{name}".removeprefix(".")
    actions = (make_nonstop, simulate) if owner == "pattern" else (make_nonstop, dump_scenario)
    for action in actions:
        with pytest.raises(ScenarioError) as error:
            action(scenario)
        assert_told(error.value, f"{field}", " = ", ": ")


@pytest.mark.parametrize("given", [None, "quintic", {}, Scenario])
def test_what_is_no_scenario(given):
    for action in (simulate, dump_scenario):
        with pytest.raises(ScenarioError, match=r"scenario = .*: give a Scenario"):
            action(given)


def test_what_is_drawn_is_checked():
    scenario = load_scenario("line", ["control_period=!Gaussian {mean: 0.01, stddev: 1e6}"])
    with pytest.raises(ScenarioError) as error:
        scenario.sampled()
    assert_told(error.value, "control_period = ", "give 0 for")


def test_angles_in_degrees_get_a_hint(capsys):
    angles = "load_trajectory.start_roll_pitch_yaw=[0, 0, 45]"
    words = r"load_trajectory\.start_roll_pitch_yaw = .*45.*: an angle beyond 2π.*degrees given\?"
    short = [angles, "simulation_duration=0.01", "optimization_layer=ConstantParameters"]
    with pytest.warns(ScenarioWarning, match=words):
        simulate(load_scenario("quintic", short))
    main(["check", "quintic", "--set", *short, "system.load_mass=1e9"])
    assert "degrees given?" in capsys.readouterr().err
