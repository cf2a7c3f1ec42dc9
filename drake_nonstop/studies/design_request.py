"""Request for the design of a formation of aircraft."""

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from drake_nonstop.analysis.flight_envelope import FlightEnvelope
from drake_nonstop.mechanics.aircraft import Aircraft
from drake_nonstop.model.aircraft import CABLE_DIAMETER, AircraftParameters, make_aircraft
from drake_nonstop.model.system import checked_inertia
from drake_nonstop.planning.formation_program import KINDS
from drake_nonstop.planning.problem_config import AircraftLimits, check_flight_limits, points
from drake_nonstop.scenario.describe import commented_fields
from drake_nonstop.scenario.fields import Walk
from drake_nonstop.scenario.overrides import parse_override
from drake_nonstop.scenario.schema import check_name
from drake_nonstop.scenario.yaml_text import parse_plain
from drake_nonstop.validation import (
    StrictFields,
    checked,
    fulfilling,
    one_of,
    read_text,
    require,
    require_array,
    vector,
)

GRAVITY = 9.81  # m/s²
_LIMITS = FlightEnvelope()
MARGIN, POWER = "margin", "power"
STRAIGHT, LUMPED = "straight", "lumped"


def _within(low: float, high: float, unit: str) -> Callable[[str, Any], None]:
    """A check of what a formation can have to do with, far beyond any that was flown."""

    def check(field: str, value: Any) -> None:
        size = np.linalg.norm(value) if isinstance(value, list) else value
        require(low <= size <= high, field, value, f"give {low:g} to {high:g} {unit}")

    return check


def _below(default: float, limit: float) -> Any:
    remedy = f"give a number above 0 and below {limit:.3g}, the limit"
    return fulfilling(default, lambda value: 0 < value < limit, remedy)


@dataclass(kw_only=True)
class _Asked(StrictFields):
    name: str = "formation"  # of the scenarios that are made
    aircraft: AircraftParameters = field(
        default_factory=lambda: AircraftParameters(model="rascal_110")
    )
    carriers: list[int] = field(default_factory=lambda: [3, 4, 5, 6])  # numbers to be tried
    kinds: list[str] = field(default_factory=lambda: [*KINDS])  # leaning, co_rotating
    load_mass: float = checked(10.0, _within(1e-3, 1e5, "kg"))  # kg
    # m, of the circle through the attachments
    load_radius: float = checked(1.5, _within(1e-3, 1e3, "m"))
    load_inertia: list[list[float]] | None = None  # kg m², in L; none: a disc of that radius
    load_drag: float = checked(0.6, _within(0.0, 1e4, "N s/m"))  # N s/m
    cable_length: list[float] = field(default_factory=lambda: [60.0, 200.0])  # m, least and largest
    cable_diameter: float = checked(CABLE_DIAMETER, _within(0.0, 0.1, "m"))  # m
    # breaking load over the largest tension, from which the diameter follows; 0: that is given
    cable_safety: float = checked(0.0, _within(0.0, 100.0, ""))
    # straight, or lumped: with mass, drag, and references that know of their bow
    cables: str = checked(STRAIGHT, one_of((STRAIGHT, LUMPED), f"give {STRAIGHT} or {LUMPED}"))
    cable_stiffness: float = checked(120.0, _within(1e-2, 1e7, "N/m"))  # N/m
    cable_damping: float = checked(2.0, _within(0.0, 1e6, "N s/m"))  # N s/m
    # m/s, in W
    wind: list[float] = vector([0.0, 0.0, 0.0], "m/s, in W", _within(0.0, 100.0, "m/s"))
    gust: float = checked(0.0, _within(0.0, 20.0, "m/s"))  # m/s, standard deviation of gusts
    # m, of the load
    displacement: list[float] = vector([50.0, 0.0, 0.0], "m, in W", _within(0.0, 1e6, "m"))
    # m/s, the load's largest on the way; 0: it rests
    speed: float = checked(1.25, _within(0.0, 1e3, "m/s"))
    separation: float = checked(12.0, _within(1e-3, 1e4, "m"))  # m, of any two carriers, at least
    # of C_Lmax, at most; less than where a controller saturates
    lift_share: float = _below(0.8, _LIMITS.lift_share)
    # of the stall speed, at least; more than where thrust is added
    speed_share: float = fulfilling(
        1.25,
        lambda share: _LIMITS.speed_share < share <= 10,
        f"give a number above {_LIMITS.speed_share:g}, the limit, up to 10",
    )
    # rad, at most; less than where a controller saturates
    bank: float = _below(0.75, _LIMITS.bank)
    # rad, up or down at most; a formation beyond 0.52 is refused
    climb: float = _below(0.45, _LIMITS.climb)
    # of the range of thrust at an airspeed, kept at both of its ends
    thrust_reserve: float = _below(0.1, 0.5)
    # what the first formation has: the largest margin, or the least power
    first: str = checked(MARGIN, one_of((MARGIN, POWER), f"give {MARGIN} or {POWER}"))
    starts: int = points(4, 100)  # of the search for each number of carriers and kind


@dataclass(kw_only=True)
class DesignRequest(AircraftLimits, _Asked):
    """Aircraft, load, wind and margins for which `design` finds formations.

    The attachments are a regular polygon about the load's centre of mass. The margins, and the
    limits of aircraft, hold at rest and while the load moves from rest to rest along
    `displacement`; the separation holds at rest in still air. Where gusts reduce an airspeed by
    three standard deviations, lift and airspeed stay within the aircraft's own limits. Each
    formation is flown in gusts 1.25 times as strong before it is returned.
    """

    def check(self) -> Aircraft:
        """The aircraft, of a cable of the largest length.

        Raises:
            ScenarioError: a field cannot be used.
        """

        def need(condition: Any, name: str, remedy: str) -> None:
            require(condition, f"request.{name}", getattr(self, name), remedy)

        Walk(reads_trees=False).read("request", DesignRequest, self)
        check_name(self.name)
        for name, usable, remedy in (
            ("carriers", range(3, 13), "give numbers from 3 to 12, each once, such as [3, 4]"),
            ("kinds", KINDS, f"give some of {', '.join(KINDS)}, each once"),
        ):
            values = getattr(self, name)
            need(values and {*values} <= {*usable} and len({*values}) == len(values), name, remedy)
        short, long = require_array("request.cable_length", self.cable_length, [2], "m, in order")
        remedy = "give the least and the largest, from 1 to 5000 m, in this order"
        need(1 <= short <= long <= 5000, "cable_length", remedy)
        reach = 2 * (self.load_radius + long)
        remedy = f"give at most {reach:.3g}, twice the reach of the longest cable"
        need(self.separation <= reach, "separation", remedy)
        way = float(np.linalg.norm(self.displacement))
        remedy = f"give {way / 36000:.2g} to {way:.2g}, for the length of the way, or 0 for none"
        need(self.speed == 0 or way / 36000 <= self.speed <= way, "speed", remedy)
        checked_inertia("request.load_inertia", self.inertia)
        aircraft = make_aircraft(
            self.aircraft,
            cable_length=float(long),
            gravity=GRAVITY,
            cable_diameter=self.cable_diameter,
            field="request.aircraft",
        )
        check_flight_limits("request", self, aircraft)
        return aircraft

    @property
    def inertia(self) -> list[list[float]]:
        """Inertia of the load, as given or that of a disc."""
        if self.load_inertia is not None:
            return self.load_inertia
        flat = self.load_mass * self.load_radius**2 / 4
        return np.diag([flat, flat, 2 * flat]).tolist()


def read_request(file: str | Path | None = None, overrides: Sequence[str] = ()) -> DesignRequest:
    """The request in a YAML file, or the default one, with changes "path=value".

    The file's keys are the fields of `DesignRequest`; the default name is that of the file.
    "load_mass=5" and "aircraft.mass=7" are changes.

    Raises:
        ScenarioError: the file cannot be read, or a field cannot be used.
    """
    tree: dict[str, Any] = {}
    if file is not None:
        path = Path(file)
        content = parse_plain(read_text(path, "REQUEST"), path.name)
        is_mapping = content is None or (isinstance(content, dict) and "_tag" not in content)
        require(is_mapping, path.name, content, "give a mapping of fields to values")
        tree = {"name": path.stem} | (content or {})
    for override in overrides:
        path_of, value = parse_override(override)
        owner, dot, part = path_of.partition(".")
        if dot:
            given = tree.get(owner) or {}
            usable = owner == "aircraft" and isinstance(given, dict)
            require(usable, "--set", path_of, "give a field, or aircraft.FIELD")
            value = given | {part: value}
        tree[owner] = value
    request = DesignRequest()
    Walk().read("request", DesignRequest, tree, request)
    request.check()
    return request


def dump_request(request: DesignRequest) -> str:
    """The request as YAML, with the unit and meaning of every field, which `read_request` reads."""
    tree = {k: v for k, v in vars(request).items() if v is not None}
    tree["aircraft"] = {k: v for k, v in vars(request.aircraft).items() if v is not None}
    about = (inspect.getdoc(DesignRequest) or "").splitlines()
    lines = [*(f"# {text}".rstrip() for text in about)]
    return "\n".join([*lines, *commented_fields(0, tree, DesignRequest), ""])
