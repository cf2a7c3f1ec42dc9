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
    Distribution,
    DistributionVector,
    Gaussian,
    Sample,
    Uniform,
    UniformDiscrete,
)

from drake_nonstop.scenario.yaml_text import dump_plain
from drake_nonstop.validation import members_of, require, require_known, require_type

_KINDS: dict[str, Any] = {
    "Gaussian": Gaussian,
    "Uniform": Uniform,
    "UniformDiscrete": UniformDiscrete,
}
_NUMBER = "give a number, or a distribution of one, such as !Uniform {min: 0, max: 1}"
_NUMBERS = "give a list in [ ], whose entries may be distributions"
_NEITHER = "a distribution may stand for a number only"
_WHOLE = (
    "give whole numbers, !UniformDiscrete {values: [1, 2]}, or !Uniform {min: 0, max: 10}, of "
    "whose numbers the whole part is taken"
)


def reduced(value: Any) -> tuple[Callable[[], Any], tuple[()]]:
    """For `copyreg.pickle`: how to make one of Drake's objects from its fields again."""
    kind: Any = type(value)
    fields = {field.name: getattr(value, field.name) for field in kind.__fields__}
    return functools.partial(kind, **fields), ()


for _class in _KINDS.values():
    copyreg.pickle(_class, reduced)


def is_distribution(value: Any) -> bool:
    """Whether a value is a distribution of `pydrake.common.schema`."""
    return isinstance(value, (Distribution, DistributionVector))


def is_entry(value: Any) -> bool:
    """Whether a value of a scenario's tree stands for a distribution."""
    return isinstance(value, dict) and str(value.get("_tag")).removeprefix("!") in _KINDS


def to_entry(distribution: Any) -> dict[str, Any]:
    """A distribution as it stands in a scenario's tree."""
    kind = type(distribution)
    values = {f.name: getattr(distribution, f.name) for f in kind.__fields__}
    return {"_tag": f"!{kind.__name__}"} | {k: np.asarray(v).tolist() for k, v in values.items()}


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
    for field, value in values.items():
        require_known(field, fields, f"{path}.{field}", value)
        is_right = isinstance(value, list) == (field == "values")
        remedy = f"give {'a list in [ ]' if field == 'values' else 'a number'}"
        require(is_right, f"{path}.{field}", value, remedy)
        for number in value if isinstance(value, list) else [value]:
            require_type(f"{path}.{field}", number, float)
    require(set(values) == set(fields), path, dump_plain(entry), f"give {' and '.join(fields)}")
    return _KINDS[name](**values)


def ends(path: str, distribution: Any, kind: Any) -> tuple[Any, Any]:
    """The least and the largest number that is drawn for a field of that type; of a Gaussian means.

    Raises:
        ScenarioError: nothing can be drawn from it for such a field.
    """
    entry, members = to_entry(distribution), members_of(kind)
    text, is_whole = dump_plain(entry), int in members
    is_number = is_whole or float in members
    remedy = _NUMBER if is_number else _NUMBERS if list[float] in members else _NEITHER
    require(is_number and type(distribution) in _KINDS.values(), path, text, remedy)
    for name, value in entry.items():
        if name != "_tag":
            is_finite = value != [] and np.all(np.isfinite(value))
            require(is_finite, f"{path}.{name}", dump_plain(value), "give finite numbers")
    spread, low = entry.get("stddev", 0.0), entry.get("min", -math.inf)
    require(spread >= 0, f"{path}.stddev", spread, "give a standard deviation from 0 on")
    high = entry.get("max", math.inf)
    require(low <= high, f"{path}.min", low, f"give at most max, which is {high:g}")
    are_whole = all(value == math.floor(value) for value in entry.get("values", ()))
    fits = not is_whole or (are_whole and not isinstance(distribution, Gaussian))
    require(fits, path, text, _WHOLE)
    numbers = entry.get("values") or [
        entry[name] for name in ("mean", "min", "max") if name in entry
    ]
    least, most = min(numbers), max(numbers)
    return (math.floor(least), math.floor(most)) if is_whole else (least, most)


def draw(distribution: Any, kind: Any, generator: RandomGenerator) -> Any:
    """A number for a field of that type; for int its whole part."""
    value = Sample(distribution, generator)
    return math.floor(value) if int in members_of(kind) else value
