"""Makes the blocks of a loop from a scenario and its replacements, and connects them."""

import contextlib
import copy
import functools
import pickle
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import is_dataclass, replace
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
from pydrake.systems.analysis import SimulatorConfig
from pydrake.systems.framework import Diagram, DiagramBuilder, System

from drake_nonstop.blocks.reference_governor import ReferenceGovernorConfig, governed
from drake_nonstop.blocks.sample_and_hold import SAMPLE_AND_HOLD, hold_of
from drake_nonstop.blocks.wrench_controller import WrenchRate
from drake_nonstop.loop.box import Box, block_class, block_of, import_path, kept_parameters
from drake_nonstop.loop.loop_response import speed_margin_for, warn_of_margin
from drake_nonstop.mechanics.signals import LoadReference
from drake_nonstop.model.descriptions import described
from drake_nonstop.model.system import (
    Model,
    PatternConfig,
    SystemParameters,
    WatchedModel,
    given_fields,
    overridden,
)
from drake_nonstop.optimization.speed_margin import SpeedMargin, with_margin
from drake_nonstop.systems import wiring
from drake_nonstop.systems.block import LOOP, is_of_package
from drake_nonstop.systems.diagnosis import raising_block
from drake_nonstop.systems.documentation import config_class
from drake_nonstop.systems.energy import LoopDiagram
from drake_nonstop.systems.requirements import LoopBlocks
from drake_nonstop.systems.tracing import NotFiniteError
from drake_nonstop.validation import ScenarioError, called, one_line, require, warn_user

LAYER = "optimization_layer"
EXTRA = "extra"  # the argument for blocks beyond the figure's, among replacements

Boxes = Mapping[str, Box]  # of a figure, by their names
Maker = Callable[[Model], System]  # of a block, such as its class


class LoopConfig(Protocol):
    """Interface of a `Scenario`, which also has the config of each box by its name."""

    system: SystemParameters
    simulated: Any  # `SystemOverrides`
    simulation_duration: float
    control_period: float
    reference_governor: ReferenceGovernorConfig | None
    optimization_layer: Any  # a config
    simulator_config: SimulatorConfig

    @property
    def pattern(self) -> PatternConfig:
        """The periodic internal force."""
        ...

    def sampled(self) -> Any:
        """Returns the scenario with numbers drawn for its distributions.

        Raises:
            ScenarioError: a field cannot be used.
        """
        ...


class Parts(NamedTuple):
    """Blocks that a loop is connected from."""

    loop: LoopBlocks
    blocks: dict[str, System]  # those of the loop, with the hold in front of sampled controllers
    watched: dict[str, WatchedModel]  # what blocks read of their models
    margin: SpeedMargin | None  # that was computed for the optimization layer


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
    is_scenario = callable(getattr(scenario, "sampled", None))
    require(is_scenario, "scenario", scenario, 'give one, such as load_scenario("line")')
    scenario, others = replaced(boxes, scenario, replacements)
    scenario = scenario.sampled()
    believed, simulated = models_of(scenario)
    cables = others.get("cables", getattr(scenario, "cables", None))
    simulated = _beside_cables(cables, simulated)
    trajectory = others.get("carrier_trajectory", getattr(scenario, "carrier_trajectory", None))
    believed = _beside_cables(trajectory, believed)
    sizes = _figure_sizes(boxes, believed)
    blocks: dict[str, System] = {}
    watched: dict[str, WatchedModel] = {}
    margin: SpeedMargin | None = None
    entries = {name: others.get(name, getattr(scenario, name)) for name in boxes}
    entries[LAYER] = entries.pop(LAYER)  # it comes last
    for name, entry in (entries | _checked_extra(boxes, extra)).items():
        box = boxes.get(name)
        if box is not None and entry is None:
            continue
        if name == LAYER and getattr(entry, "wants_margin", False):
            duration = scenario.simulation_duration
            found = speed_margin_for(believed, simulated, entry, blocks, duration)
            warn_of_margin(found)
            margin = found.margin
            entry = with_margin(entry, margin)
        if name == LAYER:
            references = described(blocks.get("carrier_trajectory"))
            believed = copy.copy(believed)
            believed.cable_shape = getattr(references, "shape", None)
        is_simulated = box is not None and box.is_simulated
        model = watched[name] = WatchedModel(simulated if is_simulated else believed)
        block = blocks[name] = make_block(boxes, name, entry, model)
        _check_layouts(name, block)
        expected = ({}, {}) if box is None else box.required_and_optional(believed, block)
        made = wiring.check_outputs(name, block, *expected)
        others_made = made.keys() - (box.signals.keys() if box is not None else ())
        in_place = {signal: size for signal, size in sizes.items() if signal in others_made}
        wiring.check_outputs(name, block, in_place, {})
    blocks = {name: blocks[name] for name in [*boxes, *blocks] if name in blocks}
    made_by_all = {signal for block in blocks.values() for signal in wiring.output_names(block)}
    if "wrench" in made_by_all and "wrench_rate" not in made_by_all:
        blocks["wrench_rate"] = WrenchRate(believed)
    loop = LoopBlocks(blocks, believed, simulated)
    _require_motion(loop)
    told = [*loop.check(), *_unread(boxes, loop)]
    _require_made(boxes, loop)
    _check_preview(loop)
    for message in told:
        warn_user(message)
    if scenario.reference_governor is not None:
        trajectory = blocks.get("load_trajectory")
        remedy = "give a block for load_trajectory, or leave reference_governor out"
        require(trajectory is not None, "load_trajectory", None, remedy)
        slowed = governed(
            believed,
            scenario.reference_governor,
            trajectory,
            with_margin(scenario.optimization_layer, margin),
            scenario.simulation_duration,
            *loop.origin_of("wind_estimate"),
        )
        blocks = blocks | {"load_trajectory": slowed}
        loop = replace(loop, blocks=blocks)
    held = {SAMPLE_AND_HOLD: hold_of(loop)} if scenario.control_period > 0 else {}
    return Parts(loop, blocks | held, watched, margin)


def _beside_cables(entry: Any, model: Model) -> Model:
    """The model, in which carriers have no share of the drag that a block counts as the cables'."""
    kind = block_of(type(entry)) if is_dataclass(entry) else entry
    if not getattr(kind, "bears_drag", False):
        return model
    model = copy.copy(model)
    model.bears_cable_drag = False
    return model


def connected(boxes: Boxes, parts: Parts, inputs: Collection[str]) -> Diagram:
    """The loop of a scenario's blocks; `inputs` are as of `make_nonstop`."""
    outside = _signals_left_out(boxes, parts.loop) | wiring.sizes_of_inputs(parts.blocks, inputs)
    builder = DiagramBuilder()
    wiring.connect_by_name(builder, parts.blocks, inputs=outside)
    diagram = LoopDiagram()
    with naming_the_block():  # Drake asks the blocks which outputs feed through
        builder.BuildInto(diagram)
    diagram.set_name(LOOP)
    diagram.speed_margin = parts.margin
    diagram.watched_models = {
        name: model
        for name, model in parts.watched.items()
        if not is_of_package(parts.blocks.get(name))
    }
    return diagram


def models_of(scenario: LoopConfig) -> tuple[Model, Model]:
    """Models of what the controllers believe, and of what is simulated."""
    others = scenario.pattern, scenario.control_period
    believed = _model(scenario.system, *others, "system", ())
    plant = overridden(scenario.system, scenario.simulated)
    require(
        len(plant.attachments) == believed.n,
        "simulated.attachments",
        plant.attachments,
        f"give as many attachment points as system.attachments has, {believed.n}",
    )
    return believed, _model(plant, *others, "simulated", tuple(given_fields(scenario.simulated)))


def _model(*own: Any) -> Model:
    """The model of a system, a pattern and what follows these as arguments of `Model`."""
    try:
        return _model_of(pickle.dumps(own))
    except (pickle.PicklingError, AttributeError, TypeError):  # a pattern of the user's own
        return Model(*own[:3], field=own[3], overridden=own[4])


@functools.lru_cache(maxsize=128)
def _model_of(content: bytes) -> Model:
    *own, field, overridden = pickle.loads(content)
    return Model(*own, field=field, overridden=overridden)


def _require_motion(loop: LoopBlocks) -> None:
    """Raises ScenarioError where neither the pattern nor the load moves the carriers."""
    model = loop.believed
    reference = loop.at_start("reference") if model.pattern.is_constant else None
    if reference is not None:
        require(
            np.any(LoadReference.view(reference).angular_velocity),
            "pattern",
            type(model.pattern_config).__name__.removesuffix("Config"),
            "its carriers keep their places above the load, which does not turn at the start, and "
            "would stop; give load_trajectory: !SteadyTurn, or a pattern with orbits",
        )


def _require_made(boxes: Boxes, loop: LoopBlocks) -> None:
    """Raises WiringError where a block needs what a block of a box may make, and does not."""
    makers = {signal: name for name, box in boxes.items() for signal in box.optional}
    for name, block in loop.blocks.items():
        needed = loop.needed(name)
        for signal, maker in makers.items():
            is_made = loop.maker_of(signal) is not None
            if signal not in needed or maker not in loop.blocks or is_made:
                continue
            variant = boxes[maker].optional[signal]
            instead = boxes[name].alternatives.get(signal) if name in boxes else None
            raise wiring.WiringError(
                f"{name} = {type(block).__name__}: it reads {signal}, which "
                f"{maker} = {type(loop.blocks[maker]).__name__} does not make; give "
                f"{f'{maker}={variant}' if variant else 'it this output'}, or "
                f"{f'{name}={instead}' if instead else f'another block for {name}'}"
            )


def _unread(boxes: Boxes, loop: LoopBlocks) -> Iterator[str]:
    """Signals made for a box's block, which does not read them."""
    for box in boxes.values():
        own = loop.maker_of(next(iter(box.signals)))
        for signal, sentence in box.expected_inputs.items():
            maker = loop.maker_of(signal)
            if own is None or maker in (None, own) or getattr(maker, "is_trivial", False):
                continue
            if signal not in wiring.input_names(own):
                name = next(name for name, block in loop.blocks.items() if block is own)
                yield f"{name} = {type(own).__name__}: {sentence}"


def _check_preview(loop: LoopBlocks) -> None:
    """Raises ScenarioError where a user's own block does not tell the reference that it makes."""
    for name, block in loop.blocks.items():
        if is_of_package(block) or "reference_preview" not in wiring.output_names(block):
            continue
        field = f"{name}.reference_preview"
        if block.num_input_ports() > 0:
            preview = block.GetOutputPort("reference_preview").Allocate().get_value()
        else:
            start = block.CreateDefaultContext()
            preview = block.GetOutputPort("reference_preview").Eval(start)
        remedy = "give a ReferencePreview, such as ReferencePreview(reference_at)"
        is_preview = callable(preview) and hasattr(preview, "end_time")
        require(is_preview, field, type(preview).__name__, remedy)
        reference = loop.at_start("reference", block)
        if reference is None:
            continue
        told = np.asarray(preview(0.0), dtype=float)
        is_equal = told.shape == reference.shape and np.allclose(told, reference, atol=1e-9)
        remedy = f"at t = 0 it is not what {name} makes as reference; correct one of the two"
        require(is_equal, field, told.tolist(), remedy)


def make_block(boxes: Boxes, name: str, entry: Any, model: Model) -> System:
    """The block that an entry makes of a model, for a box or beside them."""
    field, besides = f"replacement {name}", ", or None to leave the box out"
    if name not in boxes:
        field, besides = f"extra {name}", ""
        config = _config_class(entry)
        entry = entry if config is None else config()
    if is_dataclass(entry) and not isinstance(entry, type):
        entry = _constructor(boxes, name, entry)
    remedy = f"give a block's config, a function that takes the model and returns a system{besides}"
    require(callable(entry), field, entry, remedy)
    try:
        block = called(field, remedy, entry, model)
    except SystemExit:
        remedy = "give a function that returns a system, and does not exit"
        raise ScenarioError(f"{field} = SystemExit: {remedy}") from None
    remedy = "return a LeafSystem or Diagram from the function"
    require(isinstance(block, System), field, block, remedy)
    return block


@contextlib.contextmanager
def naming_the_block() -> Iterator[None]:
    """Has an error of a block of the user's own tell the block and the line, in one sentence."""
    try:
        yield
    except (ScenarioError, NotFiniteError):
        raise
    except Exception as error:  # whatever a block may raise
        blamed = raising_block(error)
        if not blamed:
            raise  # Drake's own, such as that of an algebraic loop
        raise ScenarioError(f"{blamed}{one_line(error)}; correct the block") from error


def _check_layouts(name: str, block: System) -> None:
    """Raises ScenarioError where the layouts that a block declares are not those of its ports."""
    layouts = getattr(block, "signal_layouts", {})
    field = f"{name}.signal_layouts"
    remedy = 'give a mapping from ports to Layouts, such as {"fuel": Layout(Part("", "n", "kg"))}'
    require(isinstance(layouts, Mapping), field, layouts, remedy)
    ports = wiring.output_names(block)
    for port, layout in layouts.items():
        remedy = f"give the name of an output port, such as {' or '.join(ports[:3])}"
        require(port in ports, field, port, remedy)
        field_of_port = f"{field}[{port}]"
        require(hasattr(layout, "entries"), field_of_port, layout, "give a Layout")
        size = block.GetOutputPort(port).size()
        remedy = f"give a Layout of {size} entries, as the port has, or the port another size"
        require(layout.entries(port, size), field_of_port, f"{layout.size} entries", remedy)


def _figure_sizes(boxes: Boxes, model: Model) -> dict[str, int | None]:
    """The sizes of all the figure's signals."""
    return {
        signal: size
        for box in boxes.values()
        for signal, size in box.sizes(model.n, model.m).items()
    }


def _signals_left_out(boxes: Boxes, loop: LoopBlocks) -> dict[str, int | None]:
    """The signals, with their sizes, of boxes left out that no block makes in their place.

    Of the optional ones those that other blocks need.
    """
    needed = {signal for name in loop.blocks for signal in loop.needed(name)}
    sizes = _figure_sizes(boxes, loop.believed)
    return {
        signal: sizes[signal]
        for name, box in boxes.items()
        if name not in loop.blocks
        for signal in box.signals
        if (signal not in box.optional or signal in needed) and loop.maker_of(signal) is None
    }


def _checked_extra(boxes: Boxes, extra: Mapping[str, Any] | None) -> dict[str, Any]:
    """The blocks beyond the figure's."""
    remedy = 'give a mapping from names to blocks, such as {"estimator": Estimator}'
    require(extra is None or isinstance(extra, Mapping), "extra", extra, remedy)
    for name in extra or {}:
        taken = name in boxes or name == SAMPLE_AND_HOLD
        remedy = f"it is a box of the figure; give it as {name}=..., or its block another name"
        if name == SAMPLE_AND_HOLD:
            remedy = "the loop has a block of that name; give another one"
        require(not taken, "extra", name, remedy)
        wiring.require_name("extra", name)
    return dict(extra or {})


Loop = TypeVar("Loop", bound=LoopConfig)


def replaced(
    boxes: Boxes, scenario: Loop, replacements: Mapping[str, Any]
) -> tuple[Loop, dict[str, Any]]:
    """The scenario with the configs among the replacements in their boxes; the other replacements.

    A block class whose module has the dataclass of its parameters, and that dataclass itself,
    stand for a config: the parameters that the block in the box has, too, stay as they are. All
    others are as in `make_nonstop`, with `extra` among them.

    Raises:
        ScenarioError: there is no box of a name.
    """
    configs: dict[str, Any] = {}
    others: dict[str, Any] = {}
    for name, entry in replacements.items():
        if name == EXTRA:
            others[name] = entry
            continue
        require(name in boxes, "replacement", name, f"give one of {', '.join(boxes)}")
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


def _config_class(entry: Any) -> type | None:
    """The dataclass of the parameters of a block class, if its module has one."""
    if not isinstance(entry, type):
        return None
    if is_dataclass(entry):
        return entry
    config = config_class(entry)
    if isinstance(config, type) and is_dataclass(config) and block_of(config) is entry:
        return config
    return None


def _constructor(boxes: Boxes, name: str, config: Any) -> Callable[[Model], System]:
    """Maker of the block of a config for the box of that name, or beside the boxes."""
    block: Any = block_class(name if name in boxes else f"extra {name}", type(config))
    if name not in boxes or block in boxes[name].variants:
        return lambda model: block(model, config)
    choices = ", ".join(variant.__name__ for variant in boxes[name].variants)
    is_own = all(block not in box.variants for box in boxes.values())
    require(is_own, name, block.__name__, f"give one of {choices}")

    def make(model: Model) -> System:
        try:
            return block(model, config)
        except ScenarioError:
            raise
        except (Exception, SystemExit) as error:  # whatever a user's constructor may raise
            raise ScenarioError(
                f"{name} = !{import_path(type(config))}: correct its constructor, which takes "
                f"the model and the config ({one_line(error)})"
            ) from error

    return make
