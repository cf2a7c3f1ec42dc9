"""Box "phase" of the internal forces, in the paper a part of their trajectories."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import (
    Context,
    ContinuousState,
    EventStatus,
    InputPortIndex,
    State,
)

from drake_nonstop.mechanics.shaping import Smoothing
from drake_nonstop.mechanics.signals import PARAMETERS_SIZE, PHASE_SIZE, PLANNED_SIZE
from drake_nonstop.model.block import Block
from drake_nonstop.model.system import Model
from drake_nonstop.systems.block import LeafBlock, weakly
from drake_nonstop.systems.diagram_trace import InContext, shown
from drake_nonstop.systems.requirements import LoopBlocks
from drake_nonstop.validation import (
    StrictFields,
    checked,
    positive,
    require_positive,
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
    state_port = "phase"
    is_sampled = True
    updates_first = True  # the optimization layer, which updates then, too, reads the new phase

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

    def inputs(self, model: Model) -> tuple[str, ...]:
        return self.reads if model.control_period > 0 else self.reads[:1]

    @staticmethod
    def equations(parameters: NDArray, time: NDArray) -> tuple[NDArray, NDArray]:
        angle = parameters[:1] * time
        planned = np.concatenate([angle, parameters, *[0 * time] * 5])
        return np.concatenate([angle, time]), planned


def _check_rate(field: str, value: Any) -> None:
    if value != math.inf:
        require_positive(field, value)


@dataclass(kw_only=True)
class ShapedPhaseConfig(StrictFields):
    """How fast ξ and A follow the parameters that a layer asks for."""

    bandwidth: float = positive(80.0)  # rad/s, of each of three equal poles
    max_frequency_rate: float = checked(math.inf, _check_rate)  # rad/s², of ξ
    max_amplitude_rate: float = checked(math.inf, _check_rate)  # N/s, of A


class ShapedPhase(LeafBlock):
    """ξ and A that follow the parameters smoothly, their rates, and the phase θ̇ = ξ.

    Where `plan` is connected ξ and A are those of the plan. Otherwise each follows its parameter
    through three equal poles, see `mechanics.shaping`: it is continuous to its second rate, stays
    between the parameters' least and largest values so far, and never moves faster than its
    largest rate, whatever the parameters do. It starts at the parameters of the first sample, or
    step, with rates of zero.

    θ, ξ, A and their rates are the state: continuous, or stepped at each sample, exactly, where the
    model has a control period.

    Raises:
        ScenarioError: a parameter is not positive, or the bandwidth is not finite.
    """

    reads = ("parameters", "plan")
    makes = ("phase", "planned")

    is_sampled = True
    optional_inputs = ("plan",)

    def requires(self, loop: LoopBlocks) -> Iterator[str]:
        """Tells of an internal force of other ξ and A than it makes."""
        layer, reader = loop.get("optimization_layer"), loop.get("internal_force")
        if loop.reads("internal_force", "parameters") and not getattr(layer, "is_trivial", False):
            has_plan = loop.maker_of("plan") is not None
            other = "" if has_plan else ", or give phase=AccumulatedPhase"
            yield (
                f"internal_force = {type(reader).__name__}: it reads parameters, which phase = "
                "ShapedPhase smooths, so that its rates are others than those that are flown; have "
                f"it read planned, as PlannedInternalForce does{other}"
            )

    def __init__(self, model: Model, config: ShapedPhaseConfig | None = None):
        super().__init__()
        config = require_ranges(_BOX, config or ShapedPhaseConfig())
        max_rates = config.max_frequency_rate, config.max_amplitude_rate
        period = model.control_period
        self._shape = config.bandwidth, *max_rates, period
        self._frequency, self._amplitude = (
            Smoothing(bandwidth=config.bandwidth, period=period, max_rate=max_rate)
            for max_rate in max_rates
        )
        self.DeclareVectorInputPort("parameters", PARAMETERS_SIZE)
        self._plan = self.DeclareVectorInputPort("plan", PLANNED_SIZE)
        parameters, plan = (self.input_port_ticket(InputPortIndex(k)) for k in range(2))
        states = self.all_state_ticket()
        for name, size, sources in (
            ("phase", PHASE_SIZE, {plan, states}),
            ("planned", PLANNED_SIZE, {plan, parameters, states}),
        ):
            self.DeclareVectorOutputPort(name, size, shown(self, name), sources)
        self._group = int(period > 0)  # that of the state
        self.is_traced = period > 0
        if period > 0:
            self.DeclareDiscreteState(_STATE_SIZE)
            # Unrestricted for the same reason as the step of an accumulated phase.
            self.DeclarePeriodicUnrestrictedUpdateEvent(period, period, weakly(self._step))
        else:
            self.DeclareContinuousState(_STATE_SIZE)
            # At the first step, and not at the initialization, which a layer's first update is a
            # part of. No trace has such an event.
            self.DeclarePerStepUnrestrictedUpdateEvent(weakly(self._begin))

    updates_first = True

    @property
    def trace_key(self) -> Any:
        """Shaping filter of ξ and A."""
        return self._shape

    def _motion(self, at: Any) -> tuple[Any, list[Any], list[Any]]:
        """θ, and of each of ξ and A the stages and the first one's rate.

        The state (8) is θ with the stages of ξ and of A, and whether these have started: 1, or,
        before that, 0, where they are the parameters.
        """
        angle, *stages, started = at.state(self._group)
        frequency, amplitude = at.input("parameters")
        if not isinstance(started, float) or started != 1:
            rest = 1 - started
            starts = [frequency] * 3 + [amplitude] * 3
            pairs = zip(stages, starts, strict=True)
            stages = [started * value + rest * start for value, start in pairs]
        xi, size = stages[:3], stages[3:]
        xi.append(self._frequency.approach(xi[0], frequency))
        size.append(self._amplitude.approach(size[0], amplitude))
        return angle, xi, size

    def traced_output(self, port: str, at: Any) -> NDArray:
        if at.has_input("plan"):
            plan = at.input("plan")
            return plan if port == "planned" else np.array([plan[0], 0.0 * plan[0]])
        if port == "phase":
            angle = at.state(self._group)[0]
            return np.array([angle, 0.0 * angle])
        angle, xi, size = self._motion(at)
        first, second, _ = self._frequency.rates(*xi)
        size_first, size_second, size_third = self._amplitude.rates(*size)
        rates = [first, size_first, second, size_second, size_third]
        return np.array([angle, xi[2], size[2], *rates])

    def traced_update(self, at: Any) -> list[NDArray]:
        if at.has_input("plan"):
            return [at.state(self._group)]
        angle, xi, size = self._motion(at)
        *xi, turn = self._frequency.after(*xi)
        *size, _ = self._amplitude.after(*size)
        return [np.array([angle + turn, *xi, *size, 1.0])]

    def _step(self, context: Context, state: State) -> EventStatus:
        if self._plan.HasValue(context):
            return EventStatus.DidNothing()
        (after,) = self.traced_update(InContext(self, context))
        state.get_mutable_discrete_state().set_value(after)
        return EventStatus.Succeeded()

    def _begin(self, context: Context, state: State) -> EventStatus:
        has_started = context.get_continuous_state_vector()[_STATE_SIZE - 1] == 1
        if has_started or self._plan.HasValue(context):
            return EventStatus.DidNothing()
        angle, xi, size = self._motion(InContext(self, context))
        values = [angle, *xi[:3], *size[:3], 1.0]
        state.get_mutable_continuous_state().SetFromVector(values)
        return EventStatus.Succeeded()

    def DoCalcTimeDerivatives(self, context: Context, derivatives: ContinuousState) -> None:
        """Overrides LeafSystem's."""
        if derivatives.size() == 0:
            return
        if self._plan.HasValue(context):
            derivatives.SetFromVector(np.zeros(_STATE_SIZE))
            return
        _, xi, size = self._motion(InContext(self, context))
        rates = [xi[3], *self._frequency.stage_rates(*xi[:3])]
        rates += [size[3], *self._amplitude.stage_rates(*size[:3])]
        derivatives.SetFromVector([xi[2], *rates, 0.0])


VARIANTS = (ShapedPhase, AccumulatedPhase, PaperPhase)

__all__ = ["ShapedPhase", "ShapedPhaseConfig", "AccumulatedPhase", "AccumulatedPhaseConfig"]
__all__ += ["PaperPhase", "PaperPhaseConfig"]
