"""The paper's control figure, as data.

load_trajectory ──────────┬──> optimization_layer ──> phase
                          │             │               │
                          │             └──> internal_force
                          v                       │
load_feedback ──> wrench_controller ──> force_distribution ──> carrier_trajectory
      ^                                                              │
      │                                                      carrier_controller
  load_plant <── cables <── carrier_dynamics <────────────────────────┘
"""

import math
import warnings
from collections.abc import Callable
from dataclasses import is_dataclass
from typing import TYPE_CHECKING, Any

from pydrake.systems.framework import Diagram, System

from drake_nonstop.blocks import (
    cables,
    carrier_controller,
    carrier_dynamics,
    carrier_trajectory,
    force_distribution,
    internal_force,
    load_disturbance,
    load_feedback,
    load_plant,
    load_trajectory,
    optimization_layer,
    phase,
    wrench_controller,
)
from drake_nonstop.blocks.fused_plant import FusedPlant
from drake_nonstop.blocks.sample_and_hold import HELD_SIGNALS, SampleAndHold
from drake_nonstop.model.system import Model, overridden
from drake_nonstop.scenario.own_blocks import import_path, make_own_block, own_block_class
from drake_nonstop.systems import wiring
from drake_nonstop.systems.block import LOOP
from drake_nonstop.systems.traced_block import Equations
from drake_nonstop.validation import ScenarioError, ScenarioWarning, require

if TYPE_CHECKING:
    from drake_nonstop.scenario.loading import Scenario

# The boxes of the figure, and the blocks that each can be, the default first.
BLOCKS: dict[str, tuple[type[System], ...]] = {
    "load_trajectory": load_trajectory.VARIANTS,
    "load_feedback": load_feedback.VARIANTS,
    "wrench_controller": wrench_controller.VARIANTS,
    "optimization_layer": optimization_layer.VARIANTS,
    "phase": phase.VARIANTS,
    "internal_force": internal_force.VARIANTS,
    "force_distribution": force_distribution.VARIANTS,
    "carrier_trajectory": carrier_trajectory.VARIANTS,
    "carrier_controller": carrier_controller.VARIANTS,
    "carrier_dynamics": carrier_dynamics.VARIANTS,
    "cables": cables.VARIANTS,
    "load_disturbance": load_disturbance.VARIANTS,
    "load_plant": load_plant.VARIANTS,
}

# What is simulated and not believed: these take the scenario's `simulated` system.
PLANT = ("carrier_dynamics", "cables", "load_plant")

# What `fused_plant` makes one block of, each after those whose outputs it reads.
FUSED = ("carrier_controller", "cables", "carrier_dynamics", "load_plant")

_MOST_STEPS = 20  # in a control period; all of them are in one trace

# What that block reads from, directly or not. Of others than the package's nobody knows whether
# they change between the controllers' samples.
_SAMPLED = (
    *("wrench_controller", "optimization_layer", "phase", "internal_force", "force_distribution"),
    *("carrier_trajectory", "load_disturbance"),
)

# The figure's wires, to be read. They follow from the names of the ports, and building
# the default blocks checks this list against what was built. Where the scenario has a
# control period, a `sample_and_hold` stands in front of the controllers, in the wires of
# `measured_load_state` and `reference`.
WIRES = """
load_trajectory.reference -> wrench_controller.reference
load_trajectory.reference -> optimization_layer.reference
load_trajectory.reference -> carrier_trajectory.reference

load_plant.load_state -> load_feedback.load_state
load_feedback.measured_load_state -> wrench_controller.measured_load_state
load_feedback.measured_load_state -> optimization_layer.measured_load_state
load_feedback.measured_load_state -> force_distribution.measured_load_state

wrench_controller.wrench -> optimization_layer.wrench
wrench_controller.wrench_rate -> optimization_layer.wrench_rate
wrench_controller.wrench -> force_distribution.wrench
wrench_controller.wrench_rate -> force_distribution.wrench_rate

optimization_layer.parameters -> phase.parameters
optimization_layer.parameters -> internal_force.parameters
phase.phase -> optimization_layer.phase
phase.phase -> internal_force.phase
internal_force.internal_force -> force_distribution.internal_force

force_distribution.desired_cable_forces -> carrier_trajectory.desired_cable_forces
force_distribution.desired_cable_force_rates -> carrier_trajectory.desired_cable_force_rates
carrier_trajectory.carrier_reference -> carrier_controller.carrier_reference
carrier_controller.carrier_forces -> carrier_dynamics.carrier_forces
carrier_dynamics.carrier_state -> carrier_controller.carrier_state

carrier_dynamics.carrier_state -> cables.carrier_state
load_plant.load_state -> cables.load_state
cables.cable_forces -> load_plant.cable_forces
load_disturbance.disturbance_wrench -> load_plant.disturbance_wrench
"""

# What comes out of each box: the size of every signal, for n carriers and m coordinates of the
# internal force. Whatever is put in a box must make its signals, save those that are optional:
# they are reported where they are there, and nothing in the figure reads them.
SIGNALS: dict[str, dict[str, str]] = {
    "load_trajectory": {"reference": "22"},
    "load_feedback": {"measured_load_state": "13"},
    "wrench_controller": {"wrench": "6", "wrench_rate": "6", "tracking_error": "12"},
    "optimization_layer": {
        "parameters": "2",
        "diagnostics": "7",
        "solve_time": "1",
        "speed_bound": "1",
    },
    "phase": {"phase": "2"},
    "internal_force": {"internal_force": "2m"},
    "force_distribution": {"desired_cable_forces": "3n", "desired_cable_force_rates": "3n"},
    "carrier_trajectory": {"carrier_reference": "6n"},
    "carrier_controller": {"carrier_forces": "3n"},
    "carrier_dynamics": {"carrier_state": "6n"},
    "cables": {"cable_forces": "3n", "tensions": "n"},
    "load_disturbance": {"disturbance_wrench": "6"},
    "load_plant": {"load_state": "13"},
    "sample_and_hold": {
        "held_measured_load_state": "13",
        "held_reference": "22",
        "sample_time": "1",
    },
}
OPTIONAL_SIGNALS = ("tracking_error", "diagnostics", "solve_time", "speed_bound")


def signal_sizes(box: str, n: int, m: int) -> dict[str, int]:
    """The sizes of a box's signals for n carriers and m internal-force coordinates."""
    numbers = {"n": n, "m": m}
    return {
        signal: int(size.rstrip("nm") or 1) * numbers.get(size[-1], 1)
        for signal, size in SIGNALS[box].items()
    }


def figure_wires() -> set[str]:
    """`WIRES` as a set of "block.port -> block.port"."""
    return {line for line in WIRES.splitlines() if line}


def make_nonstop(scenario: "Scenario", **replacements: Callable[[Model], System] | Any) -> Diagram:
    """The closed loop of a scenario as a diagram, one subsystem per box of the figure.

    Every signal is exported under its name: `diagram.GetOutputPort("load_state")`. With
    `fused_plant` one subsystem, `plant`, stands for the boxes in `FUSED`; where that cannot be,
    a ScenarioWarning tells why, and they are built as ever.

    Args:
        scenario: the system, the pattern and one config per box.
        replacements: by the name of a box, what to put in its place: a block's config, or
            a function (a block class, for instance) that takes the `Model` and returns a
            LeafSystem or Diagram with ports named after the signals it reads and makes; or
            None to leave the box out: the signals that it has to make become input ports of
            the diagram, for a bigger one to connect.

    Raises:
        ScenarioError: the scenario or a replacement cannot be built, or the ports of a
            replacement do not fit; the message names the field, the value and the remedy.
    """
    for name in replacements:
        require(name in BLOCKS, "replacement", name, f"give one of {', '.join(BLOCKS)}")
    believed = Model(scenario.system, scenario.pattern, scenario.control_period)
    plant = overridden(scenario.system, scenario.simulated)
    require(
        len(plant.attachments) == believed.n,
        "simulated.attachments",
        plant.attachments,
        f"give as many attachment points as system.attachments has, {believed.n}",
    )
    simulated = Model(plant, scenario.pattern, scenario.control_period, field="simulated")
    blocks: dict[str, System] = {}
    outside: dict[str, int] = {}
    for name in BLOCKS:
        entry = replacements.get(name, getattr(scenario, name))
        if entry is None:
            outside |= _signals(name, believed)[0]
            continue
        make = _constructor(name, entry) if is_dataclass(entry) else entry
        require(
            callable(make),
            f"replacement {name}",
            entry,
            "give a block's config, a function that takes the model and returns a system, or "
            "None to leave the box out",
        )
        blocks[name] = make(simulated if name in PLANT else believed)
        require(
            isinstance(blocks[name], System),
            f"replacement {name}",
            blocks[name],
            "return a LeafSystem or Diagram from the function",
        )
        wiring.check_outputs(name, blocks[name], *_signals(name, believed))
    if scenario.fused_plant:
        _fuse(blocks, scenario)
    replaced_signals = {}
    if scenario.control_period > 0:
        blocks["sample_and_hold"] = SampleAndHold(believed)
        replaced_signals = {signal: f"held_{signal}" for signal in HELD_SIGNALS}
    diagram = wiring.connect(blocks, name=LOOP, replaced_signals=replaced_signals, outside=outside)
    if all(type(blocks.get(name)) is BLOCKS[name][0] for name in BLOCKS):
        difference = _without_sampling(wiring.connections(diagram)) ^ figure_wires()
        if difference:
            raise wiring.WiringError(
                f"WIRES = {difference}: these differ between the list and the diagram that was "
                "built; mend the list or the ports"
            )
    return diagram


def _named(name: str, blocks: dict[str, System]) -> str:
    return f"{name} = {type(blocks[name]).__name__ if name in blocks else 'left out'}"


def _fuse(blocks: dict[str, System], scenario: "Scenario") -> None:
    """Puts one block in the place of those in `FUSED`, where it is known to do what they do."""
    equations = {name: getattr(blocks.get(name), "equations", None) for name in FUSED}
    parts = {name: own for name, own in equations.items() if isinstance(own, Equations)}
    steps = max(1, math.ceil(scenario.control_period / scenario.simulator.max_step_size - 1e-9))
    reason = _why_not_fused(blocks, scenario, parts, steps)
    if reason:
        message = f"fused_plant = true: {reason}; the separate blocks are used instead"
        warnings.warn(message, ScenarioWarning, stacklevel=3)
        return
    for name in FUSED:
        del blocks[name]
    blocks["plant"] = FusedPlant(parts, period=scenario.control_period, steps=steps)


def _why_not_fused(
    blocks: dict[str, System], scenario: "Scenario", parts: dict[str, Equations], steps: int
) -> str:
    """Why the blocks cannot be one with so many steps a sample, or nothing."""
    simulator = scenario.simulator
    if scenario.control_period == 0:
        return "control_period = 0, and it steps from sample to sample of the controllers"
    if simulator.integration_scheme != "runge_kutta3" or simulator.use_error_control:
        return "its steps are those of runge_kutta3 without error control"
    if steps > _MOST_STEPS:
        return f"{steps} steps a sample, of which {_MOST_STEPS} at most are traced"
    for name in _SAMPLED:
        if not type(blocks.get(name)).__module__.startswith("drake_nonstop.blocks."):
            return f"{_named(name, blocks)} may change between samples"
    for name in FUSED:
        if name not in parts:
            return f"{_named(name, blocks)} has no equations to be traced"
    later = {port for part in parts.values() for port in part.outputs}
    for name, part in parts.items():
        if later & part.inputs.keys():
            return f"{_named(name, blocks)} reads what is made after it"
        later -= part.outputs.keys()
    if not any("carrier_reference" in part.inputs for part in parts.values()):
        return "no part of it reads carrier_reference"
    return ""


def _signals(box: str, model: Model) -> tuple[dict[str, int], dict[str, int]]:
    """The signals that a box has to make, and those that it may make, with their sizes."""
    sizes = signal_sizes(box, model.n, model.m)
    optional = {signal: sizes.pop(signal) for signal in OPTIONAL_SIGNALS if signal in sizes}
    return sizes, optional


def _without_sampling(wires: list[str]) -> set[str]:
    """The wires as they would be if the sample-and-hold passed its inputs through."""
    pairs = [tuple(wire.split(" -> ")) for wire in wires]
    sources = {
        target.replace(".", ".held_"): source
        for source, target in pairs
        if target.startswith("sample_and_hold.")
    }
    return {
        f"{sources.get(source, source)} -> {target}"
        for source, target in pairs
        if not target.startswith("sample_and_hold.") and not target.endswith(".sample_time")
    }


def block_class(instance: str, config: Any) -> type[System]:
    """The block that a config is for: of class X for a config of class XConfig."""
    if import_path(config):
        return own_block_class(instance, type(config))
    name = type(config).__name__.removesuffix("Config")
    for block in BLOCKS[instance]:
        if block.__name__ == name:
            return block
    choices = ", ".join(block.__name__ for block in BLOCKS[instance])
    raise ScenarioError(f"{instance} = {name}: give one of {choices}")


def _constructor(instance: str, config: Any) -> Callable[[Model], System]:
    if import_path(config):
        return lambda model: make_own_block(instance, model, config)
    block = block_class(instance, config)
    return lambda model: block(model, config)
