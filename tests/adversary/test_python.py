"""Public functions and classes with values of any other type, shape and size.

Each input is a few lines of Python.
"""

import inspect
import traceback
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from registries import CHOICES, block_name

import drake_nonstop
from adversary.judging import ACCEPTED, REFUSED, ending_of
from drake_nonstop import ScenarioError, load_scenario

ALIENS = (
    *("None", "42", "-1", "3.5", "True", "'text'", "''", "b'x'", "[]", "()", "{}", "object()"),
    *("math.nan", "math.inf", "-math.inf", "1e30", "10**400", "np.float64(2)", "np.int64(3)"),
    *("np.zeros(3)", "np.zeros((2, 2))", "np.array([])", "np.array('x')", "np.full(3, np.nan)"),
    *("[1, 2]", "[[1, 2], [3]]", "{'a': 1}", "lambda: None", "print", "int", "...", "1j"),
    *("Scenario", "Scenario()", "Path('.')", "Path('no_such.yaml')", "'/dev/full'", "'no_such'"),
    *("range(3)", "iter([])", "set()", "math", "IdealFeedback", "NoisyFeedbackConfig()"),
    *("decimal.Decimal('1.5')", "fractions.Fraction(1, 3)", "'é' * 300", "NoisyFeedbackConfig"),
)
SHORT = "Scenario(simulation_duration=0.02, optimization_layer=ConstantParametersConfig())"
RUN = f"run = simulate({SHORT})\n"
BUILT = (
    f"builder = DiagramBuilder()\nloop = builder.AddSystem(make_nonstop({SHORT}))\n"
    "scene_graph = builder.AddSystem(SceneGraph())\n"
)
# Calls that refuse whatever they cannot use by a sentence, with `{}` for each drawn argument.
CALLS = (
    *("load_scenario({})", "load_scenario('quintic', {})", "load_scenario('quintic', [{}])"),
    *("load_scenario('quintic', trust={})", "parse_scenario({})", "dump_scenario({})"),
    *("parse_scenario('a: {{simulation_duration: 1}}', {})", "read_grid({})", "make_nonstop({})"),
    *("simulate({})", f"simulate({SHORT}, progress={{}})", f"simulate({SHORT}, viewers={{}})"),
    *(f"simulate({SHORT}, viewers=[{{}}])", f"simulate({SHORT}, after_step={{}})"),
    *(f"simulate({SHORT}, engine={{}})", f"changed({SHORT}, {{}})", f"changed({SHORT}, [{{}}])"),
    *("make_simulator({})", "start_meshcat({})", "linearize({})", "check_scenario({})"),
    *("Scenario(durations={})", f"study({SHORT}, {{}})", f"study({SHORT}, {{{{{{}}: [0.01]}}}})"),
    *(f"study({SHORT}, {{{{'simulation_duration': {{}}}}}})", "study({}, {{}})"),
    *(f"study({SHORT}, {{{{'simulation_duration': [{{}}]}}}})", f"study({SHORT}, seeds={{}})"),
    *(f"ablate({SHORT}, {{}}, 'out')", f"ablate({SHORT}, {{{{'a': {{}}}}}}, 'out')"),
    *(f"ablate({SHORT}, {{{{'a': [{{}}]}}}}, 'out')", f"ablate({SHORT}, [{{}}], 'out')"),
    *("SceneConfig(load_colour={}).no_such", "aircraft_margins({})"),
    *(RUN + "run.signal({})", RUN + "write_results(run, {})", "write_results({}, 'out')"),
    RUN + "write_results(run, 'out', figures={}, replay={})",
    BUILT + "LogSignals.AddToBuilder(builder, {})",
)
IMPORTS = """
import decimal, fractions, functools, math, sys
from pathlib import Path
import numpy as np
from pydrake.geometry import SceneGraph
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from drake_nonstop import *
"""
NOT_CALLED = ("run_live", "start_meshcat")  # they serve a page until they are stopped
FUNCTIONS = [
    name
    for name in drake_nonstop.__all__
    if inspect.isfunction(getattr(drake_nonstop, name)) and name not in NOT_CALLED
]


def is_pythons_own(error: BaseException) -> bool:
    """Whether an error is Python's for a call that cannot be made, or one of the caller's code."""
    frames = [frame.filename for frame in traceback.extract_tb(error.__traceback__)]
    inside = [file for file in frames if "/drake_nonstop/" in file or "/diagrams/" in file]
    words = "positional argument", "required keyword", "unexpected keyword", "multiple values"
    return frames[-1] == "<typed>" or not inside or any(word in str(error) for word in words)


@pytest.fixture
def called(tmp_path, monkeypatch):
    """How a piece of code ends, in a folder of its own; errors of some types are no failures."""

    def call(text: str, *allowed: type[Exception]) -> str:
        names: dict[str, object] = {}
        exec(IMPORTS, names)
        code = compile(text, "<typed>", "exec")
        monkeypatch.chdir(tmp_path)
        try:
            return ending_of(lambda: exec(code, names), shows_python=True)[0]
        except Exception as error:
            if not isinstance(error, allowed) and not is_pythons_own(error):
                raise
            return REFUSED

    return call


@pytest.mark.nightly("adversary")
@pytest.mark.parametrize("alien", ALIENS)
def test_a_call_with_anything_is_one_sentence(called, alien):
    for form in CALLS:
        called(form.format(alien, alien))


@given(st.sampled_from(FUNCTIONS), st.lists(st.sampled_from(ALIENS), max_size=3))
def test_any_public_function_is_called_with_anything(called, name, aliens):
    """What takes an object of the package raises Python's own errors for one of another type."""
    parameters = inspect.signature(getattr(drake_nonstop, name)).parameters.values()
    named = [p for p in parameters if p.kind is not p.VAR_KEYWORD]
    pairs: Any = zip(named, aliens, strict=False)
    arguments = [f"{p.name}={a}" if p.kind is p.KEYWORD_ONLY else a for p, a in pairs]
    called(f"{name}({', '.join(arguments)})", TypeError, AttributeError)


OWN = ("5", "None", "LeafSystem()", "DiagramBuilder", "sys.exit", "int", "lambda model: None")
OWN += ("lambda model: LeafSystem()", "lambda model: 1 / 0", "lambda: None", "lambda model: model")


@given(
    st.sampled_from([box for box in CHOICES if box != "pattern"]), st.sampled_from([*OWN, *ALIENS])
)
def test_what_is_no_block_of_a_box_is_one_sentence(called, box, entry):
    called(f"simulate({SHORT}, {box}={entry})", TypeError, AttributeError)


@pytest.mark.parametrize("box", CHOICES)
def test_a_block_of_another_box_is_refused(box):
    for kind in {kind for name, configs in CHOICES.items() if name != box for kind in configs}:
        with pytest.raises(ScenarioError, match=f"^{box} = "):
            load_scenario("quintic", [f"{box}=!{block_name(kind)} {{}}"])


def test_numbers_of_numpy_are_those_of_python(called):
    form = "simulate(Scenario(simulation_duration={}))"
    assert called(form.format("np.float64(0.02)")) == ACCEPTED
    assert called(form.format("np.array([0.02])")) == REFUSED
    assert called(form.format("math.nan")) == REFUSED
