"""The figures that judge a run, as written to metrics.json."""

from collections.abc import Mapping
from importlib.metadata import version
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.rotation import rotation_matrix
from drake_nonstop.model.system import overridden
from drake_nonstop.simulation.simulate import Run
from drake_nonstop.version import __version__


def compute_metrics(run: Run) -> dict[str, Any]:
    """The metrics of a run; keys end in their units.

    Speeds, separations, tensions and loads on the aircraft are those of the simulated
    carriers and cables at every step from t = 0 on, errors those of the load's true pose
    at 100 Hz. A time "below" or "slack" weighs each step's state with half of the two
    intervals beside it. The climb angle is that of the steepest climb or descent; it and
    the turn radius say little where a carrier nearly stops. What was not measured, such as
    the solve times of a layer that solves nothing, is None.
    """
    simulated = float(run.steps["time"][-1])
    return {
        "scenario": run.scenario.name,
        "is_steered": run.is_steered,
        "simulated_s": simulated,
        "wall_s": run.wall_time,
        "real_time_factor": simulated / run.wall_time,
        "load": _load_metrics(run),
        "carriers": _carrier_metrics(run),
        "cables": _cable_metrics(run),
        "optimizer": _optimizer_metrics(run),
        "versions": {
            "drake_nonstop": __version__,
            "drake": version("drake"),
            "numpy": version("numpy"),
        },
    }


def flattened(metrics: Mapping[str, Any]) -> dict[str, Any]:
    """The metrics that are one value, by their paths, such as "load.position_error_mean_m"."""
    flat: dict[str, Any] = {}
    for key, value in metrics.items():
        if isinstance(value, Mapping):
            flat |= {f"{key}.{path}": inner for path, inner in flattened(value).items()}
        elif not isinstance(value, list):
            flat[key] = value
    return flat


def is_wall_time(path: str) -> bool:
    """Whether the metric of that path was measured with a clock, and differs from run to run."""
    return path in ("wall_s", "real_time_factor") or path.startswith("optimizer.solve_time_ms.")


def load_errors(run: Run) -> tuple[NDArray, NDArray]:
    """Position (m) and orientation (rad) errors of the load, (samples, 3) each.

    The orientation error is the rotation vector from the reference to the load, in L; its
    norm is the angle between the two.
    """
    state, reference = run.signal("load_state"), run.signal("reference")
    a, b = (q / np.linalg.norm(q, axis=1, keepdims=True) for q in (reference[:, :4], state[:, :4]))
    scalar = (a * b).sum(axis=1, keepdims=True)
    vector = a[:, :1] * b[:, 1:] - b[:, :1] * a[:, 1:] - np.cross(a[:, 1:], b[:, 1:])
    vector = np.where(scalar < 0, -vector, vector)
    sine = np.linalg.norm(vector, axis=1, keepdims=True)
    angle_per_sine = 2 * np.arctan2(sine, np.abs(scalar)) / np.maximum(sine, 1e-300)
    rotation = vector * np.where(sine > 0, angle_per_sine, 2.0)
    return state[:, 4:7] - reference[:, 4:7], rotation


def carrier_speeds(carrier_state: NDArray) -> NDArray:
    """Speeds (k, n) in m/s of carrier states (k, 6n)."""
    return np.linalg.norm(_split(carrier_state)[1], axis=2)


def closest_carriers(positions: NDArray) -> NDArray:
    """The distance (k,) of the closest two of carriers at `positions` (k, n, 3), m."""
    return np.min(
        [
            np.linalg.norm(positions[:, i] - positions[:, j], axis=1)
            for i, j in combinations(range(positions.shape[1]), 2)
        ],
        axis=0,
    )


def closest_cables(ends: NDArray, carriers: NDArray) -> NDArray:
    """The distance (k,) of the closest two straight cables from `ends` to `carriers`, m.

    Both (k, n, 3).
    """
    return np.min(
        [
            segment_distances(ends[:, i], carriers[:, i], ends[:, j], carriers[:, j])
            for i, j in combinations(range(ends.shape[1]), 2)
        ],
        axis=0,
    )


def segment_distances(a: NDArray, b: NDArray, c: NDArray, d: NDArray) -> NDArray:
    """Distances (k,) between the segments from a to b and from c to d, (k, 3) each.

    The nearest points of the two lines are clamped to the segments, one after the other
    (C. Ericson, Real-Time Collision Detection, section 5.1.9).
    """
    u, v, w = b - a, d - c, a - c
    uu, vv, uv = (u * u).sum(axis=1), (v * v).sum(axis=1), (u * v).sum(axis=1)
    uw, vw = (u * w).sum(axis=1), (v * w).sum(axis=1)
    tiny = np.finfo(float).tiny
    determinant = uu * vv - uv * uv
    parallel = determinant <= 1e-12 * uu * vv
    on_first = np.where(parallel, 0.0, uv * vw - vv * uw) / np.where(parallel, 1.0, determinant)
    on_first = on_first.clip(0, 1)
    on_second = ((uv * on_first + vw) / (vv + tiny)).clip(0, 1)
    on_first = ((uv * on_second - uw) / (uu + tiny)).clip(0, 1)
    gap = w + on_first[:, None] * u - on_second[:, None] * v
    return np.linalg.norm(gap, axis=1)


def _load_metrics(run: Run) -> dict[str, float]:
    position, orientation = (np.linalg.norm(error, axis=1) for error in load_errors(run))
    return {
        "position_error_mean_m": float(np.mean(position)),
        "position_error_max_m": float(np.max(position)),
        "position_error_final_m": float(position[-1]),
        "orientation_error_mean_rad": float(np.mean(orientation)),
        "orientation_error_max_rad": float(np.max(orientation)),
    }


def _carrier_metrics(run: Run) -> dict[str, Any]:
    time, states = run.steps["time"], run.steps["carrier_state"]
    positions, velocities = _split(states)
    speeds = carrier_speeds(states)
    bounds = speed_bounds(run)
    normal_acceleration, turn_radius = _sharpest_turn(time, velocities)
    climb = np.arctan2(np.abs(velocities[..., 2]), np.linalg.norm(velocities[..., :2], axis=2))
    return {
        "n": speeds.shape[1],
        "speed_min_m_s": float(np.min(speeds)),
        "speed_max_m_s": float(np.max(speeds)),
        "speed_final_m_s": speeds[-1].tolist(),
        "speed_bound_m_s": float(bounds[-1]),
        "time_below_bound_s": _duration(time, np.any(speeds < bounds[:, None], axis=1)),
        "separation_min_m": float(np.min(closest_carriers(positions))),
        "normal_acceleration_max_m_s2": normal_acceleration,
        "climb_angle_max_rad": float(np.max(climb)),
        "turn_radius_min_m": turn_radius,
    }


def _sharpest_turn(time: NDArray, velocities: NDArray) -> tuple[float | None, float | None]:
    """The largest normal acceleration (m/s²) and smallest turn radius (m); None: not measured."""
    # Where an update or a sample ends a step, another may be a rounding error away.
    apart = np.append(True, np.diff(time) > 1e-9)
    time, velocities = time[apart], velocities[apart]
    speeds = np.linalg.norm(velocities, axis=2)
    if len(time) < 3 or not np.any(speeds > 0):
        return None, None
    accelerations = np.gradient(velocities, time, axis=0)
    # v × a is speed × normal acceleration, and stays defined where a carrier stops.
    crossed = np.linalg.norm(np.cross(velocities, accelerations), axis=2)
    moving = speeds > 0
    return (
        float(np.max(crossed[moving] / speeds[moving])),
        _reciprocal(float(np.max(crossed[moving] / speeds[moving] ** 3))),
    )


def _cable_metrics(run: Run) -> dict[str, Any]:
    time, tensions = run.steps["time"], run.steps["tensions"]
    carriers, _ = _split(run.steps["carrier_state"])
    ends = attachment_positions(run, run.steps["load_state"])
    return {
        "tension_min_N": float(np.min(tensions)),
        "tension_max_N": float(np.max(tensions)),
        "slack_time_s": _duration(time, np.any(tensions <= 0, axis=1)),
        "separation_min_m": float(np.min(closest_cables(ends, carriers))),
    }


def _optimizer_metrics(run: Run) -> dict[str, Any]:
    counts = np.zeros(5)
    if "diagnostics" in run.steps:
        counts = run.steps["diagnostics"][-1, 1:6]
    quantiles: list[float | None] = [None] * 3
    if len(run.solve_times):
        quantiles = (1e3 * np.quantile(run.solve_times, [0.5, 0.99, 1.0])).tolist()
    frequency, amplitude = run.signal("parameters")[-1]
    names = ("updates", "kept", "solved", "relaxed", "held")
    return {
        **{name: int(count) for name, count in zip(names, counts, strict=True)},
        "solve_time_ms": dict(zip(("p50", "p99", "max"), quantiles, strict=True)),
        "xi_final_rad_s": float(frequency),
        "A_final_N": float(amplitude),
    }


def speed_bounds(run: Run) -> NDArray:
    """The ε (m/s) that was asked for at every step (steps,); it may change during a live run."""
    if "speed_bound" in run.steps:
        return run.steps["speed_bound"][:, 0]
    return np.full(len(run.steps["time"]), run.scenario.speed_bound)


def attachment_positions(run: Run, load_states: NDArray) -> NDArray:
    """The simulated attachment points (k, n, 3), in W, for load states (k, 13)."""
    system = overridden(run.scenario.system, run.scenario.simulated)
    R_WL = rotation_matrix(load_states[:, :4])
    return load_states[:, None, 4:7] + np.array(system.attachments) @ R_WL.swapaxes(1, 2)


def _reciprocal(curvature: float) -> float | None:
    """The radius of a curvature; None for straight flight."""
    return 1 / curvature if curvature > 0 else None


def _split(carrier_state: NDArray) -> NDArray:
    """Positions and velocities (2, k, n, 3) of carrier states (k, 6n)."""
    return carrier_state.reshape(len(carrier_state), 2, -1, 3).swapaxes(0, 1)


def _duration(time: NDArray, condition: NDArray) -> float:
    """For how long (s) the condition holds, each instant standing for half its two intervals."""
    if len(time) < 2:
        return 0.0
    intervals = np.diff(time)
    weights = np.concatenate([intervals, [0.0]]) + np.concatenate([[0.0], intervals])
    return float(np.sum(weights[condition]) / 2)
