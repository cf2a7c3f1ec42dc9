"""Errors that tell the field, the value and the remedy, and the checks that raise them."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray


class ScenarioWarning(UserWarning):
    """A scenario is run in another way than it asks for; the message tells why."""


class ScenarioError(ValueError):
    """A value that a user gave cannot be used; the message is one clear sentence."""


def show_warning(message: Warning | str, *about: Any, **where: Any) -> None:
    """Python's `warnings.showwarning` in one line, without the place in the code."""
    print(f"warning: {message}")


def one_line(error: BaseException) -> str:
    """An error's type and message in one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())


def require(condition: Any, field: str, value: Any, remedy: str) -> None:
    """Raises ScenarioError "field = value: remedy" unless the condition holds."""
    if not condition:
        raise ScenarioError(f"{field} = {_shown(value)}: {remedy}")


def require_positive(owner: str, **values: float) -> None:
    """Raises ScenarioError for the first value that is not a finite number above zero."""
    for name, value in values.items():
        require(
            is_number(value) and value > 0,
            f"{owner}.{name}",
            value,
            "give a finite number greater than zero",
        )


def require_non_negative(owner: str, **values: float) -> None:
    """Raises ScenarioError for the first value that is not a finite number from zero up."""
    for name, value in values.items():
        require(
            is_number(value) and value >= 0,
            f"{owner}.{name}",
            value,
            "give a finite number that is not negative",
        )


def require_seed(field: str, value: Any) -> None:
    """Raises ScenarioError for what is no seed of a random generator."""
    is_seed = isinstance(value, int) and value >= 0
    require(is_seed, field, value, "give 0 or a whole number above it")


def require_array(field: str, value: Any, shape: Sequence[int | None], meaning: str) -> NDArray:
    """`value` as a finite float array of the shape, in which None stands for any length."""
    expected = " x ".join("n" if size is None else str(size) for size in shape)
    remedy = f"give {expected} finite numbers ({meaning})"
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise ScenarioError(f"{field} = {_shown(value)}: {remedy}") from None
    fits = array.ndim == len(shape) and all(
        size is None or size == actual for size, actual in zip(shape, array.shape, strict=True)
    )
    require(fits and np.all(np.isfinite(array)), field, value, remedy)
    return array


def is_number(value: Any) -> bool:
    """Whether the value is a finite number (a bool is none)."""
    return (
        isinstance(value, (int, float, np.number))
        and not isinstance(value, bool)
        and bool(np.isfinite(value))
    )


def _shown(value: Any) -> str:
    text = " ".join(str(value).split())
    return text if len(text) <= 120 else text[:117] + "..."
