"""Loads of 0.1 to 100 kg on cables of 0.6 to 60 m: their gains against Floquet multipliers."""

import numpy as np
import pytest
from helpers import GAINS

from drake_nonstop.analysis.load_stability import LoadDeviations
from drake_nonstop.blocks.wrench_controller import WrenchController, WrenchControllerConfig
from drake_nonstop.model.pattern import HamiltonianCycleConfig
from drake_nonstop.model.system import Model, SystemParameters

GRAVITY = 9.81
AT_REST = np.eye(22)[0]


def formation(seed):
    """A box on 3 to 5 cables, with ξ and A of its size."""
    rng = np.random.default_rng([1919, seed])
    n = int(rng.integers(3, 6))
    mass, length = np.exp(rng.uniform(np.log([0.1, 0.6]), np.log([100.0, 60.0])))
    radius = rng.uniform(0.3, 1.0) * min(length, np.sqrt(length))
    angles = 2 * np.pi * (np.arange(n) + rng.uniform(-0.1, 0.1, n)) / n
    attachments = radius * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(n)])
    a, b, c = radius * rng.uniform(0.5, 1.4, 3) ** 2
    turned, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    inertia = mass / 12 * turned @ np.diag([b**2 + c**2, a**2 + c**2, a**2 + b**2]) @ turned.T
    share = mass * GRAVITY / n
    model = Model(
        SystemParameters(
            load_mass=mass,
            load_inertia=(inertia + inertia.T) / 2,
            load_drag=0.1 * mass ** (2 / 3),
            attachments=attachments,
            cable_length=length,
            cable_stiffness=share / (0.01 * length),
            cable_damping=0.02 * np.sqrt(share / (0.01 * length) * mass / n),
        ),
        HamiltonianCycleConfig(),
    )
    frequency = rng.uniform(0.35, 0.75) * np.sqrt(GRAVITY / length)
    return model, np.array([frequency, share * rng.uniform(0.3, 0.6)])


def growth(model, parameters, **gains):
    block = WrenchController(model, WrenchControllerConfig(**gains))
    return LoadDeviations(model).growth(AT_REST, parameters, gains=block.gains).rate


@pytest.mark.parametrize("seed", range(12))
def test_a_load_settles_whatever_its_size(seed):
    model, parameters = formation(seed)
    assert growth(model, parameters) < -5e-4


@pytest.mark.parametrize("seed", [0, 13])
def test_loads_that_the_papers_gains_let_swing_settle(seed):
    model, parameters = formation(seed)
    assert growth(model, parameters, **GAINS) > 0.01
    assert growth(model, parameters) < -1e-3
