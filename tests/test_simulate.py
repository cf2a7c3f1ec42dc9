"""Runs: where they start, that they repeat, and what is left when they end early."""

import numpy as np
import pytest
from pydrake.systems.framework import LeafSystem

from drake_nonstop import ConstantParameters, RunStopped, ScenarioError, load_scenario, simulate


def short(name, *settings, duration=0.5):
    return load_scenario(name, [*settings, f"duration={duration}"])


def test_two_runs_of_one_scenario_are_equal_to_the_bit():
    # The line's first solve is after 5 s: start the move at once to have some here.
    scenario = short("quintic", "optimization_layer.speed_bound=0.72")
    first, second = simulate(scenario), simulate(scenario, progress=lambda time: None)
    assert first.signals["optimization_layer.diagnostics"][-1, 3] > 0  # solved
    assert first.signals.keys() == second.signals.keys()
    for name, values in first.signals.items():
        assert values.tobytes() == second.signals[name].tobytes(), name


def test_signals_are_sampled_at_100_hz_and_hold_no_wall_time():
    run = simulate(short("quintic", "simulator.max_step_size=0.003"))
    np.testing.assert_allclose(run.time, np.arange(51) / 100, atol=1e-12)
    assert not any("solve_time" in name for name in run.signals)
    assert len(run.steps["time"]) > len(run.time)
    assert run.steps["time"][0] == 0


def test_every_block_of_the_figure_has_its_signals():
    run = simulate(short("quintic", duration=0.02))
    blocks = {name.split(".")[0] for name in run.signals}
    assert blocks >= {"load_trajectory", "optimization_layer", "cables", "load_plant"}
    assert run.signals["wrench_controller.wrench"].shape == (3, 6)


@pytest.mark.parametrize("name", ["quintic", "paper_quintic", "three_carriers"])
@pytest.mark.parametrize("control_period", [0.0, 0.01])
def test_the_load_starts_at_rest_on_its_equilibrium(name, control_period):
    run = simulate(short(name, f"control_period={control_period}", duration=0.1))
    speed = np.linalg.norm(run.signal("load_state")[:, 10:], axis=1)
    error = np.linalg.norm(run.signal("load_state")[0, 4:7])
    sag = 0.0 if name != "paper_quintic" else 0.006
    assert abs(error - sag) < 5e-4
    assert np.max(speed) < 5e-3


def test_a_tilted_load_starts_at_rest_too():
    run = simulate(
        short(
            "quintic",
            "load_trajectory=!RestToRest {start_roll_pitch_yaw: [0.3, -0.2, 1.0]}",
            duration=0.5,
        )
    )
    # What is left is the lag of the carriers behind their turning references.
    assert np.max(np.abs(run.signal("tracking_error")[:, :6])) < 5e-4


@pytest.mark.parametrize("n", [3, 5, 6])
def test_other_numbers_of_carriers_fly(n):
    angles = 2 * np.pi * np.arange(n) / n
    points = np.stack([np.cos(angles), np.sin(angles), 0.1 * (-1.0) ** np.arange(n)], axis=1)
    run = simulate(
        short("quintic", f"system.attachments={points.tolist()}", "pattern=!HamiltonianCycle {}")
    )
    assert run.signal("carrier_state").shape[1] == 6 * n
    assert np.max(np.abs(run.signal("tracking_error")[:, 3:6])) < 1e-3


def test_a_load_that_the_cables_cannot_hold_is_an_error_before_the_run():
    with pytest.raises(ScenarioError, match="do not hold the load"):
        simulate(short("quintic", "system.load_mass=1e9"))


def test_a_diverging_run_stops_with_time_and_block_and_keeps_its_signals():
    scenario = short("quintic", "carrier_controller.position_gain=5e4", duration=2)
    with pytest.raises(RunStopped, match=r"diverged at t = 0\.\d+ s: \w+ was the first") as caught:
        simulate(scenario)
    run = caught.value.run
    assert 0 < run.time[-1] < 2
    assert len(run.signal("load_state")) == len(run.time)


class FailsAt(LeafSystem):
    """A ConstantParameters that raises, or gives NaN, from some time on."""

    def __init__(self, time, error):
        super().__init__()
        self._time, self._error = time, error
        self.DeclareVectorOutputPort("parameters", 2, self._calc)

    def _calc(self, context, output):
        late = context.get_time() >= self._time
        if late and self._error:
            raise self._error
        output.SetFromVector([np.nan if late else 2.0, 1.2])


def test_a_nan_from_a_users_block_stops_the_run_where_it_is_first_seen():
    with pytest.raises(RunStopped, match="internal_force was the first block") as caught:
        simulate(short("quintic"), optimization_layer=lambda model: FailsAt(0.2, None))
    assert 0.15 < caught.value.run.time[-1] <= 0.2


def test_an_error_in_a_users_block_is_told_with_its_time():
    layer = lambda model: FailsAt(0.2, ZeroDivisionError("my mistake"))  # noqa: E731
    with pytest.raises(RunStopped, match="my mistake") as caught:
        simulate(short("quintic"), optimization_layer=layer)
    assert 0.15 < caught.value.run.time[-1] <= 0.2


def test_an_interrupt_keeps_the_signals():
    from drake_nonstop import RunInterrupted

    layer = lambda model: FailsAt(0.2, KeyboardInterrupt())  # noqa: E731
    with pytest.raises(RunInterrupted) as caught:
        simulate(short("quintic"), optimization_layer=layer)
    assert 0.15 < caught.value.run.time[-1] <= 0.2


def test_a_finer_step_gives_the_same_run():
    coarse = simulate(short("quintic", duration=1))
    fine = simulate(short("quintic", "simulator.max_step_size=0.001", duration=1))
    difference = coarse.signal("load_state") - fine.signal("load_state")
    assert np.max(np.abs(difference[:, 4:7])) < 1e-6


def test_the_loop_without_optimization_keeps_its_parameters():
    run = simulate(short("quintic"), optimization_layer=ConstantParameters)
    assert np.all(run.signal("parameters") == [2.0, 1.2])
    assert len(run.solve_times) == 0
