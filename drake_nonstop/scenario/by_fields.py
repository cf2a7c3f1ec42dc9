"""Values that are compared and pickled by their fields, those of Drake's classes among them."""

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from drake_nonstop.validation import fields_of


def comparable(value: Any) -> Any:
    """What equals that of another value if they are of one class and their fields are equal.

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


def reduced(value: Any) -> tuple[Callable[[], Any], tuple[()]]:
    """For `copyreg.pickle`: how to make one of Drake's objects from its fields again."""
    kind: Any = type(value)
    fields = {field.name: getattr(value, field.name) for field in fields_of(kind)}
    return functools.partial(kind, **fields), ()
