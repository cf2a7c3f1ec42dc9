import dataclasses
import itertools
import textwrap

import numpy as np
import pytest
from helpers import irregular, nightly_beyond, regular, spatial

from drake_nonstop.blocks.load_trajectory import RestToRestConfig
from drake_nonstop.blocks.optimization_layer import (
    ConstantParametersConfig,
    PaperLayerConfig,
)
from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.mechanics.grasp import grasp_matrix
from drake_nonstop.mechanics.internal_force import hamiltonian_cycle
from drake_nonstop.model.pattern import (
    CarouselConfig,
    ConstantSpreadConfig,
    EllipticCarouselConfig,
    HamiltonianCycleConfig,
    InternalForcePattern,
    SpreadCarouselConfig,
    check_pattern,
)
from drake_nonstop.model.system import Model, SystemParameters
from drake_nonstop.run.simulate import simulate
from drake_nonstop.scenario.loading import parse_scenario
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.validation import ScenarioError


def weight_shares(attachments):
    return np.tile([0, 0, 9.81 / len(attachments)], (len(attachments), 1))


@pytest.mark.parametrize("attachments", [regular(3), irregular(5), spatial(7)])
def test_cycle_is_the_mechanics_with_even_phases_and_no_offset(attachments):
    n = len(attachments)
    pattern = HamiltonianCycleConfig().make(attachments)
    np.testing.assert_array_equal(pattern.basis, hamiltonian_cycle(attachments))
    np.testing.assert_allclose(pattern.phases, 2 * np.pi * np.arange(n) / n, rtol=1e-15)
    np.testing.assert_array_equal(pattern.offset, np.zeros(3 * n))
    check_pattern(pattern, attachments, weight_shares(attachments))


def test_phases_can_be_given():
    phases = [0.0, np.pi / 2, 0.0, np.pi / 2]
    np.testing.assert_array_equal(
        HamiltonianCycleConfig(phases=phases).make(regular(4)).phases, phases
    )


PHASES, SQUARE = [0.0, 1.0, 2.0, 4.0], regular(4).tolist()
STRAIGHT = [[1.0, 1, 0], [0.0, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]]
BACK = [[0.0, 0, 0], [2, 0, 0], [1, 0, 0], [0, 1, 0]]


@pytest.mark.parametrize(
    ("attachments", "phases", "cable"),
    [
        *((SQUARE, [*PHASES[:2], 1.0 + shift, 4.0], 3) for shift in (0.0, np.pi, np.pi + 1e-4)),
        (SQUARE, [0.0, 1.0, 2.0, np.pi], 1),
        (STRAIGHT, [], 2),
        (BACK, [], 2),
    ],
)
def test_edges_or_phases_that_let_a_carrier_stop_are_refused(attachments, phases, cable):
    attachments = np.array(attachments)
    pattern = HamiltonianCycleConfig(phases=phases).make(attachments)
    with pytest.raises(ScenarioError, match=f"cable {cable} swings in a plane or not at all"):
        check_pattern(pattern, attachments, weight_shares(attachments))


@pytest.mark.parametrize("phases", [[0.0, 1.0, 2.0], [0.0, 1.0, 2.0, np.nan], [[0.0, 1, 2, 4]]])
def test_phases_of_wrong_shape_are_refused(phases):
    with pytest.raises(ScenarioError, match=r"pattern\.phases = .*give 4 finite numbers"):
        HamiltonianCycleConfig(phases=phases).make(regular(4))


def test_cables_on_one_point_are_refused():
    attachments = regular(4)
    attachments[2] = attachments[1]
    with pytest.raises(ScenarioError, match="different attachment points"):
        HamiltonianCycleConfig().make(attachments)


def cycle(attachments, **fields):
    pattern = HamiltonianCycleConfig().make(attachments)
    values = {"basis": pattern.basis, "phases": pattern.phases, "offset": pattern.offset}
    return InternalForcePattern(**(values | fields))


def test_basis_with_a_net_wrench_is_refused():
    attachments = regular(4)
    basis = hamiltonian_cycle(attachments)
    basis[5, 1] += 1e-6
    with pytest.raises(ScenarioError, match=r"pattern\.basis = .*net wrench"):
        check_pattern(cycle(attachments, basis=basis), attachments, weight_shares(attachments))


def test_basis_with_a_net_torque_only_is_refused():
    attachments = regular(4)
    tangents = np.cross([0, 0, 1.0], attachments).ravel()
    assert np.max(np.abs(grasp_matrix(attachments)[3:] @ tangents)) < 1e-15
    basis = hamiltonian_cycle(attachments)
    basis[:, 0] += tangents
    with pytest.raises(ScenarioError, match=r"pattern\.basis = .*net wrench"):
        check_pattern(cycle(attachments, basis=basis), attachments, weight_shares(attachments))


def test_offset_with_a_net_wrench_is_refused():
    attachments = regular(4)
    offset = np.tile([0.0, 0, 0.1], 4)
    with pytest.raises(ScenarioError, match=r"pattern\.offset = .*net wrench"):
        check_pattern(cycle(attachments, offset=offset), attachments, weight_shares(attachments))


def test_internal_force_on_a_line_is_refused():
    attachments = regular(4)
    pattern = cycle(attachments, phases=np.array([0.0, 0.0, 1.0, 2.0]))  # cable 2 feels 1 and 2
    with pytest.raises(ScenarioError, match=r"pattern.phases = .*cable 2 swings in a plane"):
        check_pattern(pattern, attachments, weight_shares(attachments))


def test_cable_without_an_internal_force_is_refused():
    attachments = regular(4)
    pattern = InternalForcePattern(hamiltonian_cycle(attachments)[:, :1], np.zeros(1), np.zeros(12))
    with pytest.raises(ScenarioError, match=r"pattern.phases = .*cable 1 swings in a plane"):
        check_pattern(pattern, attachments, weight_shares(attachments))


def test_cable_whose_mean_force_lies_in_the_plane_of_its_internal_force_is_refused():
    # An upright square: the weight is in the plane of the cycle, and every cable stays in it.
    attachments = regular(4)[:, [0, 2, 1]]
    pattern = cycle(attachments)
    with pytest.raises(ScenarioError, match="swings in a plane"):
        check_pattern(pattern, attachments, weight_shares(attachments))


@dataclasses.dataclass(kw_only=True)
class OwnCarouselConfig:
    """ᴸf̃_i = C (cos β_i, sin β_i, 0) + A (cos(θ − β_i), sin(θ − β_i), 0), m = 2."""

    spread: float = 1.0

    def make(self, attachments):
        beta = 2 * np.pi * np.arange(len(attachments)) / len(attachments)
        zero = 0 * beta
        cosines = np.column_stack([np.cos(beta), -np.sin(beta), zero]).ravel()
        sines = np.column_stack([np.sin(beta), np.cos(beta), zero]).ravel()
        outward = np.column_stack([np.cos(beta), np.sin(beta), zero]).ravel()
        basis = np.column_stack([cosines, sines])
        return InternalForcePattern(basis, np.array([0.0, -np.pi / 2]), self.spread * outward)


@pytest.mark.parametrize("n", nightly_beyond(1, "flights", [4, 3, 6]))
def test_a_pattern_of_ones_own_holds_a_load_at_rest_and_every_carrier_in_motion(n):
    share = 9.81 / n
    scenario = Scenario(
        simulation_duration=1.0,
        system=SystemParameters(attachments=regular(n).tolist()),
        pattern=OwnCarouselConfig(spread=share),
        optimization_layer=ConstantParametersConfig(frequency=2.0, amplitude=0.4 * share),
    )
    assert Model(scenario.system, scenario.pattern).m == 2
    run = simulate(scenario)
    assert run.time[-1] == pytest.approx(1.0)
    load = run.signal("load_state")
    np.testing.assert_allclose(load[:, 4:7], 0, rtol=0, atol=1e-3)
    np.testing.assert_allclose(load[:, :4], [[1, 0, 0, 0]] * len(load), rtol=0, atol=2e-3)
    velocities = run.signal("carrier_state")[:, 3 * n :].reshape(len(load), n, 3)
    speeds = np.linalg.norm(velocities, axis=2)
    # T between √(f₀² + (0.6 f₀)²) and √(f₀² + (1.4 f₀)²), L A ξ / T and the tilt of the cone
    assert np.min(speeds) > 0.5 * 0.8 * 0.4 * 2.0 / np.hypot(1, 1.4)
    assert np.max(speeds) < 1.05 * 0.8 * 0.4 * 2.0 / np.hypot(1, 0.6)
    # The carriers turn about outward axes: they stay further apart than the attachments.
    positions = run.signal("carrier_state")[:, : 3 * n].reshape(len(load), n, 3)
    gaps = np.linalg.norm(positions - np.roll(positions, 1, axis=1), axis=2)
    assert np.min(gaps) > np.linalg.norm(regular(n)[0] - regular(n)[1])


@pytest.mark.parametrize("n", [3, 4, 5, 8])
def test_carousel_turns_all_forces_of_a_regular_polygon_together(n):
    pattern = CarouselConfig().make(regular(n))
    angles = 2 * np.pi * np.arange(n) / n
    for theta in (0.0, 0.7, 2.9):
        forces = (pattern.basis @ np.cos(theta + pattern.phases)).reshape(n, 3)
        expected = [np.cos(theta - angles), np.sin(theta - angles), 0 * angles]
        np.testing.assert_allclose(forces, np.transpose(expected), rtol=0, atol=1e-14)


@pytest.mark.parametrize("n", [3, 4, 5, 8])
def test_spread_pulls_outward(n):
    pattern = SpreadCarouselConfig(spread=3.0).make(regular(n, 1.5))
    np.testing.assert_allclose(pattern.offset.reshape(n, 3), 2 * regular(n, 1.5), atol=1e-13)
    np.testing.assert_array_equal(pattern.basis, CarouselConfig().make(regular(n, 1.5)).basis)


def test_carousel_needs_a_direction_for_every_cable():
    attachments = np.vstack([regular(4), [[0.0, 0.0, 0.4]]])
    with pytest.raises(ScenarioError, match=r"system\.attachments = .*in the middle of all"):
        CarouselConfig().make(attachments)


@pytest.mark.parametrize("spread", [0.0, -1.0, float("nan")])
def test_spread_has_to_be_positive(spread):
    with pytest.raises(ScenarioError, match=r"pattern\.spread = .*greater than zero"):
        SpreadCarouselConfig(spread=spread).make(regular(4))


ELLIPTIC = {
    "spread": 1.5,
    "phase_turns": 2,
    "radial": 0.6,
    "tangential": 0.9,
    "vertical": 0.7,
}


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


def is_said_to_be_without_a_wrench(n, k, config):
    """The conditions of the theory, on κ modulo n."""
    zero, one, minus_one = (k % n == value % n for value in (0, 1, -1))
    same = config.radial == config.tangential
    opposite = config.radial == -config.tangential
    return not (
        (not opposite and (zero or minus_one))
        or (not same and (zero or one))
        or (config.vertical != 0 and (zero or one or minus_one))
    )


@pytest.mark.parametrize("n", range(3, 9))
def test_elliptic_carousel_has_the_forces_of_its_formula_where_they_have_no_wrench(n, rng):
    accepted = 0
    for turns, radial, vertical in itertools.product(range(n), (0.9, -0.9, 0.6), (0.0, 0.7)):
        k = turns + int(rng.integers(-2, 2)) * n
        sizes = {"radial": radial, "vertical": vertical}
        config = EllipticCarouselConfig(**(ELLIPTIC | sizes | {"phase_turns": k}))
        attachments = turned_polygon(n, rng)
        theta, amplitude = rng.uniform(0, 6), rng.uniform(0.5, 3)
        forces = elliptic_forces(config, attachments, theta, amplitude)
        torque = np.cross(attachments, forces).sum(axis=0)
        is_free = np.allclose([forces.sum(axis=0), torque], 0, atol=1e-12)
        assert is_free == is_said_to_be_without_a_wrench(n, k, config)
        if not is_free:
            with pytest.raises(ScenarioError, match=f"phase_turns = {k}: with {n} cables"):
                config.make(attachments)
            continue
        accepted += 1
        pattern = config.make(attachments)
        np.testing.assert_allclose(
            pattern_forces(pattern, theta, amplitude), forces, rtol=0, atol=1e-12
        )
        assert len(pattern.phases) == 2
    assert accepted > n - 2


@pytest.mark.parametrize(
    ("n", "remedy"),
    [(3, "give vertical = 0"), (4, r"give 2 \(mod"), (6, r"give 2 or 3 or 4 \(mod")],
)
def test_turns_that_suit_are_told(n, remedy):
    with pytest.raises(ScenarioError, match=remedy):
        EllipticCarouselConfig(**(ELLIPTIC | {"phase_turns": 1})).make(regular(n))


@pytest.mark.parametrize("attachments", [irregular(5), spatial(4), spatial(7), regular(4) + 0.3])
def test_elliptic_carousel_of_other_attachments_is_the_nearest_without_a_wrench(attachments):
    turns = 3 if len(attachments) == 5 else 2
    config = EllipticCarouselConfig(**(ELLIPTIC | {"phase_turns": turns}))
    pattern = config.make(attachments)
    check_pattern(pattern, attachments, weight_shares(attachments))
    change = pattern_forces(pattern, 0.7, 1.3) - elliptic_forces(config, attachments, 0.7, 1.3)
    grasp = grasp_matrix(attachments)
    row_space = np.linalg.lstsq(grasp.T, change.ravel(), rcond=None)[0]
    np.testing.assert_allclose(grasp.T @ row_space, change.ravel(), rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("field", "value", "remedy"),
    [
        ("spread", -1.0, "not negative"),
        ("phase_turns", 1.5, "whole number"),
        ("phase_turns", 101, "from -100 to 100"),
        ("tangential", 0.0, "other than 0"),
        ("vertical", np.nan, "a finite number"),
    ],
)
def test_elliptic_carousel_refuses_bad_numbers(field, value, remedy):
    with pytest.raises(ScenarioError, match=rf"^pattern\.{field} = .*{remedy}"):
        EllipticCarouselConfig(**(ELLIPTIC | {field: value})).make(regular(4))


def test_forces_whose_ellipses_lie_in_planes_through_the_attachments_are_refused():
    # cos, sin and constant part: A_t (A_r f₀ + B C) is their volume.
    share, fields = 9.81 / 4, {"radial": -0.7 * 1.5 / (9.81 / 4)}
    flat = EllipticCarouselConfig(**(ELLIPTIC | fields)).make(regular(4))
    with pytest.raises(ScenarioError, match="cable 1 swings in a plane"):
        check_pattern(flat, regular(4), weight_shares(regular(4)))
    fields = {"radial": fields["radial"] * 1.1}
    pattern = EllipticCarouselConfig(**(ELLIPTIC | fields)).make(regular(4))
    check_pattern(pattern, regular(4), np.tile([0, 0, share], (4, 1)))


def co_rotating(**changes):
    """R60 of the theory: 60 m cables, and carriers that keep their places above a turning load."""
    text = """
      r60:
        based_on: real_scale_spread
        control_period: 0.0
        simulation_duration: 2.0
        pattern: !ConstantSpread {spread: 30.0}
        load_trajectory: !SteadyTurn {yaw_rate: 0.40}
        optimization_layer: !ConstantParameters {frequency: 0.4, amplitude: 0.0, speed_bound: 8.0}
    """
    return dataclasses.replace(parse_scenario(textwrap.dedent(text)), **changes)


def test_co_rotating_formation_flies_as_its_closed_form_says():
    run = simulate(co_rotating())
    share, length = 98.1 / 4, 60.0
    tension = np.hypot(share, 30.0)
    length += tension / 120.0
    radius, height = 1.5 + length * 30.0 / tension, length * share / tension
    carriers = run.signal("carrier_state").reshape(-1, 2, 4, 3)
    places = carriers[:, 0] - run.signal("load_state")[:, None, 4:7]
    flat = np.linalg.norm(places[..., :2], axis=2)
    speeds = np.linalg.norm(carriers[:, 1], axis=2)
    np.testing.assert_allclose(flat, radius, rtol=1e-6)
    np.testing.assert_allclose(places[..., 2], height, rtol=1e-6)
    np.testing.assert_allclose(speeds, 0.40 * radius, rtol=1e-6)
    np.testing.assert_allclose(run.signal("tensions"), tension, rtol=1e-5)
    apart = np.linalg.norm(places - np.roll(places, 1, axis=1), axis=2)
    np.testing.assert_allclose(apart, 2 * radius * np.sin(np.pi / 4), rtol=1e-6)
    assert np.max(np.abs(run.signal("tracking_error"))) < 1e-5
    # The figures of the theory's table.
    assert 0.40 * radius == pytest.approx(19.2, abs=0.1)
    assert apart.min() == pytest.approx(68, abs=0.5)


REFUSED = [
    (
        {"load_trajectory": RestToRestConfig()},
        "pattern = ConstantSpread: .*give load_traj.*SteadyT",
    ),
    ({"optimization_layer": ConstantParametersConfig()}, "amplitude = 1.2: .* give 0"),
    ({"optimization_layer": PaperLayerConfig()}, "PaperLayer: .*no orbits"),
    (
        {"pattern": SpreadCarouselConfig()},
        "optimization_layer.amplitude = 0.0: .*greater than zero",
    ),
    ({"pattern": ConstantSpreadConfig(spread=0.0)}, "pattern.spread = 0.0: .*greater than zero"),
]


@pytest.mark.parametrize(("changes", "message"), REFUSED)
def test_what_does_not_go_with_a_turning_formation_is_refused(changes, message):
    with pytest.raises(ScenarioError, match=message):
        make_nonstop(co_rotating(**changes))
