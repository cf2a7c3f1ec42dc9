"""The fused plant does what the separate blocks do, to round-off, or says that it does not."""

import dataclasses

import numpy as np
import pytest
from pydrake.systems.framework import LeafSystem

from drake_nonstop import load_scenario, make_nonstop, set_equilibrium, simulate
from drake_nonstop.blocks.fused_plant import FusedPlant
from drake_nonstop.cli.main import main
from drake_nonstop.diagrams.nonstop import BOXES
from drake_nonstop.simulation.linearized_loop import LinearizedLoop
from drake_nonstop.simulation.run import SIGNAL_PERIOD
from drake_nonstop.systems.traced_block import TracedBlock
from drake_nonstop.validation import ScenarioWarning

FUSE = "fused_plant=true"
CONSTANT = "optimization_layer=ConstantParameters"
SAME = {
    "quintic": ("quintic", "simulation_duration=2"),
    "three carriers": ("three_carriers", "simulation_duration=1", CONSTANT),
    "tilted, 60 m, feedforward": ("real_scale_spread", "simulation_duration=1"),
    "integral": ("line", "simulation_duration=1", CONSTANT, "carrier_controller.integral_gain=50"),
    "50 Hz": ("line", "simulation_duration=1", CONSTANT, "control_period=0.02"),
    "velocity hold": (
        *("quintic", "simulation_duration=1", CONSTANT, "carrier_trajectory.hold=velocity"),
        "carrier_controller=CarrierPid",
    ),
    "hold alone": (
        *("line", "simulation_duration=0.5", CONSTANT),
        *("carrier_trajectory.hold=second_order", "carrier_controller=CarrierPid"),
    ),
    "20 steps": (
        "line",
        "simulation_duration=0.3",
        CONSTANT,
        "simulator_config.max_step_size=0.0005",
    ),
    "stiff": ("line", "simulation_duration=0.5", CONSTANT, "simulated.cable_stiffness=4000"),
    "loaded carriers": (
        *("line", "simulation_duration=1", CONSTANT),
        *("carrier_dynamics=!LoadedCarrierDynamics {max_force: 9}", "simulated.carrier_mass=0.12"),
        "carrier_controller=LoadedCarrierPid",
    ),
    "constant force": (
        "line",
        "simulation_duration=1",
        CONSTANT,
        "load_disturbance=!DisturbanceForce {force: [0.3, 0, 1]}",
    ),
    "unlike cables": (
        *("line", "simulation_duration=1", CONSTANT),
        "cables=!IndividualCables {stiffness: [500, 400, 500, 600]}",
    ),
    "optimizer at 50 Hz": (
        *("line", "simulation_duration=0.4", "optimization_layer=NonstopOptimizer"),
        *("optimization_layer.speed_bound=1.2", "optimization_layer.period=0.02"),
        "phase=AccumulatedPhase",
    ),
    "a plan": ("line", "simulation_duration=0.4", "optimization_layer.speed_bound=1.2"),
    "late and noisy": (
        *("line", "simulation_duration=1", CONSTANT),
        "load_feedback=!NoisyFeedback {position_noise: 0.001, delay: 0.02}",
    ),
    "measured pose": (
        *("line", "simulation_duration=1", CONSTANT),
        *("carrier_trajectory=MeasuredCarrierTrajectory", "phase=PaperPhase"),
        "carrier_controller=CarrierPid",
    ),
}


@pytest.mark.parametrize("name", SAME)
def test_it_is_the_separate_blocks_to_round_off(name):
    scenario = load_scenario(SAME[name][0], SAME[name][1:])
    apart = simulate(scenario)
    fused = simulate(dataclasses.replace(scenario, fused_plant=True))
    assert type(fused.diagram.GetSubsystemByName("plant")) is FusedPlant
    ports = {signal.split(".")[1] for signal in apart.signals}
    further = {signal.split(".")[1] for signal in fused.signals} - ports
    acceleration, jerk = "carrier_reference_acceleration", "carrier_reference_jerk"
    read = {  # by none of the separate blocks
        "velocity hold": set(),
        "measured pose": set(),
        "hold alone": {acceleration},
        "loaded carriers": {acceleration, jerk},
    }
    assert further == read.get(name, {jerk})
    assert len(fused.signals) == len(ports | further)
    np.testing.assert_array_equal(fused.time, apart.time)
    stride = round(scenario.control_period / SIGNAL_PERIOD)  # between samples the steps differ
    for port in ports:
        ours, theirs = fused.signal(port)[::stride], apart.signal(port)[::stride]
        scale = 1 + np.max(np.abs(theirs))
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-10 * scale, err_msg=port)


def test_a_gust_is_held_over_a_control_period():
    settings = [
        "simulation_duration=3",
        CONSTANT,
        "load_disturbance=!DisturbanceForce {gust_force: 0.3}",
    ]
    apart = simulate(load_scenario("line", settings))
    fused = simulate(load_scenario("line", [*settings, FUSE]))
    moved = simulate(load_scenario("line", ["simulation_duration=3", CONSTANT]))
    difference = np.abs(fused.signal("load_state") - apart.signal("load_state"))[:, 4:7].max()
    gust = np.abs(moved.signal("load_state") - apart.signal("load_state"))[:, 4:7].max()
    assert 0 < difference < 0.02 * gust


def test_equilibrium_and_fastest_mode_are_those_of_the_separate_blocks():
    scenario = load_scenario("quintic", [CONSTANT, "simulated.load_mass=1.3"])
    found = []
    for fused in (False, True):
        nonstop = make_nonstop(dataclasses.replace(scenario, fused_plant=fused))
        context = nonstop.CreateDefaultContext()
        set_equilibrium(nonstop, context)
        states = [
            nonstop.GetOutputPort(port).Eval(context) for port in ("load_state", "carrier_state")
        ]
        found.append((np.concatenate(states), LinearizedLoop(nonstop, context, 0.01).fastest_mode))
    np.testing.assert_allclose(found[1][0], found[0][0], rtol=0, atol=1e-9)
    assert found[1][1] == pytest.approx(found[0][1], rel=1e-6)


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("load_plant=MultibodyLoadPlant", "load_plant = MultibodyLoadPlant has no equations"),
        ("carrier_dynamics=IdealCarriers", "carrier_dynamics = IdealCarriers has no equations"),
        ("control_period=0", "control_period = 0"),
        ("simulator_config.integration_scheme=runge_kutta2", "runge_kutta3"),
        ("simulator_config.use_error_control=true", "error control"),
        ("simulator_config.max_step_size=0.0004", "25 steps a sample"),
    ],
)
def test_what_cannot_be_fused_stays_apart_and_says_why(setting, words):
    scenario = load_scenario("line", [CONSTANT, FUSE, setting])
    with pytest.warns(ScenarioWarning, match=f"{words}.*the separate blocks are used instead"):
        nonstop = make_nonstop(scenario)
    assert {block.get_name() for block in nonstop.GetSystems()} >= {
        name for name, box in BOXES.items() if box.is_fused
    }


def test_aircraft_stay_apart_and_the_remedy_is_said():
    scenario = load_scenario("aircraft_rest", [FUSE])
    with pytest.warns(ScenarioWarning) as warned:
        make_nonstop(scenario, at_equilibrium=False)
    assert [str(warning.message) for warning in warned] == [
        "fused_plant = true: aircraft fly with separate blocks, so give fused_plant = false; the "
        "separate blocks are used instead"
    ]


class Hover(LeafSystem):
    """Carriers that stay where they are; no equations."""

    def __init__(self, model):
        super().__init__()
        self.DeclareVectorInputPort("carrier_forces", 3 * model.n)
        self.DeclareStateOutputPort("carrier_state", self.DeclareDiscreteState(6 * model.n))


def test_a_block_of_ones_own_stays_apart():
    with pytest.warns(ScenarioWarning, match="carrier_dynamics = Hover has no equations"):
        make_nonstop(
            load_scenario("line", [CONSTANT, FUSE]), at_equilibrium=False, carrier_dynamics=Hover
        )


class Impatient(TracedBlock):
    """Cables that read the forces of the controller that reads the cables' tensions."""

    def __init__(self, model):
        n = model.n
        super().__init__(
            lambda load, carriers, forces: (forces, forces[:n]),
            inputs={"load_state": 13, "carrier_state": 6 * n, "carrier_forces": 3 * n},
            outputs={"cable_forces": 3 * n, "tensions": n},
        )


def test_parts_that_read_each_other_stay_apart():
    blocks = {"carrier_controller": ReadsTensions, "cables": Impatient}
    with (
        pytest.warns(ScenarioWarning, match="reads what is made from its own outputs"),
        pytest.raises(RuntimeError, match="algebraic loop"),
    ):
        make_nonstop(load_scenario("line", [CONSTANT, FUSE]), **blocks)


def test_parts_are_fused_in_any_order():
    """A controller that reads the cables' tensions is one block with them."""
    diagram = make_nonstop(
        load_scenario("line", [CONSTANT, FUSE]), carrier_controller=ReadsTensions
    )
    assert diagram.HasSubsystemNamed("plant")


class ReadsTensions(TracedBlock):
    """A controller that reads the cables' tensions."""

    def __init__(self, model):
        super().__init__(
            lambda reference, tensions: tensions[:1] * reference[: 3 * model.n],
            inputs={"carrier_reference": 6 * model.n, "tensions": model.n},
            outputs={"carrier_forces": 3 * model.n},
        )


class Ramp(LeafSystem):
    """Parameters that change with the time, between samples too."""

    def __init__(self, model):
        super().__init__()
        self.DeclareVectorOutputPort("parameters", 2, lambda context, output: None)


class Gust(LeafSystem):
    """A wrench that nobody knows the times of."""

    def __init__(self, model):
        super().__init__()
        self.DeclareVectorOutputPort("disturbance_wrench", 6, lambda context, output: None)


class Steady(TracedBlock):
    """A controller that does not read where the carriers should be."""

    def __init__(self, model):
        super().__init__(
            lambda state: -state[: 3 * model.n],
            inputs={"carrier_state": 6 * model.n},
            outputs={"carrier_forces": 3 * model.n},
        )


class Wandering(TracedBlock):
    """A controller that reads the time."""

    def __init__(self, model):
        super().__init__(
            lambda reference, time: time * reference[: 3 * model.n],
            inputs={"carrier_reference": 6 * model.n},
            outputs={"carrier_forces": 3 * model.n},
            reads_time=True,
        )


@pytest.mark.parametrize(
    ("box", "block", "words"),
    [
        ("carrier_controller", Wandering, "Wandering has no equations"),
        ("phase", None, "phase = left out may change between samples"),
        ("optimization_layer", Ramp, "Ramp may change between samples"),
        ("load_disturbance", Gust, "Gust may change between samples"),
        ("carrier_controller", Steady, "no part of it reads carrier_reference"),
    ],
)
def test_what_changes_between_samples_stays_apart(box, block, words):
    settings = [CONSTANT, FUSE, "phase=PaperPhase"]
    with pytest.warns(ScenarioWarning, match=words):
        make_nonstop(load_scenario("line", settings), at_equilibrium=False, **{box: block})


class Leading(TracedBlock):
    """A controller of one's own with equations: a PD that also pulls."""

    def __init__(self, model):
        n = model.n

        def forces(reference, state, cable_forces):
            error = reference - state
            return 900 * error[: 3 * n] + 9 * error[3 * n :] + 0.1 * cable_forces

        super().__init__(
            forces,
            inputs={
                "carrier_reference": 6 * n,
                "carrier_state": 6 * n,
                "desired_cable_forces": 3 * n,
            },
            outputs={"carrier_forces": 3 * n},
        )


def test_a_traced_block_of_ones_own_is_fused():
    scenario = load_scenario("line", ["simulation_duration=0.5", CONSTANT])
    runs = [
        simulate(dataclasses.replace(scenario, fused_plant=fused), carrier_controller=Leading)
        for fused in (False, True)
    ]
    assert type(runs[1].diagram.GetSubsystemByName("plant")) is FusedPlant
    states = [run.signal("carrier_state") for run in runs]
    np.testing.assert_allclose(states[1], states[0], rtol=0, atol=1e-10)


def test_a_fresh_context_is_that_of_the_separate_blocks():
    scenario = load_scenario("line", [CONSTANT])
    for fused in (False, True):
        nonstop = make_nonstop(dataclasses.replace(scenario, fused_plant=fused))
        state = nonstop.GetOutputPort("load_state").Eval(nonstop.CreateDefaultContext())
        np.testing.assert_array_equal(state, [1.0] + [0.0] * 12)


def test_a_box_left_out_stays_out():
    with pytest.warns(ScenarioWarning, match="cables = left out has no equations"):
        nonstop = make_nonstop(load_scenario("line", [CONSTANT, FUSE]), cables=None)
    assert nonstop.HasOutputPort("load_state")


def test_the_command_says_it_in_one_line(capsys, tmp_path):
    settings = ["simulation_duration=0.05", CONSTANT, FUSE, "load_plant=MultibodyLoadPlant"]
    arguments = ["run", "line", "--no-figures", "--no-replay", "--out", str(tmp_path)]
    assert main([*arguments, "--set", *settings]) == 0
    lines = capsys.readouterr().err.splitlines()
    assert sum(line.startswith("warning: fused_plant = true: load_plant") for line in lines) == 1
