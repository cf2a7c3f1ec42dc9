"""Studies that are asked for often: ablations, sweeps, robustness."""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from drake_nonstop import diagrams
from drake_nonstop.blocks.load_feedback import FilteredFeedbackConfig, NoisyFeedbackConfig
from drake_nonstop.model.system import overridden
from drake_nonstop.scenario.overrides import changed, read_mapping, require_override
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.studies.changes import Change
from drake_nonstop.studies.study import Study, study
from drake_nonstop.validation import require

BASE = "as it is"  # the name of the scenario without any change
GRIDS = diagrams.FOLDER / "grids"

# Of a filter: its fields beyond those of what it filters.
_BELIEFS = [
    part.name
    for part in dataclasses.fields(FilteredFeedbackConfig)
    if not hasattr(NoisyFeedbackConfig, part.name)
]


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
    def factors(self) -> dict[str, Any]:
        """The factors of a study: the variants, or the values."""
        return {"variant": self.variants} if self.variants else self.grid


def grid_names() -> list[str]:
    """The names of the grids that come with the package, sorted."""
    return sorted(path.stem for path in GRIDS.glob("*.yaml"))


def read_grid(name_or_file: str | Path, option: str = "--grid") -> Grid:
    """The grid of that name, or the one in a YAML file.

    A file has `variants`, a mapping from a variant's name to a list of overrides "path=value", or
    `grid`, a mapping from a path to a list of values, of which all combinations are flown; and
    may have a `description`, `overrides` of all runs, and `seeds`.

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
    return Grid(
        name=path.stem,
        description=content.get("description", ""),
        overrides=overrides,
        variants=content.get("variants", {}),
        grid=content.get("grid", {}),
        seeds=content.get("seeds"),
    )


def ablate(
    scenario: Scenario,
    variants: Mapping[str, Any],
    folder: str | Path,
    *,
    seeds: int | Sequence[int] | None = None,
    replay: bool = True,
    **options: Any,
) -> Study:
    """Compares a scenario, as it is, with its variants; see `study` for the options.

    `variants` are by their names: a list of overrides "path=value" and of mappings from boxes to
    configs, classes or functions, as the replacements of `make_nonstop`; or one such mapping.
    """
    remedy = 'give a mapping from names to lists of overrides, {"name": ["path=value"]}'
    is_mapping = isinstance(variants, Mapping) and all(isinstance(name, str) for name in variants)
    require(is_mapping, "variants", variants, remedy)
    levels = {BASE: [], **variants}
    return study(scenario, {"variant": levels}, seeds, folder, replay=replay, **options)


def sweep(
    scenario: Scenario,
    grid: Grid | str | Path,
    folder: str | Path | None = None,
    *,
    trust: bool = False,
    **options: Any,
) -> Study:
    """Flies the study of a file; see `read_grid`, and `study` for the options."""
    grid = grid if isinstance(grid, Grid) else read_grid(grid, "SPEC")
    base = changed(scenario, grid.overrides, trust=trust)
    title = grid.description or grid.name
    return study(base, grid.factors, grid.seeds, folder, title=title, trust=trust, **options)


def robustness(scenario: Scenario, folder: str | Path | None = None, **options: Any) -> Study:
    """Flies a scenario without errors, and with single errors unknown to its controllers.

    The simulated mass, inertia, attachment points and cable length differ from the controllers'
    model; the load's state is measured with noise or delay; a constant or a gusty force pushes
    the load. See `study` for the options.
    """
    scenario = scenario.sampled()
    title = f"{scenario.name}: errors that controllers do not know of"
    return study(
        scenario, {"error": dict(_errors(scenario))}, folder=folder, title=title, **options
    )


def _errors(scenario: Scenario) -> Iterator[tuple[str, list[Change]]]:
    """Name and changes of each error."""
    system = overridden(scenario.system, scenario.simulated)
    yield "none", []
    for percent in (-20, -10, 10, 20):
        mass = system.load_mass * (1 + percent / 100)
        yield f"load mass {percent:+} %", [f"simulated.load_mass={mass}"]
    for percent in (-50, -20, 20, 50):
        inertia = (np.array(system.load_inertia) * (1 + percent / 100)).tolist()
        yield f"load inertia {percent:+} %", [f"simulated.load_inertia={inertia}"]
    attachments = np.array(system.attachments)
    radius = np.linalg.norm(attachments, axis=1).max()
    directions = np.random.default_rng(0).standard_normal(attachments.shape)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for share in (0.5, 1.0, 2.0, 5.0):
        points = (attachments + share / 100 * radius * directions).tolist()
        yield f"attachment points {share} % of radius", [f"simulated.attachments={points}"]
    for share in (-1.0, -0.3, 0.3, 1.0):
        length = (np.array(system.cable_length) * (1 + share / 100)).tolist()
        yield f"cable length {share:+} %", [f"simulated.cable_length={length}"]
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
        yield f"noise {1e3 * size} mm, mrad (rates: x 5/s)", [measurement + noise]
    for periods in (1, 2, 3, 5):
        delay = periods * period
        yield f"delay {1e3 * delay:g} ms", [f"{measurement}delay: {delay}}}"]
    push = "load_disturbance=!DisturbanceForce"
    weight = system.load_mass * system.gravity
    for share in (1, 2, 5, 10):
        force = f"{push} {{force: [0, {share / 100 * weight}, 0], start_time: 1.0}}"
        yield f"constant force {share} % of weight", [force]
    for share in (0.5, 1.0, 2.0, 5.0):
        force = f"{push} {{gust_force: {share / 100 * weight}}}"
        yield f"gusty force {share} % of weight (standard deviation)", [force]
