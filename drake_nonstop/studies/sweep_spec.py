"""The specification of a sweep: values of a scenario's fields, combined or drawn at random."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.common import RandomGenerator

from drake_nonstop.scenario.overrides import (
    as_override,
    combinations,
    read_mapping,
    require_choices,
    require_override,
)
from drake_nonstop.scenario.yaml_text import dump_plain
from drake_nonstop.studies.variants import Change, checked_changes, is_block, label
from drake_nonstop.validation import StrictFields, is_number, require, require_seed

_LARGEST = 1e12  # of the numbers of a distribution
_MAX_RUNS = 100_000  # of a sweep
_RANDOM_SEED = "random_seed"  # the scenario's field


@dataclass(frozen=True, kw_only=True)
class PlannedRun:
    """One run of a sweep: the seed of its draws, and how it changes the scenario.

    `seed` is also the value of a path that is drawn as `{seed: true}`; `values` are those of the
    grid and the draws by their paths, and `overrides` all changes of the scenario: "path=value",
    and mappings from a box to the class, config or function that makes its block. With `runs` its
    `random_seed` is among these.
    """

    number: int
    seed: int
    values: dict[str, Any]
    overrides: list[Change]


@dataclass(kw_only=True)
class SweepSpec(StrictFields):
    """The runs of a sweep.

    Every combination of the values in `grid` is run, or `runs` times each, with values drawn at
    random: those of `draws`, and those of the distributions that the scenario's fields hold. Draw
    k depends on `seed` and k only and is the same in every combination, so that combinations can
    be compared. Its `random_seed`, for the scenario's distributions, is the k-th number of
    `RandomGenerator(seed)`: what the k-th call of `make_simulator` takes from that generator.
    Without `runs` the scenario's own `random_seed` holds for all of them.

    A path is one of the resolved scenario, as in `load_scenario`. Its distribution is one
    of `{uniform: [low, high]}`, `{normal: [mean, standard deviation]}`,
    `{log_uniform: [low, high]}`, `{choice: [value, ...]}`, and `{seed: true}`: a whole number of
    each draw's own, for the seed of a block such as DisturbanceForce.

    In Python a box's values, in `grid` and in a `choice`, may be classes, configs and functions as
    well, as the replacements of `make_nonstop`; processes have to be able to import them. The table
    has their names.

    Raises:
        ScenarioError: a field cannot be used.
    """

    description: str = ""
    seed: int = 0
    runs: int | None = None  # of each combination
    overrides: list[str] = field(default_factory=list)  # "path=value", of all runs
    grid: dict[str, list[Any]] = field(default_factory=dict)  # values by path
    draws: dict[str, dict[str, Any]] = field(default_factory=dict)  # distributions by path
    source: str = "spec"  # its name in errors

    def __post_init__(self) -> None:
        source = self.source
        require_seed(f"{source}.seed", self.seed)
        where, remedy = f"{source}.overrides", "give a list of path=value"
        require(isinstance(self.overrides, list), where, self.overrides, remedy)
        for override in self.overrides:
            require_override(override, where)
        for name, what in (("grid", "lists of values"), ("draws", "distributions")):
            entries, where = getattr(self, name), f"{source}.{name}"
            is_mapping = isinstance(entries, dict) and "_tag" not in entries
            require(is_mapping, where, entries, f"give a mapping from paths to {what}")
            for path in entries:
                require(isinstance(path, str), where, path, "give paths as texts")
        is_given = self.grid or self.draws or self.runs is not None
        remedy = "give grid, draws, or runs of a scenario with distributions"
        require(is_given, source, "none of them", remedy)
        for path, values in self.grid.items():
            require_choices(_named(path, values, f"{source}.grid"), f"{source}.grid.{path}")
        for path, distribution in self.draws.items():
            where = f"{source}.draws.{path}"
            require(path not in self.grid, where, "in grid too", "give it in one of the two")
            if isinstance(distribution, dict) and "choice" in distribution:
                choices = _named(path, distribution["choice"], f"{source}.draws")
                distribution = {**distribution, "choice": choices}
            _require_distribution(distribution, where)
        where, runs = f"{source}.runs", self.runs
        if self.draws or runs is not None:
            is_count = isinstance(runs, int) and not isinstance(runs, bool) and runs > 0
            require(is_count, where, runs, "give the number of draws, 1 or more")
            paths = [*self.grid, *self.draws, *(text.split("=")[0] for text in self.overrides)]
            remedy = "leave it out: each of the runs has a seed of its own, which follows from seed"
            require(_RANDOM_SEED not in paths, f"{source}, path", _RANDOM_SEED, remedy)
        count = math.prod(map(len, self.grid.values())) * (runs or 1)
        require(count <= _MAX_RUNS, source, f"{count} runs", f"give at most {_MAX_RUNS}")

    def __len__(self) -> int:
        return math.prod(map(len, self.grid.values())) * (self.runs or 1)

    def run(self, number: int) -> PlannedRun:
        """The run of that number, from 0 on.

        Raises:
            ScenarioError: there is no such run.
        """
        remedy = f"give 0 to {len(self) - 1}"
        is_one = isinstance(number, int) and 0 <= number < len(self)
        require(is_one, f"{self.source}, run", number, remedy)
        combination, draw = divmod(number, self.runs or 1)
        seeds = np.random.SeedSequence([self.seed, draw])
        seed = int(seeds.generate_state(1)[0])
        random = np.random.default_rng(seeds)
        values = dict(self._combinations[combination])
        for path, distribution in self.draws.items():
            ((kind, parameters),) = distribution.items()
            values[path] = seed if kind == "seed" else _DRAW[kind](random, parameters)
        changes: list[Change] = [
            {path: value} if is_block(path, value) else as_override(path, value)
            for path, value in values.items()
        ]
        if self.runs is not None:
            changes.append(as_override(_RANDOM_SEED, self._random_seeds[draw]))
        shown = {path: label(v) if is_block(path, v) else v for path, v in values.items()}
        overrides: list[Change] = [*self.overrides, *changes]
        return PlannedRun(number=number, seed=seed, values=shown, overrides=overrides)

    @property
    def blocks(self) -> list[Change]:
        """Makers of blocks among the values, by their boxes."""
        choices = {path: kinds.get("choice", []) for path, kinds in self.draws.items()}
        return [
            {path: value}
            for path, values in (self.grid | choices).items()
            for value in values
            if is_block(path, value)
        ]

    @cached_property
    def _random_seeds(self) -> list[int]:
        generator = RandomGenerator(self.seed)
        return [generator() for _ in range(self.runs or 0)]

    @cached_property
    def _combinations(self) -> list[dict[str, Any]]:
        return list(combinations(self.grid))


def read_sweep(file: str | Path) -> SweepSpec:
    """The sweep in a YAML file, whose keys are the fields of `SweepSpec` but `source`.

    Raises:
        ScenarioError: the file cannot be read, or its content cannot be used.
    """
    require(isinstance(file, (str, Path)), "SPEC", file, "give a .yaml file")
    path = Path(file)
    known = ("description", "seed", "runs", "overrides", "grid", "draws")
    remedy = f"give grid, draws or runs, and if needed {', '.join(known[:4])}"
    return SweepSpec(**read_mapping(path, "SPEC", known, remedy), source=path.name)


def dump_spec(spec: SweepSpec) -> str:
    """The fields that the results depend on, as one line of YAML that `read_sweep` reads.

    What makes blocks is there by its name.
    """
    names = ("seed", "runs", "overrides", "grid", "draws")
    given = {name: getattr(spec, name) for name in names}
    given["grid"] = {path: _named(path, values) for path, values in spec.grid.items()}
    given["draws"] = {
        path: {kind: _named(path, parameters) for kind, parameters in distribution.items()}
        for path, distribution in spec.draws.items()
    }
    return dump_plain({name: value for name, value in given.items() if value not in (None, [], {})})


def _named(path: str, values: Any, where: str = "") -> Any:
    """The values with labels in place of what makes blocks, which `where` is checked."""
    if not isinstance(values, list):
        return values
    for value in values:
        if where and is_block(path, value):
            checked_changes({path: value}, where)
    return [label(value) if is_block(path, value) else value for value in values]


def _require_distribution(distribution: Any, where: str) -> None:
    """Raises ScenarioError for anything but a distribution."""
    remedy = (
        "give one of {uniform: [low, high]}, {normal: [mean, standard deviation]}, "
        "{log_uniform: [low, high]}, {choice: [values]} and {seed: true}"
    )
    is_one = isinstance(distribution, dict) and len(distribution) == 1
    require(is_one and next(iter(distribution)) in (*_DRAW, "seed"), where, distribution, remedy)
    ((kind, parameters),) = distribution.items()
    where = f"{where}.{kind}"
    if kind == "seed":
        require(parameters is True, where, parameters, "give true")
        return
    if kind == "choice":
        require_choices(parameters, where)
        return
    is_pair = isinstance(parameters, list) and len(parameters) == 2
    require(is_pair and all(map(is_number, parameters)), where, parameters, "give two numbers")
    (first, second), given = parameters, dump_plain(parameters)
    is_within = max(abs(first), abs(second)) <= _LARGEST
    require(is_within, where, given, f"give numbers up to {_LARGEST:g}")
    if kind == "normal":
        require(second >= 0, where, given, "give a deviation from 0 on")
        return
    require(first < second, where, given, "give the lower bound first")
    is_usable = kind == "uniform" or first >= 1 / _LARGEST
    require(is_usable, where, given, f"give bounds above 0, from {1 / _LARGEST:g} up")


def _log_uniform(random: np.random.Generator, low: float, high: float) -> float:
    return min(max(low * math.exp(random.uniform(0, math.log(high / low))), low), high)


_DRAW: dict[str, Callable[[np.random.Generator, list[Any]], Any]] = {
    "uniform": lambda random, bounds: float(random.uniform(*bounds)),
    "normal": lambda random, parameters: float(random.normal(*parameters)),
    "log_uniform": lambda random, bounds: _log_uniform(random, *bounds),
    "choice": lambda random, values: values[random.integers(len(values))],
}
