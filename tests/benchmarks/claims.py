"""Claims: the numbers that the README prints, measured again.

A claim is a row of a table with four columns: the arguments of `drake-nonstop run` that
measure it, the quantity, the paper's value, and ours: a number, a range "a–b" or a limit "≤ a".
Where the arguments begin with `stability`, the loop is linearized as that command does; where they
begin with `bench`, that benchmark measures it (`speed_claims`).

The numbers of a paragraph are claims, too, by rows in a comment below it that begins with
`<!-- measured`; each of these numbers has to stand in the paragraph.

What the integrator's step does not resolve holds for no number, unless the claim is of that step:
its arguments state it, or the scenario is one of the paper's, which are given at their step.
"""

import dataclasses
import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.speed_claims import (
    BENCH,
    FACTOR,
    is_exact,
    measure_benchmark,
    quantities_of,
)
from drake_nonstop.mechanics.signals import LoadReference
from drake_nonstop.run.metrics import METRICS, Metric, compute_metrics
from drake_nonstop.run.run import Run
from drake_nonstop.run.run_quantities import carrier_speeds, load_errors
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.studies.run_all import COMPLETED, Progress, attempts, no_progress, run_all
from drake_nonstop.studies.stability import Stability, linearize
from drake_nonstop.validation import ScenarioError, read_text, require

Metrics = dict[str, Any]

_PRINTED = r"(?:≤ )?\d+(?:\.\d+)?(?:–\d+(?:\.\d+)?)?"
_ROW = re.compile(rf"^\| `([^`]+)` \| ([^|]+) \|[^|]*\| ({_PRINTED}) \|$")
_NUMBER = re.compile(r"\d+(?:\.\d+)?")
_START, _END = "<!-- measured", "-->"  # of the rows of a paragraph
_LINEARIZED = "stability"  # the first argument of a claim on the linearized loop
_AT_THEIR_STEP = "paper_"  # how the scenarios begin whose results are those at their step
_STEP = "simulator_config.max_step_size="  # an argument that states it


@dataclass(frozen=True, kw_only=True)
class Claim:
    """What a text prints: the run that measures it, the quantity, and the number's digits."""

    arguments: str
    quantity: str
    printed: str
    is_in_table: bool = True  # or in a paragraph

    @property
    def is_of_speed(self) -> bool:
        """Whether a benchmark measures it, alone on the machine."""
        return self.arguments.split(" ")[0] == BENCH

    @property
    def is_of_a_step(self) -> bool:
        """Whether the number is that at a stated step, resolved or not."""
        is_stated = any(word.startswith(_STEP) for word in shlex.split(self.arguments))
        return is_stated or self.arguments.startswith(_AT_THEIR_STEP)

    def fault(self, measured: "Measured") -> str:
        """Why the claim does not hold, such as "= 0.3, not 0.2"; "" where it does."""
        if not self.holds(measured.value):
            return f"= {measured.value:.4g}, not {self.printed}"
        if not (measured.is_resolved or self.is_of_a_step):
            return f"= {measured.value:.4g} is not resolved by its step"
        return ""

    def holds(self, value: float) -> bool:
        """Whether the value rounds to what is printed; a bare 0 stands for exactly zero."""
        if self.is_of_speed and not is_exact(self.quantity):
            return 1 / FACTOR <= value / float(self.printed) <= FACTOR
        if self.printed == "0":
            return value == 0
        low, _, high = self.printed.removeprefix("≤ ").partition("–")
        digits = len(low.partition(".")[2])
        rounding = 0.55 * 10**-digits
        if self.printed.startswith("≤"):
            return value <= float(low) + rounding
        return float(low) - rounding <= value <= float(high or low) + rounding


@dataclass(frozen=True, kw_only=True)
class Measured:
    """The value of a claim's quantity, and whether the integrator's step resolves it."""

    value: float
    is_resolved: bool = True


def documentation(readme: Path) -> str:
    """The text of a README and of the pages in the folder `docs` beside it.

    Raises:
        ScenarioError: it cannot be read.
    """
    text = read_text(readme, "--readme", "run it in a checkout, or give the file")
    pages = sorted((readme.parent / "docs").glob("*.md"))
    return "\n".join([text, *(page.read_text(encoding="utf-8") for page in pages)])


def read_claims(text: str) -> list[Claim]:
    """The claims of a text in Markdown.

    Raises:
        ScenarioError: there are none, one is of an unknown quantity, or one on a paragraph is of
            a number that does not stand there.
    """
    claims = []
    paragraph, is_in_table = "", True
    for line in text.splitlines():
        found = _ROW.match(line)
        if line in (_START, _END):
            is_in_table = line == _END
        elif found:
            arguments, quantity, printed = found.groups()
            missing = set(_NUMBER.findall(printed)) - set(_NUMBER.findall(paragraph)) - {"0"}
            remedy = "print in the paragraph above what its comment claims"
            require(is_in_table or not missing, f"claim on {arguments}", printed, remedy)
            claims.append(
                Claim(
                    arguments=arguments,
                    quantity=quantity,
                    printed=printed,
                    is_in_table=is_in_table,
                )
            )
        elif line.startswith("| `") and line.count("|") == 5:
            remedy = "give a row of `run` | quantity | paper | ours, with ours a number"
            require(False, "claim", line, remedy)
        else:
            is_same = line and not line.startswith("- ")
            paragraph = f"{paragraph} {line}" if is_same else line
    require(claims, "--readme", "a text without claims", "give the README of drake_nonstop")
    for claim in claims:
        known: Any = QUANTITIES
        if claim.is_of_speed:
            known = quantities_of(claim.arguments)
        elif _is_linearized(claim.arguments):
            known = LOOP_QUANTITIES
        require(
            claim.quantity in known,
            f"claim on {claim.arguments}",
            claim.quantity,
            f"give one of {', '.join(known)}",
        )
    return claims


def measure(claims: Sequence[Claim], progress: Progress = no_progress) -> dict[Claim, Measured]:
    """The value of each claim: from a run per arguments, in a process per core, or a benchmark.

    Raises:
        ScenarioError: a claim's arguments make no scenario, its run did not complete, or its
            quantity was not measured in that run.
    """
    quantities: dict[str, list[str]] = {}
    for claim in claims:
        if not claim.is_of_speed:
            quantities.setdefault(claim.arguments, []).append(claim.quantity)
    values: dict[str, dict[str, Measured]] = {}

    def failed(arguments: str, error: str) -> dict[str, Measured]:
        raise ScenarioError(f"claim on {arguments} = {error}")

    run_all(
        _values,
        list(quantities),
        lambda arguments: (arguments, quantities[arguments]),
        values.__setitem__,
        failed,
        progress=progress,
    )
    for arguments in dict.fromkeys(claim.arguments for claim in claims if claim.is_of_speed):
        results = measure_benchmark(arguments, progress)
        found = {name: value(results) for name, value in quantities_of(arguments).items()}
        values[arguments] = _all_measured(
            arguments,
            {
                claim.quantity: found[claim.quantity]
                for claim in claims
                if claim.arguments == arguments
            },
        )
    return {claim: values[claim.arguments][claim.quantity] for claim in claims}


def failing_evals(folder: Path) -> list[str]:
    """The failures of tests/evals, which measure the other claims, in the folder of a checkout."""
    command = [sys.executable, "-m", "pytest", "-q", "tests/evals", "-m", ""]  # nightly ones, too
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode == 0:
        return []
    lines = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return lines or [f"tests/evals: {(done.stderr or done.stdout).strip()[-300:]}"]


def wrong_claims(values: dict[Claim, Measured]) -> list[str]:
    """The claims that do not hold, a sentence each."""
    return [
        f"{claim.arguments}: {claim.quantity} {fault}"
        for claim, measured in values.items()
        if (fault := claim.fault(measured))
    ]


def as_markdown(values: dict[Claim, Measured]) -> str:
    """A table of the claims and what was measured."""
    lines = ["| run | quantity | printed | measured | |", "| --- | --- | --- | --- | --- |"]
    for claim, measured in values.items():
        holds = "**fails**" if claim.fault(measured) else "holds"
        cells = (
            f"`{claim.arguments}`",
            claim.quantity,
            claim.printed,
            f"{measured.value:.4g}",
            holds,
        )
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def report_text(values: dict[Claim, Measured], failures: Sequence[str]) -> str:
    """The report in Markdown.

    Args:
        values: of the claims.
        failures: a sentence for each claim that does not hold, of whatever kind.
    """
    return "".join([as_markdown(values), *(f"\nFails: {line}\n" for line in failures)])


def _scenario(arguments: str) -> Scenario:
    name, *overrides = shlex.split(arguments)
    return load_scenario(name, overrides)


def _is_linearized(arguments: str) -> bool:
    return arguments.split(" ")[0] == _LINEARIZED


def _values(arguments: str, quantities: list[str]) -> dict[str, Measured]:
    if _is_linearized(arguments):
        found = linearize(_scenario(arguments.removeprefix(_LINEARIZED)))
        return {name: Measured(value=float(LOOP_QUANTITIES[name](found))) for name in quantities}
    _, tried = next(attempts([(lambda: _scenario(arguments), {})]))
    run = tried.run
    if run is None or tried.ending != COMPLETED:
        raise ScenarioError(f"claim on {arguments} = {tried.message}") from tried.error
    metrics = compute_metrics(run)
    measured = _all_measured(
        arguments, {name: QUANTITIES[name](run, metrics) for name in quantities}
    )
    unresolved = unresolved_quantities(run)
    return {
        name: dataclasses.replace(value, is_resolved=name not in unresolved)
        for name, value in measured.items()
    }


def unresolved_quantities(run: Run) -> set[str]:
    """What can be claimed of a run, but for what half its step was seen not to change.

    Only metrics are compared with those at half the step: of the rest nothing is known.
    """
    if not run.unresolved:
        return set()
    resolved: set[str] = set()
    if run.half_step is not None:
        moved = run.half_step["moved"]
        resolved = {metric.heading for metric in METRICS if metric.path not in moved}
    return set(QUANTITIES) - resolved


def _all_measured(arguments: str, values: dict[str, float | None]) -> dict[str, Measured]:
    for name, value in values.items():
        remedy = "give a quantity that this run measures"
        require(value is not None, f"claim on {arguments}", name, remedy)
    return {
        name: Measured(value=float(value)) for name, value in values.items() if value is not None
    }


def _first_near_the_bound(
    run: Run, metrics: Metrics, carrier: int | slice = slice(None)
) -> float | None:
    """When a carrier, or any of all, is first near the bound, after the first second."""
    time, speeds = run.steps["time"], carrier_speeds(run.steps["carrier_state"])
    near = speeds[:, carrier] <= 1.03 * metrics["carriers"]["speed_bound_m_s"]
    instants = time[near.reshape(len(time), -1).any(axis=1) & (time >= 1)]
    return instants[0] if len(instants) else None


def _first_of_carrier(k: int) -> Callable[[Run, Metrics], float | None]:
    return lambda run, metrics: _first_near_the_bound(run, metrics, k)


def _slowest_while_moving(run: Run, metrics: Metrics) -> float:
    time, speeds = run.steps["time"], carrier_speeds(run.steps["carrier_state"]).min(axis=1)
    return speeds[(time > 7) & (time < 23)].min()


def _error_at_rest(run: Run, metrics: Metrics) -> float:
    """The mean while the reference rests."""
    rests = np.linalg.norm(LoadReference.view(run.signal("reference")).velocity, axis=1) == 0
    return 1e3 * np.mean(np.linalg.norm(load_errors(run)[0][rests], axis=1))


def _value_of(metric: Metric) -> Callable[[Run, Metrics], Any]:
    return lambda run, metrics: metric.shown(metric.value(metrics))


# What can be claimed, by name: every metric that is one number by its heading, and figures
# that are no metrics.
QUANTITIES: dict[str, Callable[[Run, Metrics], Any]] = {
    **{metric.heading: _value_of(metric) for metric in METRICS if not metric.is_list},
    "slowest while moving (m/s)": _slowest_while_moving,
    "slowest final speed (m/s)": lambda run, m: min(m["carriers"]["speed_final_m_s"]),
    "fastest final speed (m/s)": lambda run, m: max(m["carriers"]["speed_final_m_s"]),
    "first within 3 % of the bound (s)": _first_near_the_bound,
    **{
        f"carrier {k + 1} first within 3 % of the bound (s)": _first_of_carrier(k) for k in range(4)
    },
    "mean position error at rest (mm)": _error_at_rest,
}

# What can be claimed of a linearized loop.
LOOP_QUANTITIES: dict[str, Callable[[Stability], float]] = {
    "stable (1: yes)": lambda loop: loop.is_stable,
    "growth rate (1/s)": lambda loop: loop.rate,
    "growth in a turn": lambda loop: loop.largest,
}
