"""Blocks of a user's own: equations that cannot be are told, layers, and what a block requires."""

import itertools
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from drake_nonstop import (
    Block,
    Layout,
    NoDisturbance,
    Part,
    Scenario,
    ScenarioError,
    ScenarioWarning,
    load_scenario,
    make_nonstop,
    simulate,
)
from drake_nonstop.systems.equations import Equations


@dataclass
class OwnConfig:
    """It has no parameters."""


class Own(Block):
    """Reads the load's state, and makes a signal of its own."""

    reads, makes = ("load_state",), ("shown",)
    signal_layouts: ClassVar = {"shown": Layout(Part("shown", "3", "m"))}
    calls: ClassVar = itertools.count()
    rng: ClassVar = np.random.default_rng(0)


def branch(load_state):
    return load_state[4:7] if load_state[6] > 0 else 0 * load_state[4:7]


def writes(load_state):
    shown = np.zeros(3)
    shown[:] = load_state[4:7]
    return shown


def one_number(load_state):
    return np.concatenate([(load_state[4] * load_state[5]) ** 0.5 * load_state[6:7], np.zeros(2)])


PURE = "give it no random numbers, counters or clocks"
PLAIN = r"without branches \(systems\.tracing\.where\)"
SIZES = r"return an array for each of shown \(3\)"
BAD = [
    (lambda load_state: load_state[4:7] + Own.rng.normal(size=3), PURE),
    (lambda load_state: load_state[4:7] if next(Own.calls) % 2 else np.zeros(3), PURE),
    (lambda load_state: load_state[4:7] * next(Own.calls), PURE),
    (branch, PLAIN),
    (lambda load_state: np.where(load_state[4:7] > 0, load_state[4:7], 0.0), PLAIN),
    (lambda load_state: np.linalg.norm(load_state[4:7]) * load_state[4:7], PLAIN),
    (lambda load_state, wind: load_state[4:7], PLAIN),
    (writes, r"make arrays by np\.concatenate"),
    (one_number, r"x\[:1\] and not x\[0\]"),
    (lambda load_state: load_state[4:8], SIZES),
    (lambda load_state: (load_state[4:7], load_state[4:7]), SIZES),
    (lambda load_state: None, SIZES),
]


def own_block(function):
    return type("Shows", (Own,), {"equations": staticmethod(function), "__module__": __name__})


@pytest.mark.slow
@pytest.mark.parametrize(("function", "remedy"), BAD)
def test_equations_that_cannot_be_are_named_with_the_remedy(function, remedy):
    with pytest.raises(ScenarioError, match=rf"Shows\.equations.* = .*: .*{remedy}"):
        simulate(load_scenario("quintic"), extra={"own": own_block(function)})


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ({"optional": {"a": 1.0}}, {"optional": {"a": 2.0}}),
        ({"optional": {"a": 1.0}}, {"optional": {"b": 1.0}}),
        ({"shown": {"c": 1, "d": 1}}, {"shown": {"d": 1, "c": 1}}),
    ],
)
def test_equations_share_nothing_where_what_is_declared_beside_them_differs(one, other):
    own = {"inputs": {"a": 1, "b": 1}, "outputs": {"e": 1}, "state": [0, 0], "key": "of both"}
    keys = [Equations(len, **own, **each).key for each in (one, one, other)]
    assert keys[0] == keys[1] != keys[2]


def test_constants_that_cannot_be_pickled_are_taken_and_shared_with_none():
    class Takes(Own):
        @staticmethod
        def equations(load_state, *, own):
            return load_state[4:7]

        def constants(self, model, config):
            return {"own": [lambda values: values]}

    loop = make_nonstop(load_scenario("quintic"), extra={"own": Takes})
    assert loop.GetSubsystemByName("own").equations_of_block.key is None


class Answers(Own):
    """A layer that shows its state, the load's position at its last update, alone."""

    is_sampled, state_ports = True, ("shown",)

    def state(self, model):
        return np.zeros(3)

    def answer(self, context):
        return self.GetInputPort("load_state").Eval(context)[4:7]

    @staticmethod
    def equations(state, load_state):
        return ()


def layer(**members):
    return type("Answers", (Answers,), {"__module__": __name__, **members})


@pytest.mark.slow
def test_a_layer_may_show_its_state_alone():
    scenario = load_scenario("quintic", ["simulation_duration=0.1"])
    runs = [simulate(scenario, engine=e, extra={"own": Answers}) for e in ("compiled", "diagram")]
    assert runs[0].engine.startswith("compiled")
    compiled, diagram = (run.signal("own.shown") for run in runs)
    assert np.any(diagram)
    np.testing.assert_allclose(compiled, diagram, atol=1e-9)


@pytest.mark.parametrize(
    "members",
    [
        {"state": lambda self, model: None, "state_ports": ()},
        {"step_period": lambda self, model, config: 0.0},
    ],
)
def test_layers_need_a_state_and_time_to_step(members):
    with pytest.raises(ScenarioError, match=r"Answers\.answer = that of no"):
        make_nonstop(load_scenario("quintic"), extra={"own": layer(**members)})


@pytest.mark.parametrize("engine", ["compiled", "diagram"])
@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (np.ones(2), r"own\.answer = 2 numbers: return the next state, 3 numbers"),
        (np.full(3, np.nan), "start = own: it makes a value that is not finite"),
    ],
)
def test_an_answer_that_is_no_state_names_its_layer(answer, said, engine):
    scenario = load_scenario("quintic", ["simulation_duration=0.1"])
    own = {"own": layer(answer=lambda self, context: answer)}
    with pytest.raises(ScenarioError, match=said):
        simulate(scenario, engine=engine, extra=own)


class Careful(NoDisturbance):
    """Wants a load of 2 kg, and tells of all cables."""

    def requires(self, loop):
        if loop.simulated.load_mass < 2:
            raise ScenarioError(f"simulated.load_mass = {loop.simulated.load_mass:g}: give 2")
        yield f"cables = {type(loop.get('cables')).__name__}: they are light"


def test_a_block_of_ones_own_tells_what_it_requires():
    scenario = Scenario()
    with pytest.raises(ScenarioError, match=r"^simulated\.load_mass = 1: give 2$"):
        make_nonstop(scenario, load_disturbance=Careful)
    scenario.system.load_mass = 2.0
    with pytest.warns(ScenarioWarning, match=r"^cables = Cables: they are light") as told:
        make_nonstop(scenario, at_equilibrium=False, load_disturbance=Careful)
    assert [warning.filename for warning in told] == [__file__]  # the user's line
