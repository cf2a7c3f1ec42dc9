"""The signals of a run in memory and in files: the same, and nothing is left behind."""

import errno
import functools
import gc
import os
import tempfile

import pytest
from pydrake.systems.framework import LeafSystem

from drake_nonstop import RunInterrupted, RunStopped, load_scenario, simulate
from drake_nonstop.run import recording

CONSTANT = "optimization_layer=ConstantParameters"
LIMIT = 2e4  # bytes in memory


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    """The temporary folder, which is empty again at the end."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    yield folder
    gc.collect()
    assert list(folder.iterdir()) == []


def flown(limit=None, **options):
    scenario = load_scenario("quintic", [CONSTANT, "simulation_duration=0.253"])
    with pytest.MonkeyPatch.context() as patch:
        if limit is not None:
            patch.setattr(recording, "MEMORY_LIMIT", limit)
        return simulate(scenario, **options)


@functools.cache
def in_memory(engine):
    return flown(engine=engine)


def assert_same(run, expected):
    """To the bit, as far as the first one flew."""
    assert run.signals.keys() == expected.signals.keys()
    pairs = [(run.signals, expected.signals, len(run.time))]
    pairs += [(run.steps, expected.steps, len(run.steps["time"]))]
    for values, others, count in pairs:
        for name in values.keys() - {"solve_time"}:
            assert values[name].tobytes() == others[name][:count].tobytes(), name


@pytest.mark.parametrize("engine", ["compiled", "diagram"])
def test_a_long_run_is_in_files_and_read_only_and_the_same(temporary, engine):
    expected, run = in_memory(engine), flown(LIMIT, engine=engine)
    assert list(temporary.iterdir()) == []  # files without names
    assert_same(run, expected)
    assert len(run.time) == len(expected.time) == 26
    for each in (run, expected):
        with pytest.raises(ValueError, match="read-only"):
            each.signal("load_state")[0] = 0
    kept = run.signal("tensions")
    del run
    gc.collect()
    assert kept.tobytes() == expected.signal("tensions").tobytes()


class FailsAt(LeafSystem):
    def __init__(self, error):
        super().__init__()
        self._error = error
        self.DeclareVectorOutputPort("parameters", 2, self._calc)

    def _calc(self, context, output):
        if context.get_time() >= 0.2:
            raise self._error
        output.SetFromVector([2.0, 1.2])


@pytest.mark.parametrize(
    ("error", "ending", "said"),
    [
        (ZeroDivisionError("my mistake"), RunStopped, "my mistake"),
        (KeyboardInterrupt(), RunInterrupted, r"interrupted at t = 0\.[12]"),
    ],
)
def test_a_run_that_ends_early_has_all_its_signals(temporary, error, ending, said):
    runs = []
    for limit in (None, LIMIT):
        with pytest.raises(ending, match=said) as caught:
            flown(limit, optimization_layer=lambda model: FailsAt(error))
        runs.append(caught.value.run)
    assert 0.15 < runs[1].time[-1] <= 0.2
    assert_same(*reversed(runs))
    error.__traceback__ = None
    del caught, runs


@pytest.mark.parametrize("room", [3e4, 5e3])
def test_a_full_disk_ends_the_run_in_one_sentence_and_loses_nothing(temporary, monkeypatch, room):
    def reserve(file, size):
        if size > room:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    reserved = recording._reserve
    monkeypatch.setattr(recording, "_reserve", lambda *a: reserve(*a) or reserved(*a))
    with pytest.raises(RunStopped, match="cannot take the signals") as caught:
        flown(LIMIT, engine="diagram")
    assert f"{temporary} cannot take the signals (No space left on device)" in str(caught.value)
    assert "set TMPDIR" in str(caught.value)
    assert 1 < len(caught.value.run.time) < 26
    assert_same(caught.value.run, in_memory("diagram"))
