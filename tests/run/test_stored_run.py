"""A run that is read back from its folder or another process, and its signals as columns."""

import dataclasses
import json
import pickle
import shutil
from typing import ClassVar

import numpy as np
import pytest
from pydrake.systems.framework import LeafSystem

from drake_nonstop import (
    Layout,
    Part,
    Run,
    RunInterrupted,
    RunStopped,
    ScenarioError,
    ScenarioWarning,
    ShapedPhase,
    compute_metrics,
    load_scenario,
    record_replay,
    simulate,
    write_results,
)

pytestmark = pytest.mark.usefixtures("undrawn")


def short(*changes):
    constant = "optimization_layer=ConstantParameters"
    return load_scenario("quintic", [constant, "simulation_duration=0.2", *changes])


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """A run, and the folder that it is written to."""
    folder = tmp_path_factory.mktemp("stored") / "run"
    run = simulate(short())
    write_results(run, folder, figures=False, replay=False)
    return run, folder


def test_it_is_as_if_it_had_just_flown_and_is_written_again_to_the_bit(stored, tmp_path):
    run, folder = stored
    loaded = Run.load(folder)
    for name in ("signals", "steps"):
        values, expected = getattr(loaded, name), getattr(run, name)
        assert list(values) == list(expected)
        for key in expected:
            np.testing.assert_array_equal(values[key], expected[key])
    same = [field.name for field in dataclasses.fields(Run)]
    for name in set(same) - {"signals", "steps", "diagram", "time", "solve_times"}:
        assert getattr(loaded, name) == getattr(run, name), name
    assert compute_metrics(loaded) == compute_metrics(run)
    assert compute_metrics(loaded) == json.loads((folder / "metrics.json").read_text())
    assert record_replay(loaded) == record_replay(run)
    write_results(loaded, tmp_path, figures=False, replay=False)
    for name in ("scenario.yaml", "metrics.json", "signals.npz"):
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes(), name


class Clock(LeafSystem):
    """An extra block, whose signal has a unit."""

    signal_layouts: ClassVar = {"hours": Layout(Part("", "1", "h"))}

    def __init__(self, model):
        super().__init__()
        self.DeclareVectorOutputPort("hours", 1, self._calc)

    def _calc(self, context, output):
        output.SetAtIndex(0, context.get_time() / 3600)


def test_a_run_with_blocks_of_ones_own_says_so(tmp_path):
    run = simulate(short(), extra={"clock": Clock})
    frame = run.to_pandas(["clock.hours"])
    assert frame["hours [h]"].iloc[-1] == pytest.approx(run.time[-1] / 3600)
    write_results(run, tmp_path, figures=False, replay=False)
    with pytest.warns(ScenarioWarning, match="blocks that its scenario does not name"):
        loaded = Run.load(tmp_path)
    assert loaded.replacements is None
    assert list(loaded.columns(["clock.hours"])) == ["time [s]", "hours [h]"]
    assert compute_metrics(loaded) == compute_metrics(run)


class OwnPhase(ShapedPhase):
    """One of the user's own."""


@pytest.mark.parametrize("kind", [None, RunStopped, RunInterrupted])
def test_a_pickled_run_or_the_exception_with_it_builds_its_loop_again(kind):
    run = simulate(short(), phase=OwnPhase)
    given = {None: run, RunStopped: RunStopped("it fell", run), RunInterrupted: RunInterrupted(run)}
    copied = pickle.loads(pickle.dumps(given[kind]))
    assert type(copied) is type(given[kind])
    assert str(copied) == str(given[kind])
    of_copy = getattr(copied, "run", copied)
    for name, values in run.signals.items():
        assert values.tobytes() == of_copy.signals[name].tobytes(), name
    assert type(of_copy.diagram.GetSubsystemByName("phase")) is OwnPhase


def test_columns_frames_and_datasets_have_units(stored):
    run, _ = stored
    names = ["load_state.velocity", "carrier_state.positions.2.x", "tensions"]
    frame = run.to_pandas(names)
    units = {f"load_state.velocity.{axis}": "m/s" for axis in "xyz"}
    units |= {"carrier_state.positions.2.x": "m"} | {f"tensions.{k}": "N" for k in (1, 2, 3, 4)}
    labels = [f"{name} [{unit}]" for name, unit in units.items()]
    assert frame.index.name == "time [s]"
    assert list(frame.columns) == labels
    assert frame.attrs["units"] == dict(zip(labels, units.values(), strict=True))
    assert frame.attrs["frames"][labels[0]] == "W"
    expected = run.signal("carrier_state")[:, 3]
    np.testing.assert_array_equal(frame[labels[3]].to_numpy(), expected)
    assert len(run.columns()) == 1 + sum(values.shape[1] for values in run.signals.values())
    for error in (ScenarioError, KeyError):
        with pytest.raises(error, match=r"signal = load_state.speed: give a port"):
            run.columns(["load_state.speed"])
    pytest.importorskip("xarray")
    data = run.to_xarray(names)
    assert {name: data[name].attrs["units"] for name in data} == units
    assert data["load_state.velocity.x"].attrs["frame"] == "W"
    np.testing.assert_array_equal(data["carrier_state.positions.2.x"], expected)
    np.testing.assert_array_equal(data["time"], run.time)


@pytest.fixture
def copied(stored, tmp_path):
    """A copy of the folder, whose path is longer than what a sentence shows of a value."""
    folder = tmp_path / ("long" * 30)
    shutil.copytree(stored[1], folder)
    return folder


@pytest.mark.parametrize("name", ["scenario.yaml", "signals.npz"])
def test_what_is_no_run_is_refused(name, copied):
    for content in (b"nothing", (copied / name).read_bytes()[:300], None):
        if content is None:
            (copied / name).unlink()
        else:
            (copied / name).write_bytes(content)
        with pytest.raises(ScenarioError, match=rf"^{name}, run = \S+: .* (give|fly its) "):
            Run.load(copied)
    with pytest.raises(ScenarioError, match=r"run = 7: give the path"):
        Run.load(7)


def _changed(name, change):
    return lambda arrays: arrays.update({name: change(arrays[name])})


@pytest.mark.parametrize(
    "damage",
    [
        *(
            lambda arrays, name=name: arrays.pop(name)
            for name in ("time", "cables.tensions", "run", "steps/carrier_state")
        ),
        _changed("time", lambda time: np.where(time > 0.1, np.nan, time)),
        _changed("entries", lambda rows: rows[:-1]),
        _changed("steps/time", lambda time: time[1:]),
        _changed("run", lambda text: np.array("{}")),
    ],
)
def test_a_damaged_file_is_named_with_the_remedy(damage, copied):
    with np.load(copied / "signals.npz") as archive:
        arrays = dict(archive)
    damage(arrays)
    np.savez(copied / "signals.npz", **arrays)
    with pytest.raises(ScenarioError, match=r"^signals.npz, run = \S+: it .*; put .* fly"):
        Run.load(copied)
