"""`drake-nonstop plot`: panels by quantity, labels by run, and what it refuses."""

import pytest
from PIL import Image
from pydrake.systems.framework import LeafSystem

from drake_nonstop import ScenarioError, load_scenario, simulate
from drake_nonstop.cli.main import main
from drake_nonstop.studies.results_folder import write_data
from drake_nonstop.view.run_figures import make_signal_figure


class Clock(LeafSystem):
    def __init__(self, model):
        super().__init__()
        self.DeclareVectorOutputPort("hours", 1, self.calc, {self.time_ticket()})

    def calc(self, context, output):
        output.SetAtIndex(0, context.get_time() / 3600)


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Two runs, and the folders that they are in."""
    folder = tmp_path_factory.mktemp("plots")
    found = {}
    for name in ("quintic", "three_carriers"):
        run = simulate(load_scenario(name, ["simulation_duration=0.2"]))
        write_data(run, folder / name)
        found[name] = run
    return folder, found


def test_a_panel_for_each_quantity_and_a_line_for_each_entry_and_run(runs):
    signals = ["tensions", "carrier_state.velocities.2", "load_state.position.x"]
    figure = make_signal_figure(runs[1], signals)
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert labels == [
        "tensions\n(N)",
        "carrier_state.velocities\n(m/s)",
        "load_state.position\n(µm)",
    ]
    assert [len(axes.lines) for axes in figure.axes] == [4 + 3, 2 * 3, 2]
    assert figure.axes[0].lines[0].get_label() == "1 quintic"
    assert figure.axes[-1].get_xlabel() == "time (s)"


def test_all_of_many_runs_can_be_told_apart_and_too_many_are_refused(runs):
    run = runs[1]["quintic"]
    axes = make_signal_figure({str(k): run for k in range(9)}, ["tensions"]).axes[0]
    kinds = {(line.get_color(), str(line._unscaled_dash_pattern)) for line in axes.lines}
    assert len(axes.lines) == len(kinds) == 9 * 4
    with pytest.raises(ScenarioError, match="--signal = 40 lines of 10 runs: at most 36"):
        make_signal_figure({str(k): run for k in range(10)}, ["tensions"])


def test_a_signal_is_drawn_of_the_runs_that_have_it(runs):
    clocked = simulate(load_scenario("quintic", ["simulation_duration=0.1"]), extra={"c": Clock})
    both = {"own": clocked, "other": runs[1]["quintic"]}
    for name in ("hours", "c.hours"):
        figure = make_signal_figure(both, [name, "cables.tensions.2"])
        assert [len(axes.lines) for axes in figure.axes] == [1, 2]
    with pytest.raises(ScenarioError, match="signal = hour: give a port"):
        make_signal_figure(both, ["hour"])


def test_the_command_writes_the_picture_and_refuses_what_it_cannot_draw(runs, tmp_path, capsys):
    folder, _ = runs
    places = [str(folder / name) for name in ("quintic", "three_carriers")]
    call = ["plot", *places, "--signal", "tensions", "--out"]
    assert main([*call, str(tmp_path / "a.png")]) == 0
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.width == 3.5 * 300  # a column
    figure = ["plot", places[0], "--figure", "snapshots", "--out", str(tmp_path / "b.pdf")]
    assert main(figure) == 0
    assert (tmp_path / "b.pdf").read_bytes().startswith(b"%PDF")
    assert main([*call, str(tmp_path / "a.txt")]) == 2
    assert "a.txt: give a name in .png, .pdf, .svg" in capsys.readouterr().err
    assert main(["plot", *places, "--signal", "tension", "--out", str(tmp_path / "c.png")]) == 2
    assert "signal = tension: give a port of the run" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.png", "b.pdf"]
