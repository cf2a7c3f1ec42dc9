"""The measured margin: its law, and what it keeps where the model is wrong."""

import numpy as np
import pytest
from helpers import nightly_beyond

from drake_nonstop import load_scenario, simulate
from drake_nonstop.mechanics.planned_orbit import OrbitMotion
from drake_nonstop.planning.measured_margin import (
    NOTHING_MEASURED,
    deviations_of,
    margin_after,
    margin_at_next_plan,
)
from drake_nonstop.run.run_quantities import RunQuantities

PERIOD, BOUND = 0.01, np.array([0.5])


def after(margin, deviation, samples=1):
    for _ in range(samples):
        margin = margin_after(margin, np.array([0.0, deviation]), BOUND, PERIOD)
    return margin


def test_a_margin_rises_at_once_and_falls_as_what_was_measured_decays():
    assert after(NOTHING_MEASURED, 0.007)[1] == 0.02  # 5/4 of it are below 2 % of 0.5 m/s
    risen = after(NOTHING_MEASURED, 0.1, 12)
    assert risen[1] == pytest.approx(0.26)  # the first step beyond 5/4 · 0.1 m/s, of 0.5 m/s
    assert after(risen, 0.0, 2000)[0] == pytest.approx(risen[0] / np.e, rel=1e-6)
    fallen = [after(risen, 0.0, count)[1] for count in (50, 2000, 10_000)]
    needed = [1.25 * after(risen, 0.0, count)[0] / 0.5 for count in (50, 2000)]
    assert fallen[0] == pytest.approx(0.26)
    assert needed[1] <= fallen[1] <= needed[1] + 0.03 + 1e-9
    assert fallen[2] == pytest.approx(0.02)
    assert after(NOTHING_MEASURED, 10.0, 1000)[1] == pytest.approx(2.0)


def test_plans_reach_a_margin_that_has_risen_in_steps_and_one_that_has_fallen_at_once():
    reached = margin_at_next_plan(np.array([0.1, 0.32, 0.02]))
    assert reached == pytest.approx([0.1, 0.32, 0.12])
    assert margin_at_next_plan(np.array([0.1, 0.06, 0.3]))[2] == pytest.approx(0.06)


def test_what_a_carrier_lags_behind_on_its_path_is_no_deviation():
    velocities, accelerations = np.random.default_rng(3).normal(size=(2, 1, 4, 3))
    none = np.zeros((1, 4, 3))
    motion = OrbitMotion(none, none, velocities, accelerations)
    late = velocities[0] - 0.04 * accelerations[0]
    assert deviations_of(motion, late) == pytest.approx(np.zeros(4), abs=1e-9)
    across = np.cross(accelerations[0], [0.3, 1.0, -0.2])
    assert deviations_of(motion, late + across) == pytest.approx(np.linalg.norm(across, axis=1))


NOISE = (
    "load_feedback=!NoisyFeedback {position_noise: 0.0005, velocity_noise: 0.002, "
    "orientation_noise: 0.0005, angular_velocity_noise: 0.002, seed: %d}"
)
FILTERED = "load_feedback=!FilteredFeedback {position_noise: 0.0005, velocity_noise: 0.002}"


def shifted(name, axis, share):
    attachments = np.array(load_scenario(name).system.attachments)
    attachments[:, axis] += share * np.ptp(attachments[:, axis])
    return f"simulated.attachments={attachments.tolist()}"


def wrong_models():
    cases = [("quintic", NOISE % 1), ("line", shifted("line", 0, -0.1))]
    cases += [("quintic", NOISE % k) for k in range(10)]
    for name in ("quintic", "line", "three_carriers"):
        system = load_scenario(name).system
        for field, shares in (("load_mass", (0.7, 1.3)), ("cable_length", (0.99, 1.01))):
            value = getattr(system, field)
            cases += [(name, f"simulated.{field}={share * value}") for share in shares]
        cases += [(name, shifted(name, axis, share)) for axis in (0, 1) for share in (0.1, -0.1)]
    return [*dict.fromkeys(cases)]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "override"), nightly_beyond(1, "studies", wrong_models()))
def test_carriers_stay_above_the_bound_where_the_model_is_wrong(name, override):
    others = [] if "load_feedback" in override else [FILTERED]
    quantities, right = (
        RunQuantities(simulate(load_scenario(name, own))) for own in ([override, *others], [])
    )
    assert quantities.time_below_bound <= 0.02
    assert np.max(quantities.speeds) <= 1.6 * np.max(right.speeds)
