"""Drake's distributions in the place of a scenario's numbers, and the numbers drawn from them.

In YAML a distribution is a tagged mapping such as `!Uniform {min: 0.7, max: 1.3}`, in Python an
object of `pydrake.common.schema`.
"""

import copy
import copyreg
import dataclasses
import functools
import math
import typing
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
from drake_nonstop.validation import fields_of, of_given, require, require_known, require_type

# Called with the path, the distribution and the type of the field; returns what takes its place.
Change = Callable[[str, Any, Any], Any]

_KINDS: dict[str, Any] = {
    "Deterministic": Deterministic,
    "DeterministicVector": DeterministicVectorX,
    "Gaussian": Gaussian,
    "GaussianVector": GaussianVectorX,
    "Uniform": Uniform,
    "UniformVector": UniformVectorX,
    "UniformDiscrete": UniformDiscrete,
}


def reduced(value: Any) -> tuple[Callable[[], Any], tuple[()]]:
    """For `copyreg.pickle`: how to make one of Drake's objects from its fields again."""
    kind: Any = type(value)
    fields = {field.name: getattr(value, field.name) for field in fields_of(kind)}
    return functools.partial(kind, **fields), ()


_SIZED = (DeterministicVector, GaussianVector, UniformVector)  # by the sizes 1 to 6

for _class in (*_KINDS.values(), *(vector[size] for vector in _SIZED for size in range(1, 7))):
    copyreg.pickle(_class, reduced)

_FIELDS: dict[str, tuple[str, ...]] = {
    "Deterministic": ("value",),
    "Gaussian": ("mean", "stddev"),
    "Uniform": ("min", "max"),
    "UniformDiscrete": ("values",),
}
_NUMBER = "give a number, or a distribution of one, such as !Uniform {min: 0, max: 1}"
_NUMBERS = (
    "give a list in [ ], whose entries may be distributions, or a distribution of a list, such as "
    "!UniformVector {min: [0, 0], max: [1, 1]}"
)
_WHOLE = (
    "give whole numbers, !UniformDiscrete {values: [1, 2]}, or !Uniform {min: 0, max: 10}, of "
    "whose numbers the whole part is taken"
)


def is_distribution(value: Any) -> bool:
    """Whether a value is a distribution of `pydrake.common.schema`."""
    return isinstance(value, (Distribution, DistributionVector))


def is_entry(value: Any) -> bool:
    """Whether a value of a scenario's tree stands for a distribution."""
    return isinstance(value, dict) and str(value.get("_tag")).removeprefix("!") in _KINDS


def to_entry(distribution: Any) -> dict[str, Any]:
    """A distribution as it stands in a scenario's tree."""
    name = _name(distribution)
    values = {field: getattr(distribution, field) for field in _FIELDS[name.replace("Vector", "")]}
    return {
        "_tag": f"!{name}",
        **{field: np.asarray(value).tolist() for field, value in values.items()},
    }


def from_entry(path: str, entry: dict[str, Any]) -> Any:
    """The distribution that an entry of a scenario's tree stands for.

    Raises:
        ScenarioError: there is no such one, or a field of it is missing, unknown, or not of its
            type.
    """
    name = entry["_tag"].removeprefix("!")
    remedy = f"give a number, or a distribution: {', '.join(f'!{name}' for name in _KINDS)}"
    require(name in _KINDS, path, dump_plain(entry), remedy)
    fields = _FIELDS[name.replace("Vector", "")]
    is_list = "Vector" in name or name == "UniformDiscrete"
    values = {field: value for field, value in entry.items() if field != "_tag"}
    for field, value in values.items():
        require_known(field, fields, f"{path}.{field}", value)
        require_type(f"{path}.{field}", value, list[float] if is_list else float)
    is_whole = set(values) == set(fields)
    require(is_whole, path, dump_plain(entry), f"give {' and '.join(fields)}")
    return _KINDS[name](**values)


def _require_usable(path: str, distribution: Any, kind: Any) -> None:
    """Raises ScenarioError for a distribution that nothing can be drawn from for such a field."""
    entry = to_entry(distribution)
    text = dump_plain(entry)
    is_vector = isinstance(distribution, DistributionVector)
    kind = of_given(kind, [] if is_vector else None)
    if kind in (float, int):
        require(not is_vector, path, text, _NUMBER)
    elif kind is np.ndarray or kind == list[float]:
        require(is_vector, path, text, _NUMBERS)
    elif typing.get_origin(kind) is list:
        require(False, path, text, "give a list in [ ]; its entries may be distributions")
    else:
        only = "a distribution may stand for a number or a list of numbers only"
        require(False, path, text, f"give what is no distribution; {only}")
    values = {name: np.atleast_1d(value) for name, value in entry.items() if name != "_tag"}
    for name, numbers in values.items():
        field, shown = f"{path}.{name}", dump_plain(entry[name])
        require(numbers.size > 0, field, shown, "give at least one number")
        require(np.all(np.isfinite(numbers)), field, shown, "give finite numbers")
    if "stddev" in values:
        field, shown = f"{path}.stddev", dump_plain(entry["stddev"])
        least = np.min(values["stddev"])
        require(least >= 0, field, shown, "give a standard deviation from 0 on")
        sizes = values["mean"].size, 1
        remedy = f"give as many numbers as mean has, {sizes[0]}, or one for all of them"
        require(values["stddev"].size in sizes, field, shown, remedy)
    if "min" in values:
        field, shown = f"{path}.min", dump_plain(entry["min"])
        size = values["max"].size
        remedy = f"give as many numbers as max has, {size}"
        require(values["min"].size == size, field, shown, remedy)
        is_below = np.all(values["min"] <= values["max"])
        remedy = f"give at most max, which is {dump_plain(entry['max'])}"
        require(is_below, field, shown, remedy)
    if kind is int:
        are_whole = all(np.all(numbers == np.floor(numbers)) for numbers in values.values())
        fits = isinstance(distribution, Uniform) or (are_whole and "stddev" not in values)
        require(fits, path, text, _WHOLE)


def mean(path: str, distribution: Any, kind: Any) -> Any:
    """The mean of a distribution for a field of that type.

    Raises:
        ScenarioError: nothing can be drawn from it for such a field.
    """
    _require_usable(path, distribution, kind)
    if isinstance(distribution, DistributionVector):
        return ToDistributionVector(distribution).Mean().tolist()
    value = ToDistribution(distribution).Mean()
    return math.floor(value) if of_given(kind) is int else value


def draw(distribution: Any, kind: Any, generator: RandomGenerator) -> Any:
    """A number, or a list of numbers, for a field of that type; for int its whole part."""
    if isinstance(distribution, DistributionVector):
        return ToDistributionVector(distribution).Sample(generator).tolist()
    value = Sample(distribution, generator)
    return math.floor(value) if of_given(kind) is int else value


def mapped(value: Any, kind: Any, path: str, change: Change) -> Any:
    """A value of a field of that type with `change` of each distribution in it.

    Dataclasses and lists are gone through in the order of their fields and entries; those
    without any distribution are not copied.
    """
    if is_distribution(value):
        return change(path, value, kind)
    if isinstance(value, list):
        item = item_kind(kind)
        items = [mapped(part, item, f"{path}[{i}]", change) for i, part in enumerate(value)]
        return items if any(a is not b for a, b in zip(items, value, strict=True)) else value
    if not dataclasses.is_dataclass(value) or isinstance(value, type):
        return value
    copied = value
    for field in fields_of(type(value)):
        old = getattr(value, field.name, None)
        if isinstance(old, (int, float, str)):
            continue
        new = mapped(old, field.type, f"{path}.{field.name}".removeprefix("."), change)
        if new is not old:
            copied = copy.copy(value) if copied is value else copied
            setattr(copied, field.name, new)
    return copied


def has_distributions(config: Any) -> bool:
    """Whether a field of a dataclass holds a distribution."""
    return mapped(config, type(config), "", lambda *_: 0) is not config


def item_kind(kind: Any) -> Any:
    """The type of the items of a field of lists; Any where there is none."""
    return next(iter(typing.get_args(of_given(kind, []))), Any)


def _name(distribution: Any) -> str:
    """Its tag: the class's name, without the size of a vector."""
    name, vector, _ = type(distribution).__name__.partition("Vector")
    return name + vector
