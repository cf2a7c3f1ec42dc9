"""Schema of a run: a tree of dataclasses."""

import copy
import copyreg
import dataclasses
import functools
import operator
import re
import typing
from dataclasses import dataclass, field
from typing import Any

from pydrake.common import RandomGenerator
from pydrake.common.schema import Sample, Uniform
from pydrake.systems.analysis import SimulatorConfig

from drake_nonstop.blocks.reference_governor import ReferenceGovernorConfig
from drake_nonstop.diagrams.nonstop import BOXES, BoxFields
from drake_nonstop.model.pattern import HamiltonianCycleConfig
from drake_nonstop.model.system import SystemOverrides, SystemParameters, aircraft_in
from drake_nonstop.planning.problem_config import stated_speed_bound
from drake_nonstop.scenario import distributions
from drake_nonstop.scenario.choices import PATTERNS
from drake_nonstop.scenario.errors import NONE, check_errors, with_fields, with_set
from drake_nonstop.scenario.fields import Walk, write
from drake_nonstop.scenario.obstacles import Obstacle, require_obstacles
from drake_nonstop.scenario.run_limits import RunLimits
from drake_nonstop.scenario.scene_config import SceneConfig
from drake_nonstop.validation import (
    StrictFields,
    checked,
    fulfilling,
    one_of,
    positive,
    require,
    require_array,
    require_non_negative,
    require_positive,
    require_ranges,
    require_whole,
)

# What steps a loop from instant to instant: Drake's Simulator, or one traced function.
AUTO, DIAGRAM, COMPILED = ENGINES = "auto", "diagram", "compiled"
_MAX_STEPS = 1e8  # of a run, which takes days
_LONGEST_PERIOD = 10.0  # s, of the controllers
_LARGEST_SEED = 2**32 - 1  # of Drake's RandomGenerator; larger ones repeat its numbers

copyreg.pickle(SimulatorConfig, distributions.reduced)


def check_name(name: str) -> None:
    """Raises ScenarioError for what is no name of a scenario."""
    is_name = re.fullmatch(r"[A-Za-z0-9][\w.-]*", name) and len(name.encode()) <= 100
    remedy = "name it with letters, digits, _, - and . only, 100 at most: so is its results' folder"
    require(is_name, "scenario", name, remedy)


@dataclass(kw_only=True)
class _Common(StrictFields):
    """The fields of a scenario that belong to no box."""

    name: str = checked("unnamed", lambda _, name: check_name(name))  # of the results' folder, too
    description: str = ""  # one line, which `drake-nonstop list` prints
    # seed of the numbers that are drawn for distributions
    random_seed: int = checked(0, lambda f, seed: require_whole(f, seed, 0, _LARGEST_SEED))
    # The name of a set, light or rough, or a mapping of fields of simulated, load_feedback and wind
    # to values that may be distributions. The controllers do not know of these errors.
    errors: str | dict[str, Any] = checked(NONE, check_errors)
    simulation_duration: float = positive(15.0)  # s
    control_period: float = fulfilling(  # s, sample time of the controllers; 0: continuous
        0.01,
        lambda period: 0 <= period <= _LONGEST_PERIOD,
        f"give 0 for continuous controllers, or 1e-4 to {_LONGEST_PERIOD:g} s",
    )
    engine: str = checked(
        AUTO, one_of(ENGINES, f"give one of {', '.join(ENGINES)}")
    )  # auto: compiled if possible
    # Slows the load's trajectory down where no ξ and A keep the speed bound with it; none: never.
    reference_governor: ReferenceGovernorConfig | None = None
    # Limits beyond which the outcome of the run is not ok.
    limits: RunLimits = field(default_factory=RunLimits)
    # Obstacles for load, cables and carriers: a list of !Sphere, !Box and !Ground.
    obstacles: list[Obstacle] = field(default_factory=list)
    # Of Drake's Simulator: max_step_size in s, and the rest as in SimulatorConfig.
    simulator_config: SimulatorConfig = field(
        default_factory=lambda: SimulatorConfig(
            integration_scheme="runge_kutta3", max_step_size=0.005, use_error_control=False
        )
    )
    # Load, cables and carriers in the controllers' model.
    system: SystemParameters = field(default_factory=SystemParameters)
    # Fields of system that differ in the simulated plant.
    simulated: SystemOverrides = field(default_factory=SystemOverrides)
    # m and rad, in W: [x, y, z, roll, pitch, yaw] of the load's start beside the equilibrium
    start_error: list[float] = checked([0.0] * 6, lambda f, v: require_array(f, v, [6], "m, rad"))
    pattern: functools.reduce(operator.or_, PATTERNS) = field(  # type: ignore[valid-type]
        default_factory=HamiltonianCycleConfig
    )


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

    A scenario can be copied and pickled. Two are equal if all their fields are. Drake's
    `yaml_dump_typed` and `yaml_load_typed` with `schema=Scenario` write and read a scenario whose
    blocks are the package's, whose cables are alike and which has no distributions. Fields are
    checked where they are used, or by `check`. Numbers and lists of numbers may be distributions;
    see `sampled`.
    """

    scene: SceneConfig = field(default_factory=SceneConfig)

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return repr(write(self, Scenario)) == repr(write(other, Scenario))  # a NaN equals another

    def __repr__(self) -> str:
        """One line; `dump_scenario` tells all."""
        carriers, layer = len(self.system.attachments), type(self.optimization_layer).__name__
        return f"<Scenario {self.name}: {carriers} carriers, {self.simulation_duration} s, {layer}>"

    @property
    def speed_bound(self) -> float:
        """The ε (m/s) that the optimization layer's config states; 0 where it states none.

        Raises:
            ScenarioError: the bound is a text that is no multiple of the stall speed, or there are
                no aircraft.
        """
        stated = getattr(self.optimization_layer, "speed_bound", 0.0)
        aircraft = aircraft_in(self.system) if isinstance(stated, str) else None
        return stated_speed_bound("optimization_layer.speed_bound", stated, aircraft)

    def check(self) -> None:
        """Checks all fields' types, and their ranges; see `check`."""
        check(self)

    def sampled(self, generator: RandomGenerator | None = None) -> "Scenario":
        """The scenario with a number drawn for each distribution, and its speed bound in m/s.

        A generator of the seed `random_seed` draws the numbers, in the order of the fields in
        `dump_scenario` and of the entries of lists. Fields of whole numbers take the whole part.

        Args:
            generator: draws the result's `random_seed`; None: it is the scenario's.

        Returns:
            A copy; this scenario itself where it holds no distributions and no generator is given.

        Raises:
            ScenarioError: a field, or a number that is drawn for it, cannot be used.
        """
        return sample(self, generator)[0]


def check(scenario: Scenario) -> None:
    """Checks all fields of a scenario, each by itself, and that a run of it comes to an end.

    Raises:
        ScenarioError: a field cannot be used.
    """
    is_scenario = isinstance(scenario, Scenario)
    require(is_scenario, "scenario", scenario, 'give a Scenario, such as load_scenario("quintic")')
    is_drawn = distributions.is_distribution(scenario.random_seed)
    require(not is_drawn, "random_seed", "a distribution", "give the whole number to draw with")
    scenario = _checked(scenario)
    if isinstance(scenario.errors, dict):
        _checked(with_fields(scenario, _read_into))
    require_obstacles("obstacles", scenario.obstacles)
    for owner in ("system", "simulated"):  # a file that was named after the scenario was loaded
        remedy = f"it is read with a scenario: give {owner}.load_file in its file or an override"
        for name in ("load_file", "attachment_frames"):
            value = getattr(getattr(scenario, owner), name)
            require(not value, f"{owner}.{name}", value, remedy)
    owner, config = "simulator_config", scenario.simulator_config
    for name in ("max_step_size", "accuracy"):
        require_positive(f"{owner}.{name}", getattr(config, name))
    require_non_negative(f"{owner}.target_realtime_rate", config.target_realtime_rate)
    step, duration = config.max_step_size, scenario.simulation_duration
    remedy = "give at least 1e-5 s, or the run would not come to an end"
    require(step >= 1e-5, f"{owner}.max_step_size", step, remedy)
    require(config.start_time == 0, f"{owner}.start_time", config.start_time, "give 0")
    step = min(step, scenario.control_period or _LONGEST_PERIOD)
    remedy = f"give at most {_MAX_STEPS * step:g} s, which are {_MAX_STEPS:.0e} steps of {step:g} s"
    require(duration <= _MAX_STEPS * step, "simulation_duration", duration, remedy)


def _checked(scenario: Scenario) -> Scenario:
    """The scenario, whose fields are usable, with the least number that is drawn for each."""
    are_drawn = False

    def end(side: int, *of: Any) -> Any:
        nonlocal are_drawn
        are_drawn = True
        return distributions.ends(*of)[side]

    least, most = (Walk(change=functools.partial(end, side), reads_trees=False) for side in (0, 1))
    found = least.read("", Scenario, scenario)
    if are_drawn:
        for drawn_ends in (found, most.read("", Scenario, scenario)):
            for name in BOXES:  # whose blocks check what is drawn for them, and not its ends
                require_ranges(name, getattr(drawn_ends, name))
    return found


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
    if isinstance(scenario.errors, dict):
        scenario = with_fields(scenario, _read_into)

    def draw(path: str, distribution: Any, kind: Any) -> Any:
        values[path] = distributions.draw(distribution, kind, random)
        return values[path]

    sampled = Walk(change=draw, reads_trees=False).read("", Scenario, scenario)
    scenario = sampled if values else scenario
    if scenario.errors != NONE:
        even = Uniform(min=-1.0, max=1.0)
        scenario, errors = with_set(scenario, lambda: Sample(even, random))
        values |= errors
    if isinstance(getattr(scenario.optimization_layer, "speed_bound", None), str):
        bound, scenario = scenario.speed_bound, copy.copy(scenario)
        scenario.optimization_layer = copy.copy(scenario.optimization_layer)
        scenario.optimization_layer.speed_bound = bound
    return scenario, values


def _read_into(tree: dict[str, Any], scenario: Scenario) -> None:
    Walk().read("", Scenario, tree, scenario)


def has_distributions(scenario: Scenario) -> bool:
    """Whether a field of a scenario holds a distribution."""
    return bool(sample(scenario)[1])
