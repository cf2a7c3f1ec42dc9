"""Schema of a run: a tree of dataclasses."""

import copy
import copyreg
import dataclasses
import functools
import itertools
import math
import operator
import re
import typing
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pydrake.common import RandomGenerator
from pydrake.systems.analysis import SimulatorConfig
from pydrake.systems.framework import System

from drake_nonstop.blocks.reference_governor import ReferenceGovernorConfig
from drake_nonstop.diagrams.nonstop import BOXES, BoxFields
from drake_nonstop.loop.box import block_of, import_path
from drake_nonstop.model.pattern import (
    CarouselConfig,
    ConstantSpreadConfig,
    EllipticCarouselConfig,
    HamiltonianCycleConfig,
    LinearPatternConfig,
    SpreadCarouselConfig,
)
from drake_nonstop.model.system import OF_CABLES, SystemOverrides, SystemParameters, aircraft_in
from drake_nonstop.planning.problem_config import stated_speed_bound
from drake_nonstop.scenario import distributions
from drake_nonstop.scenario.obstacles import Obstacle, require_obstacles
from drake_nonstop.scenario.run_limits import RunLimits
from drake_nonstop.scenario.scene_config import SceneConfig
from drake_nonstop.validation import (
    StrictFields,
    fields_of,
    is_number,
    of_given,
    require,
    require_fields,
    require_non_negative,
    require_positive,
    require_ranges,
    require_type,
)

PATTERN = "pattern"  # the field that is chosen like a box's block, and belongs to several

# What steps a loop from instant to instant: Drake's Simulator, or one traced function.
AUTO, DIAGRAM, COMPILED = ENGINES = "auto", "diagram", "compiled"

copyreg.pickle(SimulatorConfig, distributions.reduced)


@dataclass(kw_only=True)
class _Common(StrictFields):
    """The fields of a scenario that belong to no box."""

    name: str = "unnamed"
    description: str = ""
    random_seed: int = 0  # of the numbers that are drawn where fields hold distributions
    simulation_duration: float = 15.0  # s
    control_period: float = 0.01  # s, sample time of the controllers; 0: continuous
    engine: str = AUTO  # diagram, compiled, or auto: compiled what can be
    # Slows the load's trajectory down where no ξ and A keep the speed bound with it; none: never.
    reference_governor: ReferenceGovernorConfig | None = None
    # What the run is held against: beyond which figures it is not ok, or not plausible.
    limits: RunLimits = field(default_factory=RunLimits)
    # What load, cables and carriers keep clear of: a list of !Sphere, !Box and !Ground.
    obstacles: list[Obstacle] = field(default_factory=list)
    # Of Drake's Simulator: max_step_size in s, and the rest as in SimulatorConfig.
    simulator_config: SimulatorConfig = field(
        default_factory=lambda: SimulatorConfig(
            integration_scheme="runge_kutta3", max_step_size=0.005, use_error_control=False
        )
    )
    # What the controllers believe of load, cables and carriers.
    system: SystemParameters = field(default_factory=SystemParameters)
    # Fields of system that differ in the simulated plant.
    simulated: SystemOverrides = field(default_factory=SystemOverrides)
    pattern: (
        HamiltonianCycleConfig
        | CarouselConfig
        | SpreadCarouselConfig
        | EllipticCarouselConfig
        | ConstantSpreadConfig
        | LinearPatternConfig
    ) = field(default_factory=HamiltonianCycleConfig)


if typing.TYPE_CHECKING:

    @dataclass(kw_only=True)
    class _Boxes(BoxFields, _Common):
        """The boxes, for type checkers."""

else:  # a field for each box of the figure, of the configs of the blocks that it can be
    _Boxes = dataclasses.make_dataclass(
        "_Boxes",
        [
            (n, functools.reduce(operator.or_, box.configs), field(default_factory=box.configs[0]))
            for n, box in BOXES.items()
        ],
        bases=(_Common,),
        kw_only=True,
    )


@dataclass(kw_only=True)
class Scenario(_Boxes):
    """The system, a config per box of the figure, and how to simulate them.

    It can be copied and pickled, and equals another one whose fields are all equal. Drake's
    `yaml_dump_typed` writes it, where its blocks are the package's, its numbers are drawn and its
    cables alike, and `yaml_load_typed` with `schema=Scenario` reads that back; what it reads is
    checked where it is used, or by `check`. Its numbers and lists of numbers may be distributions;
    see `sampled`.
    """

    scene: SceneConfig = field(default_factory=SceneConfig)

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return bool(comparable(self) == comparable(other))

    def __repr__(self) -> str:
        """One line; `dump_scenario` tells all."""
        carriers, layer = len(self.system.attachments), type(self.optimization_layer).__name__
        return f"<Scenario {self.name}: {carriers} carriers, {self.simulation_duration} s, {layer}>"

    def _rewrite_yaml_dump_attr_name(self, name: str) -> str:
        """Drake's `yaml_dump_typed` asks for the attribute that a field's value is in.

        It would take a config of the user's own for that of the package which it inherits from.

        Raises:
            ScenarioError: the field's value is of a class that `yaml_load_typed` would not make, or
                holds a distribution or a list in the place of a number.
        """
        remedy = "write it with dump_scenario, which can write lists in the place of numbers"
        for key in OF_CABLES if name in ("system", "simulated") else ():
            value = getattr(getattr(self, name), key)
            require(not isinstance(value, list), f"{name}.{key}", value, remedy)
        has_none = not distributions.has_distributions(getattr(self, name))
        remedy = "write it with dump_scenario, which can write distributions"
        require(has_none, name, "a distribution, or a part with one", remedy)
        if name in CHOICES:
            config = getattr(self, name)
            _check_choice(name, config)
            remedy = "write it with dump_scenario, which can name a block of your own"
            require(type(config) in CHOICES[name], name, import_path(type(config)), remedy)
        return name

    @property
    def speed_bound(self) -> float:
        """The ε (m/s) that the optimization layer's config states; 0 where it states none.

        Raises:
            ScenarioError: it is stated as a text that is no multiple of the stall speed, or there
                are no aircraft.
        """
        stated = getattr(self.optimization_layer, "speed_bound", 0.0)
        aircraft = aircraft_in(self.system) if isinstance(stated, str) else None
        return stated_speed_bound("optimization_layer.speed_bound", stated, aircraft)

    def check(self) -> None:
        """Checks all fields' types, and the ranges of those that belong to no box; see `check`."""
        check(self)

    def sampled(self, generator: RandomGenerator | None = None) -> "Scenario":
        """The scenario with a number drawn for each distribution, and its speed bound in m/s.

        The numbers are drawn by a generator of their own, whose seed is `random_seed`, in the
        order of the fields in `dump_scenario`, and in that of a list's entries. A whole number is
        the whole part of what is drawn.

        Args:
            generator: what the result's `random_seed` is taken from, one number of it; None:
                that is the scenario's own.

        Returns:
            A copy; this scenario itself where it holds no distributions and no generator is given.

        Raises:
            ScenarioError: a field cannot be used, or what is drawn for it.
        """
        return sample(self, generator)[0]


PATTERNS: tuple[type, ...] = typing.get_args(typing.get_type_hints(_Common)[PATTERN])

# The configs that each tagged field may hold, the default first.
CHOICES: dict[str, tuple[type, ...]] = {
    PATTERN: PATTERNS,
    **{name: box.configs for name, box in BOXES.items()},
    "scene": (SceneConfig,),
}

_ALL_CONFIGS = {config for choices in CHOICES.values() for config in choices}

# Parts of a scenario that are no boxes.
_PARTS = (
    RunLimits,
    SystemParameters,
    SystemOverrides,
    SimulatorConfig,
    ReferenceGovernorConfig,
)

_MAX_STEPS = 1e8  # of a run, which takes days
_LONGEST_PERIOD = 10.0  # s, of the controllers
_LARGEST_SEED = 2**32 - 1  # of Drake's RandomGenerator; larger ones repeat its numbers


def comparable(value: Any) -> Any:
    """A value's key, equal to another's if they are of one class and their fields are equal.

    A NaN equals another one, and an array a list of its numbers. All else equals what it says.
    """
    kind = type(value)
    if dataclasses.is_dataclass(kind) or hasattr(kind, "__fields__"):
        fields = fields_of(kind)
        return kind, {f.name: comparable(getattr(value, f.name, None)) for f in fields}
    if isinstance(value, (np.generic, np.ndarray)):
        return comparable(value.tolist())
    if isinstance(value, (list, tuple)):
        return [comparable(item) for item in value]
    if isinstance(value, dict):
        return {key: comparable(item) for key, item in value.items()}
    return (float, "nan") if isinstance(value, float) and math.isnan(value) else value


def check(scenario: Scenario) -> None:
    """Checks the types of all fields, and the ranges of those that belong to no box.

    Raises:
        ScenarioError: a field cannot be used.
    """
    is_scenario = isinstance(scenario, Scenario)
    require(is_scenario, "scenario", scenario, 'give a Scenario, such as load_scenario("quintic")')
    require_type("scenario.name", scenario.name, str)
    check_name(scenario.name)
    seed = scenario.random_seed
    is_drawn = distributions.is_distribution(seed)
    require(not is_drawn, "random_seed", "a distribution", "give the whole number to draw with")
    scenario = distributions.mapped(scenario, Scenario, "", distributions.mean)
    for field_ in dataclasses.fields(scenario):
        kind: Any = field_.type
        path, value = field_.name, getattr(scenario, field_.name)
        if path in CHOICES:
            _check_choice(path, value)
            require_fields(path, value)
        elif (part := of_given(kind)) in _PARTS:
            or_none = "" if part is kind else ", or None"
            is_part = isinstance(value, part) or (or_none and value is None)
            require(is_part, path, value, f"give a {part.__name__}{or_none}")
            if value is not None:
                require_fields(path, value)
        else:
            require_type(f"{scenario.name}.{path}", value, kind)
    for owner, name in itertools.product(
        ("system", "simulated"), ("load_file", "attachment_frames")
    ):  # a file that was named after the scenario was loaded
        value = getattr(getattr(scenario, owner), name)
        remedy = (
            f"it is read as a scenario is loaded: give {owner}.load_file and "
            f"{owner}.attachment_frames in its file, or as overrides of load_scenario"
        )
        require(not value, f"{owner}.{name}", value, remedy)
    duration, period = scenario.simulation_duration, scenario.control_period
    require_positive(f"{scenario.name}.simulation_duration", duration)
    is_seed = 0 <= seed <= _LARGEST_SEED
    require(is_seed, f"{scenario.name}.random_seed", seed, f"give 0 to {_LARGEST_SEED}")
    require_ranges("limits", scenario.limits)
    require_obstacles("obstacles", scenario.obstacles)
    remedy = f"give {', '.join(ENGINES[:-1])} or {ENGINES[-1]}"
    require(scenario.engine in ENGINES, "engine", scenario.engine, remedy)
    owner, config = "simulator_config", scenario.simulator_config
    for name in ("max_step_size", "accuracy"):
        require_positive(f"{owner}.{name}", getattr(config, name))
    rate = config.target_realtime_rate
    require_non_negative(f"{owner}.target_realtime_rate", rate)
    remedy = "give at least 1e-5 s, or the run would not come to an end"
    step = config.max_step_size
    require(step >= 1e-5, f"{owner}.max_step_size", step, remedy)
    require(config.start_time == 0, f"{owner}.start_time", config.start_time, "give 0")
    is_period = is_number(period) and 0 <= period <= _LONGEST_PERIOD
    remedy = f"give 0 for continuous controllers, or 1e-4 to {_LONGEST_PERIOD:g} s"
    require(is_period, "control_period", period, remedy)
    step = min(step, period or _LONGEST_PERIOD)
    remedy = f"give at most {_MAX_STEPS * step:g} s, which are {_MAX_STEPS:.0e} steps of {step:g} s"
    is_short = duration <= _MAX_STEPS * step
    require(is_short, f"{scenario.name}.simulation_duration", duration, remedy)


def sample(
    scenario: Scenario, generator: RandomGenerator | None = None
) -> tuple[Scenario, dict[str, Any]]:
    """The scenario `sampled`, and what was drawn by its path: numbers, those of lists one by one.

    Raises:
        ScenarioError: see `Scenario.sampled`.
    """
    check(scenario)
    return drawn(scenario, generator)


def drawn(
    scenario: Scenario, generator: RandomGenerator | None = None
) -> tuple[Scenario, dict[str, Any]]:
    """The same of a scenario that has been checked."""
    if generator is not None:
        remedy = "give a pydrake.common.RandomGenerator, or None"
        is_generator = isinstance(generator, RandomGenerator)
        require(is_generator, "generator", generator, remedy)
        scenario = copy.copy(scenario)
        scenario.random_seed = generator()
    random = RandomGenerator(scenario.random_seed)
    values: dict[str, Any] = {}

    def draw(path: str, distribution: Any, kind: Any) -> Any:
        drawn = distributions.draw(distribution, kind, random)
        if isinstance(drawn, list):
            values.update({f"{path}[{i}]": number for i, number in enumerate(drawn)})
        else:
            values[path] = drawn
        return drawn

    scenario = distributions.mapped(scenario, Scenario, "", draw)
    if values:
        check(scenario)
    if isinstance(getattr(scenario.optimization_layer, "speed_bound", None), str):
        bound, scenario = scenario.speed_bound, copy.copy(scenario)
        scenario.optimization_layer = copy.copy(scenario.optimization_layer)
        scenario.optimization_layer.speed_bound = bound
    return scenario, values


def check_name(name: str) -> None:
    """Raises ScenarioError for what is no name of a scenario."""
    require(
        re.fullmatch(r"[A-Za-z0-9][\w.-]*", name) and len(name.encode()) <= 100,
        "scenario",
        name,
        "name it with letters, digits, _, - and . only, 100 at most: its results' folder is "
        "named after it",
    )


def _check_choice(name: str, config: Any) -> None:
    """Raises ScenarioError for what is no config of a block that the box of the name can be."""
    choices = CHOICES[name]
    names = [choice.__name__.removesuffix("Config") for choice in choices]
    is_config = dataclasses.is_dataclass(config) and not isinstance(config, type)
    require(is_config, name, config, f"give a config, such as {choices[0].__name__}()")
    kind = type(config)
    if kind in choices:
        return
    is_known = kind in _ALL_CONFIGS
    is_own = not is_known and (name in BOXES or hasattr(config, "make"))
    block = kind.__name__.removesuffix("Config")
    require(is_own, name, block, f"give one of {', '.join(names)}")
    if name in BOXES:
        remedy = f"give {kind.__module__} a LeafSystem or Diagram of the name {block}"
        is_block = isinstance(block_of(kind), type) and issubclass(block_of(kind), System)
        require(is_block, name, import_path(kind), remedy)
        for needed, meaning in BOXES[name].config_fields.items():
            remedy = f"give {kind.__name__} a field {needed} ({meaning})"
            require(hasattr(config, needed), name, import_path(kind), remedy)
