"""Requests for `design` drawn at random, each from a seed.

`python tests/drawn_designs.py FIRST COUNT` designs for the seeds, and flies what is found.
"""

import math
import sys
from typing import Any

import numpy as np

from drake_nonstop import DesignRequest, compute_metrics, design, read_request, simulate

# Of the aircraft, what suits their size: attachments' radius, drag, cables and separation.
SIZES = {
    "rascal_110": ["load_radius=1.5", "load_drag=0.6", "separation=10.0"],
    "ultrastick_25e": [
        *("load_radius=0.75", "load_drag=0.2", "separation=6.0"),
        *("cable_stiffness=40.0", "cable_damping=0.7", "cable_diameter=0.0005"),
    ],
}


def draw(seed: int) -> DesignRequest:
    """The request of a seed: 2 to 20 kg, one number of carriers from 3 to 8, either class.

    Wind of up to 6 m/s from anywhere, cables between two of 20 to 300 m, and a way of 50 m in any
    horizontal direction at up to 1.5 m/s.
    """
    rng = np.random.default_rng([2020, seed])
    name = str(rng.choice(sorted(SIZES)))
    mass, wind = round(rng.uniform(2.0, 20.0), 2), rng.uniform(0.0, 6.0)
    lengths = sorted(np.exp(rng.uniform(math.log(20.0), math.log(300.0), 2)).round(1).tolist())
    angles = rng.uniform(0, 2 * math.pi, 2)
    ways = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(2)])
    blows, moves = (np.array([[wind], [50.0]]) * ways).round(3).tolist()
    changes = [
        *(f"aircraft.model={name}", f"name=drawn_{seed}", f"load_mass={mass}"),
        *(f"carriers=[{rng.integers(3, 9)}]", f"cable_length={lengths}", f"wind={blows}"),
        *(f"displacement={moves}", f"speed={round(rng.uniform(0.5, 1.5), 2)}"),
    ]
    return read_request(None, [*changes, *SIZES[name]])


_ODD = {
    "load_mass": ["0", "-1", "1e-4", "0.01", "1e4", "1e9", ".nan", ".inf"],
    "load_radius": ["0", "1e-4", "0.01", "900", "1e4", ".nan"],
    "load_drag": ["-1", "0", "1e3", "1e9", ".nan"],
    "cable_length": ["[1, 1]", "[5000, 5000]", "[1, 5000]", "[200, 60]", "[0, 1]", "[.nan, 60]"],
    "cable_stiffness": ["0", "1e-3", "0.1", "1e6", "1e9", "-1"],
    "cable_damping": ["-1", "0", "1e5", "1e9"],
    "wind": ["[0, 0, 3]", "[0, 0, -3]", "[-15, 0, 0]", "[90, 0, 0]", "[0, 1e9, 0]", "[.nan, 0, 0]"],
    "displacement": ["[0, 0, 50]", "[0, 0, -1]", "[0, 0, 0]", "[1e-6, 0, 0]", "[1e9, 0, 0]"],
    "speed": ["0", "-1", "1e-9", "30", "1e9", ".nan"],
    "separation": ["0", "1e-6", "100", "1e9", ".nan"],
    "lift_share": ["0", "1e-9", "0.899", "0.9", ".nan"],
    "speed_share": ["1.2", "1.2001", "10", ".inf"],
    "bank": ["0", "1e-9", "0.87", ".nan"],
    "climb": ["1e-9", "0.52", "1"],
    "thrust_reserve": ["0", "1e-9", "0.499", "0.5"],
    "aircraft.mass": ["0", "1e-3", "1e3", ".nan"],
    "cable_diameter": ["0", "1e-9", "0.1", "10"],
    "aircraft.max_thrust": ["[0, 0, 0]", "[1, 0, 0]", "[1e9, 0, 0]", "[-1, 0, 0]"],
    "load_inertia": ["[[0, 0, 0], [0, 0, 0], [0, 0, 0]]", "[[1, 0, 0], [0, 1, 0], [0, 0, 9]]"],
}


def draw_odd(seed: int) -> list[str]:
    """Changes of a request of which one to three are zero, huge, tiny, negative or no number."""
    rng = np.random.default_rng([3434, seed])
    names = rng.choice(list(_ODD), size=int(rng.integers(1, 4)), replace=False)
    odd = [f"{name}={rng.choice(_ODD[name])}" for name in names]
    kind = rng.choice(DesignRequest().kinds)
    return [f"carriers=[{rng.integers(3, 7)}]", f"kinds=[{kind}]", "starts=1", *odd]


def beyond(formation: Any, metrics: dict[str, Any]) -> dict[str, float]:
    """How far each extreme of a flight is beyond the printed one; negative where it is within.

    Of C_L as a share of the printed one, and of thrust of the largest.
    """
    flown, (least, most) = metrics["aircraft"], formation.extremes["thrust_N"]
    return {
        "C_L": flown["lift_share_max"] / formation.extremes["lift"][1] - 1,
        "thrust_min": (least - flown["thrust_min_N"]) / most,
        "thrust_max": (flown["thrust_max_N"] - most) / most,
    }


def main(first: int, count: int) -> None:
    """Prints what is found for each seed, and how it flies."""
    for seed in range(first, first + count):
        found = design(draw(seed))
        print(found)
        for formation in found.formations:
            metrics = compute_metrics(simulate(formation.scenario))
            words = [f"{name} {value:+.1%}" for name, value in beyond(formation, metrics).items()]
            print(f"{formation.scenario.name}: {metrics['outcome']}, {', '.join(words)}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
