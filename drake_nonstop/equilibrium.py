"""Where a run starts: the equilibrium of the loop as configured."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common.eigen_geometry import AngleAxis, Quaternion
from pydrake.math import RotationMatrix
from pydrake.systems.framework import Context, Diagram

from drake_nonstop.compiled import NotFiniteError
from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.scenario import Scenario
from drake_nonstop.validation import ScenarioError

_STEP = 1e-6  # m and rad, of the differences that Newton's method takes
_REST = 1e-6  # m/s² and rad/s², the acceleration that counts as rest


def set_equilibrium(
    scenario: Scenario, nonstop: Diagram, context: Context, **replacements: Any
) -> None:
    """Sets load and carriers in `context` to the equilibrium of the loop as configured.

    The carriers start on their references, with their velocities; the load starts where
    the cables then hold it at rest: on its reference where the controllers know the
    cables' stretch, lower by the sag where they do not. Whatever blocks the loop is made
    of, Newton's method on the built diagram finds the pose. A load whose reference moves
    at the start gets that motion.

    Raises:
        ScenarioError: the cables cannot hold the load.
    """
    if scenario.control_period > 0:  # the sample-and-hold is empty before the first event
        continuous = dataclasses.replace(scenario, control_period=0.0)
        system = make_nonstop(continuous, **replacements)
    else:
        system = nonstop
    trial = system.CreateDefaultContext()
    trial.SetTime(context.get_time())
    load = system.GetSubsystemByName("load_plant")
    carriers = system.GetSubsystemByName("carrier_dynamics")
    load_context = system.GetMutableSubsystemContext(load, trial)
    carriers_context = system.GetMutableSubsystemContext(carriers, trial)
    reference = system.GetOutputPort("reference").Eval(trial)[:13].copy()

    def settle(offset: NDArray) -> NDArray:
        """The load's acceleration (6,) at a rotation and shift (6,) from its reference."""
        load_context.SetContinuousState(_moved(reference, offset))
        carrier_reference = system.GetOutputPort("carrier_reference").Eval(trial)
        carriers_context.SetContinuousState(carrier_reference)
        return load.EvalTimeDerivatives(load_context).CopyToVector()[7:]

    try:
        residual = _newton(settle)
    except (NotFiniteError, np.linalg.LinAlgError):
        residual = np.full(6, np.inf)
    if not np.max(np.abs(residual)) < _REST:
        raise ScenarioError(
            f"start = acceleration of {np.max(np.abs(residual)):.2g} m/s^2: the cables do not "
            "hold the load at rest; give them stiffness for its weight, and an amplitude that "
            "keeps them taut"
        )
    for name, settled in (("load_plant", load_context), ("carrier_dynamics", carriers_context)):
        target = nonstop.GetMutableSubsystemContext(nonstop.GetSubsystemByName(name), context)
        target.SetContinuousState(settled.get_continuous_state_vector().CopyToVector())


def _newton(function: Callable[[NDArray], NDArray]) -> NDArray:
    """Drives the function (6,) of an offset (6,) to zero; returns what is left of it."""
    offset = np.zeros(6)
    residual = function(offset)
    for _ in range(20):
        if np.max(np.abs(residual)) < _REST / 1e3:
            break
        columns = [
            (function(offset + step) - function(offset - step)) / (2 * _STEP)
            for step in _STEP * np.eye(6)
        ]
        offset = offset - np.linalg.solve(np.column_stack(columns), residual)
        residual = function(offset)
    return residual


def _moved(state: NDArray, offset: NDArray) -> NDArray:
    """A load state (13,) turned by a rotation vector and shifted, both in W (6,)."""
    angle = np.linalg.norm(offset[:3])
    turn = RotationMatrix() if angle == 0 else RotationMatrix(AngleAxis(angle, offset[:3] / angle))
    rotation = turn @ RotationMatrix(Quaternion(state[:4]))
    return np.concatenate([rotation.ToQuaternion().wxyz(), state[4:7] + offset[3:], state[7:]])
