"""Layouts of signals, and views of vectors by them.

The contract of the figure's boxes, `drake-nonstop blocks`, logs, plots and exports read names,
units and frames of a signal's entries here. A block of one's own may declare the layouts of its
output ports, by their names:

    class FuelGauge(LeafSystem):
        signal_layouts = {"fuel": Layout(Part("", "n", "kg"))}

An entry has the name "signal.part.carrier.component", without what there is only one of:
"carrier_state.positions.2.x", "load_state.quaternion.w", "tensions.1", "solve_time". Carriers,
cables and coordinates are counted from one.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from operator import itemgetter
from typing import Any, ClassVar, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.validation import ScenarioError

_COMPONENTS = {1: ("",), 3: ("x", "y", "z"), 4: ("w", "x", "y", "z")}
_SIZE = re.compile(r"([134]?)([nm]?)")
_MARKS = {*',"[]\n\r'}  # between and around the names in the first line of a table


def by_name(sizes: Mapping[str, int], rows: NDArray) -> dict[str, NDArray]:
    """The parts (..., size) of rows (..., k) of signals, one after the other, by their names."""
    ends = np.cumsum([*sizes.values()])[:-1]
    return dict(zip(sizes, np.split(rows, ends, axis=-1), strict=True)) if sizes else {}


class Part(NamedTuple):
    """Entries of a signal that belong together.

    The size is "1", "3" (x, y, z) or "4" (w, x, y, z); "n" or "3n" for n carriers; or "m" for the m
    coordinates of the internal force.
    """

    name: str  # "" where the signal has no other part
    size: str
    unit: str = ""  # SI; "": a number without one
    frame: str = ""  # W or L, in which its components are; "": it has none
    meaning: str = ""

    def __str__(self) -> str:
        """Such as "position (3) m, in W"; without a name and a size where it has no name."""
        frame = f"in {self.frame}" if self.frame else ""
        head = f"{self.name} ({self.size}) {self.unit}".strip() if self.name else self.unit
        return ", ".join(filter(None, [head, frame, self.meaning]))

    @property
    def base(self) -> int:
        """The number of its entries, of one carrier or coordinate."""
        return int(self.size.rstrip("nm") or 1)

    @property
    def per(self) -> str:
        """Owner of the entries: "n", each carrier, "m", each coordinate, or "", the signal."""
        return self.size.lstrip("134")


class Entry(NamedTuple):
    """One number of a signal."""

    name: str  # "signal.part.carrier.component"
    unit: str
    frame: str

    @property
    def label(self) -> str:
        """The name with its unit, such as "tensions.1 [N]"."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name


@dataclass(frozen=True)
class Layout:
    """The parts of a signal, in their order.

    Raises:
        ScenarioError: there is no part, two parts have the same name, a size is none of a `Part`,
            or there are parts of n carriers and of m coordinates.
    """

    parts: tuple[Part, ...]

    def __init__(self, *parts: Part):
        names = {part.name for part in parts if isinstance(part, Part)}
        is_sound = len(names) == len(parts) > 0 and all(
            all(isinstance(text, str) and not _MARKS & {*text} for text in part[:4])
            and part.size
            and _SIZE.fullmatch(part.size)
            for part in parts
        )
        if not is_sound or len({part.per for part in parts} - {""}) > 1:
            raise ScenarioError(
                f"layout = {', '.join(map(repr, parts)) or 'no part'}: give Part(name, size, unit, "
                "frame), each with a name of its own and without commas, quotation marks, square "
                "brackets and line breaks, and a size such as 3, n or 3n of carriers, or m"
            )
        object.__setattr__(self, "parts", parts)

    def __str__(self) -> str:
        """Its parts in words."""
        return "; ".join(map(str, self.parts))

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the parts."""
        return tuple(part.name for part in self.parts)

    @property
    def size(self) -> str:
        """Such as "13", "6n" or "2m"; "7 + 2n" where some parts are those of carriers."""
        words = []
        for per in dict.fromkeys(part.per for part in self.parts):
            total = self._per[per]
            words.append(f"{total if total > 1 or not per else ''}{per}")
        return " + ".join(words)

    def count(self, n: int = 0, m: int = 0) -> int:
        """The number of entries for n carriers and m coordinates of the internal force."""
        return self._per[""] + n * self._per["n"] + m * self._per["m"]

    def entries(self, signal: str, size: int) -> tuple[Entry, ...] | None:
        """Entries of a signal of that name and size; None: it is of another size."""
        places = self._places(size)
        if size != self.count(places, places) or places < 0:
            return None
        return tuple(
            Entry(".".join(filter(None, (signal, part.name, place, component))), *part[2:4])
            for part in self.parts
            for place in (map(str, range(1, places + 1)) if part.per else [""])
            for component in _COMPONENTS[part.base]
        )

    def views(self, values: NDArray) -> list[NDArray]:
        """The parts of an array (..., size), without a copy, in the shapes of `SignalParts`."""
        places, found, start = self._places(values.shape[-1]), [], 0
        for base, is_repeated in self._sizes:
            end = start + base * (places if is_repeated else 1)
            view, start = values[..., start:end], end
            has_rows = is_repeated and base > 1
            found.append(view.reshape(*view.shape[:-1], -1, base) if has_rows else view)
        return found

    def _places(self, size: int) -> int:
        """How many carriers or coordinates a signal of that size has; 0 where it has none."""
        repeated = self._per["n"] + self._per["m"]
        return (size - self._per[""]) // repeated if repeated else 0

    @cached_property
    def _sizes(self) -> list[tuple[int, bool]]:
        """Of each part, its number of entries, and whether it has as many for each carrier."""
        return [(part.base, bool(part.per)) for part in self.parts]

    @cached_property
    def _per(self) -> dict[str, int]:
        """The numbers of entries, of those for each carrier, and for each coordinate."""
        return {p: sum(part.base for part in self.parts if part.per == p) for p in ("", "n", "m")}


class SomeOf(Layout):
    """Parts of which a block makes some: its own `signal_layouts` say which."""

    @property
    def size(self) -> str:
        """In words."""
        return "some"

    def __str__(self) -> str:
        """Its parts in words; of those with numbers in their names the first and the last."""
        series: dict[str, list[Part]] = {}
        for part in self.parts:
            series.setdefault(part.name.rstrip("0123456789"), []).append(part)
        ends = [own[:: max(1, len(own) - 1)] for own in series.values()]
        return "; ".join(" to ".join(map(str, each)) for each in ends)


def numbered_entries(signal: str, size: int) -> tuple[Entry, ...]:
    """The entries of a signal of which no layout is known."""
    names = [signal] if size == 1 else [f"{signal}.{i + 1}" for i in range(size)]
    return tuple(Entry(name, "", "") for name in names)


def part(size: str, unit: str = "", frame: str = "", meaning: str = "") -> Any:
    """A part of `SignalParts`, which has the name of the attribute."""
    return Part("", size, unit, frame, meaning)


_Parts = TypeVar("_Parts", bound="SignalParts")


class SignalParts(tuple[NDArray, ...]):
    """The parts of a vector, in their order; of several, such as a log (k, size), too.

    A subclass has its parts after those of its base, each by `part`. They are arrays (..., size),
    and (..., n, 3) those of the size 3n. `flat` is the vector again, and so is `np.concatenate` of
    those without 3n (of logs: with axis=-1).
    """

    layout: ClassVar[Layout]

    def __init_subclass__(cls) -> None:
        own = {n: p._replace(name=n) for n, p in vars(cls).items() if isinstance(p, Part)}
        inherited = cls.layout.parts if hasattr(cls, "layout") else ()
        cls.layout = Layout(*({p.name: p for p in inherited} | own).values())
        for place, name in enumerate(cls.layout.names):
            setattr(cls, name, property(itemgetter(place)))

    def __new__(cls: type[_Parts], *parts: NDArray, **named: NDArray) -> _Parts:
        """The parts in their order, or by their names."""
        names = cls.layout.names
        given = dict(zip(names, parts, strict=False)) | named
        if len(parts) + len(named) != len(names) or given.keys() != {*names}:
            raise TypeError(f"{cls.__name__}: give {', '.join(names)}, each once")
        return super().__new__(cls, (given[name] for name in names))

    @classmethod
    def view(cls: type[_Parts], values: NDArray) -> _Parts:
        """The parts of an array (..., size), as views: nothing is copied.

        Where nothing is for each carrier or coordinate the array may be longer: a reference begins
        like a state.
        """
        return super().__new__(cls, cls.layout.views(values))

    def flat(self) -> NDArray:
        """The array (..., size) of the parts."""
        lead = self[0].shape[: -2 if self.layout.parts[0].size == "3n" else -1]
        return np.concatenate([part.reshape(*lead, -1) for part in self], axis=-1)
