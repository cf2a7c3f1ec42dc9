"""Growth of a load's small deviations on ideally tracked carriers."""

import dataclasses
import functools
import math

import numpy as np
import pytest
from drawn_tasks import carriers_task
from helpers import nightly_beyond, regular

from drake_nonstop.analysis import formation
from drake_nonstop.analysis.formation import (
    cable_loads,
    find_formation,
    find_formation_remedies,
    formation_at,
    growth_complaint,
)
from drake_nonstop.analysis.load_stability import LoadDeviations
from drake_nonstop.analysis.sampled_growth import SampledGrowth, growth_on_the_way, sampled_rate
from drake_nonstop.analysis.task import task_of
from drake_nonstop.mechanics.signals import LoadReference
from drake_nonstop.mechanics.wrench import FEEDBACK_GAINS, NO_FEEDBACK
from drake_nonstop.model.pattern import CarouselConfig, HamiltonianCycleConfig
from drake_nonstop.model.system import Model, SystemParameters
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.studies.stability import at_rest, linearize
from drake_nonstop.validation import ScenarioError

GRAVITY = 9.81
REST = np.eye(22)[0]
# Four cables of 3 m, unstable by themselves, of a draw.
UNSTABLE = [
    "system.attachments=[[1.1866, 0.0175, 0.0368], [0.1885, 0.9898, -0.0953], "
    "[-0.9959, 0.2208, 0.1383], [-0.2304, -1.133, -0.0095]]",
    "system.load_mass=1.8095",
    "system.cable_length=2.9561",
    "pattern=!HamiltonianCycle {}",
    "optimization_layer.frequency=2.3732",
    "optimization_layer.amplitude=2.0813",
    *(f"wrench_controller.{name}=0" for name in FEEDBACK_GAINS),
]


# Six cables that lean the same way, whose samples make the load's fast rotation grow.
CAROUSEL = [
    f"system.attachments={np.round(regular(6, 0.95), 3).tolist()}",
    "system.cable_length=1.82",
    "system.load_mass=1.01",
    "system.load_inertia=[[0.24, 0, 0], [0, 0.24, 0], [0, 0, 0.48]]",
    "pattern=Carousel",
    "optimization_layer.frequency=1.82",
    "optimization_layer.amplitude=0.742",
]


@functools.cache
def drawn(seed):
    return task_of(carriers_task(seed))


@pytest.fixture(scope="module")
def unstable():
    return load_scenario("quintic", UNSTABLE)


@pytest.mark.parametrize("n", nightly_beyond(1, "studies", [4, 3, 6]))
def test_a_load_on_long_even_cables_swings_as_a_damped_pendulum(n):
    """Drag B on a mass m makes all swinging in x and y decay by B / 2m, of the slowest modes."""
    mass, drag, length = 2.0, 0.5, 4.0
    system = SystemParameters(
        load_mass=mass, load_drag=drag, cable_length=length, attachments=regular(n, 1.0).tolist()
    )
    model = Model(system, HamiltonianCycleConfig())
    found = LoadDeviations(model).growth(REST, np.array([2.0, 0.01]))
    rates = np.log(np.abs(found.multipliers)) / found.period
    is_swing = np.abs(rates + drag / (2 * mass)) < 2e-3
    assert is_swing.sum() >= 4
    turns = np.angle(found.multipliers[is_swing])
    expected = math.sqrt(GRAVITY / length - (drag / (2 * mass)) ** 2) * found.period
    nearest = np.abs(np.cos(turns) - math.cos(expected))
    assert np.sort(nearest)[:4].max() < 0.05


def test_growth_without_control_is_that_of_the_whole_loop_and_of_a_run(unstable):
    """1.083 by `studies.stability.linearize`; 1.136 of a run that begins 1 mm beside, in 6 s."""
    task = task_of(unstable)
    quick = task.deviations.growth(REST, task.nominal)
    assert quick.rate == pytest.approx(1.083, rel=0.02)
    assert quick.rate == pytest.approx(1.136, rel=0.1)


def test_growth_on_unlike_cables_is_that_of_the_whole_loop():
    scenario = load_scenario("quintic", [*UNSTABLE, "system.cable_length=[1.2, 3.6, 1.5, 4.0]"])
    task = task_of(scenario)
    found = task.deviations.growth(REST, task.nominal).rate
    assert found == pytest.approx(linearize(at_rest(scenario)).rate, rel=0.02)
    assert found < 0.4  # 1.083 with cables of 2.9561 m


def test_the_integral_of_the_position_stays_while_the_axes_turn():
    """That of the attitude is in L, which turns with them."""
    reference, rate = REST.copy(), np.array([0.1, -0.2, 0.7])
    LoadReference.view(reference).angular_velocity[:] = rate
    deviations = LoadDeviations(Model(SystemParameters(), CarouselConfig()))
    (jacobian,) = deviations.jacobians(reference, np.array([2.0, 1.0]), np.zeros(1), NO_FEEDBACK)
    own = [jacobian[start : start + 3, start : start + 3] for start in (12, 15)]
    vector = np.array([0.3, 0.5, -0.4])
    np.testing.assert_allclose(own[0] @ vector, 0, atol=1e-15)
    np.testing.assert_allclose(own[1] @ vector, np.cross(vector, rate), rtol=1e-12)


def test_shares_and_elevations_of_a_carousel_are_those_of_its_cones():
    amplitude, mass = 1.5, 1.3
    system = SystemParameters(load_mass=mass, attachments=regular(5, 0.8).tolist())
    loads = cable_loads(Model(system, CarouselConfig()), REST, np.array([2.0, amplitude]))
    np.testing.assert_allclose(loads.shares, 1, rtol=1e-9)
    np.testing.assert_allclose(
        loads.elevations, math.atan2(mass * GRAVITY / 5, amplitude), rtol=1e-9
    )
    assert loads.least_tension == pytest.approx(math.hypot(mass * GRAVITY / 5, amplitude))


@pytest.mark.parametrize("mass", [1.0, 1.1])
def test_cables_carry_the_simulated_load(mass):
    """Without internal forces four cables are vertical."""
    task = task_of(load_scenario("quintic", [f"simulated.load_mass={mass}"]))
    at_rest = formation_at(task, 0.0, np.array([2.0, 0.0]))
    assert at_rest.loads.least_tension == pytest.approx(mass * task.model.gravity / 4, rel=1e-9)


@pytest.mark.parametrize(
    ("feedback", "is_measured"),
    [("IdealFeedback", True), ("DesiredAttitudeFeedback", False), ("DesiredStateFeedback", False)],
)
def test_the_attitude_of_a_task_is_fed_back_where_it_is_measured(feedback, is_measured):
    task = task_of(load_scenario("quintic", [f"load_feedback={feedback}"]))
    gains = dict(task.response.feedback.gains)
    for name in ("orientation_gain", "angular_velocity_gain"):
        other = gains | {name: 2 * np.asarray(gains[name])}
        own, changed = (
            task.deviations.jacobians(REST, task.nominal, np.zeros(1), each)
            for each in (gains, other)
        )
        assert (np.max(np.abs(own - changed)) > 1e-3) == is_measured


def test_what_is_named_against_an_unstable_formation_makes_it_stable(unstable, monkeypatch):
    """Growth in the samples, which has tests of its own, takes most of the time."""
    calm = SampledGrowth(0.0, 0.0, 0.0)
    monkeypatch.setattr(formation, "growth_on_the_way", lambda *arguments: calm)
    task = task_of(unstable)
    found = find_formation(task, count=1)
    assert not found.is_stable
    named = find_formation_remedies(task, found)
    assert any(text.startswith("pattern=LinearPattern") for text in named)
    (amplitude,) = (text for text in named if text.startswith("optimization_layer.amplitude"))
    changed = task_of(load_scenario("quintic", [*UNSTABLE, amplitude]))
    assert find_formation(changed, count=1).is_stable


def test_the_complaint_at_the_start_has_rate_and_remedy(unstable):
    task = task_of(unstable)
    said = growth_complaint(task, 10.0)
    assert said.startswith("formation = unstable: ")
    assert "1.1 1/s; give optimization_layer.amplitude of at most 0." in said
    assert growth_complaint(task, 0.5) == ""  # it has no time to grow
    assert growth_complaint(task_of(load_scenario("quintic")), 100.0) == ""


def test_a_load_too_light_for_its_cables_is_refused():
    task = task_of(load_scenario("quintic", ["system.load_mass=1e-6"]))
    with pytest.raises(ScenarioError, match=r"^fastest mode .* heavier load"):
        find_formation(task, count=1)


def test_what_grows_in_samples_is_what_the_exact_maps_of_the_loop_tell():
    """Commands are half a sample behind cables that turn; a continuous controller hides it."""
    scenario = load_scenario("quintic", [*CAROUSEL, "simulator_config.max_step_size=5e-4"])
    task = task_of(scenario)
    rate = sampled_rate(task)
    assert rate > 0.8
    assert rate == pytest.approx(linearize(scenario).rate, rel=0.01)
    formation = find_formation(task, count=1)
    assert formation.growth < 1
    assert formation.is_lost_in_samples


def test_a_load_at_rest_grows_on_its_way_by_its_rate():
    task = task_of(at_rest(load_scenario("quintic", CAROUSEL)))
    turn = 2 * math.pi / task.limits.frequency
    planned = functools.partial(task.planned, None)
    shorter, longer = (
        growth_on_the_way(dataclasses.replace(task, duration=turns * turn), planned, phases=96)
        for turns in (3, 6)
    )
    rate = sampled_rate(task)
    assert longer.growth - shorter.growth == pytest.approx(rate * 3 * turn, rel=0.05)
    assert longer.start < turn < 5.5 * turn < longer.end


@pytest.mark.nightly("studies")
def test_a_diverged_run_is_told_of_its_samples():
    task = drawn(30)
    said = growth_complaint(task, task.duration, in_samples=True)
    assert said.startswith("formation = unstable: in the samples of the controllers")
    assert growth_complaint(task, task.duration) == ""


@pytest.mark.parametrize(
    ("seed", "is_lost", "count"),
    nightly_beyond(1, "studies", [(1010, False, 1), (30, True, 4), (1010, False, 4)]),
)
def test_a_loop_that_its_samples_make_unstable_is_told(seed, is_lost, count):
    """The flight of the drawn task 30 ends with a lost load."""
    found = find_formation(drawn(seed), count=count)
    assert found.growth < 1
    assert found.is_lost_in_samples == is_lost
    assert found.is_stable != is_lost
