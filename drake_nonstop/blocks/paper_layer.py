"""The variant of box "Optimization Layer" whose program is the paper's, as printed."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.blocks.nlp_layer import NlpLayer, ProgramConfig
from drake_nonstop.mechanics.nonstop import phase_of
from drake_nonstop.mechanics.rigid_load import load_acceleration
from drake_nonstop.planning.problem_config import below_one
from drake_nonstop.validation import non_negative


@dataclass(kw_only=True)
class PaperLayerConfig(ProgramConfig):
    """The bound, ξ and A with their bounds, the solver, and weights of the cost."""

    tightening: float = non_negative(0.0, below_one)  # the solver aims at (1 + tightening) ε


class PaperLayer(NlpLayer):
    """Changes ξ and A as little as keeps every carrier at or above ε now (eqs. 23-26).

    At each update, with x = [ξ, A] and its last value x⁻,

        min ‖x − x⁻‖² + w_pos ‖λ(x) − λ(x⁻)‖² + w_vel ‖λ̇(x) − λ̇(x⁻)‖²
        such that  ‖v_i(x)‖ ≥ (1 + tightening) ε,  i = 1 … n,

    and x is within its bounds, by SNOPT from x⁻ on. v_i is the velocity of carrier i (eq. 22), for
    aircraft through the air. The load has its measured motion, and the acceleration by the wrench.
    The constraint holds at the instant of the update alone: for the orbit ahead see `NlpLayer`, and
    for plans `RecedingHorizonOptimizer`. Where the solver finds no such x, x⁻ stays, and the update
    counts as `held`.

    Raises:
        ScenarioError: as `NlpLayer`.
    """

    def prediction(self, x: NDArray, now: Any) -> tuple[Any, ...]:
        """Arguments of `carrier_speeds` and the like: the present motion, wrench and phase."""
        state, wind = now.measured_load_state, now.wind_estimate
        accelerations = load_acceleration(self.model.load, state, now.wrench, wind)
        motion = np.concatenate([state, *accelerations, np.zeros(3)])
        theta = phase_of(x, now.previous, now.phase)
        return self.model, motion, now.wrench, now.wrench_rate, x[0], x[1], theta, wind
