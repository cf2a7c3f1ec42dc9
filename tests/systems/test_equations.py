"""Equations of blocks of a user's own: what cannot be is told, and layers."""

import itertools
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from drake_nonstop import (
    Block,
    ScenarioError,
    load_scenario,
    make_nonstop,
    simulate,
)
from drake_nonstop.mechanics.signal_layouts import Layout, Part
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


def random(load_state):
    return load_state[4:7] + Own.rng.normal(size=3)


def random_choice(load_state):
    return load_state[4:7] if next(Own.calls) % 2 else np.zeros(3)


def counter(load_state):
    return load_state[4:7] * next(Own.calls)


def branch(load_state):
    return load_state[4:7] if load_state[6] > 0 else 0 * load_state[4:7]


def branch_of_arrays(load_state):
    return np.where(load_state[4:7] > 0, load_state[4:7], 0.0)


def numpy_norm(load_state):
    return np.linalg.norm(load_state[4:7]) * load_state[4:7]


def wrong_size(load_state):
    return load_state[4:8]


def two_results(load_state):
    return load_state[4:7], load_state[4:7]


def nothing(load_state):
    return None


def writes(load_state):
    shown = np.zeros(3)
    shown[:] = load_state[4:7]
    return shown


def one_number(load_state):
    return np.concatenate([(load_state[4] * load_state[5]) ** 0.5 * load_state[6:7], np.zeros(2)])


def wrong_arguments(load_state, wind):
    return load_state[4:7]


PURE, PLAIN = (
    "give it no random numbers, counters or clocks",
    r"without branches \(systems\.tracing\.where\)",
)
WRITTEN = r"make arrays by np\.concatenate"
ENTRY = r"x\[:1\] and not x\[0\]"
SIZES = r"return an array for each of shown \(3\)"
BAD = {
    **dict.fromkeys((random, random_choice, counter), PURE),
    **dict.fromkeys((branch, branch_of_arrays, numpy_norm, wrong_arguments), PLAIN),
    writes: WRITTEN,
    one_number: ENTRY,
    **dict.fromkeys((wrong_size, two_results, nothing), SIZES),
}


def own_block(function):
    return type("Shows", (Own,), {"equations": staticmethod(function), "__module__": __name__})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("function", "remedy"), BAD.items(), ids=lambda bad: getattr(bad, "__name__", "")
)
def test_equations_that_cannot_be_are_named_with_the_remedy(function, remedy):
    with pytest.raises(ScenarioError, match=rf"Shows\.equations = .*: .*{remedy}") as raised:
        simulate(load_scenario("quintic"), extra={"own": own_block(function)})
    assert "\n" not in str(raised.value)


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


@pytest.mark.slow
def test_a_layer_may_show_its_state_alone():
    class Shows(Own):
        reads, is_sampled, state_ports = ("load_state",), True, ("shown",)

        def state(self, model):
            return np.zeros(3)

        def answer(self, context):
            return self.GetInputPort("load_state").Eval(context)[4:7]

        @staticmethod
        def equations(state, load_state):
            return ()

    scenario = load_scenario("quintic", ["simulation_duration=0.1"])
    runs = [simulate(scenario, engine=e, extra={"own": Shows}) for e in ("compiled", "diagram")]
    assert runs[0].engine.startswith("compiled")
    compiled, diagram = (run.signal("own.shown") for run in runs)
    assert np.any(diagram)
    np.testing.assert_allclose(compiled, diagram, atol=1e-9)


class Answers(Own):
    """A layer."""

    is_sampled, state_ports = True, ("shown",)

    def state(self, model):
        return np.zeros(3)

    def answer(self, context):
        return np.ones(3)

    @staticmethod
    def equations(state, load_state):
        return ()


@pytest.mark.parametrize(
    ("members", "said"),
    [
        ({"state": lambda self, model: None, "state_ports": ()}, r"Answers\.answer = that of no"),
        ({"step_period": lambda self, model, config: 0.0}, r"Answers\.answer = that of no"),
    ],
)
def test_layers_need_a_state_and_time_to_step(members, said):
    kind = type("Answers", (Answers,), {"__module__": __name__, **members})
    with pytest.raises(ScenarioError, match=said):
        make_nonstop(load_scenario("quintic"), extra={"own": kind})


@pytest.mark.parametrize("engine", ["compiled", "diagram"])
@pytest.mark.parametrize(
    ("answer", "error", "said"),
    [
        (np.ones(2), ScenarioError, r"own\.answer = 2 numbers: return the next state, 3 numbers"),
        (np.full(3, np.nan), ScenarioError, "start = own: it makes a value that is not finite"),
    ],
)
def test_an_answer_that_is_no_state_names_its_layer(answer, error, said, engine):
    kind = type(
        "Answers", (Answers,), {"__module__": __name__, "answer": lambda self, context: answer}
    )
    scenario = load_scenario("quintic", ["simulation_duration=0.1"])
    with pytest.raises(error, match=said):
        simulate(scenario, engine=engine, extra={"own": kind})
