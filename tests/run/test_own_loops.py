"""Loops of the user's own are logged, simulated, judged and written like one of make_nonstop."""

import numpy as np
import pytest
from helpers import nightly_beyond
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from drake_nonstop import (
    LogSignals,
    Run,
    ScenarioError,
    compute_metrics,
    connect_by_name,
    load_scenario,
    make_blocks,
    make_nonstop,
    set_equilibrium,
    simulate,
    verify_step,
)
from drake_nonstop.systems.wiring import output_names

DURATION = 0.1  # s


@pytest.fixture(scope="module", params=nightly_beyond(1, "flights", [0.01, 0.0]))
def scenario(request):
    overrides = ["optimization_layer=ConstantParameters", f"control_period={request.param}"]
    overrides += ["engine=diagram"]  # as a Simulator of ones own
    return load_scenario("line", [*overrides, f"simulation_duration={DURATION}"])


@pytest.fixture(scope="module")
def shipped(scenario):
    return simulate(scenario)


def renamed(scenario, **replacements):
    """The figure's blocks under other names."""
    blocks = make_blocks(scenario, **replacements)
    builder = DiagramBuilder()
    connect_by_name(builder, {f"my_{name}": block for name, block in blocks.items()})
    return builder.Build()


def wrapped(scenario, **replacements):
    """The same inside of a larger diagram."""
    builder = DiagramBuilder()
    loop = builder.AddNamedSystem("inner", renamed(scenario, **replacements))
    for name in output_names(loop):
        builder.ExportOutput(loop.GetOutputPort(name), name)
    return builder.Build()


def assert_same(run, shipped):
    assert {name.partition(".")[2] for name in run.signals} == {
        name.partition(".")[2] for name in shipped.signals
    }
    np.testing.assert_array_equal(run.time, shipped.time)
    for name, values in shipped.signals.items():
        assert run.signal(name.partition(".")[2]).tobytes() == values.tobytes(), name
    for name in shipped.steps.keys() - {"solve_time"}:
        assert run.steps[name].tobytes() == shipped.steps[name].tobytes(), name
    assert run.step == shipped.step


def metrics_of(run):
    wall_times = {"wall_s", "real_time_factor"}
    return {name: value for name, value in compute_metrics(run).items() if name not in wall_times}


@pytest.mark.parametrize("make_loop", [renamed, wrapped])
def test_simulate_flies_a_loop_of_ones_own_like_the_figure(make_loop, scenario, shipped):
    run = simulate(scenario, make_loop=make_loop)
    assert_same(run, shipped)
    assert metrics_of(run) == metrics_of(shipped)
    assert "my_load_plant.load_state" in run.signals
    finer = verify_step(run)
    assert finer.half_step == {"step_s": run.step / 2, "moved": {}}


def flown(scenario, nonstop):
    """The logs and the simulator of a loop in a builder of the user's own, and its context."""
    builder = DiagramBuilder()
    loop = builder.AddSystem(nonstop)
    logs = LogSignals.AddToBuilder(builder, loop)
    simulator = Simulator(builder.Build())
    ApplySimulatorConfig(scenario.simulator_config, simulator)
    context = simulator.get_mutable_context()
    set_equilibrium(loop, loop.GetMyMutableContextFromRoot(context))
    simulator.AdvanceTo(DURATION)
    return logs, simulator


@pytest.mark.parametrize("make_loop", [make_nonstop, renamed])
def test_logs_of_ones_own_simulation_are_a_run(make_loop, scenario, shipped):
    logs, simulator = flown(scenario, make_loop(scenario))
    run = Run.from_logs(logs, simulator.get_context(), scenario)
    assert_same(run, shipped)
    assert metrics_of(run) == metrics_of(shipped)
    with pytest.raises(ScenarioError, match=r"^run = from logs: give a run of simulate, which can"):
        verify_step(run)


def test_each_context_has_its_logs_and_the_last_flight_counts(scenario, shipped):
    logs, simulator = flown(scenario, make_nonstop(scenario))
    first = simulator.get_mutable_context()
    second = Simulator(simulator.get_system())
    with pytest.raises(ScenarioError, match=r"^logs = no samples: advance a Simulator"):
        Run.from_logs(logs, second.get_context(), scenario)
    for context in (None, logs.nonstop.GetMyContextFromRoot(first)):
        with pytest.raises(ScenarioError, match=r"^context = .*: give that of the whole diagram"):
            Run.from_logs(logs, context, scenario)
    with pytest.raises(ScenarioError, match=r"^logs = None: give what LogSignals"):
        Run.from_logs(None, first, scenario)
    with pytest.raises(ScenarioError, match=r"^scenario = line: give the Scenario"):
        Run.from_logs(logs, first, "line")
    # Again from the start, and initialized twice.
    loop = logs.nonstop
    first.SetTime(0.0)
    set_equilibrium(loop, loop.GetMyMutableContextFromRoot(first))
    simulator.Initialize()
    simulator.Initialize()
    simulator.AdvanceTo(0.05)
    run = Run.from_logs(logs, first, scenario, wall_time=2.0)
    np.testing.assert_array_equal(run.time, shipped.time[:6])
    assert np.all(np.diff(run.steps["time"]) > 0)
    assert run.steps["time"][[0, -1]].tolist() == pytest.approx([0.0, 0.05], abs=1e-12)
    # The wrench controller's integral goes on from the first flight; the trajectory does not.
    expected = shipped.signal("reference")[:6]
    assert run.signal("reference").tobytes() == expected.tobytes()
    assert compute_metrics(run)["wall_s"] == 2.0


def test_a_loop_that_cannot_be_logged_is_refused(scenario):
    builder = DiagramBuilder()
    blocks = make_blocks(scenario)
    connect_by_name(builder, {"cables": blocks["cables"]}, inputs=["load_state", "carrier_state"])
    cables = builder.Build()
    with pytest.raises(ScenarioError) as error:
        LogSignals.AddToBuilder(DiagramBuilder(), cables)
    assert str(error.value) == (
        "LogSignals = Diagram without output ports load_state, reference, carrier_state, "
        "parameters: give it blocks that make load_state (13), reference (22), carrier_state, "
        "tensions, parameters (2), and export these by their names, as connect_by_name does"
    )
    with pytest.raises(ScenarioError, match=r"^make_loop = Diagram without output ports"):
        simulate(scenario, make_loop=lambda scenario: cables)
    with pytest.raises(ScenarioError, match=r"^LogSignals = nonstop: add it to the builder first"):
        LogSignals.AddToBuilder(DiagramBuilder(), make_nonstop(scenario))
    for arguments, said in (
        ((None, cables), "builder = None"),
        ((DiagramBuilder(), 3), "LogSignals = 3"),
    ):
        with pytest.raises(ScenarioError, match=f"^{said}: give a"):
            LogSignals.AddToBuilder(*arguments)
    for make_loop, said in (
        (3, "3: give a function that"),
        (lambda scenario: 3, "3: return a"),
        (lambda: 3, "<lambda>: it cannot be called so"),
    ):
        with pytest.raises(ScenarioError, match=f"^make_loop = {said}"):
            simulate(scenario, make_loop=make_loop)


class Echo(LeafSystem):
    """An extra block that reads a signal and shows it, or fails."""

    def __init__(self, model, fails_at=np.inf):
        super().__init__()
        self._fails_at = fails_at
        self._tensions = self.DeclareVectorInputPort("tensions", model.n)
        self.DeclareVectorOutputPort("echo", model.n, self._calc)

    def _calc(self, context, output):
        if context.get_time() > self._fails_at:
            raise ValueError("no echo")
        output.SetFromVector(self._tensions.Eval(context))


def test_extra_blocks_are_logged_and_change_nothing(scenario, shipped):
    run = simulate(scenario, extra={"echo": Echo})
    assert run.signal("echo").tobytes() == shipped.signal("tensions").tobytes()
    for name, values in shipped.signals.items():
        assert run.signals[name].tobytes() == values.tobytes(), name
    assert verify_step(run).half_step["moved"] == {}


def test_a_box_left_out_needs_another_maker(scenario):
    said = r"^inputs = disturbance_wrench: no block makes these signals; give one that does"
    with pytest.raises(ScenarioError, match=said):
        simulate(scenario, load_disturbance=None)
