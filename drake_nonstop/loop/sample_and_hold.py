"""Puts the hold in front of sampled controllers, in the figure and in loops wired by hand."""

from numpy.typing import NDArray
from pydrake.systems.framework import DiagramBuilder

from drake_nonstop.blocks.sample_and_hold import SampleAndHold
from drake_nonstop.mechanics.signals import LOAD_STATE_SIZE
from drake_nonstop.model.system import Model
from drake_nonstop.systems.requirements import LoopBlocks
from drake_nonstop.systems.wiring import WiringError, connect_remaining, require_open
from drake_nonstop.validation import require

SAMPLE_AND_HOLD = "sample_and_hold"  # no scenario chooses it: in front of sampled controllers
_WIND = "wind_estimate"


def hold_of(loop: LoopBlocks) -> SampleAndHold:
    """What holds the inputs of sampled controllers, before its first sample those at the start."""
    wind = loop.maker_of(_WIND)
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
