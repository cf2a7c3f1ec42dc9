"""What becomes of a run: made-up runs with faults drawn at random, and a few real ones."""

import dataclasses
import json
import math
import re
from operator import attrgetter

import numpy as np
import pytest
from aircraft_runs import aircraft_run, made_up
from helpers import regular
from hypothesis import given, settings
from hypothesis import strategies as st

from drake_nonstop import (
    RunLimits,
    RunOutcome,
    Scenario,
    StepAction,
    SystemParameters,
    changed,
    compute_metrics,
    load_scenario,
    simulate,
)
from drake_nonstop.run.metrics import metrics_table
from drake_nonstop.run.outcome import LIMITS
from drake_nonstop.run.run_quantities import RunQuantities

CONSTANT = "optimization_layer=ConstantParameters"
SAMPLES = 60


def with_obstacles(scenario, *obstacles):
    return changed(scenario, [f"obstacles=[{', '.join(obstacles)}]"])


class MadeUpRun:
    """A load at rest below carriers that circle at one and a half times the bound, of any size."""

    def __init__(self, rng, n=4, size=1.0):
        self.rng, self.n = rng, n
        self.cable_length = size * rng.uniform(0.5, 1.0)
        attachments = size * regular(n, radius=rng.uniform(0.3, 1.0))
        apart = np.linalg.norm(attachments[0] - attachments[1])
        self.reach = np.linalg.norm(attachments[0]) + self.cable_length
        self.bound = rng.uniform(0.1, 5.0)
        self.time = np.linspace(0, rng.uniform(0.5, 20.0), SAMPLES)
        self.stopped, self.unresolved = "", ()
        self.saturated = np.zeros((SAMPLES, 3 * n))
        angle = 2 * np.pi * self.time / self.time[-1]
        ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
        above = np.array([0, 0, self.cable_length])
        self.positions = attachments + (above + 0.2 * apart * ring)[:, None]
        swing = np.stack([-np.sin(angle), np.cos(angle), 0 * angle], axis=1)
        self.velocities = np.repeat(1.5 * self.bound * swing[:, None], n, axis=1)
        self.reference = np.zeros((SAMPLES, 22))
        self.reference[:, 0] = 1
        self.reference[:, 4:7] = rng.normal(size=3)
        self.positions += self.reference[0, 4:7]
        self.load = self.reference[:, :13].copy()
        self.tensions = rng.uniform(0.2, 0.5, (SAMPLES, n)) * 9.81
        self.forces = rng.normal(size=(SAMPLES, 3 * n))
        system = SystemParameters(attachments=attachments.tolist(), cable_length=self.cable_length)
        self.scenario = with_obstacles(Scenario(system=system), "!Ground {height: -1000}")
        self.scenario.optimization_layer.speed_bound = self.bound

    def some_time(self):
        """A few samples that follow each other."""
        start = self.rng.integers(1, SAMPLES - 10)
        return slice(start, start + self.rng.integers(2, 9))

    def two_carriers(self):
        return self.rng.choice(self.n, 2, replace=False)

    def run(self):
        return made_up(
            self.scenario,
            self.time,
            (self.positions, self.velocities),
            self.load,
            self.reference,
            signals={
                "optimization_layer.parameters": np.ones((SAMPLES, 2)),
                "carrier_controller.carrier_forces": self.forces,
            },
            steps={"tensions": self.tensions, "command_saturation": self.saturated},
            stopped=self.stopped,
            unresolved=self.unresolved,
        )


def load_far_off(made):
    direction = made.rng.normal(size=3)
    distance = made.rng.uniform(1.01, 20) * 0.2 * made.reach
    made.load[made.some_time(), 4:7] += distance * direction / np.linalg.norm(direction)


def turn_of_load(made, axis):
    half = made.rng.uniform(1.01 * 0.8, np.pi) / 2
    made.load[made.some_time(), :4] = made.rng.choice([-1, 1]) * np.array(
        [np.cos(half), *(np.sin(half) * np.array(axis))]
    )


def load_tilted(made):
    angle = made.rng.uniform(0, 2 * np.pi)
    turn_of_load(made, [np.cos(angle), np.sin(angle), 0])


def load_turned(made):
    turn_of_load(made, [0, 0, 1])


def carriers_meet(made):
    i, j = made.two_carriers()
    gap = made.rng.uniform(0, 0.99) * made.scenario.limits.carrier_distance * made.reach
    when = made.some_time()
    made.positions[when, i] = made.positions[when, j] + [0, 0, gap]


def cables_cross(made):
    i, j = made.two_carriers()
    when = made.some_time()
    made.positions[when, [i, j]] = made.positions[when, [j, i]]


def tower_hit(made):
    place = made.load[made.some_time().start, 4:7].tolist()
    tower = f"!Sphere {{name: tower, position: {place}, radius: 0.001}}"
    made.scenario = with_obstacles(made.scenario, "!Ground {height: -1000}", tower)


def cable_slack(made):
    made.tensions[made.some_time(), made.rng.integers(made.n)] = 0


def cable_broken(made):
    breaking_load = 1.6e9 * np.pi / 4 * made.scenario.system.cable_diameter**2
    tension = breaking_load * made.rng.uniform(1.001, 3)
    made.tensions[made.some_time(), made.rng.integers(made.n)] = tension


def carrier_slow(made):
    made.velocities[made.some_time(), made.rng.integers(made.n)] *= made.rng.uniform(0, 0.66)


def commands_saturated(made):
    start = made.rng.integers(0, SAMPLES // 2)
    made.saturated[start : start + made.rng.integers(8, 20), made.rng.integers(3 * made.n)] = 1


def unresolved(made):
    made.unresolved = ("the slowest speed moves by 20 % with half the step",)


def stopped(made):
    made.stopped = "the run diverged at t = 1.0000 s"


# What each fault makes of a run, and what a reason names: a field, or a body.
FAULTS = {
    stopped: (RunOutcome.STOPPED, "the run diverged at t = 1.0000 s"),
    cable_broken: (RunOutcome.CABLE_BROKEN, " 1257 N (system.cable_breaking_load)"),
    load_far_off: (RunOutcome.LOAD_LOST, "(limits.position_error: "),
    load_tilted: (RunOutcome.LOAD_LOST, "(limits.tilt_error: "),
    load_turned: (RunOutcome.LOAD_LOST, "(limits.yaw_error: "),
    carriers_meet: (RunOutcome.COLLISION, "(limits.carrier_distance: "),
    cables_cross: (RunOutcome.COLLISION, "(limits.cable_distance: "),
    tower_hit: (RunOutcome.COLLISION, " hit tower at t = "),
    cable_slack: (RunOutcome.CABLES_SLACK, "(limits.slack_time: "),
    carrier_slow: (RunOutcome.BOUND_MISSED, "(limits.time_below_bound: "),
    commands_saturated: (RunOutcome.LIMIT_MISSED, "(limits.saturated_share: "),
    unresolved: (RunOutcome.UNCONVERGED, "half the step"),
}


@settings(max_examples=30, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 2**32),
    n=st.integers(3, 8),
    size=st.sampled_from([0.05, 1.0, 80.0]),
    faults=st.sets(st.sampled_from(list(FAULTS))),
)
def test_the_outcome_is_the_worst_of_all_faults_and_each_is_said(seed, n, size, faults):
    made = MadeUpRun(np.random.default_rng(seed), n, size)
    present = [fault for fault in reversed(FAULTS) if fault in faults]
    for fault in present:  # carriers meet last: one that crosses another may then meet it
        fault(made)
    metrics = compute_metrics(made.run())
    reasons = metrics["reasons"]
    outcomes = [outcome for outcome in RunOutcome if outcome in [FAULTS[f][0] for f in faults]]
    assert metrics["outcome"] == (outcomes[0].value if outcomes else "ok")
    assert bool(reasons) == bool(faults)
    for fault in faults - ({cables_cross} if carriers_meet in faults else set()):
        assert any(FAULTS[fault][1] in reason for reason in reasons), (fault, reasons)
    if faults:
        assert any(
            said in reasons[0] for outcome, said in FAULTS.values() if outcome == outcomes[0]
        )
    assert json.loads(json.dumps(metrics, allow_nan=False))["outcome"] == metrics["outcome"]


def everything_stated():
    """A run in which every quantity that is bounded is above zero, of a scenario that has all."""
    made = MadeUpRun(np.random.default_rng(8))
    for fault in (load_far_off, load_tilted, cable_slack, carrier_slow, commands_saturated):
        fault(made)
    made.load[0, :4] = np.cos(0.5), 0, 0, np.sin(0.5)
    made.tensions += 0.1  # but for the tensions, whose least must be above zero
    return made


@pytest.mark.parametrize("limit", LIMITS, ids=lambda limit: limit.path)
def test_each_limit_is_kept_up_to_it_and_missed_beyond(limit):
    made = everything_stated()
    if limit.path == "limits.slack_time":
        made.tensions[5:9] = 0
    run = made.run()
    if limit.measure(RunQuantities(run)) is None:
        run = aircraft_run(3.0)
    value = limit.measure(RunQuantities(run))
    assert value > 0
    *parents, name = limit.path.split(".")
    owner = attrgetter(".".join(parents))(run.scenario)
    exact = value / limit.share_of(RunQuantities(run))
    is_least = re.search(r"\.min_|_distance|clearance", limit.path)
    within = [(1 - limit.tolerance / 2, True)] if limit.tolerance else []
    for factor, is_kept in ((1.01, True), *within, (0.99, False)):
        setattr(owner, name, exact * (1 / factor if is_least else factor))
        sentence = limit.complaint(RunQuantities(run))
        assert (sentence is None) == is_kept
        said = compute_metrics(run)["reasons"]
        assert any(f"({limit.path}: " in each for each in said) == (not is_kept)
    bound, unit = re.search(rf"\({limit.path}: ([^ )]+) ?(\w*)", sentence).groups()
    scale = math.radians(1) if unit == "deg" else 1
    stated = getattr(owner, name) * limit.share_of(RunQuantities(run))
    assert scale * float(bound) == pytest.approx(stated, rel=5e-3)


@pytest.mark.parametrize(
    ("moved", "reason"),
    [
        ("off", "limits.position_error: 1 m"),
        ("tilted", "limits.tilt_error: 15.0 deg"),
        ("turned", "limits.yaw_error: 15.0 deg"),
    ],
)
def test_loads_of_aircraft_are_lost_where_a_transport_fails(moved, reason):
    """Not at a fifth of 150 m and at 46 deg; a scenario may say otherwise."""
    run = aircraft_run(10.0)
    state = run.signal("load_state")
    if moved == "off":
        state[300:, 6] += 1.01
    else:
        state[300:, [0, 1 if moved == "tilted" else 3]] = np.cos(0.135), np.sin(0.135)
    metrics = compute_metrics(run)
    assert metrics["outcome"] == "load_lost"
    assert reason in metrics["reasons"][0]
    run.scenario.limits = RunLimits(position_error=0.2, tilt_error=0.8, yaw_error=0.8)
    assert compute_metrics(run)["outcome"] == "ok"


def test_reasons_have_the_numbers_behind_them():
    wind = "limits.position_error=1e-4 wind=SteadyWind wind.velocity=[2,0,0] wind_estimator=NoWind"
    for text, said in (
        ("quintic simulated.cable_length=[0.815,0.8,0.815,0.8]", "up to 7.5 mm beside the model"),
        (f"quintic {wind}", "the controllers missed 2 m/s of the wind"),
        ("aircraft_rest system.aircraft.max_thrust=[30,-1,0]", "most of all the thrust of"),
    ):
        name, *overrides = f"{text} simulation_duration=2 {CONSTANT}".split()
        assert said in str(compute_metrics(simulate(load_scenario(name, overrides)))["reasons"])


@pytest.mark.parametrize("after", [0.0, 0.1, 0.2])
def test_a_run_that_is_ended_before_its_time_has_stopped(after):
    def end(simulator, nonstop):
        is_late = simulator.get_context().get_time() > after - 1e-9
        return StepAction.END if is_late else StepAction.CONTINUE

    run = simulate(load_scenario("line", ["simulation_duration=0.2", CONSTANT]), after_step=end)
    metrics = compute_metrics(run)
    assert metrics["outcome"] == ("ok" if after == 0.2 else "stopped")
    assert after == 0.2 or f"t = {after:.2f}" in metrics["reasons"][0]


def test_a_run_that_stopped_at_once_has_an_outcome_and_no_values():
    run = MadeUpRun(np.random.default_rng(1)).run()
    nothing = {
        "time": run.time[:0],
        "signals": {name: values[:0] for name, values in run.signals.items()},
        "steps": {name: values[:0] for name, values in run.steps.items()},
    }
    metrics = compute_metrics(dataclasses.replace(run, stopped="it", **nothing))
    assert (metrics["outcome"], metrics["reasons"]) == ("stopped", ["it"])
    assert metrics["carriers"]["speed_min_m_s"] is None
    assert metrics_table(metrics)
