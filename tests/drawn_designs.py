"""Requests for `design` drawn at random, each from a seed.

As a script: what is found for seeds, flown. `python tests/drawn_designs.py FIRST COUNT [--fly]`.
"""

import dataclasses
import math
import sys

import numpy as np

from drake_nonstop import compute_metrics, simulate
from drake_nonstop.optimization.formation_program import KINDS
from drake_nonstop.studies.design import DesignedFormation, design_one
from drake_nonstop.studies.design_request import DesignRequest, dump_request, read_request

# Of the aircraft, what suits their size: attachments' radius, drag, cables and separation.
SIZES = {
    "rascal_110": ["load_radius=1.5", "load_drag=0.6", "separation=10.0"],
    "ultrastick_25e": [
        *("load_radius=0.75", "load_drag=0.2", "separation=6.0"),
        *("cable_stiffness=40.0", "cable_damping=0.7", "aircraft.cable_diameter=0.0005"),
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
    azimuth, heading = rng.uniform(0, 2 * math.pi, 2)
    speed = round(rng.uniform(0.5, 1.5), 2)

    def along(size: float, angle: float) -> str:
        return str(np.round([size * math.cos(angle), size * math.sin(angle), 0.0], 3).tolist())

    changes = [
        f"aircraft.model={name}",
        f"name=drawn_{seed}",
        f"carriers=[{rng.integers(3, 9)}]",
        f"load_mass={mass}",
        f"cable_length={lengths}",
        f"wind={along(wind, azimuth)}",
        f"displacement={along(50.0, heading)}",
        f"speed={speed}",
        *SIZES[name],
    ]
    return read_request(None, changes)


def found_for(request: DesignRequest) -> list:
    """Formations and refusals of both kinds."""
    (carriers,) = request.carriers
    text = dump_request(request)
    return [item for kind in KINDS for item in design_one(text, carriers, kind)]


def flown_beside_printed(formation: DesignedFormation) -> tuple[str, dict[str, tuple]]:
    """The outcome of a flight, and each extreme as flown and as printed."""
    metrics = compute_metrics(simulate(formation.scenario))
    flown, printed = metrics["aircraft"], formation.flight
    return metrics["outcome"], {
        "C_L": (flown["lift_share_max"], printed.lift_share),
        "bank": (flown["bank_max_rad"], printed.bank),
        "thrust_min": (flown["thrust_min_N"], printed.thrust_min),
        "thrust_max": (flown["thrust_max_N"], printed.thrust_max),
        "apart": (metrics["carriers"]["separation_min_m"], formation.distances[0]),
        "error": (metrics["load"]["position_error_max_m"], 0.0),
    }


def main(first: int, count: int, flies: bool) -> None:
    """Prints a line for each formation or refusal of the seeds."""
    for seed in range(first, first + count):
        request = draw(seed)
        about = f"{seed} {request.aircraft_name} {request.carriers} {request.load_mass} kg"
        about += f" wind {np.linalg.norm(request.wind):.1f} cables {request.cable_length}"
        for item in found_for(request):
            if not isinstance(item, DesignedFormation):
                print(about, *dataclasses.astuple(item), flush=True)
                continue
            x = item.variables
            about_it = f"{item.kind} L {x.cable_length:.0f} reserve {x.reserve:.2f}"
            print(about, about_it, f"{item.power:.0f} W", flush=True)
            if flies:
                outcome, pairs = flown_beside_printed(item)
                words = [f"{name} {a:.3f}/{b:.3f}" for name, (a, b) in pairs.items()]
                print("   ", outcome, *words, flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), "--fly" in sys.argv)
