"""Requests for `design` drawn at random, each from a seed.

`python tests/drawn_designs.py FIRST COUNT --journal FILE` designs for the seeds, flies what is
found, and looks beside what is refused. Interrupted, the same command goes on from there.
"""

import argparse
import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from drake_nonstop import compute_metrics, simulate
from drake_nonstop.planning.formation_program import (
    KINDS,
    FormationProgram,
    FormationVariables,
)
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.studies.design_request import DesignRequest, read_request
from drake_nonstop.studies.designed_formation import (
    DesignedFormation,
    Refusal,
    design_task,
    flight_of,
    reserve_of,
)
from drake_nonstop.studies.formation_search import design_one

LARGE_BANK = math.radians(20)

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
    kind = rng.choice(KINDS)
    return [f"carriers=[{rng.integers(3, 7)}]", f"kinds=[{kind}]", "starts=1", *odd]


def flown_beside_printed(formation: DesignedFormation) -> dict[str, Any]:
    """The outcome of a flight, and each extreme as flown and as printed."""
    flown, printed = fly(formation.scenario), formation.flight
    return {
        "outcome": flown["outcome"],
        "saturated": flown["saturated"],
        "error": flown["error"],
        "C_L": (flown["C_L"], printed.ranges.lift_share[1]),
        "bank": (flown["bank"], printed.bank),
        "thrust_min": (flown["thrust_min"], printed.ranges.thrust[0]),
        "thrust_max": (flown["thrust_max"], printed.ranges.thrust[1]),
        "apart": (flown["apart"], formation.distances[0]),
    }


def fly(scenario: Scenario) -> dict[str, Any]:
    """What a flight needed of its aircraft."""
    metrics = compute_metrics(simulate(scenario))
    flown = metrics["aircraft"]
    return {
        "outcome": metrics["outcome"],
        "saturated": flown["saturated_share"],
        "error": metrics["load"]["position_error_max_m"],
        "C_L": flown["lift_share_max"],
        "bank": flown["bank_max_rad"],
        "thrust_min": flown["thrust_min_N"],
        "thrust_max": flown["thrust_max_N"],
        "apart": metrics["carriers"]["separation_min_m"],
    }


def beyond(flown: dict[str, Any]) -> dict[str, float]:
    """How far each extreme is beyond the printed one; negative where it is within.

    Of C_L and thrust as shares of the printed one, the thrust's of its largest; bank in rad, over
    that of a bank that is larger than 20 degrees as its share.
    """
    (lift, c), (bank, b), (least, t_min), (most, t_max) = (
        flown[name] for name in ("C_L", "bank", "thrust_min", "thrust_max")
    )
    size = max(abs(t_min), abs(t_max))
    return {
        "C_L": lift / c - 1,
        "bank": (bank - b) / max(b, LARGE_BANK),
        "thrust_min": (t_min - least) / size,
        "thrust_max": (most - t_max) / size,
    }


def neighbours_that_fly(
    request: DesignRequest, refusal: Refusal, count: int, share: float = 0.05
) -> tuple[float, int]:
    """The largest reserve of formations beside a refusal's best, and how many keep all margins.

    Its forces, rate and cables are changed by up to the share, each by its own, within the
    request's cables. Their margins are those of the exact inverse at all instants of the way.

    Args:
        request: what is refused.
        refusal: of one kind.
        count: of formations.
        share: 0.05: 5 %.
    """
    rng = np.random.default_rng([2021, count])
    motions = design_task(request, refusal.carriers)
    resting = motions.with_motions(1)
    program = FormationProgram(motions, refusal.kind, refusal.phase_turns)
    best, kept = -math.inf, 0
    own = np.array(refusal.variables)
    for _ in range(count):
        values = own.copy()
        values[:6] *= 1 + rng.uniform(-share, share, 6)
        values[5] = np.clip(values[5], *request.cable_length)
        if refusal.carriers == 3:
            values[2] = values[1]
        x = FormationVariables(*map(float, values))
        reserve = math.inf
        least = min(best, 0.999)  # below, one more is not looked at any further
        for task in (resting, motions):
            if reserve > least:
                needed = flight_of(task, refusal.kind, x, phases=24)
                reserve = min(reserve, reserve_of(task, needed))
        if reserve > least:
            reserve = min(reserve, float(program.rows(values)[0].min()))
        best = max(best, reserve)
        kept += reserve >= 1
    return best, kept


def main() -> None:
    """Designs and flies what the journal does not have yet; then looks beside what is refused."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("first", type=int)
    parser.add_argument("count", type=int)
    parser.add_argument("--journal", type=Path, required=True)
    parser.add_argument("--neighbours", type=int, default=2000, help="of each refused kind")
    parser.add_argument("--refused", type=int, default=10, help="requests that are looked beside")
    given = parser.parse_args()
    seeds = range(given.first, given.first + given.count)
    rows = _read(given.journal)
    with given.journal.open("a") as file:

        def record(row: dict[str, Any]) -> None:
            rows.append(row)
            file.write(json.dumps(row) + "\n")
            file.flush()

        for seed in seeds:
            for kind in KINDS:
                if not any((r["seed"], r["kind"]) == (seed, kind) for r in rows):
                    record(_of_one(seed, kind))
        refused = [r for r in rows if r["refusal"] and r["seed"] in seeds]
        for seed in sorted({row["seed"] for row in refused})[: given.refused]:
            for row in [row for row in refused if row["seed"] == seed and "beside" not in row]:
                refusal = Refusal(**row["refusal"])
                refusal = dataclasses.replace(
                    refusal, variables=FormationVariables(*refusal.variables)
                )
                if refusal.reserve < 1:
                    row["beside"] = neighbours_that_fly(draw(seed), refusal, given.neighbours)
                    file.write(json.dumps(row) + "\n")
                    file.flush()
    print(summary([row for row in rows if row["seed"] in seeds]))


def _read(journal: Path) -> list[dict[str, Any]]:
    """The rows, each the last of its seed and kind."""
    rows = {}
    if journal.exists():
        for line in journal.read_text().splitlines():
            row = json.loads(line)
            rows[row["seed"], row["kind"]] = row
    return list(rows.values())


def _of_one(seed: int, kind: str) -> dict[str, Any]:
    """Of a seed and a kind: the flights of what is found, or the refusal."""
    request = draw(seed)
    (carriers,) = request.carriers
    row: dict[str, Any] = {"seed": seed, "kind": kind, "refusal": None, "flights": []}
    for item in design_one(request, carriers, kind):
        if isinstance(item, DesignedFormation):
            about = {"length": item.variables.cable_length, "reserve": item.reserve}
            row["flights"].append({**about, **flown_beside_printed(item)})
        else:
            row["refusal"] = vars(item)
    return row


def summary(rows: list[dict[str, Any]]) -> str:
    """What was flown and refused, and the farthest that an extreme is beyond the printed one."""
    flights = [(row, flown) for row in rows for flown in row["flights"]]
    lines = [
        f"{len({row['seed'] for row in rows})} requests, {len(rows)} kinds: "
        f"{len(flights)} formations of {sum(bool(row['flights']) for row in rows)} kinds, "
        f"{sum(bool(row['refusal']) for row in rows)} kinds refused",
    ]
    within = 0
    for row, flown in flights:
        off = beyond(flown)
        is_within = flown["outcome"] == "ok" and max(off.values()) <= 0.02
        within += is_within
        if not is_within:
            words = [f"{name} {value:+.1%}" for name, value in off.items()]
            about = f"seed {row['seed']} {row['kind']} cables {flown['length']:.0f} m"
            lines.append(f"  {about}: {flown['outcome']}, {', '.join(words)}")
    lines.append(f"{within} of {len(flights)} flights are within what was printed, to 2 %")
    if flights:
        found = [beyond(flown) for _, flown in flights]
        for name in found[0]:
            values = [off[name] for off in found]
            lines.append(f"{name} beyond the printed: {min(values):+.2%} to {max(values):+.2%}")
    for row in rows:
        if "beside" in row:
            best, kept = row["beside"]
            own = row["refusal"]["reserve"]
            about = f"seed {row['seed']} {row['kind']}: reserve {own:.3f}, beside it {best:.3f}"
            lines.append(f"{about}, {kept} keep the margins")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
