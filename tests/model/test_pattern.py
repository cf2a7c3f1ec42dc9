"""Patterns: forces without a wrench, as their formulas say, that keep every carrier in motion."""

import dataclasses
import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from helpers import irregular, regular, spatial
from registries import CHOICES

from drake_nonstop import (
    InternalForcePattern,
    Model,
    ScenarioError,
    SystemParameters,
    load_scenario,
    simulate,
)
from drake_nonstop.mechanics.grasp import grasp_matrix
from drake_nonstop.mechanics.internal_force import hamiltonian_cycle
from drake_nonstop.model.pattern import (
    CarouselConfig,
    ConstantSpreadConfig,
    EllipticCarouselConfig,
    HamiltonianCycleConfig,
    SpreadCarouselConfig,
)

SHAPES = [*(regular(n) for n in (3, 4, 5, 8)), irregular(5), spatial(7), regular(4) + 0.3]


def elliptic(**fields):
    sizes = {"spread": 1.5, "phase_turns": 2, "radial": 0.6, "tangential": 0.9, "vertical": 0.7}
    return EllipticCarouselConfig(**sizes | fields)


def checked(config, attachments):
    """The pattern of a model, of a load of 1 kg."""
    return Model(SystemParameters(attachments=np.array(attachments).tolist()), config).pattern


@pytest.mark.parametrize("config", CHOICES["pattern"], ids=lambda config: config.__name__)
def test_forces_of_any_attachments_have_no_wrench_and_keep_the_carriers_in_motion(config):
    for attachments in SHAPES:
        pattern = checked(config(), attachments)
        forces = np.column_stack([pattern.basis, pattern.offset])
        np.testing.assert_allclose(grasp_matrix(attachments) @ forces, 0, rtol=0, atol=1e-12)
        assert pattern.basis.shape == (attachments.size, len(pattern.phases))
        assert pattern.is_constant == (config is ConstantSpreadConfig)
        radii = np.linalg.norm(attachments, axis=1)
        if hasattr(config(), "spread") and np.ptp(radii) < 1e-9:
            expected = config().spread * attachments / radii[:, None]
            np.testing.assert_allclose(pattern.offset.reshape(-1, 3), expected, atol=1e-12)


def test_the_cycle_has_even_phases_or_those_given():
    for attachments in SHAPES:
        pattern, n = HamiltonianCycleConfig().make(attachments), len(attachments)
        np.testing.assert_array_equal(pattern.basis, hamiltonian_cycle(attachments))
        np.testing.assert_allclose(pattern.phases, 2 * np.pi * np.arange(n) / n, rtol=1e-15)
    phases = [0.0, np.pi / 2, 0.0, np.pi / 2]
    assert HamiltonianCycleConfig(phases=phases).make(regular(4)).phases.tolist() == phases


def elliptic_forces(config, attachments, theta, amplitude):
    """The formula, in the complex plane of the horizontal forces, (n, 3) without f₀."""
    x, y, _ = (attachments - attachments.mean(axis=0)).T
    beta = np.angle(x + 1j * y)
    phi = theta + config.phase_turns * beta
    sizes = config.radial, config.tangential, config.vertical
    radial, tangential, vertical = amplitude * np.array(sizes)
    plane = np.exp(1j * beta) * (
        config.spread + radial * np.cos(phi) + 1j * tangential * np.sin(phi)
    )
    return np.stack([plane.real, plane.imag, -vertical * np.cos(phi)], axis=1)


def pattern_forces(pattern, theta, amplitude):
    coordinates = amplitude * np.cos(theta + pattern.phases)
    return (pattern.offset + pattern.basis @ coordinates).reshape(-1, 3)


def turned_polygon(n, rng):
    """A regular polygon at any angle, height and size, its corners in any order."""
    angles = 2 * np.pi * rng.permutation(n) / n + rng.uniform(0, 6)
    x, y = rng.uniform(0.3, 2) * np.array([np.cos(angles), np.sin(angles)])
    return np.stack([x, y, np.full(n, rng.normal())], axis=1)


@pytest.mark.parametrize("n", range(3, 9))
def test_carousels_have_the_forces_of_their_formula_where_they_have_no_wrench(n, rng):
    configs = [CarouselConfig(), SpreadCarouselConfig(spread=2.0)]
    for turns, radial, vertical in itertools.product(range(n), (0.9, -0.9, 0.6), (0.0, 0.7)):
        k = turns + int(rng.integers(-2, 2)) * n
        sizes = {"radial": radial, "vertical": vertical, "phase_turns": k}
        configs.append(elliptic(**sizes))
    accepted = 0
    for config in configs:
        attachments = turned_polygon(n, rng)
        theta, amplitude = rng.uniform(0, 6), rng.uniform(0.5, 3)
        forces = elliptic_forces(config, attachments, theta, amplitude)
        torque = np.cross(attachments, forces).sum(axis=0)
        is_free = np.allclose([forces.sum(axis=0), torque], 0, atol=1e-12)
        if is_free:
            accepted += 1
            pattern = config.make(attachments)
            made = pattern_forces(pattern, theta, amplitude)
            np.testing.assert_allclose(made, forces, rtol=0, atol=1e-12)
        else:
            with pytest.raises(ScenarioError, match=f"phase_turns = {config.phase_turns}: with"):
                config.make(attachments)
    assert accepted > n


@pytest.mark.parametrize("attachments", [irregular(5), spatial(4), spatial(7), regular(4) + 0.3])
def test_an_elliptic_carousel_of_other_attachments_is_the_nearest_without_a_wrench(attachments):
    turns = 3 if len(attachments) == 5 else 2
    config = elliptic(phase_turns=turns)
    pattern = checked(config, attachments)
    change = pattern_forces(pattern, 0.7, 1.3) - elliptic_forces(config, attachments, 0.7, 1.3)
    grasp = grasp_matrix(attachments)
    row_space = np.linalg.lstsq(grasp.T, change.ravel(), rcond=None)[0]
    np.testing.assert_allclose(grasp.T @ row_space, change.ravel(), rtol=0, atol=1e-12)


PHASES, SQUARE = [0.0, 1.0, 2.0, 4.0], regular(4)
STRAIGHT = [[1.0, 1, 0], [0.0, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]]
BACK = [[0.0, 0, 0], [2, 0, 0], [1, 0, 0], [0, 1, 0]]
UPRIGHT = regular(4)[:, [0, 2, 1]]  # the weight is in the plane of the cycle
CYCLE = HamiltonianCycleConfig
FLAT = -0.7 * 1.5 / (9.81 / 4)  # A_r of which the volume A_t (A_r f₀ + B C) is none


@pytest.mark.parametrize(
    ("config", "attachments", "cable"),
    [
        *((CYCLE(phases=[*PHASES[:2], 1 + s, 4.0]), SQUARE, 3) for s in (0.0, np.pi, np.pi + 1e-4)),
        (CYCLE(phases=[0.0, 1.0, 2.0, np.pi]), SQUARE, 1),
        (CYCLE(phases=[0.0, 0.0, 1.0, 2.0]), SQUARE, 2),
        *((CYCLE(), shape, 2) for shape in (STRAIGHT, BACK)),
        (CYCLE(), UPRIGHT, 1),
        (elliptic(radial=FLAT), SQUARE, 1),
    ],
)
def test_forces_that_let_a_carrier_stop_are_refused(config, attachments, cable):
    with pytest.raises(ScenarioError, match=f"cable {cable} swings in a plane or not at all"):
        checked(config, attachments)
    checked(elliptic(radial=1.1 * FLAT), SQUARE)  # just beside


@pytest.mark.parametrize("name", ["basis", "offset"])
def test_forces_with_a_net_wrench_are_refused(name):
    pattern, tangents = HamiltonianCycleConfig().make(SQUARE), np.cross([0, 0, 1.0], SQUARE).ravel()
    for push in (tangents, np.tile([0.0, 0, 1e-6], 4)):
        value = getattr(pattern, name).copy()
        value.T[..., :] += push
        other = dataclasses.replace(pattern, **{name: value})
        with pytest.raises(ScenarioError, match=rf"pattern\.{name} = .*net wrench"):
            checked(SimpleNamespace(make=lambda _, made=other: made), SQUARE)


@pytest.mark.parametrize(
    ("config", "attachments", "field", "remedy"),
    [
        (CYCLE(phases=[0.0, 1.0, 2.0]), SQUARE, "pattern.phases", "give 4 finite numbers"),
        (CYCLE(phases=[0.0, 1, 2, np.nan]), SQUARE, "pattern.phases", "give 4 finite numbers"),
        (CYCLE(phases=[[0.0, 1, 2, 4]]), SQUARE, "pattern.phases", "give 4 finite numbers"),
        (CYCLE(), SQUARE[[0, 1, 1, 2]], "system.attachments", "different attachment points"),
        (CarouselConfig(), [*SQUARE, [0, 0, 0.4]], "system.attachments", "in the middle of all"),
        *((SpreadCarouselConfig(spread=s), SQUARE, "spread", "above|greater") for s in (0.0, -1)),
        (ConstantSpreadConfig(spread=0.0), SQUARE, "pattern.spread", "greater than zero"),
        (elliptic(spread=-1.0), SQUARE, "pattern.spread", "not negative"),
        (elliptic(phase_turns=1.5), SQUARE, "pattern.phase_turns", "whole number"),
        (elliptic(phase_turns=101), SQUARE, "pattern.phase_turns", "from -100 to 100"),
        (elliptic(tangential=0.0), SQUARE, "pattern.tangential", "other than 0"),
        (elliptic(vertical=np.nan), SQUARE, "pattern.vertical", "a finite number"),
        (elliptic(phase_turns=1), regular(3), "pattern.phase_turns", "give vertical = 0"),
        (elliptic(phase_turns=1), SQUARE, "pattern.phase_turns", r"give 2 \(mod"),
        (elliptic(phase_turns=1), regular(6), "pattern.phase_turns", r"give 2 or 3 or 4 \(mod"),
    ],
)
def test_what_makes_no_pattern_is_told(config, attachments, field, remedy):
    with pytest.raises(ScenarioError, match=f"{field} = .*({remedy})"):
        config.make(np.array(attachments))


@dataclasses.dataclass(kw_only=True)
class OwnCarouselConfig:
    """That of `SpreadCarousel`, by hand."""

    spread: float = 1.0

    def make(self, attachments):
        beta = 2 * np.pi * np.arange(len(attachments)) / len(attachments)
        x, y, zero = np.cos(beta), np.sin(beta), 0 * beta
        circle = [np.column_stack(axes).ravel() for axes in ((x, -y, zero), (y, x, zero))]
        offset = self.spread * np.column_stack([x, y, zero]).ravel()
        return InternalForcePattern(np.transpose(circle), np.array([0.0, -np.pi / 2]), offset)


def test_a_pattern_of_ones_own_is_flown_as_the_shipped_one_that_it_is():
    changes = ["simulation_duration=0.5", "optimization_layer=ConstantParameters"]
    scenario = load_scenario("quintic", changes)
    states = []
    for pattern in (OwnCarouselConfig(spread=2.0), SpreadCarouselConfig(spread=2.0)):
        scenario.pattern = pattern
        scenario.system.attachments = regular(4).tolist()
        states.append(simulate(scenario).signal("carrier_state"))
    np.testing.assert_allclose(*states, rtol=0, atol=1e-9)
