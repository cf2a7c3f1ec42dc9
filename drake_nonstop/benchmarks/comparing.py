"""Two ways to run a scenario, timed alternately: other overrides, or another git revision."""

import contextlib
import json
import os
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from drake_nonstop.benchmarks import fresh_run
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.validation import ScenarioError, require

PACKAGE_PARENT = Path(__file__).parents[2]
_SIDES = ("present", "other")  # of a comparison


@dataclass(frozen=True)
class Source:
    """Where a scenario comes from: the arguments of `load_scenario`."""

    scenario: str
    overrides: Sequence[str] = ()
    trust: bool = False

    def load(self) -> Scenario:
        """The scenario; raises ScenarioError as `load_scenario`."""
        return load_scenario(self.scenario, self.overrides, trust=self.trust)


class FreshRuns:
    """Runs of a scenario in a fresh interpreter, which is kept from run to run.

    Args:
        source: what to run.
        parent: the folder that the package is imported from.

    Raises:
        ScenarioError: from `run`, where the scenario cannot be run there; the message holds
            the last line that the interpreter wrote.
    """

    def __init__(self, source: Source, parent: Path = PACKAGE_PARENT):
        asked = asdict(source) | {"overrides": list(source.overrides)}
        paths = [str(parent), os.environ.get("PYTHONPATH", "")]
        self._parent = parent
        self._errors = tempfile.TemporaryFile("w+")  # noqa: SIM115 - closed by close()
        self._process = subprocess.Popen(
            [sys.executable, fresh_run.__file__, json.dumps(asked)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            text=True,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(path for path in paths if path)},
            start_new_session=True,  # Ctrl-C reaches this process alone, which ends that one
        )

    def run(self) -> dict[str, Any]:
        """One run: what `fresh_run` wrote, and the real-time factor."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.write("run\n")
            self._process.stdin.flush()
        line = self._process.stdout.readline()
        if not line:
            self._process.wait()
            self._errors.seek(0)
            lines = self._errors.read().strip().splitlines() or ["no message"]
            said = re.sub(r"^[\w.]*Scenario(Error|Warning): ", "", lines[-1].strip())
            raise ScenarioError(f"run in {self._parent} = {said}: give what runs there")
        answer: dict[str, Any] = json.loads(line)
        require(
            Path(answer["package"]).resolve().parent == self._parent.resolve(),
            "drake_nonstop",
            answer["package"],
            f"let it be imported from {self._parent}",
        )
        answer["real_time_factor"] = answer["simulated_s"] / answer["wall_s"]
        return answer

    def close(self) -> None:
        """Ends the interpreter."""
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout, self._errors):
            assert stream is not None
            with contextlib.suppress(BrokenPipeError):
                stream.close()


def compare(
    source: Source,
    against: Sequence[str] = (),
    revision: str | None = None,
    *,
    repeats: int = 5,
    checkout: Path = PACKAGE_PARENT,
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> dict[str, Any]:
    """Runs a scenario in two ways, the present and the other, alternately.

    Each way has a process of its own. The first run of each is its start-up and not one of
    the repeats.

    Args:
        source: the present: the scenario as it is, with the present files of the package.
        against: the overrides that the other has besides those of the present.
        revision: the git revision of the package that the other runs with; None: the present
            files.
        repeats: of each.
        checkout: where the revision is looked for: the folder that holds the package.
        progress: called with what is being done and the share of it that is done.

    Returns:
        What `drake-nonstop bench run --against` writes as JSON. `present_over_other` is the
        present's real-time factor divided by the other's: that of the medians, and the lowest
        and highest of a pair of runs, so that more than 1 is a present that is faster.
        `load_path_difference_m` is the largest distance between the two loads at one instant,
        None where the runs differ in length.

    Raises:
        ScenarioError: the scenario or the overrides cannot be run, or there is no such
            revision of a git checkout.
    """
    other = Source(source.scenario, [*source.overrides, *against], source.trust)
    scenario = source.load()
    if revision is None:
        other.load()
    with contextlib.ExitStack() as stack:
        parent = PACKAGE_PARENT
        if revision is not None:
            parent = stack.enter_context(checked_out(revision, checkout))
        sides: list[FreshRuns] = []
        answers: tuple[list[dict[str, Any]], ...] = ([], [])
        total = 2 * (repeats + 1)
        for turn in range(total):
            if turn < 2:  # one starts up while the other waits
                sides.append(FreshRuns(*((source,) if turn == 0 else (other, parent))))
                stack.callback(sides[turn].close)
            answers[turn % 2].append(sides[turn % 2].run())
            progress("running alternately", (turn + 1) / total)
    firsts = [side.pop(0) for side in answers]
    factors = [[answer["real_time_factor"] for answer in side] for side in answers]
    ratios = [present / other for present, other in zip(*factors, strict=True)]
    medians = [statistics.median(side) for side in factors]
    return {
        "scenario": scenario.name,
        "overrides": list(source.overrides),
        "against": list(against),
        "against_revision": revision,
        "repeats": repeats,
        "real_time_factor": dict(zip(_SIDES, map(spread, factors), strict=True)),
        "present_over_other": {
            "of_medians": medians[0] / medians[1],
            "lowest": min(ratios),
            "highest": max(ratios),
            "pairs": ratios,
        },
        "load_path_difference_m": _path_difference(*firsts),
        "start_up_s": {
            side: f["start_up"]["total_s"] for side, f in zip(_SIDES, firsts, strict=True)
        },
        "peak_memory_MiB": {
            side: a[-1]["peak_memory_MiB"] for side, a in zip(_SIDES, answers, strict=True)
        },
    }


def spread(values: list[float]) -> dict[str, Any]:
    """The median of the values of some runs, their range, and the values."""
    return {
        "median": statistics.median(values),
        "lowest": min(values),
        "highest": max(values),
        "runs": values,
    }


def _path_difference(present: dict[str, Any], other: dict[str, Any]) -> float | None:
    paths = [np.array(answer["load_positions_m"]) for answer in (present, other)]
    if paths[0].shape != paths[1].shape:
        return None
    return float(np.max(np.linalg.norm(paths[0] - paths[1], axis=1)))


def table(results: dict[str, Any]) -> str:
    """The results as text."""
    ratio, difference = results["present_over_other"], results["load_path_difference_m"]
    rows = [f"{results['scenario']:28}{'real-time factor':>17}{'start-up':>11}{'peak memory':>14}"]
    for side in _SIDES:
        factor, peak = results["real_time_factor"][side], results["peak_memory_MiB"][side]
        between = f"({factor['lowest']:.2f} to {factor['highest']:.2f})"
        rows.append(
            f"the {side:16}{factor['median']:9.2f} {between:>15}"
            f"{results['start_up_s'][side]:9.2f} s"
            f"{'unknown' if peak is None else f'{peak:.0f} MiB':>14}"
        )
    paths = (
        "of another length" if difference is None else f"at most {1e3 * difference:.3g} mm apart"
    )
    return "\n".join(
        [
            *rows,
            f"the present is {ratio['of_medians']:.3f} times as fast as {_other_name(results)} "
            f"({ratio['lowest']:.3f} to {ratio['highest']:.3f} in {results['repeats']} pairs of "
            "runs)",
            f"the load's paths are {paths}",
        ]
    )


def _other_name(results: dict[str, Any]) -> str:
    """Name of the other side: "revision R", "with A, B" or "revision R with A, B"."""
    parts = []
    if results["against_revision"] is not None:
        parts.append(f"revision {results['against_revision']}")
    if results["against"]:
        parts.append(f"with {', '.join(results['against'])}")
    return " ".join(parts) or "itself"


@contextlib.contextmanager
def checked_out(revision: str, checkout: Path = PACKAGE_PARENT) -> Iterator[Path]:
    """A folder with the files of a git revision, removed at the end.

    Raises:
        ScenarioError: git is missing, the folder is no checkout with the package in it, or
            has no such revision.
    """
    field = "--against-revision"
    try:
        top = _git(checkout, "rev-parse", "--show-toplevel")
    except FileNotFoundError:
        raise ScenarioError(f"{field} = {revision}: install git") from None
    in_checkout = top.returncode == 0 and Path(top.stdout.strip()).samefile(checkout)
    is_tracked = in_checkout and (
        _git(checkout, "ls-files", "--error-unmatch", "drake_nonstop/__init__.py").returncode == 0
    )
    require(
        is_tracked,
        field,
        revision,
        f"{checkout} is no git checkout of the package, so there are no revisions; run it in one",
    )
    found = _git(
        checkout, "rev-parse", "--verify", "--quiet", "--end-of-options", f"{revision}^{{commit}}"
    )
    require(
        found.returncode == 0,
        field,
        revision,
        f"there is no such revision in {checkout}; give a commit, branch or tag",
    )
    with tempfile.TemporaryDirectory(prefix="drake_nonstop_") as folder:
        tree = Path(folder) / "revision"
        files = str(tree.with_suffix(".tar"))
        packed = _git(checkout, "archive", "--output", files, found.stdout.strip())
        problem = (packed.stderr.strip().splitlines() or ["no message"])[-1]
        require(packed.returncode == 0, field, revision, f"git cannot pack it ({problem})")
        shutil.unpack_archive(files, tree, filter="data")
        yield tree


def _git(folder: Path, *arguments: str) -> "subprocess.CompletedProcess[str]":
    """Runs git in a folder, without Ctrl-C, hooks, or the variables that a hook sets."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("GIT_")}
    return subprocess.run(
        ["git", "-C", str(folder), "-c", "core.hooksPath=/dev/null", *arguments],
        capture_output=True,
        text=True,
        check=False,
        env=environment,
        start_new_session=True,
    )
