"""The signals of a run in memory and in files: the same, and nothing is left behind."""

import errno
import functools
import gc
import os
import tempfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from drake_nonstop import (
    RunInterrupted,
    RunStopped,
    load_scenario,
    simulate,
)
from drake_nonstop.run import recording
from drake_nonstop.run.metrics import compute_metrics
from drake_nonstop.run.recording import LogSignals
from drake_nonstop.studies.results_folder import write_results


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    """The temporary folder, which is empty again at the end."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    yield folder
    if any(folder.iterdir()):
        gc.collect()
    assert list(folder.iterdir()) == []


class Waves(LeafSystem):
    """Signals of several sizes, two of which are recorded at every step."""

    def __init__(self):
        super().__init__()
        self.set_name("waves")
        sizes = {"load_state": 13, "tensions": 3, "reference": 2, "a/b": 1}
        for k, (name, size) in enumerate(sizes.items()):
            self.DeclareVectorOutputPort(name, size, self._calc(k, size))

    @staticmethod
    def _calc(k, size):
        def calc(context, output):
            output.SetFromVector(np.sin((1 + k + np.arange(size)) * context.get_time()))

        return calc


def recorded(samples, steps_per_sample):
    """What is recorded in so many samples and steps."""
    inner = DiagramBuilder()
    waves = inner.AddSystem(Waves())
    for i in range(waves.num_output_ports()):
        inner.ExportOutput(waves.get_output_port(i), waves.get_output_port(i).get_name())
    diagram = inner.Build()
    builder = DiagramBuilder()
    builder.AddSystem(diagram)
    logs = LogSignals(builder, diagram, uses_files=True)
    simulator = Simulator(builder.Build())
    simulator.Initialize()
    for k in range(samples):
        for step in range(steps_per_sample):
            simulator.AdvanceTo(0.01 * (k + (step + 1) / steps_per_sample))
    return logs.collect(simulator.get_context())


def is_in_memory(fields):
    assert not any(values.flags.writeable for part in fields[1:] for values in part.values())
    owners = [values for part in fields[1:] for values in part.values()]
    while any(isinstance(owner, np.ndarray) and owner.base is not None for owner in owners):
        if any(isinstance(owner, np.memmap) for owner in owners):
            return False
        owners = [owner if owner.base is None else owner.base for owner in owners]
        owners = [owner for owner in owners if isinstance(owner, np.ndarray)]
    return True


def assert_same(stored, in_memory):
    assert stored[0].tobytes() == in_memory[0].tobytes()
    for ours, theirs in zip(stored[1:], in_memory[1:], strict=True):
        assert list(ours) == list(theirs)
        for name, values in theirs.items():
            assert ours[name].shape == values.shape
            assert ours[name].dtype == values.dtype
            assert ours[name].tobytes() == values.tobytes(), name


@settings(max_examples=25, deadline=None)
@given(
    samples=st.integers(0, 40),
    steps_per_sample=st.integers(1, 4),
    rows=st.integers(1, 12),
    offset=st.integers(-1, 1),
)
def test_files_hold_what_memory_would_to_the_bit(samples, steps_per_sample, rows, offset):
    in_memory = recorded(samples, steps_per_sample)
    assert is_in_memory(in_memory)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recording, "MEMORY_LIMIT", 8 * 20 * rows + offset)
        stored = recorded(samples, steps_per_sample)
    assert samples < max(16, rows) or not is_in_memory(stored)
    assert_same(stored, in_memory)


def flown(limit=None, **options):
    with pytest.MonkeyPatch.context() as patch:
        if limit is not None:
            patch.setattr(recording, "MEMORY_LIMIT", limit)
        return simulate(scenario_of(0.25), **options)


CONSTANT = "optimization_layer=ConstantParameters"


def scenario_of(duration, *overrides):
    return load_scenario("quintic", [CONSTANT, f"simulation_duration={duration}", *overrides])


@functools.cache
def in_memory():
    return flown()


def fields(run):
    steps = {name: values for name, values in run.steps.items() if name != "solve_time"}
    return run.time, run.signals, steps


@pytest.mark.usefixtures("undrawn")
def test_a_stored_run_is_the_same_run(temporary, tmp_path):
    expected, run = in_memory(), flown(limit=2e4)
    assert list(temporary.iterdir()) == []
    assert not is_in_memory(fields(run))
    assert_same(fields(run), fields(expected))
    assert run.signal("load_state").tobytes() == expected.signal("load_state").tobytes()
    with pytest.raises(KeyError):
        run.signal("no_such_signal")
    metrics = write_results(run, tmp_path / "out", figures=False)
    for part in ("load", "carriers", "cables"):
        assert metrics[part] == compute_metrics(expected)[part]
    with np.load(tmp_path / "out" / "signals.npz") as written:
        assert set(written) >= {"time", "entries", *expected.signals}
        for name, values in expected.signals.items():
            assert written[name].tobytes() == values.tobytes()
    with pytest.raises(ValueError, match="read-only"):
        run.signal("load_state")[0] = 0
    with pytest.raises(ValueError, match="read-only"):
        expected.signal("load_state")[0] = 0
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
    ("error", "ending"),
    [(ZeroDivisionError("my mistake"), RunStopped), (KeyboardInterrupt(), RunInterrupted)],
)
def test_a_run_that_ends_early_has_all_its_signals(temporary, error, ending):
    ends = []
    for limit in (None, 2e4):
        with pytest.raises(ending) as caught:
            flown(limit, optimization_layer=lambda model: FailsAt(error))
        ends.append(fields(caught.value.run))
    assert 0.15 < ends[1][0][-1] <= 0.2
    assert_same(*reversed(ends))
    error.__traceback__ = None
    del caught


@pytest.mark.parametrize("room", [3e4, 5e3])
def test_a_full_disk_ends_the_run_in_one_sentence_and_loses_nothing(temporary, monkeypatch, room):
    expected = flown(engine="diagram")

    def reserve(file, size):
        if size > room:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    reserved = recording._reserve
    monkeypatch.setattr(recording, "_reserve", lambda *a: reserve(*a) or reserved(*a))
    with pytest.raises(RunStopped, match="cannot take the signals") as caught:
        flown(limit=2e4, engine="diagram")
    assert f"{temporary} cannot take the signals (No space left on device)" in str(caught.value)
    assert "\n" not in str(caught.value)
    run = caught.value.run
    assert 1 < len(run.time) <= len(expected.time)
    assert str(caught.value).startswith("the run stopped at t = 0.")
    for name, values in expected.signals.items():
        assert run.signals[name].tobytes() == values[: len(run.time)].tobytes()
    assert run.steps["time"].tobytes() == expected.steps["time"][: len(run.steps["time"])].tobytes()
