"""Box "phase" of the internal forces, in the paper a part of their trajectories."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context, EventStatus, State

from drake_nonstop.mechanics.shaping import Smoothing
from drake_nonstop.mechanics.signals import PHASE_SIZE
from drake_nonstop.model.block import Block, BlockParameters
from drake_nonstop.model.system import Model
from drake_nonstop.systems.block import weakly
from drake_nonstop.systems.tracing import where
from drake_nonstop.validation import (
    StrictFields,
    positive,
    require_ranges,
)

_BOX = "phase"
_STATE_SIZE = 8  # θ, the stages of ξ and of A, and whether they have started


@dataclass(kw_only=True)
class AccumulatedPhaseConfig(StrictFields):
    """No parameters."""


class AccumulatedPhase(Block):
    """θ̇ = ξ: the phase is continuous, also where ξ jumps.

    The paper's cos(ξ(t) t + φ), that of `PaperPhase`, jumps by t Δξ when ξ changes.

    `phase`, with ∂θ/∂ξ = 0, is the state: continuous, or stepped at each sample where the model has
    a control period. `planned` tells no rates: those of constant ξ and A.
    """

    reads = ("parameters",)
    makes = ("phase", "planned")
    state_ports = ("phase",)
    is_sampled = True

    @staticmethod
    def equations(phase: NDArray, parameters: NDArray) -> tuple[NDArray, NDArray]:
        none = 0 * parameters[:1]
        rate = np.concatenate([parameters[:1], none])
        return rate, np.concatenate([phase[:1], parameters, *[none] * 5])

    def state(self, model: Model) -> NDArray:
        return np.zeros(PHASE_SIZE)


@dataclass(kw_only=True)
class PaperPhaseConfig(StrictFields):
    """No parameters."""


class PaperPhase(Block):
    """θ = ξ(t) t with the current frequency ξ, as printed in the paper (eq. 23).

    Behind a sampled controller t is the `sample_time`. `planned` tells no rates: those of constant
    ξ and A.
    """

    reads = ("parameters", "sample_time")
    makes = ("phase", "planned")
    where: ClassVar = {"sample_time": "the model has a control period"}
    is_sampled = True

    def __init__(self, model: Model, config: PaperPhaseConfig | None = None):
        self.reads_time = model.control_period == 0
        super().__init__(model, config)

    @staticmethod
    def equations(parameters: NDArray, time: NDArray) -> tuple[NDArray, NDArray]:
        angle = parameters[:1] * time
        planned = np.concatenate([angle, parameters, *[0 * time] * 5])
        return np.concatenate([angle, time]), planned


@dataclass(kw_only=True)
class ShapedPhaseConfig(StrictFields):
    """How fast ξ and A follow the parameters that a layer asks for."""

    bandwidth: float = positive(80.0)  # rad/s, of each of three equal poles


class ShapedPhase(Block):
    """ξ and A that follow the parameters smoothly, their rates, and the phase θ̇ = ξ.

    Where `plan` is connected ξ and A are those of the plan. Otherwise each follows its parameter
    through three equal poles, see `mechanics.shaping`: it is continuous to its second rate, and
    stays between the parameters' least and largest values so far. It starts at the parameters of
    the first sample, or step, with rates of zero.

    θ, ξ, A and their rates are the state: continuous, or stepped at each sample, exactly, where the
    model has a control period.

    Raises:
        ScenarioError: the bandwidth is not positive, or not finite.
    """

    reads = ("parameters", "plan")
    makes = ("phase", "planned")
    optional_inputs = ("plan",)
    is_sampled = True
    makes_next_state = True

    def __init__(self, model: Model, config: ShapedPhaseConfig | None = None):
        super().__init__(model, config)
        if model.control_period == 0:
            # At the first step, and not at the initialization, which a layer's first answer is a
            # part of.
            self.DeclarePerStepUnrestrictedUpdateEvent(weakly(self._begin_shaping))

    @classmethod
    def check(cls, model: Model, config: ShapedPhaseConfig) -> None:
        """Raises ScenarioError for a config that cannot be used."""
        require_ranges(_BOX, config)

    def block_parameters(self, model: Model, config: ShapedPhaseConfig) -> BlockParameters:
        """No parameters: the poles are those that the block was made with."""
        return BlockParameters(model, self.system)

    def constants(self, model: Model, config: ShapedPhaseConfig) -> dict[str, Any]:
        """The poles, and whether they step at samples."""
        period = model.control_period
        return {
            "poles": Smoothing(bandwidth=config.bandwidth, period=period),
            "steps": period > 0,
        }

    def state(self, model: Model) -> NDArray:
        """θ, the three stages of ξ and of A, and 1 where these have started, else 0."""
        return np.zeros(_STATE_SIZE)

    @staticmethod
    def equations(
        state: NDArray,
        parameters: NDArray,
        plan: NDArray,
        *,
        poles: Smoothing,
        steps: bool,
    ) -> tuple[NDArray, ...]:
        started = state[7:]
        stages = started * state[1:7] + (1 - started) * np.repeat(parameters, 3)
        first, second, third = stages.reshape(2, 3).T  # each of ξ and A
        moving = poles.approach(first, parameters)
        rate, second_rate, third_rate = poles.rates(first, second, third, moving)
        shaped = np.concatenate([state[:1], third, rate, second_rate, third_rate[1:]])
        if steps:
            *after, turn = poles.after(first, second, third, moving)
            moved, going, standing = np.stack(after), [state[:1] + turn[:1], np.ones(1)], state
        else:
            moved = np.stack([moving, *poles.stage_rates(first, second, third)])
            going, standing = [third[:1], np.zeros(1)], 0 * state
        going.insert(1, moved.T.ravel())
        has_plan = plan[1] > 0
        planned = where(has_plan, plan, shaped)
        moved = where(has_plan, standing, np.concatenate(going))
        return moved, np.concatenate([planned[:1], 0 * planned[:1]]), planned

    def _begin_shaping(self, context: Context, state: State) -> EventStatus:
        values = context.get_continuous_state_vector().CopyToVector()
        if values[-1] == 1:
            return EventStatus.DidNothing()
        starts = np.repeat(self.GetInputPort("parameters").Eval(context), 3)
        state.get_mutable_continuous_state().SetFromVector([values[0], *starts, 1.0])
        return EventStatus.Succeeded()


VARIANTS = (ShapedPhase, AccumulatedPhase, PaperPhase)
