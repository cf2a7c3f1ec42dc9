"""The rows of the package's own tables, for contracts that run over all of them.

`BOXES` has the blocks of each box, `CHOICES` their configs and those of patterns.

A new variant of a box is tested by being listed in the box's `VARIANTS`. Where its defaults leave
a state, noise or a port out, a row of `LIVELY` brings them in; where it does not fly alone in the
loop of "quintic", a row of `LOOPS` names the scenario and the blocks that it flies with.
"""

import copy
import functools
from typing import Any, NamedTuple

import numpy as np
from pydrake.systems.framework import Context, Diagram

from drake_nonstop import Model, ScenarioError, load_scenario, make_nonstop
from drake_nonstop.diagrams.nonstop import BOXES as BOXES
from drake_nonstop.mechanics.signals import HELD
from drake_nonstop.run.metrics import METRICS as METRICS
from drake_nonstop.scenario.choices import CHOICES as CHOICES

VARIANTS: dict[str, tuple[str, Any]] = {
    f"{box}-{kind.__name__}": (box, kind) for box in BOXES for kind in BOXES[box].variants
}
CONFIGS = {
    kind: config
    for box in BOXES.values()
    for kind, config in zip(box.variants, box.configs, strict=True)
}
NOISE = {"position_noise": 0.01, "orientation_noise": 0.01, "velocity_noise": 0.01, "delay": 0.04}

# Fields beside the defaults, by the names of blocks.
LIVELY: dict[str, dict[str, Any]] = {
    "RestToRest": {"displacement": [1, 2, 3], "roll_pitch_yaw": [0.1, 0.2, 0.3], "blend": "c4"},
    "PlannedTurn": {"displacement": [1, 2, 3]},
    "CarrierPid": {"integral_gain": 3.0},
    "FeedforwardCarrierPid": {"integral_gain": 3.0},
    "LimitedCarriers": {"has_weight": True, "feels_cable": True},
    "CarrierTrajectory": {"hold": "velocity", "correction_rates": [0.1, 0.3, 0.2, 0.4]},
    "NoisyFeedback": NOISE | {"measures_attitude": False},
    "FilteredFeedback": NOISE | {"period": 0.04},
    "DisturbanceForce": {"force": [1, 2, 3], "gust_force": 1.0},
    "SteadyWind": {"rise_time": 8.0},
    "GustyWind": {"velocity": [3, 1, 1], "load_gust": 0.3},
    "RecedingHorizonOptimizer": {"speed_bound": 0.3, "max_tension": 9.0},
}

# The scenario in which a block flies, and overrides besides the block, by the names of blocks.
AIRCRAFT = "aircraft_rest"
LOOPS: dict[str, tuple[str, list[str]]] = {
    "MeasuredCarrierTrajectory": ("quintic", ["carrier_controller=CarrierPid"]),
    "FixedWingDynamics": (AIRCRAFT, []),
    "FixedWingController": (AIRCRAFT, []),
    "BowedCarrierTrajectory": ("aircraft_rest_cables", []),
    "ObservedCarrierTrajectory": ("aircraft_rest_cables", []),
    "TurnRateOptimizer": (
        "aircraft_co_rotating",
        ["load_trajectory=!PlannedTurn {}", "phase=!ShapedPhase {bandwidth: 4.0}"],
    ),
    "PlannedTurn": ("quintic", ["simulator_config.max_step_size=0.0025"]),
}


def block_name(config: type) -> str:
    """The block's name in a scenario: X of XConfig."""
    return config.__name__.removesuffix("Config")


class Case(NamedTuple):
    """A block of a box with some fields, of continuous or of sampled controllers."""

    box: str
    kind: Any
    fields: dict[str, Any]
    is_sampled: bool

    def __hash__(self) -> int:
        return hash((self.box, self.name))

    @property
    def name(self) -> str:
        """That of the block, of its fields and of the controllers."""
        own = "-lively" if self.fields else ""
        return f"{self.kind.__name__}{own}-{'sampled' if self.is_sampled else 'continuous'}"


def _samplings(kind: Any) -> tuple[bool, ...]:
    """Whether controllers are sampled: both, of a block that differs with it."""
    reads_samples = any(name == "sample_time" or name.startswith(HELD) for name in kind.reads)
    return (False, True) if kind.is_sampled or reads_samples else (True,)


CASES = [
    Case(box, kind, fields, is_sampled)
    for box, kind in VARIANTS.values()
    for fields in ({}, LIVELY.get(kind.__name__))
    if fields is not None
    for is_sampled in _samplings(kind)
]
_MODELS = ("quintic", "aircraft_rest", "aircraft_co_rotating")  # the first that fits


@functools.cache
def loop_of(name: str, is_sampled: bool) -> tuple[Diagram, Context, dict[str, Any]]:
    """The loop of a scenario, its context at the start, and its signals there."""
    layer = ["optimization_layer=ConstantParameters"]  # of which no block here reads more
    scenario = load_scenario(name, layer if is_sampled else [*layer, "control_period=0"])
    diagram = make_nonstop(scenario)
    context = diagram.CreateDefaultContext()
    ports = [diagram.get_output_port(k) for k in range(diagram.num_output_ports())]
    return diagram, context, {port.get_name(): port.Eval(context) for port in ports}


@functools.cache
def made(case: Case) -> tuple[Any, str]:
    """The block of a case, and the scenario whose model it has.

    Every test may have the same one: what a block computes is in its contexts.
    """
    for name in _MODELS:
        try:
            return made_with(case, _model_in(name, case.is_sampled)), name
        except ScenarioError as error:
            reason = error
    raise reason


def made_with(case: Case, model: Model, **fields: Any) -> Any:
    """The block of a case with another model, and with other fields of its config."""
    return case.kind(model, CONFIGS[case.kind](**case.fields | fields))


def _model_in(name: str, is_sampled: bool) -> Model:
    controller: Any = loop_of(name, is_sampled)[0].GetSubsystemByName("wrench_controller")
    model: Model = controller.model
    return model


def model_of(case: Case) -> Model:
    """The model that the block of a case is made of."""
    return _model_in(made(case)[1], case.is_sampled)


def changed_model(model: Model, **fields: Any) -> Model:
    """A model with other fields of its system."""
    if not fields:
        return model
    system = copy.deepcopy(model.system)
    for name, value in fields.items():
        owner, _, field = name.rpartition(".")
        setattr(getattr(system, owner) if owner else system, field, value)
    return Model(system, model.pattern_config, model.control_period)


def near_rest(signal: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A signal of a loop at rest, moved a little."""
    return signal + rng.uniform(0.005, 0.02, len(signal))
