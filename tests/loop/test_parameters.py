"""A loop whose parameters are set is the loop that is built with these values.

Drawn scenarios are built for some values and set to others in the context, and built for those
others: all signals agree to the bit.
"""

import copy
from functools import cache

import numpy as np
import pytest
from helpers import nightly_beyond, output, vector_outputs
from pydrake.autodiffutils import AutoDiffXd
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from drake_nonstop import (
    CarouselConfig,
    HamiltonianCycleConfig,
    LinearPatternConfig,
    Model,
    ScenarioError,
    SpreadCarouselConfig,
    get_parameter,
    load_scenario,
    make_nonstop,
    parameters,
    set_equilibrium,
    set_parameter,
)
from drake_nonstop.diagrams.nonstop import BOXES
from drake_nonstop.mechanics.internal_force import carousel, spread
from drake_nonstop.model.block import BlockParameters
from drake_nonstop.model.system import WatchedModel
from drake_nonstop.systems import traced_block
from drake_nonstop.systems.parameters import declared, parameters_in
from drake_nonstop.systems.wiring import output_names

DURATION = 0.03  # s
CHOICES = {  # boxes whose blocks have parameters
    "wrench_controller": ("WrenchController", "PaperWrenchController", "GeometricPd"),
    "optimization_layer": ("NonstopOptimizer", "ConstantParameters"),
    "carrier_trajectory": ("CarrierTrajectory", "InextensibleCarrierTrajectory"),
    "carrier_controller": ("CarrierPid", "FeedforwardCarrierPid", "TunedFeedforwardCarrierPid"),
    "cables": ("Cables", "IndividualCables"),
}


def drawn(seed):
    """A scenario of 3 to 6 carriers on tilted attachments, with drawn blocks."""
    random = np.random.default_rng(seed)
    names = {box: random.choice(choices) for box, choices in CHOICES.items()}
    if seed % 3 == 0:
        names["wrench_controller"] = "TunedWrenchController"
    if seed % 3 == 1:
        names |= {"carrier_controller": "LoadedCarrierPid"}
        names |= {"carrier_dynamics": "LoadedCarrierDynamics"}
    scenario = load_scenario("quintic", [f"{box}={name}" for box, name in names.items()])
    n = int(random.integers(3, 7))
    angles = 2 * np.pi * np.arange(n) / n
    heights = random.uniform(-0.1, 0.1, n)
    points = np.stack([0.75 * np.cos(angles), 0.75 * np.sin(angles), heights], axis=1)
    scenario.system.attachments = points
    inertia = np.diag(random.uniform(0.01, 0.013, 3))
    inertia[0, 1] = inertia[1, 0] = 1e-3
    scenario.system.load_inertia = inertia
    scenario.control_period = 0.01 * (seed % 2)
    patterns = (
        SpreadCarouselConfig(),
        HamiltonianCycleConfig() if n > 3 else CarouselConfig(),
        LinearPatternConfig(
            basis=carousel(points).tolist(),
            phases=[0.0, -np.pi / 2],
            offset=(2 * spread(points)).tolist(),
        ),
    )
    scenario.pattern = patterns[seed % 3]
    if names["cables"] == "IndividualCables":
        scenario.cables.stiffness = [500.0] * n
    if "integral_gain" in vars(scenario.carrier_controller) and n % 2:
        scenario.carrier_controller.integral_gain = 5.0
    if "max_force" in vars(scenario.carrier_dynamics) and n % 2:
        scenario.carrier_dynamics.max_force = 8.0
    if seed % 2:
        scenario.simulated.load_mass = 1.02
    return scenario, random


def another(path, value, random):
    """Another value of a parameter, near by."""
    field = path.split(".")[1]
    given = {
        "amplitude_bounds": [0.1, 9.0],
        "load_angular_drag": 0.002,
        "load_inertia": (1.03 * np.array(value)).tolist(),
    }
    changed = (np.array(value) * random.uniform(1.005, 1.02)).tolist()
    return given.get(field, changed if np.any(value) else value)


def signals(loop, scenario, changes):
    """All signals but the wall time, a little after the start, with parameters changed."""
    simulator = Simulator(loop)
    context = simulator.get_mutable_context()
    for path, value in changes.items():
        set_parameter(loop, context, path, value)
        np.testing.assert_allclose(get_parameter(loop, context, path), value, rtol=1e-15)
    set_equilibrium(loop, context)
    ApplySimulatorConfig(scenario.simulator_config, simulator)
    simulator.AdvanceTo(DURATION)
    energies = {"kinetic": loop.CalcKineticEnergy, "potential": loop.CalcPotentialEnergy}
    return {name: calculate(context) for name, calculate in energies.items()} | {
        name: output(loop, context, name) for name in vector_outputs(loop) if name != "solve_time"
    }


def built_for(scenario, changes):
    result = copy.deepcopy(scenario)
    for path, value in changes.items():
        owner, field = path.split(".")
        setattr(getattr(result, owner), field, value)
    return result


# Between them the three patterns, and controllers that are continuous or sampled.
@pytest.mark.parametrize("seed", nightly_beyond(1, "studies", [1, 2, 3, 0, 4, 5]))
def test_a_loop_set_to_values_is_the_loop_built_for_them(seed):
    scenario, random = drawn(seed)
    loop = make_nonstop(scenario)
    entries = parameters(loop, loop.CreateDefaultContext())
    changes = {e.path: another(e.path, e.value, random) for e in entries}
    changes = dict(sorted(changes.items(), key=lambda item: item[0].startswith("simulated")))
    if "pattern.spread" in changes:
        del changes["pattern.offset"]  # the same in other words
    for chosen in (changes, dict([list(changes.items())[random.integers(len(changes))]])):
        other = built_for(scenario, chosen)
        expected = signals(make_nonstop(other), other, {})
        found = signals(loop, scenario, chosen)
        for name, value in expected.items():
            # Where carriers' forces are scaled or summed up in another order: by rounding.
            np.testing.assert_allclose(found[name], value, rtol=1e-12, atol=1e-12, err_msg=name)
    before = signals(loop, scenario, {})
    assert any(not np.array_equal(before[name], value_) for name, value_ in expected.items())


@pytest.mark.nightly("studies")
def test_where_no_linear_block_is_concerned_they_are_equal_to_the_bit():
    scenario = load_scenario("quintic")
    loop, _ = quintic()
    for path in ("system.load_mass", "wrench_controller.position_gain"):
        other = built_for(scenario, {path: 1.3})
        expected = signals(make_nonstop(other), other, {})
        for name, value in signals(loop, scenario, {path: 1.3}).items():
            np.testing.assert_array_equal(value, expected[name], err_msg=f"{path}: {name}")


@cache
def loop_of(*overrides):
    return make_nonstop(load_scenario("quintic", overrides))


def quintic(*overrides):
    """A loop that tests share, and a context of its own."""
    loop = loop_of(*overrides)
    return loop, loop.CreateDefaultContext()


CONSTANT = "optimization_layer=ConstantParameters"


def own_quintic():
    """A loop that can become a part of another diagram."""
    return make_nonstop(load_scenario("quintic", [CONSTANT]), at_equilibrium=False)


def test_nothing_is_traced_anew(monkeypatch):
    loop, context = quintic()
    monkeypatch.setattr(traced_block, "Trace", None)
    set_parameter(loop, context, "system.cable_stiffness", 450.0)
    set_parameter(loop, context, "wrench_controller.orientation_gain", 0.6)
    assert get_parameter(loop, context, "simulated.cable_stiffness") == 450.0


def test_the_plant_follows_the_system_unless_it_has_a_value_of_its_own():
    for overrides in ([], ["simulated.load_mass=1.1"]):
        loop, context = quintic(*overrides)
        if not overrides:
            set_parameter(loop, context, "system.load_mass", 1.05)
            assert get_parameter(loop, context, "simulated.load_mass") == 1.05
            set_parameter(loop, context, "simulated.load_mass", 1.1)
        set_parameter(loop, context, "system.load_mass", 1.2)
        assert get_parameter(loop, context, "system.load_mass") == 1.2
        assert get_parameter(loop, context, "simulated.load_mass") == 1.1


def wrench_gains(loop, context):
    names = {e.path for e in parameters(loop, context) if e.path.startswith("wrench_controller")}
    return {name: get_parameter(loop, context, name) for name in names}


def test_gains_that_are_auto_follow_unless_they_have_a_value_of_their_own():
    load = {
        "system.load_mass": 3.0,
        "system.load_inertia": np.diag([0.03, 0.02, 0.04]).tolist(),
        "system.cable_length": 2.0,
        "system.gravity": 8.0,
    }
    given, own = "wrench_controller.position_gain", "wrench_controller.orientation_gain"
    loop, context = quintic(f"{given}=5")  # as the one of this load and these cables
    set_parameter(loop, context, own, 0.7)
    for path, value in load.items():
        set_parameter(loop, context, path, value)
    built, start = quintic(f"{given}=5", f"{own}=0.7", *(f"{k}={v}" for k, v in load.items()))
    found = wrench_gains(loop, context)
    assert found == wrench_gains(built, start)
    assert (found[given], found[own]) == (5.0, 0.7)
    assert found["wrench_controller.velocity_gain"] == pytest.approx(13.2 * np.sqrt(11 / 13.065625))


def test_gains_that_are_auto_have_the_derivatives_of_what_they_follow():
    loop, context = quintic(CONSTANT)
    inertia = np.array([[0.03, 2e-3, 0.0], [2e-3, 0.02, 1e-3], [0.0, 1e-3, 0.04]])
    set_parameter(loop, context, "system.load_inertia", inertia)
    step = 1e-5

    def along(entry):
        """All four in one direction."""
        return {
            "system.load_inertia": [[entry(x, 0.3 * x) for x in row] for row in inertia],
            "system.load_mass": entry(1.0, 0.7),
            "system.cable_length": entry(0.8, 0.5),
            "system.gravity": entry(9.81, 1.0),
        }

    def gains(entry):
        for path, value in along(entry).items():
            set_parameter(loop, context, path, value)
        return wrench_gains(loop, context)

    above, below = (gains(lambda x, d, s=side: x + s * step * d) for side in (1, -1))
    converted = loop.ToAutoDiffXd()
    start = converted.CreateDefaultContext()
    for path, value in along(lambda x, d: AutoDiffXd(x, [d])).items():
        set_parameter(loop, start, path, np.array(value) if np.ndim(value) else value)
    controller = converted.GetSubsystemByName("wrench_controller")
    own = controller.GetMyContextFromRoot(start)
    values = parameters_in(loop.GetSubsystemByName("wrench_controller"), own)
    for path, upper in above.items():
        [value] = np.ravel(values[path.split(".")[1]])
        slope = value.derivatives()[0] if len(value.derivatives()) else 0.0
        assert slope == pytest.approx((upper - below[path]) / (2 * step), rel=1e-6, abs=1e-12)
        assert slope != 0 or path.endswith("feedforward")


def test_parameters_are_listed_with_units_and_blocks():
    loop, context = quintic()
    found = {entry.path: entry for entry in parameters(loop, context)}
    mass = found["system.load_mass"]
    assert (mass.value, mass.meaning) == (1.0, "kg")
    assert mass.blocks == (
        "wrench_controller",
        "optimization_layer",
        "carrier_trajectory",
        "load_plant",
    )
    assert found["optimization_layer.speed_bound"].meaning == ('m/s, ε; of aircraft also "1.4 V_s"')


def test_a_loop_in_a_bigger_diagram_is_set_in_its_own_context():
    builder = DiagramBuilder()
    loop = builder.AddSystem(own_quintic())
    builder.AddSystem(own_quintic()).set_name("other")
    diagram = builder.Build()
    root = diagram.CreateDefaultContext()
    with pytest.raises(ScenarioError, match=r"give that of the diagram, inside of a bigger"):
        set_parameter(loop, root, "system.load_mass", 1.2)
    own = loop.GetMyMutableContextFromRoot(root)
    set_parameter(loop, own, "system.load_mass", 1.2)
    assert get_parameter(loop, own, "system.load_mass") == 1.2
    other = diagram.GetSubsystemByName("other")
    assert get_parameter(other, other.GetMyContextFromRoot(root), "system.load_mass") == 1.0


def around(**loops):
    """A diagram of loops by their names, which exports the first one's signals if it is alone."""
    builder = DiagramBuilder()
    for name, loop in loops.items():
        builder.AddNamedSystem(name, loop)
        if len(loops) == 1:
            for signal in output_names(loop):
                builder.ExportOutput(loop.GetOutputPort(signal), signal)
    return builder.Build()


def test_a_diagram_around_a_loop_has_the_loops_parameters_and_one_around_two_is_refused():
    loop = own_quintic()
    paths = [entry.path for entry in parameters(loop, loop.CreateDefaultContext())]
    outer = around(middle=around(inner=loop))
    context = outer.CreateDefaultContext()
    assert [entry.path for entry in parameters(outer, context)] == paths
    set_parameter(outer, context, "wrench_controller.position_gain", 5.5)
    own = loop.GetMyContextFromRoot(context)
    assert get_parameter(loop, own, "wrench_controller.position_gain") == 5.5
    two = around(a=own_quintic(), b=own_quintic())
    with pytest.raises(ScenarioError, match="a diagram around a and b: give the loop inside of it"):
        set_parameter(two, two.CreateDefaultContext(), "system.load_mass", 1.2)


def test_a_loop_is_given_as_it_was_before_its_conversion():
    scenario = load_scenario("quintic", ["load_plant=MultibodyLoadPlant", CONSTANT])
    loop = make_nonstop(scenario)
    converted = loop.ToAutoDiffXd()
    for made in (loop.Clone(), converted):
        with pytest.raises(ScenarioError, match="give the loop that it was made of"):
            set_parameter(made, made.CreateDefaultContext(), "system.gravity", 1.6)
    context = converted.CreateDefaultContext()
    set_parameter(loop, context, "optimization_layer.frequency", AutoDiffXd(2.1, [1.0]))
    (frequency, _) = converted.GetOutputPort("parameters").Eval(context)
    assert (frequency.value(), *frequency.derivatives()) == (2.1, 1.0)
    one = around(inner=loop)
    with pytest.raises(ScenarioError, match="give that of the loop itself"):
        set_parameter(one, one.ToAutoDiffXd().CreateDefaultContext(), "system.gravity", 1.6)


BAD = [
    ("system.load_mass", -1.0, "greater than zero"),
    ("system.load_mass", "heavy", "give a number"),
    ("system.load_mass", AutoDiffXd(1.1, [1.0]), "a context of the loop converted to AutoDiffXd"),
    (7, 1.0, "give a scenario path"),
    (np.zeros(3), 1.0, "give a scenario path"),
    ("system.load_mass", [[1, 2], [3]], "give a number"),
    ("optimization_layer.frequency_bounds", [[1, 2], [3]], "give a number"),
    ("system.load_inertia", np.diag([1.0, 0.1, 0.1]), "triangle inequality"),
    ("system.cable_stiffness", np.inf, "simulated cables stretch"),
    ("system.attachments", [[0.0, 0.0, 0.0]], "fixed as the loop is built"),
    ("system.load_mas", 1.0, "did you mean load_mass"),
    ("sistem.load_mass", 1.0, "did you mean system"),
    ("pattern.phases", [0.0], "no parameter of the context"),
    ("load_trajectory.move_time", 3.0, "no parameter of the context"),
    ("carrier_controller.integral_gain", 1.0, "CarrierPid is built in another way for it"),
    ("optimization_layer.frequency_bounds", [3.0, 9.0], "hold the initial frequency"),
    ("optimization_layer.frequency_bounds", [1.0], "give 2 finite numbers"),
    ("optimization_layer.speed_bound", 1e-9, "give 0 .no bound. or at least"),
]


@pytest.mark.parametrize(("path", "value", "remedy"), BAD)
def test_what_cannot_be_set_is_said_and_nothing_changes(path, value, remedy):
    loop, context = quintic()
    before = [entry.value for entry in parameters(loop, context)]
    with pytest.raises(ScenarioError, match=remedy):
        set_parameter(loop, context, path, value)
    assert [entry.value for entry in parameters(loop, context)] == before


@pytest.mark.parametrize("path", [7, None, ["system.load_mass"], np.zeros(3)])
def test_a_path_that_is_no_text_is_refused(path):
    with pytest.raises(ScenarioError, match=r"^parameter = .*give a scenario path"):
        get_parameter(*quintic(), path)


def test_what_a_block_keeps_names_the_block():
    loop, context = quintic("load_plant=MultibodyLoadPlant")
    with pytest.raises(ScenarioError, match="load_plant = MultibodyLoadPlant keeps what it was"):
        set_parameter(loop, context, "system.load_mass", 1.2)
    assert get_parameter(loop, context, "system.load_mass") == 1.0
    set_parameter(loop, context, "system.load_drag", 0.8)
    assert get_parameter(loop, context, "simulated.load_drag") == 0.8


def test_carriers_without_inertia_keep_their_mass():
    loop, context = quintic("carrier_dynamics=IdealCarriers")
    with pytest.raises(ScenarioError, match="carrier_dynamics = IdealCarriers keeps what it was"):
        set_parameter(loop, context, "system.carrier_mass", 0.2)


@pytest.mark.parametrize("layer", ["NonstopOptimizer", "ConstantParameters"])
def test_a_bound_that_is_commanded_is_not_set(layer):
    scenario = load_scenario("quintic", [f"optimization_layer={layer}"])
    loop = make_nonstop(scenario, inputs=["speed_bound_command"])
    context = loop.CreateDefaultContext()
    set_parameter(loop, context, "optimization_layer.speed_bound", 0.3)
    assert loop.GetOutputPort("speed_bound").Eval(context) == 0.3
    loop.GetInputPort("speed_bound_command").FixValue(context, [0.4])
    with pytest.raises(ScenarioError, match="signal speed_bound_command sets the bound"):
        set_parameter(loop, context, "optimization_layer.speed_bound", 0.5)
    assert get_parameter(loop, context, "optimization_layer.speed_bound") == 0.3
    set_parameter(loop, context, "optimization_layer.frequency", 2.1)


@pytest.mark.parametrize("reads", [True, False])
def test_a_users_block_that_has_read_a_number_of_its_model_keeps_it(reads):
    class Push(LeafSystem):
        def __init__(self, model):
            super().__init__()
            force = model.load.mass if reads else 0.0
            wrench = np.array([0.0, 0.0, 0.0, 1e-3 * force, 0.0, 0.0])
            self.DeclareVectorOutputPort(
                "disturbance_wrench", 6, lambda _, output: output.SetFromVector(wrench)
            )

    loop = make_nonstop(load_scenario("quintic", [CONSTANT]), load_disturbance=Push)
    context = loop.CreateDefaultContext()
    if reads:
        with pytest.raises(ScenarioError, match="load_disturbance has read it from its model"):
            set_parameter(loop, context, "system.load_mass", 1.2)
    else:
        set_parameter(loop, context, "system.load_mass", 1.2)
    set_parameter(loop, context, "wrench_controller.position_gain", 4.0)


VARIANTS = [(name, variant) for name, box in BOXES.items() for variant in box.variants]


@pytest.mark.parametrize(("name", "variant"), VARIANTS)
def test_every_block_declares_the_numbers_of_the_model_that_it_reads(name, variant):
    if variant.__name__ == "JsbsimCarriers":
        pytest.importorskip("jsbsim")
    scenario = load_scenario("aircraft_rest")
    model = WatchedModel(Model(scenario.system, SpreadCarouselConfig(), 0.01, field="simulated"))
    block = variant(model)
    known = {"pattern_offset"}  # read with the basis and the phases, see the loops above
    for _, found, _ in declared(block):
        if isinstance(found, BlockParameters):
            known |= {*found.of_system, *found.fixed}
    known |= {name.split(".")[0] for name in known}  # an aircraft by its single figures
    assert model.read <= known


def test_a_plan_goes_on_without_a_step_to_another_nominal_amplitude():
    scenario = load_scenario("quintic", ["load_trajectory.start_time=9"])
    diagram = make_nonstop(scenario)
    simulator = Simulator(diagram)
    ApplySimulatorConfig(scenario.simulator_config, simulator)
    port, shown = diagram.GetOutputPort("parameters"), []
    for k in range(150):
        if k == 50:
            context = simulator.get_mutable_context()
            set_parameter(diagram, context, "optimization_layer.amplitude", 1.4)
        simulator.AdvanceTo(0.01 * k + 0.005)
        shown.append(port.Eval(simulator.get_context())[1])
    assert shown[49] == pytest.approx(1.2, rel=1e-6)
    assert shown[-1] > 1.22
    assert np.abs(np.diff(shown)).max() < 0.01
