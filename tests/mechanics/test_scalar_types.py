"""Equations that layers, start and search run, on floats, AutoDiffXd, Expression and CasADi's SX.

Those that blocks run are in blocks/test_contracts.py.
"""

import numpy as np
import pytest
from helpers import INERTIA
from pydrake.autodiffutils import ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.symbolic import Expression, MakeVectorVariable

from drake_nonstop.mechanics import aircraft, grasp, internal_force, nonstop, rigid_load, rotation
from drake_nonstop.mechanics.taylor import Taylor
from drake_nonstop.systems.tracing import TracedFunction

N = 3
LOAD = rigid_load.RigidLoad(mass=1.3, inertia=INERTIA, drag=0.7, gravity=9.81)
PHASES = internal_force.even_phases(N)
WEIGHTS = {"internal_force_weight": 2.0, "internal_force_rate_weight": 3.0}
AIRCRAFT = aircraft.Aircraft(
    *(0.3, 0.05, 1.2, 0.2, 4.0, 1.3, 0.05, 0.06),
    *(np.array([8.0, -0.5, 0.0]), np.array([0.0, 0.0, -0.03])),
    *(0.2, 0.3, 0.4, 1.1, 0.4, 0.6, 1.2, 1e-3, 1.1, 3.0, 9.81),
)

# name: (function of flat arrays, their lengths)
EQUATIONS = {
    "absolute": (rotation.absolute, [4]),
    "roll_pitch_yaw_to_quaternion": (rotation.roll_pitch_yaw_to_quaternion, [3]),
    "angular_velocity_of": (
        lambda *a: rotation.angular_velocity_of(Taylor.of_rates(*a)).rates,
        [3, 3, 3, 3],
    ),
    "grasp_matrix": (lambda b: grasp.grasp_matrix(b.reshape(-1, 3)), [9]),
    "orbit_axes": (lambda b, phases: internal_force.orbit_axes(b.reshape(9, 3), phases), [27, 3]),
    "load_acceleration": (lambda *a: rigid_load.load_acceleration(LOAD, *a), [13, 6, 3]),
    "flight_needs": (
        lambda *a: tuple(aircraft.flight_needs(AIRCRAFT, *(b.reshape(-1, 3) for b in a))),
        [6, 6, 6],
    ),
    "drawn_power": (lambda *a: aircraft.drawn_power(AIRCRAFT, *a), [N, N]),
    "phase_of": (nonstop.phase_of, [2, 2, 2]),
    "advanced_reference": (lambda x: nonstop.advanced_reference(x, 0.01), [22]),
    "change_cost": (lambda *a: nonstop.change_cost(*a, phases=PHASES, **WEIGHTS), [2, 2, 2]),
}


def flat(outputs):
    """One flat array of an array or a tuple of arrays."""
    outputs = outputs if isinstance(outputs, tuple) else (outputs,)
    return np.concatenate([np.asarray(output).ravel() for output in outputs])


def split(vector, sizes):
    return np.split(vector, np.cumsum(sizes)[:-1])


@pytest.mark.parametrize("name", EQUATIONS)
def test_all_scalar_types_give_the_values_of_floats_and_one_gradient(name, rng):
    function, sizes = EQUATIONS[name]
    values = rng.uniform(0.2, 1.5, sum(sizes)) * rng.choice([-1, 1], sum(sizes))
    expected = flat(function(*split(values, sizes)))

    def compare(found, expected):
        scale = max(1.0, np.max(np.abs(expected)))
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * scale)

    # A symbol for every fourth entry of each input, and numbers for the others: expressions
    # in dozens of symbols take seconds to evaluate.
    variables = MakeVectorVariable(len(values), "x")
    starts = np.repeat(np.cumsum([0, *sizes[:-1]]), sizes)
    is_symbol = (np.arange(len(values)) - starts) % 4 == 0
    pairs = zip(variables, values, is_symbol, strict=True)
    inputs = np.array([x if is_one else Expression(value) for x, value, is_one in pairs])
    with np.errstate(invalid="ignore"):  # Drake's symbols raise the flag without a cause
        symbols = flat(function(*split(inputs, sizes))) + Expression(0.0)
    environment = dict(zip(variables, values, strict=True))
    compare([expression.Evaluate(environment) for expression in symbols], expected)

    dual = flat(function(*split(InitializeAutoDiff(values)[:, 0], sizes)))
    compare(ExtractValue(dual)[:, 0], expected)
    gradients = ExtractGradient(dual)
    for index, columns in enumerate(split(np.arange(len(values)), sizes)):
        traced = TracedFunction(function, sizes, name=lambda: "test", jacobian_of=index)
        *outputs, jacobian = traced(*split(values, sizes))
        compare(flat(tuple(outputs)), expected)
        compare(jacobian, gradients[:, columns])
