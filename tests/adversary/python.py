"""Calls of the public functions and classes with wrong types, shapes, numbers and names.

Each case is a few lines of Python. A fault is an error other than ScenarioError (or the end of a
run), and a call that accepts what has no meaning. What takes an object of the package, such as a
Model or a Run, raises Python's own errors for one of another type, as everywhere.
"""

import dataclasses
import inspect
from pathlib import Path

import numpy as np

import drake_nonstop
from adversary.api import attempt_call
from adversary.values import paths, resolved, scenario_name
from adversary.verdicts import ACCEPTED, MISREAD, Case, Verdict
from drake_nonstop.diagrams.nonstop import BOXES
from drake_nonstop.scenario.choices import CHOICES, PATTERN, block_name

_ALIENS = (
    *("None", "42", "-1", "3.5", "True", "'text'", "''", "b'bytes'", "[]", "()", "{}", "object()"),
    *(
        "math.nan",
        "math.inf",
        "-math.inf",
        "np.nan",
        "1e30",
        "10**400",
        "np.float64(2)",
        "np.int64(3)",
    ),
    *("np.zeros(3)", "np.zeros((2, 2))", "np.array([])", "np.array('x')", "np.full(3, np.nan)"),
    *(
        "[1, 2]",
        "[[1, 2], [3]]",
        "{'a': 1}",
        "lambda: None",
        "print",
        "int",
        "Scenario",
        "Scenario()",
    ),
    *(
        "Path('.')",
        "Path('no_such.yaml')",
        "'/dev/full'",
        "'no_such'",
        "range(3)",
        "iter([])",
        "1j",
    ),
    *("dataclasses", "CarrierPid", "CarrierPidConfig", "CarrierPidConfig()", "ConstantParameters"),
    *("decimal.Decimal('1.5')", "fractions.Fraction(1, 3)", "set()", "...", "float", "'é' * 300"),
)
_RUN = "run = simulate(load_scenario('quintic', ['simulation_duration=0.02']))\n"
_LOOP = (
    "loop = make_nonstop(load_scenario('{name}'))\n"
    "context = loop.CreateDefaultContext()\n"
    "blocks = [block for block in loop.GetSystems() if hasattr(block, 'parameters')]\n"
    "found = [f'{{b.get_name()}}.{{name}}' for b in blocks for name in b.parameters.defaults]\n"
)
_BUILT = (
    "builder = DiagramBuilder()\nloop = builder.AddSystem(make_nonstop(Scenario()))\n"
    "scene_graph = builder.AddSystem(SceneGraph())\n"
)
_FLOWN = (
    _BUILT + "logs = LogSignals.AddToBuilder(builder, loop)\n"
    "simulator = Simulator(builder.Build())\nsimulator.AdvanceTo(0.02)\n"
)
_SCENARIO = "scenario = load_scenario({name!r}, ['simulation_duration=0.02'])\n"

# What is called, with `{}` for each drawn argument.
_CALLS = (
    "load_scenario({})",
    "load_scenario('quintic', {})",
    "load_scenario('quintic', [{}])",
    "load_scenario('quintic', ['simulation_duration=1'], trust={})",
    "parse_scenario({})",
    "parse_scenario('a: {{simulation_duration: 1}}', {})",
    "dump_scenario({})",
    "simulate({})",
    "simulate(Scenario(simulation_duration=0.02), progress={})",
    "simulate(Scenario(simulation_duration=0.02), viewers={})",
    "simulate(Scenario(simulation_duration=0.02), viewers=[{}])",
    "simulate(Scenario(simulation_duration=0.02), after_step={})",
    "make_nonstop({})",
    "make_nonstop(Scenario(), no_such_box={})",
    "set_equilibrium({}, {})",
    "set_equilibrium(make_nonstop(Scenario()), {})",
    _RUN + "compute_metrics({})",
    _RUN + "write_results({}, 'out')",
    _RUN + "write_results(run, {})",
    _RUN + "write_results(run, 'out', figures={}, replay={})",
    _RUN + "run.signal({})",
    _RUN + "run.signal('cables.tensions')",
    _RUN + "run.signal('tension')",
    _RUN + "record_replay({})",
    "draw_diagram({})",
    "ablate({}, {{'a': ['simulation_duration=0.02']}}, 'out')",
    "ablate(Scenario(simulation_duration=0.02), {}, 'out')",
    "ablate(Scenario(simulation_duration=0.02), {{'a': {}}}, 'out')",
    "ablate(Scenario(simulation_duration=0.02), {{'a': [{}]}}, 'out')",
    "ablate(Scenario(simulation_duration=0.02), [({}, ['phase=PaperPhase'])], 'out')",
    "ablate(Scenario(simulation_duration=0.02), [{}], 'out')",
    "ablate(Scenario(simulation_duration=0.02), {{'a': ['phase=No']}}, {})",
    "read_grid({})",
    "sweep(Scenario(), {})",
    "study({}, {{'simulation_duration': [0.01]}}, executor=SerialExecutor())",
    "study(Scenario(), {{'simulation_duration': [0.01]}}, None, {}, executor=SerialExecutor())",
    "study(Scenario(), {{'simulation_duration': [0.01]}}, executor={})",
    "study(Scenario(), {{'simulation_duration': [{}]}}, executor=SerialExecutor())",
    "study(Scenario(), {{'simulation_duration': {}}}, executor=SerialExecutor())",
    "study(Scenario(), {{{}: [0.01]}}, executor=SerialExecutor())",
    "study(Scenario(simulation_duration=0.01), {{}}, {}, executor=SerialExecutor())",
    "study(Scenario(simulation_duration=0.01), {}, executor=SerialExecutor())",
    "Model({}, HamiltonianCycleConfig())",
    "Model(SystemParameters(), {})",
    "Model(SystemParameters(), HamiltonianCycleConfig(), {})",
    "HamiltonianCycleConfig(phases={}).make(np.eye(3))",
    "HamiltonianCycleConfig().make({})",
    "SpreadCarouselConfig().make({})",
    "SampleAndHold({})",
    "LoadTrajectory({})",
    "NonstopVisualizer({}, Scenario())",
    "show_in({})",
    "run_live({}, {})",
    "RunProgress({}, {})(0.5)",
    "RunProgress('a', 1.0)({})",
    "TaskProgress()({}, {})",
    "SceneConfig(load_colour={}).no_such",
    "Scenario({})",
    "Scenario(durration={})",
    "Scenario(system=SystemParameters(aircraft={})).check()",
    "aircraft_margins({})",
    "aircraft_margins(load_scenario('aircraft_rest'), wind={})",
    "make_simulator({}, {})",
    "make_simulator(Scenario(), wind={})",
    "connect_by_name(DiagramBuilder(), {})",
    "connect_by_name(DiagramBuilder(), {{'a': {}}})",
    "connect_by_name(DiagramBuilder(), make_blocks(Scenario()), inputs={})",
    "connect_by_name({}, make_blocks(Scenario()))",
    _BUILT + "LogSignals.AddToBuilder(builder, {})",
    _BUILT + "LogSignals.AddToBuilder({}, loop)",
    _BUILT + "AddGeometry({}, loop, scene_graph, Scenario())",
    _BUILT + "AddGeometry(builder, {}, {}, Scenario())",
    _BUILT + "AddGeometry(builder, loop, scene_graph, {})",
    _BUILT + "AddGeometry(builder, loop, scene_graph, Scenario(), load_file={})",
    _FLOWN + "Run.from_logs(logs, {}, Scenario())",
    _FLOWN + "Run.from_logs({}, simulator.get_context(), Scenario())",
    _FLOWN + "Run.from_logs(logs, simulator.get_context(), {})",
    _FLOWN + "compute_metrics(Run.from_logs(logs, simulator.get_context(), Scenario(), step={}))",
    *(
        _LOOP.format(name="aircraft_rest") + call
        for call in (
            "get_parameter(loop, context, {})",
            "set_parameter(loop, context, {}, {})",
            "set_parameter(loop, {}, 'system.load_mass', 1.0)",
            "set_parameter({}, context, 'system.load_mass', 1.0)",
        )
    ),
)

# What takes an object of the package in its first place.
_OF_OBJECTS = (
    *("set_equilibrium(", "compute_metrics(", "record_replay(", "draw_diagram(", "verify_step("),
    *("Model(", "SampleAndHold(", "LoadTrajectory("),
    *("NonstopVisualizer(", "show_in(", "run_live(", "RunProgress(", "TaskProgress("),
    *("HamiltonianCycleConfig().make(", "SpreadCarouselConfig().make("),
)

# Fields that numbers, texts and lists are assigned to; what makes no sense has to be refused.
_BAD_VALUES = (
    *("math.nan", "-math.inf", "math.inf", "-1.0", "'text'", "None", "[]", "{}", "object()", "1j"),
    *("np.nan", "np.array([1.0, 2.0])", "[math.nan]", "True", "1e400", "'5'", "1e30", "10**400"),
)
_SENSELESS = "math.nan", "np.nan", "object()", "1j", "[math.nan]", "{}"


def _aliens(rng: np.random.Generator, count: int) -> list[str]:
    return [str(rng.choice(_ALIENS)) for _ in range(count)]


def _call(rng: np.random.Generator) -> tuple[str, bool]:
    form = str(rng.choice(_CALLS))
    count = form.replace("{{", "").count("{")
    return form.format(*_aliens(rng, count)), False


def _assigned(rng: np.random.Generator) -> tuple[str, bool]:
    """A field set after the scenario was made, right before it is used."""
    name = scenario_name(rng)
    found = list(paths(resolved(name)))
    path, value = found[rng.integers(len(found))]
    new = str(rng.choice(_BAD_VALUES))
    is_senseless = new in _SENSELESS and not (isinstance(value, dict) and new == "{}")
    setting = f"scenario.{path} = {new}"
    if (part := path.partition(".aircraft.")[0]) != path:
        given = f"scenario.{part}.aircraft"
        setting = f"{given} = {given} or AircraftParameters()\n{setting}"
    use = str(
        rng.choice(
            [
                "simulate(scenario)",
                "simulate(scenario)",
                "dump_scenario(scenario)",
                "make_nonstop(scenario)",
                "ablate(scenario, {'a': ['phase=PaperPhase']}, 'out')",
            ]
        )
    )
    is_used = not path.startswith(("scene", "description", "safe", "simulator_config.publish"))
    must = is_senseless and use.startswith("simulate") and is_used
    return f"{_SCENARIO.format(name=name)}{setting}\n{use}", must


def _misspelt(rng: np.random.Generator) -> tuple[str, bool]:
    name = scenario_name(rng)
    found = list(paths(resolved(name)))
    path, _ = found[rng.integers(len(found))]
    if path.startswith("simulator_config"):  # Drake's own class refuses it
        path = "simulation_duration"
    slip = str(rng.choice([path + "s", path[:-1], path + "_", path + path[-1]]))
    return f"{_SCENARIO.format(name=name)}scenario.{slip} = 5\nsimulate(scenario)", True


def _replaced(rng: np.random.Generator) -> tuple[str, bool]:
    """A replacement for a box: configs and classes of others, instances, functions."""
    box = str(rng.choice(list(BOXES)))
    every = [block_name(config) for one in BOXES.values() for config in one.configs]
    block = str(rng.choice(every))
    own = str(rng.choice([block_name(config) for config in BOXES[box].configs]))
    model = "Model(SystemParameters(), HamiltonianCycleConfig())"
    entry = str(
        rng.choice(
            [
                block,
                f"{block}Config()",
                own,
                f"{own}Config()",
                f"{own}Config",
                f"{own}({model})",
                f"lambda model: {own}(model)",
                f"lambda: {own}",
                "lambda model: None",
                "lambda model: 5",
                f"lambda model: {block}(model)",
                "lambda model: LeafSystem()",
                "LeafSystem",
                "LeafSystem()",
                "DiagramBuilder",
                "lambda model: DiagramBuilder()",
                "lambda model: 1 / 0",
                "sys.exit",
                "lambda model: sys.exit(0)",
                f"functools.partial({own}, config={own}Config())",
                "Scenario",
                f"functools.partial({own}, config={block}Config())",
                "lambda model: model",
                "int",
                "print",
                f"lambda model, config: {own}(model, config)",
                f"lambda model: {own}",
                *_ALIENS,
            ]
        )
    )
    text = f"simulate(load_scenario('quintic', ['simulation_duration=0.02']), {box}={entry})"
    return text, False


def _configured(rng: np.random.Generator) -> tuple[str, bool]:
    """A block's config with one field of any kind, built alone or in the loop."""
    configs = {
        block_name(config): config
        for box in (*BOXES, PATTERN)
        for config in CHOICES[box]
        if dataclasses.fields(config)
    }
    name = str(rng.choice(list(configs)))
    field = str(rng.choice([field.name for field in dataclasses.fields(configs[name])]))
    value = str(rng.choice([*_BAD_VALUES, *_ALIENS]))
    box = next(key for key, choices in CHOICES.items() if configs[name] in choices)
    config = f"{name}Config({field}={value})"
    if box == PATTERN:
        text = f"simulate(Scenario(simulation_duration=0.02, pattern={config}))"
        return text, value in _SENSELESS
    if rng.random() < 0.5:
        model = "Model(SystemParameters(), HamiltonianCycleConfig())"
        return f"{name}({model}, {config})", False
    is_senseless = value in _SENSELESS
    text = f"simulate(load_scenario('quintic', ['simulation_duration=0.02']), {box}={config})"
    return text, is_senseless and name not in ("DisturbanceForce",)


def _parameter(rng: np.random.Generator) -> tuple[str, bool]:
    """A parameter of a loop's context, set to anything."""
    value = str(rng.choice([*_BAD_VALUES, *_ALIENS]))
    loop = _LOOP.format(name=scenario_name(rng))
    path = f"found[{rng.integers(200)} % len(found)]"
    return f"{loop}set_parameter(loop, context, {path}, {value})", value in _SENSELESS


def _constructed(rng: np.random.Generator) -> tuple[str, bool]:
    """Any public class or function with as many drawn arguments as it may take, or more."""
    name = str(rng.choice([n for n in drake_nonstop.__all__ if n not in ("__version__",)]))
    if name in ("run_live", "start_meshcat") or name.endswith(("Error", "Warning", "Interrupted")):
        name = "load_scenario"
    try:
        parameters = list(inspect.signature(getattr(drake_nonstop, name)).parameters.values())
    except (TypeError, ValueError):
        parameters = []
    given = []
    for parameter in parameters[: rng.integers(0, 4)]:
        value = _aliens(rng, 1)[0]
        if parameter.kind is parameter.KEYWORD_ONLY:
            given.append(f"{parameter.name}={value}")
        elif parameter.kind is parameter.POSITIONAL_OR_KEYWORD:
            given.append(value)
    return f"{name}({', '.join(given)})", False


_FORMS = {_call: 5, _assigned: 3, _misspelt: 1, _replaced: 2.5, _configured: 2, _constructed: 0.6}
_FORMS[_parameter] = 1


def draw(rng: np.random.Generator) -> Case:
    weights = np.array(list(_FORMS.values()))
    form = list(_FORMS)[rng.choice(len(weights), p=weights / weights.sum())]
    text, must_refuse = form(rng)
    return Case(text=text, attempt=lambda folder: _attempt(folder, text, must_refuse), limit=30)


_IMPORTS = """
import dataclasses, decimal, fractions, functools, math, sys
from pathlib import Path
import numpy as np
from pydrake.geometry import SceneGraph
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem
import drake_nonstop
from drake_nonstop import *
from drake_nonstop.studies.workers import SerialExecutor
"""


def _attempt(folder: Path, text: str, must_refuse: bool) -> Verdict:
    names: dict[str, object] = {}
    exec(_IMPORTS, names)
    # Python's own errors for objects of another type are no concern of the package.
    call = text.splitlines()[-1]
    blocks = {block_name(config) for box in BOXES.values() for config in box.configs}
    takes_objects = call.startswith((*_OF_OBJECTS, *(f"{block}(" for block in blocks)))
    # What a function in place of a block raises is left as it is.
    is_given_no_block = call.startswith(
        (
            "simulate(load_scenario('quintic', ['simulation_duration=0.02']), ",
            "aircraft_margins(load_scenario('aircraft_rest'), ",
            "make_simulator(Scenario(), ",
        )
    )
    is_fine = ".no_such" in text or takes_objects or is_given_no_block
    allowed = (AttributeError, TypeError) if is_fine else ()
    _, verdict = attempt_call(
        lambda: exec(compile(text, "<typed>", "exec"), names),
        has_own_code=True,  # values are shown as Python has them
        allowed=allowed,
    )
    if verdict.ending == ACCEPTED and must_refuse:
        verdict.add(MISREAD, f"accepted: {text.splitlines()[-2] if chr(10) in text else text}")
    return verdict
