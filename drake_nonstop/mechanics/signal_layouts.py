"""Entries of a signal in their order: names, units and frames.

The contract of the figure's boxes, `drake-nonstop blocks`, logs, plots and exports read it here. A
block of one's own may declare the layouts of its output ports, by their names:

    class FuelGauge(LeafSystem):
        signal_layouts = {"fuel": Layout(Part("", "n", "kg"))}

An entry has the name "signal.part.carrier.component", without what there is only one of:
"carrier_state.positions.2.x", "load_state.quaternion.w", "tensions.1", "solve_time". Carriers,
cables and coordinates are counted from one.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

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

    Of size "1", "3" (x, y, z) or "4" (w, x, y, z), or as many for each of n carriers, "n" and "3n",
    or of m coordinates of the internal force, "m".
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
        """The number of its entries, for each carrier or coordinate where it is of these."""
        return int(self.size.rstrip("nm") or 1)

    @property
    def per(self) -> str:
        """Of what it has entries: "n", "m", or "" for neither."""
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
        ScenarioError: there is no part, or two have one name; a part's size is none of those that
            a `Part` may have; a name, unit or frame cannot stand in a table; or some parts are
            those of n carriers and others of m coordinates.
    """

    parts: tuple[Part, ...]

    def __init__(self, *parts: Part):
        for part in parts:
            is_part = isinstance(part, Part) and all(isinstance(text, str) for text in part)
            if not is_part or not part.size or not _SIZE.fullmatch(part.size):
                raise ScenarioError(
                    f"layout = {tuple.__repr__(part) if isinstance(part, tuple) else part!r}: give "
                    "Part(name, size, unit, frame) of texts, with a size such as 3, n, 3n or m"
                )
            if _MARKS & {*part.name, *part.unit, *part.frame}:
                raise ScenarioError(
                    f"layout = {tuple.__repr__(part)}: give names, units and frames without "
                    "commas, quotation marks, square brackets and line breaks"
                )
        names = [part.name for part in parts]
        if len({*names}) < len(names):
            raise ScenarioError(f"layout = {', '.join(names)}: give each Part a name of its own")
        kinds = {part.per for part in parts} - {""}
        if not parts or len(kinds) > 1:
            raise ScenarioError(
                f"layout = {len(parts)} parts: give at least one Part, of n carriers or of m "
                "coordinates, not of both"
            )
        object.__setattr__(self, "parts", parts)

    def __str__(self) -> str:
        """Its parts in words."""
        return "; ".join(map(str, self.parts))

    @property
    def size(self) -> str:
        """Such as "13", "6n" or "2m"; "7 + 2n" where some parts are those of carriers."""
        words = []
        for per in dict.fromkeys(part.per for part in self.parts):
            total = self._per(per)
            words.append(f"{total if total > 1 or not per else ''}{per}")
        return " + ".join(words)

    def count(self, n: int, m: int) -> int:
        """The number of entries for n carriers and m coordinates of the internal force."""
        return self._per("") + n * self._per("n") + m * self._per("m")

    def entries(self, signal: str, size: int) -> tuple[Entry, ...] | None:
        """Entries of a signal of that name and size; None: it is of another size."""
        fixed = self._per("")
        repeated = self._per("n") + self._per("m")
        places, rest = divmod(size - fixed, repeated) if repeated else (0, size - fixed)
        if rest or places < 0:
            return None
        return tuple(
            Entry(".".join(filter(None, (signal, part.name, place, component))), *part[2:4])
            for part in self.parts
            for place in (map(str, range(1, places + 1)) if part.per else [""])
            for component in _COMPONENTS[part.base]
        )

    def _per(self, per: str) -> int:
        return sum(part.base for part in self.parts if part.per == per)


class SomeOf(Layout):
    """Parts of which a block makes some: its own `signal_layouts` say which."""

    @property
    def size(self) -> str:
        """In words."""
        return "some"


def numbered_entries(signal: str, size: int) -> tuple[Entry, ...]:
    """The entries of a signal of which no layout is known."""
    names = [signal] if size == 1 else [f"{signal}.{i + 1}" for i in range(size)]
    return tuple(Entry(name, "", "") for name in names)


_POSE = (
    Part("quaternion", "4", "", "W", "of R_WL"),
    Part("position", "3", "m", "W"),
)
_TWIST = (
    Part("angular_velocity", "3", "rad/s", "W"),
    Part("velocity", "3", "m/s", "W"),
)

# The layouts of the `mechanics.signals` and of other vectors between the blocks.
LOAD_STATE = Layout(*_POSE, *_TWIST)
WRENCH = Layout(
    Part("torque", "3", "N m", "W", "about the load's centre of mass"), Part("force", "3", "N", "W")
)
CARRIER_STATES = Layout(Part("positions", "3n", "m", "W"), Part("velocities", "3n", "m/s", "W"))
PLANNED_PARAMETERS = Layout(
    Part("angle", "1", "rad", "", "θ"),
    Part("frequency", "1", "rad/s", "", "ξ"),
    Part("amplitude", "1", "N", "", "A"),
    Part("frequency_rate", "1", "rad/s²", "", "ξ̇"),
    Part("amplitude_rate", "1", "N/s", "", "Ȧ"),
    Part("frequency_second_rate", "1", "rad/s³", "", "ξ̈"),
    Part("amplitude_second_rate", "1", "N/s²", "", "Ä"),
    Part("amplitude_third_rate", "1", "N/s³", "", "A⃛"),
)
AIRCRAFT_COMMAND = Layout(
    Part("lift", "n", "", "", "C_L"),
    Part("bank", "n", "rad", "", "positive to the right"),
    Part("thrust", "n", "N"),
)

MOST_NODES = 50  # of a cable


def nodes_layout(nodes: int) -> SomeOf:
    """The state of so many nodes of each cable, from the load on."""
    return SomeOf(
        *(Part(f"position_{k + 1}", "3n", "m", "W") for k in range(nodes)),
        *(Part(f"velocity_{k + 1}", "3n", "m/s", "W") for k in range(nodes)),
    )


SAMPLE_TIME = "sample_time"  # of what is held
HELD = "held_"  # begins the name of a signal that is held from one sample to the next
SAMPLED = "sampled_"  # how names begin of what a block makes at samples and moves in between

# By the names of signals; None: one is no vector. Besides, a block may have `signal_layouts`.
SIGNALS: dict[str, Layout | None] = {
    "reference": Layout(
        _POSE[0]._replace(meaning="of R_WD, D the desired frame"),
        _POSE[1],
        *_TWIST,
        Part("angular_acceleration", "3", "rad/s²", "W"),
        Part("acceleration", "3", "m/s²", "W"),
        Part("jerk", "3", "m/s³", "W"),
    ),
    "reference_higher_rates": Layout(
        Part("angular_jerk", "3", "rad/s³", "W"), Part("snap", "3", "m/s⁴", "W")
    ),
    "reference_preview": None,
    "reference_delay": Layout(Part("", "1", "s", "", "d of the governed time t − d")),
    "load_state": LOAD_STATE,
    "measured_load_state": LOAD_STATE,
    "wrench": WRENCH,
    "wrench_rate": Layout(Part("torque", "3", "N m/s", "W"), Part("force", "3", "N/s", "W")),
    "tracking_error": Layout(
        Part("orientation", "3", "rad", "L", "e_R"),
        Part("position", "3", "m", "W", "e_p"),
        Part("angular_velocity", "3", "rad/s", "L", "e_ω"),
        Part("velocity", "3", "m/s", "W", "e_v"),
    ),
    "parameters": Layout(
        Part("frequency", "1", "rad/s", "", "ξ"), Part("amplitude", "1", "N", "", "A")
    ),
    "plan": PLANNED_PARAMETERS,
    "planned": PLANNED_PARAMETERS,
    "phase": Layout(Part("angle", "1", "rad", "", "θ"), Part("slope", "1", "s", "", "∂θ/∂ξ")),
    "solve_time": Layout(Part("", "1", "s", "", "wall time of the last update")),
    "speed_bound": Layout(Part("", "1", "m/s", "", "ε, set or commanded")),
    "speed_bound_command": Layout(Part("", "1", "m/s", "", "ε, in place of the one that is set")),
    SAMPLE_TIME: Layout(Part("", "1", "s", "", "of the last sample")),
    "internal_force": Layout(Part("values", "m", "N", "", "λ"), Part("rates", "m", "N/s", "", "λ̇")),
    "internal_force_higher_rates": Layout(
        Part("second", "m", "N/s²", "", "λ̈"), Part("third", "m", "N/s³", "", "λ⃛")
    ),
    "desired_cable_forces": Layout(Part("", "3n", "N", "W", "on the load")),
    "desired_cable_force_rates": Layout(Part("", "3n", "N/s", "W")),
    "carrier_reference": CARRIER_STATES,
    "carrier_reference_acceleration": Layout(Part("", "3n", "m/s²", "W")),
    "sampled_carrier_reference": CARRIER_STATES,
    "sampled_carrier_reference_acceleration": Layout(Part("", "3n", "m/s²", "W")),
    "carrier_reference_jerk": Layout(Part("", "3n", "m/s³", "W")),
    "cable_reference": nodes_layout(MOST_NODES),
    "cable_drag_and_weight": Layout(
        Part("", "3n", "N", "W", "that carriers pull with beyond desired_cable_forces")
    ),
    "cable_drag_and_weight_rates": Layout(Part("", "3n", "N/s", "W")),
    "carrier_forces": Layout(Part("", "3n", "N", "W")),
    "aircraft_command": AIRCRAFT_COMMAND,
    "command_saturation": Layout(
        *(
            Part(part.name, "n", "", "", "1 where a limit holds it")
            for part in AIRCRAFT_COMMAND.parts
        )
    ),
    "carrier_state": CARRIER_STATES,
    "aircraft_state": Layout(
        AIRCRAFT_COMMAND.parts[0]._replace(meaning="C_L with the gusts' part, at most its maximum"),
        *AIRCRAFT_COMMAND.parts[1:],
        Part("airspeed", "n", "m/s"),
    ),
    "carrier_acceleration": Layout(Part("", "3n", "m/s²", "W")),
    "cable_state": nodes_layout(MOST_NODES),
    "cable_forces": Layout(Part("", "3n", "N", "W", "on the load, at its attachments")),
    "carrier_cable_forces": Layout(Part("", "3n", "N", "W", "of the carriers on their cables")),
    "tensions": Layout(Part("", "n", "N", "", "0 where slack")),
    "disturbance_wrench": WRENCH,
    "wind": Layout(Part("", "3n", "m/s", "W", "of the air at the carriers")),
    "load_wind": Layout(Part("", "3", "m/s", "W", "of the air at the load")),
    "mean_wind": Layout(Part("", "3", "m/s", "W", "at the load, without gusts")),
    "wind_estimate": Layout(Part("", "3", "m/s", "W", "what the controllers believe")),
    "wind_variance": Layout(Part("", "1", "m²/s²", "", "of the estimate, on each axis")),
    "carrier_gust_estimate": Layout(Part("", "3n", "m/s", "W", "at carriers, beyond their mean")),
}
