"""Runs of `simulate`: starts, steps, samples, and what is said where one ends early."""

import os
import signal

import numpy as np
import pytest
from helpers import nightly_beyond
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import ConstantVectorSource
from pydrake.trajectories import PiecewisePolynomial

from drake_nonstop import (
    LoadTrajectory,
    RunInterrupted,
    RunStopped,
    ScenarioError,
    compute_metrics,
    load_scenario,
    make_nonstop,
    simulate,
    simulate_many,
    verify_step,
)
from drake_nonstop.blocks.load_disturbance import DisturbanceForce, DisturbanceForceConfig
from drake_nonstop.mechanics.signals import LoadReference, LoadState

CONSTANT = "optimization_layer=ConstantParameters"
POINTS = np.random.default_rng(16).uniform(-1, 1, (5, 4, 3)).tolist()
MOVING_PARAMETERS = (  # in steps, which the carriers' references follow
    "load_trajectory.roll_pitch_yaw=[0, 0, 12.566]",
    *("load_trajectory.start_time=0", "load_trajectory.move_time=6"),
    *("optimization_layer=PaperLayer", "phase=AccumulatedPhase"),
    *("carrier_trajectory.hold=velocity", "carrier_controller=CarrierPid"),
    "limits.time_below_bound=0.1",
)


def short(*overrides, name="quintic", duration=0.2):
    """A scenario with constant parameters if the overrides do not say otherwise."""
    return load_scenario(name, [CONSTANT, *overrides, f"simulation_duration={duration}"])


@pytest.mark.parametrize(
    "setting",
    nightly_beyond(
        1,
        "flights",
        [
            "wind=!GustyWind {gust: 1e-310}",
            "load_disturbance=!DisturbanceForce {gust_force: 1e-310}",
            "load_trajectory=!RestToRest {displacement: [1e-170, 0, 0]}",
        ],
    ),
)
def test_a_number_below_the_smallest_ends_no_flight(setting):
    scenario = short(setting)
    with np.errstate(all="raise"):
        for engine in ("compiled", "diagram"):
            compute_metrics(simulate(scenario, engine=engine))
        for run in simulate_many([scenario, scenario]):
            compute_metrics(run)


@pytest.mark.parametrize("points", nightly_beyond(2, "studies", POINTS))
def test_a_load_starts_with_the_acceleration_of_its_reference(points):
    """Splines through drawn points accelerate from their start on."""
    rows = np.hstack([np.zeros((4, 3)), points]).T
    curve = PiecewisePolynomial.CubicWithContinuousSecondDerivatives(
        1.5 * np.arange(4), rows, np.zeros((6, 1)), np.zeros((6, 1))
    )
    run = simulate(short(duration=0.05), load_trajectory=lambda model: LoadTrajectory(curve))
    reference, soon = (LoadReference.view(values) for values in run.signal("reference")[[0, 1]])
    start, after = (LoadState.view(state) for state in run.signal("load_state")[[0, 1]])
    size = np.linalg.norm(reference.acceleration)
    assert size > 0.1
    np.testing.assert_allclose(start.position, reference.position, atol=1e-4)
    change, desired = after.velocity - start.velocity, soon.velocity - reference.velocity
    np.testing.assert_allclose(change, desired, atol=0.05 * 0.01 * size)


@pytest.mark.parametrize("share", [-0.12, 0.1, 0.15])
def test_a_load_whose_attachments_are_elsewhere_starts_near_its_reference(share):
    """Full steps of Newton's method wind such a load up in its cables, or leave them slack."""
    attachments = np.array(load_scenario("three_carriers").system.attachments)
    shift = share * np.ptp(attachments[:, 0])
    overrides = [f"simulated.attachments={(attachments + np.array([shift, 0, 0])).tolist()}"]
    overrides.append("carrier_trajectory.correction_rates=[0, 0, 0, 0]")
    loop = make_nonstop(load_scenario("three_carriers", overrides))
    context = loop.CreateDefaultContext()
    state = LoadState.view(loop.GetOutputPort("load_state").Eval(context))
    assert np.abs(state.quaternion[1:]).max() < 0.1
    assert np.abs(state.position[0] + shift) < 0.05
    assert loop.GetOutputPort("tensions").Eval(context).min() > 1.0


LIFTING = "load_disturbance=!DisturbanceForce {{force: [0, 0, {}], start_time: {}}}"
# What cannot start, and what the message has: the field or block, and the remedy.
CANNOT_START = [
    ("simulated.cable_length=3", "do not hold the load"),
    (LIFTING.format(40, 0), "let it start later: load_disturbance lifts it with 40 N"),
    (
        "load_trajectory=!RestToRest {displacement: [1e9, 0, 0], move_time: 0.01}",
        "start = load_trajectory: it makes a value",
    ),
    ("system.gravity=1e9", "start = wrench_controller: it makes a value"),
    ("system.cable_damping=2e4", "fastest mode"),
]


@pytest.mark.parametrize(("override", "said"), CANNOT_START)
@pytest.mark.parametrize("engine", nightly_beyond(1, "engines", ["auto", "diagram"]))
def test_what_cannot_start_is_told_with_what_is_at_fault(override, said, engine):
    with pytest.raises(ScenarioError, match=said):
        simulate(short(override, f"engine={engine}"))


def test_a_reference_of_no_rotation_is_refused():
    def twice_as_long(model):
        builder = DiagramBuilder()
        source = builder.AddSystem(ConstantVectorSource(np.append(2.0, np.zeros(21))))
        builder.ExportOutput(source.get_output_port(), "reference")
        return builder.Build()

    with pytest.raises(ScenarioError, match=r"load_trajectory.reference = \[2. .* of length 1"):
        simulate(short(), load_trajectory=twice_as_long)


@pytest.mark.parametrize("damping", nightly_beyond(2, "studies", [1.3, 7.9, 18.0, 44.0, 95.0]))
def test_half_the_step_of_the_fastest_mode_moves_nothing(damping):
    push = DisturbanceForceConfig(force=[2.0, 0.0, 0.0])
    own = {"load_disturbance": lambda model: DisturbanceForce(model, push)}  # flown again, too
    run = simulate(short(f"system.cable_damping={damping}"), **own)
    assert verify_step(run).half_step == {"step_s": run.step / 2, "moved": {}}


def test_what_half_the_step_moves_is_named_and_decides_the_outcome():
    run = simulate(short(*MOVING_PARAMETERS, duration=2.0))
    assert compute_metrics(run)["outcome"] != "unconverged"
    verified = compute_metrics(verify_step(run))
    assert verified["outcome"] == "unconverged"
    assert verified["half_step"]["moved"]
    assert "simulator_config.max_step_size" in verified["reasons"][0]


def test_an_interrupt_of_the_second_flight_keeps_the_first():
    run = simulate(short(duration=2.0))
    with pytest.raises(RunInterrupted) as raised:
        verify_step(run, progress=lambda time: os.kill(os.getpid(), signal.SIGINT))
    assert raised.value.run is run


class Faulty(LeafSystem):
    """Makes constant signals, of which one is off from 0.105 s on."""

    def __init__(self, signals, name, fault):
        super().__init__()
        for each, value in signals.items():

            def calc(context, output, each=each, value=value):
                is_wrong = each == name and context.get_time() >= 0.105
                output.SetFromVector(np.array(value) + (fault if is_wrong else 0.0))

            self.DeclareVectorOutputPort(each, len(value), calc)


INTERNAL = {"internal_force": [0.0] * 8, "internal_force_higher_rates": [0.0] * 8}
FAULTS = [
    ("load_disturbance", {"disturbance_wrench": [0.0] * 6}, "disturbance_wrench"),
    ("optimization_layer", {"parameters": [2.0, 1.2]}, "parameters"),
    *(("internal_force", INTERNAL, name) for name in INTERNAL),
]


@pytest.mark.parametrize(
    ("box", "signals", "name", "fault"),
    nightly_beyond(
        6, "adversary", [(*case, fault) for fault in (np.nan, 1e12, np.inf) for case in FAULTS]
    ),
)
def test_the_block_that_made_a_value_that_is_not_finite_is_named(box, signals, name, fault):
    settings = [] if box == "load_disturbance" else ["load_feedback=DesiredStateFeedback"]
    with pytest.raises(RunStopped, match=f"diverged at t = 0.1.* s: {box} made a value") as caught:
        simulate(short(*settings), **{box: lambda model: Faulty(signals, name, fault)})
    assert 0.05 < caught.value.run.time[-1] < 0.13


@pytest.mark.nightly("flights")
def test_cables_of_many_nodes_start_although_carriers_are_at_the_origin_at_first():
    """Nodes of the default state would be drawn there by more than a number can hold."""
    loop = make_nonstop(load_scenario("aircraft_transfer_cables", ["cables.nodes=24"]))
    load, reference = (
        loop.GetOutputPort(name).Eval(loop.CreateDefaultContext())
        for name in ("load_state", "reference")
    )
    np.testing.assert_allclose(load, reference[:13], atol=1e-6)
