"""Studies that are asked for often: ablations, sweeps, robustness, ranges of stability."""

import dataclasses
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from drake_nonstop import diagrams
from drake_nonstop.analysis.stability import at_rest, linearize
from drake_nonstop.blocks.load_feedback import (
    FilteredFeedbackConfig,
    MeasurementConfig,
    NoisyFeedbackConfig,
)
from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.model.aircraft import values_of
from drake_nonstop.model.system import overridden
from drake_nonstop.run.metrics import LOWER, Metric, Quantity
from drake_nonstop.run.preparation import LoopMaker
from drake_nonstop.scenario.overrides import changed, read_mapping, require_override
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.studies.attempts import COMPLETED, UNBUILDABLE
from drake_nonstop.studies.changes import Change, checked_changes
from drake_nonstop.studies.journal import Row
from drake_nonstop.studies.study import (
    Call,
    Setting,
    Study,
    failed_row,
    run_study,
    settings_of_factors,
)
from drake_nonstop.studies.workers import Progress, no_progress
from drake_nonstop.systems.tracing import NotFiniteError
from drake_nonstop.validation import ScenarioError, listed, require, require_flags

BASE = "as it is"  # the name of the scenario without any change
GRIDS = diagrams.FOLDER / "grids"
Variants = Mapping[str, Any] | Iterable[tuple[str, Any]]

# Of a filter: its fields beyond those of what it filters.
_BELIEFS = [
    part.name
    for part in dataclasses.fields(FilteredFeedbackConfig)
    if not hasattr(NoisyFeedbackConfig, part.name)
]
_GROWTH = (
    Metric(
        lambda run: None, Quantity("growth of the least stable mode", "1/s", 1.0, LOWER)
    )._replace(path="rate_1_s"),
    Metric(lambda run: None, Quantity("largest multiplier"))._replace(path="largest_multiplier"),
)


@dataclass(frozen=True, kw_only=True)
class Grid:
    """What the file of a study states: variants by their names, or values by their paths."""

    name: str
    description: str = ""
    overrides: list[str] = field(default_factory=list)  # "path=value", of all runs
    variants: dict[str, list[str]] = field(default_factory=dict)
    grid: dict[str, list[Any]] = field(default_factory=dict)
    seeds: int | list[int] | None = None

    @property
    def settings(self) -> list[Setting]:
        """The variants, or every combination of the values."""
        if self.variants:
            return settings_of_factors({"variant": self.variants})
        return settings_of_factors(self.grid)

    def named(self) -> dict[str, list[Change]]:
        """The changes of each setting by its name."""
        return {setting.name: setting.changes for setting in self.settings}


def grid_names() -> list[str]:
    """The names of the grids that come with the package, sorted."""
    return sorted(path.stem for path in GRIDS.glob("*.yaml"))


def read_grid(name_or_file: str | Path, option: str = "--grid") -> Grid:
    """The grid of that name, or the one in a YAML file.

    A file has `variants`, a mapping from a variant's name to a list of overrides "path=value", or
    `grid`, a mapping from a path to a list of values, of which all combinations are flown; and
    may have a `description`, `overrides` of all runs, and `seeds`. The values of a grid's path that
    ends in "seed" are seeds.

    Raises:
        ScenarioError: there is no such grid or file, or its content cannot be used.
    """
    is_path = isinstance(name_or_file, (str, Path))
    require(is_path, option, name_or_file, "give a grid's name, or a .yaml file")
    path = Path(name_or_file)
    if path.suffix not in (".yaml", ".yml"):
        remedy = f"give a .yaml file or one of {', '.join(grid_names())}"
        require(str(name_or_file) in grid_names(), option, name_or_file, remedy)
        path = GRIDS / f"{name_or_file}.yaml"
    known = ("description", "overrides", "variants", "grid", "seeds")
    content = read_mapping(path, option, known, f"give variants or grid, and {known[0]} or seeds")
    source = path.name
    given = [key for key in ("variants", "grid") if key in content]
    is_one = len(given) == 1 or (not given and "seeds" in content)
    require(is_one, source, " and ".join(given) or "neither", "give variants or grid, or seeds")
    for name in given:
        entries, where = content[name], f"{source}.{name}"
        is_mapping = isinstance(entries, dict) and entries and "_tag" not in entries
        require(is_mapping, where, entries, "give a mapping from names to lists")
        for key, value in entries.items():
            require(isinstance(value, list) and value, f"{where}.{key}", value, "give a list")
            for each in value if name == "variants" else ():
                require_override(each, f"{where}.{key}")
    overrides = content.get("overrides", [])
    require(isinstance(overrides, list), f"{source}.overrides", overrides, "give a list")
    grid = dict(content.get("grid", {}))
    seeds = content.get("seeds")
    for axis in [axis for axis in grid if re.search(r"(^|[._])seed$", axis)]:
        seeds = grid.pop(axis)
    return Grid(
        name=path.stem,
        description=content.get("description", ""),
        overrides=overrides,
        variants=content.get("variants", {}),
        grid=grid,
        seeds=seeds,
    )


def name_overrides(overrides: Sequence[str]) -> str:
    """A variant's name: its blocks, and its other values with their fields."""
    paths = [override.partition("=")[0] for override in overrides]
    last = Counter(path.split(".")[-1] for path in paths)
    labels = []
    for path, override in zip(paths, overrides, strict=True):
        value = " ".join(override.partition("=")[2].split())
        block = value.removeprefix("!").removesuffix("{}").strip()
        if "." not in path and re.match(r"[A-Za-z_]", block):
            labels.append(block)
        else:
            name = path.split(".")[-1]
            labels.append(f"{name if last[name] == 1 else path}={value}")
    return ", ".join(labels)


def ablate(
    scenario: Scenario,
    variants: Variants,
    folder: str | Path,
    *,
    seeds: int | Sequence[int] | None = None,
    title: str = "",
    replay: bool = True,
    trust: bool = False,
    restart: bool = False,
    make_loop: LoopMaker = make_nonstop,
    progress: Progress = no_progress,
) -> Study:
    """Compares a scenario, as it is, with its variants; see `study` for the rest.

    `variants` are by their names: a list of overrides "path=value" and of mappings from boxes to
    configs, classes or functions, as the replacements of `make_nonstop`; or one such mapping. Equal
    names get numbers. The first run of each leaves its results in a folder of its own.

    Raises:
        ScenarioError: as of `study`; or the scenario itself cannot be built.
        StudyInterrupted: Ctrl-C; the rows that there are stay.
    """
    require_flags(replay=replay)
    remedy = 'give a mapping from names to lists of overrides, {"name": ["path=value"]}'
    pairs: Any = variants.items() if isinstance(variants, Mapping) else variants
    settings = [Setting(factors={"variant": BASE})]
    names = Counter([BASE])
    for pair in listed("variants", pairs, remedy):
        is_pair = isinstance(pair, (tuple, list)) and len(pair) == 2
        require(is_pair and isinstance(pair[0], str), "variants", pair, remedy)
        name, changes = pair
        names[name] += 1
        shown = name if names[name] == 1 else f"{name} ({names[name]})"
        checked = checked_changes(changes, f"variant {name}")
        settings.append(Setting(factors={"variant": shown}, changes=checked))
    return run_study(
        scenario,
        settings,
        seeds,
        folder,
        title=title,
        keep="replay" if replay else "results",
        restart=restart,
        trust=trust,
        make_loop=make_loop,
        needs_first=True,
        progress=progress,
    )


def sweep(
    scenario: Scenario,
    grid: Grid | str | Path,
    folder: str | Path | None = None,
    *,
    executor: Executor | None = None,
    trust: bool = False,
    restart: bool = False,
    progress: Progress = no_progress,
) -> Study:
    """Flies all that a file of a study asks for; see `read_grid`, and `study` for the rest."""
    grid = grid if isinstance(grid, Grid) else read_grid(grid, "SPEC")
    return run_study(
        changed(scenario, grid.overrides, trust=trust),
        grid.settings,
        grid.seeds,
        folder,
        title=grid.description or grid.name,
        executor=executor,
        restart=restart,
        trust=trust,
        progress=progress,
    )


def robustness(
    scenario: Scenario,
    folder: str | Path | None = None,
    *,
    seeds: int | Sequence[int] | None = None,
    restart: bool = False,
    progress: Progress = no_progress,
) -> Study:
    """Flies a scenario without error, and with each of some that its controllers do not know of.

    The simulated mass, inertia, attachment points and cable length differ from the controllers'
    model; the load's state is measured with noise or delay; a constant or a gusty force pushes
    the load. See `study` for the rest.
    """
    scenario = scenario.sampled()
    settings = [
        Setting(factors={"error": error, "level": level}, changes=changes)
        for error, level, changes in _errors(scenario)
    ]
    return run_study(
        scenario,
        settings,
        seeds,
        folder,
        title=f"{scenario.name}: errors that controllers do not know of",
        restart=restart,
        needs_first=True,
        progress=progress,
    )


def _errors(scenario: Scenario) -> Iterator[tuple[str, str, list[Change]]]:
    """Name, level and changes of each error."""
    system = overridden(scenario.system, scenario.simulated)
    yield "none", "", []
    for percent in (-20, -10, 10, 20):
        mass = system.load_mass * (1 + percent / 100)
        yield "load mass", f"{percent:+} %", [f"simulated.load_mass={mass}"]
    for percent in (-50, -20, 20, 50):
        inertia = (np.array(system.load_inertia) * (1 + percent / 100)).tolist()
        yield "load inertia", f"{percent:+} %", [f"simulated.load_inertia={inertia}"]
    attachments = np.array(system.attachments)
    radius = np.linalg.norm(attachments, axis=1).max()
    directions = np.random.default_rng(0).standard_normal(attachments.shape)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for share in (0.5, 1.0, 2.0, 5.0):
        points = (attachments + share / 100 * radius * directions).tolist()
        yield "attachment points", f"{share} % of radius", [f"simulated.attachments={points}"]
    for share in (-1.0, -0.3, 0.3, 1.0):
        length = (np.array(system.cable_length) * (1 + share / 100)).tolist()
        yield "cable length", f"{share:+} %", [f"simulated.cable_length={length}"]
    period = scenario.control_period or 0.01
    measurement = f"load_feedback=!NoisyFeedback {{period: {period}, "
    if isinstance(scenario.load_feedback, FilteredFeedbackConfig):  # the filter stays
        fields = "".join(f"{name}: {getattr(scenario.load_feedback, name)}, " for name in _BELIEFS)
        measurement = f"load_feedback=!FilteredFeedback {{{fields}period: {period}, "
    for size in (0.0005, 0.001, 0.002, 0.005):
        noise = (
            f"position_noise: {size}, orientation_noise: {size}, velocity_noise: {5 * size}, "
            f"angular_velocity_noise: {5 * size}}}"
        )
        yield "noise", f"{1e3 * size} mm, mrad (rates: x 5/s)", [measurement + noise]
    for periods in (1, 2, 3, 5):
        delay = periods * period
        yield "delay", f"{1e3 * delay:g} ms", [f"{measurement}delay: {delay}}}"]
    push = "load_disturbance=!DisturbanceForce"
    weight = system.load_mass * system.gravity
    for share in (1, 2, 5, 10):
        force = f"{push} {{force: [0, {share / 100 * weight}, 0], start_time: 1.0}}"
        yield "constant force", f"{share} % of weight", [force]
    for share in (0.5, 1.0, 2.0, 5.0):
        force = f"{push} {{gust_force: {share / 100 * weight}}}"
        yield "gusty force", f"{share} % of weight (standard deviation)", [force]


def stability_ranges(
    scenario: Scenario,
    folder: str | Path | None = None,
    *,
    restart: bool = False,
    progress: Progress = no_progress,
) -> Study:
    """Linearizes the loop around a resting load over carriers' mass and gains, delay, period.

    See `study` for the rest.
    """
    scenario = scenario.sampled()
    settings = [Setting(factors={"parameter": BASE, "value": ""})]
    for name, unit, override, values in _ranges(scenario):
        for value in values:
            factors = {"parameter": name, "value": f"{value:.4g} {unit}"}
            settings.append(Setting(factors=factors, changes=[override.format(value)]))
    return run_study(
        scenario,
        settings,
        None,
        folder,
        title=f"{scenario.name}: growth at rest",
        shown=_GROWTH,
        brief=_GROWTH,
        restart=restart,
        measure=linearize_each,
        needs_first=True,
        progress=progress,
    )


def _ranges(scenario: Scenario) -> Iterator[tuple[str, str, str, Sequence[float]]]:
    """Name, unit, override and values of each parameter."""
    system = overridden(scenario.system, scenario.simulated)
    path, mass = "simulated.carrier_mass={}", system.carrier_mass
    if system.aircraft is not None:
        path, mass = "simulated.aircraft.mass={}", values_of(system.aircraft)["mass"]
    scaled = [("carrier mass", "kg", path, mass)]
    for name, unit, part in (
        ("K_p", "N/m", "position_gain"),
        ("K_d", "N s/m", "velocity_gain"),
        ("carrier frequency", "rad/s", "frequency"),
        ("carrier damping", "of critical", "damping"),
    ):
        value = getattr(scenario.carrier_controller, part, None)
        if isinstance(value, (int, float)):
            scaled.append((name, unit, f"carrier_controller.{part}={{}}", value))
    for name, unit, override, nominal in scaled:
        if nominal > 0:
            yield name, unit, override, (nominal * np.geomspace(1 / 8, 8, 13)).tolist()
    period = scenario.control_period or 0.01
    override = "load_feedback.delay={}"
    if not isinstance(scenario.load_feedback, MeasurementConfig):
        override = f"load_feedback=!NoisyFeedback {{{{delay: {{}}, period: {period}}}}}"
    yield "delay", "s", override, [k * period for k in range(9)]
    periods = [0.0, 0.0025, 0.005, 0.01, 0.015, 0.02, 0.03, 0.04]
    yield "control period", "s", "control_period={}", periods


def linearize_each(calls: list[Call]) -> list[Row]:
    """The multipliers of loops in place of flights."""
    rows = []
    for call in calls:
        try:
            found = linearize(at_rest(call.scenario()[0]))
        except (ScenarioError, NotFiniteError) as error:
            rows.append(failed_row(UNBUILDABLE, str(error)))
            continue
        values = {"rate_1_s": found.rate, "largest_multiplier": found.largest}
        rows.append(failed_row(COMPLETED, "") | {"metrics": values})
    return rows
