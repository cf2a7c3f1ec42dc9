"""Finished results that a folder has from an earlier call, and whether they are still whole."""

import functools
import hashlib
import json
import shutil
import tempfile
from pathlib import Path

import numpy as np

from adversary.verdicts import LEFTOVER, LOST_WORK, Verdict

# What was flown, different in any two runs with different settings; pictures can be made again.
FILES = "scenario.yaml", "metrics.json", "signals.npz"


@functools.cache
def finished() -> Path:
    """The results of a run of `line`, made once."""
    from drake_nonstop import load_scenario, simulate, write_results

    folder = Path(tempfile.mkdtemp(prefix="adversary-finished-"))
    write_results(
        simulate(load_scenario("line", ["simulation_duration=0.05"])),
        folder,
        figures=False,
        replay=False,
    )
    (folder / "notes.txt").write_text("mine")
    return folder


def put(folder: Path) -> None:
    """Copies them there."""
    shutil.copytree(finished(), folder, dirs_exist_ok=True)


def hashes(folder: Path) -> dict[str, str]:
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.rglob("*")
        if path.is_file()
    }


def judge_results(verdict: Verdict, folder: Path, flown: float) -> None:
    """Notes what is wrong with the results of a run that was ended after `flown` simulated s.

    They are those of before, whole, or those of the new run, whole and up to that time.
    """
    before, now = hashes(finished()), hashes(folder)
    if now.get("notes.txt") not in (None, before["notes.txt"]):
        verdict.add(LOST_WORK, "a file of the user's is changed")
    old = [name for name in FILES if now.get(name) == before[name]]
    missing = [name for name in FILES if name not in now]
    has_earlier = "notes.txt" in now
    if missing and (has_earlier or len(missing) < len(FILES)):
        verdict.add(LOST_WORK, f"{missing} missing from the results")
        return
    if has_earlier and 0 < len(old) < len(FILES) and "scenario.yaml" not in old:
        verdict.add(LOST_WORK, f"results of two runs: {old} are the earlier one's")
        return
    if flown > 0 and (missing or len(old) == len(FILES)):
        verdict.add(LOST_WORK, f"{flown:.3g} s were flown, but no results are written")
        return
    if not missing and len(old) < len(FILES):
        try:
            metrics = json.loads((folder / "metrics.json").read_text())
            with np.load(folder / "signals.npz") as signals:
                last = float(signals["time"][-1])
        except Exception as error:
            verdict.add(LOST_WORK, f"the results cannot be read: {error!r}")
            return
        if metrics["simulated_s"] < flown - 0.02 or last < flown - 0.03:
            verdict.add(LOST_WORK, f"{flown:.3g} s were flown, results end at {last:.3g} s")


def judge_tidiness(verdict: Verdict, folder: Path) -> None:
    """Notes temporary files that stay in a folder of results."""
    names = [
        name
        for path in folder.rglob("*")
        if (name := path.name).startswith((".new-", "tmp")) or name.endswith((".tmp", ".part"))
    ]
    if names:
        verdict.add(LEFTOVER, f"temporary files: {names[:4]}")
