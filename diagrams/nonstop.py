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

import copy
import sys
from collections.abc import Callable, Mapping
from dataclasses import is_dataclass
from typing import Any, Protocol, TypeVar

from pydrake.systems.analysis import SimulatorConfig
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
from drake_nonstop.blocks.sample_and_hold import HELD_SIGNALS, SampleAndHold
from drake_nonstop.diagrams.box import (
    Box,
    Kind,
    Place,
    block_class,
    block_of,
    import_path,
    kept_parameters,
)
from drake_nonstop.diagrams.fusing import fuse
from drake_nonstop.mechanics.signals import (
    LOAD_REFERENCE_SIZE,
    LOAD_STATE_SIZE,
    PARAMETERS_SIZE,
    PHASE_SIZE,
    TRACKING_ERROR_SIZE,
    WRENCH_SIZE,
)
from drake_nonstop.model.system import Model, PatternConfig, SystemParameters, overridden
from drake_nonstop.optimization.diagnostics import DIAGNOSTICS_SIZE
from drake_nonstop.systems import wiring
from drake_nonstop.systems.block import LOOP
from drake_nonstop.validation import ScenarioError, one_line, require

# The boxes of the figure, in its order.
BOXES: dict[str, Box] = {
    "load_trajectory": Box(
        variants=load_trajectory.VARIANTS,
        signals={"reference": LOAD_REFERENCE_SIZE},
        place=Place(0, 1, 1, Kind.TRAJECTORY),
        swap_keeps_defaults=False,  # each task has times of its own
    ),
    "load_feedback": Box(
        variants=load_feedback.VARIANTS,
        signals={"measured_load_state": LOAD_STATE_SIZE},
        place=Place(0, 2, 1, Kind.ADDITION),
    ),
    "wrench_controller": Box(
        variants=wrench_controller.VARIANTS,
        signals={
            "wrench": WRENCH_SIZE,
            "wrench_rate": WRENCH_SIZE,
            "tracking_error": TRACKING_ERROR_SIZE,
        },
        optional=("tracking_error",),
        place=Place(2, 2, 1, Kind.WRENCH),
        feeds_fused_plant=True,
    ),
    "optimization_layer": Box(
        variants=optimization_layer.VARIANTS,
        signals={
            "parameters": PARAMETERS_SIZE,
            "diagnostics": DIAGNOSTICS_SIZE,
            "solve_time": 1,
            "speed_bound": 1,
        },
        optional=("diagnostics", "solve_time", "speed_bound"),
        place=Place(3, 0, 1, Kind.OPTIMIZATION),
        config_fields={"speed_bound": "m/s, which its runs are judged by"},
        feeds_fused_plant=True,
    ),
    "phase": Box(
        variants=phase.VARIANTS,
        signals={"phase": PHASE_SIZE},
        place=Place(4, 0, 1, Kind.TRAJECTORY),
        feeds_fused_plant=True,
        is_linearized=False,  # nothing drives it: its multiplier is 1 in any loop
    ),
    "internal_force": Box(
        variants=internal_force.VARIANTS,
        signals={"internal_force": "2m"},
        place=Place(3, 1, -1, Kind.TRAJECTORY),
        feeds_fused_plant=True,
    ),
    "force_distribution": Box(
        variants=force_distribution.VARIANTS,
        signals={"desired_cable_forces": "3n", "desired_cable_force_rates": "3n"},
        place=Place(3, 2, 1, Kind.INNER_LOOP),
        feeds_fused_plant=True,
    ),
    "carrier_trajectory": Box(
        variants=carrier_trajectory.VARIANTS,
        signals={"carrier_reference": "6n"},
        place=Place(4, 2, 1, Kind.INNER_LOOP),
        feeds_fused_plant=True,
    ),
    "carrier_controller": Box(
        variants=carrier_controller.VARIANTS,
        signals={"carrier_forces": "3n"},
        place=Place(4, 3, -1, Kind.PLANT),
        is_fused=True,
    ),
    "carrier_dynamics": Box(
        variants=carrier_dynamics.VARIANTS,
        signals={"carrier_state": "6n"},
        place=Place(3, 3, -1, Kind.PLANT),
        is_simulated=True,
        is_fused=True,
    ),
    "cables": Box(
        variants=cables.VARIANTS,
        signals={"cable_forces": "3n", "tensions": "n"},
        place=Place(2, 3, -1, Kind.PLANT),
        is_simulated=True,
        is_fused=True,
    ),
    "load_disturbance": Box(
        variants=load_disturbance.VARIANTS,
        signals={"disturbance_wrench": WRENCH_SIZE},
        place=Place(0, 4, 1, Kind.ADDITION),
        feeds_fused_plant=True,
    ),
    "load_plant": Box(
        variants=load_plant.VARIANTS,
        signals={"load_state": LOAD_STATE_SIZE},
        place=Place(0, 3, -1, Kind.PLANT),
        is_simulated=True,
        is_fused=True,
    ),
}

# Subsystems that no scenario chooses: the hold in front of sampled controllers, and the fused
# plant in place of its boxes.
SAMPLE_AND_HOLD, FUSED_PLANT = "sample_and_hold", "plant"
PLACES: dict[str, Place] = {name: box.place for name, box in BOXES.items()} | {
    SAMPLE_AND_HOLD: Place(1, 2, 1, Kind.ADDITION),
    FUSED_PLANT: Place(2, 3, -1, Kind.PLANT),
}
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


def box_of(signal: str) -> str:
    """The name of the box that makes a signal of the figure."""
    return next(name for name, box in BOXES.items() if signal in box.signals)


def figure_wires() -> set[str]:
    """`WIRES` as a set of "block.port -> block.port"."""
    return {line for line in WIRES.splitlines() if line}


class LoopConfig(Protocol):
    """What a loop is made from: a `Scenario`, which also has the config of each box by its name."""

    system: SystemParameters
    simulated: Any  # `SystemOverrides`
    pattern: PatternConfig
    control_period: float
    fused_plant: bool
    simulator_config: SimulatorConfig

    def check(self) -> None:
        """Raises ScenarioError for the first field that cannot be used."""
        ...


def make_nonstop(scenario: LoopConfig, **replacements: Callable[[Model], System] | Any) -> Diagram:
    """The closed loop of a scenario as a diagram, one subsystem per box of the figure.

    Every signal is exported under its name: `diagram.GetOutputPort("load_state")`. With
    `fused_plant` one subsystem, `plant`, takes the place of the boxes that are `is_fused`; where
    that is not possible a ScenarioWarning tells why, and the separate blocks are built.

    Args:
        scenario: the system, the pattern and one config per box.
        replacements: by the name of a box, what to put in its place: a block's config; a block
            class with the dataclass of its parameters beside it, to which parameters go as in a
            swap by `--set` (see `replaced`); a function that takes the `Model` and returns a
            LeafSystem or Diagram with ports named after the signals it reads and makes; or
            None to leave the box out: the signals that it has to make become input ports of
            the diagram, for a bigger one to connect.

    Raises:
        ScenarioError: the scenario or a replacement cannot be built, or the ports of a
            replacement do not fit; the message names the field, the value and the remedy.
    """
    is_scenario = callable(getattr(scenario, "check", None))
    require(is_scenario, "scenario", scenario, 'give one, such as load_scenario("line")')
    scenario, others = replaced(scenario, replacements)
    scenario.check()
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
    for name, box in BOXES.items():
        required, optional = box.required_and_optional(believed)
        entry = others.get(name, getattr(scenario, name))
        if entry is None:
            outside |= required
            continue
        make = _constructor(name, entry) if is_dataclass(entry) else entry
        require(
            callable(make),
            f"replacement {name}",
            entry,
            "give a block's config, a function that takes the model and returns a system, or "
            "None to leave the box out",
        )
        try:
            blocks[name] = make(simulated if box.is_simulated else believed)
        except SystemExit:
            remedy = "give a function that returns a system, and does not exit"
            raise ScenarioError(f"replacement {name} = SystemExit: {remedy}") from None
        require(
            isinstance(blocks[name], System),
            f"replacement {name}",
            blocks[name],
            "return a LeafSystem or Diagram from the function",
        )
        wiring.check_outputs(name, blocks[name], required, optional)
    if scenario.fused_plant:
        config = scenario.simulator_config
        blocks = fuse(blocks, BOXES, FUSED_PLANT, scenario.control_period, config)
    replaced_signals = {}
    if scenario.control_period > 0:
        blocks[SAMPLE_AND_HOLD] = SampleAndHold(believed)
        replaced_signals = {signal: f"held_{signal}" for signal in HELD_SIGNALS}
    diagram = wiring.connect(blocks, name=LOOP, replaced_signals=replaced_signals, outside=outside)
    if all(type(blocks.get(name)) is box.variants[0] for name, box in BOXES.items()):
        difference = _without_sampling(wiring.connections(diagram)) ^ figure_wires()
        if difference:
            raise wiring.WiringError(
                f"WIRES = {difference}: these differ between the list and the diagram that was "
                "built; correct the list or the ports"
            )
    return diagram


_Loop = TypeVar("_Loop", bound=LoopConfig)


def replaced(scenario: _Loop, replacements: Mapping[str, Any]) -> tuple[_Loop, dict[str, Any]]:
    """The scenario with the configs among the replacements in their boxes; the other replacements.

    A block class whose module has the dataclass of its parameters, and that dataclass itself,
    stand for a config: the parameters that the block in the box has, too, stay as they are. All
    others are as in `make_nonstop`.

    Raises:
        ScenarioError: there is no box of a name.
    """
    configs: dict[str, Any] = {}
    others: dict[str, Any] = {}
    for name, entry in replacements.items():
        require(name in BOXES, "replacement", name, f"give one of {', '.join(BOXES)}")
        config = _config_class(entry)
        if config is not None:
            present = getattr(scenario, name)
            keeps_defaults = BOXES[name].swap_keeps_defaults
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
    config = getattr(sys.modules.get(entry.__module__), f"{entry.__name__}Config", None)
    if isinstance(config, type) and is_dataclass(config) and block_of(config) is entry:
        return config
    return None


def _without_sampling(wires: list[str]) -> set[str]:
    """The wires as they would be if the sample-and-hold passed its inputs through."""
    pairs = [tuple(wire.split(" -> ")) for wire in wires]
    sources = {
        target.replace(".", ".held_"): source
        for source, target in pairs
        if target.startswith(f"{SAMPLE_AND_HOLD}.")
    }
    return {
        f"{sources.get(source, source)} -> {target}"
        for source, target in pairs
        if not target.startswith(f"{SAMPLE_AND_HOLD}.") and not target.endswith(".sample_time")
    }


def _constructor(name: str, config: Any) -> Callable[[Model], System]:
    """What makes the block of a config for the box of that name."""
    block: Any = block_class(name, type(config))
    if block in BOXES[name].variants:
        return lambda model: block(model, config)
    choices = ", ".join(variant.__name__ for variant in BOXES[name].variants)
    is_own = all(block not in box.variants for box in BOXES.values())
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
