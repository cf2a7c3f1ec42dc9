"""Runs: where they start, that they repeat, and what is left when they end early."""

import numpy as np
import pytest
from helpers import nightly_beyond
from pydrake.systems.framework import LeafSystem

from drake_nonstop import RunStopped, ScenarioError, load_scenario, simulate

CONSTANT = "optimization_layer=ConstantParameters"


def short(name, *overrides, duration=0.2):
    """A scenario with constant parameters if the overrides do not say otherwise."""
    return load_scenario(name, [CONSTANT, *overrides, f"simulation_duration={duration}"])


def test_two_runs_of_one_scenario_are_equal_to_the_bit():
    # The line's first solve is after 5 s: start the move at once to have some here.
    layer = "optimization_layer=!NlpLayer {speed_bound: 0.72}"
    scenario = short("quintic", layer)
    first, second = simulate(scenario), simulate(scenario, progress=lambda time: None)
    assert first.signals["optimization_layer.diagnostics"][-1, 3] > 0  # solved
    assert first.signals.keys() == second.signals.keys()
    for name, values in first.signals.items():
        assert values.tobytes() == second.signals[name].tobytes(), name


def test_signals_are_sampled_at_100_hz_and_hold_no_wall_time():
    run = simulate(short("quintic", "simulator_config.max_step_size=0.003"))
    np.testing.assert_allclose(run.time, np.arange(21) / 100, atol=1e-12)
    assert not any("solve_time" in name for name in run.signals)
    assert len(run.steps["time"]) > len(run.time)
    assert run.steps["time"][0] == 0


@pytest.mark.parametrize(
    ("name", "control_period"),
    nightly_beyond(
        2,
        "flights",
        [
            *(("quintic", 0.0), ("paper_quintic", 0.01), ("quintic", 0.01), ("paper_quintic", 0.0)),
            *(("three_carriers", 0.0), ("three_carriers", 0.01)),
        ],
    ),
)
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
        )
    )
    # What is left is the lag of the carriers behind their turning references.
    assert np.max(np.abs(run.signal("tracking_error")[:, :6])) < 5e-4


def test_a_load_that_the_cables_cannot_hold_is_an_error_before_the_run():
    with pytest.raises(ScenarioError, match="do not hold the load"):
        simulate(short("quintic", "simulated.cable_length=3"))


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


def test_a_nan_from_a_users_block_stops_the_run_and_is_blamed_on_it():
    with pytest.raises(RunStopped, match="optimization_layer made a value that is not") as caught:
        simulate(short("quintic"), optimization_layer=lambda model: FailsAt(0.105, None))
    assert 0.05 < caught.value.run.time[-1] < 0.111


def test_an_error_in_a_users_block_is_reported_with_its_time():
    layer = lambda model: FailsAt(0.105, ZeroDivisionError("my mistake"))  # noqa: E731
    with pytest.raises(RunStopped, match="my mistake") as caught:
        simulate(short("quintic"), optimization_layer=layer)
    assert 0.05 < caught.value.run.time[-1] < 0.111


def test_an_interrupt_keeps_the_signals():
    from drake_nonstop import RunInterrupted

    layer = lambda model: FailsAt(0.105, KeyboardInterrupt())  # noqa: E731
    with pytest.raises(RunInterrupted) as caught:
        simulate(short("quintic"), optimization_layer=layer)
    assert 0.05 < caught.value.run.time[-1] < 0.111


@pytest.mark.parametrize("n", nightly_beyond(1, "flights", [8, 6]))
def test_the_step_is_shortened_where_the_fastest_mode_needs_it(n):
    angles = 2 * np.pi * np.arange(n) / n
    points = 1.06 * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    overrides = [f"system.attachments={points.tolist()}", "pattern=!HamiltonianCycle {}"]
    run = simulate(short("quintic", *overrides))
    assert np.max(np.diff(run.steps["time"])) < 0.004  # less than the scenario's 5 ms
    assert np.min(run.steps["tensions"]) > 0
    assert np.max(np.abs(run.signal("tracking_error")[:, 3:6])) < 1e-3
