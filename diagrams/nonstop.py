"""The paper's control figure, as data.

load_trajectory ──────────┬──> optimization_layer ──> phase
                          │                             │
                          │                  internal_force
                          v                       │
load_feedback ──> wrench_controller ──> force_distribution ──> carrier_trajectory
      ^                                                              │
      │                                                      carrier_controller
  load_plant <── cables <── carrier_dynamics <────────────────────────┘
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

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
    wind,
    wind_estimator,
    wrench_controller,
)
from drake_nonstop.blocks.observed_carrier_trajectory import ObservedCarrierTrajectory
from drake_nonstop.blocks.sample_and_hold import SAMPLE_AND_HOLD
from drake_nonstop.loop import assembly
from drake_nonstop.loop.assembly import (
    Loop,
    LoopConfig,
    Maker,
    connected,
    make_parts,
)
from drake_nonstop.loop.box import Box, Kind, Place
from drake_nonstop.loop.start import set_default_equilibrium, starts_beside_defaults
from drake_nonstop.model.block import Block
from drake_nonstop.systems import wiring
from drake_nonstop.validation import require_flags

# What a carrier_trajectory may make, too.
_BESIDE_THE_REFERENCE = (
    "carrier_reference_acceleration",
    "carrier_reference_jerk",
    "sampled_carrier_reference",
    "sampled_carrier_reference_acceleration",
    "cable_drag_and_weight",
    "cable_drag_and_weight_rates",
    "cable_reference",
)

# What it may observe of load and cables.
_OBSERVED = (
    "load_mass_estimate",
    "centre_of_mass_estimate",
    "cable_length_estimate",
    "cable_drag_estimate",
)

# What an optimization_layer may make, too.
_OF_LAYERS = (
    "diagnostics",
    "plan",
    "solve_time",
    "speed_bound",
    "missed_limits",
    "measured_margin",
)

# The boxes of the figure, in its order.
BOXES: dict[str, Box] = {
    "load_trajectory": Box(
        variants=load_trajectory.VARIANTS,
        makes=("reference", "reference_higher_rates", "reference_preview", "reference_delay"),
        optional=("reference_higher_rates", "reference_preview", "reference_delay"),
        recorded_where_read=("reference_higher_rates",),
        place=Place(0, 1, 1, Kind.TRAJECTORY),
        swap_keeps_defaults=False,  # each task has times of its own
    ),
    "load_feedback": Box(
        variants=load_feedback.VARIANTS,
        makes=("measured_load_state", "measured_attitude", "measured_load_covariance"),
        optional=("measured_attitude", "measured_load_covariance"),
        recorded_where_read=("measured_attitude",),
        place=Place(0, 2, 1, Kind.ADDITION),
    ),
    "wrench_controller": Box(
        variants=wrench_controller.VARIANTS,
        makes=("wrench", "wrench_rate", "tracking_error"),
        optional=("wrench_rate", "tracking_error"),  # a WrenchRate makes the first
        place=Place(2, 2, 1, Kind.WRENCH),
    ),
    "optimization_layer": Box(
        variants=optimization_layer.VARIANTS,
        makes=("parameters", *_OF_LAYERS),
        optional=_OF_LAYERS,
        place=Place(3, 0, 1, Kind.OPTIMIZATION),
        config_fields={"speed_bound": "m/s, which its runs are judged by"},
    ),
    "phase": Box(
        variants=phase.VARIANTS,
        makes=("phase", "planned"),
        optional=("planned",),
        recorded_where_read=("planned",),
        place=Place(4, 0, 1, Kind.TRAJECTORY),
        is_linearized=False,  # nothing drives it: its multiplier is 1 in any loop
    ),
    "internal_force": Box(
        variants=internal_force.VARIANTS,
        makes=("internal_force", "internal_force_higher_rates"),
        optional=("internal_force_higher_rates",),
        recorded_where_read=("internal_force_higher_rates",),
        place=Place(3, 1, -1, Kind.TRAJECTORY),
    ),
    "force_distribution": Box(
        variants=force_distribution.VARIANTS,
        makes=("desired_cable_forces", "desired_cable_force_rates"),
        place=Place(3, 2, 1, Kind.INNER_LOOP),
    ),
    "carrier_trajectory": Box(
        variants=(*carrier_trajectory.VARIANTS, ObservedCarrierTrajectory),
        makes=("carrier_reference", *_BESIDE_THE_REFERENCE, *_OBSERVED),
        optional=(*_BESIDE_THE_REFERENCE, *_OBSERVED),
        recorded_where_read=_BESIDE_THE_REFERENCE,
        place=Place(4, 2, 1, Kind.INNER_LOOP),
    ),
    "carrier_controller": Box(
        variants=carrier_controller.VARIANTS,
        makes=("carrier_forces", "aircraft_command", "command_saturation"),
        optional=("carrier_forces", "aircraft_command", "command_saturation"),
        place=Place(4, 3, -1, Kind.PLANT),
    ),
    "carrier_dynamics": Box(
        variants=carrier_dynamics.VARIANTS,
        makes=("carrier_state", "aircraft_state", "carrier_acceleration"),
        optional=("aircraft_state", "carrier_acceleration"),
        place=Place(3, 3, -1, Kind.PLANT),
        is_simulated=True,
    ),
    "cables": Box(
        variants=cables.VARIANTS,
        makes=("cable_state", "cable_forces", "carrier_cable_forces", "tensions"),
        optional=("cable_state", "carrier_cable_forces"),
        recorded_where_read=("carrier_cable_forces",),
        place=Place(2, 3, -1, Kind.PLANT),
        is_simulated=True,
    ),
    "load_disturbance": Box(
        variants=load_disturbance.VARIANTS,
        makes=("disturbance_wrench",),
        place=Place(0, 4, 1, Kind.ADDITION),
    ),
    "wind": Box(
        variants=wind.VARIANTS,
        makes=("wind", "load_wind", "mean_wind"),
        place=Place(1, 4, 1, Kind.ADDITION),
    ),
    "wind_estimator": Box(
        variants=wind_estimator.VARIANTS,
        makes=("wind_estimate", "carrier_gust_estimate"),
        optional=("carrier_gust_estimate",),
        recorded_where_read=("carrier_gust_estimate",),
        place=Place(2, 4, 1, Kind.ADDITION),
    ),
    "load_plant": Box(
        variants=load_plant.VARIANTS,
        makes=("load_state",),
        place=Place(0, 3, -1, Kind.PLANT),
        is_simulated=True,
    ),
}


@dataclass(kw_only=True)
class BoxFields:
    """The boxes as type checkers see them: of any type, since a config may be the user's own."""

    load_trajectory: Any = None
    load_feedback: Any = None
    wrench_controller: Any = None
    optimization_layer: Any = None
    phase: Any = None
    internal_force: Any = None
    force_distribution: Any = None
    carrier_trajectory: Any = None
    carrier_controller: Any = None
    carrier_dynamics: Any = None
    cables: Any = None
    load_disturbance: Any = None
    wind: Any = None
    wind_estimator: Any = None
    load_plant: Any = None


# The layouts of all signals of the figure, by their names; None: one is no vector.
SIGNALS = {name: layout for box in BOXES.values() for name, layout in box.signals.items()}
PLACES: dict[str, Place] = {name: box.place for name, box in BOXES.items()} | {
    SAMPLE_AND_HOLD: Place(1, 2, 1, Kind.ADDITION),
}

# The paper's symbols of signals, for the drawing; _ lowers what follows.
SYMBOLS = {
    "reference": "p_Ld, R_Ld",
    "load_state": "p_L, R_L",
    "measured_load_state": "p_L, R_L",
    "wrench": "w_d",
    "wrench_rate": "ẇ_d",
    "tracking_error": "e",
    "parameters": "ξ, A",
    "plan": "ξ(t), A(t)",
    "planned": "ξ, A",
    "internal_force": "λ",
    "desired_cable_forces": "f_d",
    "desired_cable_force_rates": "ḟ_d",
    "carrier_reference": "p_Rd",
    "carrier_state": "p_R",
    "cable_forces": "f",
    "tensions": "T",
}

# The figure's wires, to be read. They follow from the names of the ports; a test checks this list
# against what is built. Where the scenario has a control period, a `sample_and_hold` stands in
# front of the controllers: of `measured_load_state`, `measured_attitude`, `reference` and
# `reference_higher_rates`.
WIRES = """
load_trajectory.reference -> wrench_controller.reference
load_trajectory.reference_higher_rates -> wrench_controller.reference_higher_rates
load_trajectory.reference -> optimization_layer.reference
load_trajectory.reference_preview -> optimization_layer.reference_preview
load_trajectory.reference -> carrier_trajectory.reference
load_trajectory.reference_higher_rates -> carrier_trajectory.reference_higher_rates

load_plant.load_state -> load_feedback.load_state
load_feedback.measured_load_state -> wrench_controller.measured_load_state
load_feedback.measured_load_state -> force_distribution.measured_load_state
load_feedback.measured_load_state -> carrier_trajectory.measured_load_state
load_feedback.measured_attitude -> carrier_trajectory.measured_attitude

wrench_controller.wrench -> force_distribution.wrench
wrench_controller.wrench_rate -> force_distribution.wrench_rate

optimization_layer.parameters -> phase.parameters
optimization_layer.plan -> phase.plan
phase.planned -> internal_force.planned
internal_force.internal_force -> force_distribution.internal_force

internal_force.internal_force_higher_rates -> carrier_trajectory.internal_force_higher_rates
force_distribution.desired_cable_forces -> carrier_trajectory.desired_cable_forces
force_distribution.desired_cable_force_rates -> carrier_trajectory.desired_cable_force_rates
carrier_trajectory.carrier_reference -> carrier_controller.carrier_reference
carrier_trajectory.carrier_reference_acceleration -> carrier_controller.carrier_reference_acceleration
carrier_controller.carrier_forces -> carrier_dynamics.carrier_forces
carrier_dynamics.carrier_state -> carrier_controller.carrier_state

carrier_dynamics.carrier_state -> cables.carrier_state
load_plant.load_state -> cables.load_state
cables.cable_forces -> load_plant.cable_forces
load_disturbance.disturbance_wrench -> load_plant.disturbance_wrench

wind.load_wind -> load_plant.load_wind
wind.mean_wind -> wind_estimator.mean_wind
wind_estimator.wind_estimate -> wrench_controller.wind_estimate
wind_estimator.wind_estimate -> carrier_trajectory.wind_estimate
"""  # noqa: E501


def box_of(signal: str) -> str:
    """The name of the box that makes a signal of the figure."""
    return next(name for name, box in BOXES.items() if signal in box.signals)


def figure_wires() -> set[str]:
    """`WIRES` as a set of "block.port -> block.port"."""
    return {line for line in WIRES.splitlines() if line}


def make_nonstop(
    scenario: LoopConfig,
    *,
    at_equilibrium: bool = True,
    extra: Mapping[str, Maker | Any] | None = None,
    inputs: Collection[str] = (),
    **replacements: Maker | Any,
) -> Diagram:
    """The closed loop of a scenario as a diagram, one subsystem per box of the figure.

    Every signal is exported under its name: `diagram.GetOutputPort("load_state")`.

    New contexts of the diagram start at its equilibrium, see `set_equilibrium`, or beside it by the
    scenario's `start_error`; a ScenarioWarning
    names a block whose default state cannot be set, see `loop/start.py`. Where the diagram
    has inputs that have to be connected there may be no equilibrium before they are: load and
    carriers then are at the origin.

    Args:
        scenario: the system, the pattern and one config per box; where fields hold distributions,
            numbers are drawn with its `random_seed`.
        at_equilibrium: whether new contexts start at the equilibrium. If not, as for a load that
            starts from the ground, load and carriers are at the origin.
        extra: blocks beyond the figure's, by name, each given as a replacement is. They read and
            make signals by the names of their ports.
        inputs: signals that no block makes, which become input ports of the diagram.
        replacements: by the name of a box, what to put in its place: a block's config; a block
            class with the dataclass of its parameters beside it, to which parameters go as in a
            swap by `--set` (see `replaced`); a function that takes the `Model` and returns a
            LeafSystem or Diagram with ports named after the signals it reads and makes, anew at
            each call; or None to leave the box out: another block makes its signals (one block for
            two boxes), or those that the box has to make become input ports of the diagram, for a
            bigger one to connect.

    Raises:
        ScenarioError: the scenario or a replacement cannot be built, or the ports of a
            replacement do not fit, or there is no equilibrium; the message names the field, the
            value and the remedy.
    """
    require_flags(at_equilibrium=at_equilibrium)
    parts = make_parts(BOXES, scenario, replacements, extra)
    diagram = connected(BOXES, parts, inputs)
    is_whole = set(wiring.input_names(diagram)) <= wiring.optional_inputs(diagram)
    if not (at_equilibrium and is_whole):
        return diagram
    start_error = getattr(scenario.sampled(), "start_error", None)
    defaults = starts_beside_defaults(diagram, start_error)
    beside = {block.get_name(): state for block, state in defaults.items()}
    if beside:  # a sampled state has no other default than the one that its block is made with
        parts = make_parts(BOXES, scenario, replacements, extra)
        for name, state in beside.items():
            if isinstance(block := parts.blocks.get(name), Block):
                parts.blocks[name] = block.starting_at(state)
        diagram = connected(BOXES, parts, inputs)
        set_default_equilibrium(diagram, start_error=start_error)
    return diagram


def make_blocks(
    scenario: LoopConfig,
    *,
    extra: Mapping[str, Maker | Any] | None = None,
    **replacements: Maker | Any,
) -> dict[str, System]:
    """The blocks of a scenario's loop by the names of their boxes, for `connect_by_name`.

    With a control period the `sample_and_hold` of the controllers' inputs is among them.
    `set_equilibrium` sets a context of their diagram.

    Args:
        scenario: as of `make_nonstop`, as are the other arguments.
        extra: blocks beyond the figure's.
        replacements: what to put in the places of boxes.

    Raises:
        ScenarioError: as `make_nonstop`, but for what concerns the blocks' inputs.
    """
    parts = make_parts(BOXES, scenario, replacements, extra)
    return parts.blocks


def replaced(scenario: Loop, replacements: Mapping[str, Any]) -> tuple[Loop, dict[str, Any]]:
    """Calls `assembly.replaced` for the figure's boxes."""
    return assembly.replaced(BOXES, scenario, replacements)
