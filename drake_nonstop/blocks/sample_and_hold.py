"""The inputs of sampled controllers, held from one sample to the next."""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context, DiagramBuilder, State

from drake_nonstop.mechanics.signal_layouts import HELD, SIGNALS
from drake_nonstop.mechanics.signals import (
    LOAD_REFERENCE_SIZE,
    LOAD_STATE_SIZE,
    REFERENCE_HIGHER_RATES_SIZE,
    WIND_SIZE,
)
from drake_nonstop.model.system import Model
from drake_nonstop.systems.block import LeafBlock
from drake_nonstop.systems.diagram_trace import InContext
from drake_nonstop.systems.requirements import LoopBlocks
from drake_nonstop.systems.wiring import WiringError, connect_remaining, require_open
from drake_nonstop.validation import require

SAMPLE_AND_HOLD = "sample_and_hold"  # no scenario chooses it: in front of sampled controllers
_WIND = "wind_estimate"
_POSES = ("measured_load_state", "reference")  # begin with a quaternion
_HIGHER_RATES = "reference_higher_rates"
HELD_SIGNALS = {
    "measured_load_state": LOAD_STATE_SIZE,
    "reference": LOAD_REFERENCE_SIZE,
    _HIGHER_RATES: REFERENCE_HIGHER_RATES_SIZE,
}


class SampleAndHold(LeafBlock):
    """Samples the controllers' inputs every `control_period`, and holds them.

    The block stands once, in front of all controllers, instead of a hold in each, which
    would add a sample of delay per block. The sample is taken by an unrestricted update:
    Drake runs those before discrete ones, so that an optimization layer that updates at
    the same instant reads the new sample (Drake's ZeroOrderHold is a discrete update and
    would give it the one before).

    What is left unconnected is held as zero. `add_sample_and_hold` adds it to a builder.

    Args:
        model: its control period.
        initial_values: the signals that are held before the first sample, by their names; those
            that are not given are a load at rest at the origin.
        holds_wind: whether `wind_estimate` is held, too, for a wind that is not constant.

    Attributes:
        period: s, between samples.
    """

    reads = ("measured_load_state", "reference", "reference_higher_rates", "wind_estimate")
    makes = (
        "held_measured_load_state",
        "held_reference",
        "held_reference_higher_rates",
        "held_wind_estimate",
        "sample_time",
    )
    where: ClassVar = {"wind_estimate": "it is held", "held_wind_estimate": "it is held"}

    optional_inputs = (_HIGHER_RATES,)
    signal_layouts: ClassVar = {"sample_time": SIGNALS["sample_time"]}

    def __init__(
        self,
        model: Model,
        initial_values: Mapping[str, NDArray] | None = None,
        *,
        holds_wind: bool = False,
    ):
        super().__init__()
        self._held = HELD_SIGNALS | ({_WIND: WIND_SIZE} if holds_wind else {})
        initial_values = initial_values or {}
        for name, size in self._held.items():
            self.DeclareVectorInputPort(name, size)
            at_rest = np.eye(size)[0] if name in _POSES else np.zeros(size)
            initial = self.DeclareDiscreteState(initial_values.get(name, at_rest))
            self.DeclareStateOutputPort(f"{HELD}{name}", initial)
        self.DeclareStateOutputPort("sample_time", self.DeclareDiscreteState(1))
        self.sample_period = period = model.control_period
        self.DeclareInitializationUnrestrictedUpdateEvent(self._sample)
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, period, self._sample)

    trace_key = ()
    updates_first = True  # before others' updates at the same instant
    updates_at_start = True

    def traced_output(self, port: str, at: Any) -> NDArray:
        return at.state(1 + int(self.GetOutputPort(port).get_index()))

    def traced_update(self, at: Any) -> list[NDArray]:
        held = [
            at.input_or(name, at.state(1 + k)) if name in self.optional_inputs else at.input(name)
            for k, name in enumerate(self._held)
        ]
        return [*held, at.time]

    def _sample(self, context: Context, state: State) -> None:
        for k, values in enumerate(self.traced_update(InContext(self, context))):
            state.get_mutable_discrete_state().set_value(k, values)


def hold_of(loop: LoopBlocks) -> SampleAndHold:
    """The block that holds the inputs of sampled controllers, at first those at the start."""
    wind, _ = loop.origin_of(_WIND)
    is_wanted = wind is not None or any(loop.reads(name, _WIND) for name in loop.blocks)
    # A constant estimate needs no hold, which would cost time at each sample.
    holds_wind = is_wanted and not getattr(wind, "is_sampled", False)
    held: dict[str, NDArray] = {}
    for signal in ("reference", "reference_higher_rates"):
        if (value := loop.at_start(signal, loop.maker_of(signal))) is not None:
            held[signal] = value
    if "reference" in held:
        held["measured_load_state"] = held["reference"][:LOAD_STATE_SIZE]
    return SampleAndHold(loop.believed, held, holds_wind=holds_wind)


def add_sample_and_hold(builder: DiagramBuilder, model: Model) -> SampleAndHold:
    """Adds the hold in front of sampled controllers to a builder that has all other blocks.

    Its inputs are connected to the blocks that make `measured_load_state`, `reference`,
    `reference_higher_rates` and, in wind that changes, `wind_estimate`. Its outputs, `sample_time`
    and the `held_` signals, are connected to inputs of these names that are open, and each
    `held_x` to open inputs x, save those of the block that makes x or another signal that is held.
    An input of the hold whose signal no block makes stays open, to be connected or exported.

    Args:
        builder: it is not built yet; what was connected stays.
        model: of the controllers, with their control period.

    Raises:
        ScenarioError: the builder is built, or has a block of the name "sample_and_hold"; two
            blocks make a signal, or a port has another size; no block reads what is held; the
            control period is 0.
    """
    require_open(builder, "add_sample_and_hold")
    require(isinstance(model, Model), "model", model, "give the Model of the controllers")
    remedy = "controllers read their inputs directly; leave the hold out, or give a longer one"
    require(model.control_period > 0, "control_period", model.control_period, remedy)
    remedy = "the builder has a system of that name; add the hold once"
    require(not builder.HasSubsystemNamed(SAMPLE_AND_HOLD), "blocks", SAMPLE_AND_HOLD, remedy)
    blocks = {block.get_name(): block for block in builder.GetMutableSystems()}
    hold = hold_of(LoopBlocks(blocks, model, model))
    builder.AddNamedSystem(SAMPLE_AND_HOLD, hold)
    connect_remaining(builder, of=hold)
    if all(source is not hold for source, _ in builder.connection_map().values()):
        raise WiringError(
            f"{SAMPLE_AND_HOLD} = no open input reads what it holds: add the controllers to the "
            "builder before, and leave their inputs measured_load_state and reference open"
        )
    return hold
