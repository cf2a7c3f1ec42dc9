"""`run` and `check NAME --set PATH=VALUE` with every path of every scenario.

A run is a flight of a few steps.
"""

from pathlib import Path

import numpy as np

from adversary.commands import Command, ended
from adversary.values import (
    BLOCKS,
    SPELLINGS,
    block_with_a_field,
    drawn_value,
    near_value,
    paths,
    resolved,
    scenario_name,
)
from adversary.verdicts import ACCEPTED, LOST_WORK, MISREAD, REFUSED, Case, Verdict

_LENGTHY = (
    "simulation_duration",
    "simulator_config.target_realtime_rate",
)  # whose values say how long it takes
_EVERY_BLOCK = [block for blocks in BLOCKS.values() for block in blocks]


def draw(rng: np.random.Generator) -> Case:
    name, count = scenario_name(rng), int(rng.choice([1, 1, 1, 2, 3]))
    overrides, expected = ["simulation_duration=0.02"], ""
    for _ in range(count):
        override, expected = _override(rng, name)
        overrides.append(override)
    if count > 1:
        expected = ""
    is_lengthy = any(override.startswith(_LENGTHY) for override in overrides[1:])
    is_seen = any(override.startswith("scene") for override in overrides)
    brief = ["--no-figures"] if is_seen else ["--no-figures", "--no-replay"]
    is_check = name.startswith("aircraft") and rng.random() < 0.3
    call = ["check", name] if is_check else ["run", name, *brief]
    arguments = [*call, "--out", "out", "--set", *overrides]
    shown = [a if len(a) < 400 else a[:200] + "…" for a in arguments]
    return Case(
        text=" ".join(shown),
        attempt=lambda folder: _attempt(folder, arguments, expected),
        limit=60 if is_lengthy else 40,
    )


def _override(rng: np.random.Generator, name: str) -> tuple[str, str]:
    """A change, and what has to become of it: "refused" where that is certain."""
    found = list(paths(resolved(name)))
    path, value = found[rng.integers(len(found))]
    form = rng.random()
    if path in _LENGTHY:
        values = ["0", "-1", "1e-9", "1e-3", "0.1", "1e12", "1e27", "1e300", ".inf", ".nan", "true"]
        return f"{path}={rng.choice([*values, *SPELLINGS][: 11 + 3])}", ""
    if form < 0.4:
        return f"{path}={near_value(rng, value)}", ""
    if form < 0.7:
        return f"{path}={drawn_value(rng)}", ""
    if form < 0.8:
        return "=".join(block_with_a_field(rng)), ""
    if form < 0.88:
        box = str(rng.choice(list(BLOCKS)))
        block = str(rng.choice(BLOCKS[box] if rng.random() < 0.6 else _EVERY_BLOCK))
        quoted = str(rng.choice(["{}", "!{} {{}}", "!{}", "'!{} {{}}'", "{}Config", "{} ", '"{}"']))
        return f"{box}={quoted.format(block)}", ""
    slip = [
        *(f"{path}s=1", f"{path}.x=1", f".{path}=1", f"{path}.=1", f"{path}..a=1", f"{path} =1"),
        *(f"={path}", path, "", "=", f"{path}=", f"{path}[0]=1", f"{path[:-1]}=1", f"{path}:1"),
        *(f"{path.upper()}=1", "_tag=1", "name=x", "phase._tag=!PaperPhase", "based_on=line"),
        *("__class__=1", f"{'a.' * 3000}b=1", f"{'x' * 100_000}=1", f"{path}\n=1", "simulated=1"),
    ]
    return str(rng.choice(slip)), "refused"


def _attempt(folder: Path, arguments: list[str], expected: str) -> Verdict:
    command = Command(arguments=arguments, folder=folder)
    verdict = ended(command, 20)
    if expected and verdict.ending != REFUSED:
        verdict.add(MISREAD, verdict.ending)
    results = "check.json" if arguments[0] == "check" else "metrics.json"
    has_results = (folder / "out" / results).exists()
    if verdict.ending == ACCEPTED and not has_results:
        verdict.add(LOST_WORK, "no results")
    if verdict.ending == REFUSED and (folder / "out").exists():
        verdict.add(LOST_WORK, "refused, but a folder is made")
    return verdict
