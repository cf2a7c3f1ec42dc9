"""`drake-nonstop plot`: panels by quantity, labels by run, and what it refuses."""

import pytest
from PIL import Image

from drake_nonstop import load_scenario, simulate
from drake_nonstop.cli.main import main
from drake_nonstop.studies.results_folder import write_data
from drake_nonstop.view.run_figures import make_signal_figure


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
