"""Drake's distributions in the place of a scenario's numbers, and the numbers drawn from them.

In YAML a distribution is a tagged mapping such as `!Uniform {min: 0.7, max: 1.3}`, in Python an
object of `pydrake.common.schema`.
"""

import copyreg
import functools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from pydrake.common import RandomGenerator
from pydrake.common.schema import (
    Deterministic,
    DeterministicVector,
    DeterministicVectorX,
    Distribution,
    DistributionVector,
    Gaussian,
    GaussianVector,
    GaussianVectorX,
    Sample,
    ToDistribution,
    ToDistributionVector,
    Uniform,
    UniformDiscrete,
    UniformVector,
    UniformVectorX,
)

from drake_nonstop.scenario.yaml_text import dump_plain
from drake_nonstop.validation import members_of, require, require_known, require_type

_KINDS: dict[str, Any] = {
    "Deterministic": Deterministic,
    "DeterministicVector": DeterministicVectorX,
    "Gaussian": Gaussian,
    "GaussianVector": GaussianVectorX,
    "Uniform": Uniform,
    "UniformVector": UniformVectorX,
    "UniformDiscrete": UniformDiscrete,
}
_NUMBER = "give a number, or a distribution of one, such as !Uniform {min: 0, max: 1}"
_NUMBERS = (
    "give a list in [ ], whose entries may be distributions, or a distribution of a list, such as "
    "!UniformVector {min: [0, 0], max: [1, 1]}"
)
_NEITHER = "a distribution may stand for a number or a list of numbers only"
_WHOLE = (
    "give whole numbers, !UniformDiscrete {values: [1, 2]}, or !Uniform {min: 0, max: 10}, of "
    "whose numbers the whole part is taken"
)


def reduced(value: Any) -> tuple[Callable[[], Any], tuple[()]]:
    """For `copyreg.pickle`: how to make one of Drake's objects from its fields again."""
    kind: Any = type(value)
    fields = {field.name: getattr(value, field.name) for field in kind.__fields__}
    return functools.partial(kind, **fields), ()


_SIZED = (DeterministicVector, GaussianVector, UniformVector)  # by the sizes 1 to 6

for _class in (*_KINDS.values(), *(vector[size] for vector in _SIZED for size in range(1, 7))):
    copyreg.pickle(_class, reduced)


def is_distribution(value: Any) -> bool:
    """Whether a value is a distribution of `pydrake.common.schema`."""
    return isinstance(value, (Distribution, DistributionVector))


def is_entry(value: Any) -> bool:
    """Whether a value of a scenario's tree stands for a distribution."""
    return isinstance(value, dict) and str(value.get("_tag")).removeprefix("!") in _KINDS


def to_entry(distribution: Any) -> dict[str, Any]:
    """A distribution as it stands in a scenario's tree."""
    name, vector, _ = type(distribution).__name__.partition("Vector")  # without its size
    values = {f.name: getattr(distribution, f.name) for f in distribution.__fields__}
    return {"_tag": f"!{name}{vector}"} | {k: np.asarray(v).tolist() for k, v in values.items()}


def from_entry(path: str, entry: dict[str, Any]) -> Any:
    """The distribution that an entry of a scenario's tree stands for.

    Raises:
        ScenarioError: there is no such one, or a field of it is missing, unknown, or not of its
            type.
    """
    name = entry["_tag"].removeprefix("!")
    remedy = f"give a number, or a distribution: {', '.join(f'!{name}' for name in _KINDS)}"
    require(name in _KINDS, path, dump_plain(entry), remedy)
    fields = [field.name for field in _KINDS[name].__fields__]
    values = {field: value for field, value in entry.items() if field != "_tag"}
    is_list = "Vector" in name or name == "UniformDiscrete"
    for field, value in values.items():
        require_known(field, fields, f"{path}.{field}", value)
        is_right = isinstance(value, list) == is_list
        require(
            is_right, f"{path}.{field}", value, f"give {'a list in [ ]' if is_list else 'a number'}"
        )
        for number in value if is_list else [value]:
            require_type(f"{path}.{field}", number, float)
    require(set(values) == set(fields), path, dump_plain(entry), f"give {' and '.join(fields)}")
    return _KINDS[name](**values)


def mean(path: str, distribution: Any, kind: Any) -> Any:
    """The mean of a distribution for a field of that type.

    Raises:
        ScenarioError: nothing can be drawn from it for such a field.
    """
    _require_usable(path, distribution, kind)
    if isinstance(distribution, DistributionVector):
        return ToDistributionVector(distribution).Mean().tolist()
    value = ToDistribution(distribution).Mean()
    return math.floor(value) if int in members_of(kind) else value


def draw(distribution: Any, kind: Any, generator: RandomGenerator) -> Any:
    """A number, or a list of numbers, for a field of that type; for int its whole part."""
    if isinstance(distribution, DistributionVector):
        return ToDistributionVector(distribution).Sample(generator).tolist()
    value = Sample(distribution, generator)
    return math.floor(value) if int in members_of(kind) else value


def _require_usable(path: str, distribution: Any, kind: Any) -> None:
    """Raises ScenarioError for a distribution that nothing can be drawn from for such a field."""
    entry = to_entry(distribution)
    text, members = dump_plain(entry), members_of(kind)
    is_number = float in members or int in members
    is_list = list[float] in members or np.ndarray in members
    fits = is_list if isinstance(distribution, DistributionVector) else is_number
    require(fits, path, text, _NUMBER if is_number else _NUMBERS if is_list else _NEITHER)
    values = {name: np.atleast_1d(value) for name, value in entry.items() if name != "_tag"}

    def need(condition: Any, name: str, remedy: str) -> None:
        require(condition, f"{path}.{name}", dump_plain(entry[name]), remedy)

    for name, numbers in values.items():
        need(numbers.size > 0, name, "give at least one number")
        need(np.all(np.isfinite(numbers)), name, "give finite numbers")
    if "stddev" in values:
        need(np.min(values["stddev"]) >= 0, "stddev", "give a standard deviation from 0 on")
        size = values["mean"].size
        remedy = f"give as many numbers as mean has, {size}, or one for all of them"
        need(values["stddev"].size in (size, 1), "stddev", remedy)
    if "min" in values:
        size = values["max"].size
        need(values["min"].size == size, "min", f"give as many numbers as max has, {size}")
        is_below = np.all(values["min"] <= values["max"])
        need(is_below, "min", f"give at most max, which is {dump_plain(entry['max'])}")
    if int in members:
        are_whole = all(np.all(numbers == np.floor(numbers)) for numbers in values.values())
        fits = isinstance(distribution, Uniform) or (are_whole and "stddev" not in values)
        require(fits, path, text, _WHOLE)
