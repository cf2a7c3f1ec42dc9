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

import contextlib
import copy
import math
import sys
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import is_dataclass
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import SimulatorConfig
from pydrake.systems.framework import Diagram, DiagramBuilder, System

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
    wrench_controller,
)
from drake_nonstop.blocks.reference_governor import ReferenceGovernorConfig, governed
from drake_nonstop.blocks.sample_and_hold import SampleAndHold
from drake_nonstop.blocks.turn_rate_optimizer import TurnRateOptimizer
from drake_nonstop.loop.box import (
    Box,
    Kind,
    Place,
    block_class,
    block_of,
    import_path,
    is_of_package,
    kept_parameters,
)
from drake_nonstop.loop.equilibrium import set_equilibrium
from drake_nonstop.loop.margin_of_loop import computed_margin
from drake_nonstop.loop.plant_states import PlantStates
from drake_nonstop.mechanics import signal_layouts
from drake_nonstop.mechanics.reference_preview import ReferencePreview
from drake_nonstop.mechanics.signal_layouts import Layout, Part
from drake_nonstop.mechanics.signals import (
    LOAD_STATE_SIZE,
    LoadReference,
)
from drake_nonstop.model.system import (
    Model,
    PatternConfig,
    SystemParameters,
    WatchedModel,
    given_fields,
    overridden,
)
from drake_nonstop.optimization.diagnostics import DIAGNOSTICS, MISSED_LIMITS
from drake_nonstop.optimization.problem_config import AUTO, LimitsConfig
from drake_nonstop.optimization.speed_margin import SpeedMargin, with_margin
from drake_nonstop.systems import wiring
from drake_nonstop.systems.block import LOOP
from drake_nonstop.systems.diagnosis import raising_block
from drake_nonstop.systems.energy import LoopDiagram
from drake_nonstop.systems.tracing import NotFiniteError
from drake_nonstop.validation import (
    ScenarioError,
    ScenarioWarning,
    called,
    one_line,
    require,
    require_flags,
)

# The boxes of the figure, in its order.
BOXES: dict[str, Box] = {
    "load_trajectory": Box(
        variants=load_trajectory.VARIANTS,
        signals={
            "reference": signal_layouts.LOAD_REFERENCE,
            "reference_higher_rates": signal_layouts.REFERENCE_HIGHER_RATES,
            "reference_preview": None,
            "reference_delay": Layout(Part("", "1", "s")),
        },
        optional=("reference_higher_rates", "reference_preview", "reference_delay"),
        recorded_where_read=("reference_higher_rates",),
        place=Place(0, 1, 1, Kind.TRAJECTORY),
        swap_keeps_defaults=False,  # each task has times of its own
    ),
    "load_feedback": Box(
        variants=load_feedback.VARIANTS,
        signals={"measured_load_state": signal_layouts.LOAD_STATE},
        place=Place(0, 2, 1, Kind.ADDITION),
    ),
    "wrench_controller": Box(
        variants=wrench_controller.VARIANTS,
        signals={
            "wrench": signal_layouts.WRENCH,
            "wrench_rate": signal_layouts.WRENCH_RATE,
            "tracking_error": signal_layouts.TRACKING_ERROR,
        },
        optional=("tracking_error",),
        place=Place(2, 2, 1, Kind.WRENCH),
    ),
    "optimization_layer": Box(
        variants=optimization_layer.VARIANTS,
        signals={
            "parameters": signal_layouts.PARAMETERS,
            "diagnostics": DIAGNOSTICS,
            "plan": signal_layouts.PLANNED_PARAMETERS,
            "solve_time": Layout(Part("", "1", "s")),
            "speed_bound": Layout(Part("", "1", "m/s")),
            "missed_limits": MISSED_LIMITS,
        },
        optional=("diagnostics", "plan", "solve_time", "speed_bound", "missed_limits"),
        place=Place(3, 0, 1, Kind.OPTIMIZATION),
        config_fields={"speed_bound": "m/s, which its runs are judged by"},
    ),
    "phase": Box(
        variants=phase.VARIANTS,
        signals={
            "phase": signal_layouts.PHASE,
            "planned": signal_layouts.PLANNED_PARAMETERS,
        },
        optional=("planned",),
        recorded_where_read=("planned",),
        place=Place(4, 0, 1, Kind.TRAJECTORY),
        is_linearized=False,  # nothing drives it: its multiplier is 1 in any loop
    ),
    "internal_force": Box(
        variants=internal_force.VARIANTS,
        signals={
            "internal_force": signal_layouts.INTERNAL_FORCE,
            "internal_force_higher_rates": signal_layouts.INTERNAL_FORCE_HIGHER_RATES,
        },
        optional=("internal_force_higher_rates",),
        recorded_where_read=("internal_force_higher_rates",),
        place=Place(3, 1, -1, Kind.TRAJECTORY),
    ),
    "force_distribution": Box(
        variants=force_distribution.VARIANTS,
        signals={
            "desired_cable_forces": Layout(Part("", "3n", "N", "W")),
            "desired_cable_force_rates": Layout(Part("", "3n", "N/s", "W")),
        },
        place=Place(3, 2, 1, Kind.INNER_LOOP),
    ),
    "carrier_trajectory": Box(
        variants=carrier_trajectory.VARIANTS,
        signals={
            "carrier_reference": signal_layouts.CARRIER_STATES,
            "carrier_reference_acceleration": Layout(Part("", "3n", "m/s²", "W")),
            "carrier_reference_jerk": Layout(Part("", "3n", "m/s³", "W")),
        },
        optional=("carrier_reference_acceleration", "carrier_reference_jerk"),
        recorded_where_read=("carrier_reference_acceleration", "carrier_reference_jerk"),
        place=Place(4, 2, 1, Kind.INNER_LOOP),
    ),
    "carrier_controller": Box(
        variants=carrier_controller.VARIANTS,
        signals={
            "carrier_forces": Layout(Part("", "3n", "N", "W")),
            "aircraft_command": signal_layouts.AIRCRAFT_COMMAND,
            "command_saturation": signal_layouts.COMMAND_SATURATION,
        },
        optional=("carrier_forces", "aircraft_command", "command_saturation"),
        place=Place(4, 3, -1, Kind.PLANT),
    ),
    "carrier_dynamics": Box(
        variants=carrier_dynamics.VARIANTS,
        signals={
            "carrier_state": signal_layouts.CARRIER_STATES,
            "aircraft_state": signal_layouts.AIRCRAFT_STATE,
            "carrier_acceleration": Layout(Part("", "3n", "m/s²", "W")),
        },
        optional=("aircraft_state", "carrier_acceleration"),
        place=Place(3, 3, -1, Kind.PLANT),
        is_simulated=True,
    ),
    "cables": Box(
        variants=cables.VARIANTS,
        signals={
            "cable_forces": Layout(Part("", "3n", "N", "W")),
            "tensions": Layout(Part("", "n", "N")),
        },
        place=Place(2, 3, -1, Kind.PLANT),
        is_simulated=True,
    ),
    "load_disturbance": Box(
        variants=load_disturbance.VARIANTS,
        signals={"disturbance_wrench": signal_layouts.WRENCH},
        place=Place(0, 4, 1, Kind.ADDITION),
    ),
    "wind": Box(
        variants=wind.VARIANTS,
        signals={
            "wind": Layout(Part("", "3n", "m/s", "W")),
            "load_wind": Layout(Part("", "3", "m/s", "W")),
            "wind_estimate": Layout(Part("", "3", "m/s", "W")),
        },
        place=Place(1, 4, 1, Kind.ADDITION),
    ),
    "load_plant": Box(
        variants=load_plant.VARIANTS,
        signals={"load_state": signal_layouts.LOAD_STATE},
        place=Place(0, 3, -1, Kind.PLANT),
        is_simulated=True,
    ),
}

# The layouts of all signals of the figure, by their names; None: one is no vector.
SIGNALS = {name: layout for box in BOXES.values() for name, layout in box.signals.items()}

SAMPLE_AND_HOLD = "sample_and_hold"  # no scenario chooses it: in front of sampled controllers
LAYER = "optimization_layer"
# What commands carriers; the controller makes one. The blocks that make it and read it.
COMMANDS = {
    "carrier_forces": ("CarrierPid", "CarrierDynamics"),
    "aircraft_command": ("FixedWingController", "FixedWingDynamics"),
}
EXTRA = "extra"  # the argument for blocks beyond the figure's, among replacements
PLACES: dict[str, Place] = {name: box.place for name, box in BOXES.items()} | {
    SAMPLE_AND_HOLD: Place(1, 2, 1, Kind.ADDITION),
}
# The figure's wires, to be read. They follow from the names of the ports, and building
# the default blocks checks this list against what was built. Where the scenario has a
# control period, a `sample_and_hold` stands in front of the controllers, in the wires of
# `measured_load_state`, `reference` and `reference_higher_rates`.
WIRES = """
load_trajectory.reference -> wrench_controller.reference
load_trajectory.reference -> optimization_layer.reference
load_trajectory.reference_preview -> optimization_layer.reference_preview
load_trajectory.reference -> carrier_trajectory.reference
load_trajectory.reference_higher_rates -> carrier_trajectory.reference_higher_rates

load_plant.load_state -> load_feedback.load_state
load_feedback.measured_load_state -> wrench_controller.measured_load_state
load_feedback.measured_load_state -> force_distribution.measured_load_state

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
wind.wind_estimate -> wrench_controller.wind_estimate
wind.wind_estimate -> carrier_trajectory.wind_estimate
"""  # noqa: E501


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
        """What it is with numbers drawn for its distributions.

        Raises:
            ScenarioError: a field cannot be used.
        """
        ...


Maker = Callable[[Model], System]  # of a block, such as its class


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
    `CalcKineticEnergy` and `CalcPotentialEnergy` of the diagram sum those of its blocks, see
    `LoopDiagram`.

    New contexts of the diagram start at its equilibrium, see `set_equilibrium`. Where a block's
    default state cannot be set once it is built (`loop/plant_states.py` says how it can), all
    of them are made a second time, with the equilibrium in the plant's `Model`; a ScenarioWarning
    names a block that starts from another state nevertheless. Where the diagram has inputs that
    have to be connected there may be no equilibrium before they are: load and carriers then are at
    the origin.

    Args:
        scenario: the system, the pattern and one config per box; where fields hold distributions,
            numbers are drawn with its `random_seed`.
        at_equilibrium: whether the equilibrium is looked for. If not, as where a load is to start
            from the ground, load and carriers are at the origin in new contexts.
        extra: blocks beyond the figure's by names of their own, each as a replacement. They read
            and make signals by the names of their ports.
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
    scenario, others = _resolved(scenario, replacements)
    parts = _made_parts(scenario, others, extra)
    diagram = _connected(scenario, parts, inputs, has_extra=bool(extra))
    is_whole = set(wiring.input_names(diagram)) <= wiring.optional_inputs(diagram)
    if not (at_equilibrium and is_whole):
        return diagram
    context = diagram.CreateDefaultContext()
    with _naming_the_block():
        set_equilibrium(diagram, context)
    if not PlantStates(diagram).declare_defaults(context):
        return diagram
    states = PlantStates(diagram).states(context)
    again = _made_parts(scenario, others, extra, states, parts.margin)
    taken = [*parts.blocks.values()]
    if not any(block is other for block in again.blocks.values() for other in taken):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ScenarioWarning)  # told already
            diagram = _connected(scenario, again, inputs, has_extra=bool(extra))
        context = diagram.CreateDefaultContext()
        set_equilibrium(diagram, context)
    for message in PlantStates(diagram).declare_defaults(context):
        warnings.warn(message, ScenarioWarning, stacklevel=2)
    return diagram


def make_blocks(
    scenario: LoopConfig,
    *,
    extra: Mapping[str, Maker | Any] | None = None,
    **replacements: Maker | Any,
) -> dict[str, System]:
    """The blocks of a scenario's loop by the names of their boxes, for `connect_by_name`.

    With a control period the `sample_and_hold` of the controllers' inputs is among them.
    `set_equilibrium` sets a context of their
    diagram.

    Args:
        scenario: as of `make_nonstop`, and so are the others.
        extra: blocks beyond the figure's.
        replacements: what to put in the places of boxes.

    Raises:
        ScenarioError: as `make_nonstop`, but for what concerns the blocks' inputs.
    """
    scenario, others = _resolved(scenario, replacements)
    return _completed(scenario, _made_parts(scenario, others, extra))


def _resolved(
    scenario: LoopConfig, replacements: Mapping[str, Any]
) -> tuple[LoopConfig, dict[str, Any]]:
    """The scenario, checked, with drawn numbers and replaced configs; the other replacements."""
    is_scenario = callable(getattr(scenario, "sampled", None))
    require(is_scenario, "scenario", scenario, 'give one, such as load_scenario("line")')
    scenario, others = replaced(scenario, replacements)
    return scenario.sampled(), others


class _Parts(NamedTuple):
    """What a loop is connected from."""

    model: Model  # that the controllers believe
    blocks: dict[str, System]  # by the names of their boxes
    watched: dict[str, WatchedModel]  # what blocks read of their models
    margin: SpeedMargin | None = None  # that was computed for the optimization layer


def _made_parts(
    scenario: LoopConfig,
    others: Mapping[str, Any],
    extra: Mapping[str, Any] | None,
    initial_states: Mapping[str, NDArray] | None = None,
    margin: SpeedMargin | None = None,
) -> _Parts:
    """The blocks of a scenario that has been checked.

    Args:
        scenario: what they are made from.
        others: the replacements that are no configs.
        extra: blocks beyond the figure's.
        initial_states: of the plant, by the names of the signals that show them.
        margin: of the layer, where it was computed before.
    """
    believed = Model(scenario.system, scenario.pattern, scenario.control_period)
    plant = overridden(scenario.system, scenario.simulated)
    require(
        len(plant.attachments) == believed.n,
        "simulated.attachments",
        plant.attachments,
        f"give as many attachment points as system.attachments has, {believed.n}",
    )
    given = given_fields(scenario.simulated)
    simulated = Model(
        plant,
        scenario.pattern,
        scenario.control_period,
        field="simulated",
        initial_states=initial_states,
        overridden=given,
    )
    sizes = _figure_sizes(believed)
    blocks: dict[str, System] = {}
    watched: dict[str, WatchedModel] = {}  # what blocks read of their models
    for name, box in sorted(BOXES.items(), key=lambda item: item[0] == LAYER):  # it comes last
        entry = others.get(name, getattr(scenario, name))
        if entry is None:
            continue
        if name == LAYER and _wants_margin(entry):
            duration = scenario.simulation_duration
            if margin is None:
                margin = computed_margin(believed, simulated, entry, blocks, duration)
            entry = with_margin(entry, margin)
        make = _constructor(name, entry) if is_dataclass(entry) else entry
        model = watched[name] = WatchedModel(simulated if box.is_simulated else believed)
        blocks[name] = _made(f"replacement {name}", make, model, ", or None to leave the box out")
        _check_layouts(name, blocks[name])
        contract = box.required_and_optional(believed, blocks[name])
        made = wiring.check_outputs(name, blocks[name], *contract)
        _check_others(name, blocks[name], made.keys() - box.signals.keys(), sizes)
    for name, entry in _checked_extra(extra).items():
        model = watched[name] = WatchedModel(believed)
        blocks[name] = _made(f"extra {name}", _maker(name, entry), model, "")
        _check_others(name, blocks[name], set(wiring.output_names(blocks[name])), sizes)
        _check_layouts(name, blocks[name])
    blocks = {name: blocks[name] for name in [*BOXES, *blocks] if name in blocks}
    _require_motion(believed, blocks)
    _check_turn(believed, blocks)
    _check_command(blocks)
    _check_plan(blocks)
    _check_accelerations(blocks)
    _check_preview(blocks)
    if scenario.reference_governor is not None:
        trajectory = blocks.get("load_trajectory")
        remedy = "give a block for load_trajectory, or leave reference_governor out"
        require(trajectory is not None, "load_trajectory", None, remedy)
        blocks["load_trajectory"] = governed(
            believed,
            scenario.reference_governor,
            trajectory,
            with_margin(scenario.optimization_layer, margin),
            scenario.simulation_duration,
            next((b for b in blocks.values() if "wind_estimate" in wiring.output_names(b)), None),
        )
    return _Parts(believed, blocks, watched, margin)


def _wants_margin(entry: Any) -> bool:
    """Whether a layer's entry has a margin computed for it."""
    is_auto = isinstance(entry, LimitsConfig) and entry.tightening == AUTO
    return is_auto and entry.speed_margin == 0 < entry.speed_bound


def _require_motion(model: Model, blocks: Mapping[str, System]) -> None:
    """Raises ScenarioError where neither the pattern nor the load moves the carriers."""
    reference = _start_of_reference(blocks) if model.pattern.is_constant else None
    if reference is not None:
        require(
            np.any(LoadReference.view(reference).angular_velocity),
            "pattern",
            type(model.pattern_config).__name__.removesuffix("Config"),
            "its carriers keep their places above the load, which does not turn at the start, and "
            "would stop; give load_trajectory: !SteadyTurn, or a pattern with orbits",
        )


def _check_turn(model: Model, blocks: Mapping[str, System]) -> None:
    """Raises ScenarioError where a layer's rate is not that at which the load turns."""
    layer, trajectory = (blocks.get(name) for name in (LAYER, "load_trajectory"))
    if type(layer) is not TurnRateOptimizer:
        return
    require(
        model.pattern.is_constant,
        LAYER,
        "TurnRateOptimizer",
        "the pattern has orbits, which it does not size; give pattern: !ConstantSpread and "
        "load_trajectory: !PlannedTurn, or another optimization_layer",
    )
    is_own = isinstance(trajectory, load_trajectory.VARIANTS)
    require(
        not is_own or type(trajectory) is load_trajectory.PlannedTurn,
        "load_trajectory",
        type(trajectory).__name__,
        "the load does not turn at the rate that optimization_layer = TurnRateOptimizer makes; "
        "give !PlannedTurn, and phase: !ShapedPhase, or another optimization_layer",
    )
    shaper = blocks.get("phase")
    require(
        type(shaper) is phase.ShapedPhase or not isinstance(shaper, phase.VARIANTS),
        "phase",
        type(shaper).__name__,
        "its ξ has no rates, which the load's turn follows; give !ShapedPhase",
    )


def _check_command(blocks: Mapping[str, System]) -> None:
    """Raises ScenarioError where the carriers' controller and dynamics do not fit each other."""
    controller, dynamics = (blocks.get(name) for name in ("carrier_controller", "carrier_dynamics"))
    if controller is None or dynamics is None:
        return
    made = {signal for block in blocks.values() for signal in wiring.output_names(block)}
    optional = wiring.optional_inputs(dynamics)
    for signal, (maker, _) in COMMANDS.items():
        if signal in wiring.input_names(dynamics) and signal not in optional | made:
            own = type(controller).__name__
            other = next((s for s in COMMANDS if s in wiring.output_names(controller)), "")
            remedy = f"give carrier_controller={maker}"
            if other:
                remedy += f", or carrier_dynamics={COMMANDS[other][1]}, which reads {other}"
            raise wiring.WiringError(
                f"carrier_dynamics = {type(dynamics).__name__}: it reads {signal}, which "
                f"carrier_controller = {own} does not make; {remedy}"
            )
    optional = wiring.optional_inputs(controller)
    for signal in BOXES["carrier_dynamics"].optional:
        if signal in wiring.input_names(controller) and signal not in optional | made:
            raise wiring.WiringError(
                f"carrier_controller = {type(controller).__name__}: it reads {signal}, which "
                f"carrier_dynamics = {type(dynamics).__name__} does not make; give "
                "carrier_dynamics=FixedWingDynamics, or another carrier_controller"
            )


def _check_plan(blocks: Mapping[str, System]) -> None:
    """Raises ScenarioError where the rates of ξ and A are read, and not made."""
    phase, made = blocks.get("phase"), _signals_made(blocks)
    for name, block in blocks.items():
        read = {*wiring.input_names(block)} - wiring.optional_inputs(block)
        if "planned" in read - made and phase is not None:
            other = f", or {name}=InternalForceTrajectory" if name == "internal_force" else ""
            raise wiring.WiringError(
                f"{name} = {type(block).__name__}: it reads planned, which "
                f"phase = {type(phase).__name__} does not make; give that this output, θ, ξ, A "
                f"and their rates (8){other}"
            )


def _signals_made(blocks: Mapping[str, System]) -> set[str]:
    return {signal for block in blocks.values() for signal in wiring.output_names(block)}


def _check_accelerations(blocks: Mapping[str, System]) -> None:
    """Raises ScenarioError where what is read of the references' accelerations is not made."""
    trajectory = blocks.get("carrier_trajectory")
    made = _signals_made(blocks)
    needs = getattr(trajectory, "hold_order", 0) >= 2
    for name, block in blocks.items():
        read = {*wiring.input_names(block)} - wiring.optional_inputs(block)
        for signal in BOXES["carrier_trajectory"].optional:
            needs |= signal in read
            if signal in read and signal not in made and trajectory is not None:
                other = f"another block for {name}"
                if "carrier_forces" in wiring.output_names(block):
                    other = f"{name}=CarrierPid"
                raise wiring.WiringError(
                    f"{name} = {type(block).__name__}: it reads {signal}, which "
                    f"carrier_trajectory = {type(trajectory).__name__} does not make; give "
                    f"carrier_trajectory=CarrierTrajectory, or {other}"
                )
    internal_force = blocks.get("internal_force")
    for signal in BOXES["internal_force"].optional:
        is_read = trajectory is not None and signal in wiring.input_names(trajectory)
        if needs and is_read and signal not in made and internal_force is not None:
            raise wiring.WiringError(
                f"internal_force = {type(internal_force).__name__}: it does not make {signal}, of "
                "which the references' accelerations follow; give it this output, the second and "
                "third rates (2m) of the internal force, or internal_force=InternalForceTrajectory"
            )


def _check_preview(blocks: Mapping[str, System]) -> None:
    """Raises ScenarioError where a user's own block does not tell the reference that it makes."""
    for name, block in blocks.items():
        if is_of_package(block) or "reference_preview" not in wiring.output_names(block):
            continue
        field = f"{name}.reference_preview"
        if block.num_input_ports() > 0:
            preview = block.GetOutputPort("reference_preview").Allocate().get_value()
        else:
            start = block.CreateDefaultContext()
            preview = block.GetOutputPort("reference_preview").Eval(start)
        remedy = "give a ReferencePreview, such as ReferencePreview(reference_at)"
        require(isinstance(preview, ReferencePreview), field, type(preview).__name__, remedy)
        reference = _start_of_reference({"load_trajectory": block})
        if reference is None:
            continue
        told = np.asarray(preview(0.0), dtype=float)
        is_equal = told.shape == reference.shape and np.allclose(told, reference, atol=1e-9)
        remedy = f"at t = 0 it is not what {name} makes as reference; correct one of the two"
        require(is_equal, field, told.tolist(), remedy)


def _completed(scenario: LoopConfig, parts: _Parts) -> dict[str, System]:
    """The blocks, with the hold in front of sampled ones."""
    believed, blocks, *_ = parts
    _warn_of_unread_wind(blocks)
    _warn_of_unshaped_parameters(blocks)
    _warn_of_unread_plan(blocks)
    _warn_of_unflown_aircraft(scenario, blocks)
    _warn_of_unlimited_aircraft(blocks)
    if scenario.control_period > 0:
        # A constant estimate needs no hold, which would cost time at each sample.
        holds_wind = not getattr(blocks.get("wind"), "is_sampled", False)
        hold = SampleAndHold(believed, _first_samples(blocks), holds_wind=holds_wind)
        blocks = blocks | {SAMPLE_AND_HOLD: hold}
    return blocks


def _warn_of_unread_wind(blocks: Mapping[str, System]) -> None:
    """Tells of a load that no wind acts on, where there is some."""
    makers = {signal: name for name in blocks for signal in wiring.output_names(blocks[name])}
    air, load = makers.get("load_wind"), makers.get("load_state")
    if air in (None, load) or load is None or isinstance(blocks[air], wind.StillAir):
        return
    if "load_wind" not in wiring.input_names(blocks[load]):
        warnings.warn(
            f"{load} = {type(blocks[load]).__name__}: no wind acts on the load, since this block "
            "does not read it; give it an input port load_wind (3), the air's velocity in m/s, in "
            "W, or have still air by wind=StillAir",
            ScenarioWarning,
            stacklevel=5,
        )


def _warn_of_unshaped_parameters(blocks: Mapping[str, System]) -> None:
    """Tells of an internal force of other ξ and A than the phase has."""
    layer, internal = blocks.get("optimization_layer"), blocks.get("internal_force")
    if internal is None or not isinstance(blocks.get("phase"), phase.ShapedPhase):
        return
    changes = not isinstance(layer, optimization_layer.ConstantParameters)
    if changes and "parameters" in wiring.input_names(internal):
        plans = layer is not None and "plan" in wiring.output_names(layer)
        other = "" if plans else ", or give phase=AccumulatedPhase"
        warnings.warn(
            f"internal_force = {type(internal).__name__}: it reads parameters, which phase = "
            "ShapedPhase smooths, so that its rates are others than those that are flown; have it "
            f"read planned, as PlannedInternalForce does{other}",
            ScenarioWarning,
            stacklevel=5,
        )


def _warn_of_unread_plan(blocks: Mapping[str, System]) -> None:
    """Tells of a phase that goes its own way beside a layer's plan of it."""
    layer, own = blocks.get(LAYER), blocks.get("phase")
    if layer is None or own is None or "plan" not in wiring.output_names(layer):
        return
    if "plan" not in wiring.input_names(own):
        warnings.warn(
            f"phase = {type(own).__name__}: it does not read the plan of optimization_layer = "
            f"{type(layer).__name__}, and departs from the phase that is planned with; give "
            "phase=ShapedPhase, or optimization_layer=NonstopOptimizer, which reads the phase",
            ScenarioWarning,
            stacklevel=5,
        )


def _warn_of_unflown_aircraft(scenario: LoopConfig, blocks: Mapping[str, System]) -> None:
    """Tells of aircraft whose carriers move as points."""
    dynamics = blocks.get("carrier_dynamics")
    is_given = overridden(scenario.system, scenario.simulated).aircraft is not None
    if not is_given or not isinstance(dynamics, carrier_dynamics.VARIANTS):
        return
    if "aircraft_command" not in wiring.input_names(dynamics):
        controller, flying = COMMANDS["aircraft_command"]
        warnings.warn(
            f"carrier_dynamics = {type(dynamics).__name__}: its carriers are points of the "
            f"aircraft's mass, which cannot stall; give carrier_dynamics={flying} and "
            f"carrier_controller={controller}",
            ScenarioWarning,
            stacklevel=5,
        )


def _warn_of_unlimited_aircraft(blocks: Mapping[str, System]) -> None:
    """Tells of an optimization layer that keeps a speed bound, and no limit of aircraft."""
    dynamics, layer = blocks.get("carrier_dynamics"), blocks.get("optimization_layer")
    if dynamics is None or type(layer) is not optimization_layer.NonstopOptimizer:
        return
    flies = "aircraft_command" in wiring.input_names(dynamics)
    if flies and math.isinf(layer.parameters.config.max_lift_share):
        warnings.warn(
            "optimization_layer.max_lift_share = inf: the layer may ask of aircraft what they "
            "cannot fly; give at most the lift_share of carrier_controller, such as 0.85, and "
            "max_bank and max_thrust_share, or optimization_layer: !ConstantParameters",
            ScenarioWarning,
            stacklevel=5,
        )


def _connected(
    scenario: LoopConfig, parts: _Parts, inputs: Collection[str], *, has_extra: bool
) -> Diagram:
    """The loop of a scenario's blocks."""
    blocks = _completed(scenario, parts)
    outside = _signals_left_out(parts.model, blocks) | wiring.sizes_of_inputs(blocks, inputs)
    builder = DiagramBuilder()
    wiring.connect_by_name(builder, blocks, inputs=outside)
    diagram = LoopDiagram()
    with _naming_the_block():  # Drake asks the blocks which outputs feed through
        builder.BuildInto(diagram)
    diagram.set_name(LOOP)
    diagram.speed_margin = parts.margin
    diagram.watched_models = {
        name: model for name, model in parts.watched.items() if not is_of_package(blocks.get(name))
    }
    is_default = all(type(blocks.get(name)) is box.variants[0] for name, box in BOXES.items())
    if is_default and not has_extra:
        difference = _without_sampling(wiring.connections(diagram)) ^ figure_wires()
        if difference:
            raise wiring.WiringError(
                f"WIRES = {difference}: these differ between the list and the diagram that was "
                "built; correct the list or the ports"
            )
    return diagram


def _made(field: str, make: Any, model: Model, besides: str) -> System:
    """The block that a function makes of a model."""
    remedy = f"give a block's config, a function that takes the model and returns a system{besides}"
    require(callable(make), field, make, remedy)
    try:
        block = called(field, remedy, make, model)
    except SystemExit:
        remedy = "give a function that returns a system, and does not exit"
        raise ScenarioError(f"{field} = SystemExit: {remedy}") from None
    require(
        isinstance(block, System), field, block, "return a LeafSystem or Diagram from the function"
    )
    return block


@contextlib.contextmanager
def _naming_the_block() -> Iterator[None]:
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


def _check_others(name: str, block: System, made: set[str], sizes: wiring.Sizes) -> None:
    """Checks the sizes of those signals of the figure that a block makes in place of others."""
    known = {signal: size for signal, size in sizes.items() if signal in made}
    if known:
        wiring.check_outputs(name, block, known, {})


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
        require(isinstance(layout, Layout), field_of_port, layout, "give a Layout")
        size = block.GetOutputPort(port).size()
        remedy = f"give a Layout of {size} entries, as the port has, or the port another size"
        require(layout.entries(port, size), field_of_port, f"{layout.size} entries", remedy)


def _figure_sizes(model: Model) -> dict[str, int | None]:
    """The sizes of all the figure's signals."""
    return {
        signal: size
        for box in BOXES.values()
        for signal, size in box.sizes(model.n, model.m).items()
    }


def _signals_left_out(model: Model, blocks: Mapping[str, System]) -> dict[str, int | None]:
    """The signals, with their sizes, of boxes left out that no block makes in their place.

    Of the optional ones those of commands, and those that other blocks need.
    """
    if all(name in blocks for name in BOXES):
        return {}
    made = _signals_made(blocks)
    needed: set[str] = set()
    for block in blocks.values():
        needed |= {*wiring.input_names(block)} - wiring.optional_inputs(block)
    missing = [
        signal
        for name, box in BOXES.items()
        for signal in box.signals
        if signal not in made
        and (
            signal not in box.optional
            or signal in COMMANDS
            or (name not in blocks and signal in needed)
        )
    ]
    sizes = _figure_sizes(model)
    return {signal: sizes[signal] for signal in missing}


def _checked_extra(extra: Mapping[str, Any] | None) -> Mapping[str, Any]:
    """The blocks beyond the figure's."""
    remedy = 'give a mapping from names to blocks, such as {"estimator": Estimator}'
    require(extra is None or isinstance(extra, Mapping), "extra", extra, remedy)
    for name in extra or {}:
        taken = name in BOXES or name == SAMPLE_AND_HOLD
        remedy = f"it is a box of the figure; give it as {name}=..., or its block another name"
        if name == SAMPLE_AND_HOLD:
            remedy = "the loop has a block of that name; give another one"
        require(not taken, "extra", name, remedy)
        remedy = "name each block by a text without colons and dots"
        require(
            isinstance(name, str) and name and not {":", "."} & set(name), "extra", name, remedy
        )
    return extra or {}


def _maker(name: str, entry: Any) -> Any:
    """What makes an extra block of a model."""
    config = _config_class(entry)
    if config is not None:
        entry = config()
    if not is_dataclass(entry) or isinstance(entry, type):
        return entry
    block: Any = block_class(f"extra {name}", type(entry))
    return lambda model: block(model, entry)


def _first_samples(blocks: Mapping[str, System]) -> dict[str, NDArray]:
    """What the sample-and-hold holds before its first sample: the reference, and a load on it."""
    reference = _start_of_reference(blocks)
    if reference is None:
        return {}
    held = {"reference": reference, "measured_load_state": reference[:LOAD_STATE_SIZE]}
    higher_rates = _start_of_reference(blocks, "reference_higher_rates")
    return held if higher_rates is None else held | {"reference_higher_rates": higher_rates}


def _start_of_reference(blocks: Mapping[str, System], signal: str = "reference") -> NDArray | None:
    """The reference at t = 0, or its rates, of a trajectory that needs nothing for it."""
    trajectory = blocks.get("load_trajectory")
    if trajectory is None or trajectory.num_input_ports() > 0:
        return None
    try:
        context = trajectory.CreateDefaultContext()
        return trajectory.GetOutputPort(signal).Eval(context).copy()
    except Exception:  # the start of the run tells it, with the block's name
        return None


_Loop = TypeVar("_Loop", bound=LoopConfig)


def replaced(scenario: _Loop, replacements: Mapping[str, Any]) -> tuple[_Loop, dict[str, Any]]:
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
