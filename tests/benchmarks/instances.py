"""Random problems for the optimization layer, and their true optima."""

import contextlib
import hashlib
import os
import tempfile
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.blocks.optimization_layer import NonstopOptimizerConfig
from drake_nonstop.mechanics.nonstop import polynomial_values, speed_squares
from drake_nonstop.mechanics.rigid_load import gravity_wrench
from drake_nonstop.mechanics.rotation import roll_pitch_yaw_to_quaternion
from drake_nonstop.mechanics.signals import LoadReference
from drake_nonstop.model.pattern import HamiltonianCycleConfig, LinearPatternConfig
from drake_nonstop.model.system import Model, PatternConfig, SystemParameters
from drake_nonstop.optimization.constraints import FEASIBILITY_TOLERANCE
from drake_nonstop.optimization.search_problem import SearchProblem
from drake_nonstop.optimization.update_data import UpdateData
from drake_nonstop.optimization.update_problem import UpdateProblem
from drake_nonstop.optimization.update_solver import UpdateSolver
from drake_nonstop.studies.files import replacing_file

# The instances are drawn from these ranges: uniformly, or from a pair by the logarithm.
RANGES: dict[str, float | tuple[float, float]] = {
    "tilt_rad": 0.3,  # roll and pitch of the load, either way
    "load_speed_m_s": 1.0,  # in any direction
    "angular_velocity_rad_s": 0.3,  # each component, either way, as all that follow
    "reference_acceleration_m_s2": 1.0,
    "position_error_m": 0.02,
    "velocity_error_m_s": 0.05,
    "torque_per_weight_m": 0.1,
    "force_rate_N_s": 2.0,
    "torque_rate_Nm_s": 0.3,
    "previous_frequency_rad_s": (0.5, 6.0),
    "previous_amplitude_per_share_of_weight": (0.1, 1.5),
    "speed_bound_m_s": (0.1, 20.0),
}

_ROUND_OFF = 1e-9  # of a margin; more would make a truth of nearly nothing cheaper
_GRID = (160, 120)  # frequencies and amplitudes of the grid of `truth`
_ZOOM = 41  # points a side
_STARTS = 4  # local minima of the grid on which the search zooms in
_AMPLITUDES = 200  # of the other search


def _regular(n: int) -> NDArray:
    angles = 2 * np.pi * np.arange(n) / n
    return np.column_stack([0.75 * np.cos(angles), 0.75 * np.sin(angles), np.zeros(n)])


def _spread_carousel(n: int, offset: float) -> LinearPatternConfig:
    """Each force turns in the plane, those of opposite attachments in opposition."""
    angles = 2 * np.pi * np.arange(n) / n
    cosine, sine, zero = np.cos(angles), np.sin(angles), np.zeros(n)
    columns = [np.column_stack(c).ravel() for c in ((cosine, -sine, zero), (sine, cosine, zero))]
    outward = offset * np.column_stack([cosine, sine, zero]).ravel()
    basis = np.column_stack(columns).tolist()
    return LinearPatternConfig(basis=basis, phases=[0.0, -np.pi / 2], offset=outward.tolist())


_SYSTEMS: dict[str, tuple[int, PatternConfig]] = {
    "cycle of 3": (3, HamiltonianCycleConfig()),
    "cycle of 4": (4, HamiltonianCycleConfig()),
    "cycle of 4, the paper's phases": (
        4,
        HamiltonianCycleConfig(phases=[0.0, np.pi / 2, 0.0, np.pi / 2]),
    ),
    "spread carousel of 4": (4, _spread_carousel(4, 2.0)),
    "carousel of 6": (6, _spread_carousel(6, 0.0)),
    "cycle of 8": (8, HamiltonianCycleConfig()),
}


@dataclass(frozen=True)
class Instance:
    """One update of a system."""

    system: str
    data: UpdateData


@dataclass(frozen=True)
class Truth:
    """The least cost of an instance, inf where no point is feasible, and the largest margin.

    The margin of what can be kept is that of the previous point.
    """

    cost: float
    margin: float


def make_solvers(**fields: object) -> dict[str, UpdateSolver]:
    """A solver for each system, with those fields of the optimizer's config changed."""
    solvers = {}
    for name, (n, pattern) in _SYSTEMS.items():
        model = Model(SystemParameters(attachments=_regular(n).tolist()), pattern)
        config = NonstopOptimizerConfig(**fields)  # type: ignore[arg-type]
        solvers[name] = UpdateSolver(model, config, lambda: "optimization_layer")
    return solvers


def draw_instances(count: int, seed: int, solvers: dict[str, UpdateSolver]) -> list[Instance]:
    """Instances from the ranges above for the solvers of `make_solvers`.

    The i-th depends on the seed and i alone.
    """
    return [_draw(np.random.default_rng([seed, i]), solvers) for i in range(count)]


def _draw(rng: np.random.Generator, solvers: dict[str, UpdateSolver]) -> Instance:
    name = str(rng.choice(list(_SYSTEMS)))
    system = SystemParameters()
    weight = gravity_wrench(system.load_mass, system.gravity)
    share = weight[5] / _SYSTEMS[name][0]

    def either_way(name: str, scale: float = 1.0) -> NDArray:
        size = RANGES[name]
        assert isinstance(size, float)
        return scale * rng.uniform(-size, size, 3)

    def by_logarithm(name: str) -> float:
        low, high = np.log(RANGES[name])
        return float(np.exp(rng.uniform(low, high)))

    tilt = either_way("tilt_rad")
    tilt[2] = rng.uniform(-np.pi, np.pi)
    direction = rng.normal(size=3)
    speed = rng.uniform(0, RANGES["load_speed_m_s"])
    velocity = speed * direction / np.linalg.norm(direction)
    omega = either_way("angular_velocity_rad_s")
    acceleration = either_way("reference_acceleration_m_s2")
    state = np.concatenate([roll_pitch_yaw_to_quaternion(tilt), np.zeros(3), omega, velocity])
    reference = np.concatenate([state, np.zeros(3), acceleration, np.zeros(3)])
    LoadReference.view(reference).position[:] += either_way("position_error_m")
    LoadReference.view(reference).velocity[:] += either_way("velocity_error_m_s")
    torque = either_way("torque_per_weight_m", weight[5])
    data = solvers[name].update_data(
        previous=np.array(
            [
                by_logarithm("previous_frequency_rad_s"),
                share * by_logarithm("previous_amplitude_per_share_of_weight"),
            ]
        ),
        phase=np.array([rng.uniform(0, 2 * np.pi), 0.0]),
        load_state=state,
        reference=reference,
        wrench=weight + np.concatenate([torque, system.load_mass * acceleration]),
        wrench_rate=np.concatenate([either_way("torque_rate_Nm_s"), either_way("force_rate_N_s")]),
        wrench_second_rate=np.zeros(6),
        speed_bound=by_logarithm("speed_bound_m_s"),
        updates=int(rng.integers(1000)),
    )
    return Instance(name, data)


def truths(
    instances: list[Instance],
    solvers: dict[str, UpdateSolver],
    progress: Callable[[int], None] | None = None,
) -> list[Truth]:
    """The true optima, from the cache where it holds these very problems."""
    path = _cache_path(instances, solvers)
    try:
        with np.load(path) as cached:
            return [Truth(*row) for row in cached["truths"].tolist()]
    except (OSError, KeyError, ValueError, zipfile.BadZipFile):
        pass
    found = []
    for i, instance in enumerate(instances):
        found.append(truth(solvers[instance.system].problem(instance.data)))
        if progress is not None:
            progress(i + 1)
    with contextlib.suppress(OSError):  # they are found again the next time
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing_file(path) as file:
            np.savez(file, truths=np.array([(t.cost, t.margin) for t in found]))
    return found


def _cache_path(instances: list[Instance], solvers: dict[str, UpdateSolver]) -> Path:
    """A file named after this module and the problems: their data, and values of both sides."""
    digest = hashlib.sha256(Path(__file__).read_bytes())
    for instance in instances:
        problem = solvers[instance.system].problem(instance.data)
        digest.update(problem.vector.tobytes())
        for factor in (0.7, 1.6):
            x = problem.previous * factor
            digest.update(np.array([problem.worst_margin(x), problem.cost(x)]).tobytes())
        digest.update(np.array(problem.bounds).tobytes())
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    if not os.path.isabs(home):  # nobody's home is known
        home = tempfile.gettempdir()
    return Path(home) / "drake_nonstop" / f"optimizer-truth-{digest.hexdigest()[:16]}.npz"


def truth(update: UpdateProblem) -> Truth:
    """The better of two searches that share the polynomials of the speeds with the solvers, only.

    They judge the solvers, so the cost of eq. 26 and the best ξ are written here once more, on
    purpose. For the speed bound alone, without other constraints or an anchor.
    One is a dense grid over ξ and A that zooms in on its best local minima, the other a
    dense grid over A alone with the best ξ for each from sorted ends of intervals.
    """
    if update.worst_margin(update.previous) >= -FEASIBILITY_TOLERANCE:
        return Truth(0.0, update.worst_margin(update.previous))
    problem = update.search_problem
    costs = [_cheapest_of_grid(problem), _cheapest_of_amplitudes(problem)]
    return Truth(min(costs), _largest_margin(problem))


def _grid(problem: SearchProblem, count: tuple[int, int]) -> tuple[NDArray, NDArray]:
    frequencies, amplitudes = (
        np.geomspace(low, high, k).clip(low, high)
        for low, high, k in zip(problem.lower, problem.upper, count, strict=True)
    )
    return frequencies, amplitudes


def _cost(problem: SearchProblem, frequencies: NDArray, amplitudes: NDArray) -> NDArray:
    """Eq. 26 over a grid, (amplitudes, frequencies), for an accumulated phase.

    Independent of `mechanics.nonstop.change_cost` on purpose, see `truth`.
    """
    xi, A = frequencies[None], amplitudes[:, None]
    xi_before, A_before = problem.previous
    cosines, sines = np.cos(problem.angles), np.sin(problem.angles)
    forces = ((A[..., None] - A_before) * cosines) ** 2
    rates = ((xi * A)[..., None] - xi_before * A_before) ** 2 * sines**2
    return (
        (xi - xi_before) ** 2
        + (A - A_before) ** 2
        + problem.internal_force_weight * forces.sum(axis=2)
        + problem.internal_force_rate_weight * rates.sum(axis=2)
    )


def _least_cells(values: NDArray) -> list[tuple[int, int]]:
    """The least local minima of a grid of values, `_STARTS` of them at most."""
    padded = np.pad(values, 1, constant_values=np.inf)
    around = [
        padded[1 + i : 1 + i + values.shape[0], 1 + j : 1 + j + values.shape[1]]
        for i in (-1, 0, 1)
        for j in (-1, 0, 1)
    ]
    is_least = np.isfinite(values) & (values <= np.min(around, axis=0))
    cells = np.argwhere(is_least)
    order = np.argsort(values[is_least], kind="stable")[:_STARTS]
    return [(int(i), int(j)) for i, j in cells[order]]


def _zoomed(
    problem: SearchProblem, objective: Callable[[NDArray, NDArray], NDArray], zooms: int
) -> float:
    """The least value of an objective over the bounds, (amplitudes, frequencies) each."""
    frequencies, amplitudes = _grid(problem, _GRID)
    best = np.inf
    for i, j in _least_cells(objective(frequencies, amplitudes)):
        x = np.array([frequencies[j], amplitudes[i]])
        size = x * [
            frequencies[1] / frequencies[0] - 1,
            amplitudes[1] / amplitudes[0] - 1,
        ]
        for _ in range(zooms):
            axes = np.linspace(x - size, x + size, _ZOOM).clip(problem.lower, problem.upper).T
            values = objective(*axes)
            row, column = np.unravel_index(np.argmin(values), values.shape)
            best = min(best, float(values[row, column]))
            x, size = np.array([axes[0][column], axes[1][row]]), size * 3 / _ZOOM
    return best


def _cheapest_of_grid(problem: SearchProblem) -> float:
    def objective(frequencies: NDArray, amplitudes: NDArray) -> NDArray:
        margins = problem.margins(amplitudes, frequencies)[0]
        costs = _cost(problem, frequencies, amplitudes)
        return np.where(margins >= -_ROUND_OFF, costs, np.inf)

    return _zoomed(problem, objective, zooms=4)


def _largest_margin(problem: SearchProblem) -> float:
    return -_zoomed(problem, lambda xi, A: -problem.margins(A, xi)[0], zooms=5)


def _cheapest_of_amplitudes(problem: SearchProblem) -> float:
    """The least cost over a grid of amplitudes that zooms in on its best local minima.

    For each amplitude all ends of the intervals of ξ that a speed forbids are tried.
    """
    low, high = problem.lower[1], problem.upper[1]
    amplitudes = np.geomspace(low, high, _AMPLITUDES).clip(low, high)
    costs = _best_costs(problem, amplitudes)
    best = float(np.min(costs))
    for _, i in _least_cells(costs[None]):
        centre, size = amplitudes[i], amplitudes[i] * (amplitudes[1] / amplitudes[0] - 1)
        for _ in range(4):
            around = np.linspace(centre - size, centre + size, _ZOOM).clip(low, high)
            values = _best_costs(problem, around)
            best = min(best, float(np.min(values)))
            centre, size = around[np.argmin(values)], size * 3 / _ZOOM
    return best


def _best_costs(problem: SearchProblem, amplitudes: NDArray) -> NDArray:
    """The least cost (k,) at each amplitude, inf where no ξ is feasible."""
    A = amplitudes[:, None]
    c, b, a, _ = speed_squares(
        polynomial_values(problem.polynomials[:, :, None], A),
        rest_length=problem.rest_length,
        compliance=problem.compliance,
    )
    root = np.sqrt(np.maximum(b * b - a * (c - problem.speed_bound**2), 0))
    cosines, sines = np.cos(problem.angles), np.sin(problem.angles)
    before = problem.previous[0] * problem.previous[1]
    weight = problem.internal_force_rate_weight * float(sines @ sines)
    wanted = (problem.previous[0] / A + weight * before) / (1 / A**2 + weight)
    s = np.concatenate([wanted, (-b - root) / a, (root - b) / a], axis=1)
    s = s.clip(A * problem.lower[0], A * problem.upper[0])
    squares = c[:, None] + s[:, :, None] * (2 * b[:, None] + s[:, :, None] * a[:, None])
    least = problem.speed_bound**2 * (1 - _ROUND_OFF)
    costs = (
        (s / A - problem.previous[0]) ** 2
        + (1 + problem.internal_force_weight * float(cosines @ cosines))
        * (A - problem.previous[1]) ** 2
        + weight * (s - before) ** 2
    )
    return np.where(squares.min(axis=2) >= least, costs, np.inf).min(axis=1)
