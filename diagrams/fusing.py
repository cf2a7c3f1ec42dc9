"""One block in place of the plant's boxes, where that gives the same signals."""

import math
import warnings
from collections.abc import Mapping
from graphlib import CycleError, TopologicalSorter

from pydrake.systems.analysis import SimulatorConfig
from pydrake.systems.framework import System

from drake_nonstop.blocks.fused_plant import FusedPlant
from drake_nonstop.diagrams.box import Box
from drake_nonstop.systems.parameters import declared
from drake_nonstop.systems.traced_block import Equations
from drake_nonstop.systems.wiring import input_names, output_names
from drake_nonstop.validation import ScenarioWarning

_AIRCRAFT_COMMAND = "aircraft_command"  # a signal that only blocks of aircraft make and read
_MAX_STEPS = 20  # in a control period: all of them are in one trace


def fuse(
    blocks: Mapping[str, System],
    boxes: Mapping[str, Box],
    name: str,
    control_period: float,
    config: SimulatorConfig,
) -> dict[str, System]:
    """The blocks with one in place of those whose boxes are `is_fused`.

    Where that would not give the same signals, a ScenarioWarning tells why, and the blocks are
    returned as they are.

    Args:
        blocks: by the names of their boxes.
        boxes: of the figure.
        name: of the block that takes their place.
        control_period: the controllers' sample time in s.
        config: whose integrator and step the block takes over.
    """
    fused = [box for box in boxes if boxes[box].is_fused]
    equations = {box: getattr(blocks.get(box), "equations", None) for box in fused}
    parts = {box: own for box, own in equations.items() if isinstance(own, Equations)}
    steps = max(1, math.ceil(control_period / config.max_step_size - 1e-9))
    reason = _reason_against(blocks, boxes, parts, control_period, steps, config)
    if not reason:
        try:
            ordered = _in_order(parts)
        except CycleError as error:
            reason = f"{_named(error.args[1][0], blocks)} reads what is made from its own outputs"
    if reason:
        message = f"fused_plant = true: {reason}; the separate blocks are used instead"
        warnings.warn(message, ScenarioWarning, stacklevel=4)
        return dict(blocks)
    others = {box: block for box, block in blocks.items() if box not in fused}
    hold_order = max((getattr(block, "hold_order", 1) for block in others.values()), default=1)
    plant = FusedPlant(ordered, period=control_period, steps=steps, hold_order=hold_order)
    plant.kept_parameters = {
        box: [parameters for _, parameters, _ in declared(blocks[box])] for box in fused
    }
    return others | {name: plant}


def _reason_against(
    blocks: Mapping[str, System],
    boxes: Mapping[str, Box],
    parts: Mapping[str, Equations],
    control_period: float,
    steps: int,
    config: SimulatorConfig,
) -> str:
    """Why the blocks cannot be one with that number of steps a sample; empty where they can."""
    apart = [name for name, box in boxes.items() if box.is_fused and name not in parts]
    for block in (blocks[name] for name in apart if name in blocks):
        if _AIRCRAFT_COMMAND in {*input_names(block), *output_names(block)}:
            return "aircraft fly with separate blocks, so give fused_plant = false"
    if control_period == 0:
        return "control_period = 0, and it steps from sample to sample of the controllers"
    if config.integration_scheme != "runge_kutta3" or config.use_error_control:
        return "its steps are those of runge_kutta3 without error control"
    if steps > _MAX_STEPS:
        return f"{steps} steps a sample, of which {_MAX_STEPS} at most are traced"
    made = {signal for block in blocks.values() for signal in output_names(block)}
    for name, box in boxes.items():
        is_elsewhere = name not in blocks and made >= box.signals.keys() - set(box.optional)
        is_sampled = is_elsewhere or getattr(blocks.get(name), "is_sampled", False)
        if box.feeds_fused_plant and not is_sampled:
            return f"{_named(name, blocks)} may change between samples"
    read = {port for part in parts.values() for port in part.inputs}
    for name, block in blocks.items():
        others = set(output_names(block)) - (boxes[name].signals.keys() if name in boxes else set())
        if others & read and not getattr(block, "is_sampled", False):
            return f"{_named(name, blocks)} may change between samples"
    if apart:
        return f"{_named(apart[0], blocks)} has no equations to be traced"
    if not any("carrier_reference" in part.inputs for part in parts.values()):
        return "no part of it reads carrier_reference"
    return ""


def _in_order(parts: Mapping[str, Equations]) -> dict[str, Equations]:
    """The parts, each after those whose outputs it reads; a state is known beforehand."""
    sources = {port: name for name, part in parts.items() for port in part.outputs}
    reads = {
        name: [sources[port] for port in part.inputs if port in sources]
        for name, part in parts.items()
    }
    return {name: parts[name] for name in TopologicalSorter(reads).static_order()}


def _named(name: str, blocks: Mapping[str, System]) -> str:
    return f"{name} = {type(blocks[name]).__name__ if name in blocks else 'left out'}"
