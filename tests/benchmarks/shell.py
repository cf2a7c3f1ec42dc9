"""`drake-nonstop run` from the shell to its finished folder, at present and at another revision."""

import contextlib
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from drake_nonstop.benchmarks.comparing import PACKAGE_PARENT, checked_out, spread
from drake_nonstop.validation import ScenarioError

_ENVIRONMENT = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}


def benchmark_shell(
    arguments: Sequence[str],
    revision: str | None = None,
    *,
    repeats: int = 5,
    checkout: Path = PACKAGE_PARENT,
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> dict[str, Any]:
    """Times of `drake-nonstop run` with these arguments, alternately with both revisions.

    A first call of each fills caches, and does not count.

    Returns:
        By "present" and, with a revision, "other": `wall_s` and `cpu_s`, of the process and all of
        its own, as `spread`; and by how much the medians of the present are of the other's.

    Raises:
        ScenarioError: a call fails, or there is no such revision.
    """
    with contextlib.ExitStack() as stack:
        parents = {"present": PACKAGE_PARENT}
        if revision is not None:
            parents["other"] = stack.enter_context(checked_out(revision, checkout))
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        times: dict[str, list[tuple[float, float]]] = {side: [] for side in parents}
        for k in range(repeats + 1):
            for side, parent in parents.items():
                times[side].append(_times(parent, folder, [*arguments, "--out", side]))
            progress("running alternately", (k + 1) / (repeats + 1))
    results: dict[str, Any] = {"arguments": [*arguments], "against_revision": revision}
    for side, found in times.items():
        wall, cpu = zip(*found[1:], strict=True)
        results[side] = {"wall_s": spread([*wall]), "cpu_s": spread([*cpu])}
    if revision is not None:
        results["present_of_other"] = {
            kind: results["present"][kind]["median"] / results["other"][kind]["median"]
            for kind in ("wall_s", "cpu_s")
        }
    return results


def _times(parent: Path, folder: str, arguments: Sequence[str]) -> tuple[float, float]:
    """Wall and processor time in s of one call."""
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "drake_nonstop.cli", "run", *arguments, "--quiet"],
        cwd=folder,
        env={**_ENVIRONMENT, "PYTHONPATH": str(parent)},
        capture_output=True,
        text=True,
        check=False,
    )
    wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        raise ScenarioError(f"run in {parent} = {done.stderr.strip()}: give what runs there")
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def table(results: dict[str, Any]) -> str:
    """The results as text."""
    rows = [
        f"{side:8} {found['wall_s']['median']:6.2f} s ({found['wall_s']['lowest']:.2f} to "
        f"{found['wall_s']['highest']:.2f}), {found['cpu_s']['median']:.2f} s of processors"
        for side, found in results.items()
        if side in ("present", "other")
    ]
    if "present_of_other" in results:
        ratios = results["present_of_other"]
        rows.append(f"ratio    {ratios['wall_s']:6.2f}, {ratios['cpu_s']:.2f} of processors")
    return "\n".join(rows)
