"""Each equation runs on floats, AutoDiffXd, Expression and CasADi's SX, to equal values."""

import numpy as np
import pytest
from helpers import GAINS, INERTIA, spatial
from pydrake.autodiffutils import ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.symbolic import Expression, MakeVectorVariable

from drake_nonstop.mechanics import (
    aircraft,
    cable,
    carrier,
    grasp,
    internal_force,
    load_motion,
    nonstop,
    rigid_load,
    rotation,
    shaping,
    taylor,
    wrench,
)
from drake_nonstop.mechanics.signals import PlannedParameters
from drake_nonstop.systems.tracing import TracedFunction

N = 3
ATTACHMENTS = spatial(N)
BASIS = internal_force.hamiltonian_cycle(ATTACHMENTS)
PHASES = internal_force.even_phases(N)
GRASP = {
    "pseudo_inverse": np.linalg.pinv(grasp.grasp_matrix(ATTACHMENTS)),
    "basis": BASIS,
    "offset": BASIS @ np.array([0.2, 0.1, -0.3]),
}
LOAD = rigid_load.RigidLoad(mass=1.3, inertia=INERTIA, drag=0.7, gravity=9.81)
CABLES = {"attachments": ATTACHMENTS, "rest_length": 0.2}
CONTROL = {**GAINS, "feedforward": 1.0}

AIRCRAFT = aircraft.Aircraft(
    *(0.3, 0.05, 1.2, 0.2, 4.0, 1.3, 0.05, 0.06),
    *(np.array([8.0, -0.5, 0.0]), np.array([0.0, 0.0, -0.03])),
    *(0.2, 0.3, 0.4, 1.1, 0.4, 0.6, 1.2, 1e-3, 1.1, 3.0, 9.81),
)


def smoothed(stages, target):
    """Rates of three stages, and their values at the next sample."""
    stages = [stages[i : i + 1] for i in range(3)]
    poles = shaping.Smoothing(bandwidth=40.0, period=0.01)
    rate = poles.approach(stages[0], target)
    rates = [rate, *poles.stage_rates(*stages), *poles.rates(*stages, rate)]
    return (*rates, *poles.after(*stages, rate))


# name: (function of flat arrays, their lengths)
EQUATIONS = {
    "cross": (rotation.cross, [3, 3]),
    "components": (lambda a: tuple(rotation.components(a)), [3]),
    "absolute": (rotation.absolute, [4]),
    "skew": (rotation.skew, [3]),
    "vee": (lambda a: rotation.vee(a.reshape(3, 3)), [9]),
    "norm": (lambda a: rotation.norm(a.reshape(2, 3)), [6]),
    "rotation_matrix": (rotation.rotation_matrix, [4]),
    "quaternion_product": (rotation.quaternion_product, [4, 4]),
    "quaternion_conjugate": (rotation.quaternion_conjugate, [4]),
    "quaternion_rate": (rotation.quaternion_rate, [4, 3]),
    "rotate_quaternion": (rotation.rotate_quaternion, [4, 3]),
    "roll_pitch_yaw_to_quaternion": (rotation.roll_pitch_yaw_to_quaternion, [3]),
    "angular_velocity_of": (
        lambda *a: rotation.angular_velocity_of(taylor.Taylor.of_rates(*a)).rates,
        [3, 3, 3, 3],
    ),
    "grasp_matrix": (lambda b: grasp.grasp_matrix(b.reshape(-1, 3)), [9]),
    "cable_forces_and_rates": (
        lambda *a: grasp.cable_forces_and_rates(*a, **GRASP),
        [13, 6, 6, 2 * N],
    ),
    "internal_force": (lambda *a: internal_force.internal_force(*a, phases=PHASES), [2, 1]),
    "harmonics": (
        lambda planned: (
            internal_force.harmonics(*PlannedParameters.view(planned).series, phases=PHASES).rates
        ),
        [8],
    ),
    "smoothed": (smoothed, [3, 1]),
    "orbit_axes": (
        lambda basis, phases: internal_force.orbit_axes(basis.reshape(9, 3), phases),
        [27, 3],
    ),
    "load_acceleration": (lambda *a: rigid_load.load_acceleration(LOAD, *a), [13, 6, 3]),
    "load_state_rate": (
        lambda *a: rigid_load.load_state_rate(LOAD, *a, attachments=ATTACHMENTS),
        [13, 3 * N, 6, 3],
    ),
    "tracking_error": (wrench.tracking_error, [13, 22]),
    "wrench_and_rate": (
        lambda *a: wrench.wrench_and_rate(LOAD, *a, **CONTROL),
        [13, 22, 6, 3],
    ),
    "positive_part": (cable.positive_part, [4]),
    "cable_forces_and_tensions": (
        lambda *a: cable.cable_forces_and_tensions(*a, stiffness=500.0, damping=0.1, **CABLES),
        [13, 6 * N],
    ),
    "carrier_motion": (
        lambda reference, *pulls: tuple(
            carrier.carrier_motion(
                reference, *(pull.reshape(-1, 3) for pull in pulls), compliance=0.002, **CABLES
            )
        ),
        [22, 3 * N, 3 * N, 3 * N, 3 * N],
    ),
    "forces_along": (
        lambda reference, higher_rates, forces, rates, *orbit: (
            grasp.forces_along(
                LOAD,
                load_motion.LoadMotion.along(reference, higher_rates),
                forces.reshape(-1, 3),
                rates.reshape(-1, 3),
                *orbit,
                pseudo_inverse=GRASP["pseudo_inverse"],
                basis=BASIS,
            ).rates
        ),
        [22, 6, 3 * N, 3 * N, 2 * N, 3],
    ),
    "motion_after": (
        lambda motion, time, acceleration: (
            carrier.motion_after(motion, time),
            carrier.motion_after(motion, time, acceleration),
        ),
        [6 * N, 1, 3 * N],
    ),
    "pid_forces": (
        lambda *a: carrier.pid_forces(
            *a, position_gain=1000.0, velocity_gain=10.0, integral_gain=3.0
        ),
        [6 * N, 3 * N],
    ),
    "limited_acceleration": (lambda a: carrier.limited_acceleration(a, 0.8), [3 * N]),
    "limited_carrier_rate": (
        lambda *a: carrier.limited_carrier_rate(*a, max_acceleration=0.8, lag=0.1),
        [9 * N, 3 * N, 3 * N],
    ),
    "double_integrator_rate": (
        lambda *a: carrier.double_integrator_rate(*a, mass=0.1),
        [6 * N, 3 * N],
    ),
    "flight_rate": (
        lambda states, *others: aircraft.flight_rate(AIRCRAFT, states, *others),
        [12 * N, 3 * N, 3 * N, 3 * N],
    ),
    "flight_needs": (
        lambda *a: tuple(aircraft.flight_needs(AIRCRAFT, *(b.reshape(-1, 3) for b in a))),
        [6, 6, 6],
    ),
    "drawn_power": (lambda *a: aircraft.drawn_power(AIRCRAFT, *a), [N, N]),
    "shown_state": (lambda *a: aircraft.shown_state(AIRCRAFT, *a), [12 * N, 3 * N]),
    "phase_of": (nonstop.phase_of, [2, 2, 2]),
    "advanced_reference": (lambda x: nonstop.advanced_reference(x, 0.01), [22]),
    "change_cost": (
        lambda *a: nonstop.change_cost(
            *a,
            phases=PHASES,
            internal_force_weight=2.0,
            internal_force_rate_weight=3.0,
        ),
        [2, 2, 2],
    ),
}


def flat(outputs):
    """One flat array of an array or a tuple of arrays."""
    outputs = outputs if isinstance(outputs, tuple) else (outputs,)
    return np.concatenate([np.asarray(output).ravel() for output in outputs])


def split(vector, sizes):
    return np.split(vector, np.cumsum(sizes)[:-1])


@pytest.fixture(params=EQUATIONS, ids=EQUATIONS.keys())
def equation(request, rng):
    """An equation, the lengths of its inputs, values for them, and the result on floats."""
    function, sizes = EQUATIONS[request.param]
    values = rng.uniform(0.2, 1.5, sum(sizes)) * rng.choice([-1, 1], sum(sizes))
    return function, sizes, values, flat(function(*split(values, sizes)))


def compare(values, expected):
    scale = max(1.0, np.max(np.abs(expected)))
    np.testing.assert_allclose(values, expected, rtol=0, atol=1e-12 * scale)


def test_symbols_give_the_values_of_floats(equation):
    function, sizes, values, expected = equation
    # A symbol for every fourth entry of each input, and numbers for the others: expressions
    # in dozens of symbols take seconds to evaluate.
    variables = MakeVectorVariable(len(values), "x")
    starts = np.repeat(np.cumsum([0, *sizes[:-1]]), sizes)
    symbolic = (np.arange(len(values)) - starts) % 4 == 0
    inputs = np.array(
        [variables[i] if symbolic[i] else Expression(values[i]) for i in range(len(values))]
    )
    with np.errstate(invalid="ignore"):  # Drake's symbols raise the flag without a cause
        result = flat(function(*split(inputs, sizes))) + Expression(0.0)
    environment = dict(zip(variables, values, strict=True))
    compare([expression.Evaluate(environment) for expression in result], expected)


def test_autodiff_and_traced_functions_give_the_values_of_floats_and_one_gradient(equation):
    function, sizes, values, expected = equation
    result = flat(function(*split(InitializeAutoDiff(values)[:, 0], sizes)))
    compare(ExtractValue(result)[:, 0], expected)
    gradients = ExtractGradient(result)
    gradients = gradients if gradients.size else np.zeros((len(gradients), len(values)))
    for index, columns in enumerate(split(np.arange(len(values)), sizes)):
        traced = TracedFunction(function, sizes, name=lambda: "test", jacobian_of=index)
        *outputs, jacobian = traced(*split(values, sizes))
        compare(flat(tuple(outputs)), expected)
        compare(jacobian, gradients[:, columns])
    without = TracedFunction(function, sizes, name=lambda: "test")
    compare(flat(without(*split(values, sizes))), expected)
