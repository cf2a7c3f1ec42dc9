"""The state that a run starts from, and what is said where there is none."""

import numpy as np
import pytest
from helpers import nightly_beyond
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource
from pydrake.trajectories import PiecewisePolynomial

from drake_nonstop import LoadTrajectory
from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.loop.start import PlantStates, set_equilibrium
from drake_nonstop.mechanics.signals import LoadReference, LoadState
from drake_nonstop.run.simulate import simulate
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.validation import ScenarioError

GENERATOR = np.random.default_rng(16)


def drawn(count, values):
    return nightly_beyond(count, "studies", values.tolist())


def short(*overrides):
    layer = "optimization_layer=ConstantParameters"
    return load_scenario("quintic", ["simulation_duration=0.05", layer, *overrides])


@pytest.mark.parametrize("points", drawn(2, GENERATOR.uniform(-1, 1, (5, 4, 3))))
def test_a_load_starts_with_the_acceleration_of_its_reference(points):
    """Splines through drawn points accelerate from their start on."""
    rows = np.hstack([np.zeros((4, 3)), points]).T
    curve = PiecewisePolynomial.CubicWithContinuousSecondDerivatives(
        1.5 * np.arange(4), rows, np.zeros((6, 1)), np.zeros((6, 1))
    )
    run = simulate(short(), load_trajectory=lambda model: LoadTrajectory(curve))
    reference, soon = (LoadReference.view(values) for values in run.signal("reference")[[0, 1]])
    start, after = (LoadState.view(state) for state in run.signal("load_state")[[0, 1]])
    size = np.linalg.norm(reference.acceleration)
    assert size > 0.1
    np.testing.assert_allclose(start.position, reference.position, atol=1e-4)
    change, desired = after.velocity - start.velocity, soon.velocity - reference.velocity
    np.testing.assert_allclose(change, desired, atol=0.05 * 0.01 * size)


@pytest.mark.parametrize("lift", drawn(1, GENERATOR.uniform(10, 100, 2)))
def test_a_disturbance_that_lifts_the_load_is_named_with_a_remedy_that_works(lift):
    with pytest.raises(ScenarioError, match="load_disturbance lifts it with") as raised:
        simulate(short(f"load_disturbance=!DisturbanceForce {{force: [0, 0, {lift}]}}"))
    assert "let it start later" in str(raised.value)
    assert "load_trajectory" not in str(raised.value)
    simulate(
        short(f"load_disturbance=!DisturbanceForce {{force: [0, 0, {lift}], start_time: 0.05}}")
    )
    simulate(short("load_disturbance=!DisturbanceForce {force: [0, 0, 6]}"))


BEYOND = [  # settings, and the blocks whose signals they make too large
    (
        "load_trajectory=!RestToRest {displacement: [1e9, 0, 0], move_time: 0.01}",
        "load_trajectory",
    ),
    ("optimization_layer=!ConstantParameters {amplitude: 4.0e+8}", "internal_force"),
    ("system.gravity=1e9", "wrench_controller"),
    ("load_disturbance=!DisturbanceForce {force: [0, 1e9, 0]}", "load_disturbance"),
]


@pytest.mark.parametrize(
    ("override", "block", "engine"),
    nightly_beyond(
        len(BEYOND) + 1,
        "engines",
        [
            *((*case, "diagram") for case in BEYOND),
            *((*case, engine) for engine in ("compiled", "auto") for case in BEYOND),
        ],
    ),
)
def test_a_value_that_is_not_finite_at_the_start_names_its_block(override, block, engine):
    with pytest.raises(ScenarioError, match=f"start = ({block}): it makes a value"):
        simulate(short(override, f"engine={engine}"))


@pytest.mark.parametrize("scenario", ["paper_quintic", "aircraft_rest"])
def test_a_load_at_its_equilibrium_stays_there_to_the_bit(scenario, monkeypatch):
    nonstop = make_nonstop(load_scenario(scenario))
    context = nonstop.CreateDefaultContext()
    before = context.get_continuous_state_vector().CopyToVector()
    looked, look = [], PlantStates.load_acceleration

    def counted(states, trial):
        looked.append(trial)
        return look(states, trial)

    monkeypatch.setattr(PlantStates, "load_acceleration", counted)
    set_equilibrium(nonstop, context)
    np.testing.assert_array_equal(context.get_continuous_state_vector().CopyToVector(), before)
    assert len(looked) == 1


def test_a_reference_of_no_rotation_is_refused():
    def twice_as_long(model):
        builder = DiagramBuilder()
        source = builder.AddSystem(ConstantVectorSource(np.append(2.0, np.zeros(21))))
        builder.ExportOutput(source.get_output_port(), "reference")
        return builder.Build()

    with pytest.raises(ScenarioError, match=r"load_trajectory.reference = \[2. .* of length 1"):
        simulate(short("optimization_layer=ConstantParameters"), load_trajectory=twice_as_long)


@pytest.mark.parametrize("share", [-0.12, 0.1, 0.15])
def test_a_load_whose_attachments_are_elsewhere_starts_near_its_reference(share):
    """Full steps of Newton's method wind such a load up in its cables, or leave them slack."""
    attachments = np.array(load_scenario("three_carriers").system.attachments)
    shift = share * np.ptp(attachments[:, 0])
    overrides = [f"simulated.attachments={(attachments + np.array([shift, 0, 0])).tolist()}"]
    loop = make_nonstop(load_scenario("three_carriers", overrides))
    context = loop.CreateDefaultContext()
    state = LoadState.view(loop.GetOutputPort("load_state").Eval(context))
    assert np.abs(state.quaternion[1:]).max() < 0.1
    assert np.abs(state.position[0] + shift) < 0.05
    assert loop.GetOutputPort("tensions").Eval(context).min() > 1.0
