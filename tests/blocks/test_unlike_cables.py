"""Cables that differ, each with a length, a stiffness and a thickness of its own."""

import re

import numpy as np
import pytest
from helpers import Motion, fix, model, outputs, regular, sizes_of_ports

from drake_nonstop import RunOutcome, compute_metrics, load_scenario, simulate
from drake_nonstop.blocks.cables import Cables
from drake_nonstop.blocks.carrier_trajectory import (
    BowedCarrierTrajectory,
    BowedCarrierTrajectoryConfig,
    CarrierTrajectory,
    CarrierTrajectoryConfig,
    MeasuredCarrierTrajectory,
)
from drake_nonstop.blocks.lumped_cables import LumpedCables, LumpedCablesConfig

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
    (CarrierTrajectory, CarrierTrajectoryConfig(correction_rates=[0.0] * 4)),
    (MeasuredCarrierTrajectory, None),
    (BowedCarrierTrajectory, BowedCarrierTrajectoryConfig(nodes=3, correction_rates=[0.0] * 4)),
]


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
    for name, size in sizes_of_ports(block(model(n), config), "input").items():
        inputs.setdefault(name, rng.uniform(-0.2, 0.2, size))
    start = (rng.uniform(-0.1, 0.1, (6, n, 3)) + regular(n)).ravel()
    start[: 9 * n] += np.tile(UP, 3 * n) * np.repeat([0.2, 0.5, 0.9], 3 * n)

    def moved(system):
        made = block(model(n, **system), config)
        context = made.CreateDefaultContext()
        given = {name: inputs[name] for name in sizes_of_ports(made, "input")}
        state = start[: context.num_continuous_states()]
        found = [*outputs(made, state if len(state) else None, **given).values()]
        if len(state):
            context.SetContinuousState(state)
            fix(made, context, **given)
            found.append(made.EvalTimeDerivatives(context).CopyToVector())
        return [part.reshape(-1, n, 3 if part.size % (3 * n) == 0 else 1) for part in found]

    together = moved(UNLIKE)
    for i in range(n):
        alone = moved({name: values[i] for name, values in UNLIKE.items()})
        for one, other in zip(together, alone, strict=True):
            np.testing.assert_allclose(one[:, i], other[:, i], rtol=1e-9, atol=1e-9)
    assert any(np.ptp(a - b) > 1e-3 for a, b in zip(together, alone, strict=True))


def test_the_cable_that_bears_too_little_is_the_one_that_breaks():
    own = ["system.cable_breaking_load=[100, 100, 2.4, 100]", "simulation_duration=0.3"]
    own += ["optimization_layer=ConstantParameters"]
    metrics = compute_metrics(simulate(load_scenario("quintic", own)))
    assert metrics["outcome"] == RunOutcome.CABLE_BROKEN
    assert re.search(r"cable 3 broke .* it bears 2.4 N", metrics["reasons"][0])
