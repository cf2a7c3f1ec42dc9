"""A block of one's own by its declarations: what follows from them, and what is refused."""

from dataclasses import dataclass

import numpy as np
import pytest
from helpers import fix, model, output

from drake_nonstop import (
    Block,
    Layout,
    Part,
    ScenarioError,
    load_scenario,
    make_nonstop,
    set_parameter,
    simulate,
)

POSITION = slice(4, 7)
SETTINGS = ["optimization_layer=ConstantParameters", "simulation_duration=0.2"]


@dataclass(kw_only=True)
class DraggedConfig:
    gain: float = 2.0  # N/m
    name: str = "no parameter of the context"


class Dragged(Block):
    """A force towards a point that follows the load with a lag."""

    reads = ("load_state",)
    makes = ("disturbance_wrench",)
    system = ("load_mass",)
    of_model = ("n", "pattern.basis")

    @staticmethod
    def equations(point, load_state, *, gain, load_mass, n, basis):
        assert basis.shape[0] == 3 * n
        off = load_state[POSITION] - point
        return off / load_mass, np.concatenate([np.zeros(3), -gain * off])

    def state(self, model):
        return np.array([0.5, 0.0, 0.0])


class Faster(Dragged):
    """With a rate of its own; the config is that of the class above."""

    @staticmethod
    def equations(*inputs, **values):
        rate, wrench = Dragged.equations(*inputs, **values)
        return 3 * rate, wrench


def shown(block, name="disturbance_wrench", **inputs):
    """An output of a block and the rates of its state."""
    context = block.CreateDefaultContext()
    fix(block, context, **inputs)
    return output(block, context, name), block.EvalTimeDerivatives(context).CopyToVector()


@pytest.mark.parametrize("n", [3, 5])
@pytest.mark.parametrize(("kind", "factor"), [(Dragged, 1.0), (Faster, 3.0)])
def test_what_is_declared_is_what_there_is(n, kind, factor):
    made = kind(model(n))
    assert made.GetInputPort("load_state").size() == 13
    assert [*made.parameters.defaults] == ["load_mass", "gain"]
    assert "- `gain`: N/m" in Dragged.__doc__
    for block in (made, made.Clone()):
        wrench, rates = shown(block, load_state=np.eye(13)[0] + np.eye(13)[4])
        np.testing.assert_array_equal(wrench, [0, 0, 0, -1, 0, 0])
        expected = [factor * 0.5 / model(n).load.mass, 0, 0]
        np.testing.assert_allclose(rates, expected, rtol=1e-14)


def test_its_parameters_are_those_of_the_context():
    diagram = make_nonstop(load_scenario("quintic", SETTINGS), load_disturbance=Dragged)
    context = diagram.CreateDefaultContext()
    before = output(diagram, context, "disturbance_wrench")
    set_parameter(diagram, context, "load_disturbance.gain", 6.0)
    after = output(diagram, context, "disturbance_wrench")
    np.testing.assert_allclose(after, 3 * before, rtol=1e-14)
    assert before[3] != 0


class Still(Dragged):
    """Its state does not move."""

    first = 0.5

    @classmethod
    def has_state(cls, model, config):
        return False

    def state(self, model):
        return np.full(3, self.first)


def test_states_that_stay_are_those_of_each_class():
    further = type("FurtherStill", (Still,), {"__module__": __name__, "first": 2.0})
    wrenches = [shown(kind(model()), load_state=np.zeros(13))[0] for kind in (Still, further)]
    assert [wrench[3] for wrench in wrenches] == [1.0, 4.0]


@dataclass(kw_only=True)
class CounterConfig:
    rate: float = 1.0


class Counter(Block):
    """A held output of a state that is sampled, by a signal that the figure does not know."""

    reads = ("measured_load_state",)
    makes = ("count",)
    signal_layouts = {"count": Layout(Part("", "1"))}  # noqa: RUF012
    is_sampled = True

    @staticmethod
    def equations(count, load, *, rate):
        return rate + 0 * load[:1], 1.0 * count

    def state(self, model):
        return np.array([self.config.rate])


class Reset(Counter):
    """It declares an event besides, which no trace has."""

    def __init__(self, model, config=None):
        super().__init__(model, config)
        self.DeclarePeriodicDiscreteUpdateEvent(0.05, 0.05, self.begin)

    def begin(self, context, state):
        state.set_value(0, [0.0])


class Slow(Counter):
    """It steps at every second or third sample, by a period that was rounded to decimals."""

    def step_period(self, model, config):
        return self.config.rate


def counted(kind, *settings):
    """Counts of a flight, which are the same in both engines."""
    scenario = load_scenario("quintic", [*SETTINGS, *settings])
    runs = [
        simulate(scenario, engine=engine, extra={"counter": kind})
        for engine in ("compiled", "diagram")
    ]
    counts = [run.signals["counter.count"][:, 0] for run in runs]
    np.testing.assert_allclose(*counts, rtol=0, atol=1e-12)
    return counts[0]


@pytest.mark.filterwarnings("error:.*compiled")
def test_a_held_state_without_a_start_is_the_same_in_both_engines():
    assert counted(Counter)[0] == 1.0
    assert "- `count` (1)" in Counter.__doc__


@pytest.mark.filterwarnings("error:.*compiled")
@pytest.mark.parametrize(
    ("period", "sample"), [(0.02, 0.01), (0.0300000001, 0.01), (0.00666667, 1 / 300)]
)
def test_a_period_is_one_of_samples_but_for_the_rounding_of_decimals(period, sample):
    def given(model):
        return Slow(model, CounterConfig(rate=period))

    assert counted(given, f"control_period={sample!r}")[-1] > period


def test_an_event_of_a_class_below_is_not_left_out_in_silence():
    with pytest.warns(match="counter"):
        counted(Reset)


def test_a_config_that_changes_later_changes_no_block():
    config = CounterConfig()
    block = Counter(model(control_period=0.01), config)
    config.rate = 5.0
    assert block.config.rate == 1.0


def own(**members):
    """A class of these members, beside its config."""
    return type("Own", (Block,), {"__module__": __name__, **members})


@dataclass(kw_only=True)
class OwnConfig:
    gain: float = 1.0


NOTHING = {"reads": ("load_state",), "makes": ("disturbance_wrench",)}
ZEROS = staticmethod(lambda load, *, gain: np.zeros(6))


def equations(function):
    return {"equations": staticmethod(function)}


# What is told, the remedy, and members of the class, with equations of zeros where it says nothing.
REFUSED = [
    ("Own.equations = a method", "make it a @staticmethod", {"equations": lambda self, load: load}),
    ("Own.makes = disturbance_wrench", "give a tuple of names", {"makes": "disturbance_wrench"}),
    ("Own reads or makes = load_stat", "it is no vector", {"reads": ("load_stat",)}),
    (
        "Own.equations = arrays of [6] numbers",
        "the next state (2), dist",
        equations(lambda state, load, *, gain: np.zeros(6))
        | {"state": lambda self, model: np.zeros(2)},
    ),
    ("Own.system = mass", "give fields of the scenario's system", {"system": ("mass",)}),
    ("Own.state = 3.0", "give n finite numbers", {"state": lambda self, model: 3.0}),
    ("Own.of_model = ", "give attributes of a Model", {"of_model": ("attachment",)}),
]


@pytest.mark.parametrize(("told", "remedy", "members"), REFUSED)
def test_what_cannot_be_a_block_is_refused_in_a_sentence(told, remedy, members):
    with pytest.raises(ScenarioError) as error:
        own(**NOTHING | {"equations": ZEROS} | members)(model(control_period=0.01))
    assert told in str(error.value)
    assert remedy in str(error.value).partition(told)[2]
    assert not isinstance(error.value.__cause__, RecursionError)  # of thousands of lines


def test_a_class_without_equations_or_a_config_is_refused_in_a_sentence():
    with pytest.raises(ScenarioError, match=r"Own\.equations = none: write a @staticmethod"):
        own(**NOTHING)(model())
    lonely = type("Lonely", (Block,), {"__module__": __name__, **NOTHING, "equations": ZEROS})
    with pytest.raises(ScenarioError, match=f"give {__name__} a dataclass LonelyConfig"):
        lonely(model())


def test_classes_of_one_name_do_not_share_a_trace():
    """As where a cell of a notebook is run again."""
    for factor in (1.0, 2.0):
        made = equations(lambda load, *, gain, factor=factor: factor * gain * np.ones(6))
        wrench, _ = shown(own(**NOTHING | made)(model()), load_state=np.zeros(13))
        np.testing.assert_array_equal(wrench, factor)
