"""The inputs of sampled controllers, held from one sample to the next."""

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context, DiagramBuilder

from drake_nonstop.mechanics.signal_layouts import Layout
from drake_nonstop.mechanics.signals import HELD, SAMPLE_TIME, SIGNALS
from drake_nonstop.model.block import Block, signal_sizes
from drake_nonstop.model.system import Model
from drake_nonstop.systems.equation_block import EquationBlock
from drake_nonstop.systems.equations import Equations
from drake_nonstop.systems.requirements import LoopBlocks
from drake_nonstop.systems.wiring import connect_remaining, input_names, require_open
from drake_nonstop.validation import ScenarioError, require, warn_user

SAMPLE_AND_HOLD = "sample_and_hold"  # no scenario chooses it: in front of sampled controllers
_WIND = "wind_estimate"
_POSES = ("measured_load_state", "reference")  # begin with a quaternion
_HIGHER_RATES = "reference_higher_rates"
_ALIKE = 0.98  # |cos(angle / 2)| of two attitudes, 23 degrees apart
HELD_SIGNALS = ("measured_load_state", "reference", _HIGHER_RATES)


class SampleAndHold(EquationBlock):
    """Samples the controllers' inputs every `control_period`, and holds them.

    The block stands once, in front of all controllers, instead of a hold in each, which
    would add a sample of delay per block. It steps at once with the states of all sampled blocks,
    before layers read the new sample.

    What is left unconnected is held as zero. `add_sample_and_hold` adds it to a builder.

    Args:
        model: its control period, and how many carriers there are.
        holds_wind: whether `wind_estimate` is held, too, for a wind that is not constant.
        others: further signals that are held.

    Attributes:
        replaces: the signals that all who read them take as they are held.
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

    signal_layouts: Mapping[str, Layout | None] = {"sample_time": SIGNALS["sample_time"]}
    optional_inputs: tuple[str, ...] = (_HIGHER_RATES,)
    is_sampled = True

    def __init__(self, model: Model, *, holds_wind: bool = False, others: Sequence[str] = ()):
        held = (*HELD_SIGNALS, *([_WIND] if holds_wind else []), *others)
        sizes = signal_sizes(type(self), model, held)
        # Before the start of a run a load at rest at the origin.
        parts = [np.eye(n)[0] if name in _POSES else np.zeros(n) for name, n in sizes.items()]
        shown = {f"{HELD}{name}": size for name, size in sizes.items()} | {SAMPLE_TIME: 1}
        equations = Equations(
            _sampled,
            inputs=sizes,
            outputs={},
            optional=dict.fromkeys((_HIGHER_RATES, *others), 0.0),
            state=np.concatenate([*parts, [0.0]]),
            shown=shown,
            reads_time=True,
            period=model.control_period,
            makes_next_state=True,
            start=_sampled,
            starts_first=True,
            key="hold",
        )
        super().__init__(equations)
        self.optional_inputs = (_HIGHER_RATES, *others)
        self.replaces = (*sizes,)[: len(sizes) - len(others)]

    def tell_start(self, context: Context) -> None:
        tell_of_scalar_last(self, context)


def tell_of_scalar_last(reader: Block | SampleAndHold, context: Context) -> None:
    """Warns of attitudes that a block reads whose quaternions are given as x, y, z, w."""
    given, desired = (reader.GetInputPort(name).Eval(context)[:4] for name in _POSES)
    # |cos(angle / 2)| of what is between the load and its reference.
    turned, as_told = (abs(desired @ np.roll(given, shift)) for shift in (0, 1))
    if turned < 0.5 * _ALIKE and as_told > _ALIKE:
        warn_user(
            f"measured_load_state = {np.round(given, 3).tolist()}, ...: begin it with the "
            "quaternion w, x, y, z; this is the attitude of the reference as x, y, z, w"
        )
    if np.array_equal(desired, [0, 0, 0, 1]):  # a yaw of π has a w of 6e-17
        warn_user(
            "reference = [0, 0, 0, 1], ...: a load turned by half a turn; begin the reference with "
            "the quaternion w, x, y, z, if no rotation is meant"
        )


def _sampled(held: NDArray, *signals_and_time: NDArray) -> NDArray:
    """What is held from now on: the signals, and the time."""
    return np.concatenate(signals_and_time)


def hold_of(loop: LoopBlocks) -> SampleAndHold:
    """The block that holds the inputs of sampled controllers."""
    wind, _ = loop.origin_of(_WIND)
    is_wanted = wind is not None or any(b.HasInputPort(_WIND) for b in loop.blocks.values())
    # A constant estimate needs no hold, which would cost time at each sample.
    holds_wind = is_wanted and not getattr(wind, "is_sampled", False)
    read = {name for own in loop.blocks.values() for name in input_names(own)}
    others = [name.removeprefix(HELD) for name in sorted(read) if name.startswith(HELD)]
    others = [n for n in others if n not in (*HELD_SIGNALS, _WIND) and loop.maker_of(n) is not None]
    return SampleAndHold(loop.believed, holds_wind=holds_wind, others=others)


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
        raise ScenarioError(
            f"{SAMPLE_AND_HOLD} = no open input reads what it holds: add the controllers to the "
            "builder before, and leave their inputs measured_load_state and reference open"
        )
    return hold
