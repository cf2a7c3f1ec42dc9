"""Carriers kept apart, against all pairs at all phases."""

from itertools import combinations

import numpy as np
import pytest
from helpers import nightly_beyond

from drake_nonstop.blocks.optimization_layer import NonstopOptimizerConfig
from drake_nonstop.mechanics.rotation import roll_pitch_yaw_to_quaternion
from drake_nonstop.model.pattern import HamiltonianCycleConfig, LinearPatternConfig
from drake_nonstop.model.system import Model, SystemParameters
from drake_nonstop.optimization import separation
from drake_nonstop.optimization.diagnostics import Outcome
from drake_nonstop.optimization.update_solver import UpdateSolver
from drake_nonstop.systems.tracing import NotFiniteError

PHASES = 36
GRAVITY = np.array([0, 0, 9.81])
SHARE = 0.25 * 9.81  # N, of a cable


def spread_carousel(n, offset):
    angles = 2 * np.pi * np.arange(n) / n
    cosine, sine, zero = np.cos(angles), np.sin(angles), np.zeros(n)
    columns = [np.column_stack(c).ravel() for c in ((cosine, -sine, zero), (sine, cosine, zero))]
    outward = offset * np.column_stack([cosine, sine, zero]).ravel()
    return LinearPatternConfig(
        basis=np.column_stack(columns).tolist(), phases=[0.0, -np.pi / 2], offset=outward.tolist()
    )


class Drawn:
    """A tilted load on 3 to 12 cables of 0.8 to 60 m, and a least separation that may bind."""

    def __init__(self, seed, **fields):
        rng = np.random.default_rng([16, seed])
        n = int(rng.integers(3, 13))
        angles = 2 * np.pi * np.arange(n) / n
        radius = rng.uniform(0.5, 2)
        attachments = radius * np.column_stack([np.cos(angles), np.sin(angles), 0 * angles])
        pattern = HamiltonianCycleConfig()
        if rng.random() < 0.3:
            pattern = spread_carousel(n, rng.choice([0.0, 1.5, 2.5]))
        else:
            attachments += rng.uniform(-0.1, 0.1, (n, 3)) * radius * 2 / n
        length = float(rng.choice([0.8, 2.0, 10.0, 60.0]))
        mass = 0.25 * n
        bound = float(length * np.exp(rng.uniform(np.log(0.1), np.log(2.0))))
        self.model = Model(
            SystemParameters(attachments=attachments.tolist(), cable_length=length, load_mass=mass),
            pattern,
        )
        # About what a level load keeps at some amplitude.
        self.least, self.levers = 1.0, attachments
        self.forces = SHARE * np.array([[0, 0, 1]]) + self.model.pattern.offset.reshape(-1, 3)
        apart = np.sqrt(1 + self.worst_margin(SHARE * np.exp(rng.uniform(np.log(0.1), 1.0))))
        self.least = float(apart * rng.uniform(0.8, 1.2))
        config = NonstopOptimizerConfig(
            min_separation=self.least,
            speed_bound=bound,
            tightening=0.0,
            orbit_points=1,
            **fields,
        )
        self.solver = UpdateSolver(self.model, config, lambda: "optimization_layer")
        tilt, omega, velocity, torque, torque_rate = rng.uniform(-1, 1, (5, 3)) * [
            [0.4],
            [0.3],
            [0.5],
            [0.1 * mass * 9.81 * radius],
            [0.3],
        ]
        acceleration, force_rate = rng.uniform(-1, 1, 3), rng.uniform(-2, 2, 3)
        state = np.concatenate([roll_pitch_yaw_to_quaternion(tilt), np.zeros(3), omega, velocity])
        self.data = self.solver.update_data(
            previous=np.exp(rng.uniform(np.log([0.5, 0.1 * SHARE]), np.log([5.0, 1.3 * SHARE]))),
            phase=np.array([rng.uniform(0, 2 * np.pi), 0.0]),
            load_state=state,
            reference=np.concatenate([state, np.zeros(3), acceleration, np.zeros(3)]),
            wrench=np.concatenate([torque, mass * (acceleration + GRAVITY)]),
            wrench_rate=np.concatenate([torque_rate, force_rate]),
            wrench_second_rate=np.zeros(6),
            speed_bound=bound,
        )
        self.problem = self.solver.problem(self.data)
        terms = self.problem._terms
        self.forces, self.levers = terms.forces, terms.levers

    def positions(self, amplitude, phase):
        """(n, 3), relative to the load."""
        pattern = self.model.pattern
        push = amplitude * pattern.basis @ np.cos(phase + pattern.phases)
        forces = self.forces + push.reshape(-1, 3)
        tensions = np.linalg.norm(forces, axis=1, keepdims=True)
        length = self.model.cable_length + self.model.cable_compliance * tensions
        return self.levers + length * forces / tensions

    def worst_margin(self, amplitude):
        """Of all pairs at all phases, with tangents by differences."""
        half_step, h, worst = np.pi / PHASES, 1e-5, np.inf
        i, j = np.array(list(combinations(range(self.model.n), 2))).T
        for phase in 2 * np.pi * np.arange(PHASES) / PHASES:
            now = self.positions(amplitude, phase)
            rates = (
                self.positions(amplitude, phase + h) - self.positions(amplitude, phase - h)
            ) / (2 * h)
            gaps, opening = now[i] - now[j], rates[i] - rates[j]
            way = -(gaps * opening).sum(axis=1) / (opening**2).sum(axis=1)
            gaps = gaps + way.clip(-half_step, half_step)[:, None] * opening
            worst = min(worst, float((gaps**2).sum(axis=1).min()))
        return worst / self.least**2 - 1


@pytest.mark.parametrize("seed", nightly_beyond(4, "studies", range(25)))
def test_the_closest_encounter_of_all_pairs_is_found(seed, monkeypatch):
    if seed % 2:
        monkeypatch.setattr(separation, "_MOST_DISTANCES", 200)  # several blocks of phases
    drawn = Drawn(seed)
    for amplitude in SHARE * np.array([0.05, 0.4, 1.0, 2.5]):
        expected = drawn.worst_margin(amplitude)
        found = drawn.problem.margins(np.array([2.0, amplitude]))[-1]
        if expected > 1e-6:
            assert found == np.inf
        elif expected < -1e-6:
            assert found == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("seed", nightly_beyond(3, "studies", range(12)))
def test_encounters_are_learned_of_where_carriers_come_too_close(seed):
    drawn = Drawn(seed)
    problem = drawn.problem
    for amplitude in SHARE * np.array([0.1, 0.4, 1.0, 2.5]):
        x = np.array([2.0, amplitude])
        is_missed = problem.margins(x)[-1] < -1e-6
        assert problem.learns_from(x) <= is_missed
        assert not problem.learns_from(x)
        if is_missed:
            (margin,) = problem.search_problem.amplitude_margins(x[1:])
            assert margin == pytest.approx(problem.margins(x)[-1], abs=1e-9)


@pytest.mark.parametrize("seed", nightly_beyond(4, "studies", range(24)))
def test_answers_keep_apart_and_none_of_a_grid_is_cheaper(seed):
    drawn = Drawn(seed)
    problem, search = drawn.problem, drawn.solver.problem(drawn.data).search_problem
    found, outcome, _ = drawn.solver.solve(drawn.data)
    frequencies, amplitudes = (
        np.geomspace(*bounds, 60) for bounds in zip(search.lower, search.upper, strict=True)
    )
    amplitudes = amplitudes.clip(search.lower[1], search.upper[1])
    speeds, _ = search.margins(amplitudes, frequencies)
    separations = np.array([drawn.worst_margin(a) for a in amplitudes])
    is_feasible = (speeds >= 0) & (separations[:, None] >= 0)
    costs = [
        problem.cost(np.array([frequencies[j], amplitudes[i]])) for i, j in np.argwhere(is_feasible)
    ]
    if outcome in (Outcome.KEPT, Outcome.SOLVED):
        assert drawn.worst_margin(found[1]) >= -2e-6
        assert search.speed_margins(found).min() >= -2e-6
        assert problem.cost(found) <= min(costs, default=np.inf) * (1 + 1e-3)
    else:
        assert not costs


@pytest.mark.parametrize("seed", nightly_beyond(1, "studies", [7, 2, 11]))
def test_other_solvers_agree_with_the_search(seed):
    drawn = Drawn(seed)
    expected, outcome, _ = drawn.solver.solve(drawn.data)
    for solver in ("grid", "snopt", "ipopt", "nlopt"):
        other = Drawn(seed, solver=solver)
        found, other_outcome, _ = other.solver.solve(other.data)
        assert other_outcome == outcome == Outcome.SOLVED
        if solver != "grid":  # which is coarser
            least = drawn.problem.cost(expected)
            assert drawn.problem.cost(found) == pytest.approx(least, rel=1e-3)
        assert drawn.worst_margin(found[1]) >= -2e-6


def test_a_cable_without_tension_has_no_margin():
    drawn = Drawn(0)
    drawn.problem._terms = drawn.problem._terms._replace(forces=0 * drawn.forces)
    with pytest.raises(NotFiniteError, match="optimization_layer made"):
        drawn.problem.margins(np.array([2.0, 0.0]))


@pytest.mark.parametrize("seed", nightly_beyond(3, "studies", range(12)))
def test_encounters_that_are_near_are_all_that_come_so_close(seed):
    drawn = Drawn(seed)
    model, amplitude = drawn.model, np.array([0.6 * SHARE])
    cables = {"rest_length": model.cable_length, "compliance": model.cable_compliance}
    distances, load = drawn.solver._traced.distances, (drawn.forces, drawn.levers)
    every = distances.every()
    assert every.shape == (3, PHASES * model.n * (model.n - 1) // 2)
    (squares,) = distances.least_squares(every, amplitude, *load, **cables)
    for distance in np.sqrt(np.quantile(squares, [0.001, 0.01, 0.1])) + 1e-9:
        near = distances.near(distance, float(amplitude[0]), *load, **cables)
        assert {*map(tuple, every[:, squares <= distance**2].T)} <= {*map(tuple, near.T)}
        assert near.shape[1] < every.shape[1]
