"""Makes the blocks of a loop from a scenario and its replacements, and connects them."""

import copy
from collections.abc import Callable, Collection, Mapping
from dataclasses import is_dataclass
from typing import Any, NamedTuple, Protocol, TypeVar

from pydrake.systems.framework import Diagram, DiagramBuilder, System

from drake_nonstop.blocks.reference_governor import governed
from drake_nonstop.blocks.sample_and_hold import SAMPLE_AND_HOLD, hold_of
from drake_nonstop.blocks.wrench_controller import WrenchRate
from drake_nonstop.loop.box import Box, block_of, kept_parameters
from drake_nonstop.mechanics.signals import HELD
from drake_nonstop.model.descriptions import described
from drake_nonstop.model.system import (
    Model,
    given_fields,
    overridden,
)
from drake_nonstop.systems import wiring
from drake_nonstop.systems.block import LOOP, DiagramBlock
from drake_nonstop.systems.diagnosis import block_blamed
from drake_nonstop.systems.documentation import config_class, declared_by
from drake_nonstop.systems.requirements import LoopBlocks
from drake_nonstop.validation import ScenarioError, called, require, warn_user

LAYER = "optimization_layer"
EXTRA = "extra"  # the argument for blocks beyond the figure's, among replacements

Boxes = Mapping[str, Box]  # of a figure, by their names
Maker = Callable[[Model], System]  # of a block, such as its class


class LoopConfig(Protocol):
    """A `Scenario`, as far as a loop has to know it."""

    def sampled(self) -> Any:
        """The scenario with numbers drawn for its distributions."""
        ...


class Parts(NamedTuple):
    """Blocks that a loop is connected from."""

    loop: LoopBlocks
    blocks: dict[str, System]  # those of the loop, with the hold in front of sampled controllers


def make_parts(
    boxes: Boxes,
    scenario: LoopConfig,
    replacements: Mapping[str, Any],
    extra: Mapping[str, Any] | None,
) -> Parts:
    """The blocks of a scenario; the arguments are as of `make_nonstop`.

    Raises:
        ScenarioError: one of them cannot be made, or does not fit the others.
    """
    stated, others = replaced(boxes, scenario, replacements)
    drawn = stated.sampled()
    entries = {name: others.get(name, getattr(drawn, name)) for name in boxes}
    believed, simulated = models_of(drawn)
    # Carriers have no share of the drag that a block counts as the cables'.
    simulated = _with(simulated, bears_cable_drag=not _bears_drag(entries["cables"]))
    believed = _with(believed, bears_cable_drag=not _bears_drag(entries["carrier_trajectory"]))
    entries[LAYER] = entries.pop(LAYER)  # it comes last
    remedy = 'give a mapping from names to blocks, such as {"estimator": Estimator}'
    require(extra is None or isinstance(extra, Mapping), "extra", extra, remedy)
    taken = next((name for name in extra or {} if name in (*boxes, SAMPLE_AND_HOLD)), None)
    remedy = "the figure has a block of that name; give another one, or a box's as box=..."
    require(taken is None, "extra", taken, remedy)
    blocks: dict[str, System] = {}
    for name, entry in (entries | dict(extra or {})).items():
        box = boxes.get(name)
        if box is not None and entry is None:
            continue
        if name == LAYER:
            references = described(blocks.get("carrier_trajectory"))
            believed = _with(believed, cable_shape=declared_by(references, "shape"))
        model = simulated if box is not None and box.is_simulated else believed
        blocks[name] = make_block(boxes, name, entry, model)
    blocks = {name: blocks[name] for name in [*boxes, *blocks] if name in blocks}
    loop = LoopBlocks(blocks, believed, simulated)
    if loop.maker_of("wrench") is not None and loop.maker_of("wrench_rate") is None:
        blocks["wrench_rate"] = WrenchRate(believed)
    for message in [*loop.check()]:
        warn_user(message)
    _require_made(boxes, loop)
    if drawn.reference_governor is not None:
        trajectory = blocks.get("load_trajectory")
        remedy = "give a block for load_trajectory, or leave reference_governor out"
        require(trajectory is not None, "load_trajectory", None, remedy)
        blocks["load_trajectory"] = governed(
            believed,
            drawn.reference_governor,
            trajectory,
            drawn.optimization_layer,
            drawn.simulation_duration,
        )
    held = {SAMPLE_AND_HOLD: hold_of(loop)} if drawn.control_period > 0 else {}
    return Parts(loop, blocks | held)


def _with(model: Model, **attributes: Any) -> Model:
    """A copy of the model with other values of attributes."""
    model = copy.copy(model)
    vars(model).update(attributes)
    return model


def _bears_drag(entry: Any) -> bool:
    """Whether the block of a box's entry counts the drag of cables."""
    kind = block_of(type(entry)) if is_dataclass(entry) else entry
    return bool(declared_by(kind, "bears_drag", False))


def connected(boxes: Boxes, parts: Parts, inputs: Collection[str]) -> Diagram:
    """The loop of a scenario's blocks; `inputs` are as of `make_nonstop`."""
    loop = parts.loop
    needed = {signal.removeprefix(HELD) for name in loop.blocks for signal in loop.needed(name)}
    left_out = [
        signal
        for name, box in boxes.items()
        for signal in box.signals
        if name not in loop.blocks and signal in needed and loop.maker_of(signal) is None
    ]
    outside = dict.fromkeys(left_out) | wiring.sizes_of_inputs(parts.blocks, inputs)
    builder = DiagramBuilder()
    wiring.connect_by_name(builder, parts.blocks, inputs=[*outside])
    diagram = DiagramBlock()
    with block_blamed():  # Drake asks the blocks which outputs feed through
        builder.BuildInto(diagram)
    diagram.set_name(LOOP)
    return diagram


def models_of(scenario: Any) -> tuple[Model, Model]:
    """Models of what the controllers believe, and of what is simulated."""
    others = scenario.pattern, scenario.control_period
    believed = Model(scenario.system, *others)
    plant = overridden(scenario.system, scenario.simulated)
    require(
        len(plant.attachments) == believed.n,
        "simulated.attachments",
        plant.attachments,
        f"give as many attachment points as system.attachments has, {believed.n}",
    )
    given = tuple(given_fields(scenario.simulated))
    return believed, Model(plant, *others, field="simulated", overridden=given)


def _require_made(boxes: Boxes, loop: LoopBlocks) -> None:
    """Raises ScenarioError where a block needs what the block of a box does not make."""
    makers = {signal: name for name, box in boxes.items() for signal in box.signals}
    for name, block in loop.blocks.items():
        for signal in sorted({s.removeprefix(HELD) for s in loop.needed(name)}):
            maker = makers.get(signal)
            if maker is None or maker not in loop.blocks or loop.maker_of(signal) is not None:
                continue
            made = [v for v in boxes[maker].variants if signal in v.makes]
            others = boxes[name].variants if name in boxes else ()
            instead = [v for v in others if signal not in v.reads]
            raise ScenarioError(
                f"{name} = {type(block).__name__}: it reads {signal}, which "
                f"{maker} = {type(loop.blocks[maker]).__name__} does not make; give "
                f"{f'{maker}={made[0].__name__}' if made else 'it this output'}, or "
                f"{f'{name}={instead[0].__name__}' if instead else f'another block for {name}'}"
            )


def make_block(boxes: Boxes, name: str, entry: Any, model: Model) -> System:
    """The block that an entry makes of a model, for a box or beside them.

    Raises:
        ScenarioError: it is no such block, or its constructor does not take the model.
    """
    field = f"{'replacement' if name in boxes else 'extra'} {name}"
    if name not in boxes:
        config = _config_class(entry)
        entry = entry if config is None else config()
    arguments: tuple[Any, ...] = (model,)
    if is_dataclass(entry) and not isinstance(entry, type):
        arguments = model, entry
        entry = block_of(type(entry))
    remedy = "give a block's config, or a function that takes the model and returns a system"
    require(callable(entry), field, entry, remedy)
    try:
        block = called(field, remedy, entry, *arguments)
    except SystemExit:
        remedy = "give a function that returns a system, and does not exit"
        raise ScenarioError(f"{field} = SystemExit: {remedy}") from None
    remedy = "return a LeafSystem or Diagram from the function"
    require(isinstance(block, System), field, block, remedy)
    return block


Loop = TypeVar("Loop", bound=LoopConfig)


def replaced(
    boxes: Boxes, scenario: Loop, replacements: Mapping[str, Any]
) -> tuple[Loop, dict[str, Any]]:
    """The scenario with the configs among the replacements in their boxes; the other replacements.

    A block class whose module has the dataclass of its parameters, and that dataclass itself,
    stand for a config: the parameters that the block in the box has, too, stay as they are. All
    others are as in `make_nonstop`, with `extra` among them.

    Raises:
        ScenarioError: there is no box of a name, or the scenario is none.
    """
    is_scenario = callable(getattr(scenario, "sampled", None))
    require(is_scenario, "scenario", scenario, 'give one, such as load_scenario("line")')
    configs: dict[str, Any] = {}
    others: dict[str, Any] = {}
    for name, entry in replacements.items():
        is_known = name in boxes or name == EXTRA
        require(is_known, "replacement", name, f"give one of {', '.join(boxes)}")
        config = _config_class(entry)
        if config is not None:
            present = getattr(scenario, name)
            keeps_defaults = boxes[name].swap_keeps_defaults
            kept = kept_parameters(vars(present), type(present), config, keeps_defaults)
            entry = config(**kept)
        (configs if is_dataclass(entry) else others)[name] = entry
    scenario = copy.copy(scenario)
    for name, config in configs.items():
        setattr(scenario, name, config)
    return scenario, others


def _config_class(entry: Any) -> Any:
    """The dataclass of the parameters of a block class, if its module has one, or that itself."""
    if not isinstance(entry, type) or is_dataclass(entry):
        return entry if isinstance(entry, type) else None
    config = config_class(entry)
    is_pair = isinstance(config, type) and block_of(config) is entry
    return config if is_pair and is_dataclass(config) else None
