"""Cables that differ, each with a length, a stiffness and a thickness of its own."""

import re

import numpy as np
import pytest
from helpers import Motion, fix, model, nightly_beyond, outputs, regular

from drake_nonstop.blocks.cables import Cables
from drake_nonstop.blocks.carrier_trajectory import (
    BowedCarrierTrajectory,
    BowedCarrierTrajectoryConfig,
    CarrierTrajectory,
    MeasuredCarrierTrajectory,
)
from drake_nonstop.blocks.lumped_cables import LumpedCables, LumpedCablesConfig
from drake_nonstop.mechanics.rotation import rotation_matrix
from drake_nonstop.mechanics.signals import LoadReference
from drake_nonstop.run.metrics import compute_metrics
from drake_nonstop.run.outcome import RunOutcome
from drake_nonstop.run.simulate import simulate
from drake_nonstop.scenario.loading import load_scenario

UP = np.array([0.0, 0.0, 1.0])
UNLIKE = {
    "cable_length": [0.8, 0.9, 1.1, 1.3],
    "cable_stiffness": [300.0, 400.0, 500.0, 800.0],
    "cable_damping": [0.1, 0.2, 0.0, 0.3],
    "cable_diameter": [0.001, 0.002, 0.003, 0.0015],
    "cable_drag": [1.1, 1.0, 0.9, 0.8],
    "cable_friction": [0.02, 0.03, 0.01, 0.0],
    "cable_density": [970.0, 500.0, 1400.0, 800.0],
}
BLOCKS = [
    (Cables, None),
    (LumpedCables, LumpedCablesConfig(nodes=3)),
    (CarrierTrajectory, None),
    (MeasuredCarrierTrajectory, None),
    (BowedCarrierTrajectory, BowedCarrierTrajectoryConfig(nodes=3)),
]
ERRORS = (("position", "m"), ("orientation", "rad"))
# Five cables on the corners of an L, whose carriers circle outside of it.
L_SHAPED = [
    "system.load_mass=3.0",
    "system.load_inertia=[[0.9, -0.2, 0.0], [-0.2, 0.9, 0.0], [0.0, 0.0, 1.7]]",
    "system.attachments=[[1.2, -0.4, 0.05], [0.4, -0.5, 0.05], [-0.5, -0.5, 0.0], "
    "[-0.5, 0.4, 0.05], [-0.4, 1.2, 0.1]]",
    "pattern=!SpreadCarousel {spread: 3.0}",
    "optimization_layer=!ConstantParameters {frequency: 3.0, amplitude: 2.5, speed_bound: 0.3}",
    "load_trajectory.move_time=6",
    "simulation_duration=7",
]
FIVE = "system.cable_length=[0.8, 0.95, 1.1, 1.25, 1.4]"
LUMPED = [
    "cables=!LumpedCables {nodes: 3}",
    "carrier_trajectory=!BowedCarrierTrajectory {nodes: 3}",
]


HORIZON = [
    "optimization_layer=!RecedingHorizonOptimizer {speed_bound: 0.3}",
    *("load_trajectory.move_time=10", "simulation_duration=11"),
]
SHORT = ["control_period=0", "simulation_duration=1"]


def fly(*changes, name="quintic", **arguments):
    return simulate(load_scenario(name, changes), **arguments)


@pytest.mark.parametrize(("block", "config"), BLOCKS)
def test_each_cable_is_as_one_of_many_that_are_all_like_it(rng, block, config):
    n, motion = 4, Motion(60)
    inputs = {
        "load_state": motion.state(0.3),
        "measured_load_state": motion.state(0.3),
        "reference": motion.reference(0.3),
        "carrier_state": np.concatenate([(regular(n) + 1.2 * UP).ravel(), rng.normal(size=12)]),
        "desired_cable_forces": (rng.uniform(-0.5, 0.5, (n, 3)) + 2.5 * UP).ravel(),
        "planned": np.array([0.3, 2.0, 0.1, 0.0, 1.2, 0.1, 0.0, 0.0]),
    }

    def moved(system):
        made = block(model(n, **system), config)
        context = made.CreateDefaultContext()
        size = context.num_continuous_states()
        given = {k: inputs.get(k, rest[k][:sizes]) for k, sizes in _sizes(made).items()}
        state = start[:size] if size else None
        found = [*outputs(made, state, **given).values()]
        if size:
            context.SetContinuousState(state)
            fix(made, context, **given)
            found.append(made.EvalTimeDerivatives(context).CopyToVector())
        return [part.reshape(-1, n, 3 if part.size % (3 * n) == 0 else 1) for part in found]

    start = (rng.uniform(-0.1, 0.1, (6, n, 3)) + regular(n)).ravel()
    start[: 9 * n] += np.tile(UP, 3 * n) * np.repeat([0.2, 0.5, 0.9], 3 * n)
    rest = {name: rng.uniform(-0.2, 0.2, 30) for name in _sizes(block(model(n), config))}
    together = moved(UNLIKE)
    for i in range(n):
        alone = moved({name: values[i] for name, values in UNLIKE.items()})
        for one, other in zip(together, alone, strict=True):
            np.testing.assert_allclose(one[:, i], other[:, i], rtol=1e-9, atol=1e-9)
    assert any(np.ptp(a - b) > 1e-3 for a, b in zip(together, alone, strict=True))


def _sizes(block):
    ports = (block.get_input_port(i) for i in range(block.num_input_ports()))
    return {port.get_name(): port.size() for port in ports}


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    nightly_beyond(1, "flights", [([],), (HORIZON,), ([*LUMPED, "system.cable_diameter=0.003"],)]),
)
def test_cables_of_five_lengths_carry_an_l_shaped_load_as_well_as_equal_ones(changes):
    found = []
    for lengths in ("system.cable_length=1.1", FIVE):
        run = fly(*L_SHAPED, *changes, lengths)
        metrics = compute_metrics(run)
        assert metrics["outcome"] == RunOutcome.OK, metrics["reasons"]
        found.append([metrics["load"][f"{part}_error_max_{unit}"] for part, unit in ERRORS])
    alike, unlike = np.array(found)
    assert np.all(unlike < 1.5 * alike + 1e-6)


@pytest.mark.slow
def test_references_are_at_the_ends_of_cables_of_their_own_length():
    """p = p_L + R b + (L + T/K) f/T (eq. 1)."""
    stiffness = [400.0, 500.0, 600.0, 700.0, 800.0]
    run = fly(*L_SHAPED, FIVE, f"system.cable_stiffness={stiffness}", *SHORT)
    system = run.scenario.system
    load = LoadReference.view(run.signal("reference"))
    forces = run.signal("desired_cable_forces").reshape(-1, 5, 3)
    tensions = np.linalg.norm(forces, axis=2)
    lengths = system.cable_length + tensions / stiffness
    levers = system.attachments @ rotation_matrix(load.quaternion).swapaxes(1, 2)
    ends = load.position[:, None] + levers + (lengths / tensions)[..., None] * forces
    references = run.signal("carrier_reference")[:, :15].reshape(-1, 5, 3)
    np.testing.assert_allclose(references, ends, atol=1e-12)
    np.testing.assert_allclose(run.signal("tensions"), tensions, rtol=1e-3)


def test_the_cable_that_bears_too_little_is_the_one_that_breaks():
    run = fly(
        *(L_SHAPED[4], "simulation_duration=0.3"),
        "system.cable_breaking_load=[100, 100, 2.4, 100]",
    )
    metrics = compute_metrics(run)
    assert metrics["outcome"] == RunOutcome.CABLE_BROKEN
    assert re.search(r"cable 3 broke .* it bears 2.4 N", metrics["reasons"][0])
