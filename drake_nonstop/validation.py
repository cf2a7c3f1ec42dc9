"""Errors that tell the field, the value and the remedy, and the checks that raise them."""

import copy
import dataclasses
import difflib
import functools
import importlib.util
import math
import re
import sys
import traceback
import types
import typing
import warnings
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

_LARGEST = 1e9  # of a number in a scenario, in SI units
_LEAST = 1e-12  # of a number that has to be above zero
SHORTEST_PERIOD = 1e-4  # s, between samples
_LARGEST_FILE = 16_000_000  # bytes
_DEEPEST = 20  # lists within lists
_Config = typing.TypeVar("_Config")


class ScenarioWarning(UserWarning):
    """The scenario is run in another way than it states; the message gives the reason."""


def warn_user(message: str) -> None:
    """Warns at the line outside of the package that led here, by a ScenarioWarning."""
    package, level, frame = __name__.partition(".")[0], 1, sys._getframe()
    while frame.f_back and frame.f_globals.get("__name__", "").partition(".")[0] == package:
        frame, level = frame.f_back, level + 1
    warnings.warn(message, ScenarioWarning, stacklevel=level)


class ScenarioError(ValueError):
    """A value that a user gave cannot be used; the message is one clear sentence."""


def show_warning(message: Warning | str, *about: Any, **where: Any) -> None:
    """Python's `warnings.showwarning` in one line on stderr, without the place in the code."""
    print(f"warning: {message}", file=sys.stderr, flush=True)


def one_line(error: BaseException) -> str:
    """An error's type and message in one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())


def require(condition: Any, field: str, value: Any, remedy: str) -> None:
    """Raises ScenarioError "field = value: remedy", in one line, unless the condition holds."""
    if not condition:
        raise _refusal(field, value, remedy)


def _refusal(field: str, value: Any, remedy: str) -> ScenarioError:
    return ScenarioError(_printable(f"{_shown(field)} = {_shown(value)}: {remedy}"))


def require_installed(what: str, **packages: str) -> None:
    """Raises ScenarioError unless what needs these packages, by the names of modules, has them.

    A package may be an extra, "drake-nonstop[video]".
    """
    for module, package in packages.items():
        is_installed = importlib.util.find_spec(module) is not None
        name = package.rpartition("[")[2].rstrip("]")
        quoted = package if name == package else f"'{package}'"  # from the shell
        require(is_installed, what, f"no {name}", f"install it, `pip install {quoted}`")


def called(field: str, remedy: str, function: Any, *arguments: Any, **named: Any) -> Any:
    """Calls a function of the user's and returns its value.

    Raises:
        ScenarioError: it does not take these arguments.
    """
    try:
        return function(*arguments, **named)
    except TypeError as error:
        if len([*traceback.walk_tb(error.__traceback__)]) > 1:  # it was called, and failed
            raise
        name = getattr(function, "__name__", type(function).__name__)
        cause = str(error).partition("\n")[0]
        raise _refusal(field, name, f"it cannot be called so ({cause}); {remedy}") from None


def listed(field: str, value: Any, remedy: str) -> list[Any]:
    """The items of what can be iterated and is no text.

    Raises:
        ScenarioError: it is anything else, such as an array without dimensions.
    """
    try:
        items = None if isinstance(value, (str, bytes)) else iter(value)
    except TypeError:
        items = None
    require(items is not None, field, value, remedy)
    return [*typing.cast(Any, items)]


def require_positive(field: str, value: Any) -> None:
    """Raises ScenarioError for what is no number above zero, from 1e-12 to 1e9."""
    is_positive = is_number(value) and value > 0
    require(is_positive, field, value, "give a finite number greater than zero")
    is_within = _LEAST <= value <= _LARGEST
    require(is_within, field, value, f"give {_LEAST:g} to {_LARGEST:g}, in SI units")


def require_non_negative(field: str, value: Any) -> None:
    """Raises ScenarioError for what is no number from zero to 1e9."""
    is_natural = is_number(value) and value >= 0
    require(is_natural, field, value, "give a finite number that is not negative")
    require(value <= _LARGEST, field, value, f"give at most {_LARGEST:g}, in SI units")


def checked(default: Any, *checks: Callable[[str, Any], Any]) -> Any:
    """A dataclass's field with its default and its checks, which `require_ranges` calls.

    Args:
        default: of the field; a list is copied for each object, and None passes unchecked.
        checks: called with the field's path and value; they raise ScenarioError.
    """
    declared: dict[str, Any] = {"metadata": {"checks": checks}}
    if isinstance(default, list):
        return dataclasses.field(default_factory=lambda: copy.deepcopy(default), **declared)
    return dataclasses.field(default=default, **declared)


def positive(default: float | None, *checks: Callable[[str, Any], Any]) -> Any:
    """A field of a number above zero, up to 1e9, with further checks."""
    return checked(default, require_positive, *checks)


def non_negative(default: float | None, *checks: Callable[[str, Any], Any]) -> Any:
    """A field of a number from zero to 1e9, with further checks."""
    return checked(default, require_non_negative, *checks)


def fulfilling(default: Any, condition: Callable[[Any], Any], remedy: str) -> Any:
    """A field of a number, finite or not, that fulfils a condition."""
    return checked(default, number_with(condition, remedy))


def number_with(condition: Callable[[Any], Any], remedy: str) -> Callable[[str, Any], None]:
    """A check of a number, finite or not, that fulfils a condition."""

    def check(field: str, value: Any) -> None:
        is_one = is_number(value) or value in (math.inf, -math.inf)
        require(is_one and condition(value), field, value, remedy)

    return check


def number_or_list(check: Callable[[str, Any], Any]) -> Callable[[str, Any], None]:
    """A check of a number, or of each number in a list."""

    def check_all(field: str, value: Any) -> None:
        for i, number in enumerate(value if isinstance(value, list) else ()):
            check(f"{field}[{i}]", number)
        if not isinstance(value, list):
            check(field, value)

    return check_all


def whole(default: int, least: int, most: int) -> Any:
    """A field of a whole number from the least to the most."""
    return checked(default, lambda field, value: require_whole(field, value, least, most))


def require_whole(field: str, value: Any, least: int, most: int) -> None:
    """Raises ScenarioError for what is no whole number from the least to the most."""
    is_whole = isinstance(value, int) and not isinstance(value, bool) and least <= value <= most
    remedy = f"give {least}" if least == most else f"give a whole number from {least} to {most}"
    require(is_whole, field, value, remedy)


def vector(default: list[float], meaning: str, *checks: Callable[[str, Any], Any]) -> Any:
    """A field of three finite numbers, with further checks; `meaning` as of `require_array`."""
    is_vector = functools.partial(require_array, shape=[3], meaning=meaning)
    return checked(default, is_vector, *checks)


def one_of(options: Collection[Any], remedy: str) -> Callable[[str, Any], None]:
    """A check of what is one of some options."""
    return lambda field, value: require(value in options, field, value, remedy)


def require_ranges(owner: str, config: _Config, values: Mapping[str, Any] | None = None) -> _Config:
    """The dataclass, whose fields are as they are declared.

    Args:
        owner: its name in error messages.
        config: the dataclass.
        values: those of the fields where they are not the dataclass's own.

    Raises:
        ScenarioError: the declaration of a field refuses its value.
    """
    values = vars(config) if values is None else values
    for field in dataclasses.fields(typing.cast(Any, config)):
        for check in field.metadata.get("checks", ()):
            value = values[field.name]
            if value is not None or field.default is not None:
                check(f"{owner}.{field.name}".removeprefix("."), value)
    return config


def require_period(field: str, value: float) -> None:
    """Raises ScenarioError for what is no time between samples (s) that a run can go on with."""
    require_positive(field, value)
    require(value >= SHORTEST_PERIOD, field, value, f"give at least {SHORTEST_PERIOD:g} s")


def require_seed(field: str, value: Any) -> None:
    """Raises ScenarioError for what is no seed of a random generator."""
    require_whole(field, value, 0, 10**18)


def require_known(key: Any, valid: Collection[str], field: str, value: Any) -> None:
    """Raises ScenarioError for a key that is not among the valid ones.

    Only then is a close one looked for, which takes longer than all else.
    """
    if key not in valid:
        name = _shown(key)
        close = difflib.get_close_matches(name, valid, n=1)
        hint = f"did you mean {close[0]}? " if close else ""
        there = f"there is no {name}; {hint}there are {', '.join(valid) or 'no fields'}"
        require(False, field, value, there)


class StrictFields:
    """A base of dataclasses that have no attributes besides their fields.

    What is assigned becomes plain: NumPy's numbers and arrays become Python's numbers and lists,
    and tuples become lists.

    Raises:
        ScenarioError: there is no field of that name.
    """

    __dataclass_fields__: typing.ClassVar[dict[str, Any]]

    def __setattr__(self, name: str, value: Any) -> None:
        owner = type(self).__name__
        require_known(name, self.__dataclass_fields__, f"{owner}.{name}", value)
        object.__setattr__(self, name, plain_value(value, f"{owner}.{name}"))


def plain_value(value: Any, field: str, depth: int = 0) -> Any:
    """A value with Python's numbers and lists in place of NumPy's, and of tuples."""
    if isinstance(value, (np.generic, np.ndarray)):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        require(depth < _DEEPEST, field, "lists within lists", f"give at most {_DEEPEST} levels")
        return [plain_value(item, field, depth + 1) for item in value]
    if isinstance(value, dict):
        require(depth < _DEEPEST, field, "dicts within dicts", f"give at most {_DEEPEST} levels")
        return {key: plain_value(item, field, depth + 1) for key, item in value.items()}
    return value


@functools.cache
def members_of(kind: Any) -> tuple[Any, ...]:
    """The types that a value of a type may have: the members of a union, or the type itself."""
    is_union = typing.get_origin(kind) in (typing.Union, types.UnionType)
    return typing.get_args(kind) if is_union else (kind,)


def require_type(field: str, value: Any, kind: type) -> Any:
    """The value, a number, text or truth value; a whole number as a float where that is asked for.

    Raises:
        ScenarioError: it is none of `kind`: float, int, bool or str, or a number is NaN, or large.
    """
    if kind is bool:
        require(isinstance(value, bool), field, value, "give true or false")
        return value
    if kind is str:
        require(isinstance(value, str), field, value, "give a text, in quotes")
        is_text = not any("\ud800" <= character <= "\udfff" for character in value)
        require(is_text, field, value, "give a text that can be written as UTF-8")
        return value
    if isinstance(value, str):
        require(not number_text(value), field, f"'{value}'", "give the number without quotes")
        is_other = re.fullmatch(r"[-+]?(\.?nan|inf|infinity|[0-9][0-9A-Fa-foxOX_:.]*)", value, re.I)
        require(not is_other, field, value, "give a finite number in plain digits, or .inf")
    is_whole = isinstance(value, int) and not isinstance(value, bool)
    if kind is int:
        require(is_whole, field, value, "give a whole number")
        require(abs(value) < 2**63, field, value, "give a whole number of 18 digits at most")
        return value
    require(is_whole or isinstance(value, float), field, value, "give a number")
    require(value == value, field, value, "give a finite number")
    is_within = abs(value) <= _LARGEST or value in (math.inf, -math.inf)
    require(is_within, field, value, f"give a number up to {_LARGEST:g}, in SI units")
    return float(value) if is_whole else value


def number_text(text: str) -> bool:
    """Whether a text is a decimal number as scenarios write it: 10, -0.5, 1e-3, .inf."""
    return bool(_NUMBER.fullmatch(text))


# YAML 1.2's decimal numbers, without zeros in front: YAML 1.1 takes these for octal digits.
_NUMBER = re.compile(
    r"[-+]?(?:(?:0|[1-9][0-9]*)(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)"
)


def read_text(path: str | Path, field: str, remedy: str = "give a file that can be read") -> str:
    """The text of a file, UTF-8 with or without a byte-order mark.

    Error messages call it `field`, and `remedy` is what to give in its place.

    Raises:
        ScenarioError: it cannot be read, is no regular file, is not UTF-8, or is above 16 MB.
    """
    try:
        file = Path(path)
        is_usable = file.is_file() and file.stat().st_size <= _LARGEST_FILE
        text = file.read_text(encoding="utf-8-sig") if is_usable else None
    except (OSError, ValueError) as error:
        raise _refusal(field, path, f"{remedy} ({_shown(error)})") from None
    why = "no folder or device, of 16 MB at most" if file.exists() else "there is none of this name"
    require(text is not None, field, path, f"{remedy}: {why}")
    return typing.cast(str, text)


def require_flags(**flags: bool) -> None:
    """Raises ScenarioError for the first argument that is neither True nor False."""
    for name, value in flags.items():
        require_type(name, value, bool)


def require_array(field: str, value: Any, shape: Sequence[int | None], meaning: str) -> NDArray:
    """`value` as a finite float array of the shape, in which None stands for any length."""
    expected = " x ".join("n" if size is None else str(size) for size in shape)
    remedy = f"give {expected} finite numbers ({meaning})"
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise _refusal(field, value, remedy) from None
    fits = array.ndim == len(shape) and all(
        size is None or size == actual for size, actual in zip(shape, array.shape, strict=True)
    )
    require(fits and np.all(np.isfinite(array)), field, value, remedy)
    is_within = np.all(np.abs(array) <= _LARGEST)
    require(is_within, field, value, f"give numbers up to {_LARGEST:g}, in SI units")
    return array


def is_number(value: Any) -> bool:
    """Whether the value is a finite number (a bool is none)."""
    is_one = isinstance(value, (int, float, np.integer, np.floating))
    try:
        return is_one and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:  # an int beyond all floats
        return False


def finite(value: Any) -> Any:
    """The value, with None for each number in its dictionaries and lists that is not finite.

    Scalars of NumPy become Python's, which JSON knows.
    """
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _shown(value: Any) -> str:
    try:
        text = " ".join(str(value).split())
    except Exception:  # whatever a user's object may raise; an int of thousands of digits
        text = f"<{type(value).__name__}>"
    return text if len(text) <= 120 else text[:117] + "..."


def _printable(text: str) -> str:
    """The text in one line that any terminal can show."""
    line = " ".join(text.split())
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in line)
