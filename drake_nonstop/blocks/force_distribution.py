"""Box "Cable Force Distribution" of the figure."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import AbstractValue, Value
from pydrake.solvers import ClarabelSolver, MathematicalProgram
from pydrake.systems.framework import Context, ValueProducer

from drake_nonstop.mechanics.grasp import (
    cable_forces_and_rates,
    grasp_matrix,
    null_space_correction,
)
from drake_nonstop.mechanics.rotation import rotation_matrix
from drake_nonstop.mechanics.signals import LoadState
from drake_nonstop.model.block import Block, BlockParameters
from drake_nonstop.model.descriptions import PseudoInverse
from drake_nonstop.model.system import Model
from drake_nonstop.systems.block import weakly
from drake_nonstop.validation import (
    StrictFields,
    is_number,
    non_negative,
    require,
    require_ranges,
)

_OUTPUTS = ("desired_cable_forces", "desired_cable_force_rates")

_ACCURACY = 1e-12  # of the quadratic program's cost, in units of the largest violation of a bound
_SLACK = 1.01  # of a tension over its bound: the program bounds the part along a direction
_AT_BOUND = 1e-5  # from a bound to what counts as on it, in the same units

_BOX = "force_distribution"


@dataclass(kw_only=True)
class CableForceDistributionConfig(StrictFields):
    """No parameters: the pattern is the scenario's."""


class CableForceDistribution(Block):
    """f_d = G† w_d + f̃⁰ + N λ and its exact rate (eqs. 16, 19-21)."""

    reads = ("measured_load_state", "wrench", "wrench_rate", "internal_force")
    makes = _OUTPUTS
    of_model = ("pseudo_inverse", "pattern.basis")
    is_sampled = True

    @staticmethod
    def equations(
        *inputs: NDArray,
        pseudo_inverse: NDArray,
        basis: NDArray,
        pattern_offset: NDArray | None = None,
    ) -> tuple[NDArray, NDArray]:
        offset = np.zeros(len(basis)) if pattern_offset is None else pattern_offset
        return cable_forces_and_rates(
            *inputs, pseudo_inverse=pseudo_inverse, basis=basis, offset=offset
        )

    def block_parameters(self, model: Model, config: Any) -> BlockParameters:
        return BlockParameters(model, model.offset_parameter)

    def describe_response(self) -> PseudoInverse:
        return PseudoInverse()


@dataclass(kw_only=True)
class BoundedTensionDistributionConfig(StrictFields):
    """The bounds on the tension of every cable."""

    min_tension: float = non_negative(1.0)  # N
    max_tension: float = math.inf  # N


class BoundedTensionDistribution(CableForceDistribution):
    """The pseudo-inverse's forces with the smallest change that keeps the tensions within bounds.

    A quadratic program: of all cable forces with the desired wrench, those nearest to
    G† w_d + f̃⁰ + N λ whose components along these are within the bounds (a tension may exceed
    `max_tension` by 1 %, since a force also has a part across). Drake's MathematicalProgram with
    Clarabel solves it where a bound is violated; its active bounds then give forces and exact
    rates in closed form. The rates jump where a bound becomes active. The optimization layer
    does not model the change: it predicts the speeds without it.

    The bounds are those of the commanded tensions. In a simulation the carriers' error along a
    cable times its stiffness comes on top, which is largest where the rates jump: on `quintic` with
    a `min_tension` of 2.9 N, CarrierPid and the hold "velocity" the tensions fall to 2.85 N,
    because 0.1 mm are 0.05 N (2.89 N with FeedforwardCarrierPid). A run warns of it.

    Raises:
        ScenarioError: a bound is negative, or the two are not in order.
        RuntimeError: during a run, if no such cable forces are found.
    """

    computes_besides = True  # a search is no equation

    def __init__(self, model: Model, config: BoundedTensionDistributionConfig | None = None):
        super().__init__(model, config)
        # The last rows of Vᵀ span the null space of the grasp matrix, which has rank 6.
        self._null_space = np.linalg.svd(grasp_matrix(model.attachments))[2][6:].T
        entry = self.DeclareCacheEntry(
            "cables on a bound",
            ValueProducer(Value(()).Clone, weakly(self._calc_active)),
            self._tickets[_OUTPUTS[0]],
        )
        self._entry_index = entry.cache_index()  # the entry would keep this block alive

    @classmethod
    def check(cls, model: Model, config: BoundedTensionDistributionConfig) -> None:
        require_ranges(_BOX, config)
        limit = config.max_tension
        require(
            (is_number(limit) and limit > config.min_tension) or limit == math.inf,
            f"{_BOX}.max_tension",
            limit,
            f"give more than min_tension = {config.min_tension:g} N, or .inf for no limit",
        )

    def result(self, context: Context, name: str) -> NDArray:
        """Cable forces or their rates (3n,), with every tension within its bounds."""
        forces, rates = _OUTPUTS
        found = self._least(context, forces)
        if name == forces:
            return self._bounded(context, found, np.zeros(found.shape))[0].ravel()
        return self._bounded(context, found, self._least(context, rates))[1].ravel()

    def _load_state(self, context: Context) -> LoadState:
        return LoadState.view(self._inputs["measured_load_state"].Eval(context))

    def _least(self, context: Context, name: str) -> NDArray:
        """The pseudo-inverse's forces, or their rates (n, 3)."""
        return super().result(context, name).reshape(-1, 3).copy()

    def _calc_active(self, context: Context, value: AbstractValue) -> None:
        """The forces' directions, in L, and `_active_bounds`; () where no bound is violated."""
        self.require_floats("give CableForceDistribution in place of BoundedTensionDistribution")
        forces = self._least(context, _OUTPUTS[0])
        tensions = np.linalg.norm(forces, axis=1)
        low, high = self.config.min_tension - tensions, self.config.max_tension - tensions
        if np.all(low <= 0) and np.all(high >= 0):
            value.set_value(())
            return
        R_WL = rotation_matrix(self._load_state(context).quaternion)
        directions = forces @ R_WL / tensions[:, None]
        value.set_value((directions, *self._active_bounds(directions, low, high)))

    def _bounded(
        self, context: Context, forces: NDArray, rates: NDArray
    ) -> tuple[NDArray, NDArray]:
        """The changed forces and rates; the forces do not depend on the rates."""
        found = self.get_cache_entry(self._entry_index).Eval(context)
        if not found:
            return forces, rates
        directions, active, shortfalls = found
        load = self._load_state(context)
        R_WL, angular_velocity = rotation_matrix(load.quaternion), load.angular_velocity
        # In the load frame, where the null space is constant.
        forces_L = forces @ R_WL
        rates_L = (rates - np.cross(angular_velocity, forces)) @ R_WL
        tensions = np.linalg.norm(forces, axis=1)
        tension_rates = (directions * rates_L).sum(axis=1)
        direction_rates = (rates_L - tension_rates[:, None] * directions) / tensions[:, None]
        rows = np.zeros((len(active), *forces.shape))
        row_rates = np.zeros(rows.shape)
        rows[np.arange(len(active)), active] = directions[active]
        row_rates[np.arange(len(active)), active] = direction_rates[active]
        change, change_rate = null_space_correction(
            rows, row_rates, shortfalls, -tension_rates[active], self._null_space
        )
        if np.max(np.linalg.norm(forces_L + change, axis=1)) > _SLACK * self.config.max_tension:
            raise RuntimeError(self._failure())
        forces = (forces_L + change) @ R_WL.T
        rates = (rates_L + change_rate) @ R_WL.T + np.cross(angular_velocity, forces)
        return forces, rates

    def _failure(self) -> str:
        return (
            f"no cable forces with tensions from {self.config.min_tension:g} to "
            f"{self.config.max_tension:g} N that make the wrench were found near those of the "
            "pattern; widen force_distribution.min_tension and max_tension"
        )

    def _active_bounds(
        self, directions: NDArray, low: NDArray, high: NDArray
    ) -> tuple[NDArray, NDArray]:
        """The cables on a bound in the quadratic program, and the violations, in N.

        `directions` (n, 3) are those of the forces, `low` and `high` (n,) the least and the
        largest change of each tension within the bounds, in N.
        """
        n = len(directions)
        rows = np.zeros((n, n, 3))
        rows[np.arange(n), np.arange(n)] = directions
        matrix = rows.reshape(n, -1) @ self._null_space
        scale = max(np.max(low), np.max(-high))  # the program is in units of the violation
        program = MathematicalProgram()
        y = program.NewContinuousVariables(matrix.shape[1])
        program.AddQuadraticCost(np.eye(len(y)), np.zeros(len(y)), y)
        program.AddLinearConstraint(matrix, low / scale, high / scale, y)
        for name in ("tol_gap_abs", "tol_gap_rel"):
            program.SetSolverOption(ClarabelSolver.id(), name, _ACCURACY)
        result = ClarabelSolver().Solve(program)
        if not result.is_success():
            raise RuntimeError(self._failure())
        change = scale * matrix @ result.GetSolution(y)
        margin = scale * _AT_BOUND
        at_low, at_high = change <= low + margin, change >= high - margin
        active = np.flatnonzero(at_low | at_high)
        return active, np.where(at_low, low, high)[active]


VARIANTS = (CableForceDistribution, BoundedTensionDistribution)

__all__ = ["CableForceDistribution", "CableForceDistributionConfig"]
__all__ += ["BoundedTensionDistribution", "BoundedTensionDistributionConfig"]
