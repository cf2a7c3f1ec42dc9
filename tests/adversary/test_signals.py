"""Signals at drawn times: what was flown is kept."""

import json
import os
import shutil
import signal
import time
from pathlib import Path

import numpy as np
import pytest
from helpers import begun
from hypothesis import given, settings
from hypothesis import strategies as st

from drake_nonstop import load_scenario, simulate, write_results

pytestmark = pytest.mark.nightly("adversary")

RESULTS = ("scenario.yaml", "metrics.json", "signals.npz")
RUN = ["run", "line", "--no-figures", "--no-replay", "--trust", "--out", "out", "--set"]
ENVIRONMENT = {**os.environ, "PYTHONPATH": f"{Path(__file__).parents[2]}"}
FEW = settings(max_examples=max(2, int(os.environ.get("ADVERSARY_COUNT", "40")) // 20))
BEGUN = "import sys; print('begins', flush=True); from drake_nonstop.cli.main import main; main()"


def kept(folder: Path) -> list[bytes]:
    """The content of a folder's results."""
    return [(folder / name).read_bytes() for name in RESULTS]


def assert_whole(folder: Path) -> float:
    """Results can be read, and are of one run, whose length in s is returned."""
    metrics = json.loads((folder / "metrics.json").read_text())
    with np.load(folder / "signals.npz") as signals:
        assert signals["time"][-1] == pytest.approx(metrics["simulated_s"], abs=0.03)
    assert not [*folder.rglob(".new-*")]
    return metrics["simulated_s"]


@pytest.fixture(scope="module")
def earlier(tmp_path_factory):
    """Results of an earlier run, in a folder to copy."""
    folder = tmp_path_factory.mktemp("earlier")
    run = simulate(load_scenario("line", ["simulation_duration=0.05"]))
    write_results(run, folder, figures=False, replay=False)
    return folder


@FEW
@given(
    st.sampled_from([signal.SIGINT, signal.SIGTERM, signal.SIGHUP]),
    st.floats(0.1, 4),
    st.sampled_from([1, 1, 2]),
    st.booleans(),
    st.booleans(),
)
def test_a_signal_at_any_time_keeps_what_was_flown(
    tmp_path_factory, earlier, number, after, times, is_group, has_earlier
):
    folder = tmp_path_factory.mktemp("signals")
    if has_earlier:
        shutil.copytree(earlier, folder / "out")
    process = begun(["-c", BEGUN, *RUN, "simulation_duration=1000"], folder, ENVIRONMENT)
    time.sleep(after)
    for _ in range(times):
        (os.killpg if is_group else os.kill)(process.pid, number)
        time.sleep(0.3)
    _, error = process.communicate(timeout=20)
    assert process.returncode == 128 + number, error
    assert "Traceback" not in error
    with pytest.raises(ProcessLookupError):  # nothing is left of its session
        os.killpg(process.pid, 0)
    assert not has_earlier or kept(folder / "out") == kept(earlier)
    for made in (folder / "out", folder / "out_stopped"):
        if made.exists():
            assert_whole(made)
    assert times > 1 or after < 3.5 or (folder / "out").exists()
