"""What one run is: a tree of dataclasses."""

import dataclasses
import functools
import operator
import typing
from dataclasses import dataclass, field
from typing import Any

from pydrake.systems.analysis import SimulatorConfig

from drake_nonstop.diagrams.nonstop import BOXES
from drake_nonstop.model.pattern import (
    CarouselConfig,
    HamiltonianCycleConfig,
    LinearPatternConfig,
    SpreadCarouselConfig,
)
from drake_nonstop.model.system import SystemOverrides, SystemParameters
from drake_nonstop.scenario.run_limits import RunLimits, check_limits
from drake_nonstop.scenario.scene_config import SceneConfig
from drake_nonstop.validation import require, require_positive

PATTERN = "pattern"  # the field that is chosen like a box's block, and belongs to several


def _default_simulator() -> SimulatorConfig:
    return SimulatorConfig(
        integration_scheme="runge_kutta3", max_step_size=0.005, use_error_control=False
    )


@dataclass(kw_only=True)
class _Common:
    """The fields of a scenario that belong to no box."""

    name: str = "unnamed"
    description: str = ""
    duration: float = 15.0  # s
    control_period: float = 0.01  # s, sample time of the controllers; 0: continuous
    fused_plant: bool = False  # load, cables, carriers and their controller in one fast block
    limits: RunLimits = field(default_factory=RunLimits)
    simulator: SimulatorConfig = field(default_factory=_default_simulator)
    system: SystemParameters = field(default_factory=SystemParameters)
    simulated: SystemOverrides = field(default_factory=SystemOverrides)
    pattern: (
        HamiltonianCycleConfig | CarouselConfig | SpreadCarouselConfig | LinearPatternConfig
    ) = field(default_factory=HamiltonianCycleConfig)


# A field for each box of the figure, of the configs of the blocks that it can be. Type checkers
# cannot know these fields, so that for them the class and its decorator are of any type.
_dataclass: Any = dataclass(kw_only=True)
_Boxes: Any = dataclasses.make_dataclass(
    "_Boxes",
    [
        (name, functools.reduce(operator.or_, box.configs), field(default_factory=box.configs[0]))
        for name, box in BOXES.items()
    ],
    bases=(_Common,),
    kw_only=True,
)


@_dataclass
class Scenario(_Boxes):
    """The system, a config per box of the figure, and how to simulate them."""

    scene: SceneConfig = field(default_factory=SceneConfig)

    @property
    def speed_bound(self) -> float:
        """The ε (m/s) that the optimization layer's config states; 0 where it states none."""
        return getattr(self.optimization_layer, "speed_bound", 0.0)


PATTERNS: tuple[type, ...] = typing.get_args(typing.get_type_hints(_Common)[PATTERN])

# The configs that each tagged field may hold, the default first.
CHOICES: dict[str, tuple[type, ...]] = {
    PATTERN: PATTERNS,
    **{name: box.configs for name, box in BOXES.items()},
    "scene": (SceneConfig,),
}


def check(scenario: Scenario) -> None:
    """Checks the fields that belong to no box.

    Raises:
        ScenarioError: one is out of range.
    """
    require_positive(scenario.name, duration=scenario.duration)
    check_limits(scenario.limits)
    simulator = scenario.simulator
    require_positive(
        "simulator", max_step_size=simulator.max_step_size, accuracy=simulator.accuracy
    )
    require(
        simulator.max_step_size >= 1e-5,
        "simulator.max_step_size",
        simulator.max_step_size,
        "give at least 1e-5 s, or the run would not come to an end",
    )
    require(simulator.start_time == 0, "simulator.start_time", simulator.start_time, "give 0")
