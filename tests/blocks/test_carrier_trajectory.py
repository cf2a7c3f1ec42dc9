"""The carrier trajectories, on the desired and on the measured pose."""

import itertools
import math

import numpy as np
import pytest
from helpers import Motion, difference, fix, model, output, regular
from pydrake.polynomial import Polynomial
from pydrake.systems.framework import LeafSystem
from pydrake.trajectories import PiecewisePolynomial

from drake_nonstop import simulate
from drake_nonstop.blocks.along_trajectory import LoadTrajectory
from drake_nonstop.blocks.carrier_controller import (
    TunedFeedforwardCarrierPid,
)
from drake_nonstop.blocks.carrier_trajectory import (
    CarrierTrajectory,
    CarrierTrajectoryConfig,
)
from drake_nonstop.blocks.load_feedback import DesiredStateFeedback
from drake_nonstop.blocks.load_trajectory import (
    ConstantVelocityMoveConfig,
    RestToRestConfig,
    SteadyTurnConfig,
)
from drake_nonstop.blocks.optimization_layer import ConstantParametersConfig
from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.model.pattern import (
    CarouselConfig,
    ConstantSpreadConfig,
    EllipticCarouselConfig,
)
from drake_nonstop.model.system import SystemParameters
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.systems.compiled_loop import CompiledLoop

SIGNALS = {"measured_load_state": Motion(3).state(0.3), "reference": Motion(4).reference(0.3)}


def carried(block, pose):
    context = block.CreateDefaultContext()
    pulls = {"desired_cable_forces": np.tile([0.3, -0.2, 2.5], 4)}
    fix(block, context, **pose, **pulls, desired_cable_force_rates=np.full(12, 0.1))
    return output(block, context, "carrier_reference")


def test_references_move_against_the_measured_error():
    """By a shift and at its velocity, as if the load's reference were moved."""
    rates, shift = np.array([0.1, 0.0, 0.3]), np.array([0.02, 0.0, -0.04])
    desired, seen = SIGNALS["reference"], SIGNALS["measured_load_state"]
    block = CarrierTrajectory(model(), CarrierTrajectoryConfig(correction_rates=rates.tolist()))
    context = block.CreateDefaultContext()
    context.SetContinuousState(shift)
    pulls = {"desired_cable_forces": np.tile([0.3, -0.2, 2.5], 4)}
    fix(block, context, **SIGNALS, **pulls, desired_cable_force_rates=np.full(12, 0.1))
    velocity = rates * (desired[4:7] - seen[4:7])
    np.testing.assert_allclose(block.EvalTimeDerivatives(context).CopyToVector(), velocity)
    moved = desired.copy()
    moved[4:7] += shift
    moved[10:13] += velocity
    np.testing.assert_allclose(
        output(block, context, "carrier_reference"),
        carried(CarrierTrajectory(model()), {"reference": moved}),
        rtol=1e-12,
    )


DERIVATIVES = ("carrier_reference_acceleration", "carrier_reference_jerk")


class SteadyJerk(LeafSystem):
    """A reference without rotation whose jerk is constant."""

    def __init__(self, model):
        super().__init__()
        self.DeclareVectorOutputPort("reference", 22, self._calc)

    def _calc(self, context, reference):
        time, jerk = context.get_time(), np.array([0.3, -0.5, 0.2])
        motion = [jerk * time**3 / 6, jerk * time**2 / 2, jerk * time, jerk]
        position, velocity, acceleration, jerk = motion
        pose = [1, 0, 0, 0, *position, 0, 0, 0, *velocity]
        reference.SetFromVector([*pose, 0, 0, 0, *acceleration, *jerk])


def carriers_at(diagram, context, time, names=("carrier_reference", *DERIVATIVES)):
    """Signals of a loop with constant ξ = 2 rad/s at a time, the load on its reference."""
    context.SetTime(time)
    phase = diagram.GetSubsystemByName("phase").GetMyMutableContextFromRoot(context)
    phase.SetContinuousState([2.0 * time, *np.zeros(7)])  # ξ and A have not started to change
    return [output(diagram, context, name) for name in names]


def loop_on_its_reference(**boxes):
    """A loop whose controllers take the load to be on its reference, and its context."""
    fields = {name: boxes.pop(name) for name in ("pattern", "system") if name in boxes}
    scenario = Scenario(control_period=0.0, **fields)
    amplitude = 0.0 if isinstance(scenario.pattern, ConstantSpreadConfig) else 1.2
    layer = ConstantParametersConfig(frequency=2.0, amplitude=amplitude)
    ends = {"load_feedback": DesiredStateFeedback, "optimization_layer": layer}
    diagram = make_nonstop(scenario, **ends, **boxes)
    return diagram, diagram.CreateDefaultContext()


ELLIPSES = EllipticCarouselConfig(
    spread=1.5,
    phase_turns=2,
    radial=0.6,
    tangential=0.9,
    vertical=0.7,
)
INERTIA_OF_A_BOX = [[0.014, 0.001, -0.0005], [0.001, 0.011, 0.002], [-0.0005, 0.002, 0.017]]
TURN = SteadyTurnConfig(yaw_rate=1.3, start_roll_pitch_yaw=[0.2, -0.1, 0.4])


@pytest.mark.parametrize(
    "boxes",
    [
        {"pattern": ELLIPSES, "load_trajectory": SteadyJerk},
        {"pattern": ELLIPSES, "load_trajectory": TURN},
        {"pattern": ConstantSpreadConfig(spread=2.0), "load_trajectory": TURN},
    ],
    ids=["ellipses", "ellipses on a turning load", "turning load"],
)
def test_derivatives_are_exact_for_ellipses_and_for_a_turning_load(boxes):
    system = SystemParameters(load_inertia=INERTIA_OF_A_BOX, load_angular_drag=0.1)
    controller = TunedFeedforwardCarrierPid
    diagram, context = loop_on_its_reference(system=system, carrier_controller=controller, **boxes)
    for time in (0.3, 1.1):
        motion, acceleration, jerk = carriers_at(diagram, context, time)
        velocity = difference(lambda t: carriers_at(diagram, context, t)[0][12:], time)
        np.testing.assert_allclose(acceleration, velocity, rtol=0, atol=1e-8)
        expected = difference(lambda t: carriers_at(diagram, context, t)[1], time)
        np.testing.assert_allclose(jerk, expected, rtol=0, atol=1e-8)
        if isinstance(boxes["load_trajectory"], SteadyTurnConfig):
            set_carriers(diagram, context, motion)
            (forces,) = carriers_at(diagram, context, time, ["carrier_forces"])
            np.testing.assert_allclose(
                forces, system.carrier_mass * acceleration, rtol=0, atol=1e-9
            )


def set_carriers(diagram, context, motion):
    """Sets the carriers to their references."""
    block = diagram.GetSubsystemByName("carrier_dynamics")
    own = block.GetMyMutableContextFromRoot(context)
    own.SetContinuousState(motion)
    shown = output(diagram, context, "carrier_state")
    np.testing.assert_array_equal(shown, motion)


def mistakes(diagram, context, time):
    """The largest of the carriers' accelerations, by differences of velocities and positions."""

    def position(time):
        return carriers_at(diagram, context, time)[0][:12]

    _, acceleration, _ = carriers_at(diagram, context, time)
    by_velocities = difference(lambda t: carriers_at(diagram, context, t)[0][12:], time)
    by_positions = difference(lambda t: difference(position, t), time)
    return [np.max(np.abs(acceleration - rate)) for rate in (by_velocities, by_positions)]


LINE = ConstantVelocityMoveConfig(start_time=1.0)


@pytest.mark.parametrize(
    "move",
    [
        LINE,
        RestToRestConfig(displacement=[1.0, -1.0, 0.5], move_time=4.0, blend="c4"),
    ],
    ids=["line", "septic"],
)
def test_accelerations_have_the_snap_of_the_reference_in_them(move):
    diagram, context = loop_on_its_reference(load_trajectory=move)
    for time in (0.8, 1.2, 5.0):
        assert max(mistakes(diagram, context, time)) < 1e-8


@pytest.mark.parametrize("n", [3, 5])
def test_carousel_over_a_resting_load_in_closed_form(n):
    attachments = regular(n)
    system = SystemParameters(attachments=attachments.tolist())
    diagram, context = loop_on_its_reference(pattern=CarouselConfig(), system=system)
    share = system.load_mass * system.gravity / n
    tension = math.hypot(share, 1.2)
    height = (system.cable_length + tension / system.cable_stiffness) * share / tension
    for time in (0.0, 1.7):
        motion, acceleration, jerk = carriers_at(diagram, context, time)
        positions, velocities = np.split(motion, 2)
        from_centre = positions - (attachments + np.array([0, 0, height])).ravel()
        np.testing.assert_allclose(acceleration, -(2.0**2) * from_centre, rtol=0, atol=1e-12)
        np.testing.assert_allclose(jerk, -(2.0**2) * velocities, rtol=0, atol=1e-12)


AIRCRAFT = ["simulation_duration=0.2", "carrier_trajectory=!BowedCarrierTrajectory {nodes: 2}"]


@pytest.mark.slow
def test_references_on_lines_without_mass_and_drag_are_straight():
    """At the start of a turning load, and of one that is carried."""
    for name, allowed in (("aircraft_co_rotating", 1e-8), ("aircraft_transfer", 2e-4)):
        found = []
        for changes in ([], [AIRCRAFT[1], "system.cable_diameter=0"]):
            diagram = make_nonstop(load_scenario(name, changes))
            context = diagram.CreateDefaultContext()
            found.append([output(diagram, context, n) for n in ("carrier_reference", *DERIVATIVES)])
        for straight, bowed, factor in zip(*found, (1, 10, 100), strict=True):
            np.testing.assert_allclose(bowed, straight, rtol=0, atol=factor * allowed)


def turning_path():
    """A motion with constant angular jerk, about the vertical, and constant snap."""
    rows = np.zeros((6, 5))
    rows[2:] = [
        [0.3, 0.25, 0.1, 0.06, 0.0],
        [0.0, 0.2, -0.1, 0.05, 0.02],
        [0.1, -0.1, 0.05, 0.04, -0.015],
        [1.0, 0.1, 0.02, -0.03, 0.01],
    ]
    return PiecewisePolynomial([np.array([[Polynomial(row)] for row in rows])], [0.0, 3.0])


def test_between_samples_accelerations_are_the_rates_of_velocities():
    changes = ["optimization_layer=ConstantParameters", "control_period=0.05"]
    run = simulate(load_scenario("quintic", [*changes, "simulation_duration=0.2"]))
    velocity = np.split(run.signal("carrier_reference"), 2, axis=1)[1]
    for k in (2, 3, 7, 8, 12, 13):  # exact, at a constant jerk
        mean = (velocity[k + 1] - velocity[k - 1]) / 0.02
        acceleration = run.signal("carrier_reference_acceleration")[k]
        np.testing.assert_allclose(acceleration, mean, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("changes", [[], ["optimization_layer=ConstantParameters"]])
def test_flown_references_have_the_differences_of_those_below_as_rates(changes):
    """Of sixth order, before the first replan; on a load that turns faster and faster."""
    scenario = load_scenario("quintic", ["load_feedback=DesiredStateFeedback", *changes])
    path = turning_path()
    diagram = make_nonstop(scenario, load_trajectory=lambda _: LoadTrajectory(path))
    loop = CompiledLoop(diagram, scenario.simulator_config, 0.01, compiles=False)
    _, rows = loop.run(diagram.CreateDefaultContext(), 0.35)
    motion = rows["sampled_carrier_reference"][1:]
    found = *np.split(motion, 2, axis=1), rows["sampled_carrier_reference_acceleration"][1:]
    weights = np.array([-1.0, 9, -45, 0, 45, -9, 1]) / 60
    for below, rate in itertools.pairwise((*found, rows["carrier_reference_jerk"][1:])):
        windows = np.lib.stride_tricks.sliding_window_view(below, 7, axis=0)
        expected = windows @ weights / 0.01
        np.testing.assert_allclose(rate[3:-3], expected, rtol=0, atol=1e-6 * np.max(np.abs(rate)))
